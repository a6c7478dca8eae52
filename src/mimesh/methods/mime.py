"""mime as an ONNX file, run by onnxruntime: the identity is read once, each driving frame once.

Inputs "points", "normals" (1, N, 3) of a surface and "vertices", "vertex_normals" (1, V, 3) of the same mesh; outputs
"rotation" (1, J, 3, 3) and "joints" (1, J, 3), and "scores" (1, V, J), whose softmax is the skinning weights. Any unit
and place will do; normals that are not known are zero. A frame is then linear blend skinning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..geometry import face_vectors, sample_surface, vertex_normals
from ..mesh import Clip, Mesh
from . import Drive
from .network import batch_of_one, generator
from .pairing import Ranked, rank_vertices
from .tracking import Parts, mean_rotation
from .travel import travelling

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

CHUNK = 16_384
"""Vertices that are weighed at a time."""
READINGS = 4
"""Of a mesh, each of other points of its surface; their mean is taken. All of them are followed through a clip."""


@dataclass(frozen=True, eq=False)
class Rig:
    """Joints of a mesh and how they hold it."""

    rotation: Float[np.ndarray, "J 3 3"]
    joints: Float[np.ndarray, "J 3"]
    weights: Float[np.ndarray, "V J"]
    """Skinning weights, rows sum to 1."""


@dataclass(frozen=True, eq=False)
class Mime:
    """A loaded network, ready for any identity."""

    name: str
    session: InferenceSession
    parents: tuple[int, ...]
    points: int
    """That are read of a mesh."""
    seed: int = 0

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Read the identity and the driving's glimpses, once for all; every frame is then measured against those."""
        ranked = rank_vertices(identity.vertices)
        still = ranked.merge(identity.vertices)
        normals = vertex_normals(still, ranked.group[identity.faces[_face_order(ranked, identity.faces)]])
        own = self._identity(identity, still, normals)
        turned = self._driving(driving)
        above = list(self.parents[1:])
        bones = np.einsum("jkl,jk->jl", own.rotation[above], own.joints[1:] - own.joints[above])
        # What every joint sees of a vertex is the same in all frames.
        local = np.einsum("jkl,vjk->vjl", own.rotation, still[:, None] - own.joints)
        held = np.concatenate([own.weights[..., None] * local, own.weights[..., None]], -1)
        held = held.reshape(len(still), -1).astype(np.float32)

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            rotation = turned(vertices)
            place = [own.joints[0]]
            for j, parent in enumerate(self.parents[1:]):
                place.append(place[parent] + rotation[parent] @ bones[j])
            moves = np.concatenate([rotation.transpose(0, 2, 1), np.stack(place)[:, None]], axis=1)
            return (held @ moves.reshape(-1, 3).astype(np.float32)).astype(np.float64)[ranked.group]

        return lambda frames: travelling(frames, pose, driving.mesh.name)

    def _identity(self, mesh: Mesh, vertices: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "V 3"]) -> Rig:
        """Joints and skinning weights of a mesh, of all its vertices: the mean of several readings."""
        places = Samples.of(mesh, READINGS * self.points, generator(self.seed, 0))
        parts = [places.part(k, READINGS) for k in range(READINGS)]
        rigs = [self._read(part, mesh.vertices, vertices, normals) for part in parts]
        rotation = mean_rotation(np.stack([rig.rotation for rig in rigs]))
        return Rig(rotation, *(np.mean([getattr(rig, name) for rig in rigs], axis=0) for name in ("joints", "weights")))

    def _driving(self, glimpses: Clip) -> Callable[[Float[np.ndarray, "U 3"]], Float[np.ndarray, "J 3 3"]]:
        """From vertices of a driving frame to the rotation of every joint.

        What the network makes of each glimpse is turned back to the first frame by the tracked motion, and the mean
        taken; so no frame has errors of its own, and what stands still stays still.
        """
        places = Samples.of(glimpses.mesh, READINGS * self.points, generator(self.seed, 1))
        seen = [glimpses.vertices[k % len(glimpses)] for k in range(max(READINGS, len(glimpses)))]
        rigs = [
            self._read(places.part(k, READINGS), vertices, places.points(vertices), places.normals(vertices))
            for k, vertices in enumerate(seen)
        ]
        weights = np.mean([rig.weights for rig in rigs], axis=0)
        parts = Parts.of(places.points(seen[0]), weights, rigs[0].joints, self.parents)
        back = [parts.turned(places.points(v)).mT @ rig.rotation for v, rig in zip(seen, rigs, strict=True)]
        start = mean_rotation(np.stack(back))
        return lambda vertices: parts.turned(places.points(vertices)) @ start

    def _read(
        self,
        places: Samples,
        vertices: Float[np.ndarray, "U 3"],
        weighed: Float[np.ndarray, "V 3"],
        normals: Float[np.ndarray, "V 3"],
    ) -> Rig:
        """Joints from places on a mesh, and skinning weights of points of it, some of them at a time."""
        inputs = {"points": batch_of_one(places.points(vertices)), "normals": batch_of_one(places.normals(vertices))}
        weights = []
        for start in range(0, len(weighed), CHUNK):
            few = slice(start, start + CHUNK)
            given = {"vertices": batch_of_one(weighed[few]), "vertex_normals": batch_of_one(normals[few])}
            found = self.session.run(["rotation", "joints", "scores"], {**inputs, **given})
            rotation, joints, scores = (np.asarray(array)[0].astype(np.float64) for array in found)
            weights.append(np.exp(scores - scores.max(axis=1, keepdims=True)))
            weights[-1] /= weights[-1].sum(axis=1, keepdims=True)
        return Rig(rotation, joints, np.concatenate(weights))


@dataclass(frozen=True, eq=False)
class Samples:
    """Points spread evenly over a mesh, the same ones of its surface in every frame; vertices, of a point cloud."""

    corners: Int[np.ndarray, "N 3"]
    shares: Float[np.ndarray, "N 3"]

    @classmethod
    def of(cls, mesh: Mesh, count: int, rng: np.random.Generator) -> Samples:
        """Random points by area, whatever the order of vertices and faces."""
        ranked = rank_vertices(mesh.vertices)
        if len(mesh.faces) == 0:
            many = len(ranked)
            chosen = rng.permutation(many)[:count] if many >= count else rng.integers(many, size=count)
            vertex = ranked.order[ranked.start[chosen]]
            return cls(np.repeat(vertex[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (count, 1)))
        faces = mesh.faces[_face_order(ranked, mesh.faces)]
        face, shares = sample_surface(mesh.vertices, faces, count, rng)
        return cls(faces[face], shares)

    def part(self, which: int, of: int) -> Samples:
        """One of so many disjoint parts, as evenly spread as the whole."""
        return Samples(self.corners[which % of :: of], self.shares[which % of :: of])

    def points(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
        """Where the points are in a frame."""
        return (vertices[self.corners] * self.shares[..., None]).sum(axis=1)

    def normals(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
        """Unit normals of the surface there, in a frame; zeros without faces."""
        normals = face_vectors(vertices, self.corners)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _face_order(ranked: Ranked, faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, " F"]:
    """Indices that sort faces by the ranks of their vertices, whatever their order was."""
    corners = ranked.group[faces]
    first = corners.argmin(axis=1)[:, None]
    turned = np.take_along_axis(corners, (first + np.arange(3)) % 3, axis=1)
    return np.lexsort(turned.T[::-1])
