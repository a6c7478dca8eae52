"""Write motions of joints as BVH files (Biovision hierarchy)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from .atomic import whole_file, writing

if TYPE_CHECKING:  # slow to import, also for the child processes that read native formats
    from ..bodies import RiggedBody
    from ..motions.motion import Motion

ORDER = "ZXY"
"""Order of the rotation channels of every joint: R = R_z R_x R_y, so the last one applies first."""
CENTIMETRES = 100.0
"""File units per metre; most BVH files are in centimetres."""


def save_bvh(motion: Motion, body: RiggedBody, path: str | Path) -> Path:
    """Write a motion on the joints of a body of mean shape, and return the path; y up, centimetres, degrees.

    The rest pose of the file is the body's T-pose. The floor is at the soles of the resting body. Only the root has
    position channels.

    Raises:
        InputError: the motion is for another skeleton, or the path cannot be written to.
    """
    if motion.joint_names != body.joint_names:
        raise InputError(f"{motion.name}: expected a motion of {body.name}, found other joints; retarget it first")
    joints, root = CENTIMETRES * body.joints, CENTIMETRES * (body.joints[0] + motion.root)
    return save_joint_motion(body.joint_names, body.parents, joints, motion.rotmat, root, motion.fps, path)


def save_joint_motion(
    names: tuple[str, ...],
    parents: tuple[int, ...],
    rest: Float[np.ndarray, "J 3"],
    rotmat: Float[np.ndarray, "T J 3 3"],
    root: Float[np.ndarray, "T 3"],
    fps: float,
    path: str | Path,
) -> Path:
    """Write the motion of any skeleton, and return the path; y is up.

    Args:
        parents: index of each joint's parent; -1 for the root, which comes first.
        rest: positions at rest, in the unit of the file.
        rotmat: rotation of each joint in its parent's frame; joints at rest have the axes of the world.
        root: position of the root.

    Raises:
        InputError: the path cannot be written to.
    """
    from scipy.spatial.transform import Rotation

    lines, order, rotations = ["HIERARCHY"], [], " ".join(f"{axis}rotation" for axis in ORDER)

    def offset_line(offset: np.ndarray) -> str:
        return "OFFSET " + " ".join(f"{value:.5f}" for value in offset)

    def add_joint(j: int, indent: str = "") -> None:
        """Append a joint and its descendants to the lines, and their indices, depth first, to `order`."""
        order.append(j)
        parent, children = parents[j], [k for k, other in enumerate(parents) if other == j]
        offset = rest[j] - (rest[parent] if parent >= 0 else 0.0)
        channels = "CHANNELS 3" if parent >= 0 else "CHANNELS 6 Xposition Yposition Zposition"
        lines.extend([f"{indent}{'JOINT' if parent >= 0 else 'ROOT'} {names[j]}", f"{indent}{{"])
        lines.extend([f"{indent}\t{offset_line(offset)}", f"{indent}\t{channels} {rotations}"])
        for child in children:
            add_joint(child, indent + "\t")
        if not children:
            # A leaf needs an end site, which gives its bone a length: half of the parent bone's.
            end = ["End Site", "{", f"\t{offset_line(offset / 2)}", "}"]
            lines.extend(f"{indent}\t{line}" for line in end)
        lines.append(f"{indent}}}")

    add_joint(0)
    angles = Rotation.from_matrix(rotmat[:, order].reshape(-1, 3, 3)).as_euler(ORDER, degrees=True)
    rows = np.concatenate([root, angles.reshape(len(root), -1)], axis=1)
    lines += ["MOTION", f"Frames: {len(root)}", f"Frame Time: {1 / fps:.7f}"]
    lines += [" ".join(f"{value:.5f}" for value in row) for row in rows]
    path = Path(path)
    with writing(path), whole_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="replace", newline="\n")
    return path
