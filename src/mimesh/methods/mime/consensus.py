"""Combine several predictions of a mesh: those that agree are averaged, those that contradict them are left out."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.rig import Rig
from ..confidence import mean_angle
from .part_tracking import mean_rotation

CONTRADICTION, FACES_AWAY = 60.0, 0.1
"""Mean angle between the joint rotations (degrees) from which on two predictions contradict each other, and the vote of
a prediction whose root is upright and faces away from +z beside the vote 1 of the others."""


def agreeing(rigs: list[Rig]) -> list[int]:
    """Return the indices of the predictions that agree with the one that most agree with, nearest to it first.

    Where the front of a figure looks like its back, predictions contradict each other, and a mean of contradictions is
    none of them. Predictions of a person who faces away count for less, because the facing of the mesh has been decided
    before (docs/log/mime.md, "Agreement").
    """
    angles = np.array([[mean_angle(one.rotation, other.rotation) for one in rigs] for other in rigs])
    votes = np.array([FACES_AWAY if faces_away(rig.rotation[0]) else 1.0 for rig in rigs])
    # Of those with the same votes, the one nearest to the others: the second term is below the smallest vote.
    centre = angles[((angles < CONTRADICTION) @ votes - FACES_AWAY * angles.mean(axis=1) / 180).argmax()]
    return [int(k) for k in np.argsort(centre, kind="stable") if centre[k] < CONTRADICTION]


def faces_away(root: Float[np.ndarray, "3 3"]) -> bool:
    """Tell whether a figure with this rotation of its root joint is upright and faces away from +z."""
    return bool(root[1, 1] > 0 and root[2, 2] <= 0)


def consensus(rigs: list[Rig]) -> Rig:
    """Average the joints of the predictions that agree: robust mean of rotations, mean of positions; no weights."""
    kept = [rigs[k] for k in agreeing(rigs)]
    joints = np.mean([rig.joints for rig in kept], axis=0)
    return Rig(mean_rotation(np.stack([rig.rotation for rig in kept])), joints, np.zeros((0, len(joints))))
