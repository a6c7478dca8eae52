"""Forward kinematics and linear blend skinning (LBS) in NumPy: x -> sum over joints j of w_j (A_j x + t_j).

There are three forms, because each is the fastest for its use: `skin_points` (one pose, any linear maps A_j),
`skin_poses` (batches of poses) and `SkinnedMesh` (many poses of one mesh, single precision, in blocks). Code that needs
derivatives has its own forms (`bodies.sampled_body`, torch in `learn`), and so do influences
with rest points of their own (`bodies.skinned_character`). tests/core/test_skinning.py checks that all of them agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .rig import Rig, descendant_matrix

BLOCK_COST = 5000
"""Vertices times joints that take as long as a further block of vertices takes by itself (about 10 microseconds)."""


def blend_matrices(
    weights: Float[np.ndarray, "V J"], matrices: Float[np.ndarray, "J 3 3"]
) -> Float[np.ndarray, "V 3 3"]:
    """Compute one matrix per vertex: the weighted sum of the joints' matrices.

    One matrix product; einsum takes three times as long.
    """
    return (weights @ matrices.reshape(-1, 9)).reshape(-1, 3, 3)


def skin_points(
    points: Float[np.ndarray, "V 3"],
    weights: Float[np.ndarray, "V J"],
    linear: Float[np.ndarray, "J 3 3"],
    offset: Float[np.ndarray, "J 3"],
) -> Float[np.ndarray, "V 3"]:
    """Move points at rest by the weighted sum of the joints' maps x -> linear x + offset."""
    return np.einsum("vkl,vl->vk", blend_matrices(weights, linear), points) + weights @ offset


def skin_poses(
    points: Float[np.ndarray, "*#B V 3"],
    weights: Float[np.ndarray, "V J"],
    rotation: Float[np.ndarray, "*B J 3 3"],
    translation: Float[np.ndarray, "*B J 3"],
) -> Float[np.ndarray, "*B V 3"]:
    """Do what `skin_points` does for a batch of poses; leading axes broadcast. See `skinning_transforms`."""
    batch = rotation.shape[:-3]
    transforms = np.concatenate([rotation, translation[..., None]], axis=-1).reshape(*batch, -1, 12)
    # Rotation and translation are blended in one matrix product: einsum over joints takes three times as long.
    blended = (weights @ transforms).reshape(*batch, -1, 3, 4)
    return np.einsum("...vkl,...vl->...vk", blended[..., :3], points) + blended[..., 3]


def skinning_transforms(
    joints: Float[np.ndarray, "*#B J 3"],
    rotmat: Float[np.ndarray, "*#B J 3 3"],
    parents: tuple[int, ...],
    root: Float[np.ndarray, "*#B 3"] | None = None,
) -> tuple[Float[np.ndarray, "*C J 3 3"], Float[np.ndarray, "*C J 3"]]:
    """Compute the map x -> rotation x + translation of each joint from rest to a pose (forward kinematics).

    Args:
        joints: positions at rest, where all joint frames have the world's axes.
        rotmat: rotation of each joint in its parent's frame.
        parents: index of each joint's parent, -1 for roots; parents come before their children.
        root: displacement of the root joints from rest.
    """
    batch = np.broadcast_shapes(rotmat.shape[:-3], joints.shape[:-2], () if root is None else root.shape[:-1])
    rotmat = np.broadcast_to(rotmat, (*batch, *rotmat.shape[-3:]))
    rotation, position = [], []
    for j, parent in enumerate(parents):
        if parent < 0:
            rotation.append(rotmat[..., j, :, :])
            position.append(joints[..., j, :] if root is None else joints[..., j, :] + root)
        else:
            bone = (joints[..., j, :] - joints[..., parent, :])[..., None]
            rotation.append(rotation[parent] @ rotmat[..., j, :, :])
            position.append(position[parent] + (rotation[parent] @ bone)[..., 0])
    rotations, positions = np.stack(rotation, -3), np.stack(np.broadcast_arrays(*position), -2)
    # The map takes the joint's rest position to its posed one: position = rotation joint + translation.
    return rotations, positions - (rotations @ joints[..., None])[..., 0]


def place_joints(
    root: Float[np.ndarray, "*T 3"],
    bones: Float[np.ndarray, "B 3"],
    linear: Float[np.ndarray, "*T J 3 3"],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "*T J 3"]:
    """Compute joint positions from the joints' world maps (forward kinematics): p_child = p_parent + linear bone.

    Args:
        root: position of the root joint.
        bones: vector from each joint's parent to the joint, in the parent's frame; the root has none.
        linear: map of each joint from its own frame to the world: a rotation, also times scales of bones.
        parents: -1 for the root, which comes first; parents come before their children.
    """
    along = (linear[..., list(parents[1:]), :, :] @ bones[..., None])[..., 0]
    steps = np.concatenate([root[..., None, :], along], axis=-2)
    # Each joint is where the steps of its ancestors and its own lead to: one product instead of a loop.
    return descendant_matrix(parents).T @ steps


@dataclass(frozen=True, eq=False)
class SkinBlock:
    """Vertices of a mesh that few joints move, packed so that posing them is a matrix product in single precision."""

    joints: Int[np.ndarray, " K"]
    """The joints that move any of the vertices."""
    packed: np.ndarray
    """(R, 4 K), float32: each vertex in each joint's frame, in homogeneous coordinates, times the joint's weight."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "R 3"], weights: Float[np.ndarray, "R J"], rig: Rig) -> SkinBlock:
        """Pack vertices at rest with their weights."""
        joints = np.flatnonzero(weights.any(axis=0))
        rotation = rig.rotation[joints]
        # The map of each joint from the world to its frame, transposed: x -> (rotation^T (x - position), 1).
        maps = np.zeros((len(joints), 4, 4))
        maps[:, :3, :3], maps[:, 3, 3] = rotation, 1.0
        maps[:, 3, :3] = -(rig.joints[joints][:, None] @ rotation)[:, 0]
        local = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1) @ maps.swapaxes(0, 1).reshape(4, -1)
        return cls(joints, (np.repeat(weights[:, joints], 4, axis=1) * local).astype(np.float32))


@dataclass(frozen=True, eq=False)
class SkinnedMesh:
    """A rigged mesh, packed in blocks of vertices that the same joints move."""

    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root; parents come before their children."""
    bones: Float[np.ndarray, "B 3"]
    """Vector from each joint's parent to the joint, in the parent's frame; the root has none."""
    blocks: tuple[SkinBlock, ...]
    place: Int[np.ndarray, " V"]
    """Index of each vertex among those of all blocks, one block after the other."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "V 3"], rig: Rig, parents: tuple[int, ...]) -> SkinnedMesh:
        """Pack the vertices at rest that the rig belongs to."""
        rows = _blocks(rig.weights)
        blocks = tuple(SkinBlock.of(vertices[some], rig.weights[some], rig) for some in rows)
        return cls(parents, rig.bones(parents), blocks, np.argsort(np.concatenate(rows)))

    @classmethod
    def of_influences(
        cls,
        joint_of: Int[np.ndarray, "V K"],
        weights: Float[np.ndarray, "V K"],
        points: Float[np.ndarray, "V K 3"],
        rig: Rig,
        parents: tuple[int, ...],
    ) -> SkinnedMesh:
        """Pack vertices that have a rest position of their own for each of their K influences.

        Args:
            joint_of: joint of each influence.
            weights: of each influence.
            points: position of the vertex at rest under each influence alone.
            rig: its weights are the sums of the influences' by joint.
        """
        local = np.einsum("vklm,vkl->vkm", rig.rotation[joint_of], points - rig.joints[joint_of])
        packed = weights[..., None] * np.concatenate([local, np.ones((*weights.shape, 1))], axis=-1)
        blocks, rows_of_blocks = [], _blocks(rig.weights)
        for rows in rows_of_blocks:
            joints = np.flatnonzero(rig.weights[rows].any(axis=0))
            column = np.searchsorted(joints, joint_of[rows]).clip(max=len(joints) - 1)
            of_block = np.zeros((len(rows), len(joints), 4))
            np.add.at(of_block, (np.arange(len(rows))[:, None], column), packed[rows])
            blocks.append(SkinBlock(joints, of_block.reshape(len(rows), -1).astype(np.float32)))
        return cls(parents, rig.bones(parents), tuple(blocks), np.argsort(np.concatenate(rows_of_blocks)))

    def repeated(self, vertices: Int[np.ndarray, " P"]) -> SkinnedMesh:
        """Give vertices in another order, which may repeat; all are computed, and repeated ones are equal."""
        return replace(self, place=self.place[vertices])

    def part(self, vertices: Int[np.ndarray, " P"]) -> SkinnedMesh:
        """Select some vertices, which may repeat."""
        starts = np.cumsum([0, *(len(block.packed) for block in self.blocks)])
        place = self.place[vertices]
        order = np.argsort(place, kind="stable")
        ends = np.searchsorted(place[order], starts)
        blocks = [
            SkinBlock(block.joints, block.packed[place[order[low:high]] - start])
            for block, start, low, high in zip(self.blocks, starts, ends, ends[1:], strict=False)
        ]
        return SkinnedMesh(self.parents, self.bones, tuple(blocks), np.argsort(order))

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """Compute the vertices from the world rotation of every joint and the position of the root joint."""
        return self.posed_at(rotation, self.joint_positions(rotation, root))

    def posed_at(
        self, rotation: Float[np.ndarray, "J 3 3"], positions: Float[np.ndarray, "J 3"]
    ) -> Float[np.ndarray, "V 3"]:
        """Compute the vertices from the world rotation and position of every joint; bones may change their lengths."""
        transforms = np.concatenate([rotation.swapaxes(-1, -2), positions[:, None]], axis=1)
        packed = sum(len(block.packed) for block in self.blocks)
        maps, vertices, start = transforms.astype(np.float32), np.empty((packed, 3)), 0
        for block in self.blocks:
            of_block, end = maps[block.joints].reshape(-1, 3), start + len(block.packed)
            # Column by column: BLAS takes three times as long for one product with three columns.
            for k in range(3):
                vertices[start:end, k] = block.packed @ of_block[:, k]
            start = end
        return vertices.take(self.place, axis=0)

    def posed_frames(
        self, rotation: Float[np.ndarray, "T J 3 3"], root: Float[np.ndarray, "T 3"]
    ) -> Float[np.ndarray, "T V 3"]:
        """Compute few vertices in many frames at once; see `posed`."""
        return self.posed_frames_at(rotation, self.joint_positions(rotation, root))

    def posed_frames_at(
        self, rotation: Float[np.ndarray, "T J 3 3"], positions: Float[np.ndarray, "T J 3"]
    ) -> Float[np.ndarray, "T V 3"]:
        """Compute few vertices in many frames at once; see `posed_at`."""
        maps = np.concatenate([rotation, positions[..., None]], axis=3).swapaxes(1, 2).astype(np.float32)
        # Three rows for each frame: one product instead of one a frame.
        blocks = [maps[:, :, block.joints].reshape(3 * len(maps), -1) @ block.packed.T for block in self.blocks]
        vertices = np.concatenate(blocks, axis=1).take(self.place, axis=1).astype(np.float64)
        return vertices.reshape(len(maps), 3, -1).swapaxes(1, 2)

    def joint_positions(
        self, rotation: Float[np.ndarray, "*T J 3 3"], root: Float[np.ndarray, "*T 3"]
    ) -> Float[np.ndarray, "*T J 3"]:
        """Compute the joint positions of that pose; bones keep their lengths."""
        return place_joints(root, self.bones, rotation, self.parents)


def _blocks(weights: Float[np.ndarray, "V J"]) -> list[Int[np.ndarray, " R"]]:
    """Divide vertices, given by their indices, into blocks, so that few joints move each.

    Vertices with the same strongest joint are a block; then the two blocks are merged whose joints differ least, until
    a merge would cost more time than a block does. The size of a block is its vertices times its joints: all together
    have a third of that of one block, with finger joints a fifth.
    """
    strongest, group = np.unique(weights.argmax(axis=1), return_inverse=True)
    count = np.bincount(group).astype(float)
    starts = np.cumsum([0, *count[:-1]]).astype(int)
    used = np.add.reduceat(weights[np.argsort(group, kind="stable")], starts, axis=0).astype(bool).astype(float)
    block = np.arange(len(strongest))  # of each group
    while len(used) > 1:
        joints = used.sum(axis=1)
        union, size = joints[:, None] + joints - used @ used.T, count * joints
        gain = size[:, None] + size + BLOCK_COST - (count[:, None] + count) * union
        np.fill_diagonal(gain, -np.inf)
        first, second = np.unravel_index(gain.argmax(), gain.shape)
        if gain[first, second] <= 0:
            break
        used[first], count[first] = np.maximum(used[first], used[second]), count[first] + count[second]
        used, count = np.delete(used, second, axis=0), np.delete(count, second)
        block[block == second] = first
        block[block > second] -= 1
    of_vertex = block[group]
    order = np.argsort(of_vertex, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(of_vertex[order])) + 1)
