"""Characters: meshes with joints that have roles, such as "left upper arm", whoever found them.

Everything here is normalised: y up, +z front, bounding box centred, largest distance from its centre 1. A character is
made of the rig of a file (`Character.of_file`), or of what `mime` finds on a bare surface (`mime.model.Mime.rig`).

Fingers that a driving does not have joint by joint get the bends of those that stand for them (`stands_for`); one for
several has their mean. So a mitten closes as far as four fingers do on average. A finger of fewer or more joints than
the driving's has the same bend in all, spread evenly along it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES
from ..bodies.hands import FLEXION
from ..bodies.joint_names import FINGERS, ancestors, followed_fingers, stands_for
from ..bodies.sampling import rotvec_to_rotmat
from ..core.geometry import rotate_between, unit_vectors
from ..core.mesh import Mesh
from ..core.normalization import Normalization
from ..core.rig import Rig
from ..core.skinning import SkinnedMesh
from ..core.soles import Soles, find_soles, sole_height
from .confidence import Confidence

if TYPE_CHECKING:
    from ..motions.humanoid_rig import HumanoidRig
    from .body_grid import BodyGrid

AT_REST = 1e-4
"""Largest distance (normalised) of vertices that are at rest from there: files have single precision."""
RestPose = tuple[Float[np.ndarray, "D 3 3"], Float[np.ndarray, "D 3"]]
"""World rotations and positions of a driving's joints at rest."""


@dataclass(frozen=True, eq=False)
class Character:
    """A mesh that can be posed by its joints."""

    joints: tuple[str, ...]
    """Names of the joints that move with the hips, the hips first."""
    parents: tuple[int, ...]
    rig: Rig
    """Joints at rest, and skinning weights of `points`. A rotation is that of the body's joint that a joint is or
    belongs to, from the body's T-pose to rest."""
    points: Float[np.ndarray, "W 3"]
    """Distinct positions of the mesh at rest."""
    group: Int[np.ndarray, " V"]
    """Index of each vertex of the mesh among them."""
    skinned: SkinnedMesh
    """The distinct positions, skinned."""
    roles: Mapping[str, int]
    """Index of each joint that is one of the shipped body's, by its name there."""
    above: tuple[tuple[str, ...], ...]
    """For each joint, the body's joints that it is or is below, the nearest first."""
    legs: tuple[tuple[int, ...], ...]
    """Of each leg hip, knee and ankle, those of them that it has."""
    leg: float
    """Length of a leg."""
    soles: Soles
    """Contact points of the feet, then of the hands, as indices of `points`."""
    faces: Int[np.ndarray, "F 3"]
    """Triangles of `points`; none of a point cloud."""
    arms: tuple[tuple[int, ...], ...] = ()
    """Of each arm of a person shoulder, elbow and wrist, those of them that it has."""
    confidence: Confidence | None = None
    """How certainly the joints were found; None: they are those of a file."""
    whole: Mapping[str, str] = field(default_factory=dict)
    """Body's joints that move a whole limb here, and the one at the other end of the limb."""
    directions: Mapping[str, Float[np.ndarray, " 3"]] = field(default_factory=dict)
    """Direction of these limbs in a T-pose."""
    standing: Mapping[str, Float[np.ndarray, "3 3"]] = field(default_factory=dict)
    """Rotations at rest of the body's joints that keep how they stand: they are turned from there by as much as the
    driving's from its own rest."""
    palms: Mapping[str, Float[np.ndarray, "3 3"]] = field(default_factory=dict)
    """Rotations of the hands at rest whose fingers hang on the forearm, as there is no joint of the hand, by side."""
    in_action: bool = False
    """Whether it sits, lies or moves at rest, so that it need not stand on its soles."""
    shown: Float[np.ndarray, "W 3"] | None = None
    """The distinct positions as the file shows them, where that is not at rest: nodes may have been posed or moved."""

    @classmethod
    def of_file(cls, humanoid: HumanoidRig, norm: Normalization, vertices: Float[np.ndarray, "V 3"]) -> Character:
        """Normalise the rig of a file and select the joints that move with its hips.

        Args:
            vertices: the mesh as the file shows it, normalised; may be in another pose than the rig's rest.
        """
        character = humanoid.character
        kept, parents = humanoid.tree()
        of_joint = {joint: name for name, joint in reversed(humanoid.joints.items())}
        place = {joint: k for k, joint in enumerate(kept)}
        above = tuple(
            tuple(of_joint[kept[k]] for k in ancestors(parents, j) if kept[k] in of_joint) for j in range(len(kept))
        )
        frames = np.stack([humanoid.frames[names[0] if names else "Hips"] for names in above])
        columns = character.nearest_columns(place, 0)
        weights = character.summed_weights(columns, len(kept))
        rig = Rig(norm.rotation @ frames, norm.apply(character.joints[kept]), weights)
        points = norm.apply(character.points.reshape(-1, 3)).reshape(character.points.shape)
        legs, arms = (tuple(tuple(place[j] for j in limb) for limb in of) for of in (humanoid.legs, humanoid.arms))
        body = humanoid.body
        ends = {
            name: body.joints[body.joint(end)] - body.joints[body.joint(name)]
            for name, end in humanoid.whole_limbs.items()
        }
        skinned = SkinnedMesh.of_influences(columns[character.joint_of], character.weights, points, rig, parents)
        rest = skinned.posed(rig.rotation, rig.joints[0]).astype(np.float64)
        at_rest = np.allclose(rest, vertices, atol=AT_REST)
        rest = vertices if at_rest else rest
        return cls(
            joints=tuple(character.joint_names[j] for j in kept),
            parents=parents,
            rig=rig,
            points=rest,
            group=np.arange(len(vertices)),
            skinned=skinned,
            roles={name: place[joint] for name, joint in humanoid.joints.items() if joint in place},
            above=above,
            legs=legs,
            leg=humanoid.leg / norm.radius,
            soles=find_soles(rest, rig, legs, parents, arms),
            faces=character.mesh.faces,
            arms=arms,
            whole=humanoid.whole_limbs,
            directions={name: end / np.linalg.norm(end) for name, end in ends.items()},
            standing={name: humanoid.turn @ humanoid.frames[name] for name in humanoid.stands & humanoid.joints.keys()},
            palms={side: norm.rotation @ palm for side, palm in humanoid.palms.items()},
            in_action=humanoid.in_action,
            shown=None if at_rest else vertices,
        )

    @cached_property
    def grid(self) -> BodyGrid | None:
        """Points on its surface that correspond to those of other people."""
        from .body_grid import BodyGrid

        names = tuple(names[0] if names else "Hips" for names in self.above)
        return BodyGrid.of_pose(Mesh(self.points, self.faces), self.rig, names, self.parents)

    @property
    def shared(self) -> Int[np.ndarray, " V"] | None:
        """`group`, where vertices share positions; None where none do."""
        return None if len(self.points) == len(self.group) else self.group

    @property
    def floor(self) -> float | None:
        """Height of the floor that it is on: that of its lowest sole, in action of its lowest point; None: no feet."""
        points = self.points if self.shown is None else self.shown
        if self.in_action and any(sole is not None for sole in self.soles[: len(self.legs)]):
            return float(points[:, 1].min())
        return sole_height(points, self.soles, len(self.legs))

    def rig_of_file(self, norm: Normalization) -> Rig:
        """Return the rig in the axes, unit and position of the file; `norm` is that of the character.

        It has the weights of all vertices of the mesh, or of `points` where vertices have `shared` positions.
        """
        weights = self.rig.weights if self.shared is not None else self.rig.weights.take(self.group, axis=0)
        return Rig(norm.rotation.T @ self.rig.rotation, norm.undo(self.rig.joints), weights)

    def limited(self, influences: int) -> Character:
        """Keep only the largest weights of each vertex, as files of skinned meshes do."""
        rig = self.rig.limited(influences)
        return replace(self, rig=rig, skinned=SkinnedMesh.of(self.points, rig, self.parents))

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """Return the vertices for world rotations of the joints and a position of the root joint."""
        return self._posing.posed(rotation, root)

    def posed_points(
        self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, "W 3"]:
        """Return what `posed` does, each of the distinct positions once."""
        return self.skinned.posed(rotation, root)

    @cached_property
    def _posing(self) -> SkinnedMesh:
        """The vertices, of which some share a position, as a skinned mesh."""
        return self.skinned.repeated(self.group)

    def linked(self, driving: tuple[str, ...], rest: RestPose | None = None) -> LinkedJoints:
        """Find the joint of a driving that each joint follows; `rest` is the driving at rest."""
        index = {name: k for k, name in enumerate(driving)}
        whole = {
            self.roles[name]: (index[end], self.directions[name])
            for name, end in self.whole.items()
            if name in index and end in index
        }
        rows = ([*names[:1], *followed_fingers(names[0]), *names[1:]] if names else [] for names in self.above)
        follows = np.array([next((index[name] for name in names if name in index), 0) for names in rows])
        linked = LinkedJoints(follows, whole, finger_curls(self, index))
        if rest is None or not self.standing:
            return linked
        at_rest = linked.rotations(*(array[None] for array in rest))[0]
        turned = np.tile(np.eye(3), (len(self.joints), 1, 1))
        for j, names in enumerate(self.above):
            if names and names[0] in self.standing:
                turned[j] = at_rest[j].T @ self.standing[names[0]]
        return replace(linked, standing=turned)


@dataclass(frozen=True, eq=False)
class LinkedJoints:
    """The joint of a driving that each joint of a character follows."""

    follows: Int[np.ndarray, " J"]
    """Index of that joint. One without a counterpart follows that of the nearest joint above it."""
    whole: Mapping[int, tuple[int, Float[np.ndarray, " 3"]]]
    """Joints of the character that move a whole limb: index of the driving's joint at the other end of the limb, and
    direction of the limb in a T-pose."""
    curls: tuple[Curl, ...] = ()
    """Fingers that do not follow one of the driving joint by joint."""
    standing: Float[np.ndarray, "J 3 3"] | None = None
    """Rotation before that of each joint, in the frame of the joint; None: none."""

    def rotations(
        self, rotation: Float[np.ndarray, "T D 3 3"], positions: Float[np.ndarray, "T D 3"]
    ) -> Float[np.ndarray, "T J 3 3"]:
        """Return the rotations of the joints; a whole limb points from the driving's first joint to its end.

        So an arm of one joint has the direction from shoulder to hand when the driving bends its elbow.
        """
        linked = rotation[:, self.follows]
        for joint, (end, direction) in self.whole.items():
            start = self.follows[joint]
            old = unit_vectors(rotation[:, start] @ direction)
            new = unit_vectors(positions[:, end] - positions[:, start])
            columns = (rotate_between(old, new, rotation[:, start, :, k]) for k in range(3))
            linked[:, joint] = np.stack(list(columns), axis=-1)
        for curl in self.curls:
            curl.turn(linked, rotation)
        return linked if self.standing is None else linked @ self.standing


def names_above(joints: tuple[str, ...], parents: tuple[int, ...]) -> tuple[tuple[str, ...], ...]:
    """Return for each joint of a body its own name and those of all joints above it, the nearest first."""
    return tuple(tuple(joints[k] for k in ancestors(parents, j)) for j in range(len(joints)))


FARTHEST = float(np.radians(max(most for _, most in FLEXION)))
"""Largest bend (radians) of a joint that stands for several: a fist bends the three joints of a finger by 240 degrees,
which one joint would turn through the palm."""
TIP_SHARE = 0.25
"""Share of the weights of the joint before, from which on a fourth joint is one of the finger: tips have traces."""


@dataclass(frozen=True, eq=False)
class Curl:
    """A finger with the bends of fingers of the driving."""

    joints: tuple[tuple[int, ...], ...]
    """Joints of the character, outwards, each with those below it that move as it does: ends, twists."""
    carrier: int
    """Joint of the character that carries the finger."""
    hand: Float[np.ndarray, "3 3"]
    """Rotation from the frame of that joint to the hand's, which differ where the hand has no joint."""
    fingers: tuple[tuple[int, ...], ...]
    """For each finger that it stands for the driving's hand and finger joints."""

    def bends(self, rotation: Float[np.ndarray, "T D 3 3"]) -> Float[np.ndarray, "T N 3"]:
        """Return the rotation vector of each joint relative to the one before; `rotation` is that of the driving."""
        from ..motions.motion import rotmat_to_rotvec

        count, total = len(self.joints), np.zeros((len(rotation), len(self.joints), 3))
        for chain in self.fingers:
            world = rotation[:, list(chain)]
            bends = rotmat_to_rotvec(world[:, :-1].swapaxes(-1, -2) @ world[:, 1:])
            driving = len(chain) - 1  # joints; both fingers have theirs evenly spread
            ends, theirs = np.linspace(0, driving, count + 1), np.arange(driving)
            overlap = np.minimum(ends[1:, None], theirs + 1) - np.maximum(ends[:-1, None], theirs)
            total += np.einsum("nm,tmk->tnk", np.maximum(overlap, 0.0), bends)
        mean = total / len(self.fingers)
        if count >= max(len(chain) - 1 for chain in self.fingers):
            return mean
        size = np.linalg.norm(mean, axis=-1, keepdims=True)
        return mean * np.minimum(1.0, FARTHEST / np.maximum(size, FARTHEST))

    def turn(self, linked: Float[np.ndarray, "T J 3 3"], rotation: Float[np.ndarray, "T D 3 3"]) -> None:
        """Turn the joints of the finger, in place; the joint that carries it is turned already."""
        above = linked[:, self.carrier] @ self.hand
        for joints, bend in zip(self.joints, rotvec_to_rotmat(self.bends(rotation)).swapaxes(0, 1), strict=True):
            above = above @ bend
            linked[:, list(joints)] = above[:, None]


def finger_curls(character: Character, index: Mapping[str, int]) -> tuple[Curl, ...]:
    """Find the fingers of a character that do not follow one of a driving joint by joint; `index` is of its joints."""
    curls = []
    for side in SIDES:
        hand = f"{side}Hand"
        chains = {finger: chain for finger in FINGERS if (chain := _chain(character, hand + finger))}
        if hand not in index or not chains:
            continue
        for finger, stood_for in stands_for(chains).items():
            found = [_driving_chain(hand + each, index) for each in stood_for]
            theirs = [chain for chain in found if chain]
            mine = chains[finger]
            one_by_one = hand in character.roles and len(set(theirs)) == 1 and len(theirs[0]) == len(mine)
            if theirs and not one_by_one:
                carrier = character.parents[mine[0]]
                at_rest = character.rig.rotation[carrier]
                turn = at_rest.T @ character.palms.get(side, at_rest)
                nearest = [
                    next((k for k in ancestors(character.parents, j) if k in mine), None)
                    for j in range(len(character.parents))
                ]
                moved = tuple(tuple(j for j, above in enumerate(nearest) if above == joint) for joint in mine)
                curls.append(Curl(moved, carrier, turn, tuple((index[hand], *chain) for chain in theirs)))
    return tuple(curls)


def _chain(character: Character, finger: str) -> tuple[int, ...]:
    """List the joints of a finger of a character, outwards: those with a role, and a fourth that moves the surface."""
    chain = [character.roles[name] for k in (1, 2, 3) if (name := f"{finger}{k}") in character.roles]
    if len(chain) < 3:
        return tuple(chain)
    weight = character.rig.weights.sum(axis=0)
    below = [j for j, parent in enumerate(character.parents) if parent == chain[-1]]
    return (*chain, *below) if len(below) == 1 and weight[below[0]] > TIP_SHARE * weight[chain[-1]] else tuple(chain)


def _driving_chain(finger: str, index: Mapping[str, int]) -> tuple[int, ...]:
    """List the driving's joints of a finger, or else of the first one beside it that it has."""
    first = next((name for name in (f"{finger}1", *followed_fingers(f"{finger}1")) if name in index), None)
    if first is None:
        return ()
    return tuple(index[name] for k in (1, 2, 3) if (name := f"{first[:-1]}{k}") in index)
