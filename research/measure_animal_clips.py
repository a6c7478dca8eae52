"""Measure the clips of shipped animals in gaits, and whether tails that hang between the hind legs keep their weights.

    python research/measure_animal_clips.py [-o benchmarks/animal_clips.json]

Gaits: for which share of the time no foot is on the ground (lower than AIR of the height), how fast feet slide that
should stand, in heights and in paths of the animal, how high these are, and by how many degrees the path leaves the
direction in which the animal faces. Tails: of the vertices that are a tail's, on meshes with triangles of their own,
how many `mime` gives mostly to joints of the tail, with and without `with_whole_tail`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy.spatial import KDTree

from mimesh import transfer
from mimesh.bodies import load_body
from mimesh.bodies.animals import ANIMALS, animal, animal_body, standing
from mimesh.core.mesh import Mesh
from mimesh.core.options import Hints
from mimesh.core.rig import descendants
from mimesh.evaluate import remesh
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file
from mimesh.mime.kept_results import keep_results
from mimesh.motions.animal_clips import ANIMAL_MOTIONS, RUNS, random_style, run
from mimesh.motions.gaits import LEGS

RATE, CYCLES = 240.0, 2
AIR = 0.005
ENDS = {"Hind": "Toes", "Front": "Fingers"}
FACES = {"cow": 6000, "cat": 5000, "dog": 4000, "horse": 5500, "rhino": 7000}
"""Animal -> triangles of the mesh whose tail is looked at; 6,000 for all others."""


def main() -> None:
    """Print and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/animal_clips.json"))
    args = parser.parse_args()
    gaits = {name: gait_figures(*motion) for name, motion in ANIMAL_MOTIONS.items() if motion[1] in RUNS}
    for name, figures in gaits.items():
        print(name, figures, flush=True)
    tails = {}
    keep_results(False)  # the same mesh is read twice
    for name in ANIMALS:
        tails[name] = tail_shares(name)
        print(f"tail of the {name}", tails[name], flush=True)
    report = {"provenance": provenance({}), "gaits": gaits, "tails": tails}
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def gait_figures(species: str, gait: str, index: int) -> dict[str, float]:
    """Measure two cycles of a gait."""
    body, stand, style = animal_body(species), standing(animal_body(species), species), random_style(gait, index)
    cycle = style.start + np.arange(0, CYCLES, style.pace / RATE)
    rotmat, root = run(body, RUNS[gait], style, stand, cycle)
    vertices, rest = body.posed(np.zeros(0), rotmat, root), body.posed(np.zeros(0), stand)
    feet = []
    for leg in LEGS:
        kind = "Hind" if leg.endswith("Hind") else "Front"
        joints = descendants([body.joint(leg.removesuffix(kind) + ENDS[kind])], body.parents)
        foot = np.flatnonzero(body.weights[:, joints].sum(axis=1) > 0.5)
        place = vertices[:, foot[rest[foot, 1].argsort()[: len(foot) // 10]]].mean(axis=1)
        place[:, 1] = vertices[:, foot, 1].min(axis=1)
        feet.append(place)
    height = float(np.ptp(rest[:, 1]))
    points, stands = np.stack(feet, axis=1) / height, (cycle[:, None] - RUNS[gait].phases) % 1.0 < RUNS[gait].duty
    slide = np.linalg.norm(np.diff(points[..., [0, 2]], axis=0), axis=-1)[stands[1:] & stands[:-1]].mean() * RATE
    x, _, z = root[-1] - root[0]
    speed = float(np.hypot(x, z)) / height / (len(root) - 1) * RATE
    return {
        "cycles_per_second": round(style.pace, 3),
        "metres_per_second": round(speed * height * ANIMALS[species].size, 3),
        "in_air": round(float((points[..., 1].min(axis=1) > AIR).mean()), 3),
        "slide_heights_per_second": round(float(slide), 4),
        "slide_over_path": round(float(slide) / speed, 4),
        "mean_height_of_standing_feet": round(float(points[..., 1][stands].mean()), 4),
        "lowest_foot": round(float(points[..., 1].min()), 4),
        "heading_degrees": round(float(np.degrees(np.arctan2(x, z))), 3),
    }


def tail_shares(species: str) -> dict[str, float]:
    """Measure the share of a tail's vertices that are given mostly to the tail."""
    body, shape = load_body("quadruped"), animal(species)
    meshing = remesh.simplified(animal_body(species), FACES.get(species, 6000))
    mesh = Mesh(meshing.positions(shape.vertices), meshing.faces, name=shape.name)
    nearest = np.asarray(KDTree(shape.vertices).query(mesh.vertices)[1])
    tail = descendants([body.joint("Tail1")], body.parents)
    own = body.weights[nearest][:, tail].sum(axis=1) > 0.5
    driving = Mesh(body.vertices, body.faces, name="quadruped", up="+y")
    shares = {}
    for key, replaced in (("without", lambda weights, *_: weights), ("with", None)):
        if replaced is None:
            result = transfer(
                Mesh(mesh.vertices, mesh.faces, name=key, up="+y"), driving, hints=Hints(body="quadruped")
            )
        else:
            with patch("mimesh.mime.model.with_whole_tail", replaced):
                result = transfer(
                    Mesh(mesh.vertices, mesh.faces, name=key, up="+y"), driving, hints=Hints(body="quadruped")
                )
        assert result.skeleton is not None
        columns = [result.skeleton.names.index(body.joint_names[j]) for j in tail]
        shares[key] = round(float((result.skeleton.rig.weights[own][:, columns].sum(axis=1) > 0.5).mean()), 3)
    return shares


if __name__ == "__main__":
    main()
