"""Move predicted joints to positions that the user has picked, so that the body fit starts from a consistent pose.

Joints are those of the shipped body. A corrected joint is moved to its target. All others stay where they were
predicted, except that

* the middle of an arm or leg whose end is corrected is placed by two-bone inverse kinematics,
* joints of the trunk are displaced by interpolation between corrected ones,
* shoulders follow the upper spine, toes the foot, and fingers the hand.

Rotations follow. Hips and chest turn with the plane through their limbs. Limbs get the direction of their bones by the
smallest turn, and the twist that was predicted, unless that is impossible: a person read from behind has all limbs
twisted by half a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from ...bodies import load_body
from ...core.geometry import angles_between, nearest_rotation, rotate_between, unit_vectors

LIMBS = tuple(
    (f"{side}{upper}", f"{side}{middle}", f"{side}{end}")
    for side in ("Left", "Right")
    for upper, middle, end in (("UpLeg", "Leg", "Foot"), ("Arm", "ForeArm", "Hand"))
)
"""Upper, middle and end joint of each limb."""
TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")
ANCHORS = ("Hips", "Spine1", "Head")
"""Joints of the trunk that stay unless they are corrected; Spine1 does not if both others are."""
STAYING = {*TRUNK, *(name for limb in LIMBS for name in limb)}
"""Joints that do not follow their parent."""
TRUNK_SIDES = {"Hips": ("LeftUpLeg", "RightUpLeg"), "Spine1": ("LeftArm", "RightArm")}
"""Joint of the trunk -> the left and the right joint that it turns with."""
TURNED_BY = {
    **{name: "Hips" for name in ("Hips", "LHipJoint", "RHipJoint", "LowerBack")},
    **{name: "Spine1" for name in ("Spine1", "LeftShoulder", "RightShoulder", "Spine")},
}
"""Joints that turn with hips or chest: their bones are short, and differ too much between bodies, to tell a turn."""
STRAIGHT = 0.02
"""A limb whose middle is nearer to the line between its ends (in lengths of the limb) is straight."""
SAME_LENGTH = 0.75
"""A knee or elbow stays where it is if this keeps the length of the lower bone up to this ratio."""
SWAPPED = 0.5
"""Left and right are swapped if targets are nearer than this share of their distance to the joint of the other side."""
BENT = 0.5
"""Sine of the angle of a knee or elbow from which on its hinge tells how the limb is twisted."""
MAX_HINGE_TWIST = 90.0
"""Largest angle (degrees) between a bone's rotation and that of the hinge at its end."""
MAX_TWIST = 90.0
"""Largest angle (degrees) between the rotations of a limb and of the trunk, apart from the direction of the bone."""
Joints = Float[np.ndarray, "J 3"]
Rotation = Float[np.ndarray, "3 3"]


@cache
def _joint_indices() -> dict[str, int]:
    return {name: j for j, name in enumerate(load_body().joint_names)}


@dataclass(frozen=True, eq=False)
class JointTargets:
    """Positions of K joints of a mesh that the user has picked, normalised."""

    index: list[int]
    """Indices of the joints among those of the shipped body."""
    positions: Float[np.ndarray, "K 3"]

    def apply(self, joints: Joints) -> Joints:
        """Return the positions of all joints with the known ones in their place."""
        moved = joints.copy()
        moved[self.index] = self.positions
        return moved

    def move(self, rotation: Float[np.ndarray, "J 3 3"], joints: Joints) -> tuple[Float[np.ndarray, "J 3 3"], Joints]:
        """Move predicted joints to their targets, and others with them; return rotations and positions of all."""
        fixed = np.zeros(len(joints), bool)
        fixed[self.index] = True
        placed = self._swapped_sides(joints, fixed)
        moved = _moved_joints(self.apply(placed), placed, rotation, fixed)
        return _turned_joints(rotation, joints, moved, fixed)

    def _swapped_sides(self, joints: Joints, fixed: Bool[np.ndarray, " J"]) -> Joints:
        """Swap left and right of the arms or legs if a target of one side is where the other side was predicted."""
        at = _joint_indices()
        swapped, targets = joints.copy(), self.apply(joints)
        for left_limb, right_limb in zip(LIMBS[:2], LIMBS[2:], strict=True):
            left, right = ([at[name] for name in limb] for limb in (left_limb, right_limb))
            own, other = (np.concatenate([joints[one], joints[two]]) for one, two in ((left, right), (right, left)))
            known = fixed[[*left, *right]]
            far, near = (np.linalg.norm(targets[[*left, *right]] - to, axis=1)[known] for to in (own, other))
            if known.any() and near.sum() < SWAPPED * far.sum():
                swapped[[*left, *right]] = other
        return swapped


def _moved_joints(
    moved: Joints, joints: Joints, rotation: Float[np.ndarray, "J 3 3"], fixed: Bool[np.ndarray, " J"]
) -> Joints:
    """Move the joints that are not fixed with those that are; `moved` has the fixed ones in their place."""
    at, parents = _joint_indices(), load_body().parents
    trunk = [at[name] for name in TRUNK]
    known = [fixed[at[name]] or name in ANCHORS for name in TRUNK]
    if fixed[at["Hips"]] and fixed[at["Head"]]:
        known[TRUNK.index("Spine1")] = fixed[at["Spine1"]]
    bones = np.linalg.norm(np.diff(joints[trunk], axis=0), axis=1)
    height = np.concatenate([[0.0], np.cumsum(np.maximum(bones, 1e-9))])
    displacements = [np.interp(height, height[known], along[known]) for along in (moved - joints)[trunk].T]
    moved = moved.copy()
    moved[trunk] = joints[trunk] + np.stack(displacements, axis=1)
    for name, j in at.items():  # parents come before their children
        if not fixed[j] and name not in STAYING:
            moved[j] = joints[j] + moved[parents[j]] - joints[parents[j]]
    for limb in LIMBS:
        upper, middle, end = (at[name] for name in limb)
        if fixed[end] and not fixed[middle] and not _reaches(limb, joints, moved):
            # Knees bend to the front, elbows to the back: this decides where the predicted limb is straight.
            front = rotation[upper, :, 2] * (1 if limb[2].endswith("Foot") else -1)
            moved[middle] = two_bone_middle(joints[[upper, middle, end]], moved[upper], moved[end], front)
    return moved


def _reaches(limb: tuple[str, str, str], before: Joints, after: Joints) -> bool:
    """Whether the lower bone of a limb, its middle staying, has about its predicted length, or that of the body."""
    upper, middle, end = (_joint_indices()[name] for name in limb)
    length = np.linalg.norm(after[end] - after[middle])
    thigh, predicted = np.linalg.norm(np.diff(before[[upper, middle, end]], axis=0), axis=1)
    rest = np.linalg.norm(np.diff(load_body().joints[[upper, middle, end]], axis=0), axis=1)
    return any(SAME_LENGTH * other < length < other / SAME_LENGTH for other in (predicted, thigh * rest[1] / rest[0]))


def _turned_joints(
    rotation: Float[np.ndarray, "J 3 3"], joints: Joints, moved: Joints, fixed: Bool[np.ndarray, " J"]
) -> tuple[Float[np.ndarray, "J 3 3"], Joints]:
    """Turn all joints so that they agree with their moved positions; toes and fingers turn with foot and hand."""
    at, parents = _joint_indices(), load_body().parents
    turned, moved = rotation.copy(), moved.copy()
    turns = {name: _trunk_turn(joints, moved, sides) for name, sides in TRUNK_SIDES.items()}
    ends = {limb[k]: limb[k + 1] for limb in (*LIMBS, TRUNK[-3:]) for k in range(2)}
    for name, j in at.items():  # parents come before their children
        parent, trunk = parents[j], TURNED_BY.get(name)
        if trunk is not None:
            turned[j] = turns[trunk] @ rotation[j]
            continue
        inherited = turned[parent] @ rotation[parent].T @ rotation[j]
        above, bone, plain, most = parent, np.zeros(3), None, MAX_TWIST
        if name in ends:
            child = at[ends[name]]
            bone = moved[child] - moved[j]
            if not np.array_equal(moved[[j, child]], joints[[j, child]]):
                turned[j] = _along_bone(name, rotation[j], inherited, joints[child] - joints[j], bone)
                plain = _hinge_rotation(name, moved)
                most = MAX_HINGE_TWIST
        elif fixed[j]:
            turned[j] = inherited
        if name.endswith(("UpLeg", "Arm")) and not name.endswith("ForeArm"):
            # Shoulders and hip joints are too short to tell how the chest or the hips are turned.
            above = at["Hips" if name.endswith("UpLeg") else "Spine1"]
        changed = [not np.array_equal(turned[k], rotation[k]) for k in (j, above)]
        if any(changed):
            if plain is None:
                plain, most = _swung(turned[above], turned[j], bone), MAX_TWIST
            candidates = turned[j], _swung(turned[above] @ rotation[above].T @ rotation[j], turned[j], bone)
            turned[j] = next((c for c in candidates if angles_between(c, plain) < most), plain)
        if not fixed[j] and name not in STAYING:
            moved[j] = moved[parent] + turned[parent] @ rotation[parent].T @ (joints[j] - joints[parent])
    return turned, moved


def _along_bone(
    name: str, rotation: Rotation, inherited: Rotation, before: Float[np.ndarray, " 3"], bone: Float[np.ndarray, " 3"]
) -> Rotation:
    """Turn a joint's predicted rotation, of the neck the one that it has from the chest, to the direction of its bone.

    Of limbs the direction that the rotation gives the bone is turned, not that of the predicted positions: where these
    contradict each other, rotations are more often right.
    """
    at, body = _joint_indices(), load_body()
    if name.startswith("Neck"):
        # Necks of other bodies have other directions at rest: relative to the predicted one.
        return _smallest_turn((inherited @ rotation.T @ before)[None], bone[None]) @ inherited
    child = body.parents.index(at[name])
    return _smallest_turn((rotation @ (body.joints[child] - body.joints[at[name]]))[None], bone[None]) @ rotation


def _hinge_rotation(name: str, joints: Joints) -> Rotation | None:
    """Return the rotation of a bone of a bent limb whose knee or elbow is a hinge; None if it is not bent."""
    at, body = _joint_indices(), load_body()
    limb = next((limb for limb in LIMBS if name in limb), None)
    if limb is None:
        return None
    upper, lower = unit_vectors(np.diff(joints[[at[part] for part in limb]], axis=0))
    axis = np.cross(upper, lower)
    if np.linalg.norm(axis) < BENT:
        return None
    # At rest knees bend about +x, the left elbow about -y and the right one about +y.
    rest_axis = np.array([1.0, 0, 0] if limb[2].endswith("Foot") else [0, -1.0 if name.startswith("Left") else 1.0, 0])
    j = at[name]
    rest = body.joints[body.parents.index(j)] - body.joints[j]
    bone = upper if name == limb[0] else lower
    frames = [_frame(direction, about) for direction, about in ((rest, rest_axis), (bone, axis))]
    return frames[1] @ frames[0].T


def _frame(direction: Float[np.ndarray, " 3"], axis: Float[np.ndarray, " 3"]) -> Rotation:
    """Return the rotation whose first column is a direction, and whose second one is nearest to an axis."""
    first = unit_vectors(direction[None])[0]
    second = unit_vectors((axis - (axis @ first) * first)[None])[0]
    return np.stack([first, second, np.cross(first, second)], axis=1)


def _trunk_turn(before: Joints, after: Joints, sides: tuple[str, str]) -> Rotation:
    """Return the rotation of the plane through the trunk."""
    at = _joint_indices()
    old, new = (_trunk_plane(joints, [at[side] for side in sides]) for joints in (before, after))
    return np.eye(3) if np.array_equal(old, new) else _smallest_turn(old, new)


def _trunk_plane(joints: Joints, sides: list[int]) -> Float[np.ndarray, "2 3"]:
    """Return the vector from the right to the left side of the trunk, and that from the hips to the shoulders."""
    at = _joint_indices()
    shoulders, hips = ((joints[at[f"Left{part}"]] + joints[at[f"Right{part}"]]) / 2 for part in ("Arm", "UpLeg"))
    return np.stack([joints[sides[0]] - joints[sides[1]], shoulders - hips])


def two_bone_middle(
    limb: Float[np.ndarray, "3 3"],
    upper: Float[np.ndarray, " 3"],
    end: Float[np.ndarray, " 3"],
    front: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, " 3"]:
    """Place the knee or elbow of a limb whose upper joint and end are known (two-bone inverse kinematics).

    Bones keep their lengths if the end is in reach; else both are stretched alike. The limb bends to the side that it
    bent to before, or to the direction `front` if it was straight.

    Args:
        limb: upper, middle and end joint before.
        upper: the upper joint now.
        end: the end now.
        front: direction to which a straight limb bends.
    """
    first, second = np.linalg.norm(np.diff(limb, axis=0), axis=1)
    reach = float(np.linalg.norm(end - upper))
    if reach >= first + second or reach < 1e-9:
        return upper + (end - upper) * first / max(first + second, 1e-9)
    direction = (end - upper) / reach
    # The triangle of the two bones: where the middle is along the line from end to end, and its height over the line.
    along = (first**2 - second**2 + reach**2) / (2 * reach)
    height = np.sqrt(max(first**2 - along**2, 0.0))
    bend = _smallest_turn((limb[2] - limb[0])[None], direction[None]) @ (limb[1] - limb[0])
    bend -= (bend @ direction) * direction
    if np.linalg.norm(bend) < STRAIGHT * (first + second):
        bend = front - (front @ direction) * direction
    return upper + along * direction + height * unit_vectors(bend[None])[0]


def _swung(candidate: Rotation, rotation: Rotation, bone: Float[np.ndarray, " 3"]) -> Rotation:
    """Turn a rotation by the smallest turn so that the bone has the direction that another rotation gives it."""
    return _smallest_turn((candidate @ (rotation.T @ bone))[None], bone[None]) @ candidate


def _smallest_turn(before: Float[np.ndarray, "B 3"], after: Float[np.ndarray, "B 3"]) -> Rotation:
    """Return the rotation that takes vectors to new directions: the smallest one for one, else by least squares."""
    old, new = unit_vectors(before), unit_vectors(after)
    if len(old) > 1:
        return nearest_rotation(new.T @ old)
    if not (old.any() and new.any()):  # a bone without length has no direction
        return np.eye(3)
    # Opposite directions have no smallest rotation: `rotate_between` then gives a reflection.
    return nearest_rotation(rotate_between(np.tile(old, (3, 1)), np.tile(new, (3, 1)), np.eye(3)).T)
