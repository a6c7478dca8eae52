"""Measure how far a result moves when the identity or the driving is turned about the vertical.

    python research/measure_headings.py POOL [--split val] [--pairs 40] [--body human] [-o benchmarks/headings.json]

Pairs of rigged characters of a pool: one at rest as the identity, another in a frame of its clips as the driving, both
without their rigs, with known up. Each is turned by every angle of ANGLES; the result is turned back by it (of the
driving) and by the right angles between the fronts that were found, and compared with that of the meshes as they were.
Distances are in percent of the longest side of the result.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mimesh import transfer
from mimesh.bodies.character_pool import PoolCharacter, read_pool
from mimesh.core.geometry import turned
from mimesh.core.mesh import Mesh
from mimesh.core.normalization import turn
from mimesh.core.options import Hints
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file

ANGLES = (0.01, 20.0, -40.0, 70.0, 160.0)
"""Degrees."""


def main() -> None:
    """Print and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path)
    parser.add_argument("--split", default="val")
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--body", default="human")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/headings.json"))
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    characters = [c for c in read_pool(args.pool, args.split, body=args.body).characters if c.clips]
    pairs = []
    for k in range(args.pairs):
        identity, driving = (characters[int(rng.integers(len(characters)))] for _ in range(2))
        meshes = at_rest(identity), in_a_frame(driving, rng)
        moves = measure_pair(*meshes, args.body)
        pairs.append({"identity": meshes[0].name, "driving": meshes[1].name} | moves)
        print(f"{k + 1}/{args.pairs} {meshes[0].name} <- {meshes[1].name}: {moves}", flush=True)
    report = {
        "provenance": provenance({"split": args.split, "body": args.body, "seed": args.seed, "angles": ANGLES}),
        "largest_percent": {
            which: {f"{q:g}": float(np.quantile([pair[which] for pair in pairs], q)) for q in (0.5, 0.9, 1.0)}
            for which in ("of_identity", "of_driving")
        },
        "pairs": pairs,
    }
    print(report["largest_percent"])
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def at_rest(character: PoolCharacter) -> Mesh:
    """Return a character as its file has it, without its rig."""
    mesh = character.rig.mesh
    return Mesh(mesh.vertices, mesh.faces, name=character.meta.file, up="+y")


def in_a_frame(character: PoolCharacter, rng: np.random.Generator) -> Mesh:
    """Return a character in a frame of one of its clips."""
    name = sorted(character.clips)[int(rng.integers(len(character.clips)))]
    frame = int(rng.integers(len(character.clips[name])))
    vertices = character.rig.skinned(character.clip_transforms(name, frame))
    return Mesh(vertices, character.rig.mesh.faces, name=f"{character.meta.file} {name} {frame}", up="+y")


def measure_pair(identity: Mesh, driving: Mesh, body: str) -> dict[str, list[float]]:
    """Turn each mesh by every angle; return the largest distances of a vertex in percent, one for each angle."""
    plain = transfer(identity, driving, hints=Hints(body=body)).mesh.vertices
    moves: dict[str, list[float]] = {"of_identity": [], "of_driving": []}
    for angle in np.radians(ANGLES):
        of_identity = transfer(headed(identity, angle), driving, hints=Hints(body=body)).mesh.vertices
        of_driving = transfer(identity, headed(driving, angle), hints=Hints(body=body)).mesh.vertices
        moves["of_identity"].append(largest_distance(of_identity, plain))
        moves["of_driving"].append(largest_distance(of_driving @ turn(-angle).T, plain))
    return moves


def headed(mesh: Mesh, angle: float) -> Mesh:
    """Turn a mesh about the vertical by an angle (radians)."""
    return mesh.with_vertices(turned(mesh.vertices, angle))


def largest_distance(vertices: Float[np.ndarray, "V 3"], plain: Float[np.ndarray, "V 3"]) -> float:
    """Return the largest distance of a vertex between two results, in percent of the longest side of the second."""
    vertices, plain = vertices - vertices.mean(axis=0), plain - plain.mean(axis=0)
    fronts = [vertices @ turn(quarter * np.pi / 2).T for quarter in range(4)]
    distances = min((np.linalg.norm(front - plain, axis=1) for front in fronts), key=lambda d: float(d.mean()))
    return round(100 * float(distances.max() / np.ptp(plain, axis=0).max()), 4)


if __name__ == "__main__":
    main()
