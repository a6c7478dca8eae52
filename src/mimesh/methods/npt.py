"""NPT and its max-pool variant as ONNX files, run by onnxruntime, frame by frame.

Inputs "identity" (B, V, 3) and "driving" (B, V, 3) or, where the pose is pooled, (B, U, 3); output "result" (B, V, 3).
Each input is centred on its bounding box and divided by its largest distance from there; the result is centred on its
own bounding box, in units of the identity's radius. The file's metadata say the rest (key "mimesh").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Float32, Int

from ..core.canonical_order import canonical_order
from ..core.geometry import edges, spatial_order
from ..core.mesh import Clip, Mesh
from ..core.normalization import bbox_centre, radius
from ..core.surface_points import padded_vertices
from .base import Drive
from .root_motion import with_root_motion

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

POOLED_POINTS = 8192
"""Most driving points that a pooling network is given; a denser driving mesh is thinned by the seed."""
PATCHES = 200
"""Patches of the identity's surface by which the size of a result is judged, where the network does not know it."""


@dataclass(frozen=True, eq=False)
class NPTMethod:
    """A loaded network, ready for any identity."""

    rough: ClassVar[bool] = True
    name: str
    session: InferenceSession
    pose_code: str
    """"per_vertex" (driving and identity need one count) or "global_max" (any driving count)."""
    target_scale: str
    """"identity", or "truth": then the result's size is unknown, and `EdgeLengths` of the identity set it."""
    ensemble: int = 1
    seed: int = 0

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Rank both meshes and choose the driving points and their pairings, once for all frames."""
        ranked = canonical_order(identity.vertices)
        still = ranked.merge(identity.vertices)
        pooled = self.pose_code == "global_max"
        points = padded_vertices(driving.mesh, 0 if pooled else len(ranked), generator(self.seed, 0))
        taken = min(len(points), POOLED_POINTS) if pooled else len(ranked)
        # A pooled pose has no pairing to average over.
        rounds = 1 if pooled else self.ensemble
        pairings = [generator(self.seed, 1 + k).permutation(len(points))[:taken] for k in range(rounds)]
        lengths = EdgeLengths.of(still, edges(ranked.group[identity.faces]))

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            centred = vertices - bbox_centre(vertices)
            result = self._run(still, points.at(centred / radius(centred)), pairings)
            if self.target_scale == "truth":
                result = lengths.resized(result, still)
            return result[ranked.group]

        return lambda frames: with_root_motion(frames, pose, driving.mesh.name)

    def _run(
        self,
        identity: Float[np.ndarray, "W 3"],
        driving: Float[np.ndarray, "P 3"],
        pairings: list[Int[np.ndarray, " N"]],
    ) -> Float[np.ndarray, "W 3"]:
        """Mean result over the pairings (float64)."""
        total = np.zeros(identity.shape)
        for pairing in pairings:
            inputs = {"identity": batch_of_one(identity), "driving": batch_of_one(driving[pairing])}
            total += np.asarray(self.session.run(["result"], inputs)[0])[0]
        return total / len(pairings)


@dataclass(frozen=True, eq=False)
class EdgeLengths:
    """Distances between the middles of neighbouring patches of a surface: a size that roughness hardly changes."""

    patch: Int[np.ndarray, " W"]
    pairs: Int[np.ndarray, "E 2"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "W 3"], welded_edges: Int[np.ndarray, "E 2"]) -> EdgeLengths:
        """Up to PATCHES patches of equally many vertices, and which of them touch."""
        count, patch = min(PATCHES, len(points)), np.empty(len(points), np.int64)
        patch[spatial_order(points)] = np.arange(len(points)) * count // len(points)
        touching = np.unique(patch[welded_edges].reshape(-1, 2), axis=0)
        return cls(patch, touching[touching[:, 0] != touching[:, 1]])

    def total(self, points: Float[np.ndarray, "W 3"]) -> float:
        """Sum of the distances; 1 for a point cloud, whose size is left as it is."""
        sums = np.stack([np.bincount(self.patch, column) for column in points.T], axis=1)
        middles = sums / np.bincount(self.patch)[:, None]
        apart = np.linalg.norm(middles[self.pairs[:, 0]] - middles[self.pairs[:, 1]], axis=1)
        return float(apart.sum()) if len(apart) else 1.0

    def resized(self, points: Float[np.ndarray, "W 3"], like: Float[np.ndarray, "W 3"]) -> Float[np.ndarray, "W 3"]:
        """Points in the size that makes their lengths those of `like`."""
        return points * self.total(like) / self.total(points)


def batch_of_one(points: Float[np.ndarray, "*T N 3"]) -> Float32[np.ndarray, "1 *T N 3"]:
    """As a network's input."""
    return np.ascontiguousarray(points[None], np.float32)


def generator(seed: int, stream: int) -> np.random.Generator:
    """Random numbers of their own for each purpose (stream) of a seed."""
    return np.random.default_rng(np.random.SeedSequence([seed, stream]))
