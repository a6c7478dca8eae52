"""Move predicted joints to positions that the user has picked, so that the body fit starts from a consistent pose.

Joints are those of a shipped body. A corrected joint is moved to its target. All others stay where they were predicted,
except that

* the middle of an arm or leg whose end is corrected is placed by two-bone inverse kinematics,
* joints of the trunk, and of an animal's tail, are displaced by interpolation between corrected ones,
* shoulders follow the upper spine; a person's toes follow the foot, and fingers the hand,
* an animal's hock or wrist follows its corrected toes, and toes follow a hock or wrist that is moved away from them.

Rotations follow. Hips and chest turn with the plane through their limbs. Limbs get the direction of their bones by the
smallest turn, and the twist that was predicted, unless that is impossible: a person read from behind has all limbs
twisted by half a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from ..bodies import load_body
from ..bodies.character_limbs import SIDES
from ..core.geometry import angles_between, frames_along, nearest_rotation, rotation_between, unit_vectors


@dataclass(frozen=True)
class Linkage:
    """Joints of a shipped body by how they move with corrected ones."""

    limbs: tuple[tuple[str, ...], ...]
    """Upper, middle and end joint of each limb, then the tip of its foot if that stays on its own: the two left ones,
    then the two right ones."""
    bends: tuple[float, ...]
    """Where the middle of each limb goes as it bends: to the front (1) or the back (-1)."""
    hinges: tuple[tuple[float, float, float], ...]
    """Axis of the body at rest about which each limb bends. None for animals: their limbs hardly twist against the
    trunk, and where a rig has fewer bones, the middle of a foreleg is its wrist, which bends the other way."""
    trunk: tuple[str, ...]
    anchors: tuple[str, str, str]
    """Joints of the trunk that stay unless they are corrected; the middle one does not if both others are."""
    neck: tuple[str, ...]
    """From its first joint to the head."""
    tail: tuple[str, ...]
    """Its first and its last joint stay unless they are corrected."""
    trunk_sides: dict[str, tuple[str, str]]
    """Hips and chest -> the left and the right joint that they turn with."""
    turned_by: dict[str, str]
    """Joints that turn with hips or chest: their bones are short, and differ too much between bodies, to tell a
    turn."""

    @cached_property
    def staying(self) -> set[str]:
        """Joints that do not follow their parent."""
        return {*self.trunk, *self.tail, *(name for limb in self.limbs for name in limb)}

    @cached_property
    def ends(self) -> dict[str, str]:
        """Joint -> the one at the end of its bone, of bones that turn with the positions of these two."""
        chains = (*self.limbs, self.neck, self.tail)
        return {start: end for chain in chains for start, end in pairwise(chain)}

    @cached_property
    def trunk_above(self) -> dict[str, str]:
        """First joint of a limb -> joint of the trunk that it hangs on."""
        return {side: joint for joint, sides in self.trunk_sides.items() for side in sides}


HUMAN = Linkage(
    limbs=tuple(
        (f"{side}{upper}", f"{side}{middle}", f"{side}{end}")
        for side in SIDES
        for upper, middle, end in (("UpLeg", "Leg", "Foot"), ("Arm", "ForeArm", "Hand"))
    ),
    bends=(1.0, -1.0, 1.0, -1.0),
    hinges=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    trunk=("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"),
    anchors=("Hips", "Spine1", "Head"),
    neck=("Neck", "Neck1", "Head"),
    tail=(),
    trunk_sides={"Hips": ("LeftUpLeg", "RightUpLeg"), "Spine1": ("LeftArm", "RightArm")},
    turned_by={
        **dict.fromkeys(("Hips", "LHipJoint", "RHipJoint", "LowerBack"), "Hips"),
        **dict.fromkeys(("Spine1", "LeftShoulder", "RightShoulder", "Spine"), "Spine1"),
    },
)
QUADRUPED = Linkage(
    limbs=tuple(
        tuple(side + part for part in leg)
        for side in SIDES
        for leg in (("Thigh", "Shin", "Foot", "Toes"), ("UpperArm", "Forearm", "Hand", "Fingers"))
    ),
    bends=(1.0, -1.0, 1.0, -1.0),
    hinges=(),
    trunk=("Hips", "Spine1", "Spine2", "Spine3", "Spine4", "Chest", "Neck1", "Neck2", "Neck3", "Head"),
    anchors=("Hips", "Chest", "Head"),
    neck=("Neck1", "Neck2", "Neck3", "Head"),
    tail=tuple(f"Tail{k}" for k in range(1, 7)),
    trunk_sides={"Hips": ("LeftThigh", "RightThigh"), "Chest": ("LeftUpperArm", "RightUpperArm")},
    turned_by={
        **dict.fromkeys(("Hips", "Spine1", "Spine2"), "Hips"),
        **dict.fromkeys(("Chest", "LeftScapula", "RightScapula", "Spine3", "Spine4"), "Chest"),
    },
)
LINKAGES = {"human": HUMAN, "quadruped": QUADRUPED}
"""Name of a shipped body -> its linkage."""
STRAIGHT = 0.02
"""A limb whose middle is nearer to the line between its ends (in lengths of the limb) is straight."""
SAME_LENGTH = 0.75
"""A knee, an elbow or an animal's toes stay where they are if this keeps the length of the bone up to this ratio."""
SWAPPED = 0.5
"""Left and right are swapped if targets are nearer than this share of their distance to the joint of the other side."""
BENT = 0.5
"""Sine of the angle of a knee or elbow from which on its hinge tells how the limb is twisted."""
MAX_HINGE_TWIST = 90.0
"""Largest angle (degrees) between a bone's rotation and that of the hinge at its end."""
MAX_TWIST = 90.0
"""Largest angle (degrees) between the rotations of a limb and of the trunk, apart from the direction of the bone."""
MAX_TRUNK_TURN = 45.0
"""Largest angle (degrees) between the rotation of a joint of an animal's trunk and that of the plane through the trunk,
if its hips and shoulders are all corrected."""
Joints = Float[np.ndarray, "J 3"]
Rotation = Float[np.ndarray, "3 3"]


@dataclass(frozen=True, eq=False)
class JointTargets:
    """Positions of K joints of a mesh that the user has picked, normalised."""

    index: list[int]
    """Indices of the joints among those of the shipped body."""
    positions: Float[np.ndarray, "K 3"]
    body: str = "human"
    """Name of the shipped body."""

    def apply(self, joints: Joints) -> Joints:
        """Return the positions of all joints with the known ones in their place."""
        moved = joints.copy()
        moved[self.index] = self.positions
        return moved

    def move(self, rotation: Float[np.ndarray, "J 3 3"], joints: Joints) -> tuple[Float[np.ndarray, "J 3 3"], Joints]:
        """Move predicted joints to their targets, and others with them; return rotations and positions of all."""
        fixed = np.zeros(len(joints), bool)
        fixed[self.index] = True
        chains = _chains(self.body)
        limbs, at = chains.linkage.limbs, chains.at
        placed, targets = joints.copy(), self.apply(joints)
        # Left and right arms or legs are swapped if a target of one side is where the other side was predicted.
        for left_limb, right_limb in zip(limbs[:2], limbs[2:], strict=True):
            left, right = ([at[name] for name in limb] for limb in (left_limb, right_limb))
            own, other = (np.concatenate([joints[one], joints[two]]) for one, two in ((left, right), (right, left)))
            known = fixed[[*left, *right]]
            far, near = (np.linalg.norm(targets[[*left, *right]] - to, axis=1)[known] for to in (own, other))
            if known.any() and near.sum() < SWAPPED * far.sum():
                placed[[*left, *right]] = other
        moved = chains.moved(self.apply(placed), placed, rotation, fixed)
        return chains.turned(rotation, joints, moved, fixed)


@dataclass(frozen=True, eq=False)
class _Chains:
    """A shipped body and its linkage."""

    linkage: Linkage
    parents: tuple[int, ...]
    rest: Joints
    at: dict[str, int]
    """Joint -> its index."""

    def moved(
        self, moved: Joints, joints: Joints, rotation: Float[np.ndarray, "J 3 3"], fixed: Bool[np.ndarray, " J"]
    ) -> Joints:
        """Move the joints that are not fixed with those that are; `moved` has the fixed ones in their place."""
        linkage, at = self.linkage, self.at
        hips, chest, head = (at[name] for name in linkage.anchors)
        known = fixed.copy()
        known[[hips, head, *(at[name] for name in (*linkage.tail[:1], *linkage.tail[-1:]))]] = True
        known[chest] |= not (fixed[hips] and fixed[head])
        moved = moved.copy()
        for chain in filter(None, (linkage.trunk, linkage.tail)):
            places = [at[name] for name in chain]
            # Displaced by interpolation, along the chain, between the joints whose place is known.
            bones = np.linalg.norm(np.diff(joints[places], axis=0), axis=1)
            length = np.concatenate([[0.0], np.cumsum(np.maximum(bones, 1e-9))])
            displacements = (moved - joints)[places]
            between = [np.interp(length, length[known[places]], of[known[places]]) for of in displacements.T]
            moved[places] = joints[places] + np.stack(between, axis=1)
        for name, j in at.items():  # parents come before their children
            if not fixed[j] and name not in linkage.staying:
                moved[j] = joints[j] + moved[self.parents[j]] - joints[self.parents[j]]
        for limb, front in zip(linkage.limbs, linkage.bends, strict=True):
            upper, middle, end, *tips = (at[name] for name in limb)
            corrected = bool(fixed[end])
            for tip in tips:
                if fixed[tip] and not fixed[end]:
                    moved[end] = joints[end] + moved[tip] - joints[tip]
                    corrected = True
                elif fixed[end] and not fixed[tip]:
                    before, after = (np.linalg.norm(places[tip] - places[end]) for places in (joints, moved))
                    if not SAME_LENGTH * before < after < before / SAME_LENGTH:
                        moved[tip] = joints[tip] + moved[end] - joints[end]
            bones = [upper, middle, end]
            if corrected and not fixed[middle] and not self._reaches(bones, joints, moved):
                # Knees bend to the front, elbows to the back: this decides where the predicted limb is straight.
                moved[middle] = two_bone_middle(joints[bones], moved[upper], moved[end], rotation[upper, :, 2] * front)
        return moved

    def _reaches(self, limb: list[int], before: Joints, after: Joints) -> bool:
        """Whether the lower bone of a limb, its middle staying, has about its predicted length, or the body's."""
        _, middle, end = limb
        length = np.linalg.norm(after[end] - after[middle])
        thigh, predicted = np.linalg.norm(np.diff(before[limb], axis=0), axis=1)
        rest = np.linalg.norm(np.diff(self.rest[limb], axis=0), axis=1)
        lengths = predicted, thigh * rest[1] / rest[0]
        return any(SAME_LENGTH * other < length < other / SAME_LENGTH for other in lengths)

    def turned(
        self, rotation: Float[np.ndarray, "J 3 3"], joints: Joints, moved: Joints, fixed: Bool[np.ndarray, " J"]
    ) -> tuple[Float[np.ndarray, "J 3 3"], Joints]:
        """Turn all joints so that they agree with their moved positions; joints without a bone turn with their parent.

        Returns the rotations, and positions in which the joints that follow their parent have turned with it.
        """
        linkage, at, parents = self.linkage, self.at, self.parents
        turned, moved = rotation.copy(), moved.copy()
        turns = {name: self._trunk_turn(joints, moved, sides) for name, sides in linkage.trunk_sides.items()}
        known_trunk = linkage is QUADRUPED and all(fixed[at[side]] for side in linkage.trunk_above)
        for name, j in at.items():  # parents come before their children
            parent, trunk = parents[j], linkage.turned_by.get(name)
            if trunk is not None:
                turned[j] = turns[trunk] @ rotation[j]
                # Animals that lie on their side are read as standing: the prediction contradicts the corrections.
                upright = self._trunk_turn(self.rest, moved, linkage.trunk_sides[trunk])
                if known_trunk and angles_between(turned[j], upright) > MAX_TRUNK_TURN:
                    turned[j] = upright
                continue
            inherited = turned[parent] @ rotation[parent].T @ rotation[j]
            # Shoulders and hip joints are too short to tell how the chest or the hips are turned.
            above = at[linkage.trunk_above[name]] if name in linkage.trunk_above else parent
            bone, plain, most = np.zeros(3), None, MAX_TWIST
            if name in linkage.ends:
                child = at[linkage.ends[name]]
                bone = moved[child] - moved[j]
                if not np.array_equal(moved[[j, child]], joints[[j, child]]):
                    if name in linkage.neck:  # those of other bodies have other directions at rest
                        before = inherited @ rotation[j].T @ (joints[child] - joints[j])
                        turned[j] = rotation_between(before, bone) @ inherited
                    else:  # where positions contradict the rotation, this is more often right
                        before = rotation[j] @ (self.rest[child] - self.rest[j])
                        turned[j] = rotation_between(before, bone) @ rotation[j]
                    plain = self._hinge_rotation(name, moved)
                    most = MAX_HINGE_TWIST
            elif fixed[j]:
                turned[j] = inherited
            changed = [not np.array_equal(turned[k], rotation[k]) for k in (j, above)]
            if any(changed):
                if plain is None:
                    plain, most = _swung(turned[above], turned[j], bone), MAX_TWIST
                candidates = turned[j], _swung(turned[above] @ rotation[above].T @ rotation[j], turned[j], bone)
                turned[j] = next((c for c in candidates if angles_between(c, plain) < most), plain)
            if not fixed[j] and name not in linkage.staying:
                moved[j] = moved[parent] + turned[parent] @ rotation[parent].T @ (joints[j] - joints[parent])
        return turned, moved

    def _hinge_rotation(self, name: str, joints: Joints) -> Rotation | None:
        """Return the rotation of a bone of a bent limb whose knee or elbow is a hinge; None if it is not bent."""
        found = [
            (limb, hinge)
            for limb, hinge in zip(self.linkage.limbs, self.linkage.hinges, strict=False)
            if name in limb[:2]
        ]
        if not found:
            return None
        limb, hinge = found[0]
        places = [self.at[part] for part in limb[:3]]
        upper, lower = unit_vectors(np.diff(joints[places], axis=0))
        axis = np.cross(upper, lower)
        if np.linalg.norm(axis) < BENT:
            return None
        k = limb.index(name)
        rest = self.rest[places[k + 1]] - self.rest[places[k]]
        bone = (upper, lower)[k]
        frames = [frames_along(direction, about) for direction, about in ((rest, np.array(hinge)), (bone, axis))]
        return frames[1] @ frames[0].T

    def _trunk_turn(self, before: Joints, after: Joints, sides: tuple[str, str]) -> Rotation:
        """Return the rotation of the plane through the trunk."""
        old, new = (self._trunk_plane(joints, [self.at[side] for side in sides]) for joints in (before, after))
        return np.eye(3) if np.array_equal(old, new) else nearest_rotation(unit_vectors(new).T @ unit_vectors(old))

    def _trunk_plane(self, joints: Joints, sides: list[int]) -> Float[np.ndarray, "2 3"]:
        """Return the vector from the right to the left side of the trunk, and that from the hips to the shoulders."""
        hips, shoulders = (joints[[self.at[side] for side in pair]].mean(axis=0)
                           for pair in self.linkage.trunk_sides.values())  # fmt: skip
        return np.stack([joints[sides[0]] - joints[sides[1]], shoulders - hips])


@cache
def _chains(body: str) -> _Chains:
    rigged = load_body(body)
    at = {name: j for j, name in enumerate(rigged.joint_names)}
    return _Chains(LINKAGES[body], tuple(rigged.parents), rigged.joints, at)


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
    bend = rotation_between(limb[2] - limb[0], direction) @ (limb[1] - limb[0])
    bend -= (bend @ direction) * direction
    if np.linalg.norm(bend) < STRAIGHT * (first + second):
        bend = front - (front @ direction) * direction
    return upper + along * direction + height * unit_vectors(bend[None])[0]


def _swung(candidate: Rotation, rotation: Rotation, bone: Float[np.ndarray, " 3"]) -> Rotation:
    """Turn a rotation by the smallest turn so that the bone has the direction that another rotation gives it."""
    return rotation_between(candidate @ (rotation.T @ bone), bone) @ candidate
