"""GltfRig: somebody else's rigged character, posed by full linear blend skinning (NumPy).

Joint rotations are those of `RiggedBody`: about world axes (y up, +z front, +x the left side) placed at the joint where
it rests, in the frame of its parent. How the file's own joint frames lie does not matter, so one set of rotations
means one pose for all characters that rest alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.mesh import Mesh


@dataclass(frozen=True, eq=False)
class SkinnedCharacter:
    """A character at rest and what holds it, in the units of its file."""

    mesh: Mesh
    """At rest, as `load_mesh` gives it."""
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for roots; parents come before children."""
    T_world_joint: Float[np.ndarray, "J 4 4"]
    """Joints at rest, with the scales of the file's nodes."""
    joint_of: Int[np.ndarray, "V K"]
    """Joint of each influence; J stands for the world, which never moves."""
    weights: Float[np.ndarray, "V K"]
    """Rows sum to 1."""
    points: Float[np.ndarray, "V K 3"]
    """Where each influence alone puts the vertex at rest; they differ where the file was bound in another pose."""

    @property
    def joints(self) -> Float[np.ndarray, "J 3"]:
        """Positions of the joints at rest."""
        return self.T_world_joint[:, :3, 3]

    def bones(self) -> frozenset[tuple[str, str]]:
        """Name and parent's name of each joint: two characters with equal bones have one skeleton, of any size."""
        return frozenset(
            (name, self.joint_names[parent] if parent >= 0 else "")
            for name, parent in zip(self.joint_names, self.parents, strict=True)
        )

    def skinning_transforms(
        self, local_rotmat: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, "3"] | None = None
    ) -> Float[np.ndarray, "J+1 4 4"]:
        """What each joint does to points of the rest pose, and last what the world does to them: nothing.

        `root` (the file's unit) moves every root joint.
        """
        count = len(self.parents)
        transforms = np.tile(np.eye(4), (count + 1, 1, 1))
        for j, parent in enumerate(self.parents):
            own = np.eye(4)
            own[:3, :3] = local_rotmat[j]
            own[:3, 3] = self.joints[j] - local_rotmat[j] @ self.joints[j]
            if parent < 0 and root is not None:
                own[:3, 3] += root
            transforms[j] = transforms[parent] @ own  # the parent -1 is the last entry, the world
        return transforms

    def posed(
        self, local_rotmat: Float[np.ndarray, "J 3 3"], root: Float[np.ndarray, "3"] | None = None
    ) -> Float[np.ndarray, "V 3"]:
        """Vertices under local joint rotations; see the module for their frames. Morph targets stay as they are."""
        held = self.skinning_transforms(local_rotmat, root)[self.joint_of]
        moved = (held[..., :3] @ self.points[..., None])[..., :3, 0] + held[..., :3, 3]
        return (self.weights[..., None] * moved).sum(axis=1)
