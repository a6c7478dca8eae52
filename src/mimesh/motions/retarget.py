"""Retargeting: another skeleton's motion onto one of our bodies, by joint name.

Per joint, in world space: D_j = C G_j C^T A_j, with G_j the source's world rotation, C the change of axes and A_j the
smallest rotation from our rest bone direction to the source's (limbs only); then local = D_parent^T D_j. A limb bone
of the result so points exactly where the source's points, whatever the two rest poses are.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..geometry import rotate_between
from ..mesh import InputError
from .bvh import Bvh
from .motion import LEG, Motion, leg_length, lowest

_SIDE_BONES = {"UpLeg": "Leg", "Leg": "Foot", "Arm": "ForeArm", "ForeArm": "Hand"}
BONES = {f"{side}{bone}": f"{side}{tail}" for side in ("Left", "Right") for bone, tail in _SIDE_BONES.items()}
"""Limb joints and the joint at the other end of their bone: the bones whose directions are kept exactly."""
NEEDED = ("Hips", *BONES, *BONES.values())
STILL = ("Thumb", "Finger")
"""Joints kept at rest: optical capture of hands with one or two markers is mostly noise."""


FLOOR_SHARE = 0.2
"""The floor is where the lowest vertex is in this quantile of the frames: most takes stand on it for longer."""


def retarget(source: Bvh, body: RiggedBody, name: str | None = None) -> Motion:
    """The source's motion on `body` (mean shape), at the source's frame rate.

    The root's path is scaled by the ratio of leg lengths and starts above the origin; the floor is found from the
    result (`FLOOR_SHARE`). Joints that the source lacks follow their parent. Contacts are not enforced.

    Raises:
        InputError: the source lacks a limb joint of ours by name (a prefix up to ":" is ignored).
    """
    index = {n.split(":")[-1]: j for j, n in reversed(list(enumerate(source.joint_names)))}
    missing = [n for n in dict.fromkeys(NEEDED) if n not in index]
    if missing:
        raise InputError(
            f"{source.name}: expected joints named as in CMU's files, found no {', '.join(missing[:4])}"
            f"{' ...' if len(missing) > 4 else ''}; rename the joints (Hips, LeftUpLeg, LeftLeg, ...)"
        )
    rest, (rotation, place) = source.rest(), source.world()
    axes = axes_from_rest(rest, index)
    aligned = alignments(rest @ axes.T, index, body)
    rotation = axes @ rotation @ axes.T
    target = np.empty((len(rotation), len(body.joint_names), 3, 3))
    for j, (joint, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        if joint in index and not any(word in joint for word in STILL):
            target[:, j] = rotation[:, index[joint]] @ aligned.get(joint, np.eye(3))
        else:
            target[:, j] = target[:, parent]
    scale = leg_length(body.joints, body.joint_names) / leg_length(rest, tuple(_named(rest, index)))
    path = place[:, index["Hips"]] @ axes.T * scale
    return Motion(
        name or source.name, body.joint_names, to_local(target, body.parents), _grounded(path, target, body), source.fps
    )


def axes_from_rest(rest: Float[np.ndarray, "J 3"], index: dict[str, int]) -> Float[np.ndarray, "3 3"]:
    """The axis rotation C that takes the source's axes to ours (x the left, y up, z front), read off its rest pose."""
    hips = rest[[index["LeftUpLeg"], index["RightUpLeg"]]]
    up = _axis(hips.mean(axis=0) - (rest[index["LeftFoot"]] + rest[index["RightFoot"]]) / 2)
    left = _axis((hips[0] - hips[1]) * (up == 0))
    return np.stack([left, up, np.cross(left, up)])


def alignments(
    rest: Float[np.ndarray, "J 3"], index: dict[str, int], body: RiggedBody
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """A_j of every joint that needs one: limbs, hands (as the forearm) and feet.

    A foot takes its shin's roll only: capture skeletons splay their legs at rest with soles square to the shin seen
    from the front, while the pitch of ankle and toes is that of a flat sole, as in our rest pose.
    """
    aligned = {}
    for joint, tail in BONES.items():
        ours = body.joints[body.joint(tail)] - body.joints[body.joint(joint)]
        theirs = rest[index[tail]] - rest[index[joint]]
        aligned[joint] = _turn(ours, theirs)
        if tail.endswith("Hand"):
            aligned[tail] = aligned[joint]
        if tail.endswith("Foot"):
            seen = np.array([1.0, 1.0, 0.0])
            aligned[tail] = aligned[tail.replace("Foot", "ToeBase")] = _turn(ours * seen, theirs * seen)
    return aligned


def to_local(world: Float[np.ndarray, "T J 3 3"], parents: tuple[int, ...]) -> Float[np.ndarray, "T J 3 3"]:
    """Local rotations of world rotations: D_parent^T D_j."""
    local = world.copy()
    for j, parent in enumerate(parents):
        if parent >= 0:
            local[:, j] = np.swapaxes(world[:, parent], -1, -2) @ world[:, j]
    return local


def _grounded(path, target, body):
    """Shift the path to start at x = z = 0 and stand on the floor."""
    path = path - path[0] * [1.0, 0.0, 1.0]
    # Some 400 frames are enough to find the floor.
    some = slice(None, None, max(len(path) // 400, 1))
    floor = np.quantile(lowest(body, to_local(target[some], body.parents), path[some]), FLOOR_SHARE)
    return path - [0.0, floor, 0.0]


def _named(rest, index):
    """The source's joint names in order, without prefixes, for lookups by name."""
    names = [""] * len(rest)
    for joint in LEG:
        names[index[joint]] = joint
    return names


def _axis(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """The coordinate axis nearest to a vector, with its sign."""
    axis = np.zeros(3)
    largest = int(np.abs(vector).argmax())
    axis[largest] = np.sign(vector[largest])
    return axis


def _turn(old: Float[np.ndarray, " 3"], new: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Smallest rotation matrix that turns direction `old` to `new`."""
    old, new = (np.tile(v / np.linalg.norm(v), (3, 1)) for v in (old, new))
    return rotate_between(old, new, np.eye(3)).T
