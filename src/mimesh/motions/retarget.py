"""Retargeting: another skeleton's motion onto one of our bodies, joints found by name (`bodies.joint_names`).

Per joint, in world space: D_j = C G_j M_j, with G_j the source's world rotation, C the change of the world's axes and
M_j what stands between our rest pose and the source's; then local = D_parent^T D_j. Where the source rests standing,
M_j = C^T A_j with A_j the smallest rotation from our rest bone direction to the source's (limbs only); where its rest
pose is no pose, M_j comes from the motion (`unposed`). A limb bone of the result so points exactly where the source's
points, whatever the two rest poses are.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.joint_names import named_joints, require_joints
from ..core.errors import InputError
from ..core.geometry import unit_vectors
from .bvh import Bvh
from .motion import LEG, Motion, leg_length, lowest
from .rest_calibration import axes_from_motion, measured, turn_between

_SIDE_BONES = {"UpLeg": "Leg", "Leg": "Foot", "Arm": "ForeArm", "ForeArm": "Hand"}
BONES = {f"{side}{bone}": f"{side}{tail}" for side in ("Left", "Right") for bone, tail in _SIDE_BONES.items()}
"""Limb joints and the joint at the other end of their bone: the bones whose directions are kept exactly."""
NEEDED = ("Hips", *BONES, *BONES.values())
STANDING = 0.7
"""Cosine of the angle (45 degrees) up to which a rest pose may lean and still stand."""
FLOOR_SHARE = 0.2
"""The floor is where the lowest vertex is in this quantile of the frames: most takes stand on it for longer."""


def retarget(source: Bvh, body: RiggedBody, name: str | None = None) -> Motion:
    """The source's motion on `body` (mean shape), at the source's frame rate.

    The root's path is scaled by the ratio of leg lengths and starts above the origin; the floor is found from the
    result (`FLOOR_SHARE`). Joints that the source lacks follow their parent. So do fingers: optical capture of hands
    with one or two markers is mostly noise. Contacts are not enforced.

    Raises:
        InputError: the source lacks the hips or a limb joint by name, or a limb bone has no length at rest.
    """
    index = named_joints(source.joint_names, source.parents)
    require_joints(index, NEEDED, source.joint_names, name or source.name)
    rest, (rotation, place) = source.rest(), source.world()
    flat = [joint for joint, tail in BONES.items() if not (rest[index[tail]] - rest[index[joint]]).any()]
    if flat:
        raise InputError(
            f"{name or source.name}: expected limbs with a length at rest, found none for {', '.join(flat)}; "
            "export the skeleton with its bones"
        )
    if rests_standing(rest, index):
        axes = axes_from_rest(rest, index)
        aligned = alignments(rest @ axes.T, index, body)
        between = {joint: axes.T @ aligned.get(joint, np.eye(3)) for joint in index}
    else:
        axes = axes_from_motion(place, index)
        between = measured(axes @ rotation, place @ axes.T, rest, index, body)
    target = np.empty((len(rotation), len(body.joint_names), 3, 3))
    for j, (joint, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        target[:, j] = axes @ rotation[:, index[joint]] @ between[joint] if joint in index else target[:, parent]
    theirs = [rest[index[joint]] for joint in LEG]
    scale = leg_length(body.joints, body.joint_names) / leg_length(np.array(theirs), LEG)
    path = place[:, index["Hips"]] @ axes.T * scale
    return Motion(
        name or source.name, body.joint_names, to_local(target, body.parents), _grounded(path, target, body), source.fps
    )


def rests_standing(rest: Float[np.ndarray, "J 3"], index: dict[str, int]) -> bool:
    """Whether a rest pose stands: legs point away from the shoulders, and left and right are on the sides.

    Some files (LAFAN1's, for one) rest with all limbs along one axis; what is up and in front is then in the motion
    alone.
    """
    hips, feet, arms = (_pair(rest, index, part).mean(axis=0) for part in ("UpLeg", "Foot", "Arm"))
    up = unit_vectors(hips - feet)
    upright = up @ unit_vectors(arms - hips) > STANDING
    across = [np.subtract(*_pair(rest, index, part)) for part in ("UpLeg", "Arm")]
    return bool(upright and all(abs(up @ unit_vectors(way)) < STANDING for way in across) and across[0] @ across[1] > 0)


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
        aligned[joint] = turn_between(ours, theirs)
        if tail.endswith("Hand"):
            aligned[tail] = aligned[joint]
        if tail.endswith("Foot"):
            seen = np.array([1.0, 1.0, 0.0])
            aligned[tail] = aligned[tail.replace("Foot", "ToeBase")] = turn_between(ours * seen, theirs * seen)
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


def _pair(rest, index, part):
    """Left and right joint of a part, (2, 3)."""
    return rest[[index[f"Left{part}"], index[f"Right{part}"]]]


def _axis(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """The coordinate axis nearest to a vector, with its sign."""
    axis = np.zeros(3)
    largest = int(np.abs(vector).argmax())
    axis[largest] = np.sign(vector[largest])
    return axis
