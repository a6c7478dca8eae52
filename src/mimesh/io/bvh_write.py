"""Motions as BVH files, which motion capture tools, engines and Blender read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..bodies import RiggedBody
from ..core.errors import InputError
from ..motions.motion import Motion
from .atomic import whole_file, writing

ORDER = "ZXY"
"""Rotation channels of every joint; the last applies first."""
CENTIMETRES = 100.0
"""Units a metre: what most BVH files are in."""


def save_bvh(motion: Motion, body: RiggedBody, path: str | Path) -> Path:
    """Write a motion of a body of mean shape: its joints, its T-pose as the rest pose, y up, centimetres, degrees.

    The floor of the file is that of the body's feet at rest. Only the root has positions.

    Raises:
        InputError: the motion is for another skeleton, or a place that cannot be written to.
    """
    from scipy.spatial.transform import Rotation

    if motion.joint_names != body.joint_names:
        raise InputError(f"{motion.name}: expected a motion of {body.name}, found other joints; retarget it first")
    lines, order = ["HIERARCHY"], []
    _write_joint(body, 0, lines, order)
    angles = Rotation.from_matrix(motion.rotmat[:, order].reshape(-1, 3, 3)).as_euler(ORDER, degrees=True)
    root = CENTIMETRES * (body.joints[0] + motion.root)
    rows = np.concatenate([root, angles.reshape(len(motion), -1)], axis=1)
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.fps:.7f}"]
    lines += [" ".join(f"{value:.5f}" for value in row) for row in rows]
    path = Path(path)
    with writing(path), whole_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    return path


def _write_joint(body: RiggedBody, j: int, lines: list[str], order: list[int], indent: str = "") -> None:
    """Add a joint and all below it to the hierarchy; `order` becomes that of the motion's columns."""
    order.append(j)
    parent, below = body.parents[j], [k for k, holder in enumerate(body.parents) if holder == j]
    offset = CENTIMETRES * (body.joints[j] - (body.joints[parent] if parent >= 0 else 0.0))
    turns = " ".join(f"{axis}rotation" for axis in ORDER)
    lines += [
        f"{indent}{'JOINT' if parent >= 0 else 'ROOT'} {body.joint_names[j]}",
        f"{indent}{{",
        f"{indent}\t{_offset(offset)}",
        f"{indent}\tCHANNELS " + (f"3 {turns}" if parent >= 0 else f"6 Xposition Yposition Zposition {turns}"),
    ]
    for child in below:
        _write_joint(body, child, lines, order, indent + "\t")
    if not below:
        lines += [f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\t{_offset(offset / 2)}", f"{indent}\t}}"]
    lines.append(f"{indent}}}")


def _offset(bone: np.ndarray) -> str:
    return "OFFSET " + " ".join(f"{value:.5f}" for value in bone)
