"""Fit the expected error of `mime` to the figures of its confidence, on pairs with a known truth.

`collect` runs mime on pairs of many kinds and writes the figures of both meshes and the error; `fit` finds the
coefficients of `mimesh.methods.confidence.EXPECTED_ERROR` and says how well they warn.

The error of a pair is modelled as the sum of the contributions of its two meshes, each exp(constant + coefficients *
features). Coefficients are found by least squares on the logarithm of the sum.

    python scripts/fit_confidence.py collect pairs.json --characters POOL --people FOLDER
    python scripts/fit_confidence.py fit pairs.json
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from mimesh.core.mesh import Clip
from mimesh.evaluate.characters import ACROSS
from mimesh.evaluate.measure import AXES
from mimesh.evaluate.metrics import pmd_of_pair
from mimesh.evaluate.run import find_protocol
from mimesh.methods.find import find_method
from mimesh.pipeline.result import Timer
from mimesh.pipeline.run import MotionOptions, play, prepare

SHIPPED_BODY = ("human-npt", "human-wide", "contact", "dressed", "noise", "cross-topology")
"""Protocols of the shipped body: COUNT pairs of each kind."""
CHARACTERS = {"val": 72, "train": 36}
"""Pairs of each kind of the pool's splits. The network has been trained on `train`, where it errs less: fewer of it."""
COUNT, PEOPLE = 10, 24
app = typer.Typer(add_completion=False)


@app.command()
def collect(
    output: Path,
    characters: Annotated[Path, typer.Option(help="Pool of rigged characters.")],
    people: Annotated[Path, typer.Option(help="Folder of rigged characters of the protocol cross-body.")],
    model: Annotated[str, typer.Option("-m", help="mime, or an .onnx file.")] = "mime",
) -> None:
    """Run mime on pairs of many kinds; write the error and the confidence of both meshes of each."""
    method = find_method(model)
    rows = []
    with typer.progressbar(list(_pairs(characters, people)), label="pairs") as bar:
        for name, make in bar:
            pair = make()
            axes = (AXES["up"], AXES["front"], AXES["driving_up"], AXES["driving_front"])
            prepared = prepare(pair.identity, Clip.still(pair.driving), lambda _: method, axes, False, MotionOptions())
            result = play(prepared, Timer()).vertices[0]
            rows.append(
                {
                    "kind": name,
                    "pmd_e4": pmd_of_pair(result, pair.truth) * 1e4,
                    "meshes": [dataclasses.asdict(confidence) for confidence in prepared.drive.confidence],
                }
            )
    output.write_text(json.dumps(rows))


def _pairs(characters: Path, people: Path) -> Iterator[tuple[str, Any]]:
    """List the kind and a function that makes the pair, of all pairs."""
    pool, others = find_protocol("characters", characters), find_protocol("cross-body", people)
    sets = [(find_protocol(name), "val", COUNT) for name in SHIPPED_BODY]
    sets += [(pool, split, count) for split, count in CHARACTERS.items()] + [(others, "val", PEOPLE)]
    for protocol, split, count in sets:
        for kind in (kind for kind in protocol.kinds if not kind.startswith(ACROSS)):
            for i in range(count):
                yield f"{protocol.name} {split} {kind}", lambda p=protocol, s=split, k=kind, i=i: p.pair(s, k, i)


@app.command()
def fit(pairs: Path) -> None:
    """Fit the coefficients to collected pairs, each kind of pair left out in turn for the figures."""


if __name__ == "__main__":
    app()
