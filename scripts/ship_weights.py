"""Export trained checkpoints into the zoo, and write the measured errors of docs/results into the cards.

Shipped weights are replaced only by weights that were trained on the same kind of data and have a lower validation
error. If other settings of the data differ, or the version of the metrics, the stored validation errors cannot be
compared; then both networks are measured (mime with its body fit) on the split `val` of all kinds of pair.

    python scripts/ship_weights.py npt=runs/npt-small-0/best.safetensors aniformer=runs/aniformer-small-0/...
    python scripts/measure_all.py human-npt clips-aniformer
    python scripts/ship_weights.py

The network of fingers is no checkpoint but what research/recipes/train_hands.py has written, with its card:

    python scripts/ship_weights.py hands=hands.onnx
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import write_results
from write_results import read_reports

from mimesh.core.errors import InputError
from mimesh.evaluate.measure import measure
from mimesh.evaluate.metrics import VERSION
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.evaluate.run import fingerprint
from mimesh.io.atomic import together, whole_file
from mimesh.learn import checkpoint
from mimesh.learn.config import recorded_config
from mimesh.learn.export import export_command, test_set

ALL_KINDS = tuple((name, kind) for name, protocol in PROTOCOLS.items() for kind in protocol.kinds)
"""Protocol and kind of all pairs of meshes."""
PAIRS = 8
"""Number of pairs of each kind."""
ZOO = Path(__file__).parents[1] / "src" / "mimesh" / "methods" / "zoo"


def main() -> None:
    """Export the given checkpoints if they are better, then update the cards."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", nargs="*", metavar="NAME=CHECKPOINT")
    args = parser.parse_args()
    for entry in args.weights:
        name, _, path = entry.partition("=")
        if name == "hands":
            ship_hands(Path(path))
        else:
            ship(name, Path(path))
    for path in sorted(ZOO.glob("*.onnx")):
        facts = json.loads(path.with_suffix(".json").read_text())
        if facts["config"].get("network") == "hands":
            continue  # no method of its own: its figures are those of `mime` on fingers
        protocol = test_set(facts)
        reports = read_reports(write_results.RESULTS)
        rows = [row for report in reports.values() if report["protocol"] == protocol for row in report["results"]]
        if not fill_card(path, rows):
            print(f"{path.stem}: not measured yet on {protocol}; its card holds no test figures")


def ship(name: str, path: Path) -> None:
    """Export one checkpoint, unless the shipped weights of that name have a lower validation error.

    Raises:
        InputError: the shipped weights were trained on another kind of data.
    """
    state, card, old = checkpoint.load(path), ZOO / f"{name}.json", float("inf")
    new = state.metrics.get("val", float("inf"))
    if card.exists():
        facts = json.loads(card.read_text())
        shipped = recorded_config(facts["config"], str(card))
        if shipped.data.kind != state.config.data.kind:
            raise InputError(f"{path}: expected data {shipped.data.kind} as shipped, found others")
        stored = facts["metrics"]
        old = stored["val"].get("val_pmd_e4", old)
        if not state.metrics or stored.get("version") != VERSION or shipped.data != state.config.data:
            with tempfile.TemporaryDirectory() as folder:
                exported = Path(folder) / f"{name}.onnx"
                export_command(path, exported)
                old, new = (mean_val_error(str(weights)) for weights in (ZOO / exported.name, exported))
    if new >= old:
        print(f"{name}: kept, {old:.2f}e-4 on val against {new:.2f}e-4 of {path}")
        return
    print(f"{name}: {old:.2f}e-4 on val before, {new:.2f}e-4 now")
    export_command(path, ZOO / f"{name}.onnx")


def ship_hands(path: Path) -> None:
    """Copy a network of fingers and its card into the zoo, unless the shipped one has a lower error on unseen people.

    Raises:
        InputError: there is no card beside it with that error.
    """
    try:
        cards = [json.loads(folder.with_suffix(".json").read_text()) for folder in (ZOO / "hands.onnx", path)]
        old, new = (card["metrics"]["val"]["unseen_pmd_e4"] for card in cards)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected a network and its card of train_hands.py, found none; train one") from error
    if new >= old:
        print(f"hands: kept, {old:.2f}e-4 on unseen people against {new:.2f}e-4 of {path}")
        return
    print(f"hands: {old:.2f}e-4 on unseen people before, {new:.2f}e-4 now")
    card = json.dumps({**cards[1], "name": "hands", "file": "hands.onnx"}, indent=2) + "\n"
    with together():
        for suffix, content in ((".onnx", path.read_bytes()), (".json", card.encode())):
            with whole_file(ZOO / f"hands{suffix}") as temporary:
                temporary.write_bytes(content)


def mean_val_error(weights: str) -> float:
    """Return the mean PMD x1e4 on the split `val` over ALL_KINDS."""
    errors = [
        measure(PROTOCOLS[protocol].pair("val", kind, i), weights)["pmd_e4"]
        for protocol, kind in ALL_KINDS
        for i in range(PAIRS)
    ]
    return sum(errors) / len(errors)


def fill_card(weights: Path, measured_rows: list[dict]) -> bool:
    """Write the test errors of weights, and of `copy` on the same pairs, into their card; False if there are none.

    Rows of the reports that were measured with other weights of the same name are not used.
    """
    rows = {(row["method"], row["split"]): row for row in measured_rows}
    measured = rows.get((weights.stem, "unseen"), {}).get("weights") == fingerprint(str(weights))
    card = weights.with_suffix(".json")
    facts = json.loads(card.read_text())
    val = facts["metrics"]["val"] if facts["metrics"].get("version") == VERSION else {}
    test = {
        f"{prefix}{split}_pmd_e4": rows[method, split]["pmd_e4"]
        for prefix, method in (("", weights.stem), ("copy_", "copy"))
        for split in ("seen", "unseen")
        if measured
    }
    facts["metrics"] = {"version": VERSION, "val": val, "test": test}
    with whole_file(card) as temporary:
        temporary.write_text(json.dumps(facts, indent=2) + "\n")
    return measured


if __name__ == "__main__":
    main()
