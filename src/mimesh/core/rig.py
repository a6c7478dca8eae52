"""Joints and skinning weights of a mesh at rest, and functions of the kinematic tree."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Rig:
    """Joints of a mesh at rest and its skinning weights."""

    rotation: Float[np.ndarray, "J 3 3"]
    """World rotation of each joint. Corresponding joints of two meshes have corresponding axes: the rotation of the
    driving joint times the transposed rotation of the identity joint takes the identity joint to the driving pose."""
    joints: Float[np.ndarray, "J 3"]
    """World positions of the joints."""
    weights: Float[np.ndarray, "V J"]
    """Skinning weights, rows sum to 1."""

    def bones(self, parents: tuple[int, ...]) -> Float[np.ndarray, "B 3"]:
        """Compute the vector from each joint's parent to the joint, in the parent's frame; the root has none."""
        above = list(parents[1:])
        return np.einsum("jkl,jk->jl", self.rotation[above], self.joints[1:] - self.joints[above])

    def strongest(self, influences: int) -> tuple[Int[np.ndarray, "V C"], Float[np.ndarray, "V C"]]:
        """Select the joints with the largest weights of each vertex, and scale these weights to sum to 1."""
        joints = np.argsort(-self.weights, axis=1, kind="stable")[:, :influences]
        weights = np.take_along_axis(self.weights, joints, axis=1)
        return joints, weights / weights.sum(axis=1, keepdims=True)

    def limited(self, influences: int) -> Rig:
        """Return this rig with only the largest weights of each vertex, scaled to sum to 1."""
        weights = np.zeros_like(self.weights)
        joints, largest = self.strongest(influences)
        np.put_along_axis(weights, joints, largest, axis=1)
        return replace(self, weights=weights)


def descendants(tops: Iterable[int], parents: tuple[int, ...]) -> list[int]:
    """List the indices of some joints and of all joints below them, in rising order; joints may have any order."""
    found, before = set(tops), 0
    while len(found) > before:  # one round, and one that finds no more, where parents come before their children
        before = len(found)
        for j, parent in enumerate(parents):
            if parent in found:
                found.add(j)
    return sorted(found)


def nearest_columns(column_of: Mapping[int, int], parents: tuple[int, ...], other: int) -> Int[np.ndarray, " K"]:
    """Return the column of each joint: its own, or that of its nearest ancestor with one; the last one is `other`.

    Args:
        column_of: column of some joints.
        parents: come before their children, -1 for roots.
        other: column of joints without such an ancestor.
    """
    columns = np.full(len(parents) + 1, other)
    for j, parent in enumerate(parents):
        columns[j] = column_of.get(j, columns[parent])  # parent -1 is the last entry
    return columns


def homogeneous(
    rotation: Float[np.ndarray, "*B 3 3"], position: Float[np.ndarray, "*B 3"]
) -> Float[np.ndarray, "*B 4 4"]:
    """Build the transforms x -> rotation x + position in homogeneous coordinates; `rotation` is any linear map."""
    found = np.zeros((*position.shape[:-1], 4, 4))
    found[..., :3, :3], found[..., :3, 3], found[..., 3, 3] = rotation, position, 1.0
    return found


def local_rotations(rotation: Float[np.ndarray, "T J 3 3"], parents: tuple[int, ...]) -> Float[np.ndarray, "T J 3 3"]:
    """Compute rotations in the frames of the parents from those in the world; those of roots stay: R_parent^T R_j."""
    local = rotation.copy()
    below = [j for j, parent in enumerate(parents) if parent >= 0]
    above = [parents[j] for j in below]
    local[:, below] = rotation[:, above].swapaxes(-1, -2) @ rotation[:, below]
    return local


@cache
def descendant_matrix(parents: tuple[int, ...]) -> Float[np.ndarray, "J J"]:
    """Build the matrix that has 1 at [j, k] if joint k is joint j or a descendant of it, else 0; read-only.

    Its product with a column per joint sums over each joint's subtree; the product with its transpose sums over each
    joint's ancestors. Parents come before their children.
    """
    matrix = np.eye(len(parents))
    for j in range(len(parents) - 1, -1, -1):
        if parents[j] >= 0:
            matrix[parents[j]] += matrix[j]
    matrix.setflags(write=False)  # it is cached, so all callers share it
    return matrix


def leg_length(joints: Float[np.ndarray, "J 3"], legs: tuple[tuple[int, ...], ...]) -> float:
    """Measure the mean length of the legs, each given as the indices of a chain of joints."""
    chains = [joints[list(leg)] for leg in legs]
    return float(np.mean([np.linalg.norm(np.diff(chain, axis=0), axis=1).sum() for chain in chains]))
