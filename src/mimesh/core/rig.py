"""Joints and skinning weights of a mesh at rest, and their kinematic tree."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Rig:
    """Joints of a mesh at rest and its skinning weights."""

    rotation: Float[np.ndarray, "J 3 3"]
    """Of every joint in the world. Joints of two meshes correspond by these: the driving's rotation times the
    transposed of the identity's is what the identity's joint has to do."""
    joints: Float[np.ndarray, "J 3"]
    """Positions."""
    weights: Float[np.ndarray, "V J"]
    """Skinning weights, rows sum to 1."""

    def bones(self, parents: tuple[int, ...]) -> Float[np.ndarray, "B 3"]:
        """Vectors from each parent to its child (all joints but the root), in the parent's frame."""
        above = list(parents[1:])
        return np.einsum("jkl,jk->jl", self.rotation[above], self.joints[1:] - self.joints[above])


def descendants(tops: Iterable[int], parents: tuple[int, ...]) -> list[int]:
    """Indices of some joints and of all joints below them in the tree; parents come before their children."""
    found = set(tops)
    for j, parent in enumerate(parents):
        if parent in found:
            found.add(j)
    return sorted(found)


def leg_length(joints: Float[np.ndarray, "J 3"], legs: tuple[tuple[int, ...], ...]) -> float:
    """Mean length of the legs, each a chain of joints."""
    chains = [joints[list(leg)] for leg in legs]
    return float(np.mean([np.linalg.norm(np.diff(chain, axis=0), axis=1).sum() for chain in chains]))
