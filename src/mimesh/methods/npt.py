"""NPT and its max-pool variant as ONNX files, run by onnxruntime, frame by frame.

Inputs "identity" (B, V, 3) and "driving" (B, V, 3) or, where the pose is pooled, (B, U, 3); output "result" (B, V, 3).
Each input is centred on its bounding box and divided by its largest distance from there; the result is centred on its
own bounding box, in units of the identity's radius. The file's metadata (key "mimesh") give `pose_code`,
`target_scale` and `pairing`. Networks of the papers' public code have the `target_scale` metres: they get and give
metres.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..core.canonical_order import CanonicalOrder, canonical_order
from ..core.errors import InputError, option
from ..core.geometry import edges, spatial_order
from ..core.mesh import Clip, Mesh, same_mesh
from ..core.normalization import bbox_centre, radius
from ..core.surface_points import batch_of_one, generator, padded_vertices
from .base import Drive, ShapeMethod, Shapes, with_root_motion

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

POOLED_POINTS = 8192
"""Largest number of driving points for a pooling network; of a denser driving mesh a random subset is taken."""
PATCHES = 200
"""Patches of the identity's surface by which a result is rescaled, where the network does not know its size."""
METRES = "metres"
"""The `target_scale` of networks whose meshes are in metres."""
RADII = (0.2, 2.5)
"""Metres. Radii of people's and animals' meshes: those of Table 6 have 0.6 to 1.3; other units give 30 or more."""
PointsAt = Callable[[Float[np.ndarray, "U 3"]], Float[np.ndarray, "P 3"]]
"""Computes the driving points in a frame."""


@dataclass(frozen=True, eq=False)
class NPTMethod:
    """The methods `npt` and `npt-maxpool`: a loaded network, ready for any identity."""

    rough: ClassVar[bool] = True
    name: str
    session: InferenceSession
    pose_code: str
    """"per_vertex" (driving and identity need one count) or "global_max" (any driving count)."""
    target_scale: str
    """Unit of the network's shapes: "identity", the identity's radius; or "truth", the unknown radius of the true
    result. Then `drive_of` rescales them by `PatchDistances` of the identity; or METRES, in which the meshes are given,
    too."""
    ensemble: int = 1
    """Random pairings over which results are averaged."""
    seed: int = 0
    body: str = "human"
    """Name of the shipped body that it was trained on."""
    pairing: str = "random"
    """Driving point of an identity vertex: "random", or "order": that of its own index, of the same mesh."""
    sizes: tuple[float, float] | None = None
    """Metres. Radius of the identity and of the driving's first frame, for METRES; None: the network gets radius 1."""

    def with_sizes(self, identity: tuple[str, float], driving: tuple[str, float]) -> NPTMethod:
        """Return this method for two meshes, given by name and radius."""
        if self.target_scale != METRES:
            return self
        return dataclasses.replace(self, sizes=radii_in_metres(identity, driving))

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Rank both meshes and choose the driving points and their pairings, once for all frames.

        Raises:
            InputError: vertices are paired by index, and those of the two meshes do not correspond.
        """
        return drive_of(self, identity, driving)

    def shapes(self, identity: Mesh, driving: Clip) -> Shapes:
        """As `ShapeMethod.shapes`."""
        ranked = canonical_order(identity.vertices)
        rest = ranked.merge(identity.vertices)
        points_at, pairings = self._paired(ranked, identity, driving.mesh)

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            return self._run(rest, points_at(driving_input(vertices, self.sizes)), pairings)[ranked.group]

        return lambda frames: map(pose, frames)

    def _paired(
        self, ranked: CanonicalOrder, identity: Mesh, driving: Mesh
    ) -> tuple[PointsAt, list[Int[np.ndarray, " N"]]]:
        """Choose the driving points, and their order for each run of the network."""
        # A pooled pose does not depend on the order of the driving points: there is no pairing to average over.
        pooled = self.pose_code == "global_max"
        if self.pairing == "order":
            check_same_mesh(self.name, identity, driving)
            return ranked.merge, [np.arange(len(ranked))]
        # A network with one pose code for each vertex needs as many driving points as the identity has: where the
        # driving has fewer, random points of its surface are added, where it has more, each pairing leaves some out.
        points = padded_vertices(driving, 0 if pooled else len(ranked), generator(self.seed, 0))
        count = min(len(points), POOLED_POINTS) if pooled else len(ranked)
        rounds = 1 if pooled else self.ensemble
        return points.at, [generator(self.seed, 1 + k).permutation(len(points))[:count] for k in range(rounds)]

    def _run(
        self,
        identity: Float[np.ndarray, "W 3"],
        driving: Float[np.ndarray, "P 3"],
        pairings: list[Int[np.ndarray, " N"]],
    ) -> Float[np.ndarray, "W 3"]:
        total, size = np.zeros(identity.shape), self.sizes[0] if self.sizes else 1.0
        for pairing in pairings:
            inputs = {"identity": batch_of_one(identity * size), "driving": batch_of_one(driving[pairing])}
            total += np.asarray(self.session.run(["result"], inputs)[0])[0]
        return total / (len(pairings) * size)


def drive_of(network: ShapeMethod, identity: Mesh, driving: Clip) -> Drive:
    """Give the shapes of a network the identity's size, where they have none, and the path of the driving."""
    shapes = network.shapes(identity, driving)
    if network.target_scale == "truth":
        shapes = with_size_of(identity, shapes)
    return lambda frames: with_root_motion(frames, shapes, driving.mesh.name)


def with_size_of(identity: Mesh, shapes: Shapes) -> Shapes:
    """Scale shapes so that their `PatchDistances` add up to those of the identity at rest."""
    ranked = canonical_order(identity.vertices)
    rest = ranked.merge(identity.vertices)
    lengths = PatchDistances.of(rest, edges(ranked.group[identity.faces]))
    total = lengths.total(rest)
    return lambda frames: (shape * (total / lengths.total(ranked.merge(shape))) for shape in shapes(frames))


@dataclass(frozen=True, eq=False)
class PatchDistances:
    """Distances between the centroids of adjacent patches of a surface: a size that roughness hardly changes."""

    patch: Int[np.ndarray, " W"]
    """Patch of each point."""
    pairs: Int[np.ndarray, "E 2"]
    """Pairs of adjacent patches."""

    @classmethod
    def of(cls, points: Float[np.ndarray, "W 3"], welded_edges: Int[np.ndarray, "E 2"]) -> PatchDistances:
        """Divide points into at most PATCHES compact patches of equal size, adjacent where an edge joins them."""
        # Successive points of a spatial order are near each other: equal runs of it are compact patches.
        count, patch = min(PATCHES, len(points)), np.empty(len(points), np.int64)
        patch[spatial_order(points)] = np.arange(len(points)) * count // len(points)
        pairs = np.unique(patch[welded_edges].reshape(-1, 2), axis=0)
        return cls(patch, pairs[pairs[:, 0] != pairs[:, 1]])

    def total(self, points: Float[np.ndarray, "W 3"]) -> float:
        """Return the sum of the distances; 1 for a point cloud, whose size is then left as it is."""
        sums = np.stack([np.bincount(self.patch, column) for column in points.T], axis=1)
        centroids = sums / np.bincount(self.patch)[:, None]
        distances = np.linalg.norm(centroids[self.pairs[:, 0]] - centroids[self.pairs[:, 1]], axis=1)
        return float(distances.sum()) if len(distances) else 1.0


def radii_in_metres(*meshes: tuple[str, float]) -> tuple[float, ...]:
    """Return the radii of meshes, given by name and radius.

    Raises:
        InputError: a radius is not that of a mesh in metres.
    """
    for name, size in meshes:
        if not RADII[0] <= size <= RADII[1]:
            raise InputError(
                f"{name}: expected a mesh in metres, as the network was trained on, with a radius of {RADII[0]} to "
                f"{RADII[1]}, found {size:.4g}; scale the file"
            )
    return tuple(size for _, size in meshes)


def driving_input(
    vertices: Float[np.ndarray, "U 3"], sizes: tuple[float, float] | None = None
) -> Float[np.ndarray, "U 3"]:
    """Centre the vertices of a driving frame on their bounding box, in their unit sphere or, with sizes, in metres."""
    centred = vertices - bbox_centre(vertices)
    return centred / radius(centred) if sizes is None else centred * sizes[1]


def check_same_mesh(method: str, identity: Mesh, driving: Mesh) -> None:
    """Check that vertices can be paired by index: by their number and, where both meshes have some, by the triangles.

    Raises:
        InputError: they cannot.
    """
    counts = len(identity.vertices), len(driving.vertices)
    points = 0 in (len(identity.faces), len(driving.faces)) and counts[0] == counts[1]
    if not points and not same_mesh(identity, driving):
        found = f"{counts[1]} vertices" if counts[0] != counts[1] else "other triangles"
        raise InputError(
            f"{driving.name}: expected the {counts[0]} vertices and the triangles of {identity.name}, which {method} "
            f"pairs by index, found {found}; give {option('pairing', 'random')} with npt or aniformer"
        )
