"""A rigged body as random surface points with proportions of bones, and the Jacobian of its points, for Gauss-Newton.

The unknowns, U in one vector, in this order (`SampledBody.unknowns` has their slices):

* size (1): logarithm of the scale s;
* root (3): position of the root joint;
* shape (K): shape coefficients (standard deviations);
* bones (2 G): logarithms of the length, then of the girth, of the G kinds of bones; left and right bones are one kind.
  Where bones branch, the girth scales all directions;
* turns (3 J): a small rotation vector of each joint about the world's axes, applied after its rotation. All descendants
  of the joint turn with it.

Point i is x_i = sum_j w_ij (p_j + L_j o_ij) (linear blend skinning), with o_ij its offset from joint j at rest, p_j the
position of joint j, and L_j = s R_j (l_j A_j + g_j (I - A_j)) for the joint's world rotation R_j, the length l_j and
girth g_j of its bone, and the projection A_j onto the bone's direction at rest. Forward kinematics gives
p_child = p_parent + L_parent (rest_child - rest_parent).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.geometry import face_normals
from ..core.rig import descendant_matrix
from ..core.skinning import blend_matrices, place_joints
from ..core.surface_points import interpolate, sample_surface
from .body_model import RiggedBody
from .joint_names import without_side
from .sampling import rotvec_to_rotmat

DENSITY_EXPONENT = 0.5
"""The density of points is a bone's fraction of the surface to minus this power: small parts get more points."""
MIN_FRACTION = 0.003
"""Smallest fraction of the surface that a bone is assumed to have; bounds the density."""


@dataclass(frozen=True, eq=False)
class BodyState:
    """Size, position, shape, proportions and pose of one person: the values of all unknowns."""

    size: float
    """Length of one metre of the body, in the unit of the points."""
    root: Float[np.ndarray, " 3"]
    """Position of the root joint."""
    shape: Float[np.ndarray, " K"]
    """Shape coefficients (standard deviations)."""
    bones: Float[np.ndarray, " B"]
    """Logarithms of length, then of girth, of each kind of bones: B is 2 G."""
    rotation: Float[np.ndarray, "J 3 3"]
    """World rotation of each joint from rest."""


@dataclass(frozen=True, eq=False)
class SampledBody:
    """N surface points of a body at rest, with the arrays that pose them."""

    name: str
    """Of the body."""
    names: tuple[str, ...]
    """Names of the joints."""
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root; parents come before their children."""
    vertices: Float[np.ndarray, "N 3"]
    """Positions of the points (metres)."""
    normals: Float[np.ndarray, "N 3"]
    components: Float[np.ndarray, "N 3 K"]
    """Displacement of the points for one standard deviation of each shape coefficient."""
    weights: Float[np.ndarray, "N J"]
    """Skinning weights, rows sum to 1."""
    joints: Float[np.ndarray, "J 3"]
    joint_components: Float[np.ndarray, "J 3 K"]
    along: Float[np.ndarray, "J 3 3"]
    """Projection A_j onto the direction of each joint's bone; zero where bones branch."""
    kind: Int[np.ndarray, " J"]
    """Kind of each joint's bone; left and right are one kind."""

    @classmethod
    def of(cls, body: RiggedBody, count: int, seed: int = 0) -> SampledBody:
        """Sample about `count` points, evenly on each part of the body, denser on small parts, in random order."""
        rng = np.random.default_rng(seed)
        face, barycentric = sample_surface(body.vertices, body.faces, 30 * count, rng)
        weights = interpolate(body.weights, body.faces[face], barycentric)
        # Of many uniform samples, take those at equal steps of the accumulated density.
        fraction = np.maximum(weights.mean(axis=0), MIN_FRACTION)
        density = np.cumsum(weights @ fraction**-DENSITY_EXPONENT)
        chosen = np.unique(np.searchsorted(density, density[-1] * (np.arange(count) + 0.5) / count))
        chosen = rng.permutation(chosen)
        return cls._at(body, face[chosen], barycentric[chosen])

    @classmethod
    def of_vertices(cls, body: RiggedBody) -> SampledBody:
        """Take all vertices of the body, in their order; the normal of each is that of one of its triangles."""
        corner = np.unique(body.faces, return_index=True)[1]
        return cls._at(body, corner // 3, np.eye(3)[corner % 3])

    @classmethod
    def _at(cls, body: RiggedBody, face: Int[np.ndarray, " N"], barycentric: Float[np.ndarray, "N 3"]) -> SampledBody:
        corners = body.faces[face]
        directions, branching = bone_directions(body)
        return cls(
            name=body.name,
            names=body.joint_names,
            parents=body.parents,
            vertices=interpolate(body.vertices, corners, barycentric),
            normals=face_normals(body.vertices, body.faces)[face],
            components=np.stack([interpolate(c, corners, barycentric) for c in body.components], axis=2),
            weights=interpolate(body.weights, corners, barycentric),
            joints=body.joints,
            joint_components=np.moveaxis(body.joint_components, 0, 2),
            along=np.where(branching[:, None, None], 0.0, directions[:, :, None] * directions[:, None]),
            kind=kinds_of_bones(body),
        )

    def first(self, count: int) -> SampledBody:
        """Reduce to the first `count` points, which are random ones."""
        arrays = ("vertices", "normals", "components", "weights")
        return replace(self, **{name: getattr(self, name)[:count] for name in arrays})

    def weighted_to(self, joints: list[int]) -> Bool[np.ndarray, " N"]:
        """Return a mask of the points that are weighted mostly to some joints."""
        return self.weights[:, joints].sum(axis=1) > 0.5

    @cached_property
    def below(self) -> Float[np.ndarray, "J J"]:
        """Descendant matrix: 1 at [j, k] if joint k is joint j or a descendant of it."""
        return descendant_matrix(self.parents)

    @cached_property
    def one_hot(self) -> Float[np.ndarray, "J G"]:
        """One-hot encoding of the kind of each joint's bone."""
        return np.eye(self.kind.max() + 1)[self.kind]

    @cached_property
    def unknowns(self) -> dict[str, slice]:
        """Slice of each group in the vector of unknowns; see the module."""
        sizes = (1, 3, self.components.shape[2], 2 * self.one_hot.shape[1], 3 * len(self.parents))
        ends = np.cumsum(sizes)
        return {name: slice(end - n, end) for name, n, end in zip(_GROUPS, sizes, ends, strict=True)}

    def mean_person(
        self, size: float, root: Float[np.ndarray, " 3"], rotation: Float[np.ndarray, "J 3 3"]
    ) -> BodyState:
        """Make the state of the mean shape and proportions in a pose."""
        groups = self.unknowns
        shape, bones = (np.zeros(groups[name].stop - groups[name].start) for name in ("shape", "bones"))
        return BodyState(size, root, shape, bones, rotation)

    def stepped(self, state: BodyState, step: Float[np.ndarray, " U"]) -> BodyState:
        """Apply a change of all unknowns to a state."""
        size, root, shape, bones, turns = (step[self.unknowns[name]] for name in _GROUPS)
        # A joint turns with all its ancestors: the sum of their rotation vectors, to first order.
        rotation = rotvec_to_rotmat(self.below.T @ turns.reshape(-1, 3)) @ state.rotation
        return BodyState(
            float(state.size * np.exp(size[0])), state.root + root, state.shape + shape, state.bones + bones, rotation
        )


_GROUPS = ("size", "root", "shape", "bones", "turns")


class PosedBody:
    """A sampled body in a state: points, normals and joints, and products with their Jacobian.

    With the notation of the module, the derivatives of x_i = sum_j w_ij (p_j + L_j o_ij) are

    * by the size: x_i - p_root, since s scales everything about the root;
    * by the root: I;
    * by shape coefficient k: sum_j w_ij (dp_j/dk + L_j (c_ik - cj_jk)), c the components of points, cj those of joints;
    * by the logarithm of a length: sum_j w_ij (dp_j + s R_j l_j A_j o_ij) over the joints of that kind in the second
      term; for a girth the same with g_j (I - A_j);
    * by the turn of joint j: t x (sum_k w_ik (p_k + L_k o_ik - p_j)) over the descendants k of j, including j.

    The derivatives dp_j of the joints by shape and bones follow the kinematic chain (`_joint_jacobian`).

    Attributes:
        points: (N, 3), x_i.
        normals: (N, 3), of unit length.
        joints: (J, 3), p_j.
        linear: (J, 3, 3), L_j.
        lengthwise: (J, 3, 3), the part s R_j l_j A_j of L_j.
    """

    def __init__(self, body: SampledBody, state: BodyState) -> None:
        self.body, self.state = body, state
        count = len(body.one_hot.T)
        length, girth = np.exp(state.bones.reshape(2, count))[:, body.kind, None, None]
        across = np.eye(3) - body.along
        scaled_rotation = state.size * state.rotation
        self.lengthwise, self._crosswise = scaled_rotation @ (length * body.along), scaled_rotation @ (girth * across)
        self.linear = self.lengthwise + self._crosswise
        self.rest_joints = body.joints + body.joint_components @ state.shape
        # Coordinates come first: products over rows of three take several times as long.
        self._offset = (body.vertices + body.components @ state.shape).T[..., None] - self.rest_joints.T[:, None]
        bones = self.rest_joints[1:] - self.rest_joints[list(body.parents[1:])]
        self.joints = place_joints(state.root, bones, self.linear, body.parents)
        # Contribution of each joint to each point, w_ij (p_j + L_j o_ij).
        self._moved = self._by_joints(self.linear)
        self._contributions = self._moved + body.weights * self.joints.T[:, None]
        self.points = np.ascontiguousarray(self._contributions.sum(axis=2).T)
        # Normals transform with the inverse transpose of L_j; the scale does not matter.
        normals = state.rotation @ (body.along / length + across / girth)
        self.normals = _unit(np.einsum("nab,nb->na", self._blended(normals), body.normals))

    def along(self, index: Int[np.ndarray, " M"], direction: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "M U"]:
        """Compute direction_m . dx_index[m] / du for all unknowns u: how far points move along given directions.

        These are rows of the Jacobian of point-to-plane distances.
        """
        n = direction
        size = ((self.points[index] - self.joints[0]) * n).sum(axis=1, keepdims=True)
        by_person = (n[:, None] @ self._person_jacobian[index])[:, 0]
        # n . (t x arm) = t . (arm x n)
        (ax, ay, az), (nx, ny, nz) = self._arms[:, index], n.T[..., None]
        turns = np.stack([ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx], axis=-1).reshape(len(n), -1)
        return np.concatenate([size, n, by_person, turns], axis=1)

    def of_joints(self) -> Float[np.ndarray, "R U"]:
        """Compute the Jacobian of the joint positions: three rows (x, y, z) per joint, R is 3 J."""
        joints, body = self.joints, self.body
        arms = body.below.T[..., None] * (joints[:, None] - joints)
        turns = np.einsum("abc,kjc->kajb", _LEVI_CIVITA, arms).reshape(*joints.shape, -1)
        root = np.broadcast_to(np.eye(3), (len(joints), 3, 3))
        parts = [(joints - joints[0])[..., None], root, self._joint_jacobian, turns]
        return np.concatenate(parts, axis=2).reshape(joints.size, -1)

    @cached_property
    def _joint_jacobian(self) -> Float[np.ndarray, "J 3 D"]:
        """Derivatives of the joint positions by shape and bones, D = K + 2 G, down the kinematic chain."""
        body, shapes = self.body, self.state.shape.size
        kinds = body.one_hot.shape[1]
        jacobians = [np.zeros((3, shapes + 2 * kinds))]
        for j, parent in enumerate(body.parents[1:], 1):
            bone = self.rest_joints[j] - self.rest_joints[parent]
            bone_components = body.joint_components[j] - body.joint_components[parent]
            jacobian = jacobians[parent].copy()
            jacobian[:, :shapes] += self.linear[parent] @ bone_components
            jacobian[:, shapes + body.kind[parent]] += self.lengthwise[parent] @ bone
            jacobian[:, shapes + kinds + body.kind[parent]] += self._crosswise[parent] @ bone
            jacobians.append(jacobian)
        return np.stack(jacobians)

    @cached_property
    def _person_jacobian(self) -> Float[np.ndarray, "N 3 D"]:
        """Derivatives of the points by shape and bones, D = K + 2 G."""
        body, shapes = self.body, self.state.shape.size
        # The part of the joints, sum_j w_ij (dp_j - L_j cj_jk),
        by_joints = self._joint_jacobian.copy()
        by_joints[:, :, :shapes] -= self.linear @ body.joint_components
        jacobian = (body.weights @ by_joints.reshape(len(by_joints), -1)).reshape(-1, *by_joints.shape[1:])
        # plus sum_j w_ij L_j c_ik,
        jacobian[:, :, :shapes] += self._blended(self.linear) @ body.components
        # plus the parts of length and girth of L_j o_ij, summed over the joints of each kind.
        lengthwise = self._by_joints(self.lengthwise)
        kinds = [lengthwise @ body.one_hot, (self._moved - lengthwise) @ body.one_hot]
        jacobian[:, :, shapes:] += np.concatenate(kinds, axis=2).swapaxes(0, 1)
        return jacobian

    @cached_property
    def _arms(self) -> Float[np.ndarray, "3 N J"]:
        """Lever arm of each joint j at each point: sum over descendants k of w_ik (p_k + L_k o_ik - p_j)."""
        below = self.body.below.T
        return self._contributions @ below - (self.body.weights @ below) * self.joints.T[:, None]

    def contributions(self, chosen: Bool[np.ndarray, " N"]) -> Float[np.ndarray, "M J 3"]:
        """Return what each joint adds to some points, w_ij (p_j + L_j o_ij)."""
        return np.moveaxis(self._contributions[:, chosen], 0, -1)

    def offsets(self, chosen: Bool[np.ndarray, " N"]) -> Float[np.ndarray, "M J 3"]:
        """Return the offsets of some points from each joint at rest, o_ij."""
        return np.moveaxis(self._offset[:, chosen], 0, -1)

    def _by_joints(self, matrices: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "3 N J"]:
        """Apply a matrix of each joint to the offsets of the points from it, times their weights."""
        rows = np.moveaxis(matrices, 0, -1)  # (3, 3, J)
        x, y, z = self._offset
        return np.stack([(a * x + b * y + c * z) * self.body.weights for a, b, c in rows])

    def _blended(self, matrices: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "N 3 3"]:
        return blend_matrices(self.body.weights, matrices)


def bone_directions(body: RiggedBody) -> tuple[Float[np.ndarray, "J 3"], Bool[np.ndarray, " J"]]:
    """Compute the direction of each joint's bone at rest, and which joints have several children.

    A joint without children has a bone to the centroid of the vertices that are weighted to it. Of a joint with several
    children the direction is not used: all its directions scale alike.
    """
    children = [[c for c, p in enumerate(body.parents) if p == j] for j in range(len(body.parents))]
    ends = []
    for j, below in enumerate(children):
        weight = body.weights[:, j]
        centroid = weight @ body.vertices / max(weight.sum(), 1e-9)
        ends.append(body.joints[below[0]] if len(below) == 1 else centroid)
    direction = np.stack(ends) - body.joints
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    return direction, np.array([len(below) > 1 for below in children])


def kinds_of_bones(body: RiggedBody) -> Int[np.ndarray, " J"]:
    """Number the kinds of bones: joints that are mirror images of each other have one number."""
    return np.unique([without_side(name) for name in body.joint_names], return_inverse=True)[1]


def _unit(vectors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
_LEVI_CIVITA[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1
"""Levi-Civita symbol: (a x b)_i = e_ijk a_j b_k."""
