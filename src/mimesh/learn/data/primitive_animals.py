"""Four-legged animals made of primitives, for training: figures of blocks, toys, and what else has four legs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from ...bodies import RiggedBody
from ...bodies.animal_limbs import LEGS, NECK, TAIL, TRUNK
from ...bodies.character_limbs import SIDES
from ...bodies.sampling import rotvec_to_rotmat
from ...motions.animal_rig import rest_directions
from .characters import CharacterSurface
from .primitives import SHAPES, Primitive, Shape, assemble, bone, boxes_on, draw_shape

ANIMALS, BLOCKS = 256, 0.5
"""Number of animals of primitives, and the share of figures of boxes among them."""
ONE_BONE, TWO_BONES = 0.35, 0.4
"""Share of animals whose legs have one joint, and of those with an elbow or a knee alone."""
Joints = dict[str, Float[np.ndarray, " 3"]]


@cache
def primitive_animals(body: RiggedBody) -> tuple[CharacterSurface, ...]:
    """Make the animals of primitives that count as one more pack beside those of a folder; see `primitive_people`."""
    return tuple(primitive_animal(body, np.random.default_rng(k)) for k in range(ANIMALS))


def primitive_animal(body: RiggedBody, rng: np.random.Generator) -> CharacterSurface:
    """Make an animal of primitives, each moved by one joint.

    Legs are long or short, bent or straight, of one to four bones; necks and tails point anywhere up and down; heads
    have boxes for ears, horns and hair.
    """
    style = _Style.random(rng)
    places = _places(body, rng)
    has = _random_joints(rng)
    turns = rest_directions({name: places[name] for name in places if name in has}, 0.0, body)
    alignment = np.stack([turns.get(name, np.eye(3)) for name in body.joint_names])
    parts = [*_legs(body, places, has, style, rng), *_trunk(body, places, has, style, rng)]
    parts += [*_head(body, places, has, style, rng), *_tail(body, places, has, style, rng)]
    joints = np.stack([places[name] for name in body.joint_names])
    return assemble(parts, body, joints, alignment, has, rng)


@dataclass(frozen=True)
class _Style:
    """What the primitives of an animal have in common."""

    shapes: tuple[Shape, ...]
    """Shapes that legs, trunk and head are drawn from."""
    leg: float
    """Half of the width of a leg (metres)."""
    trunk: Float[np.ndarray, " 2"]
    """Half of the width and of the height of the trunk (metres)."""
    head: Float[np.ndarray, " 3"]
    """Half of the size of the head (metres)."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> _Style:
        """Draw a figure of boxes, or one of mixed primitives."""
        blocks = rng.random() < BLOCKS
        leg = np.exp(rng.uniform(*np.log((0.02, 0.1 if blocks else 0.05))))
        trunk = np.exp(rng.uniform(np.log(0.07), np.log(0.24), 2) * [1.0, 0.9])
        head = np.array([0.08, 0.08, 0.1]) * np.exp(rng.uniform(-0.3, 0.7) + rng.normal(0, 0.2, 3))
        return cls(("box",) if blocks else SHAPES[:3], leg, trunk, head)


def _places(body: RiggedBody, rng: np.random.Generator) -> Joints:
    """Draw the joints at rest: the shipped quadruped's with other lengths, straighter legs, neck and tail turned."""
    names, rest = body.joint_names, body.joints
    local = np.array([rest[j] - rest[p] if p >= 0 else rest[j] for j, p in enumerate(body.parents)])
    of_leg = [name.removeprefix("Left").removeprefix("Right") for name in names]
    scale = {part: np.exp(rng.normal(0, 0.3)) for part in ("trunk", "neck", "tail")}
    kinds = {
        **dict.fromkeys(TRUNK, "trunk"),
        **dict.fromkeys((*NECK[1:], "Head"), "neck"),
        **dict.fromkeys(TAIL[1:], "tail"),
    }
    straight, width = rng.random() ** 2 if rng.random() < 0.4 else 1.0, np.exp(rng.normal(0, 0.4))
    turns = {"Neck1": rng.uniform(-30, 45), "Tail1": rng.uniform(-80, 60)}
    world = np.tile(np.eye(3), (len(names), 1, 1))
    points = np.zeros_like(rest)
    for j, (name, parent) in enumerate(zip(names, body.parents, strict=True)):
        above = world[parent] if parent >= 0 else np.eye(3)
        turned = rotvec_to_rotmat(np.radians([turns.get(name, 0.0), 0, 0]))
        offset = local[j] * scale.get(kinds.get(name, ""), 1.0)
        if of_leg[j] in (LEGS["front"][0], LEGS["hind"][0]):
            offset = offset * [width, 1, 1]
        points[j] = points[parent] + above @ offset if parent >= 0 else offset
        world[j] = above @ turned
    places = dict(zip(names, points, strict=True))
    length = np.exp(rng.uniform(-1.0, 0.3))
    for side in SIDES:
        for chain in LEGS.values():
            top = places[side + chain[0]]
            for part in chain[1:]:
                offset = rest[names.index(side + part)] - rest[names.index(side + chain[0])]
                down = np.array([0.0, -np.linalg.norm(offset), 0.0])
                places[side + part] = top + straight * length * offset + (1 - straight) * length * down
    # Feet stand on the ground: forelegs and hind legs are made to reach it alike.
    ends = {kind: places["Left" + chain[-1]][1] for kind, chain in LEGS.items()}
    lift = 0.04 - min(ends.values())
    return {name: point + [0, lift, 0] for name, point in places.items()}


def _random_joints(rng: np.random.Generator) -> set[str]:
    kind = rng.random()
    bones = 1 if kind < ONE_BONE else 2 if kind < ONE_BONE + TWO_BONES else 3
    has = {"Hips", *(side + part for side in SIDES for chain in LEGS.values() for part in chain[:bones])}
    if bones > 1 and rng.random() < 0.5:
        has |= {side + chain[-1] for side in SIDES for chain in LEGS.values()}
    trunk = rng.random()
    has |= set() if trunk < 0.3 else {"Chest"} if trunk < 0.6 else {"Spine1"} if trunk < 0.75 else {"Spine2", "Chest"}
    neck = rng.random()
    has |= {"Head"} if neck < 0.3 else {"Neck1", "Head"} if neck < 0.8 else {*NECK[:2], "Head"}
    tail = int(rng.integers(0, 5))
    return has | {TAIL[k] for k in np.linspace(0, len(TAIL), tail, endpoint=False).astype(int)}


def _legs(
    body: RiggedBody, places: Mapping[str, np.ndarray], has: set[str], style: _Style, rng: np.random.Generator
) -> list[Primitive]:
    """Make a primitive for each bone of a leg that the animal has; left and right are alike."""
    shape, parts = draw_shape(style.shapes, rng), []
    for chain in LEGS.values():
        widths = style.leg * np.exp(
            rng.normal(0, 0.15, (len(chain), 2)) + np.linspace(0.25, -0.15, len(chain))[:, None]
        )
        foot = rng.uniform(0.6, 2.0)
        for side in SIDES:
            had = [part for part in chain if side + part in has]
            points = [places[side + part] for part in had]
            sole = places[side + chain[-1]] * [1, 0, 1]
            for k, part in enumerate(had):
                end = points[k + 1] if k + 1 < len(had) else sole
                parts.append(bone(points[k], end, widths[k], shape, body.joint(side + part)))
            size = np.array([widths[-1][0] * 1.2, 0.02, widths[-1][1] * 1.2 * foot])
            parts.append(Primitive("box", body.joint(side + had[-1]), sole + [0, 0.02, size[2] * 0.4], np.eye(3), size))
    return parts


def _trunk(
    body: RiggedBody, places: Mapping[str, np.ndarray], has: set[str], style: _Style, rng: np.random.Generator
) -> list[Primitive]:
    """Make the trunk, of one or two primitives from behind the hind legs to before the forelegs."""
    hind, front = ((places["Left" + LEGS[pair][0]] + places["Right" + LEGS[pair][0]]) / 2 for pair in ("hind", "front"))
    along = unit = front - hind
    unit = unit / np.linalg.norm(unit)
    margin = rng.uniform(0.03, 0.12)
    up = np.array([0.0, rng.uniform(0.0, 0.8) * style.trunk[1], 0.0])
    start, end, middle = (
        hind - margin * unit + up,
        front + margin * unit + up,
        hind + rng.uniform(0.35, 0.65) * along + up,
    )
    own = [name for name in TRUNK if name in has]
    shape = draw_shape(style.shapes, rng)
    if not own:
        return [bone(start, end, style.trunk, shape, body.joint("Hips"))]
    if own == ["Spine1"]:
        return [bone(start, end, style.trunk, shape, body.joint("Spine1"))]
    wider = style.trunk * np.exp(rng.normal(0, 0.12, 2))
    return [
        bone(start, middle, style.trunk, shape, body.joint("Hips")),
        bone(middle - 0.02 * unit, end, wider, shape, body.joint(own[-1])),
    ]


def _head(
    body: RiggedBody, places: Mapping[str, np.ndarray], has: set[str], style: _Style, rng: np.random.Generator
) -> list[Primitive]:
    head, size, parts = body.joint("Head"), style.head, []
    centre = places["Head"] + [0, 0.0, 0.6 * size[2]]
    carriers = [name for name in NECK if name in has]
    width = min(size[0], style.trunk[0]) * rng.uniform(0.4, 0.9, 2)
    chest = next((name for name in reversed(TRUNK) if name in has), "Hips")
    stops = [places[name] for name in carriers] or [places["Neck1"]]
    shape = draw_shape(style.shapes, rng)
    for k, start in enumerate(stops):
        end = stops[k + 1] if k + 1 < len(stops) else centre
        joint = body.joint(carriers[k]) if carriers else (head if rng.random() < 0.5 else body.joint(chest))
        parts.append(bone(start, end, width, shape, joint))
    skull = Primitive(draw_shape(style.shapes, rng), head, centre, np.eye(3), size)
    parts.append(skull)
    if rng.random() < 0.7:
        muzzle = size * np.array([rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.7), rng.uniform(0.4, 1.3)])
        place = centre + [0, -0.4 * size[1], size[2] + 0.5 * muzzle[2]]
        parts.append(Primitive(draw_shape(style.shapes, rng), head, place, np.eye(3), muzzle))
    return parts + boxes_on(skull, int(rng.integers(5)), up=1.0, largest=0.7, paired=0.6, rng=rng)


def _tail(
    body: RiggedBody, places: Mapping[str, np.ndarray], has: set[str], style: _Style, rng: np.random.Generator
) -> list[Primitive]:
    own = [name for name in TAIL if name in has]
    last = 2 * places[TAIL[-1]] - places[TAIL[-2]]
    stops, width = [places[name] for name in own] + [last], style.leg * rng.uniform(0.4, 1.0, 2)
    shape = draw_shape(style.shapes, rng)
    return [bone(stops[k], stops[k + 1], width, shape, body.joint(name)) for k, name in enumerate(own)]
