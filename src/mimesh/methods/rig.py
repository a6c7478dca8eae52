"""A mesh with joints: linear blend skinning from its own joints to any rotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Rig:
    """Joints of a mesh as it stands, and how they hold it."""

    rotation: Float[np.ndarray, "J 3 3"]
    """Of every joint in the world: that of the same joint of another mesh says how the two stand to each other."""
    joints: Float[np.ndarray, "J 3"]
    weights: Float[np.ndarray, "V J"]
    """Skinning weights, rows sum to 1."""


@dataclass(frozen=True, eq=False)
class Skinned:
    """Vertices of a rigged mesh, ready to be moved."""

    parents: tuple[int, ...]
    """-1 is the root's."""
    bones: Float[np.ndarray, "B 3"]
    """From each parent to its child (all joints but the root), as the parent sees it."""
    held: np.ndarray
    """(V, 4 J), float32: every vertex as each joint sees it, homogeneous, times the joint's weight."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "V 3"], rig: Rig, parents: tuple[int, ...]) -> Skinned:
        """The mesh that the rig was read from."""
        above = list(parents[1:])
        bones = np.einsum("jkl,jk->jl", rig.rotation[above], rig.joints[1:] - rig.joints[above])
        local = np.einsum("jkl,vjk->vjl", rig.rotation, vertices[:, None] - rig.joints)
        held = np.concatenate([rig.weights[..., None] * local, rig.weights[..., None]], axis=-1)
        return cls(parents, bones, held.reshape(len(vertices), -1).astype(np.float32))

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """Vertices where every joint has turned to `rotation` and the root joint stands at `root`."""
        moves = np.concatenate([rotation.mT, self.places(rotation, root)[:, None]], axis=1)
        return (self.held @ moves.reshape(-1, 3).astype(np.float32)).astype(np.float64)

    def places(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "J 3"]:
        """Where the joints then are; bones keep their lengths."""
        place = [root]
        for bone, parent in zip(self.bones, self.parents[1:], strict=True):
            place.append(place[parent] + rotation[parent] @ bone)
        return np.stack(place)


def leg_length(joints: Float[np.ndarray, "J 3"], legs: tuple[tuple[int, ...], ...]) -> float:
    """Mean length of the legs, each a chain of joints."""
    chains = [joints[list(leg)] for leg in legs]
    return float(np.mean([np.linalg.norm(np.diff(chain, axis=0), axis=1).sum() for chain in chains]))
