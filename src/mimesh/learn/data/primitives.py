"""Boxes, ellipsoids, cylinders, cones and capsules as points with normals, and people made of them, for training.

People of primitives stand for figures of blocks, for mannequins of separate shells and for anything else that has the
limbs of a person and no skin: toys, robots, snowmen.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...bodies import RiggedBody
from ...bodies.character_limbs import SIDES
from ...bodies.sampling import rotvec_to_rotmat
from ...core.geometry import rotation_between, unit_vectors
from .characters import POINTS, CharacterSurface

Shape = Literal["box", "ellipsoid", "cylinder", "cone", "disc"]
SHAPES: tuple[Shape, ...] = ("box", "ellipsoid", "cylinder", "cone", "disc")
PEOPLE, BLOCK_FIGURES = 256, 0.4
"""Number of people of primitives beside the characters of a folder, and the share of figures of blocks among them."""
PACK = "primitives"
"""Name under which people of primitives are sampled beside the packs of a pool."""
LIMBS = {"Arm": ("ForeArm", "Hand"), "ForeArm": ("Hand", "Hand"), "UpLeg": ("Leg", "Foot"), "Leg": ("Foot", "Foot")}
"""Limb joints without their side, the joint at the other end, and the one at the end of a limb without that joint."""
LIMB_ENDS = (("ForeArm", "Hand"), ("Leg", "Foot"))
"""Joints without their side that limbs of one joint lack."""
DETAILS = ("HipJoint", "Thumb", "FingerBase", "HandFinger1", "ToeBase", "Shoulder", "Neck1")
"""Joints that no person of primitives has."""
Points = tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]


def sample_primitive(shape: Shape, half: Float[np.ndarray, " 3"], count: int, rng: np.random.Generator) -> Points:
    """Draw points, about evenly spread, and unit normals of a primitive centred at the origin.

    Cylinders, cones and discs stand along y.

    Args:
        half: half of its size along x, y and z.
    """
    x, y, z = half
    up = np.array([0.0, 1.0, 0.0])
    if shape == "ellipsoid":
        points = normals = unit_vectors(rng.normal(size=(count, 3)))
    elif shape == "box":
        areas = np.array([y * z, x * z, x * y])
        axis, sign = rng.choice(3, count, p=areas / areas.sum()), rng.choice([-1.0, 1.0], count)
        normals = np.eye(3)[axis] * sign[:, None]
        points = np.where(normals != 0, normals, rng.uniform(-1, 1, (count, 3)))
    else:
        angle, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(-1, 1, count)
        lids = x * z * (1 if shape == "cone" else 2)
        side = 2 * y * np.hypot(x, z) / np.sqrt(2) * (1 if shape == "cone" else 2)
        on_lid = (rng.random(count) < lids / (lids + side)) | (shape == "disc")
        top = (rng.random(count) < 0.5) & (shape != "cone")
        if shape == "cone":  # its surface grows towards the base, at y = -1
            height = 1 - 2 * np.sqrt(rng.random(count))
        radius = (1 - height) / 2 if shape == "cone" else 1.0
        radius = np.where(on_lid, np.sqrt(rng.random(count)), radius)
        lid = np.where(top, 1.0, -1.0)
        around = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
        points = around * radius[:, None] + up * np.where(on_lid, lid * (shape != "disc"), height)[:, None]
        normals = np.where(on_lid[:, None], up * lid[:, None], around + 0.5 * up * (shape == "cone"))
    return points * half, unit_vectors(normals / half)


@dataclass(frozen=True)
class Primitive:
    """A primitive that one joint moves."""

    shape: Shape
    joint: int
    centre: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "3 3"]
    """Unit vectors of its x, y and z in columns."""
    half: Float[np.ndarray, " 3"]
    """Half of its size along them (metres)."""

    @property
    def area(self) -> float:
        """Area of the box around it (square metres)."""
        x, y, z = self.half
        return float(8 * (x * y + y * z + z * x))

    def sample(self, count: int, rng: np.random.Generator) -> Points:
        """Draw points of its surface and their normals."""
        points, normals = sample_primitive(self.shape, self.half, count, rng)
        return self.centre + points @ self.axes.T, normals @ self.axes.T


def draw_shape(shapes: tuple[Shape, ...], rng: np.random.Generator) -> Shape:
    """Draw one of some shapes."""
    return shapes[rng.integers(len(shapes))]


def bone(
    start: Float[np.ndarray, " 3"],
    end: Float[np.ndarray, " 3"],
    width: Float[np.ndarray, " 2"],
    shape: Shape,
    joint: int,
    overlap: float = 1.0,
) -> Primitive:
    """Make a primitive along a bone, `overlap` times as long."""
    along = end - start
    half = np.array([width[0], max(overlap * np.linalg.norm(along) / 2, 1e-3), width[1]])
    return Primitive(shape, joint, (start + end) / 2, rotation_between(np.array([0.0, 1.0, 0.0]), along), half)


def boxes_on(
    head: Primitive, count: int, up: float, largest: float, paired: float, rng: np.random.Generator
) -> list[Primitive]:
    """Put boxes somewhere on the surface of a head: hair, ears, horns, hats and noses are there.

    Args:
        up: by which their directions lean upwards.
        largest: size of the largest, beside that of the head.
        paired: share of them that come in pairs, left and right.
    """
    boxes = []
    for _ in range(count):
        direction = rng.normal(size=3) + [0, up, 0]
        place, half = head.half * direction / np.abs(direction).max(), head.half * rng.uniform(0.1, largest, 3)
        for side in (1.0, -1.0) if rng.random() < paired else (1.0,):
            boxes.append(Primitive("box", head.joint, head.centre + place * [side, 1, 1], np.eye(3), half))
    return boxes


def assemble(
    parts: Sequence[Primitive],
    body: RiggedBody,
    joints: Float[np.ndarray, "J 3"],
    alignment: Float[np.ndarray, "J 3 3"],
    has: Set[str],
    rng: np.random.Generator,
) -> CharacterSurface:
    """Make a figure of primitives.

    Args:
        joints: of the shipped body, at rest.
        alignment: rotation of each from the shipped body's rest pose to the figure's.
        has: names of the joints that the figure has.
    """
    carrier = body.carriers(has)
    area = np.array([part.area for part in parts])
    which = rng.choice(len(parts), POINTS, p=area / area.sum())
    points, normals = np.empty((2, POINTS, 3))
    for k, part in enumerate(parts):
        points[which == k], normals[which == k] = part.sample(int((which == k).sum()), rng)
    return CharacterSurface(
        pack=PACK,
        points=points,
        normals=normals,
        weights=np.eye(len(body.parents))[carrier[np.array([part.joint for part in parts])[which]]],
        joints=joints,
        alignment=alignment[carrier],
        carrier=carrier,
        placed=np.array([name in has for name in body.joint_names]),
    )


@cache
def primitive_people(body: RiggedBody) -> tuple[CharacterSurface, ...]:
    """Make the people of primitives that count as one more pack beside the characters of a folder.

    They take a second, and training and validation have the same ones.
    """
    return tuple(primitive_person(body, np.random.default_rng(k)) for k in range(PEOPLE))


def primitive_person(body: RiggedBody, rng: np.random.Generator) -> CharacterSurface:
    """Make a person of primitives, each moved by one joint, with the body's joints at rest and random girths.

    Arms rest anywhere between a T-pose and hanging; some people have limbs of one joint, a stiff trunk, no hands or no
    feet. Lengths are varied later, as those of all characters.
    """
    style = _Style.random(rng)
    has = _random_joints(body, style, rng)
    alignment, joints = _rest(body, rng.uniform(0, 1.4) * (rng.random() < 0.7), style.limb_length)
    parts = _limbs(body, joints, has, style, rng)
    for part, offset, size in (
        ("Hand", (0.07, 0.0, 0.0), (0.08, 0.03, 0.05)),
        ("Foot", (0.0, -0.03, 0.06), (0.05, 0.04, 0.12)),
    ):
        shape, scale = draw_shape(style.shapes[:2], rng), np.exp(rng.normal(0, 0.35, 3))
        for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
            if side + part in has:
                j = body.joint(side + part)
                centre = joints[j] + alignment[j] @ (np.array(offset) * [sign, 1, 1] * scale)
                parts.append(Primitive(shape, j, centre, alignment[j], np.array(size) * scale))
    parts += _trunk(body, joints, has, style, rng) + _head(body, joints, style, rng)
    return assemble(parts, body, joints, alignment, has, rng)


@dataclass(frozen=True)
class _Style:
    """What the primitives of a person have in common."""

    shapes: tuple[Shape, ...]
    """Shapes that limbs, trunk and head are drawn from."""
    girth: float
    """Half of the width of an arm (metres)."""
    head: Float[np.ndarray, " 3"]
    """Half of the size of the head (metres)."""
    one_joint: float
    """Probability of arms of one joint, and of such legs."""
    pieces: int
    """Number of boxes on the head: hair, ears, horns, hats."""
    limb_length: float
    """Length of arms and legs beside the body's."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> _Style:
        """Draw a figure of blocks, or a person of mixed primitives."""
        if rng.random() < BLOCK_FIGURES:
            head = np.exp(rng.uniform(*np.log((0.1, 0.22))) + rng.normal(0, 0.1, 3))
            girth, limb_length = np.exp(rng.uniform(*np.log(((0.04, 0.35), (0.1, 1.0)))))
            return cls(("box",), girth, head, 0.7, int(rng.integers(5)), limb_length)
        large = np.exp(rng.uniform(-0.1, 1.1) * (rng.random() < 0.5) + rng.normal(0, 0.15, 3))
        return cls(SHAPES[:3], 0.05 * np.exp(rng.normal(0, 0.4)), np.array([0.08, 0.12, 0.1]) * large, 0.3, 0, 1.0)


def _random_joints(body: RiggedBody, style: _Style, rng: np.random.Generator) -> set[str]:
    has = {name for name in body.joint_names if not name.endswith(DETAILS)}
    dropped = {**dict.fromkeys(LIMB_ENDS, style.one_joint), ("Hand",): 0.2, ("Foot",): 0.2}
    dropped |= {("LowerBack", "Spine"): 0.5, ("Spine1",): 0.3, ("Neck",): 0.5}
    for parts, share in dropped.items():
        if rng.random() < share:
            has -= {name for name in has if name.removeprefix("Left").removeprefix("Right") in parts}
    return has


def _rest(
    body: RiggedBody, lowered: float, limb_length: float
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]:
    """Compute rotations and positions of the body's joints with arms lowered by an angle (radians), limbs scaled."""
    local = np.zeros((len(body.parents), 3))
    local[body.joint("LeftArm"), 2], local[body.joint("RightArm"), 2] = -lowered, lowered
    joints = body.joints.copy()
    for j, parent in enumerate(body.parents):
        if j:
            of_limb = body.joint_names[parent].endswith(tuple(LIMBS))
            joints[j] = joints[parent] + (limb_length if of_limb else 1.0) * (body.joints[j] - body.joints[parent])
    rotation, translation = body.skinning_transforms(joints, rotvec_to_rotmat(local))
    return rotation, np.einsum("jkl,jl->jk", rotation, joints) + translation


def _limbs(
    body: RiggedBody, joints: Float[np.ndarray, "J 3"], has: set[str], style: _Style, rng: np.random.Generator
) -> list[Primitive]:
    """Make a primitive for each limb joint, as long as its bone; left and right are alike."""
    shape, parts = draw_shape(style.shapes, rng), []
    for part, (tail, last) in LIMBS.items():
        width = style.girth * (1.4 if part.endswith("Leg") else 1.0) * np.exp(rng.normal(0, 0.2, 2))
        overlap = rng.uniform(0.8, 1.15)
        for side in SIDES:
            if side + part in has:
                start = joints[body.joint(side + part)]
                end = joints[body.joint(side + (tail if side + tail in has else last))]
                parts.append(bone(start, end, width, shape, body.joint(side + part), overlap))
    return parts


def _trunk(
    body: RiggedBody, joints: Float[np.ndarray, "J 3"], has: set[str], style: _Style, rng: np.random.Generator
) -> list[Primitive]:
    hips, chest = body.joint("Hips"), body.joint("Spine1")
    shoulders = (joints[body.joint("LeftArm")] + joints[body.joint("RightArm")]) / 2
    legs = (joints[body.joint("LeftUpLeg")] + joints[body.joint("RightUpLeg")]) / 2
    width = np.ptp(joints[[body.joint("LeftArm"), body.joint("RightArm")], 0]) / 2 * rng.uniform(0.6, 1.1)
    depth, shape = 0.11 * np.exp(rng.normal(0, 0.3)), draw_shape(style.shapes, rng)
    cuts = [(hips, legs - [0, 0.06, 0], shoulders)]
    if "Spine1" in has:
        middle = legs + rng.uniform(0.3, 0.6) * (shoulders - legs)
        cuts = [(hips, cuts[0][1], middle), (chest, middle, shoulders + [0, 0.05, 0])]
    parts = []
    for joint, low, high in cuts:
        half = np.array([width * rng.uniform(0.7, 1.0), (high - low)[1] / 2, depth])
        parts.append(Primitive(shape, joint, (low + high) / 2, np.eye(3), half))
    return parts


def _head(
    body: RiggedBody, joints: Float[np.ndarray, "J 3"], style: _Style, rng: np.random.Generator
) -> list[Primitive]:
    joint = body.joint("Head")
    centre = joints[joint] + [0, 0.8 * style.head[1], 0.02]
    head = Primitive(draw_shape(style.shapes, rng), joint, centre, np.eye(3), style.head)
    return [head, *boxes_on(head, style.pieces, up=0.0, largest=0.9, paired=0.5, rng=rng)]
