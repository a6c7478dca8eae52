"""The commands `mimesh demo`, `mimesh models` and `mimesh doctor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..core.printable import say, shell_line
from .options import OutputOptions, Without, with_options
from .terminal import Json, Stop, open_page, print_json, print_next, progress


@with_options
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")] = Path("mimesh-demo"),
    body: Annotated[str, typer.Option(help="human, or quadruped: a cow takes over a horse's gallop.")] = "human",
    *,
    printed: Annotated[OutputOptions, Without("output", "preview", "no_clobber", "no_limits")],
) -> None:
    """Let a shipped person take over a captured motion.

    Writes the inputs, an animated GLB, a picture and a page that plays it into a folder; needs no network.
    """
    from ..tools.demo import run_demo

    with progress("frames", printed.silent) as advance:
        facts = run_demo(output, advance, body)
    if printed.open and facts["player"]:
        open_page(facts["player"])
    if printed.json:
        print_json(facts)
    elif not printed.quiet:
        seconds = facts["seconds"]["drive"]
        say(f"{facts['motion']}: {facts['frames']} frames moved by {facts['model']} in {seconds:.1f} s")
        say(*facts["files"])
        say(*(f"note: {note}" for note in facts["notes"]))
        if facts["player"]:
            say(f"open {shell_line(facts['player'])} in a browser to see it move, or: mimesh demo --open")
        print_next("transfer", output / "identity.obj", output / "driving.obj")


def models(json: Json = False) -> None:
    """List the models that -m takes, with figures."""
    from ..methods.find import MODELS, NETWORK_OF_BODY, SHIPPED_NETWORKS
    from ..methods.zoo import cards

    shipped = {card["name"]: card for card in cards()}
    if json:
        names = [*MODELS, *(name for name in NETWORK_OF_BODY.values() if name not in MODELS)]
        print_json({"models": [shipped.get(name, {"name": name}) for name in names]})
        return
    for name in MODELS:
        for number, line in enumerate(DESCRIPTIONS[name].splitlines()):
            say(f"{'' if number else name:<22}{line}")
        if name in SHIPPED_NETWORKS:
            say(f"{'':<22}{_describe(shipped[name]) if name in shipped else MISSING}")
    print_next("evaluate", "human-npt", "-m", "mime,npt,copy")


DESCRIPTIONS = {
    "copy": "the driving vertices themselves: no transfer, for comparison",
    "deformation-transfer": "Sumner and Popovic 2004; needs --reference, and --markers where topologies differ",
    "mime": "ours, the default: predicts the joints of both meshes, fits a body to each, and skins the identity;\n"
    "people, and four-legged animals by a second network, mime-quadruped",
    "npt": "Neural Pose Transfer, trained on generated people and poses",
    "npt-maxpool": "its variant with one pose code for the whole driving mesh, of any vertex count",
    "aniformer": "AniFormer: three frames at once, trained on generated people and motions",
}
FIGURES = {"seen": "poses of the papers' tables", "unseen": "new poses"}
"""Kind of pair -> label of its error. Shipped networks have not seen the poses of the papers' tables either."""
MISSING = "its weights are missing here; install mimesh again"


def _describe(card: dict[str, Any]) -> str:
    from ..evaluate.metrics import VERSION

    measured = card.get("metrics", {})
    test = measured.get("test", {}) if measured.get("version") == VERSION else {}
    figures = ", ".join(
        f"{label} {test[f'{kind}_pmd_e4']:.3g}" for kind, label in FIGURES.items() if f"{kind}_pmd_e4" in test
    )
    size = f"{card['bytes'] / 2**20:.1f} MiB, {card['license']}"
    return f"{size}, PMD x1e-4 on new people: {figures}" if figures else size


def doctor(json: Json = False) -> None:
    """Check this installation.

    Versions, shipped files, and one transfer from end to end; exit 0 if all is well, else 1.
    """
    from ..tools.doctor import examine

    checks = examine()
    healthy = all(check.ok for check in checks)
    if json:
        print_json({"ok": healthy, "checks": [vars(check) for check in checks]})
    else:
        for check in checks:
            mark = "FAIL" if not check.ok else "-" if check.optional else "ok"
            say(f"{mark:<4}  {check.name:<20}{check.found}")
        print_next("demo") if healthy else say("next: pip install --force-reinstall mimesh")
    if not healthy:
        raise Stop(1)
