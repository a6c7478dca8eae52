"""Hands for training, all as left hands at rest: of the shipped body and of characters, and hands without fingers.

Hands of characters with fifteen finger joints have known joints and weights. Hands of blocks, mittens (convex hulls of
hands, whole or of the four fingers) and hands without fingers are what the network has to refuse.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from hand_gestures import finger_rotations, fingertips, hand_alignment, sample_finger_poses
from jaxtyping import Float, Int

from mimesh.bodies.body_model import RiggedBody
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.character_pool import PoolCharacter
from mimesh.bodies.hands import HAND_PARENTS, hand_weight, load_hands
from mimesh.bodies.joint_names import finger_joints
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core import geometry, surface_points
from mimesh.core.geometry import MIRROR, unit_vectors
from mimesh.core.skinning import skin_poses, skinning_transforms
from mimesh.learn.data.primitives import SHAPES, Shape, sample_primitive

POINTS = 1000
"""Points that a hand is represented by."""
NEAR_HAND = 0.05
"""Least weight of the hand and its fingers in a vertex of a hand: a bit of the forearm belongs to it."""
PEOPLE, MITTENS, BLOCKS, STUMPS = 48, 48, 40, 16
"""Number of hands of the shipped body, and of each kind of hand without fingers made from them or of primitives."""
SHAPE_SPREAD, LARGEST_SHAPE = 1.3, 2.5
"""Standard deviation of people's shape coefficients, and their largest absolute value (standard deviations of the body
model)."""
CLUSTERS = (0, 0, 300, 170, 120)
"""Clusters of vertices that hands are simplified to in turn; 0 leaves them as they are."""
FINGER_DETAIL = 2.5
"""How many times closer together clusters are on fingers, which would vanish otherwise."""
OF_THUMB, OF_FINGERS = 0.5, 0.3
"""Weight of the thumb, and of the four fingers together, from which on a vertex belongs to them in a mitten."""
BLOCK, BLOCK_ASPECT = 0.04, (2.0, 1.0, 1.2)
"""Half of the usual thickness of a block (metres), and its size along the hand, through the palm and across it in units
of that."""
BLOCK_SPREAD, BLOCK_TURN = 0.35, 0.3
"""Standard deviation of the logarithm of its size, and of the components of its rotation vector (radians)."""
HUMAN, FINGERLESS = "human", "without fingers"
"""Groups of hands beside the packs of a pool."""
FOREARM_COLUMN, HAND_COLUMN = 0, 1
"""Columns of the forearm, with all the rest, and of the hand in the 17 columns of weights."""


@dataclass(frozen=True, eq=False)
class HandSurface:
    """A left hand at rest, in metres or the unit of its file."""

    group: str
    """Hands are drawn by group: the pack of a character, HUMAN, or FINGERLESS, with the pack of hands of characters."""
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    weights: Float[np.ndarray, "N 17"]
    """Weights of the forearm with all the rest, of the hand and of 15 finger joints, rows sum to 1."""
    joints: Float[np.ndarray, "16 3"]
    alignment: Float[np.ndarray, "16 3 3"]
    """Rotation of each joint from the shipped body's hand at rest to this one."""
    bones: Float[np.ndarray, "16 3"]
    """Unit direction of each joint's bone at rest."""
    separate: bool
    """Whether it shows separate fingers, so that joints and weights are known."""


@dataclass(frozen=True, eq=False)
class HandMesh:
    """The part of a mesh around a left hand at rest; for units and columns see `HandSurface`."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    weights: Float[np.ndarray, "V 17"]
    joints: Float[np.ndarray, "16 3"]

    @classmethod
    def cut(
        cls,
        vertices: Float[np.ndarray, "V 3"],
        faces: Int[np.ndarray, "F 3"],
        weights: Float[np.ndarray, "V 17"],
        joints: Float[np.ndarray, "16 3"],
        left: bool,
    ) -> HandMesh:
        """Cut a hand out of a whole mesh: the triangles near it; a right hand is mirrored."""
        near = weights[:, 1:].sum(axis=1) > NEAR_HAND
        faces = faces[near[faces].all(axis=1)]
        kept, flat = np.unique(faces, return_inverse=True)
        faces = flat.reshape(-1, 3)
        mirror = 1.0 if left else MIRROR
        return cls(vertices[kept] * mirror, faces if left else faces[:, ::-1], weights[kept], joints * mirror)

    def simplified(self, clusters: int) -> HandMesh:
        """Merge vertices into clusters around far apart ones; 0 or too many clusters leave the mesh as it is.

        Only vertices with the same strongest joint are merged, so that fingers stay apart.
        """
        if not 0 < clusters < len(self.vertices):
            return self
        strongest = self.weights.argmax(axis=1)
        stretched = self.vertices * np.where(strongest > 1, FINGER_DETAIL, 1.0)[:, None]
        seeds = farthest_points(stretched, clusters, np.unique(strongest, return_index=True)[1])
        distance = np.linalg.norm(self.vertices[:, None] - self.vertices[seeds], axis=-1)
        distance[strongest[:, None] != strongest[seeds]] = np.inf
        cluster = distance.argmin(axis=1)
        count = np.bincount(cluster, minlength=len(seeds))[:, None]
        means = []
        for array in (self.vertices, self.weights):
            total = np.zeros((len(seeds), array.shape[1]))
            np.add.at(total, cluster, array)
            means.append(total / count)
        faces = cluster[self.faces]
        distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        return HandMesh(means[0], faces[distinct], means[1], self.joints)

    def tips(self) -> Float[np.ndarray, "5 3"]:
        """Find the fingertips."""
        return self.vertices[fingertips(self.vertices, self.weights[:, 2:], self.joints[1:])]

    def surface(self, group: str, rng: np.random.Generator, clusters: int = 0) -> HandSurface:
        """Sample a hand with fingers, simplified to a number of clusters."""
        alignment, bones = hand_alignment(self.joints, self.tips())
        points, normals, weights = self.simplified(clusters).sample(rng)
        return HandSurface(group, points, normals, weights, self.joints, alignment, bones, True)

    def sample(
        self, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"], Float[np.ndarray, "N 17"]]:
        """Draw points, even by area, with normals and weights."""
        face, share = surface_points.sample_surface(self.vertices, self.faces, POINTS, rng)
        normals = geometry.face_normals(self.vertices, self.faces)[face]
        points, weights = (
            surface_points.at_barycentric(values, self.faces, face, share) for values in (self.vertices, self.weights)
        )
        return points, normals, weights


def farthest_points(
    points: Float[np.ndarray, "N 3"], count: int, first: Int[np.ndarray, " S"]
) -> Int[np.ndarray, " C"]:
    """Choose points, each the farthest from those before it, beginning with given ones."""
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
    shapes = (SHAPE_SPREAD * rng.normal(size=(count, len(body.components)))).clip(-LARGEST_SHAPE, LARGEST_SHAPE)
    found = []
    for shape in shapes:
        vertices, joints = body.shaped(shape)
        fingers = hands.joints + np.tensordot(shape, hands.joint_components, axes=1)
        found.append(HandMesh.cut(vertices, body.faces, weights, np.stack([joints[hand], *fingers[:15]]), left=True))
    return found


def hands_of_character(character: PoolCharacter) -> list[tuple[HandMesh, bool]]:
    """Cut out both hands of a character as left hands, and tell whether each has fifteen finger joints.

    Without them all finger joints are at the hand, whose surface is all that the hand and joints below it move.
    """
    rig, found = character.rig, []
    for side in SIDES:
        if f"{side}Hand" not in character.joints:
            continue
        hand = character.joints[f"{side}Hand"]
        fingers = [character.fingers[name] for name in finger_joints(side) if name in character.fingers]
        whole = len(fingers) == 15
        column_of = {hand: HAND_COLUMN} | ({joint: 2 + k for k, joint in enumerate(fingers)} if whole else {})
        joints = rig.joints[[hand, *(fingers if whole else [hand] * 15)]]
        weights = rig.summed_weights(rig.nearest_columns(column_of, other=FOREARM_COLUMN), 17)
        mesh = HandMesh.cut(rig.mesh.vertices, rig.mesh.faces, weights, joints, left=side == "Left")
        if len(mesh.faces):
            found.append((mesh, whole))
    return found


def training_hands(body: RiggedBody, characters: Iterable[PoolCharacter], seed: int = 0) -> list[HandSurface]:
    """Make all hands of a training: of people, of characters, and without fingers.

    Args:
        body: the shipped body.
    """
    rng = np.random.default_rng(seed)
    people = hands_of_people(body, rng)
    surfaces = [hand.surface(HUMAN, rng, CLUSTERS[k % len(CLUSTERS)]) for k, hand in enumerate(people)]
    for character in characters:
        pack = character.meta.pack
        for mesh, whole in hands_of_character(character):
            clusters = CLUSTERS[rng.integers(len(CLUSTERS))]
            surfaces.append(
                mesh.surface(pack, rng, clusters) if whole else _fingerless(*mesh.sample(rng), f"{FINGERLESS}, {pack}")
            )
    return surfaces + mittens(people, rng) + stumps(people, rng) + blocks(rng)


def _fingerless(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    weights: Float[np.ndarray, "N 17"] | None = None,
    group: str = FINGERLESS,
) -> HandSurface:
    """Make a hand without fingers, by default without a forearm; its joints do not matter."""
    weights = np.tile(np.eye(17)[HAND_COLUMN], (len(points), 1)) if weights is None else weights
    eye = np.tile(np.eye(3), (16, 1, 1))
    return HandSurface(group, points, normals, weights, np.tile(points.mean(axis=0), (16, 1)), eye, eye[:, 0], False)


def posed_hand(hand: HandMesh, local: Float[np.ndarray, "15 3 3"]) -> Float[np.ndarray, "V 3"]:
    """Pose the fingers of a hand of the shipped body by local rotations: its vertices."""
    # The forearm, of the first column of weights, is a joint above the hand; both stay at rest.
    rotmat = np.concatenate([np.tile(np.eye(3), (2, 1, 1)), local])
    parents = (-1, 0, *(1 + parent for parent in HAND_PARENTS[1:]))
    joints = np.concatenate([hand.joints[:1], hand.joints])
    return skin_poses(hand.vertices, hand.weights, *skinning_transforms(joints, rotmat, parents))


def mittens(people: list[HandMesh], rng: np.random.Generator) -> list[HandSurface]:
    """Make mittens: unions of convex hulls of parts of posed hands, which are cut in three ways in turn."""
    found = []
    for k in range(MITTENS):
        hand = people[k % len(people)]
        vertices = posed_hand(hand, finger_rotations(sample_finger_poses(1, rng)[0], left=True))
        thumb, fingers = hand.weights[:, 2:5].sum(axis=1), hand.weights[:, 5:].sum(axis=1)
        if k % 3 == 2:  # the four fingers apart from palm and thumb
            parts = [vertices[fingers > OF_FINGERS], vertices[fingers < OF_FINGERS]]
        elif k % 2:  # thumb and fingers apart, both with the palm
            parts = [vertices[thumb < OF_THUMB], vertices[fingers < OF_FINGERS]]
        else:
            parts = [vertices]
        found.append(_hulls(parts, rng))
    return found


def _hulls(parts: list[Float[np.ndarray, "_ 3"]], rng: np.random.Generator) -> HandSurface:
    """Make a hand of the union of convex hulls: of points of each that are in no other."""
    from scipy.spatial import ConvexHull

    hulls = [ConvexHull(part) for part in parts]
    total = sum(hull.area for hull in hulls)
    points, normals = [], []
    for hull in hulls:
        count = round(3 * POINTS * hull.area / total)  # more than needed, as those in other hulls are left out
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
    return _fingerless(np.concatenate(points)[chosen], np.concatenate(normals)[chosen])


def stumps(people: list[HandMesh], rng: np.random.Generator) -> list[HandSurface]:
    """Make hands whose fingers end at the first joints (the knuckles) or, every other one, at the second joints."""
    found = []
    for k in range(STUMPS):
        hand = people[k % len(people)]
        beyond = hand.weights[:, 2:].reshape(-1, 5, 3)[:, :, k % 2 :].sum(axis=(1, 2))
        faces = hand.faces[(beyond < 0.5)[hand.faces].all(axis=1)]
        points, normals, weights = dataclasses.replace(hand, faces=faces).sample(rng)
        weights = np.concatenate([weights[:, :1], 1 - weights[:, :1], np.zeros((POINTS, 15))], axis=1)
        found.append(_fingerless(points, normals, weights))
    return found


def blocks(rng: np.random.Generator) -> list[HandSurface]:
    """Make hands of boxes, balls, cylinders and cones, half of them with a thumb: an ellipsoid on the front."""
    found: list[HandSurface] = []
    shapes: list[Shape] = [shape for shape in SHAPES if shape != "disc"]
    for _ in range(BLOCKS):
        half = BLOCK * np.exp(rng.normal(0, BLOCK_SPREAD, 3)) * BLOCK_ASPECT
        points, normals = sample_primitive(shapes[rng.integers(len(shapes))], half, POINTS, rng)
        if rng.random() < 0.5:
            thumb, thumb_normals = sample_primitive("ellipsoid", half * (0.5, 0.4, 0.4), POINTS // 6, rng)
            thumb += half * (rng.uniform(-0.5, 0.5), 0.0, 1.2)
            points[: len(thumb)], normals[: len(thumb)] = thumb, thumb_normals
        turn = rotvec_to_rotmat(rng.normal(0, BLOCK_TURN, (1, 3)))[0]
        found.append(_fingerless(points @ turn.T, unit_vectors(normals) @ turn.T))
    return found
