"""Ship a trained checkpoint: export it into the zoo, measure it on `test` and fill its card.

A shipped weight is replaced only by one trained on the same kind of data whose validation figure is lower.

    python scripts/ship_weights.py npt=runs/npt-small-0/best.safetensors npt-maxpool=runs/...  [--report FILE]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from mimesh.evaluate.run import evaluate_command
from mimesh.evaluate.tables import markdown
from mimesh.io.atomic import whole_file
from mimesh.learn import checkpoint
from mimesh.learn.export import export_command
from mimesh.mesh import InputError

ZOO = Path(__file__).parents[1] / "src" / "mimesh" / "zoo"


def main() -> None:
    """Export what improves, then measure everything that is shipped."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", nargs="*", metavar="NAME=CHECKPOINT")
    parser.add_argument("--report", type=Path, help="figures of `mimesh evaluate human-npt` to fill the cards with")
    args = parser.parse_args()
    for entry in args.weights:
        name, _, path = entry.partition("=")
        ship(name, Path(path))
    names = sorted(path.stem for path in ZOO.glob("*.onnx"))
    report = json.loads(args.report.read_text()) if args.report else evaluate_command("human-npt", [*names, "copy"])
    for name in names:
        fill_card(ZOO / f"{name}.json", report)
    print(markdown(report))


def ship(name: str, path: Path) -> None:
    """Export one checkpoint unless what is shipped under that name validates better."""
    state, card, old = checkpoint.load(path), ZOO / f"{name}.json", float("inf")
    new = state.metrics.get("val", float("inf"))
    if card.exists():
        facts = json.loads(card.read_text())
        if facts["config"]["data"]["kind"] != state.config.data.kind:
            raise InputError(f"{path}: expected data {facts['config']['data']['kind']} as shipped, found others")
        old = facts["metrics"]["val"]["val_pmd_e4"]
    if new >= old:
        print(f"{name}: kept, {old:.2f}e-4 on val against {new:.2f}e-4 of {path}")
        return
    print(f"{name}: {old:.2f}e-4 on val before, {new:.2f}e-4 now")
    export_command(path, ZOO / f"{name}.onnx")


def fill_card(card: Path, report: dict) -> None:
    """Write the test figures of a model, and of `copy` in the same run, into its card."""
    rows = {(row["method"], row["split"]): row["pmd_e4"] for row in report["results"]}
    facts = json.loads(card.read_text())
    facts["metrics"]["test"] = {
        f"{prefix}{split}_pmd_e4": rows[method, split]
        for prefix, method in (("", card.stem), ("copy_", "copy"))
        for split in ("seen", "unseen")
    }
    with whole_file(card) as temporary:
        temporary.write_text(json.dumps(facts, indent=2) + "\n")


if __name__ == "__main__":
    main()
