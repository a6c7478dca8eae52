"""RiggedBody: a body model with shape components, a skeleton and skinning weights, posed by linear blend skinning.

Frame: metres, y up, the body faces +z, its left side is +x. At rest every joint frame has the world's axes. A joint's
rotation is given in the frame of its parent, as in SMPL. The batched torch twin is `learn.data.bodies`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, Integer

from ..core.errors import InputError
from ..core.mesh import Mesh
from ..core.skinning import skin_poses, skinning_transforms


@dataclass(frozen=True, eq=False)
class RiggedBody:
    """A body model with V vertices, J joints and K shape coefficients; see the module for frames and units."""

    name: str
    vertices: Float[np.ndarray, "V 3"]
    """Vertices of the mean shape at rest (T-pose)."""
    faces: Int[np.ndarray, "F 3"]
    components: Float[np.ndarray, "K V 3"]
    """Displacement of the vertices for one standard deviation of each shape coefficient."""
    joints: Float[np.ndarray, "J 3"]
    """Joint positions of the mean shape at rest."""
    joint_components: Float[np.ndarray, "K J 3"]
    """Displacement of the joints for one standard deviation of each shape coefficient."""
    weights: Float[np.ndarray, "V J"]
    """Skinning weights, rows sum to 1."""
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root; parents come before their children."""

    def joint(self, name: str) -> int:
        """Look up the index of a joint; the KeyError of an unknown name lists the joints."""
        if name not in self.joint_names:
            raise KeyError(f"{self.name} has no joint {name!r}; it has {', '.join(self.joint_names)}")
        return self.joint_names.index(name)

    def carriers(self, names: Collection[str]) -> Int[np.ndarray, " J"]:
        """Find the joint whose rotation each joint has in a figure that has only the named ones, and the root."""
        carrier = np.arange(len(self.parents))
        for j, (name, parent) in enumerate(zip(self.joint_names, self.parents, strict=True)):
            if name not in names and parent >= 0:
                carrier[j] = carrier[parent]
        return carrier

    def part(self, vertices: Int[np.ndarray, " P"]) -> RiggedBody:
        """Select some vertices, without faces: what they do in poses takes less time than the whole surface."""
        rows = {"vertices": self.vertices[vertices], "components": self.components[:, vertices]}
        return replace(self, **rows, weights=self.weights[vertices], faces=np.zeros((0, 3), np.int64))

    def shaped(
        self, shape: Float[np.ndarray, "*B K"]
    ) -> tuple[Float[np.ndarray, "*B V 3"], Float[np.ndarray, "*B J 3"]]:
        """Compute vertices and joints at rest for shape coefficients (standard deviations).

        If there are fewer coefficients than components, the others are zero.
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
        """Compute vertices for shape coefficients and local joint rotations.

        Leading axes broadcast: one person in many poses, or many people in one pose.

        Args:
            root: displacement of the root joint from rest (metres).
        """
        vertices, joints = self.shaped(shape)
        return skin_poses(vertices, self.weights, *self.skinning_transforms(joints, rotmat, root))

    def skinning_transforms(
        self,
        joints: Float[np.ndarray, "*#B J 3"],
        rotmat: Float[np.ndarray, "*#B J 3 3"],
        root: Float[np.ndarray, "*#B 3"] | None = None,
    ) -> tuple[Float[np.ndarray, "*C J 3 3"], Float[np.ndarray, "*C J 3"]]:
        """Compute the map x -> rotation x + translation of each joint from rest to a pose; leading axes broadcast."""
        return skinning_transforms(joints, rotmat, self.parents, root)

    def mesh(self, vertices: Float[np.ndarray, "V 3"] | None = None) -> Mesh:
        """Make a Mesh with this body's faces and the given vertices; default is the mean shape at rest.

        Callers may change its arrays; those of the body, which they share, are copied.
        """
        points = self.vertices.copy() if vertices is None else np.asarray(vertices, np.float64)
        return Mesh(points, self.faces.copy(), name=self.name)


def load_body(name_or_path: str | Path = "human") -> RiggedBody:
    """Load a shipped body by name, which all callers share, or a `.npz` of its layout by path."""
    path = Path(name_or_path)
    shipped = path.suffix != ".npz"
    if shipped:
        path = Path(str(resources.files("mimesh.bodies") / f"{name_or_path}.npz"))
    if not path.exists():
        raise InputError(f"{name_or_path}: expected a shipped body (human, quadruped) or a .npz file, found neither")
    return _shipped_body(path) if shipped else _read_body(path)


def _read_body(path: Path) -> RiggedBody:
    """Read a body of a file of `research/recipes/save_body.py`."""
    with np.load(path) as data:
        return RiggedBody(
            name=path.stem,
            vertices=data["vertices"].astype(np.float64),
            faces=data["faces"].astype(np.int64),
            components=data["components"].astype(np.float64),
            joints=data["joints"].astype(np.float64),
            joint_components=data["joint_components"].astype(np.float64),
            weights=unpacked_weights(data["weight_joints"], data["weights"], len(data["parents"])),
            joint_names=tuple(data["joint_names"].tolist()),
            parents=tuple(int(p) for p in data["parents"]),
        )


_shipped_body = cache(_read_body)
"""Reads a shipped body once: it takes 25 ms, and many functions ask for it."""


def unpacked_weights(
    joints: Integer[np.ndarray, "V K"], weights: Float[np.ndarray, "V K"], count: int
) -> Float[np.ndarray, "V J"]:
    """Make the skinning weights of `count` joints from those stored: the largest few of a vertex, in half precision."""
    unpacked = np.zeros((len(weights), count))
    np.put_along_axis(unpacked, joints.astype(int), weights.astype(np.float64), axis=1)
    return unpacked / unpacked.sum(axis=1, keepdims=True)


EXTREMES = {
    "head": ("Head", (0.0, 1.0, 0.0)),
    "left hand": ("LeftHand", (1.0, 0.0, 0.0)),
    "right hand": ("RightHand", (-1.0, 0.0, 0.0)),
    "left foot": ("LeftToeBase", (0.0, 0.0, 1.0)),
    "right foot": ("RightToeBase", (0.0, 0.0, 1.0)),
}
"""Landmarks at the ends of the body: joint and direction; the vertex farthest along the line through the joint."""
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
"""Landmarks on the skin at a joint: joint and direction. The vertex near which a ray from the joint leaves the body."""
LANDMARKS = (*EXTREMES, *ON_SKIN)
"""Names of all 13 landmarks of a human in order; the first 5 are the ends of the body."""
TIP = (0.0, -0.6, 0.8)
"""Direction from a foot's joint to its tip. It points down too, because straight ahead of a hind foot is a forefoot."""
QUADRUPED_EXTREMES = {
    "nose": ("Head", (0.0, -0.33, 0.94)),
    **{f"{side} forefoot": (f"{side.title()}Fingers", TIP) for side in ("left", "right")},
    **{f"{side} hind foot": (f"{side.title()}Toes", TIP) for side in ("left", "right")},
}
QUADRUPED_ON_SKIN = {
    "withers": ("Chest", (0.0, 1.0, 0.0)),
    "croup": ("Hips", (0.0, 1.0, 0.0)),
    "root of the tail": ("Tail2", (0.0, 1.0, 0.0)),
    "neck": ("Neck3", (0.0, 0.8, -0.6)),
    **{f"{side} elbow": (f"{side.title()}Forearm", (0.0, 0.0, -1.0)) for side in ("left", "right")},
    **{f"{side} knee": (f"{side.title()}Shin", (0.0, 0.0, 1.0)) for side in ("left", "right")},
}
"""The same of a quadruped."""
NEAR = 0.06
"""Largest distance (metres) of an extreme from the line through its joint; a palm or a foot is narrower."""
DISTANCE_COST = 0.1
"""Cost of a metre along the ray, in metres of distance from the ray: prefers the first crossing of the skin."""


def landmarks(body: RiggedBody) -> dict[str, int]:
    """Find the vertex index of 13 landmarks on a shipped body, at rest; it is the same for all shapes and poses.

    Other surfaces with its joints may lack a vertex at a landmark: its index is -1.
    """
    quadruped = body.name == "quadruped"
    extremes, on_skin = (QUADRUPED_EXTREMES, QUADRUPED_ON_SKIN) if quadruped else (EXTREMES, ON_SKIN)
    found = {name: _extreme(body, joint, np.array(direction)) for name, (joint, direction) in extremes.items()}
    return found | {name: _on_skin(body, joint, np.array(direction)) for name, (joint, direction) in on_skin.items()}


def _line_coordinates(
    body: RiggedBody, joint: str, direction: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " V"], Float[np.ndarray, " V"]]:
    offset = body.vertices - body.joints[body.joint(joint)]
    along = offset @ direction
    return along, np.linalg.norm(offset - along[:, None] * direction, axis=1)


def _extreme(body: RiggedBody, joint: str, direction: Float[np.ndarray, " 3"]) -> int:
    """Find the vertex farthest along a line through a joint, among those less than NEAR from the line."""
    along, distance = _line_coordinates(body, joint, direction)
    near = distance < NEAR
    return int(np.where(near, along, -np.inf).argmax()) if near.any() else -1


def _on_skin(body: RiggedBody, joint: str, direction: Float[np.ndarray, " 3"]) -> int:
    """Find the vertex nearest to a ray from a joint, among those weighted mostly to this joint or its parent."""
    along, distance = _line_coordinates(body, joint, direction)
    index = body.joint(joint)
    weighted = body.weights[:, index] + body.weights[:, body.parents[index]] > 0.5
    ahead = weighted & (along > 0)
    return int(np.where(ahead, distance + DISTANCE_COST * along, np.inf).argmin()) if ahead.any() else -1
