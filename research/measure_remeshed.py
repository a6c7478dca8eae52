"""Measure the joints found on characters of a pool that were remeshed as image-to-mesh models make meshes.

    pip install scikit-image trimesh
    python research/measure_remeshed.py POOL [-o benchmarks/remeshed.json] [--files FOLDER]

Each character becomes one closed surface of marching cubes over a blurred grid of 180 to 420 cells: fingers fuse,
clothes grow to legs, some surfaces are rough; 55,000 to 550,000 triangles, without names, axes or rig. Figures are the
mean distance of joints of limbs, neck and head from the maker's (percent of the height) of the remeshed character and
of the maker's mesh, both found without any hint.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy import ndimage
from skimage.measure import marching_cubes

from mimesh import InputError, Mesh, rig, save_mesh
from mimesh.evaluate.rigs import ListedRig, RigTrial, joint_errors, mean_of_compared, rigs
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file

COUNTS = {"val": 12, "train": 8}
"""Characters of each split, evenly spread over it."""
SHELL = 3
"""Cells by which a surface is thickened before it is filled, so that necks and hems of open meshes close."""
SMALL = 200
"""Faces of a separate piece up to which it is left out."""


def main() -> None:
    """Print and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/remeshed.json"))
    parser.add_argument("--files", type=Path, help="also keep the meshes as .ply files here")
    args = parser.parse_args()
    protocol, rng = rigs(args.pool), np.random.default_rng(7)
    chosen = [
        (split, int(i))
        for split, count in COUNTS.items()
        for i in np.linspace(0, protocol.count("people", split=split) - 1, count)
    ]
    rows = []
    for split, i in chosen:
        trial = protocol.pair(split, "people", i)
        mesh, facts = remeshed(trial.identity, rng)
        if args.files:
            args.files.mkdir(parents=True, exist_ok=True)
            save_mesh(mesh, args.files / f"{mesh.name}.ply")
        rows.append({"file": mesh.name, "split": split} | facts | measured(trial, mesh))
        print(json.dumps(rows[-1]), flush=True)
    report = {"provenance": provenance({"counts": COUNTS, "seed": 7}), "characters": rows}
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def remeshed(mesh: Mesh, rng: np.random.Generator) -> tuple[Mesh, dict[str, Any]]:
    """Make one closed surface of a mesh; return what was drawn for it, too."""
    cells, close = int(rng.choice([180, 240, 320, 420])), int(rng.choice([0, 2, 4, 6]))
    blur, noise = float(rng.uniform(0.8, 2.2)), float(rng.choice([0, 0.02, 0.05]))
    pitch = float(np.ptp(mesh.vertices, axis=0).max()) / cells
    grid = trimesh.voxel.creation.voxelize(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), pitch)
    pad = close + SHELL + 1
    solid = np.pad(grid.matrix, pad)
    if close:
        solid = ndimage.binary_closing(solid, ndimage.generate_binary_structure(3, 2), iterations=close)
    solid = ndimage.binary_fill_holes(solid)
    shell = ndimage.binary_fill_holes(ndimage.binary_dilation(solid, iterations=SHELL))
    solid |= ndimage.binary_erosion(shell, iterations=SHELL + 1)
    field = ndimage.gaussian_filter(solid.astype(np.float32), blur)
    if noise:
        field += 10 * noise * ndimage.gaussian_filter(rng.normal(size=field.shape).astype(np.float32), 2)
    vertices, faces, _, _ = marching_cubes(field, 0.5)
    surface = trimesh.Trimesh((vertices - pad) * pitch + grid.transform[:3, 3], faces[:, ::-1], process=False)
    if surface.volume < 0:
        surface.invert()
    pieces = [piece for piece in surface.split(only_watertight=False) if len(piece.faces) > SMALL]
    whole = trimesh.util.concatenate(pieces)
    facts = {"cells": cells, "close": close, "blur": round(blur, 2), "noise": noise, "faces": len(whole.faces)}
    return Mesh(np.array(whole.vertices), np.array(whole.faces), name=mesh.name), facts


def measured(trial: RigTrial, mesh: Mesh) -> dict[str, Any]:
    """Find the joints of a character's two meshes and compare them with the maker's."""
    truth = ListedRig.of_maker(trial.character)
    figures: dict[str, Any] = {}
    for key, given in (("remeshed", mesh), ("maker", trial.identity)):
        started = time.perf_counter()
        try:
            rigged = rig(given)
        except InputError as error:
            figures[key] = {"refused": str(error)}
            continue
        errors = joint_errors(ListedRig.found(rigged.skeleton), truth, trial.height)
        figures[key] = {
            "joints_pct": round(mean_of_compared(errors), 2),
            "seconds": round(time.perf_counter() - started, 1),
            "notes": list(rigged.notes),
        }
    return figures


if __name__ == "__main__":
    main()
