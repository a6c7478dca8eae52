"""Ship a trained checkpoint: export it into the zoo, and fill the cards with what was measured in docs/results.

A shipped weight is replaced only by one trained on the same kind of data whose validation figure is lower. Where the
data differ otherwise, so do the figures: then both are run (mime with its fit) on the split `val` of all kinds of pair.

    python scripts/ship_weights.py npt=runs/npt-small-0/best.safetensors aniformer=runs/aniformer-small-0/...
    python scripts/measure_all.py human-npt clips-aniformer --clips DIR
    python scripts/ship_weights.py
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import write_results

from mimesh.core.errors import InputError
from mimesh.evaluate.measure import measure
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.evaluate.run import fingerprint
from mimesh.io.atomic import whole_file
from mimesh.learn import checkpoint
from mimesh.learn.body_sampler import DataConfig
from mimesh.learn.export import export_command, test_set

COMMON = tuple((name, kind) for name, protocol in PROTOCOLS.items() for kind in protocol.kinds)
PAIRS = 8
"""Of each of COMMON."""
ZOO = Path(__file__).parents[1] / "src" / "mimesh" / "zoo"


def main() -> None:
    """Export what improves; then each card takes the figures of its own weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", nargs="*", metavar="NAME=CHECKPOINT")
    args = parser.parse_args()
    for entry in args.weights:
        name, _, path = entry.partition("=")
        ship(name, Path(path))
    for path in sorted(ZOO.glob("*.onnx")):
        protocol = test_set(json.loads(path.with_suffix(".json").read_text()))
        reports = [json.loads(file.read_text()) for file in sorted(write_results.RESULTS.glob("*.json"))]
        rows = [row for report in reports if report["protocol"] == protocol for row in report["results"]]
        if not fill_card(path, rows):
            print(f"{path.stem}: not measured yet on {protocol}; its card holds no test figures")


def ship(name: str, path: Path) -> None:
    """Export one checkpoint unless what is shipped under that name validates better."""
    state, card, old = checkpoint.load(path), ZOO / f"{name}.json", float("inf")
    new = state.metrics.get("val", float("inf"))
    if card.exists():
        facts = json.loads(card.read_text())
        data = facts["config"]["data"]
        if data["kind"] != state.config.data.kind:
            raise InputError(f"{path}: expected data {data['kind']} as shipped, found others")
        old = facts["metrics"]["val"]["val_pmd_e4"]
        if DataConfig(**data) != state.config.data:
            with tempfile.TemporaryDirectory() as folder:
                exported = Path(folder) / f"{name}.onnx"
                export_command(path, exported)
                old, new = (on_common(str(weights)) for weights in (ZOO / exported.name, exported))
    if new >= old:
        print(f"{name}: kept, {old:.2f}e-4 on val against {new:.2f}e-4 of {path}")
        return
    print(f"{name}: {old:.2f}e-4 on val before, {new:.2f}e-4 now")
    export_command(path, ZOO / f"{name}.onnx")


def on_common(weights: str) -> float:
    """Mean over COMMON of the mean PMD x1e4 on `val`."""
    figures = [
        measure(PROTOCOLS[protocol].pair("val", kind, i), weights)["pmd_e4"]
        for protocol, kind in COMMON
        for i in range(PAIRS)
    ]
    return sum(figures) / len(figures)


def fill_card(weights: Path, measured_rows: list[dict]) -> bool:
    """Write the test figures of these weights, and of `copy` on the same pairs, into their card; False if none."""
    rows = {(row["method"], row["split"]): row for row in measured_rows}
    mine = rows.get((weights.stem, "unseen"), {})
    measured = mine.get("weights") == fingerprint(str(weights))
    card = weights.with_suffix(".json")
    facts = json.loads(card.read_text())
    facts["metrics"]["test"] = {
        f"{prefix}{split}_pmd_e4": rows[method, split]["pmd_e4"]
        for prefix, method in (("", weights.stem), ("copy_", "copy"))
        for split in ("seen", "unseen")
        if measured
    }
    with whole_file(card) as temporary:
        temporary.write_text(json.dumps(facts, indent=2) + "\n")
    return measured


if __name__ == "__main__":
    main()
