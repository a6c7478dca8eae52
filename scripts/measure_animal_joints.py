"""Measure how many corrected joints mend four-legged animals of other makers that `mime`, without their rigs, misreads.

    python scripts/measure_animal_joints.py FOLDER [--splits train,val] [--frames 2] [-o benchmarks/animal-joints.json]

Each animal of a pool or a folder of rigged files is the identity at rest and in frames of its clips, y up, facing +z.
The joint that is farthest from that of the file's own rig is put there, one after the other, until none is farther than
FAR. The driving mesh is the same animal in another pose, all its joints corrected; the truth are its vertices.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from measure_animals import limb_surfaces

from mimesh import transfer
from mimesh.bodies.character_pool import PoolCharacter
from mimesh.core.mesh import Mesh
from mimesh.evaluate.animals import read_animals
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file
from mimesh.methods.confidence import limb_joints
from mimesh.pipeline.corrections import shown_bones

FAR = 0.2
"""Distance (heights of the animal at rest) from which on a joint is wrong: rigs of other makers place joints otherwise
than the shipped body, by half of that on average."""
MOST = 8
"""Joints that are corrected at most."""


def main() -> None:
    """Print and write the errors on every mesh by the number of corrected joints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--splits", default="train,val", help="of a pool; of other folders all animals are taken")
    parser.add_argument("--frames", type=int, default=2, help="clips of which a frame is taken")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/animal-joints.json"))
    args = parser.parse_args()
    rows = []
    for split in args.splits.split(","):
        for animal in read_animals(args.folder, split).characters:
            for row in corrected_meshes(animal, args.frames):
                rows.append({"split": split, **row})
                print(json.dumps(rows[-1]), flush=True)
    wrong = [row for row in rows if len(row["steps"]) > 1]
    print(f"{len(wrong)} of {len(rows)} meshes have a joint farther than {FAR} heights from its place")
    for which, k in (("without corrections", 0), ("with the first", 1), ("with all", -1)):
        steps = [row["steps"][k] for row in wrong]
        means = {
            key: round(float(np.mean([step[key] for step in steps])), 3) for key in ("vertices", "joints", "share")
        }
        print(f"{which} ({np.mean([step['corrected'] for step in steps]):.1f} joints): {means}")
    report = {"provenance": provenance(vars(args) | {"folder": args.folder.name, "output": None}), "results": rows}
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def corrected_meshes(animal: PoolCharacter, frames: int) -> list[dict[str, Any]]:
    """Measure an animal at rest and in one frame of each of some clips."""
    rng, rig = np.random.default_rng(0), animal.rig
    names = [name for name in shown_bones("quadruped") if name in animal.joints]
    index = [animal.joints[name] for name in names]
    poses = {"rest": (rig.mesh.vertices, dict(zip(names, rig.joints[index], strict=True)))}
    for clip in list(animal.clips)[:frames]:
        transforms = animal.clip_transforms(clip, int(rng.integers(len(animal.clips[clip]))))
        places = np.einsum("jkl,jl->jk", transforms[index, :3, :3], rig.joints[index]) + transforms[index, :3, 3]
        poses[clip] = rig.skinned(transforms), dict(zip(names, places, strict=True))
    last = list(poses)[-1]
    limbs, height = limb_surfaces(animal), float(np.ptp(rig.mesh.vertices[:, 1]))
    return [
        {
            "mesh": f"{animal.meta.file} {pose}",
            "steps": corrected_steps(animal, poses[pose], poses["rest" if pose == last else last], limbs, height),
        }
        for pose in poses
    ]


def corrected_steps(
    animal: PoolCharacter,
    identity: tuple[Float[np.ndarray, "V 3"], dict[str, Float[np.ndarray, " 3"]]],
    driving: tuple[Float[np.ndarray, "V 3"], dict[str, Float[np.ndarray, " 3"]]],
    limbs: dict[str, np.ndarray],
    height: float,
) -> list[dict[str, Any]]:
    """Correct one joint after the other; identity and driving are vertices and the places of the joints.

    Returns, for each number of corrected joints, the mean error of the vertices and of the joints and the largest of
    these (percent of the height), and the smallest share of a limb's surface that is that limb.
    """
    meshes = [
        Mesh(points, animal.rig.mesh.faces, name=animal.meta.file, up="+y") for points in (identity[0], driving[0])
    ]
    steps, corrected = [], {}
    while True:
        result = transfer(
            *meshes, front="+z", driving_front="+z", body="quadruped", joints=corrected, driving_joints=driving[1]
        )
        assert result.joints is not None
        assert result.skeleton is not None
        distance = {name: float(np.linalg.norm(result.joints[name] - place)) for name, place in identity[1].items()}
        off = (result.vertices - result.vertices.mean(axis=0)) - (driving[0] - driving[0].mean(axis=0))
        carrier = result.skeleton.rig.weights.argmax(axis=1)
        regions = limb_joints(result.skeleton.names, result.skeleton.parents)
        farthest = max(distance, key=lambda name: distance[name])
        steps.append(
            {
                "corrected": len(corrected),
                "vertices": round(100 * float(np.linalg.norm(off, axis=1).mean()) / height, 2),
                "joints": round(100 * float(np.mean(list(distance.values()))) / height, 2),
                "farthest": farthest,
                "distance": round(100 * distance[farthest] / height, 2),
                "share": round(
                    min(float(np.isin(carrier[own], regions[limb]).mean()) for limb, own in limbs.items()), 3
                ),
            }
        )
        if distance[farthest] < FAR * height or len(corrected) == MOST:
            return steps
        corrected = {**corrected, farthest: identity[1][farthest]}


if __name__ == "__main__":
    main()
