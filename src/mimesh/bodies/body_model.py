"""RiggedBody: a template with shape components and a skeleton, posed by linear blend skinning (NumPy).

Frame: metres, y up, the body faces +z, its left side is +x. At rest every joint frame has the world's axes, so a joint
rotation is a rotation about world axes placed at the joint, in the frame of its parent (as SMPL has it).
The batched torch twin is `learn.bodies`.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.mesh import Mesh


@dataclass(frozen=True, eq=False)
class RiggedBody:
    """Arrays of one body model; see the module for frames and units."""

    name: str
    vertices: Float[np.ndarray, "V 3"]
    """Mean shape at rest (T-pose)."""
    faces: Int[np.ndarray, "F 3"]
    components: Float[np.ndarray, "K V 3"]
    """Displacement of the vertices for one standard deviation of each shape coefficient."""
    joints: Float[np.ndarray, "J 3"]
    joint_components: Float[np.ndarray, "K J 3"]
    weights: Float[np.ndarray, "V J"]
    """Skinning weights, rows sum to 1."""
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root; parents come before children."""

    def joint(self, name: str) -> int:
        """Index of a joint; KeyError names the ones there are."""
        if name not in self.joint_names:
            raise KeyError(f"{self.name} has no joint {name!r}; it has {', '.join(self.joint_names)}")
        return self.joint_names.index(name)

    def shaped(
        self, shape: Float[np.ndarray, "*B K"]
    ) -> tuple[Float[np.ndarray, "*B V 3"], Float[np.ndarray, "*B J 3"]]:
        """Rest vertices and joints of people with the given shape coefficients (standard deviations).

        Fewer coefficients than components leave the rest at zero.
        """
        k = shape.shape[-1]
        vertices = self.vertices + np.tensordot(shape, self.components[:k], axes=1)
        return vertices, self.joints + np.tensordot(shape, self.joint_components[:k], axes=1)

    def posed(
        self,
        shape: Float[np.ndarray, "*#B K"],
        rotmat: Float[np.ndarray, "*#B J 3 3"],
        root: Float[np.ndarray, "*#B 3"] | None = None,
    ) -> Float[np.ndarray, "*C V 3"]:
        """Vertices under local joint rotations; `root` (metres) is added to where the root joint rests.

        One person in many poses and many people in one pose are fine: leading axes broadcast.
        """
        vertices, joints = self.shaped(shape)
        rotation, translation = self.skinning_transforms(joints, rotmat, root)
        many = rotation.shape[:-3]
        transforms = np.concatenate([rotation, translation[..., None]], axis=-1).reshape(*many, -1, 12)
        # One matrix product: einsum over joints takes three times as long.
        blended = (self.weights @ transforms).reshape(*many, -1, 3, 4)
        return np.einsum("...vkl,...vl->...vk", blended[..., :3], vertices) + blended[..., 3]

    def skinning_transforms(
        self, joints: Float[np.ndarray, "*#B J 3"], rotmat: Float[np.ndarray, "*#B J 3 3"], root=None
    ) -> tuple[Float[np.ndarray, "*C J 3 3"], Float[np.ndarray, "*C J 3"]]:
        """Rotation and translation that each joint applies to a rest point: x -> rotation x + translation."""
        rotation, position = [], []
        for j, parent in enumerate(self.parents):
            if parent < 0:
                rotation.append(rotmat[..., j, :, :])
                position.append(joints[..., j, :] if root is None else joints[..., j, :] + root)
            else:
                bone = (joints[..., j, :] - joints[..., parent, :])[..., None]
                rotation.append(rotation[parent] @ rotmat[..., j, :, :])
                position.append(position[parent] + (rotation[parent] @ bone)[..., 0])
        rotations, positions = np.stack(rotation, -3), np.stack(np.broadcast_arrays(*position), -2)
        return rotations, positions - (rotations @ joints[..., None])[..., 0]

    def mesh(self, vertices: Float[np.ndarray, "V 3"] | None = None) -> Mesh:
        """A Mesh with this body's faces; at rest with the mean shape unless vertices are given."""
        points = self.vertices if vertices is None else vertices
        return Mesh(np.asarray(points, np.float64), self.faces, name=self.name)


def load_body(name_or_path: str | Path = "human") -> RiggedBody:
    """Load a shipped body by name, or a `.npz` of the same layout (see `save_body`) by path."""
    path = Path(name_or_path)
    if path.suffix != ".npz":
        path = Path(str(resources.files("mimesh.bodies") / f"{name_or_path}.npz"))
    if not path.exists():
        raise InputError(f"{name_or_path}: expected a shipped body (human) or a .npz file, found neither")
    with np.load(path) as data:
        weights = np.zeros((len(data["vertices"]), len(data["parents"])))
        np.put_along_axis(weights, data["weight_joints"].astype(int), data["weights"].astype(np.float64), axis=1)
        return RiggedBody(
            name=path.stem,
            vertices=data["vertices"].astype(np.float64),
            faces=data["faces"].astype(np.int64),
            components=data["components"].astype(np.float64),
            joints=data["joints"].astype(np.float64),
            joint_components=data["joint_components"].astype(np.float64),
            weights=weights / weights.sum(axis=1, keepdims=True),
            joint_names=tuple(data["joint_names"].tolist()),
            parents=tuple(int(p) for p in data["parents"]),
        )


def save_body(body: RiggedBody, path: Path, influences: int = 6) -> None:
    """Write a compact `.npz`: components and weights in half precision, the largest `influences` weights a vertex."""
    strongest = np.argsort(-body.weights, axis=1)[:, :influences]
    np.savez_compressed(
        path,
        vertices=body.vertices.astype(np.float32),
        faces=body.faces.astype(np.uint16),
        components=body.components.astype(np.float16),
        joints=body.joints.astype(np.float32),
        joint_components=body.joint_components.astype(np.float32),
        weight_joints=strongest.astype(np.uint8),
        weights=np.take_along_axis(body.weights, strongest, axis=1).astype(np.float16),
        joint_names=np.array(body.joint_names),
        parents=np.array(body.parents, np.int8),
    )


EXTREMES = {
    "head": ("Head", (0.0, 1.0, 0.0)),
    "left hand": ("LeftHand", (1.0, 0.0, 0.0)),
    "right hand": ("RightHand", (-1.0, 0.0, 0.0)),
    "left foot": ("LeftToeBase", (0.0, 0.0, 1.0)),
    "right foot": ("RightToeBase", (0.0, 0.0, 1.0)),
}
"""The vertex farthest in a direction from a joint, among those near the line through the joint."""
ON_SKIN = {
    "left shoulder": ("LeftArm", (0.0, 1.0, 0.0)),
    "right shoulder": ("RightArm", (0.0, 1.0, 0.0)),
    "left elbow": ("LeftForeArm", (0.0, 0.0, -1.0)),
    "right elbow": ("RightForeArm", (0.0, 0.0, -1.0)),
    "left hip": ("LeftUpLeg", (1.0, 0.0, 0.0)),
    "right hip": ("RightUpLeg", (-1.0, 0.0, 0.0)),
    "left knee": ("LeftLeg", (0.0, 0.0, 1.0)),
    "right knee": ("RightLeg", (0.0, 0.0, 1.0)),
}
"""The vertex of the skin where a ray from a joint leaves the body (the first crossing, roughly: nearest to the ray)."""
LANDMARKS = (*EXTREMES, *ON_SKIN)
"""All 13 in order; the first 5 are the ends of the body."""
NEAR = 0.06
"""Metres around the line through a joint in which an extreme is looked for; a palm or a foot is narrower."""


def landmarks(body: RiggedBody) -> dict[str, int]:
    """Vertex index of each of LANDMARKS on a human body; shape and pose do not matter, the vertex stays the same."""
    found = {name: _extreme(body, joint, np.array(way)) for name, (joint, way) in EXTREMES.items()}
    return found | {name: _on_skin(body, joint, np.array(way)) for name, (joint, way) in ON_SKIN.items()}


def _along_and_aside(
    body: RiggedBody, joint: str, way: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " V"], Float[np.ndarray, " V"]]:
    """Of each vertex: how far it lies in a direction from a joint, and how far from that line."""
    offset = body.vertices - body.joints[body.joint(joint)]
    along = offset @ way
    return along, np.linalg.norm(offset - along[:, None] * way, axis=1)


def _extreme(body: RiggedBody, joint: str, way: Float[np.ndarray, " 3"]) -> int:
    along, aside = _along_and_aside(body, joint, way)
    return int(np.where(aside < NEAR, along, -np.inf).argmax())


def _on_skin(body: RiggedBody, joint: str, way: Float[np.ndarray, " 3"]) -> int:
    """Nearest to the ray among vertices that follow this joint or its parent; far ones lose by their distance."""
    along, aside = _along_and_aside(body, joint, way)
    index = body.joint(joint)
    follows = body.weights[:, index] + body.weights[:, body.parents[index]] > 0.5
    return int(np.where(follows & (along > 0), aside + 0.1 * along, np.inf).argmin())
