"""Fit the expected error of `mime` to the figures of its confidence, on pairs with a known truth.

`collect` runs mime on pairs of many kinds and writes the figures of both meshes and the error; `fit` finds the
coefficients of `mimesh.rigs.confidence.EXPECTED_ERROR` and says how well they warn.

The logarithm of a pair's error is modelled as linear in a doubt about its worse mesh: the logarithm of the odds that it
is of another kind (`OTHER_KIND`, fitted to other data) and that of its predictions' spread. Weights that are free take
the spread alone: on characters of the training fit and entropy say little, on those of other makers they say most.

    python research/fit_confidence.py collect pairs.json --characters POOL --people FOLDER
    python research/fit_confidence.py fit pairs.json
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from jaxtyping import Float

from mimesh.bodies.character_pool import read_arrays
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.options import MotionOptions
from mimesh.evaluate.characters import ACROSS
from mimesh.evaluate.measure import AXES
from mimesh.evaluate.metrics import mean_error_mm, pmd_public
from mimesh.evaluate.pairs import Pair
from mimesh.evaluate.run import find_protocol
from mimesh.methods.find import find_mime
from mimesh.pipeline.file_rigs import NO_RIGS
from mimesh.pipeline.joint_route import joint_route
from mimesh.pipeline.known import Known
from mimesh.pipeline.result import Timer
from mimesh.rigs.confidence import OTHER_KIND, Confidence

SHIPPED_BODY = ("human-npt", "human-wide", "contact", "noise", "cross-topology")
"""Protocols of the shipped body: COUNT pairs of each kind."""
CHARACTERS = {"train": 36}
"""Pairs of each kind of the pool's splits. How well the result warns is measured on `val` (`mimesh evaluate`)."""
COUNT, PEOPLE = 12, 24
CREATURES, CREATURE_ERROR = "creatures", (500.0, 0.15)
"""Animals and things as identities, and the PMD x1e4 and the error that they count as."""
BAD, GOOD = 50.0, 10.0
"""PMD x1e4 of the public formula above which a result is bad, and below which it is good."""
SPREAD = 1.0
"""Weight of the spread in the doubt. From 0.5 to 2 bad and good results are told apart alike."""
app = typer.Typer(add_completion=False)


@app.command()
def collect(
    output: Path,
    characters: Annotated[Path, typer.Option(help="Pool of rigged characters.")],
    people: Annotated[Path, typer.Option(help="Folder of rigged characters of the protocol cross-body.")],
    model: Annotated[str, typer.Option("-m", help="mime, or an .onnx file.")] = "mime",
) -> None:
    """Run mime on pairs of many kinds; write the error and the confidence of both meshes of each."""
    mime = find_mime(model)
    rows = []
    known = Known(AXES.axes, body="human")  # "auto" refuses what looks like no person; here it is measured
    options = MotionOptions(contacts=False)  # the truth has the driving's rotations
    with typer.progressbar(list(_pairs(characters, people)), label="pairs") as bar:
        for name, make in bar:
            pair = make()
            route = joint_route(pair.identity, Clip.still(pair.driving), mime, known, NO_RIGS)
            found = route.retarget.character.confidence, route.retarget.motion.confidence
            confidences = [confidence for confidence in found if confidence is not None]
            meshes = [dataclasses.asdict(confidence) for confidence in confidences]
            for mesh in meshes:
                del mesh["standards"]  # those of people, all of them
            pmd, error = CREATURE_ERROR
            if name != CREATURES:
                pmd, error = _errors(route.play(Timer(), options).frames.first(), pair)
            rows.append({"kind": name, "pmd_e4": pmd, "error": error, "meshes": meshes})
    output.write_text(json.dumps(rows))


def _errors(result: Float[np.ndarray, "V 3"], pair: Pair) -> tuple[float, float]:
    """Compute the PMD x1e4 of the public formula, and the mean distance in heights of the identity."""
    height = np.ptp(pair.identity.vertices[:, 1])
    return pmd_public(result, pair.truth, pair.metres) * 1e4, mean_error_mm(result, pair.truth, height) / 1700


def _pairs(characters: Path, people: Path) -> Iterator[tuple[str, Callable[[], Pair]]]:
    """List the kind and a function that makes the pair, of all pairs."""
    pool, others = find_protocol("characters", characters), find_protocol("cross-body", people)
    sets = [(find_protocol(name), "val", COUNT) for name in SHIPPED_BODY]
    sets += [(pool, split, count) for split, count in CHARACTERS.items()] + [(others, "val", PEOPLE)]
    for protocol, split, count in sets:
        for kind in (kind for kind in protocol.kinds if not kind.startswith(ACROSS)):
            for i in range(count):
                yield f"{protocol.name} {split} {kind}", lambda p=protocol, s=split, k=kind, i=i: p.pair(s, k, i)
    wide = find_protocol("human-wide")
    rows = json.loads((characters / "index.json").read_text())
    for i, row in enumerate(row for row in rows if row["class"] != "humanoid" and row["split"] == "train"):
        yield CREATURES, lambda i=i, file=row["file"]: _with_creature(wide.pair("val", "clips", i), characters / file)


def _with_creature(pair: Pair, path: Path) -> Pair:
    """Replace the identity of a pair by a creature of the pool, of whose result nothing can be right."""
    arrays = read_arrays(path.with_suffix(".npz"))
    return dataclasses.replace(pair, identity=Mesh(arrays["vertices"].astype(float), arrays["faces"].astype(int)))


@app.command()
def fit(pairs: Path) -> None:
    """Fit the coefficients; print them, and how well they warn."""
    rows = [row for row in json.loads(pairs.read_text()) if len(row["meshes"]) == 2]
    meshes = [[Confidence(**mesh) for mesh in row["meshes"]] for row in rows]
    worse = np.array([max(doubt(mesh) for mesh in pair) for pair in meshes])
    fault = np.array([max(mesh.limb_fault for mesh in pair) for pair in meshes])
    error, pmd = np.array([(row["error"], row["pmd_e4"]) for row in rows]).T
    defined = np.array([row["kind"] != CREATURES for row in rows])
    slope, constant = np.polyfit(worse[defined], np.log(error[defined]), 1)
    weights = {name: slope * value for name, value in (OTHER_KIND | {"spread": SPREAD}).items()}
    weights["constant"] += constant
    print(json.dumps({name: round(value, 3) for name, value in weights.items()}, indent=2))
    expected = np.exp(constant + slope * worse)
    ratio = np.exp(np.quantile(np.abs(np.log(expected / error))[defined], [0.5, 0.9]))
    print(f"expected error within a factor of {ratio[0]:.2f} (half of the pairs), {ratio[1]:.2f} (nine of ten)")
    bad, good = pmd > BAD, pmd < GOOD
    for limit in (0.02, 0.025, 0.03, 0.035, 0.04, 0.042, 0.045, 0.05, 0.06):
        warned = (expected > limit) | (fault > 1)
        print(f"limit {limit}: warned about {warned[bad].sum()} of {bad.sum()} bad results", end=", ")
        print(f"{warned[good].sum()} of {good.sum()} good ones")


def doubt(mesh: Confidence) -> float:
    """Measure how little a mesh looks like what was found in it."""
    return mesh.other_kind + SPREAD * mesh.features()["spread"]


if __name__ == "__main__":
    app()
