"""Write motion files of the shipped body with other joint names, rest poses, axes and units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mimesh.bodies import RiggedBody
from mimesh.core.geometry import unit_vectors
from mimesh.motions import Motion
from mimesh.motions.motion import BONES, joint_tracks

Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Rotation to the axes of a file with z up, in which a person faces -y."""
X_FRONT = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
"""Rotation to the axes of a file with y up, in which a person faces +x."""
ARM, LEG = ("Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot", "ToeBase")


def bone_directions(body: RiggedBody, motion: Motion) -> dict[str, np.ndarray]:
    """Compute unit vectors along the limb bones in every frame, by the bones' joints."""
    position = joint_tracks(body, motion)[1]
    return {
        joint: unit_vectors(position[:, body.joint(tail)] - position[:, body.joint(joint)])
        for joint, tail in BONES.items()
    }


def rest_pose(body: RiggedBody, kind: str) -> np.ndarray:
    """Compute world rotations (J, 3, 3) from the T-pose to another rest pose.

    t, a (arms 45 degrees down, legs 8 degrees out) and lowered (arms 85 degrees down) are standing poses. In up and
    along-x all bones point up or along x, with one random roll for each limb.
    """
    turns = np.tile(np.eye(3), (len(body.parents), 1, 1))
    if kind in ("a", "lowered"):
        lowered, out = {"a": (45, 8), "lowered": (85, 0)}[kind]
        for side, sign in (("Left", 1), ("Right", -1)):
            for parts, degrees in ((ARM, -lowered * sign), (LEG, out * sign)):
                for part in parts:
                    turns[body.joint(side + part)] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    elif kind == "axes":
        turns = _along_axes(body, turns)
    elif kind != "t":
        turns = _all_along(body, np.array([0.0, 1, 0] if kind == "up" else [1.0, 0, 0]), turns)
    return turns


def _all_along(body: RiggedBody, direction: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Rotate all bones to one direction, with a random roll for each limb."""
    rng = np.random.default_rng(4)
    roll: dict[str, float] = {}
    for j, joint in enumerate(body.joint_names):
        children = [k for k, parent in enumerate(body.parents) if parent == j]
        bones = [body.joints[k] - body.joints[j] for k in children]
        bone = max(bones, key=np.linalg.norm) if bones else body.joints[j] - body.joints[body.parents[j]]
        if joint in ("Hips", "Spine1"):
            bone = np.array([0.0, 1.0, 0.0])
        limb = next((side + name for side in ("Left", "Right") for name, parts in (("Arm", ARM), ("UpLeg", LEG))
                     for part in parts if joint == side + part), joint)  # fmt: skip
        turn = Rotation.from_rotvec(direction * roll.setdefault(limb, rng.uniform(-3, 3)))
        turns[j] = (turn * Rotation.align_vectors(direction[None], bone[None])[0]).as_matrix()
    return turns


def _along_axes(body: RiggedBody, turns: np.ndarray) -> np.ndarray:
    """Rotate the bones of trunk and limbs to x: first the nearest axis, by an axis rotation."""
    x = np.array([1.0, 0.0, 0.0])
    for joint in ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"):
        turns[body.joint(joint)] = Rotation.from_euler("z", -90, degrees=True).as_matrix()
    tails = BONES | {f"{side}{foot}": f"{side}ToeBase" for side in ("Left", "Right") for foot in ("Foot", "ToeBase")}
    for joint, tail in tails.items():
        bone = body.joints[body.joint(tail)] - body.joints[body.joint(joint.replace("ToeBase", "Foot"))]
        axis = np.sign(bone) * (np.abs(bone) == np.abs(bone).max())
        to_x = Rotation.align_vectors(x[None], axis[None])[0]
        turns[body.joint(joint)] = (to_x * Rotation.align_vectors(axis[None], bone[None])[0]).as_matrix()
    for side in ("Left", "Right"):
        turns[body.joint(f"{side}Hand")] = turns[body.joint(f"{side}ForeArm")]
    return turns


def write_bvh(
    path: Path,
    body: RiggedBody,
    motion: Motion,
    *,
    name: Callable[[str], str] = str,
    rest: str = "t",
    axes: np.ndarray | None = None,
    scale: float = 1.0,
    order: str = "ZXY",
    end: str = "End Site\n{\nOFFSET 0 0 1\n}",
) -> Path:
    """Write a motion of `body` as BVH; `axes` rotates to the file's axes, `scale` is the file's units per metre."""
    axes = np.eye(3) if axes is None else axes
    turns = rest_pose(body, rest)
    rotation, position = joint_tracks(body, motion)
    world = axes @ rotation @ np.swapaxes(turns, -1, -2) @ axes.T
    lines, columns = ["HIERARCHY"], []

    def visit(j: int) -> None:
        """Append the joint, its channels and, recursively, its children."""
        parent = body.parents[j]
        bone = turns[parent] @ (body.joints[j] - body.joints[parent]) if parent >= 0 else body.joints[0]
        lines.append(f"{'JOINT' if parent >= 0 else 'ROOT'} {name(body.joint_names[j])}\n{{")
        lines.append("OFFSET " + " ".join(repr(float(x)) for x in scale * axes @ bone))
        turning = " ".join(f"{axis}rotation" for axis in order)
        lines.append(f"CHANNELS {turning and 3} {turning}" if parent >= 0 else
                     f"CHANNELS 6 Xposition Yposition Zposition {turning}")  # fmt: skip
        if parent < 0:
            columns.append(scale * position[:, 0] @ axes.T)
        local = np.swapaxes(world[:, parent], -1, -2) @ world[:, j] if parent >= 0 else world[:, j]
        columns.append(Rotation.from_matrix(local).as_euler(order, degrees=True))
        children = [k for k, above in enumerate(body.parents) if above == j]
        for child in children:
            visit(child)
        lines.append("}" if children else f"{end}\n}}")

    visit(0)
    rows = [" ".join(map(repr, row)) for row in np.concatenate(columns, axis=1).tolist()]
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {1 / motion.fps:.7f}", *rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_amass(path: Path, body: RiggedBody, motion: Motion, axes: np.ndarray, joints: int = 52, **arrays) -> Path:
    """Write a motion of `body` as an AMASS-style archive; `axes` rotates to the world of the file."""
    rotation, position = joint_tracks(body, motion)
    world = {joint: rotation[:, body.joint(ours)] for joint, ours in OURS.items()}
    local = {j: np.swapaxes(world[p], -1, -2) @ world[j] if p else axes @ world[j] for j, p in PARENTS.items()}
    rotvec = np.zeros((len(motion), joints, 3))
    for k, joint in enumerate(PARENTS):
        rotvec[:, k] = Rotation.from_matrix(local[joint]).as_rotvec()
    np.savez(path, poses=rotvec.reshape(len(motion), -1), trans=position[:, 0] @ axes.T, **arrays)
    return path


PARENTS = {
    "pelvis": "", "left_hip": "pelvis", "right_hip": "pelvis", "spine1": "pelvis", "left_knee": "left_hip",
    "right_knee": "right_hip", "spine2": "spine1", "left_ankle": "left_knee", "right_ankle": "right_knee",
    "spine3": "spine2", "left_foot": "left_ankle", "right_foot": "right_ankle", "neck": "spine3",
    "left_collar": "spine3", "right_collar": "spine3", "head": "neck", "left_shoulder": "left_collar",
    "right_shoulder": "right_collar", "left_elbow": "left_shoulder", "right_elbow": "right_shoulder",
    "left_wrist": "left_elbow", "right_wrist": "right_elbow",
}  # fmt: skip
"""The first 22 joints of an archive in order, and their parents."""
_PARTS = {
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase", "collar": "Shoulder", "shoulder": "Arm",
    "elbow": "ForeArm", "wrist": "Hand",
}  # fmt: skip
OURS = {"pelvis": "Hips", "spine1": "LowerBack", "spine2": "Spine", "spine3": "Spine1", "neck": "Neck", "head": "Head"}
OURS |= {f"{side}_{part}": f"{side.title()}{ours}" for side in ("left", "right") for part, ours in _PARTS.items()}
"""Joint of the shipped body for each joint of an archive."""
