"""SkinnedCharacter: a rigged character of a file, posed by linear blend skinning (NumPy).

Joint rotations are defined as in `RiggedBody`: about world axes (y up, +z front, +x the left side) through the joint at
rest, in the frame of its parent. They do not depend on the joint frames of the file, so one set of rotations gives the
same pose to all characters with the same rest pose.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.mesh import Mesh, permute_vertices
from ..core.rig import homogeneous, nearest_columns


@dataclass(frozen=True, eq=False)
class SkinnedCharacter:
    """A character at rest with its skeleton and skinning weights, in the unit of its file."""

    mesh: Mesh
    """The mesh at rest, as `load_mesh` returns it."""
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for roots; parents come before their children."""
    T_world_joint: Float[np.ndarray, "J 4 4"]
    """Transform of each joint at rest, with the scales of the file's nodes."""
    joint_of: Int[np.ndarray, "V K"]
    """Joint of each of the K influences of a vertex; index J is the world, which does not move."""
    weights: Float[np.ndarray, "V K"]
    """Skinning weight of each influence, rows sum to 1."""
    points: Float[np.ndarray, "V K 3"]
    """Position of the vertex at rest under each influence alone; they differ if the file was bound in another pose."""

    @property
    def joints(self) -> Float[np.ndarray, "J 3"]:
        """Joint positions at rest."""
        return self.T_world_joint[:, :3, 3]

    @property
    def skeleton(self) -> tuple[tuple[str, ...], tuple[int, ...]]:
        """Names and parents of the joints in order; characters with equal ones have the same skeleton."""
        return self.joint_names, self.parents

    def skinning_transforms(
        self, local_rotmat: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, "3"] | None = None
    ) -> Float[np.ndarray, "J+1 4 4"]:
        """Compute each joint's transform of points from rest to a pose; the last one, of the world, is the identity.

        Args:
            root: displacement of every root joint from rest, in the unit of the file.
        """
        count = len(self.parents)
        transforms = np.tile(np.eye(4), (count + 1, 1, 1))
        for j, parent in enumerate(self.parents):
            # The rotation about the joint's position at rest.
            local = homogeneous(local_rotmat[j], self.joints[j] - local_rotmat[j] @ self.joints[j])
            if parent < 0 and root is not None:
                local[:3, 3] += root
            transforms[j] = transforms[parent] @ local  # parent -1 is the last entry, the world
        return transforms

    def posed(
        self, local_rotmat: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, "3"] | None = None
    ) -> Float[np.ndarray, "V 3"]:
        """Compute the vertices under local joint rotations (see the module); morph targets are not animated."""
        return self.skinned(self.skinning_transforms(local_rotmat, root))

    def skinned(self, transforms: Float[np.ndarray, "K 4 4"]) -> Float[np.ndarray, "V 3"]:
        """Compute the vertices under given transforms from rest to a pose, as `skinning_transforms` returns them."""
        # Each influence has its own rest point, so transforms cannot be blended first, as `core.skinning` does.
        influences = transforms[self.joint_of]
        moved = (influences[..., :3] @ self.points[..., None])[..., :3, 0] + influences[..., :3, 3]
        return (self.weights[..., None] * moved).sum(axis=1)

    def joint_weights(self) -> Float[np.ndarray, "V J"]:
        """Add up the weights of each joint on each vertex; those of the world are left out."""
        count = len(self.parents)
        return self.summed_weights(np.arange(count + 1), count + 1)[:, :-1]

    def summed_weights(self, column: Int[np.ndarray, " K"], count: int) -> Float[np.ndarray, "V C"]:
        """Add up the weights of the joints that have one column.

        Args:
            column: of each joint; the last entry is that of the world.
            count: number of columns.
        """
        weights = np.zeros((len(self.weights), count))
        np.add.at(weights, (np.arange(len(weights))[:, None], column[self.joint_of]), self.weights)
        return weights

    def nearest_columns(self, column_of: Mapping[int, int], other: int) -> Int[np.ndarray, " K"]:
        """Return the column of each joint, for `summed_weights`: its own, or that of its nearest ancestor with one.

        Args:
            column_of: column of some joints.
            other: column of joints without such an ancestor, and of the world.
        """
        return nearest_columns(column_of, self.parents, other)

    def part(self, faces: Int[np.ndarray, "F 3"]) -> SkinnedCharacter:
        """Keep some triangles and their vertices, with all joints."""
        used: Bool[np.ndarray, " V"] = np.zeros(len(self.weights), bool)
        used[faces] = True
        mesh = Mesh(self.mesh.vertices[used], (np.cumsum(used) - 1)[faces], name=self.mesh.name)
        rows = {name: getattr(self, name)[used] for name in ("joint_of", "weights", "points")}
        return dataclasses.replace(self, mesh=mesh, **rows)

    def permuted(self, order: Int[np.ndarray, " V"]) -> SkinnedCharacter:
        """Reorder the vertices with their weights: new vertex k is old vertex `order[k]`."""
        mesh = permute_vertices(self.mesh, order)
        rows = {name: getattr(self, name)[order] for name in ("joint_of", "weights", "points")}
        return dataclasses.replace(self, mesh=mesh, **rows)

    def turned(self, turn: Float[np.ndarray, "3 3"]) -> SkinnedCharacter:
        """Turn the character about the origin."""
        mesh = dataclasses.replace(self.mesh, vertices=self.mesh.vertices @ turn.T)
        frames = homogeneous(turn, np.zeros(3)) @ self.T_world_joint
        return dataclasses.replace(self, mesh=mesh, T_world_joint=frames, points=self.points @ turn.T)
