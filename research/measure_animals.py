"""Measure whether `mime` finds the limbs of four-legged animals of other makers, given without rigs and options.

    python research/measure_animals.py FOLDER [--splits train,val] [--frames 2] [-o benchmarks/animals.json]

Each animal of a pool or a folder of rigged files is the identity at rest and in frames of its clips, with y up as files
of most formats say, and with no axes at all. The driving mesh is the shipped quadruped. The limbs found are compared
with those of the file's own rig.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from mimesh import transfer
from mimesh.bodies import load_body
from mimesh.bodies.character_pool import PoolCharacter
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.core.rig import descendants
from mimesh.evaluate.character_folder import read_character_folder
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file
from mimesh.rigs.confidence import limb_joints

SMALLEST_SHARE = 0.8
"""Share of the surface of head and feet that must belong to the same limb in the file's own rig."""
LOWER = 0.5
"""Share of a leg's surface, from the ground up, that is looked at: where a trunk ends is a matter of taste."""


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
        for animal in read_character_folder(args.folder, split, body="quadruped").characters:
            limbs = limb_surfaces(animal)
            for name, vertices in shown(animal, args.frames):
                for up in ("+y", None):
                    mesh = Mesh(vertices, animal.rig.mesh.faces, name=name, up=up)
                    rows.append({"split": split, "mesh": name, "up": up, **found(mesh, driving, limbs)})
                    print(json.dumps(rows[-1]), flush=True)
    report = {"provenance": provenance(vars(args) | {"folder": args.folder.name, "output": None}), "results": rows}
    for up in ("+y", None):
        of = [row for row in rows if row["up"] == up]
        right = [row for row in of if row.get("share", 0.0) >= SMALLEST_SHARE]
        doubted = [row for row in of if row not in right and row.get("confidence", 0.0) < 0.5]
        print(
            f"up {up}: {len(right)} of {len(of)} found, {sum(row['confidence'] < 0.5 for row in right)} of them with "
            f"a note; {len(doubted)} of the {len(of) - len(right)} others with a note or refused"
        )
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def shown(animal: PoolCharacter, frames: int) -> list[tuple[str, np.ndarray]]:
    """Pose an animal at rest and in frames of its clips."""
    rng, rig = np.random.default_rng(0), animal.rig
    poses = [(f"{animal.meta.file} rest", rig.mesh.vertices)]
    for clip in list(animal.clips)[:frames]:
        transforms = animal.clip_transforms(clip, int(rng.integers(len(animal.clips[clip]))))
        poses.append((f"{animal.meta.file} {clip}", rig.skinned(transforms)))
    return poses


def limb_surfaces(animal: PoolCharacter) -> dict[str, np.ndarray]:
    """Find the vertices of the head and of the lower parts of the legs by an animal's own rig."""
    rig, body = animal.rig, load_body("quadruped")
    column = rig.nearest_columns({j: body.joint(name) for name, j in animal.joints.items()}, body.joint("Hips"))
    carrier = rig.summed_weights(column, len(body.parents)).argmax(axis=1)
    regions = limb_joints(body.joint_names, body.parents)
    regions["head"] = list(descendants([body.joint("Head")], body.parents))
    surfaces = {}
    for limb, joints in regions.items():
        own = np.flatnonzero(np.isin(carrier, joints))
        if limb != "head" and len(own):
            height = rig.mesh.vertices[own, 1]
            own = own[height <= height.min() + LOWER * np.ptp(height)]
        if len(own):
            surfaces[limb] = own
    return surfaces


def found(mesh: Mesh, driving: Mesh, limbs: dict[str, np.ndarray]) -> dict[str, Any]:
    """Say what `mime` found on a mesh: the smallest share of a limb that is that limb, and its confidence."""
    try:
        result = transfer(mesh, driving)
    except InputError as error:
        return {"refused": str(error)}
    assert result.skeleton is not None
    carrier = result.skeleton.rig.weights.argmax(axis=1)
    regions = limb_joints(result.skeleton.names, result.skeleton.parents)
    shares = {limb: float(np.isin(carrier[own], regions[limb]).mean()) for limb, own in limbs.items()}
    worst = min(shares, key=lambda limb: shares[limb])
    about = result.report["identity"]
    return {
        "share": round(shares[worst], 3),
        "worst": worst,
        "confidence": about.get("confidence"),
        "expected_error": about.get("expected_error"),
    }


if __name__ == "__main__":
    main()
