"""Forward kinematics and linear blend skinning (LBS) in NumPy: x -> sum over joints j of w_j (A_j x + t_j).

There are three forms, because each is the fastest for its use: `skin_points` (one pose, any linear maps A_j),
`skin_poses` (batches of poses) and `SkinnedMesh` (many poses of one mesh, single precision). Code that needs
derivatives has its own forms (`bodies.body_parameters`, `bodies.sampled_body`, torch in `learn`), and so do influences
with rest points of their own (`bodies.skinned_character`). tests/core/test_skinning.py checks that all of them agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .rig import Rig, descendant_matrix


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
    root: Float[np.ndarray, " 3"],
    bones: Float[np.ndarray, "B 3"],
    linear: Float[np.ndarray, "J 3 3"],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "J 3"]:
    """Compute joint positions from the joints' world maps (forward kinematics): p_child = p_parent + linear bone.

    Args:
        root: position of the root joint.
        bones: vector from each joint's parent to the joint, in the parent's frame; the root has none.
        linear: map of each joint from its own frame to the world: a rotation, also times scales of bones.
        parents: -1 for the root, which comes first; parents come before their children.
    """
    steps = np.concatenate([root[None], (linear[list(parents[1:])] @ bones[..., None])[..., 0]])
    # Each joint is where the steps of its ancestors and its own lead to: one product instead of a loop.
    return descendant_matrix(parents).T @ steps


@dataclass(frozen=True, eq=False)
class SkinnedMesh:
    """A rigged mesh, packed so that posing it is one matrix product in single precision."""

    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root; parents come before their children."""
    bones: Float[np.ndarray, "B 3"]
    """Vector from each joint's parent to the joint, in the parent's frame; the root has none."""
    packed: np.ndarray
    """(V, 4 J), float32: each vertex in each joint's frame, in homogeneous coordinates, times the joint's weight."""
    rows: Int[np.ndarray, " R"] | None = None
    """Vertices that the last K joints move, if these are packed apart because they move few vertices (fingers)."""
    packed_rows: np.ndarray | None = None
    """(R, 4 K), float32: the same of these vertices and joints; `packed` has the joints before them."""

    @classmethod
    def of(
        cls, vertices: Float[np.ndarray, "V 3"], rig: Rig, parents: tuple[int, ...], everywhere: int | None = None
    ) -> SkinnedMesh:
        """Pack the vertices at rest that the rig belongs to.

        Args:
            everywhere: number of joints, the first ones, that are packed for all vertices; the others only for those
                that they move, which with thirty finger joints takes a third of the time. None: all.
        """
        dense, bones = slice(everywhere), rig.bones(parents)
        packed = _packed(vertices, rig.rotation[dense], rig.joints[dense], rig.weights[:, dense])
        if everywhere is None or everywhere >= len(parents):
            return cls(parents, bones, packed)
        last = slice(everywhere, None)
        rows = np.flatnonzero(rig.weights[:, last].any(axis=1))
        packed_rows = _packed(vertices[rows], rig.rotation[last], rig.joints[last], rig.weights[rows, last])
        return cls(parents, bones, packed, rows, packed_rows)

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """Compute the vertices from the world rotation of every joint and the position of the root joint."""
        transforms = np.concatenate([rotation.swapaxes(-1, -2), self.joint_positions(rotation, root)[:, None]], axis=1)
        maps = transforms.reshape(-1, 3).astype(np.float32)
        columns = self.packed.shape[1]
        vertices = _product(self.packed, maps[:columns])
        if self.rows is not None and self.packed_rows is not None:
            vertices[self.rows] += _product(self.packed_rows, maps[columns:])
        return vertices

    def joint_positions(
        self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, "J 3"]:
        """Compute the joint positions of that pose; bones keep their lengths."""
        return place_joints(root, self.bones, rotation, self.parents)


def _packed(
    vertices: Float[np.ndarray, "V 3"],
    rotation: Float[np.ndarray, "J 3 3"],
    joints: Float[np.ndarray, "J 3"],
    weights: Float[np.ndarray, "V J"],
) -> np.ndarray:
    """Write vertices in the frames of joints, in homogeneous coordinates, times the weights: (V, 4 J), float32."""
    # The map of each joint from the world to its frame, transposed: x -> (rotation^T (x - joint), 1).
    maps = np.zeros((len(joints), 4, 4))
    maps[:, :3, :3], maps[:, 3, 3] = rotation, 1.0
    maps[:, 3, :3] = -(joints[:, None] @ rotation)[:, 0]
    homogeneous = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    local = homogeneous @ maps.swapaxes(0, 1).reshape(4, -1)
    return (np.repeat(weights, 4, axis=1) * local).astype(np.float32)


def _product(packed: np.ndarray, maps: np.ndarray) -> Float[np.ndarray, "V 3"]:
    """Multiply (V, K) by (K, 3), column by column: BLAS takes a third of the time of one product with three columns."""
    product = np.empty((len(packed), 3))
    for k in range(3):
        product[:, k] = packed @ maps[:, k]
    return product
