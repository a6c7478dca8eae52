"""What pages take from the code, from measured figures and from transcripts while the site is built.

`<!-- insert: WHAT [NAME] -->` in a page becomes Markdown before it is read, so nothing of it is typed and nothing can
go stale. In the repository it shows as nothing, beside a link or a sentence that says where to look.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from commands import command_reference

from mimesh.commands.about import WHAT
from mimesh.evaluate.tables import markdown_table, paper_table
from mimesh.methods.find import MODELS, SHIPPED_NETWORKS
from mimesh.zoo import cards

DOCS = Path(__file__).parents[1]
MARK = re.compile(r"<!-- insert: ([a-z]+)(?: ([\w-]+))? -->")
DRAWN = re.compile(r"!\[([^\]]*)\]\(images/([\w-]+)\.svg\)")
OUTSIDE = re.compile(r"\[([^\]]+)\]\((?:\.\./[^)]*|results/?)\)")
"""Links that work in the repository and lead out of the site."""


def setup(app):
    """Fill the marks of every page."""
    app.connect("source-read", lambda app, page, source: source.__setitem__(0, filled(source[0])))
    return {"parallel_read_safe": True}


def filled(text: str) -> str:
    """A page with its marks replaced, without links that lead out of the site, and with its SVG put into it.

    A drawing inside the page has the theme's colours.

    Raises:
        KeyError: nothing goes by the name of a mark.
    """
    text = OUTSIDE.sub(r"\1", text)
    text = DRAWN.sub(lambda mark: _drawing(mark[2]), text)
    return MARK.sub(lambda mark: INSERTS[mark[1]](*filter(None, [mark[2]])), text)


def _drawing(name: str) -> str:
    return f'<div class="drawn">\n{(DOCS / "images" / f"{name}.svg").read_text()}</div>\n'


def models() -> str:
    """One row for each model that -m takes."""
    rows = []
    for name in MODELS:
        row = _report_row(name, "unseen")
        pmd = f"{_figure(row['pmd_e4'])}\N{NO-BREAK SPACE}({_figure(row['pmd_e4_median'])})"
        rows.append([f"[`{name}`](#{name})", WHAT[name], pmd, f"{_figure(row['mm'])}\N{NO-BREAK SPACE}mm"])
    return markdown_table(["`-m`", "what it is", "PMD ×1e-4: mean (median)", "distance"], rows)


def _report_row(name: str, kind: str) -> dict:
    """The measured figures of a model on new people: of poses, or of clips for aniformer."""
    protocol = "clips-aniformer" if name == "aniformer" else "human-npt"
    method = {"deformation-transfer": "deformation-transfer-13"}.get(name, name)
    for path in sorted((DOCS / "results").glob("*.json")):
        report = json.loads(path.read_text())
        for row in report["results"]:
            if (report["protocol"], row["method"], row["split"]) == (protocol, method, kind):
                return row
    raise KeyError(name)


def card(name: str) -> str:
    """The card of shipped weights as a table."""
    assert name in SHIPPED_NETWORKS
    found = next(card for card in cards() if card["name"] == name)
    before = found.get("before", [])
    minutes = sum(run["seconds_trained"] for run in (*before, found)) / 60
    pairs = sum(run["pairs"] for run in (*before, found))
    seen, unseen = (_report_row(name, kind) for kind in ("seen", "unseen"))
    copied = found["metrics"]["test"]
    stages = f" in {len(before) + 1} stages; the card has the configuration of the last one only" if before else ""
    dirty = " (a working tree with uncommitted changes)" if found["commit"].endswith("-dirty") else ""
    rows = [
        ["licence", found["license"]],
        ["trained on", found["data"]],
        ["training", f"{minutes:.0f} minutes, {found['hardware']}; {pairs:,} pairs{stages}"],
        ["commit", f"`{found['commit']}`{dirty}, seed {found['seed']}"],
        ["PMD ×1e-4 on new people, seen / unseen", _both(seen["pmd_e4"], unseen["pmd_e4"])],
        ["its median", _both(seen["pmd_e4_median"], unseen["pmd_e4_median"])],
        ["distance, for a person of 1.7 m", f"{_both(seen['mm'], unseen['mm'])} mm"],
        ["PMD of `copy` on the same", _both(copied["copy_seen_pmd_e4"], copied["copy_unseen_pmd_e4"])],
        ["file", f"`{found['file']}`, {found['bytes'] / 2**20:.1f} MiB"],
    ]
    return markdown_table(["card", ""], rows)


def table(name: str) -> str:
    """A table of a paper, its figures beside ours, from the reports in docs/results."""
    reports = [json.loads(path.read_text()) for path in sorted((DOCS / "results").glob("*.json"))]
    return paper_table(name, *reports)


def speed() -> str:
    """Times per frame, from benchmarks/mime.json."""
    found = json.loads((DOCS.parent / "benchmarks" / "mime.json").read_text())
    counts = [key for key in found if key.isdigit()]
    lines = {
        "prepare, for a pose": "prepare_pose_ms",
        "prepare, for a clip": "prepare_clip_ms",
        "a frame of `mime`": "frame_ms",
        "plain skinning, for comparison": "plain_skinning_ms",
        "a frame of `npt`": "npt_ms_a_frame",
        "a frame of `npt-maxpool`": "npt-maxpool_ms_a_frame",
        "a frame of `aniformer`": "aniformer_ms_a_frame",
    }
    rows = [[label, *(_ms(found[count].get(key)) for count in counts)] for label, key in lines.items()]
    head = ["", *(f"{int(count):,} vertices" for count in counts)]
    return f"{markdown_table(head, rows)}\n\nMeasured at commit {found['commit']}, {found['machine']}."


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{_figure(value)} ms"


def _both(seen: float, unseen: float) -> str:
    return f"{_figure(seen)} / {_figure(unseen)}"


def _figure(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def transcript(name: str) -> str:
    """Commands and their output."""
    said = json.loads((DOCS / "transcripts.json").read_text())[name]
    lines = "\n\n".join(f"$ {command}\n{output}" for command, output in said)
    return f"```console\n{lines}\n```"


def notes(name: str, which: str = "notes") -> str:
    """The notes that mimesh printed for a picture of the troubleshooting page."""
    found = json.loads((DOCS / "trouble.json").read_text())[name].get(which, [])
    return "\n".join(f"> note: {note}" for note in found) or "> mimesh prints no note here."


def helped(name: str) -> str:
    """The notes that it printed with the remedy applied."""
    return notes(name, "helped")


def minute() -> str:
    """The time from `git clone` to the demo in the browser."""
    found = json.loads((DOCS.parent / "benchmarks" / "first_minute.json").read_text(encoding="utf-8"))
    return (
        f"From `git clone` to the animation in {found['browser'].split()[0]}: {found['seconds']['all']:.0f} s on two "
        f"cores with all downloads, of which the installation takes {found['seconds']['install']:.0f} s "
        "(`benchmarks/first_minute.py`)."
    )


INSERTS = {
    "minute": minute,
    "models": models,
    "card": card,
    "table": table,
    "speed": speed,
    "transcript": transcript,
    "notes": notes,
    "helped": helped,
    "commands": command_reference,
}
