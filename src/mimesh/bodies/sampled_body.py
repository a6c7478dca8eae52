"""A rigged body as points of people of any shape and proportions, and how each point moves with every unknown.

Unknowns, in one vector of U: logarithm of the size, place of the root joint (3), shape coefficients (K), logarithms of
length and then of girth for each kind of bone (G each; left and right are one kind; where bones branch girth counts
for both), and a small turn of each joint about the world's axes (3 J), which all that hangs from the joint follows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.geometry import face_normals
from ..core.skinning import blend_matrices
from ..core.surface_points import sample_surface
from .body_model import RiggedBody
from .body_parameters import descendants
from .sampling import rotvec_to_rotmat

FINE = 0.5
"""How much denser points lie where a bone holds little surface: with that root of it, so that hands are known too."""
LEAST = 0.003
"""Share of the surface that every bone is counted to hold at least."""


@dataclass(frozen=True, eq=False)
class BodyState:
    """One person in one pose, somewhere in space."""

    size: float
    """What a metre of the body is."""
    root: Float[np.ndarray, " 3"]
    shape: Float[np.ndarray, " K"]
    bones: Float[np.ndarray, " B"]
    """Logarithms of length, then of girth, of each kind of bone: B is 2 G."""
    rotation: Float[np.ndarray, "J 3 3"]
    """Of each joint from the body at rest, in the world."""


@dataclass(frozen=True, eq=False)
class SampledBody:
    """N points of a body at rest."""

    names: tuple[str, ...]
    """Of the joints."""
    parents: tuple[int, ...]
    vertices: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    components: Float[np.ndarray, "N 3 K"]
    weights: Float[np.ndarray, "N J"]
    joints: Float[np.ndarray, "J 3"]
    joint_components: Float[np.ndarray, "J 3 K"]
    along: Float[np.ndarray, "J 3 3"]
    """Projects onto the direction of each joint's bone; zero where there is no such direction."""
    kind: Int[np.ndarray, " J"]
    """Of each joint's bone; left and right are of one kind."""

    @classmethod
    def of(cls, body: RiggedBody, count: int, seed: int = 0) -> SampledBody:
        """About so many points, spread evenly over each part of the body, denser on small parts, in random order."""
        rng = np.random.default_rng(seed)
        face, share = sample_surface(body.vertices, body.faces, 30 * count, rng)
        weights = mixed(body.weights, body.faces[face], share)
        dense = np.cumsum(weights @ np.maximum(weights.mean(axis=0), LEAST) ** -FINE)
        chosen = np.unique(np.searchsorted(dense, dense[-1] * (np.arange(count) + 0.5) / count))
        chosen = rng.permutation(chosen)
        corners, share = body.faces[face[chosen]], share[chosen]
        directions, branching = bone_directions(body)
        return cls(
            names=body.joint_names,
            parents=body.parents,
            vertices=mixed(body.vertices, corners, share),
            normals=face_normals(body.vertices, body.faces)[face[chosen]],
            components=np.stack([mixed(component, corners, share) for component in body.components], axis=2),
            weights=weights[chosen],
            joints=body.joints,
            joint_components=np.moveaxis(body.joint_components, 0, 2),
            along=np.where(branching[:, None, None], 0.0, directions[:, :, None] * directions[:, None]),
            kind=kinds_of_bones(body),
        )

    def first(self, count: int) -> SampledBody:
        """The same with fewer points."""
        arrays = ("vertices", "normals", "components", "weights")
        return replace(self, **{name: getattr(self, name)[:count] for name in arrays})

    @cached_property
    def below(self) -> Float[np.ndarray, "J J"]:
        """1 at [j, k] where joint k is j or hangs from it."""
        return descendants(self.parents)

    @cached_property
    def one_hot(self) -> Float[np.ndarray, "J G"]:
        """Which kind each joint's bone is."""
        return np.eye(self.kind.max() + 1)[self.kind]

    @cached_property
    def unknowns(self) -> dict[str, slice]:
        """Where in the vector each group is."""
        sizes = (1, 3, self.components.shape[2], 2 * self.one_hot.shape[1], 3 * len(self.parents))
        ends = np.cumsum(sizes)
        return {name: slice(end - n, end) for name, n, end in zip(_GROUPS, sizes, ends, strict=True)}

    def mean_person(
        self, size: float, root: Float[np.ndarray, " 3"], rotation: Float[np.ndarray, "J 3 3"]
    ) -> BodyState:
        """The mean person in a pose."""
        groups = self.unknowns
        shape, bones = (np.zeros(groups[name].stop - groups[name].start) for name in ("shape", "bones"))
        return BodyState(size, root, shape, bones, rotation)

    def stepped(self, stance: BodyState, step: Float[np.ndarray, " U"]) -> BodyState:
        """The stance after a change of all unknowns."""
        size, root, shape, bones, turns = (step[self.unknowns[name]] for name in _GROUPS)
        turned = rotvec_to_rotmat(self.below.T @ turns.reshape(-1, 3)) @ stance.rotation
        return BodyState(
            float(stance.size * np.exp(size[0])), stance.root + root, stance.shape + shape, stance.bones + bones, turned
        )


_GROUPS = ("size", "root", "shape", "bones", "turns")


class PosedBody:
    """A figure in a stance: its points, and rows of the derivative of what one asks for.

    Attributes:
        points: (N, 3).
        normals: (N, 3), of unit length.
        joints: (J, 3).
    """

    def __init__(self, figure: SampledBody, stance: BodyState) -> None:
        self.figure, self.stance = figure, stance
        count = len(figure.one_hot.T)
        length, girth = np.exp(stance.bones.reshape(2, count))[:, figure.kind, None, None]
        across = np.eye(3) - figure.along
        turned = stance.size * stance.rotation
        self.lengthwise, crosswise = turned @ (length * figure.along), turned @ (girth * across)
        self.linear = self.lengthwise + crosswise
        rest = figure.joints + figure.joint_components @ stance.shape
        self.offset = (figure.vertices + figure.components @ stance.shape)[:, None] - rest
        self.joints, self.by_person = self._chain(rest, crosswise)
        held = figure.weights[..., None] * np.einsum("jab,njb->nja", self.linear, self.offset)
        self.held = held + figure.weights[..., None] * self.joints
        self.points = self.held.sum(axis=1)
        normals = stance.rotation @ (figure.along / length + across / girth)
        self.normals = _unit(np.einsum("nab,nb->na", self._blended(normals), figure.normals))

    def along(self, index: Int[np.ndarray, " M"], direction: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "M U"]:
        """How far chosen points move along directions with each unknown."""
        figure, n = self.figure, direction
        weights, person = figure.weights[index], self.by_person.copy()
        shapes = figure.components.shape[2]
        person[:, :, :shapes] -= self.linear @ figure.joint_components
        by_person = (weights[..., None] * n[:, None]).reshape(len(n), -1) @ person.reshape(-1, person.shape[2])
        back = np.einsum("nab,na->nb", self._blended(self.linear)[index], n)
        by_person[:, :shapes] += (back[:, None] @ figure.components[index])[:, 0]
        offset = self.offset[index]
        ways = [
            weights * np.einsum("nja,nja->nj", _seen(n, linear), offset) for linear in (self.lengthwise, self.linear)
        ]
        kinds = np.concatenate([ways[0] @ figure.one_hot, (ways[1] - ways[0]) @ figure.one_hot], axis=1)
        by_person[:, shapes:] += kinds
        size = ((self.points[index] - self.joints[0]) * n).sum(axis=1, keepdims=True)
        turns = _cross(self._arms[index], n[:, None]).reshape(len(n), -1)
        return np.concatenate([size, n, by_person, turns], axis=1)

    def of_joints(self) -> Float[np.ndarray, "R U"]:
        """How the joints move with each unknown, three rows each."""
        joints, figure = self.joints, self.figure
        arms = figure.below.T[..., None] * (joints[:, None] - joints)
        turns = np.einsum("abc,kjc->kajb", _LEVI_CIVITA, arms).reshape(*joints.shape, -1)
        place = np.broadcast_to(np.eye(3), (len(joints), 3, 3))
        parts = [(joints - joints[0])[..., None], place, self.by_person, turns]
        return np.concatenate(parts, axis=2).reshape(joints.size, -1)

    def _chain(self, rest: Float[np.ndarray, "J 3"], crosswise: Float[np.ndarray, "J 3 3"]):
        """Where the joints are, and how they move with shape and bones."""
        figure, shapes = self.figure, self.stance.shape.size
        kinds = figure.one_hot.shape[1]
        places = [self.stance.root]
        moves = [np.zeros((3, shapes + 2 * kinds))]
        for j, parent in enumerate(figure.parents[1:], 1):
            bone = rest[j] - rest[parent]
            between = figure.joint_components[j] - figure.joint_components[parent]
            places.append(places[parent] + self.linear[parent] @ bone)
            move = moves[parent].copy()
            move[:, :shapes] += self.linear[parent] @ between
            move[:, shapes + figure.kind[parent]] += self.lengthwise[parent] @ bone
            move[:, shapes + kinds + figure.kind[parent]] += crosswise[parent] @ bone
            moves.append(move)
        return np.stack(places), np.stack(moves)

    @cached_property
    def _arms(self) -> Float[np.ndarray, "N J 3"]:
        """From each joint to what it carries of each point, times how much of it that is."""
        below = self.figure.below
        return below @ self.held - (self.figure.weights @ below.T)[..., None] * self.joints

    def _blended(self, matrices: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "N 3 3"]:
        return blend_matrices(self.figure.weights, matrices)


def bone_directions(body: RiggedBody) -> tuple[Float[np.ndarray, "J 3"], Bool[np.ndarray, " J"]]:
    """Direction of each joint's bone at rest, and which joints have several (these scale alike in all directions)."""
    children = [[c for c, p in enumerate(body.parents) if p == j] for j in range(len(body.parents))]
    ends = []
    for j, below in enumerate(children):
        own = body.weights[:, j]
        ends.append(body.joints[below[0]] if len(below) == 1 else own @ body.vertices / max(own.sum(), 1e-9))
    direction = np.stack(ends) - body.joints
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    return direction, np.array([len(below) > 1 for below in children])


def kinds_of_bones(body: RiggedBody) -> Int[np.ndarray, " J"]:
    """Joints that are each other's mirror image share a number."""
    names = [re.sub("^(Left|Right|L(?=[A-Z])|R(?=[A-Z]))", "", name) for name in body.joint_names]
    return np.unique(names, return_inverse=True)[1]


def _seen(n: Float[np.ndarray, "M 3"], linear: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "M J 3"]:
    """Directions as each joint sees them."""
    return (n @ linear.transpose(1, 0, 2).reshape(3, -1)).reshape(len(n), -1, 3)


def _cross(a: Float[np.ndarray, "M #J 3"], b: Float[np.ndarray, "M #J 3"]) -> Float[np.ndarray, "M J 3"]:
    """As np.cross, several times as fast."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def mixed(values: np.ndarray, corners: Int[np.ndarray, "N 3"], shares: Float[np.ndarray, "N 3"]) -> np.ndarray:
    """Values of vertices at places on triangles."""
    return (values[corners] * shares[..., None]).sum(axis=1)


def _unit(vectors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
_LEVI_CIVITA[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1
