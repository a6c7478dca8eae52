"""Measure how corrected joints mend what `mime` misreads on four-legged animals of other makers, given without rigs.

    python research/measure_animal_joints.py FOLDER [--identity Death] [--driving Walk] [-o FILE]

FOLDER has rigged files (.glb, .gltf) with several animations. The identity is the mesh of an animal, without its rig,
in the middle of an animation in which animals are misread (they fall over). It is driven by the same animal, without
its rig, in one in which they are not; the truth are the driving's vertices. It is moved as it is read, and with the
joints of its legs and its head put where the file's rig has them.
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
from mimesh.core.mesh import Mesh, cut_clip
from mimesh.core.options import Hints, MotionOptions
from mimesh.evaluate.run import provenance
from mimesh.io import load_clip
from mimesh.io.atomic import whole_file
from mimesh.mime.joint_targets import QUADRUPED
from mimesh.pipeline.file_rigs import Rigs

NAMES = (*(name for limb in QUADRUPED.limbs for name in limb), "Head")
"""Joints whose places rigs agree on. Those of the trunk are anywhere in it."""
FRAMES = 6
"""Frames of the driving motion."""


def main() -> None:
    """Print and write the errors of every animal, and their means."""
    parser = argparse.ArgumentParser(
        description="Measure corrected joints of animals.", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--identity", default="Death", help="end of the names of the animations of the identity")
    parser.add_argument("--driving", default="Walk", help="end of the name of the driving animation")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/animal_joints.json"))
    args = parser.parse_args()
    rows = []
    for path in sorted(path for path in args.folder.iterdir() if path.suffix.lower() in (".glb", ".gltf")):
        for row in errors(path, args.identity, args.driving):
            rows.append(row)
            print(json.dumps(row), flush=True)
    for which in ("read", "corrected"):
        print(f"{which}: {np.mean([row[which] for row in rows]):.1f} % of the height, {len(rows)} meshes")
    report = {"provenance": provenance(vars(args) | {"folder": args.folder.name, "output": None}), "results": rows}
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n")


def errors(path: Path, identity: str, driving: str) -> Iterator[dict[str, Any]]:
    """Measure an animal in the middle of some of its animations, by the ends of their names.

    Yields mean distances of the vertices of all frames, which are moved to one centre, in percent of the height.
    """
    names = getattr(load_clip(path).mesh.source, "animations", ())
    motion = load_clip(path, animation=next(name for name in names if name.endswith(driving)))
    motion = dataclasses.replace(cut_clip(motion, 0, FRAMES, 1), skeleton=None)
    for name in (name for name in names if name.endswith(identity)):
        clip = load_clip(path, animation=name)
        rig = Rigs.read(clip.mesh, clip, "mimesh").driving
        assert rig is not None
        t, row = len(clip) // 2, {}
        true = {joint: rig.positions[t, rig.joints.index(joint)] for joint in NAMES if joint in rig.joints}
        mesh = Mesh(np.asarray(clip.vertices[t], np.float64), clip.mesh.faces, name=path.stem, up="+y")
        for which, joints in (("read", {}), ("corrected", true)):
            result = animate(
                mesh,
                motion,
                hints=Hints(front=rig.front, driving_front=rig.front, body="quadruped", joints=joints),
                motion=MotionOptions(ground=False),
            )
            off = np.linalg.norm(centred(result.clip.vertices) - centred(motion.vertices), axis=-1)
            row[which] = round(100 * float(off.mean() / np.ptp(motion.mesh.vertices[:, 1])), 2)
        yield {"mesh": f"{path.stem} {name} {t}", "joints": len(true), **row}


def centred(vertices: np.ndarray) -> Float[np.ndarray, "T V 3"]:
    """Move every frame to one place."""
    return vertices - vertices.mean(axis=1, keepdims=True)


if __name__ == "__main__":
    main()
