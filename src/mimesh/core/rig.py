"""A mesh with joints: linear blend skinning from its own joints to any rotations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .mesh import Mesh

INFLUENCES = 4
"""Joints that may hold a vertex in a file: what engines take."""


@dataclass(frozen=True, eq=False)
class Rig:
    """Joints of a mesh as it stands, and how they hold it."""

    rotation: Float[np.ndarray, "J 3 3"]
    """Of every joint in the world: that of the same joint of another mesh says how the two stand to each other."""
    joints: Float[np.ndarray, "J 3"]
    weights: Float[np.ndarray, "V J"]
    """Skinning weights, rows sum to 1."""

    def bones(self, parents: tuple[int, ...]) -> Float[np.ndarray, "B 3"]:
        """From each parent to its child (all joints but the root), as the parent sees it."""
        above = list(parents[1:])
        return np.einsum("jkl,jk->jl", self.rotation[above], self.joints[1:] - self.joints[above])


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
        local = np.einsum("jkl,vjk->vjl", rig.rotation, vertices[:, None] - rig.joints)
        held = np.concatenate([rig.weights[..., None] * local, rig.weights[..., None]], axis=-1)
        return cls(parents, rig.bones(parents), held.reshape(len(vertices), -1).astype(np.float32))

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """Vertices where every joint has turned to `rotation` and the root joint stands at `root`."""
        moves = np.concatenate([rotation.swapaxes(-1, -2), self.places(rotation, root)[:, None]], axis=1)
        return (self.held @ moves.reshape(-1, 3).astype(np.float32)).astype(np.float64)

    def places(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "J 3"]:
        """Where the joints then are; bones keep their lengths."""
        place = [root]
        for bone, parent in zip(self.bones, self.parents[1:], strict=True):
            place.append(place[parent] + rotation[parent] @ bone)
        return np.stack(place)


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints of a mesh that moves, in its own axes, unit and place: what a game engine wants instead of frames."""

    mesh: Mesh
    """As it stands in its file."""
    names: tuple[str, ...]
    parents: tuple[int, ...]
    """-1 is the root's; parents come before their children."""
    rig: Rig
    """Of all vertices."""
    rotation: Float[np.ndarray, "T J 3 3"]
    """Of every joint in the world."""
    root: Float[np.ndarray, "T 3"]
    """Where the root joint is."""

    def strongest(self) -> tuple[Int[np.ndarray, "V C"], Float[np.ndarray, "V C"]]:
        """The INFLUENCES joints that hold each vertex most, and their weights, which sum to 1."""
        joints = np.argsort(-self.rig.weights, axis=1, kind="stable")[:, :INFLUENCES]
        weights = np.take_along_axis(self.rig.weights, joints, axis=1)
        return joints, weights / weights.sum(axis=1, keepdims=True)

    def deviation(self, frames: Float[np.ndarray, "T V 3"]) -> float:
        """Farthest that a vertex held by so few joints is from a frame, over the mesh's size; of 16 frames at most."""
        joints, weights = self.strongest()
        few = np.zeros_like(self.rig.weights)
        np.put_along_axis(few, joints, weights, axis=1)
        skinned = Skinned.of(self.mesh.vertices, replace(self.rig, weights=few), self.parents)
        chosen = np.unique(np.linspace(0, len(frames) - 1, 16).round().astype(int))
        off = [skinned.posed(self.rotation[t], self.root[t]) - frames[t] for t in chosen]
        return float(np.linalg.norm(off, axis=-1).max() / np.ptp(self.mesh.vertices, axis=0).max())


def hanging(tops: Iterable[int], parents: tuple[int, ...]) -> list[int]:
    """Some joints and all that hang from them; parents come before their children."""
    found = set(tops)
    for j, parent in enumerate(parents):
        if parent in found:
            found.add(j)
    return sorted(found)


def leg_length(joints: Float[np.ndarray, "J 3"], legs: tuple[tuple[int, ...], ...]) -> float:
    """Mean length of the legs, each a chain of joints."""
    chains = [joints[list(leg)] for leg in legs]
    return float(np.mean([np.linalg.norm(np.diff(chain, axis=0), axis=1).sum() for chain in chains]))
