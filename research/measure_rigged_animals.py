"""Measure `mime` on the pairs of `animals` with the rigs of both known: how far its pose is from the truth by names.

    python research/measure_rigged_animals.py FOLDER [--split val] [-o benchmarks/rigged_animals.json]

FOLDER is a pool of rigged characters, or has rigged files of animals that share the names of their joints. The truth
copies the rotations of the maker's bones; `mime` gives the identity the directions of the driving's limbs, as its
joints mean them. So a method that finds all joints without a rig is not expected to be nearer to the truth than this.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mimesh import animate
from mimesh.bodies.character_pool import PoolCharacter
from mimesh.commands.terminal import progress
from mimesh.core.frame_buffer import counted
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.options import MotionOptions
from mimesh.core.person_motion import KnownJoints
from mimesh.evaluate.animals import Animals, animals
from mimesh.evaluate.measure import AXES
from mimesh.evaluate.metrics import pmd_aligned
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file
from mimesh.motions.animal_rig import animal_rig


def main() -> None:
    """Print and write the error of every pair, mean, median and 90th percentile."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--split", default="val", choices=("val", "test"))
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/rigged_animals.json"))
    args = parser.parse_args()
    protocol = animals(args.folder)
    protocol.check(args.split)
    with progress("pairs", quiet=False) as advance:
        pairs = counted(range(protocol.pairs), protocol.pairs, advance)
        rows = [measured(protocol, args.split, i) for i in pairs]
    errors = [row["pmd_e4"] for row in rows]
    summary = {
        "pmd_e4": round(float(np.mean(errors)), 1),
        "median": round(float(np.median(errors)), 1),
        "p90": round(float(np.quantile(errors, 0.9)), 1),
    }
    print(json.dumps(summary))
    given = vars(args) | {"folder": args.folder.name, "output": None}
    report = {"provenance": provenance(given), "summary": summary, "results": rows}
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def measured(protocol: Animals, split: str, i: int) -> dict[str, Any]:
    """Move the identity of pair `i` by the joints of both rigs, and compare it with the truth."""
    (kind,) = protocol.kinds
    identity, driving, clip, frame = protocol.draw(split, i, protocol.rng(split, kind, i))
    pair = protocol.unshuffled_pair(split, kind, i, protocol.rng(split, kind, i))
    rig, _ = animal_rig(identity.rig, np.eye(3), identity.meta.file)
    hints, motion = dataclasses.replace(AXES, rig=rig), MotionOptions(ground=False)
    moved = animate(pair.identity, posed(driving, pair.driving, clip, frame), "mime", hints=hints, motion=motion)
    error = pmd_aligned(moved.clip.vertices[0].astype(np.float64), pair.truth)
    return {"identity": identity.meta.file, "driving": pair.driving.name, "pmd_e4": round(1e4 * error, 2)}


def posed(animal: PoolCharacter, mesh: Mesh, clip: str, frame: int) -> Clip:
    """Return a frame of a clip with the joints that the animal's rig has in it."""
    rig, order = animal_rig(animal.rig, np.eye(3), animal.meta.file)
    own = [order[rig.joints[name]] for name in rig.person]
    rest: Float[np.ndarray, "J 4 4"] = animal.rig.T_world_joint
    world = animal.clip_transforms(clip, frame)[:-1] @ rest
    return dataclasses.replace(Clip.still(mesh), skeleton=KnownJoints(rig.motion(world[own][None], rest[own])))


if __name__ == "__main__":
    main()
