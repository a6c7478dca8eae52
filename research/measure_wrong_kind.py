"""Measure how well a fit tells people and four-legged animals from other creatures and things, given without rigs.

    python research/measure_wrong_kind.py collect rows.jsonl POOL [--axes none]
    python research/measure_wrong_kind.py fit rows.jsonl [-o benchmarks/wrong_kind.json]

`collect` shows the pool's characters and the things of `wrong_kind_meshes.py` to `mime`, and appends a line of figures
for each; it goes on where it was stopped. Characters are those of the splits train and val, at rest and in a frame of a
clip, animals of two; of each pack of people of `train` the first 8. `fit` finds the coefficients of
`mimesh.rigs.confidence.OTHER_KIND` by logistic regression, with equal weight of right and wrong kinds, and says how
often the shipped ones give a note. Each pack is left out in turn to compare sets of figures.
"""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from jaxtyping import Bool, Float
from measure_body_choice import shown
from scipy.optimize import minimize
from wrong_kind_meshes import further_things, things

from mimesh.bodies.character_pool import read_pool
from mimesh.core.mesh import Mesh
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file
from mimesh.methods.find import NETWORK_OF_BODY, find_mime
from mimesh.mime.model import Mime
from mimesh.pipeline.look import (
    FITS,
    Subject,
    fitting_body,
    look,
    predicted_body,
    same_after_half_turn,
)
from mimesh.rigs.confidence import HUMAN_STANDARDS, MAX_OTHER_KIND, QUADRUPED_STANDARDS, Confidence

PER_PACK = 8
"""Most people of a pack of the split `train`."""
RIDGE = 0.02
"""Weight of the coefficients' squares beside one mesh."""
FEATURES = (("entropy", "fit_distance"), ("spread", "entropy", "fit_distance"), ("spread",), ("entropy",))
"""Sets of figures that are compared; the first is used."""
app = typer.Typer(add_completion=False)


class Shown(NamedTuple):
    """A mesh, and what it is."""

    kind: str
    """human, quadruped, other (a creature) or thing."""
    split: str
    pack: str
    mesh: Mesh


@app.command()
def collect(
    rows: Path,
    pool: Path,
    axes: Annotated[str, typer.Option(help="up: y up is known; none: no axis is.")] = "none",
) -> None:
    """Append the figures of each mesh that has no line yet."""
    mime = find_mime("mime")
    up = "+y" if axes == "up" else None
    lines = rows.read_text().splitlines() if rows.exists() else []
    done = {(row["mesh"], row["up"]) for row in map(json.loads, lines)}
    with rows.open("a") as file:
        for kind, split, pack, mesh in meshes(pool):
            if (mesh.name, up) not in done:
                about = {"kind": kind, "split": split, "pack": pack, "mesh": mesh.name, "up": up}
                file.write(json.dumps(about | figures(mime, dataclasses.replace(mesh, up=up))) + "\n")
                file.flush()


def meshes(pool: Path) -> Iterator[Shown]:
    """List all meshes."""
    for split in ("val", "train"):
        for body in (*NETWORK_OF_BODY, "other"):
            times: Counter[str] = Counter()
            for character in read_pool(pool, split, body=body).characters:
                times[character.meta.pack] += 1
                if not (body == "human" and split == "train" and times[character.meta.pack] > PER_PACK):
                    for mesh in shown(character, np.random.default_rng(0))[: 3 if body == "quadruped" else 2]:
                        yield Shown(body, split, character.meta.pack, mesh)
    yield from (Shown("thing", "made", "made", mesh) for mesh in [*things(), *further_things()])


def figures(mime: Mime, mesh: Mesh) -> dict[str, Any]:
    """Say what a mesh is taken for, and the confidence of the fits: of that body, and of the other one if it is low."""
    taken = look(mime, Subject(mesh, (None, None)), None, quick=True).body
    row: dict[str, Any] = {"taken": taken, "same_after_half_turn": same_after_half_turn(mesh)}
    for body in sorted(NETWORK_OF_BODY, key=lambda body: body != taken):
        doubt = body != taken and (read(row, taken).misfit > FITS or read(row, taken).uncertainty > 1)
        if body == taken or doubt or row["same_after_half_turn"]:
            row[body] = dataclasses.asdict(predicted_body(mime.of_body(body), mesh, (None, None))[2])
            del row[body]["standards"]
    return row


def read(row: dict[str, Any], body: str) -> Confidence:
    """Read the confidence of a body's fit from a line."""
    names = {field.name for field in dataclasses.fields(Confidence)}
    standards = QUADRUPED_STANDARDS if body == "quadruped" else HUMAN_STANDARDS
    given = {name: value for name, value in row[body].items() if name in names}
    return Confidence(**given, standards=standards)


@app.command()
def fit(rows: Path, output: Annotated[Path, typer.Option("-o")] = Path("benchmarks/wrong_kind.json")) -> None:
    """Fit the coefficients; print and write them, and how often there is a note."""
    lines = [json.loads(line) for line in rows.read_text().splitlines()]
    fits = [(row, body) for row in lines for body in NETWORK_OF_BODY if body in row]
    wrong = np.array([row["kind"] != body for row, body in fits])
    packs = np.array([row["pack"] for row, _ in fits])
    sets = []
    for names in FEATURES:
        values = np.array([[1.0, *(read(*of).features()[name] for name in names)] for of in fits])
        left_out = np.concatenate(
            [values[packs == p] @ fitted(values[packs != p], wrong[packs != p]) for p in set(packs)]
        )
        order = np.concatenate([np.flatnonzero(packs == p) for p in set(packs)])
        right, other = left_out[~wrong[order]], left_out[wrong[order]]
        above = float((other > np.quantile(right, 0.98)).mean())
        found = dict(zip(["constant", *names], fitted(values, wrong).round(2).tolist(), strict=True))
        sets.append({"coefficients": found, "wrong_above_98_percent_of_right": round(above, 3)})
        print(sets[-1])
    report = {"provenance": provenance({"per_pack": PER_PACK, "ridge": RIDGE}), "sets": sets, "notes": counts(lines)}
    report["meshes"] = [compact(row) for row in lines]
    with whole_file(output) as temporary:
        temporary.write_text(json.dumps(report, indent=1).replace("\n   ", " ") + "\n")


def fitted(values: Float[np.ndarray, "N F"], wrong: Bool[np.ndarray, " N"]) -> Float[np.ndarray, " F"]:
    """Fit a logistic regression; right and wrong kinds count alike."""
    weight = np.where(wrong, 0.5 / wrong.mean(), 0.5 / (1 - wrong.mean()))
    sign = np.where(wrong, -1.0, 1.0)

    def loss(c: np.ndarray) -> float:
        return float((weight * np.logaddexp(0, sign * (values @ c))).sum() + RIDGE * np.square(c[1:]).sum())

    return minimize(loss, np.zeros(values.shape[1])).x


def decided(row: dict[str, Any]) -> str | None:
    """Say what a mesh is after the second look, from the same fits; None: of neither kind."""
    fits = {body: read(row, body) for body in (row["taken"], *NETWORK_OF_BODY) if body in row}
    surely = fits[row["taken"]].misfit <= FITS and not row["same_after_half_turn"]
    return row["taken"] if surely else fitting_body(row["taken"], fits, row["same_after_half_turn"])


def compact(row: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a mesh that are stored."""
    own = read(row, row["taken"])
    about = {name: row[name] for name in ("kind", "split", "mesh", "up", "taken")}
    facts = {"decided": decided(row), "misfit": round(own.misfit, 2), "expected": round(own.expected_error, 3)}
    return about | facts | {"note": own.uncertainty > 1}


def counts(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Count for each kind and split how often a mesh is taken for each body, looks like none, and has a note."""
    table = []
    groups = sorted({(row["kind"], row["split"], row["up"]) for row in lines}, key=str)
    for kind, split, up in groups:
        of = [row for row in lines if (row["kind"], row["split"], row["up"]) == (kind, split, up)]
        first, last = Counter(row["taken"] for row in of), Counter(decided(row) or "neither" for row in of)
        noted = sum(read(row, row["taken"]).uncertainty > 1 for row in of)
        table.append({"kind": kind, "split": split, "up": up, "meshes": len(of), "first": dict(first),
                      "second": dict(last), "any_note": noted})  # fmt: skip
        print(table[-1])
    scores = [read(row, "human").other_kind for row in lines if row["kind"] == row["taken"] == "human"
              and row["split"] == "val"]  # fmt: skip
    print(f"people of val above {MAX_OTHER_KIND}: {sum(s > MAX_OTHER_KIND for s in scores)} of {len(scores)}")
    return table


if __name__ == "__main__":
    app()
