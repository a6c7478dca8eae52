"""Fingers that a driving does not have joint by joint: the joints of one finger get the bends of several, or of another
number of joints.

Each of the driving's fingers bends the one of a hand that stands for it (`stands_for`); one that stands for several has
the mean of their bends. So a mitten closes as far as four fingers do on average. A finger of fewer or more joints than
the driving's has the same bend in all, spread evenly along it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..bodies.character_limbs import SIDES
from ..bodies.hands import FLEXION
from ..bodies.joint_names import FINGERS, ancestors, followed_fingers, stands_for
from ..bodies.sampling import rotvec_to_rotmat

if TYPE_CHECKING:
    from .character import Character

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
