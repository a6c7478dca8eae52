"""Measure how corrected joints mend what `mime` misreads on four-legged animals of other makers, given without rigs.

    python scripts/measure_animal_joints.py FOLDER [--identity Death] [--driving Walk] [-o benchmarks/animal_joints.json]

FOLDER has rigged files (.glb, .gltf) with several animations. The identity is the mesh of an animal, without its rig,
in the middle of an animation in which animals are misread (they fall over). It is driven by the same animal, without
its rig, in one in which they are not; the truth are the driving's vertices. The joint of a leg or of the head that is
farthest from that of the file's rig is put there, one after the other, until none is wrong.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mimesh import animate
from mimesh.core.mesh import Clip, Mesh, cut_clip
from mimesh.evaluate.run import provenance
from mimesh.io import load_clip
from mimesh.io.atomic import whole_file
from mimesh.methods.mime.joint_targets import QUADRUPED
from mimesh.pipeline.rigs import Rigs

NAMES = (*(name for limb in QUADRUPED.limbs for name in limb), "Head")
"""Joints whose places rigs agree on. Those of the trunk are anywhere in it."""
WRONG = 20.0
"""Distance (percent of the animal's height) from which on a joint is wrong."""
MOST = 8
"""Joints that are corrected at most."""
FRAMES = 6
"""Frames of the driving motion."""


def main() -> None:
    """Print and write the errors of every mesh after each corrected joint, and their means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--identity", default="Death", help="end of the names of the animations of the identity")
    parser.add_argument("--driving", default="Walk", help="end of the name of the driving animation")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/animal_joints.json"))
    args = parser.parse_args()
    rows = []
    for path in sorted(path for path in args.folder.iterdir() if path.suffix.lower() in (".glb", ".gltf")):
        for row in corrected_meshes(path, args.identity, args.driving):
            rows.append(row)
            print(json.dumps(row), flush=True)
    wrong = [row for row in rows if row["steps"][0]["distance"] > WRONG]
    print(f"{len(wrong)} of {len(rows)} meshes have a joint farther than {WRONG:g} % of the height from its place")
    for which, k in (("as they are", 0), ("one joint corrected", 1), ("all of them", -1)):
        steps = [row["steps"][min(k, len(row["steps"]) - 1)] for row in wrong]
        for of in ("vertices", "others"):
            values = [step[of] for step in steps]
            print(f"{which}: {of} mean {np.mean(values):.2f}, median {np.median(values):.2f} % of the height")
    print(f"corrected joints: {np.mean([len(row['steps']) - 1 for row in wrong]):.1f} on average")
    report = {"provenance": provenance(vars(args) | {"folder": args.folder.name, "output": None}), "results": rows}
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def corrected_meshes(path: Path, identity: str, driving: str) -> Iterator[dict[str, Any]]:
    """Measure an animal in the middle of some of its animations, by the ends of their names."""
    names = getattr(load_clip(path).mesh.source, "animations", ())
    motion = load_clip(path, animation=next(name for name in names if name.endswith(driving)))
    motion = dataclasses.replace(cut_clip(motion, 0, FRAMES, 1), skeleton=None)
    for name in (name for name in names if name.endswith(identity)):
        clip = load_clip(path, animation=name)
        rig = Rigs.read(clip.mesh, clip, "mimesh").driving
        assert rig is not None
        t = len(clip) // 2
        true = {joint: rig.positions[t, rig.joints.index(joint)] for joint in NAMES if joint in rig.joints}
        mesh = Mesh(np.asarray(clip.vertices[t], np.float64), clip.mesh.faces, name=path.stem, up="+y")
        yield {"mesh": f"{path.stem} {name} {t}", "steps": list(corrected_steps(mesh, true, motion, rig.front))}


def corrected_steps(
    mesh: Mesh, true: dict[str, Float[np.ndarray, " 3"]], motion: Clip, front: str | None
) -> Iterator[dict[str, Any]]:
    """Correct one joint after the other.

    Yields mean errors of the vertices of all frames, which are moved to one centre, and of the joints that are not
    corrected, and the joint that is farthest from its place; all in percent of the height.
    """
    height = float(np.ptp(motion.mesh.vertices[:, 1])) / 100
    corrected: dict[str, Float[np.ndarray, " 3"]] = {}
    while True:
        result = animate(
            mesh, motion, front=front, driving_front=front, body="quadruped", ground=False, joints=corrected
        )
        assert result.joints is not None
        off = centred(result.clip.vertices) - centred(motion.vertices)
        distance = {joint: float(np.linalg.norm(result.joints[joint] - place)) for joint, place in true.items()}
        farthest = max(distance, key=lambda joint: distance[joint])
        yield {
            "corrected": list(corrected),
            "vertices": round(float(np.linalg.norm(off, axis=-1).mean()) / height, 2),
            "others": round(float(np.mean([distance[joint] for joint in true if joint not in corrected])) / height, 2),
            "farthest": farthest,
            "distance": round(distance[farthest] / height, 1),
            "confidence": round(result.report["identity"]["confidence"], 2),
        }
        if distance[farthest] < WRONG * height or len(corrected) == MOST:
            return
        corrected = {**corrected, farthest: true[farthest]}


def centred(vertices: np.ndarray) -> Float[np.ndarray, "T V 3"]:
    """Move every frame to one place."""
    return vertices - vertices.mean(axis=1, keepdims=True)


if __name__ == "__main__":
    main()
