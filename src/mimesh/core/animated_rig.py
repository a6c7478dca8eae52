"""Joints, skinning weights and rotations of an animated mesh: what is written to skinned files instead of frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .mesh import Mesh
from .rig import Rig
from .skinning import SkinnedMesh, place_joints

INFLUENCES = 4
"""Joints per vertex in a written file. Readers of glTF 2.0 must support 4, and many game engines support no more."""
CHECKED_FRAMES = 16
"""Frames, evenly spread, in which the reduced weights are compared with the full ones."""


@dataclass(frozen=True, eq=False)
class AnimatedRig:
    """Rig of a mesh and its pose in T frames, in the axes and unit of the mesh's file."""

    mesh: Mesh
    """The mesh at rest, as in its file."""
    names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root; parents come before their children."""
    rig: Rig
    """Joints at rest, and skinning weights of all vertices of the mesh."""
    rotation: Float[np.ndarray, "T J 3 3"]
    """World rotation of every joint in every frame."""
    root: Float[np.ndarray, "T 3"]
    """Position of the root joint."""

    def transforms(self) -> Float[np.ndarray, "T J 4 4"]:
        """Compute the transform of points that each joint moves, from rest to every frame."""
        turn = self.rotation @ self.rig.rotation.swapaxes(-1, -2)
        bones = self.rig.bones(self.parents)
        positions = np.stack(
            [
                place_joints(root, bones, rotation, self.parents)
                for root, rotation in zip(self.root, self.rotation, strict=True)
            ]
        )
        transforms = np.tile(np.eye(4), (*turn.shape[:2], 1, 1))
        transforms[..., :3, :3] = turn
        transforms[..., :3, 3] = positions - (turn @ self.rig.joints[..., None])[..., 0]
        return transforms

    def strongest(self) -> tuple[Int[np.ndarray, "V C"], Float[np.ndarray, "V C"]]:
        """Select the INFLUENCES joints with the largest weights of each vertex, and scale these weights to sum to 1."""
        joints = np.argsort(-self.rig.weights, axis=1, kind="stable")[:, :INFLUENCES]
        weights = np.take_along_axis(self.rig.weights, joints, axis=1)
        return joints, weights / weights.sum(axis=1, keepdims=True)

    def deviation(self, frames: Float[np.ndarray, "T V 3"]) -> float:
        """Measure the error of `strongest`: largest distance of a vertex from `frames`, over the mesh's size.

        The size is the longest side of the bounding box. Only CHECKED_FRAMES frames are compared.
        """
        joints, weights = self.strongest()
        reduced = np.zeros_like(self.rig.weights)
        np.put_along_axis(reduced, joints, weights, axis=1)
        skinned = SkinnedMesh.of(self.mesh.vertices, replace(self.rig, weights=reduced), self.parents)
        chosen = np.unique(np.linspace(0, len(frames) - 1, CHECKED_FRAMES).round().astype(int))
        differences = [skinned.posed(self.rotation[t], self.root[t]) - frames[t] for t in chosen]
        return float(np.linalg.norm(differences, axis=-1).max() / np.ptp(self.mesh.vertices, axis=0).max())
