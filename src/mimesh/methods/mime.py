"""mime as an ONNX file, run by onnxruntime: the identity is read once, each driving frame once.

Inputs "points", "normals" (1, N, 3) of a surface and "vertices", "vertex_normals" (1, V, 3) of the same mesh; outputs
"rotation" (1, J, 3, 3) and "joints" (1, J, 3), and "scores" (1, V, J), whose softmax is the skinning weights. Any unit
and place will do; normals that are not known are zero. A frame is then linear blend skinning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..geometry import face_vectors, sample_surface, vertex_normals
from ..mesh import Mesh
from . import Drive
from .network import batch_of_one, generator
from .pairing import rank_order, rank_vertices
from .travel import travelling

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

CHUNK = 16_384
"""Vertices that are weighed at a time."""


@dataclass(frozen=True, eq=False)
class Mime:
    """A loaded network, ready for any identity."""

    name: str
    session: InferenceSession
    parents: tuple[int, ...]
    points: int
    """That are read of a mesh."""
    seed: int = 0

    def prepare(self, identity: Mesh, driving: Mesh) -> Drive:
        """Read the identity's joints and skinning weights, and choose the driving points, once for all frames."""
        ranked = rank_vertices(identity.vertices)
        still = ranked.merge(identity.vertices)
        own = Samples.of(identity, self.points, generator(self.seed, 0))
        seen = own.at(identity.vertices)
        rotation, joints = self._read(*seen)
        normals = vertex_normals(still, _sorted(still, ranked.group[identity.faces]))
        weights = self._weights(seen, still, normals)
        theirs = Samples.of(driving, self.points, generator(self.seed, 1))
        above = list(self.parents[1:])
        bones = np.einsum("jkl,jk->jl", rotation[above], joints[1:] - joints[above])
        # What every joint sees of a vertex is the same in all frames.
        local = np.einsum("jkl,vjk->vjl", rotation, still[:, None] - joints)
        held = np.concatenate([weights[..., None] * local, weights[..., None]], -1).reshape(len(still), -1)

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            turned, _ = self._read(*theirs.at(vertices))
            place = [joints[0]]
            for j, parent in enumerate(self.parents[1:]):
                place.append(place[parent] + turned[parent] @ bones[j])
            moves = np.concatenate([turned.transpose(0, 2, 1), np.stack(place)[:, None]], axis=1)
            return (held @ moves.reshape(-1, 3))[ranked.group]

        return lambda frames: travelling(frames, pose, driving.name)

    def _read(
        self, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]
    ) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]:
        """Rotation and place of every joint."""
        one = batch_of_one(points[:1])
        inputs = {"points": batch_of_one(points), "normals": batch_of_one(normals)}
        found = self.session.run(["rotation", "joints"], {**inputs, "vertices": one, "vertex_normals": one})
        rotation, joints = (np.asarray(array)[0].astype(np.float64) for array in found)
        return rotation, joints

    def _weights(
        self,
        read: tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]],
        vertices: Float[np.ndarray, "V 3"],
        normals: Float[np.ndarray, "V 3"],
    ) -> Float[np.ndarray, "V J"]:
        """Skinning weights, some vertices at a time."""
        inputs = {"points": batch_of_one(read[0]), "normals": batch_of_one(read[1])}
        chunks = []
        for start in range(0, len(vertices), CHUNK):
            given = {"vertices": vertices[start : start + CHUNK], "vertex_normals": normals[start : start + CHUNK]}
            scores = self.session.run(["scores"], {**inputs, **{k: batch_of_one(v) for k, v in given.items()}})[0]
            chunks.append(np.asarray(scores)[0].astype(np.float64))
        weights = np.exp(np.concatenate(chunks) - np.concatenate(chunks).max(axis=1, keepdims=True))
        return weights / weights.sum(axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Samples:
    """Points spread evenly over a mesh, the same ones of its surface in every frame; vertices, of a point cloud."""

    corners: Int[np.ndarray, "N 3"]
    shares: Float[np.ndarray, "N 3"]

    @classmethod
    def of(cls, mesh: Mesh, count: int, rng: np.random.Generator) -> Samples:
        """Random points by area, whatever the order of vertices and faces."""
        if len(mesh.faces) == 0:
            order, many = rank_order(mesh.vertices), len(mesh.vertices)
            chosen = order[rng.permutation(many)[:count] if many >= count else rng.integers(many, size=count)]
            return cls(np.repeat(chosen[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (count, 1)))
        faces = _sorted(mesh.vertices, mesh.faces)
        face, shares = sample_surface(mesh.vertices, faces, count, rng)
        return cls(faces[face], shares)

    def at(self, vertices: Float[np.ndarray, "U 3"]) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
        """Where the points are in a frame, and their unit normals (zeros without faces)."""
        normals = face_vectors(vertices, self.corners)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return (vertices[self.corners] * self.shares[..., None]).sum(axis=1), normals / np.maximum(length, 1e-12)


def _sorted(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "F 3"]:
    """Faces by the place of their middles."""
    return faces[rank_order(vertices[faces].mean(axis=1))]
