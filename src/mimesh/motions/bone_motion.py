"""Motions of VRM's humanoid bones since a T-pose, which VRM animations (.vrma) hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..bodies.character_limbs import SIDES, Limb
from ..bodies.engine_names import SCHEMES
from ..bodies.hands import body_with_fingers
from ..bodies.joint_names import ancestors
from .humanoid_rig import rest_frames
from .motion import BONES

BONE_OF_JOINT = SCHEMES["vrm"].bones
"""Bone of VRM 1.0 of each joint of the shipped body, or of a finger, parents first; other joints have none."""
TRUNK = ("LowerBack", "Spine", "Spine1")
"""Joints of the trunk, and of VRM's three, from the hips up."""
NEEDED = (*("Hips", "Head"), *BONES, *(f"{side}{end}" for side in SIDES for end in ("Hand", "Foot")))
"""Joints that VRM requires, besides one of the trunk."""
SIGNS = dict(zip(SIDES, (1.0, -1.0), strict=True))
T_DIRECTIONS = {
    f"{side}{joint}": np.array(direction) / np.linalg.norm(direction)
    for side, x in SIGNS.items()
    for joint, direction in {
        **dict.fromkeys(("ForeArm", "Hand"), (x, 0.0, 0.0)),
        **dict.fromkeys(("Leg", "Foot"), (0.0, -1.0, 0.0)),
        **{f"Hand{finger}{k}": (x, 0.0, 0.0) for finger in ("Index", "Middle", "Ring", "Pinky") for k in (2, 3)},
        **{f"HandThumb{k}": (x, 0.0, 1.0) for k in (2, 3)},
    }.items()
}
"""Direction from its parent to each joint in the T-pose of VRM 1.0 (tpose.md, definitions 1.1 to 1.8)."""


@dataclass(frozen=True, eq=False)
class BoneMotion:
    """A motion of humanoid bones in T frames: y up, facing +z, the ground at y = 0."""

    name: str
    joints: tuple[str, ...]
    """Joints of the shipped body and of fingers that VRM has bones for, the hips first, parents before children."""
    rest: Float[np.ndarray, "J 3"]
    """Positions in the T-pose, in which no bone is rotated."""
    rotation: Float[np.ndarray, "T J 3 3"]
    """World rotation of each bone since the T-pose."""
    hips: Float[np.ndarray, "T 3"]
    fps: float

    @property
    def parents(self) -> tuple[int, ...]:
        """Index of each joint's parent, -1 for the hips."""
        return bone_parents(self.joints)

    @property
    def bones(self) -> tuple[str, ...]:
        """Names of the bones in VRM 1.0."""
        return bone_names(self.joints)


def bone_joints(names: Mapping[str, int]) -> tuple[str, ...]:
    """Select the joints that VRM has bones for, parents first."""
    return tuple(name for name in BONE_OF_JOINT if name in names)


def bone_names(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names in VRM 1.0 of the bones of joints; those of the trunk are counted from the hips up."""
    trunk = [name for name in joints if name in TRUNK]
    renamed = dict(zip(trunk, (BONE_OF_JOINT[name] for name in TRUNK), strict=False))
    return tuple((BONE_OF_JOINT | renamed)[name] for name in joints)


def bone_parents(joints: tuple[str, ...]) -> tuple[int, ...]:
    """Return the index of the nearest joint above each joint, -1 for the hips."""
    body, index = body_with_fingers(), {name: k for k, name in enumerate(joints)}
    chains = ([body.joint_names[j] for j in ancestors(body.parents, body.joint(name))[1:]] for name in joints)
    return tuple(next((index[name] for name in chain if name in index), -1) for chain in chains)


def misplaced_bones(nodes: Mapping[str, int], parents: Sequence[int]) -> dict[str, int]:
    """Find the bones of a hierarchy whose nearest bone above is not the one that VRM demands there (humanoid.md).

    Thighs hang on the spine in Bipeds of 3ds Max, and on a bone beside the hips in other rigs. Players turn each bone
    relative to the one that VRM has above it, so that such bones miss the rotations of that one.

    Args:
        nodes: node of each joint of the person, by our name.
        parents: index of each node's parent, -1 for roots.

    Returns:
        Joint -> node that it has to hang on, -1 for none; parents first.
    """
    joints = bone_joints(nodes)
    bones, found = {nodes[joint] for joint in joints}, {}
    for joint, parent in zip(joints, bone_parents(joints), strict=True):
        above = [node for node in ancestors(parents, nodes[joint])[1:] if node in bones]
        if parent < 0 and above:
            found[joint] = parents[above[-1]]
        elif parent >= 0 and above[:1] != [nodes[joints[parent]]]:
            found[joint] = nodes[joints[parent]]
    return found


def t_pose_frames(joints: tuple[str, ...], rest: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 3 3"]:
    """Compute the rotation of each joint from the shipped body's T-pose to another pose, from the joints' positions.

    Args:
        rest: of a person who stands, y up, and faces +z.
    """
    index = {name: k for k, name in enumerate(joints)}
    limbs = {name: Limb(index[name], rest[index[name]], rest[index[tail]]) for name, tail in BONES.items()}
    frames = rest_frames(rest, index, limbs)
    return np.stack([frames[name] for name in joints])


def t_pose(
    joints: tuple[str, ...], rest: Float[np.ndarray, "J 3"], frames: Float[np.ndarray, "J 3 3"]
) -> Float[np.ndarray, "J 3"]:
    """Place the joints of a person in VRM's T-pose, with the lengths of its bones; the hips stay.

    Args:
        rest: positions at rest, y up.
        frames: rotation of each joint from the shipped body's T-pose to that rest pose.
    """
    placed = rest.copy()
    for k, (name, parent) in enumerate(zip(joints, bone_parents(joints), strict=True)):
        if parent >= 0:
            bone = frames[parent].T @ (rest[k] - rest[parent])
            if name in T_DIRECTIONS:
                bone = np.linalg.norm(bone) * T_DIRECTIONS[name]
            placed[k] = placed[parent] + bone
    return placed
