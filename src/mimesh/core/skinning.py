"""Linear blend skinning: vertices that several joints move at once, each by its weight.

The one NumPy implementation. `learn/` has a batched torch twin (gradients), and tests hold the two together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .rig import Rig


def blend_matrices(
    weights: Float[np.ndarray, "V J"], matrices: Float[np.ndarray, "J 3 3"]
) -> Float[np.ndarray, "V 3 3"]:
    """One matrix a vertex: the weighted sum of those of the joints.

    One matrix product; the same as an einsum takes three times as long.
    """
    return (weights @ matrices.reshape(-1, 9)).reshape(-1, 3, 3)


def skin_points(
    points: Float[np.ndarray, "V 3"],
    weights: Float[np.ndarray, "V J"],
    linear: Float[np.ndarray, "J 3 3"],
    offset: Float[np.ndarray, "J 3"],
) -> Float[np.ndarray, "V 3"]:
    """Move each point by the weighted sum of what the joints do to it: x -> linear x + offset."""
    return np.einsum("vkl,vl->vk", blend_matrices(weights, linear), points) + weights @ offset


def place_joints(
    root: Float[np.ndarray, " 3"],
    bones: Float[np.ndarray, "B 3"],
    linear: Float[np.ndarray, "J 3 3"],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "J 3"]:
    """Positions of the joints of a chain whose root is at `root` (forward kinematics).

    Args:
        bones: from each parent to its child, all joints but the root, in the parent's frame.
        linear: of every joint in the world: rotations, or with the scale of bones.
        parents: -1 for the root, which comes first; parents come before their children.
    """
    places = [root]
    for bone, parent in zip(bones, parents[1:], strict=True):
        places.append(places[parent] + linear[parent] @ bone)
    return np.stack(places)


@dataclass(frozen=True, eq=False)
class SkinnedMesh:
    """Vertices of a rigged mesh in the form in which posing them is one matrix product."""

    parents: tuple[int, ...]
    """-1 is the root's."""
    bones: Float[np.ndarray, "B 3"]
    """From each parent to its child (all joints but the root), in the parent's frame."""
    packed: np.ndarray
    """(V, 4 J), float32: every vertex in each joint's frame, homogeneous, times the joint's weight."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "V 3"], rig: Rig, parents: tuple[int, ...]) -> SkinnedMesh:
        """From the vertices that the rig belongs to."""
        local = np.einsum("jkl,vjk->vjl", rig.rotation, vertices[:, None] - rig.joints)
        packed = np.concatenate([rig.weights[..., None] * local, rig.weights[..., None]], axis=-1)
        return cls(parents, rig.bones(parents), packed.reshape(len(vertices), -1).astype(np.float32))

    def posed(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "V 3"]:
        """Vertices where every joint has the world rotation `rotation` and the root joint is at `root`."""
        transforms = np.concatenate([rotation.swapaxes(-1, -2), self.places(rotation, root)[:, None]], axis=1)
        return (self.packed @ transforms.reshape(-1, 3).astype(np.float32)).astype(np.float64)

    def places(self, rotation: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "J 3"]:
        """Positions of the joints in that pose; bones keep their lengths."""
        return place_joints(root, self.bones, rotation, self.parents)
