"""Joints, skinning weights and rotations of an animated mesh: what is written to skinned files instead of frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .frame_buffer import LazyFrames, evenly_spread
from .geometry import first_of_each, slerp
from .mesh import Mesh
from .rig import Rig, homogeneous, local_rotations
from .skinning import SkinnedMesh, place_joints

INFLUENCES = 4
"""Joints per vertex in a written file, unless more are asked for. Readers of glTF 2.0 must support 4, and many game
engines support no more."""
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
    """Joints at rest, and skinning weights of all vertices of the mesh, or of the `points` that these are at."""
    rotation: Float[np.ndarray, "T J 3 3"]
    """World rotation of every joint in every frame."""
    root: Float[np.ndarray, "T 3"]
    """Position of the root joint."""
    person: Mapping[str, int] | None = None
    """Index of each joint that is known to be a person's, by our name; None: the names are ours."""
    positions: Float[np.ndarray, "T J 3"] | None = None
    """Position of every joint; None: bones keep their lengths, so positions follow from `root` and `rotation`."""
    group: Int[np.ndarray, " V"] | None = None
    """Row of the weights of each vertex, where vertices share positions, -1 for those that no joint moves; None: each
    has a row of its own."""
    influences: int = INFLUENCES
    """Largest number of joints per vertex in a written file."""

    def __repr__(self) -> str:
        """Sum up the rig: arrays of thousands of numbers say nothing."""
        return f"AnimatedRig({self.mesh.name!r}, {len(self.names)} joints, {len(self.rotation)} frames)"

    @property
    def points(self) -> Float[np.ndarray, "W 3"]:
        """The positions at rest that the weights belong to: the vertices of the mesh, each position once."""
        return self.mesh.vertices if self.group is None else self.mesh.vertices[first_of_each(self.group)]

    def joint_positions(self) -> Float[np.ndarray, "T J 3"]:
        """Return the position of every joint in every frame."""
        if self.positions is not None:
            return self.positions
        bones = self.rig.bones(self.parents)
        return place_joints(self.root, bones, self.rotation, self.parents)

    def local_positions(self) -> Float[np.ndarray, "T J 3"]:
        """Compute the position of every joint in the frame of its parent; the root's is that in the world."""
        local = self.joint_positions().copy()
        above = list(self.parents[1:])
        steps = local[:, 1:] - local[:, above]
        local[:, 1:] = (self.rotation[:, above].swapaxes(-1, -2) @ steps[..., None])[..., 0]
        return local

    def resampled(self, fps: float, output_fps: float) -> AnimatedRig:
        """Sample the motion, which has `fps` frames a second, at another rate, between frames as players of glTF do.

        Rotations in the frames of the parents are interpolated by slerp, positions linearly.
        """
        before, after, fraction = frames_around(len(self.root), fps, output_fps)
        rotations, positions = local_rotations(self.rotation, self.parents), self.local_positions()
        rotations = slerp(rotations[before], rotations[after], fraction[:, None])
        weight = fraction[:, None, None]
        positions = positions[before] * (1 - weight) + positions[after] * weight
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                positions[:, j] = positions[:, parent] + (rotations[:, parent] @ positions[:, j, :, None])[..., 0]
                rotations[:, j] = rotations[:, parent] @ rotations[:, j]
        kept = None if self.positions is None else positions
        return replace(self, rotation=rotations, root=positions[:, 0], positions=kept)

    def transforms(self) -> Float[np.ndarray, "T J 4 4"]:
        """Compute the transform of points that each joint moves, from rest to every frame."""
        turn = self.rotation @ self.rig.rotation.swapaxes(-1, -2)
        return homogeneous(turn, self.joint_positions() - (turn @ self.rig.joints[..., None])[..., 0])

    @property
    def size(self) -> float:
        """Longest side of the bounding box of the mesh at rest, without what no joint moves."""
        return float(np.ptp(self.points, axis=0).max())

    def strongest(self) -> tuple[Int[np.ndarray, "V C"], Float[np.ndarray, "V C"]]:
        """Select the joints per vertex that a file has, by the largest weights, and scale these to sum to 1.

        Vertices that no joint moves have all weights zero.
        """
        joints, weights = self.rig.strongest(self.influences)
        if self.group is None:
            return joints, weights
        return joints[self.group], np.where(self.group[:, None] >= 0, weights[self.group], 0.0)

    def on_mesh(self, points: Float[np.ndarray, "W 3"]) -> Float[np.ndarray, "V 3"]:
        """Return the vertices of the mesh with other `points`."""
        if self.group is None:
            return points
        return np.where(self.group[:, None] >= 0, points[self.group], self.mesh.vertices)

    def deviation(self, frames: LazyFrames) -> float:
        """Measure the error of `strongest`: largest distance of a vertex from `frames`, over the mesh's size.

        Only CHECKED_FRAMES frames are compared.
        """
        skinned = SkinnedMesh.of(self.points, self.rig.limited(self.influences), self.parents)
        kept = slice(None) if self.group is None else first_of_each(self.group)
        chosen = evenly_spread(len(frames), CHECKED_FRAMES)
        positions = None if self.positions is None else self.positions[chosen]
        part = replace(self, rotation=self.rotation[chosen], root=self.root[chosen], positions=positions)
        posed = map(skinned.posed_at, part.rotation, part.joint_positions())
        differences = (points - of_frame[kept] for points, of_frame in zip(posed, frames.at(chosen), strict=True))
        return float(max(np.linalg.norm(difference, axis=-1).max() for difference in differences) / self.size)


@dataclass(frozen=True, eq=False)
class RigAnimation:
    """A named motion of a rig, at a frame rate: one animation of a file."""

    name: str
    skeleton: AnimatedRig
    fps: float
    """Frames a second."""

    def resampled(self, fps: float | None) -> RigAnimation:
        """Sample the motion at another rate; None keeps it."""
        return self if fps is None else RigAnimation(self.name, self.skeleton.resampled(self.fps, fps), fps)


def frames_around(
    count: int, fps: float, output_fps: float
) -> tuple[Int[np.ndarray, " N"], Int[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Find, for each frame at another rate, the frames before and after it, and the fraction of the way between."""
    last = count - 1
    # The tolerance keeps the last frame when 1/fps came from a rounded "Frame Time: .0083333".
    total = int(np.floor(last / fps * output_fps + 1e-3)) + 1
    at = np.minimum(np.arange(total) * (fps / output_fps), last)
    # A motion of one frame has only index 0.
    before = np.minimum(np.floor(at).astype(int), max(last - 1, 0))
    return before, np.minimum(before + 1, last), at - before
