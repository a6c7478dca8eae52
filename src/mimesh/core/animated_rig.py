"""A rig that moves: what is written as joints, skinning weights and rotations instead of frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .mesh import Mesh
from .rig import Rig
from .skinning import SkinnedMesh

INFLUENCES = 4
"""Joints a vertex in a file: what game engines take (glTF 2.0 requires no more)."""
CHECKED_FRAMES = 16
"""Frames, evenly spread, in which the reduced weights are compared with the full ones."""


@dataclass(frozen=True, eq=False)
class AnimatedRig:
    """Joints of a mesh over T frames, in the mesh's own axes, unit and place."""

    mesh: Mesh
    """At rest, as in its file."""
    names: tuple[str, ...]
    parents: tuple[int, ...]
    """-1 is the root's; parents come before their children."""
    rig: Rig
    """Of all vertices."""
    rotation: Float[np.ndarray, "T J 3 3"]
    """World rotation of every joint in every frame."""
    root: Float[np.ndarray, "T 3"]
    """Position of the root joint."""

    def strongest(self) -> tuple[Int[np.ndarray, "V C"], Float[np.ndarray, "V C"]]:
        """The INFLUENCES joints with the largest weights of each vertex, and these weights scaled to sum to 1."""
        joints = np.argsort(-self.rig.weights, axis=1, kind="stable")[:, :INFLUENCES]
        weights = np.take_along_axis(self.rig.weights, joints, axis=1)
        return joints, weights / weights.sum(axis=1, keepdims=True)

    def deviation(self, frames: Float[np.ndarray, "T V 3"]) -> float:
        """Largest distance of a vertex with only its strongest weights from a frame, over the mesh's size."""
        joints, weights = self.strongest()
        few = np.zeros_like(self.rig.weights)
        np.put_along_axis(few, joints, weights, axis=1)
        skinned = SkinnedMesh.of(self.mesh.vertices, replace(self.rig, weights=few), self.parents)
        chosen = np.unique(np.linspace(0, len(frames) - 1, CHECKED_FRAMES).round().astype(int))
        off = [skinned.posed(self.rotation[t], self.root[t]) - frames[t] for t in chosen]
        return float(np.linalg.norm(off, axis=-1).max() / np.ptp(self.mesh.vertices, axis=0).max())
