"""A rigged four-legged animal of any maker, whose joints are known, and how its rest pose differs from the shipped one.

The same as `humanoid_rig` for another body: A_j (`frames`) takes the shipped quadruped's rest pose to the animal's.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody, load_body
from ..bodies.anatomy import QUADRUPED
from ..bodies.animal_limbs import LEGS, LOOSE_FOOT, NECK, TAIL, name_animal_joints, named_tail
from ..bodies.character_limbs import SIDES, moves_vertices, with_parents
from ..bodies.character_pool import FACING, facing_rotation
from ..bodies.joint_names import ancestors
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.geometry import rotation_between
from ..core.rig import leg_length
from .humanoid_rig import HumanoidRig

CHAINS = tuple(tuple(side + part for part in parts) for side in SIDES for parts in LEGS.values())
"""Joints of each leg from the top."""
LEG_WORDS = {"front": re.compile("front|fore"), "hind": re.compile("back|hind|rear")}
"""Words in the names of the joints of forelegs and of hind legs."""


@dataclass(frozen=True, eq=False)
class AnimalRig(HumanoidRig):
    """An animal at rest with its known joints, in the axes and unit of its file; `limbs` is empty."""

    body_name: ClassVar[str] = "quadruped"
    stands: ClassVar[frozenset[str]] = frozenset(itertools.chain(*CHAINS, TAIL))
    """Animals rest on their feet, and how their bones lie in their legs differs from rig to rig. Tails hang in ways of
    their own, too: with them PMD from the rotations of the bones by name fell from 68 to 60 (docs/log/animals.md).
    Necks are not among them: 135, as heads then miss the ground or the height that the driving's reach."""

    @property
    def person(self) -> tuple[str, ...]:
        """Names of the joints that are known, parents before their children."""
        return tuple(name for name in self.body.joint_names if name in self.joints)

    @property
    def leg(self) -> float:
        """Mean length of the legs from the top to wrist or ankle, from all bones down to the ground."""
        body, facing = self.body, self.character.turned(self.turn)
        ground = facing.mesh.vertices[:, 1].min()
        lengths, whole = [], []
        for chain in CHAINS:
            points = [facing.joints[self.joints[name]] for name in chain if name in self.joints]
            lengths.append(_length([*points, points[-1] * [1, 0, 1] + [0, ground, 0]]))
            own = [body.joints[body.joint(name)] for name in chain]
            whole.append(_length([*own, own[-1] * [1, 0, 1]]))
        indices = tuple(tuple(body.joint(name) for name in leg) for leg in QUADRUPED.legs)
        return float(np.mean(lengths) * leg_length(body.joints, indices) / np.mean(whole))

    @property
    def whole_limbs(self) -> dict[str, str]:
        """Joints of legs that stand for several of the shipped quadruped's, and the joint at the other end of them."""
        found = {}
        for chain in CHAINS:
            had = [k for k, name in enumerate(chain) if name in self.joints]
            for k, after in zip(had, [*had[1:], len(chain)], strict=True):
                end = min(after, len(chain) - 1)
                if end > k + 1 or (after == len(chain) and end > k):
                    found[chain[k]] = chain[end]
        return found


def animal_rig(
    character: SkinnedCharacter, turn: Float[np.ndarray, "3 3"], path: object
) -> tuple[AnimalRig, list[int]]:
    """Find the joints of an animal and how they rest; feet on roots of their own become children of their legs.

    Args:
        character: at rest, in the axes of its file.
        turn: rotation after which y is up and it faces +z.
        path: in error messages.

    Returns the rig, and the order of its joints: joint k is joint `order[k]` of `character`.
    """
    facing = character.turned(turn)
    joints = name_animal_joints(facing, path)
    facing, joints, order = with_parents(facing, joints, _attached(facing, joints, path))
    positions = {name: facing.joints[joint] for name, joint in joints.items()}
    turned = rest_directions(positions, float(facing.mesh.vertices[:, 1].min()), load_body("quadruped"))
    frames = {name: turn.T @ turned.get(name, np.eye(3)) for name in joints}
    return AnimalRig(facing.turned(turn.T), joints, frames, {}, turn), order.tolist()


def _attached(rig: SkinnedCharacter, joints: Mapping[str, int], path: object) -> list[int]:
    """Return the parents of all joints, those of feet on roots of their own being the ends of their legs."""
    parents = rig.parents
    attached, trunk = list(parents), ancestors(parents, joints["Hips"])
    tops, ends = [], []
    for chain in CHAINS:
        own = [joints[name] for name in chain if name in joints]
        tops.append(own[0])
        ends.append(own[-1])
        for above, below in itertools.pairwise(own):
            own_above = ancestors(attached, above)
            apart = [j for j in ancestors(attached, below) if j not in trunk and j not in own_above]
            if not apart:
                raise InputError(
                    f"{path}: expected legs that are chains of joints, found one upside down; is it an animal?"
                )
            if above not in ancestors(attached, below):
                attached[apart[-1]] = above
    known = {above for joint in joints.values() for above in ancestors(parents, joint)}
    low, high = rig.mesh.vertices[:, 1].min(), rig.mesh.vertices[:, 1].max()
    for foot in np.flatnonzero(moves_vertices(rig) & (rig.joints[:, 1] < low + LOOSE_FOOT * (high - low))):
        if foot not in known and parents[foot] in (-1, *trunk):  # the leg carries more of the foot than its own joint
            distance = np.linalg.norm(rig.joints[ends] - rig.joints[foot], axis=1)
            nearest = int(distance.argmin())
            loose = foot not in ancestors(attached, ends[nearest])
            if loose and distance[nearest] < rig.joints[tops[nearest], 1] - low:
                attached[foot] = ends[nearest]
    return attached


def _length(points: list[Float[np.ndarray, " 3"]]) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def rest_directions(
    positions: Mapping[str, Float[np.ndarray, " 3"]], ground: float, body: RiggedBody
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute how joints of legs, neck and tail are turned from the shipped quadruped's rest pose to an animal's.

    A joint's direction is that to the next one of its chain that the animal has, of the last one of a leg to the
    ground. Feet on the ground, the trunk and the head keep the world's axes.

    Args:
        positions: of the joints that the animal has, at rest, y up, facing +z.
        ground: height of the ground.
    """
    turned = {}
    for chain in (*CHAINS, (*NECK, "Head"), TAIL):
        had = [name for name in chain if name in positions]
        theirs = np.array([positions[name] for name in had]).reshape(-1, 3)
        ours = body.joints[[body.joint(name) for name in had]]
        if chain in CHAINS:
            toes = body.joints[body.joint(chain[-1])] * [1, 0, 1]
            theirs = np.concatenate([theirs, theirs[-1:] * [1, 0, 1] + [0, ground, 0]])
            ours = np.concatenate([ours, [toes]])
            had = had[:-1] if had[-1] == chain[-1] else had
        for k, name in enumerate(had[: len(theirs) - 1]):
            turned[name] = rotation_between(ours[k + 1] - ours[k], theirs[k + 1] - theirs[k])
        if chain == TAIL and len(had) > 1:
            turned[had[-1]] = turned[had[-2]]
    return turned


def animal_facing(rig: SkinnedCharacter, path: object) -> str:
    """Find where an animal faces: where the largest part that sticks out from its legs, the head, is in front.

    Names of legs are believed first (leg-front-left), and a tail that has this name is behind.

    Raises:
        InputError: there are no four legs on one skeleton, whatever it faces.
    """
    scores, reasons = {}, []
    for facing in filter(None, FACING):
        turned = rig.turned(facing_rotation(facing))
        try:
            joints = name_animal_joints(turned, path)
        except InputError as error:
            reasons.append(error)
            continue
        tops = {pair: [joints[side + parts[0]] for side in SIDES] for pair, parts in LEGS.items()}
        names = [(pair, turned.joint_names[joint].lower()) for pair in LEGS for joint in tops[pair]]
        said = sum(bool(LEG_WORDS[pair].search(name)) for pair, name in names)
        center = turned.joints[[*tops["front"], *tops["hind"]], 2].mean()
        head = [joints["Head"]] if "Head" in joints else []
        scores[facing] = said, _ahead(turned, head, center) - _ahead(turned, named_tail(turned), center)
    if not scores:
        raise reasons[0]
    return max(scores, key=lambda facing: scores[facing])  # the first, +z, where they are equal


def _ahead(rig: SkinnedCharacter, joints: list[int], center: float) -> float:
    """Compute how far in front of the legs' center joints are, times the share of the vertices that they move."""
    share = rig.joint_weights()[:, joints].mean(axis=0)
    return float(share @ (rig.joints[joints, 2] - center))
