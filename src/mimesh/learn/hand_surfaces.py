"""Hands for training, all as left hands at rest: of the shipped body and of characters, and hands without fingers.

Hands of characters with fifteen finger joints have known joints and weights. Hands of blocks, mittens (convex hulls of
hands, whole or of the four fingers) and hands without fingers are what the network has to refuse.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..bodies.body_model import RiggedBody
from ..bodies.character_limbs import SIDES
from ..bodies.character_pool import PoolCharacter
from ..bodies.finger_poses import finger_rotations, sample_finger_poses
from ..bodies.hands import HAND_PARENTS, fingertips, hand_alignment, hand_weight, load_hands
from ..bodies.joint_names import ancestors, finger_joints
from ..bodies.sampling import rotvec_to_rotmat
from ..core import geometry, surface_points
from ..core.geometry import MIRROR, unit_vectors
from ..core.skinning import skin_poses, skinning_transforms
from .primitives import SHAPES, Shape, sample_primitive

POINTS = 1000
"""Points that a hand is represented by."""
NEAR_HAND = 0.05
"""Least weight of the hand and its fingers in a vertex of a hand: a bit of the forearm belongs to it."""
PEOPLE, MITTENS, BLOCKS, STUMPS = 48, 48, 40, 16
"""Number of hands of the shipped body, and of each kind of hand without fingers made from them or of primitives."""
SPREAD = 1.3
"""Standard deviation of the shape coefficients."""
COARSE, FINGER_DETAIL = (0, 0, 300, 170, 120), 2.5
"""Number of clusters of vertices that hands are simplified to in turn (0 leaves them as they are), and how many times
closer together they are on fingers, which would vanish otherwise."""
HUMAN, WITHOUT = "human", "without fingers"
"""Groups of hands beside the packs of a pool."""


@dataclass(frozen=True, eq=False)
class HandSurface:
    """A left hand at rest, in metres or the unit of its file."""

    group: str
    """Its pack, HUMAN or WITHOUT; groups take turns in training."""
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    weights: Float[np.ndarray, "N 17"]
    """Weights of the forearm with all the rest, of the hand and of 15 finger joints, rows sum to 1."""
    joints: Float[np.ndarray, "16 3"]
    alignment: Float[np.ndarray, "16 3 3"]
    """Rotation of each joint from the shipped body's hand at rest to this one."""
    bones: Float[np.ndarray, "16 3"]
    """Unit direction of each joint's bone."""
    separate: bool
    """Whether it shows separate fingers, so that joints and weights are known."""


@dataclass(frozen=True, eq=False)
class HandMesh:
    """The part of a mesh around a left hand at rest."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    weights: Float[np.ndarray, "V 17"]
    joints: Float[np.ndarray, "16 3"]

    @classmethod
    def cut(cls, vertices, faces, weights, joints, left: bool) -> HandMesh:
        """Cut a hand out of a character; a right hand is mirrored."""
        near = weights[:, 1:].sum(axis=1) > NEAR_HAND
        faces = faces[near[faces].all(axis=1)]
        kept, flat = np.unique(faces, return_inverse=True)
        faces = flat.reshape(-1, 3)
        mirror = 1.0 if left else MIRROR
        return cls(vertices[kept] * mirror, faces if left else faces[:, ::-1], weights[kept], joints * mirror)

    def simplified(self, clusters: int) -> HandMesh:
        """Merge the vertices around so many of them, those of one joint only, so that fingers stay apart."""
        if not 0 < clusters < len(self.vertices):
            return self
        strongest = self.weights.argmax(axis=1)
        stretched = self.vertices * np.where(strongest > 1, FINGER_DETAIL, 1.0)[:, None]
        seeds = farthest_points(stretched, clusters, np.unique(strongest, return_index=True)[1])
        distance = np.linalg.norm(self.vertices[:, None] - self.vertices[seeds], axis=-1)
        distance[strongest[:, None] != strongest[seeds]] = np.inf
        cluster = distance.argmin(axis=1)
        count = np.bincount(cluster, minlength=len(seeds))[:, None]
        merged = [np.zeros((len(seeds), array.shape[1])) for array in (self.vertices, self.weights)]
        for total, array in zip(merged, (self.vertices, self.weights), strict=True):
            np.add.at(total, cluster, array)
            total /= count
        faces = cluster[self.faces]
        distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        return HandMesh(merged[0], faces[distinct], merged[1], self.joints)

    def tips(self) -> Float[np.ndarray, "5 3"]:
        """Find the fingertips."""
        return self.vertices[fingertips(self.vertices, self.weights[:, 2:], self.joints[1:])]

    def surface(self, group: str, rng: np.random.Generator, clusters: int = 0) -> HandSurface:
        """Sample a hand with fingers."""
        mesh, (alignment, bones) = self.simplified(clusters), hand_alignment(self.joints, self.tips())
        points, normals, weights = mesh.sample(rng)
        return HandSurface(group, points, normals, weights, self.joints, alignment, bones, True)

    def sample(self, rng: np.random.Generator):
        """Draw points, with normals and weights."""
        face, share = surface_points.sample_surface(self.vertices, self.faces, POINTS, rng)
        normals = geometry.face_normals(self.vertices, self.faces)[face]
        points, weights = (
            surface_points.at_barycentric(values, self.faces, face, share) for values in (self.vertices, self.weights)
        )
        return points, normals, weights


def farthest_points(
    points: Float[np.ndarray, "N 3"], count: int, first: Int[np.ndarray, " S"]
) -> Int[np.ndarray, " C"]:
    """Choose points that are far from each other, one after the other, beginning with some."""
    chosen = list(first)
    distance = np.linalg.norm(points[:, None] - points[chosen], axis=-1).min(axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def hands_of_people(body: RiggedBody, rng: np.random.Generator, count: int = PEOPLE) -> list[HandMesh]:
    """Make left hands of random people of the shipped body."""
    hands, hand = load_hands(), body.joint("LeftHand")
    total = hand_weight(body, "Left")
    weights = np.concatenate([1 - total[:, None], total[:, None] * hands.shares[0]], axis=1)
    shapes = (SPREAD * rng.normal(size=(count, len(body.components)))).clip(-2.5, 2.5)
    found = []
    for shape in shapes:
        vertices, joints = body.shaped(shape)
        fingers = hands.joints + np.tensordot(shape, hands.joint_components, axes=1)
        found.append(HandMesh.cut(vertices, body.faces, weights, np.stack([joints[hand], *fingers[:15]]), left=True))
    return found


def hands_of_character(character: PoolCharacter, body: RiggedBody) -> list[tuple[HandMesh, bool]]:
    """Cut out both hands of a character as left hands, and tell whether each has fifteen finger joints.

    A hand without joints is the surface that its hand, or else the end of its forearm, moves.
    """
    rig, found = character.rig, []
    for side in SIDES:
        if f"{side}Hand" not in character.joints:
            continue
        hand = character.joints[f"{side}Hand"]
        names = finger_joints(side)
        fingers = [character.fingers[name] for name in names if name in character.fingers]
        whole = len(fingers) == len(names)
        column = np.zeros(len(rig.parents) + 1, int)  # the last entry is the world
        for j in range(len(rig.parents)):
            own = next((k for k in ancestors(rig.parents, j) if k in fingers or k == hand), None)
            column[j] = 0 if own is None else 2 + fingers.index(own) if whole and own in fingers else 1
        weights = np.zeros((len(rig.weights), 17))
        np.add.at(weights, (np.arange(len(weights))[:, None], column[rig.joint_of]), rig.weights)
        joints = rig.joints[[hand, *(fingers if whole else [hand] * 15)]]
        mesh = HandMesh.cut(rig.mesh.vertices, rig.mesh.faces, weights, joints, left=side == "Left")
        if len(mesh.faces):
            found.append((mesh, whole))
    return found


def training_hands(body: RiggedBody, characters: Iterable[PoolCharacter], seed: int = 0) -> list[HandSurface]:
    """Make all hands of a training: of people, of characters, and without fingers."""
    rng = np.random.default_rng(seed)
    people = hands_of_people(body, rng)
    surfaces = [hand.surface(HUMAN, rng, COARSE[k % len(COARSE)]) for k, hand in enumerate(people)]
    for character in characters:
        for mesh, whole in hands_of_character(character, body):
            clusters = COARSE[rng.integers(len(COARSE))]
            pack = character.meta.pack
            surfaces.append(
                mesh.surface(pack, rng, clusters) if whole else _without(*mesh.sample(rng), f"{WITHOUT}, {pack}")
            )
    return surfaces + mittens(people, rng) + stumps(people, rng) + blocks(rng)


def _without(points, normals, weights, group: str = WITHOUT) -> HandSurface:
    """Make a hand without fingers; its joints do not matter."""
    eye = np.tile(np.eye(3), (16, 1, 1))
    return HandSurface(group, points, normals, weights, np.tile(points.mean(axis=0), (16, 1)), eye, eye[:, 0], False)


def posed_hand(hand: HandMesh, local: Float[np.ndarray, "15 3 3"]) -> Float[np.ndarray, "V 3"]:
    """Pose the fingers of a hand of the shipped body."""
    rotmat = np.concatenate([np.tile(np.eye(3), (2, 1, 1)), local])
    parents = (-1, 0, *(1 + parent for parent in HAND_PARENTS[1:]))
    joints = np.concatenate([hand.joints[:1], hand.joints])
    return skin_poses(hand.vertices, hand.weights, *skinning_transforms(joints, rotmat, parents))


def mittens(people: list[HandMesh], rng: np.random.Generator) -> list[HandSurface]:
    """Make mittens: convex hulls of posed hands, in every second one the thumb apart from the four fingers."""
    found = []
    for k in range(MITTENS):
        hand = people[k % len(people)]
        vertices = posed_hand(hand, finger_rotations(sample_finger_poses(1, rng)[0], left=True))
        thumb, fingers = hand.weights[:, 2:5].sum(axis=1), hand.weights[:, 5:].sum(axis=1)
        parts = [vertices[thumb < 0.5], vertices[fingers < 0.3]] if k % 2 else [vertices]
        if k % 3 == 2:  # a mitten of which only the fingers are merged, the palm being as it is
            parts = [vertices[fingers > 0.3], vertices[fingers < 0.3]]
        found.append(_hulls(parts, rng))
    return found


def _hulls(parts: list[np.ndarray], rng: np.random.Generator) -> HandSurface:
    """Sample the surface of the union of convex hulls: the points of each that are in no other."""
    from scipy.spatial import ConvexHull

    hulls = [ConvexHull(part) for part in parts]
    total = sum(hull.area for hull in hulls)
    points, normals = [], []
    for hull in hulls:
        count = round(3 * POINTS * hull.area / total)
        face, share = surface_points.sample_surface(hull.points, hull.simplices, count, rng)
        on = surface_points.at_barycentric(hull.points, hull.simplices, face, share)
        inside = [
            (on @ other.equations[:, :3].T + other.equations[:, 3] < 0).all(axis=1)
            for other in hulls
            if other is not hull
        ]
        outside = ~np.any([np.zeros(len(on), bool), *inside], axis=0)
        points.append(on[outside])
        normals.append(hull.equations[face[outside], :3])
    chosen = rng.integers(sum(map(len, points)), size=POINTS)
    weights = np.tile(np.eye(17)[1], (POINTS, 1))
    return _without(np.concatenate(points)[chosen], np.concatenate(normals)[chosen], weights)


def stumps(people: list[HandMesh], rng: np.random.Generator) -> list[HandSurface]:
    """Make hands that end at the knuckles, or at some of the first joints."""
    found = []
    for k in range(STUMPS):
        hand = people[k % len(people)]
        last = (hand.weights[:, 2:].reshape(-1, 5, 3)[:, :, k % 2 :]).sum(axis=(1, 2)) < 0.5
        faces = hand.faces[last[hand.faces].all(axis=1)]
        points, normals, weights = HandMesh(hand.vertices, faces, hand.weights, hand.joints).sample(rng)
        weights = np.concatenate([weights[:, :1], 1 - weights[:, :1], np.zeros((POINTS, 15))], axis=1)
        found.append(_without(points, normals, weights))
    return found


def blocks(rng: np.random.Generator) -> list[HandSurface]:
    """Make hands of boxes, balls, cylinders and cones, some with a thumb of another one."""
    found: list[HandSurface] = []
    shapes: list[Shape] = [shape for shape in SHAPES if shape != "disc"]
    for _ in range(BLOCKS):
        half = 0.04 * np.exp(rng.normal(0, 0.35, 3)) * (2.0, 1.0, 1.2)
        points, normals = sample_primitive(shapes[rng.integers(len(shapes))], half, POINTS, rng)
        if rng.random() < 0.5:
            thumb, thumb_normals = sample_primitive("ellipsoid", half * (0.5, 0.4, 0.4), POINTS // 6, rng)
            thumb += half * (rng.uniform(-0.5, 0.5), 0.0, 1.2)
            points[: len(thumb)], normals[: len(thumb)] = thumb, thumb_normals
        turn = rotvec_to_rotmat(rng.normal(0, 0.3, (1, 3)))[0]
        weights = np.tile(np.eye(17)[1], (POINTS, 1))
        found.append(_without(points @ turn.T, unit_vectors(normals) @ turn.T, weights))
    return found
