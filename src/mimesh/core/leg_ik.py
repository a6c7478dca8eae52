"""Inverse kinematics of a leg of two bones: the ankle goes to a target, and bones keep their lengths."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from .geometry import smooth_step, unit_vectors
from .rig import descendants

LONGEST = 0.995
"""Largest distance of hip and ankle over the length of the leg, unless it was larger before."""
STRAIGHT = (0.02, 0.08)
"""Distance of the knee from the line of hip and ankle (thigh lengths): below the first the leg counts as straight and
bends to the front of the thigh, from the second on it bends where it does already."""


def move_ankle(
    rotation: Float[np.ndarray, "T J 3 3"],
    positions: Float[np.ndarray, "T J 3"],
    leg: tuple[int, ...],
    offset: Float[np.ndarray, "T 3"],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "T J 3 3"]:
    """Turn thigh and shin so that the ankle moves by `offset`, as far as the leg reaches.

    The foot keeps its world rotation, and the knee stays in the plane of the leg, which turns with the line from hip to
    ankle.

    Args:
        rotation: world rotation of all joints; z axes point to the front.
        positions: their positions.
        leg: hip, knee and ankle.
        offset: displacement of the ankle.
        parents: parent of each joint.

    Returns:
        World rotations of all joints.
    """
    hip, knee, ankle = leg
    thigh, shin = positions[:, knee] - positions[:, hip], positions[:, ankle] - positions[:, knee]
    upper, lower = _length(thigh), _length(shin)
    before, after = thigh + shin, thigh + shin + offset
    shortest = np.abs(upper - lower) + 1e-3 * upper
    distance = np.clip(_length(after), shortest, longest_reach(positions, leg))
    swing = _smallest_rotation(before, after)
    line, sideways = unit_vectors(before), _knee_direction(thigh, before, rotation[:, hip, :, 2])
    # Law of cosines: where the knee is along the line from hip to ankle, and how far from it.
    along = (distance**2 + upper**2 - lower**2) / (2 * distance)
    across = np.sqrt(np.maximum(upper**2 - along**2, 0))
    new_thigh = _turn(swing, along * line + across * sideways)
    new_shin = _turn(swing, distance * line) - new_thigh
    thigh_turn = _smallest_rotation(_turn(swing, thigh), new_thigh) @ swing
    shin_turn = _smallest_rotation(_turn(swing, shin), new_shin) @ swing
    turned = rotation.copy()
    below_hip, below_knee, foot = (descendants([joint], parents) for joint in leg)
    turned[:, below_hip] = thigh_turn[:, None] @ rotation[:, below_hip]
    turned[:, below_knee] = shin_turn[:, None] @ rotation[:, below_knee]
    turned[:, foot] = rotation[:, foot]
    return turned


def longest_reach(positions: Float[np.ndarray, "T J 3"], leg: tuple[int, ...]) -> Float[np.ndarray, "T 1"]:
    """Return the largest distance of hip and ankle that is allowed: almost straight, or as straight as the leg is."""
    hip, knee, ankle = (positions[:, j] for j in leg)
    return np.maximum(LONGEST * (_length(knee - hip) + _length(ankle - knee)), _length(ankle - hip))


def _knee_direction(
    thigh: Float[np.ndarray, "T 3"], line: Float[np.ndarray, "T 3"], front: Float[np.ndarray, "T 3"]
) -> Float[np.ndarray, "T 3"]:
    """Return the direction, perpendicular to the line from hip to ankle, in which the knee is or should be."""
    axis = unit_vectors(line)
    bend = thigh - (thigh * axis).sum(axis=-1, keepdims=True) * axis
    front = unit_vectors(front - (front * axis).sum(axis=-1, keepdims=True) * axis)
    size = _length(bend)
    bent = smooth_step(size / _length(thigh), STRAIGHT)
    mixed = bent * bend / np.maximum(size, 1e-12) + (1 - bent) * front
    # A knee bent exactly to the back would cancel out half-way: it keeps its side.
    return np.where(_length(mixed) > 1e-3, unit_vectors(mixed), front)


def _smallest_rotation(old: Float[np.ndarray, "T 3"], new: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3 3"]:
    """Return the smallest rotations from directions `old` to `new`, which are not opposite (Rodrigues' formula)."""
    old, new = unit_vectors(old), unit_vectors(new)
    x, y, z = np.cross(old, new).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    cosine = (old * new).sum(axis=-1)[:, None, None]
    return np.eye(3) + cross + cross @ cross / np.maximum(1 + cosine, 1e-6)


def _turn(rotation: Float[np.ndarray, "T 3 3"], vectors: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    return (rotation @ vectors[..., None])[..., 0]


def _length(vectors: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 1"]:
    return np.linalg.norm(vectors, axis=-1, keepdims=True)
