"""Joints, skinning weights and rotations of an animated mesh: what is written to skinned files instead of frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .mesh import Mesh
from .rig import Rig
from .skinning import SkinnedMesh

INFLUENCES = 4
"""Joints per vertex in a written file. Readers of glTF 2.0 must support 4, and many game engines support no more."""
CHECKED_FRAMES = 16
"""Frames, evenly spread, in which the reduced weights are compared with the full ones."""
CHECKED_VERTICES = 1000
"""Vertices, evenly spread over their indices, in which two motions are compared in every frame (about 0.1 ms each)."""


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

    @property
    def size(self) -> float:
        """Longest side of the bounding box of the mesh at rest."""
        return float(np.ptp(self.mesh.vertices, axis=0).max())

    def strongest(self) -> tuple[Int[np.ndarray, "V C"], Float[np.ndarray, "V C"]]:
        """Select the INFLUENCES joints with the largest weights of each vertex, and scale these weights to sum to 1."""
        return self.rig.strongest(INFLUENCES)

    def deviation(self, frames: Float[np.ndarray, "T V 3"]) -> float:
        """Measure the error of `strongest`: largest distance of a vertex from `frames`, over the mesh's size.

        Only CHECKED_FRAMES frames are compared.
        """
        skinned = SkinnedMesh.of(self.mesh.vertices, self.rig.limited(INFLUENCES), self.parents)
        chosen = np.unique(np.linspace(0, len(frames) - 1, CHECKED_FRAMES).round().astype(int))
        differences = [skinned.posed(self.rotation[t], self.root[t]) - frames[t] for t in chosen]
        return float(np.linalg.norm(differences, axis=-1).max() / self.size)

    def motion_deviation(self, other: AnimatedRig) -> float:
        """Measure the largest distance of a vertex between this motion and another one of this rig, over the size.

        All frames are compared, and about CHECKED_VERTICES vertices.
        """
        every = max(1, len(self.mesh.vertices) // CHECKED_VERTICES)
        rig = replace(self.rig, weights=self.rig.weights[::every])
        skinned = SkinnedMesh.of(self.mesh.vertices[::every], rig, self.parents)
        poses = zip(self.rotation, self.root, other.rotation, other.root, strict=True)
        distances = (np.linalg.norm(skinned.posed(a, p) - skinned.posed(b, q), axis=1).max() for a, p, b, q in poses)
        return float(max(distances) / self.size)


@dataclass(frozen=True, eq=False)
class RigAnimation:
    """A named motion of a rig, at a frame rate: one animation of a file."""

    name: str
    skeleton: AnimatedRig
    fps: float
    """Frames a second."""
