"""Run the network of mime: joints of a mesh from points sampled from its surface, and skinning weights of any points.

Inputs of the ONNX file are "points" and "normals" (1, N, 3) of the samples, and "vertices" and "vertex_normals"
(1, V, 3), points of the same mesh at which weights are predicted. Outputs are "rotation" (1, J, 3, 3) and "joints"
(1, J, 3), in the world, and "scores" (1, V, J), whose softmax over the joints gives the skinning weights. Any unit and
position will do; normals that are not known are zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...bodies.joint_names import other_side
from ...core.geometry import MIRROR, mirrored_rotations
from ...core.rig import Rig
from ...core.surface_points import SurfacePoints
from ..npt import batch_of_one

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

CHUNK = 16_384
"""Vertices whose weights are predicted in one run of the network; bounds the memory."""


@dataclass(frozen=True, eq=False)
class NetworkPoints:
    """Points of a surface as the network takes them."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    """Unit normals, or zeros where they are not known."""

    @classmethod
    def of(cls, samples: SurfacePoints, vertices: Float[np.ndarray, "V 3"]) -> NetworkPoints:
        """Compute samples of a mesh in a frame."""
        return cls(samples.points(vertices), samples.normals(vertices))

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, chosen: slice) -> NetworkPoints:
        return NetworkPoints(self.points[chosen], self.normals[chosen])

    def joined(self, others: NetworkPoints) -> NetworkPoints:
        """Append other points of the same surface."""
        return NetworkPoints(
            np.concatenate([self.points, others.points]), np.concatenate([self.normals, others.normals])
        )

    def mirrored(self) -> NetworkPoints:
        """Reflect the points at the plane x = 0."""
        return NetworkPoints(self.points * MIRROR, self.normals * MIRROR)

    def turned(self, turn: Float[np.ndarray, "3 3"]) -> NetworkPoints:
        """Rotate the points about the origin."""
        return NetworkPoints(self.points @ turn.T, self.normals @ turn.T)


@dataclass(frozen=True, eq=False)
class JointNetwork:
    """A loaded network."""

    session: InferenceSession
    joints: tuple[str, ...]
    """Names of the joints."""

    def predict(
        self,
        samples: NetworkPoints,
        queries: NetworkPoints | None,
        mirrored: bool = False,
        turn: Float[np.ndarray, "3 3"] | None = None,
    ) -> Rig:
        """Predict joints from samples of a mesh, and skinning weights of the queries, CHUNK at a time.

        With `mirrored` the network gets the mirror image, and its prediction is mirrored back: its errors are others,
        so the mean of both kinds is nearer to the truth than that of as many of one kind. With `turn` it gets the mesh
        after this rotation, which is undone in the prediction.
        """
        if turn is not None:
            rig = self.predict(samples.turned(turn), queries and queries.turned(turn), mirrored)
            return Rig(turn.T @ rig.rotation, rig.joints @ turn, rig.weights)
        if mirrored:
            rig = self.predict(samples.mirrored(), queries and queries.mirrored())
            rotation = mirrored_rotations(rig.rotation[self._other_sides])
            return Rig(rotation, rig.joints[self._other_sides] * MIRROR, rig.weights[:, self._other_sides])
        given = {"points": batch_of_one(samples.points), "normals": batch_of_one(samples.normals)}
        at = queries or NetworkPoints(*np.zeros((2, 1, 3)))  # the network takes no empty input
        outputs = []
        for start in range(0, len(at), CHUNK):
            chunk = at[start : start + CHUNK]
            given |= {"vertices": batch_of_one(chunk.points), "vertex_normals": batch_of_one(chunk.normals)}
            found = self.session.run(["rotation", "joints", "scores"], given)
            outputs.append([np.asarray(array)[0].astype(np.float64) for array in found])
        rotation, joints, _ = outputs[-1]  # the same for all chunks: they do not depend on the queries
        weights = [softmax(scores) for _, _, scores in outputs] if queries else [np.zeros((0, len(joints)))]
        return Rig(rotation, joints, np.concatenate(weights))

    @cached_property
    def _other_sides(self) -> list[int]:
        """Joint on the other side of the body of each joint, or itself."""
        index = {name: j for j, name in enumerate(self.joints)}
        return [index.get(other_side(name), j) for name, j in index.items()]


def softmax(scores: Float[np.ndarray, "V J"]) -> Float[np.ndarray, "V J"]:
    """Compute skinning weights from scores; subtracting the largest score first keeps the exponentials finite."""
    weights = np.exp(scores - scores.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    return weights
