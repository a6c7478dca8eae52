"""Measure whether `mime` finds the limbs of four-legged animals of other makers, given without rigs and options.

    python scripts/measure_animals.py FOLDER [--splits train,val] [--frames 2] [-o benchmarks/animals.json]

Each animal of a pool or a folder of rigged files is the identity at rest and in frames of its clips, with y up as files
of most formats say, and with no axes at all. The driving mesh is the shipped quadruped. Joints found on the surface are
compared with those of the file's own rig.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from mimesh import transfer
from mimesh.bodies import load_body
from mimesh.bodies.anatomy import QUADRUPED
from mimesh.bodies.character_pool import PoolCharacter
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.evaluate.animals import read_animals
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file

LARGEST_ERROR = 0.12
"""Distance of head and feet from their joints in the rig, in the animal's longest extent, from which on an animal does
not count as found: less than half of the distance between two feet."""
MARKED = ("Head", *(names[-1] for names in QUADRUPED.legs))
"""Joints that say whether an animal stands on its feet and faces forward, where its rig has them."""


def main() -> None:
    """Print and write what was found on each mesh, and how often it was right and confident."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--splits", default="train,val", help="of a pool; of other folders all animals are taken")
    parser.add_argument("--frames", type=int, default=2, help="clips of which a frame is taken")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/animals.json"))
    args = parser.parse_args()
    body = load_body("quadruped")
    driving = Mesh(body.vertices, body.faces, name="quadruped", up="+y")
    rows = []
    for split in args.splits.split(","):
        for animal in read_animals(args.folder, split).characters:
            for name, vertices in shown(animal, args.frames):
                for up in ("+y", None):
                    mesh = Mesh(vertices["surface"], animal.rig.mesh.faces, name=name, up=up)
                    rows.append({"split": split, "mesh": name, "up": up, **found(mesh, driving, vertices["joints"])})
                    print(json.dumps(rows[-1]), flush=True)
    report = {"provenance": provenance(vars(args) | {"folder": args.folder.name, "output": None}), "results": rows}
    for up in ("+y", None):
        of = [row for row in rows if row["up"] == up]
        right = [row for row in of if row.get("error", 1.0) < LARGEST_ERROR]
        doubted = [row for row in of if row not in right and (row.get("confidence", 0) < 0.5)]
        print(
            f"up {up}: {len(right)} of {len(of)} found, {sum(row['confidence'] < 0.5 for row in right)} of them with "
            f"a note; {len(doubted)} of the {len(of) - len(right)} others with a note or refused"
        )
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def shown(animal: PoolCharacter, frames: int) -> list[tuple[str, dict[str, Any]]]:
    """Pose an animal at rest and in frames of its clips: its surface, and its joints by their names in the body."""
    rng, rig = np.random.default_rng(0), animal.rig
    poses = [("rest", np.tile(np.eye(4), (len(rig.parents) + 1, 1, 1)))]
    for clip in list(animal.clips)[:frames]:
        poses.append((clip, animal.clip_transforms(clip, int(rng.integers(len(animal.clips[clip]))))))
    return [
        (
            f"{animal.meta.file} {name}",
            {
                "surface": rig.skinned(transforms),
                "joints": {
                    joint: transforms[j, :3, :3] @ rig.joints[j] + transforms[j, :3, 3]
                    for joint, j in animal.joints.items()
                    if joint in MARKED
                },
            },
        )
        for name, transforms in poses
    ]


def found(mesh: Mesh, driving: Mesh, truth: dict[str, np.ndarray]) -> dict[str, Any]:
    """Say what `mime` found on a mesh: the largest error of head and feet in its extent, and its confidence."""
    try:
        result = transfer(mesh, driving)
    except InputError as error:
        return {"refused": str(error)}
    joints = result.joints or {}
    size = float(np.ptp(mesh.vertices, axis=0).max())
    errors = {name: float(np.linalg.norm(joints[name] - place)) / size for name, place in truth.items()}
    worst = max(errors, key=lambda name: errors[name])
    about = result.report["identity"]
    return {
        "error": round(errors[worst], 3),
        "worst": worst,
        "confidence": about["confidence"],
        "expected_error": about["expected_error"],
    }


if __name__ == "__main__":
    main()
