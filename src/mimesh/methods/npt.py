"""NPT, its max-pool variant and AniFormer as ONNX files, run by onnxruntime.

Inputs "identity" (B, V, 3) and "driving" (B, V, 3) or, where the pose is pooled, (B, U, 3); output "result" (B, V, 3).
Each input is centred on its bounding box and divided by its largest distance from there; the result is centred on its
own bounding box, in units of the identity's radius. The file's metadata (key "mimesh") give `pose_code`,
`target_scale` and `pairing`. Networks of the papers' public code have the `target_scale` metres: they get and give
metres.

AniFormer runs over overlapping windows of the driving clip, "driving" (1, T, V, 3), each frame in its own unit sphere;
"result" is (1, T, V, 3) or, with the regression head, (1, 1, V, 3), the window's middle frame. The result of a frame is
the mean over all windows that contain it: at most two windows of driving frames are in memory.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..core.canonical_order import CanonicalOrder, canonical_order, file_order
from ..core.errors import InputError, option
from ..core.geometry import edges, spatial_order
from ..core.mesh import Clip, Mesh, same_mesh
from ..core.normalization import bbox_centre, radius
from ..core.surface_points import batch_of_one, generator, padded_vertices
from .base import Drive, Shapes, with_root_motion

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


@dataclass(frozen=True, eq=False, kw_only=True)
class PaperNetwork:
    """A loaded network of the papers, trained on centred meshes: its results have no place, and some have no size."""

    rough: ClassVar[bool] = True
    name: str
    session: InferenceSession
    target_scale: str
    """Unit of the network's shapes: "identity", the identity's radius; or "truth", the unknown radius of the true
    result. Then `prepare` rescales them by `PatchDistances` of the identity; or METRES, in which the meshes are given,
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

    def with_sizes(self, *meshes: tuple[str, float]) -> PaperNetwork:
        """Return this method for an identity and a driving, given by name and radius in the unit of the files.

        Raises:
            InputError: the network needs metres, and a radius is not that of a mesh in metres.
        """
        if self.target_scale != METRES:
            return self
        for name, size in meshes:
            if not RADII[0] <= size <= RADII[1]:
                raise InputError(
                    f"{name}: expected a mesh in metres, as the network was trained on, with a radius of {RADII[0]} to "
                    f"{RADII[1]}, found {size:.4g}; scale the file"
                )
        return dataclasses.replace(self, sizes=tuple(size for _, size in meshes))

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Rank both meshes and choose the driving points and their pairings, once for all frames.

        Shapes get the identity's size, where they have none, and the path of the driving.

        Raises:
            InputError: the network needs a vertex count that one of the meshes has not, or meshes that correspond.
        """
        shapes = self.shapes(identity, driving)
        if self.target_scale != "truth":
            return lambda frames: with_root_motion(frames, shapes, driving.mesh.name)
        ranked = canonical_order(identity.vertices)
        rest = ranked.merge(identity.vertices)
        lengths = PatchDistances.of(rest, edges(ranked.group[identity.faces]))
        total = lengths.total(rest)

        def sized(frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
            return (shape * (total / lengths.total(ranked.merge(shape))) for shape in shapes(frames))

        return lambda frames: with_root_motion(frames, sized, driving.mesh.name)

    def shapes(self, identity: Mesh, driving: Clip) -> Shapes:
        """As `prepare`; the function that is returned gives the network's own results.

        The origin is where the training had the centre of the true result's bounding box.
        """
        raise NotImplementedError

    def _driving_input(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "U 3"]:
        """Centre a driving frame on its bounding box, in its unit sphere or, with `sizes`, in metres."""
        centred = vertices - bbox_centre(vertices)
        return centred / radius(centred) if self.sizes is None else centred * self.sizes[1]

    def _check_same_mesh(self, identity: Mesh, driving: Mesh) -> None:
        """Raise InputError where vertices cannot be paired by index: other counts or, where both have some, faces."""
        counts = len(identity.vertices), len(driving.vertices)
        points = 0 in (len(identity.faces), len(driving.faces)) and counts[0] == counts[1]
        if not points and not same_mesh(identity, driving):
            found = f"{counts[1]} vertices" if counts[0] != counts[1] else "other triangles"
            raise InputError(
                f"{driving.name}: expected the {counts[0]} vertices and the triangles of {identity.name}, which "
                f"{self.name} pairs by index, found {found}; give {option('pairing', 'random')} with npt or aniformer"
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class NPTMethod(PaperNetwork):
    """The methods `npt` and `npt-maxpool`, ready for any identity."""

    pose_code: str
    """"per_vertex" (driving and identity need one count) or "global_max" (any driving count)."""

    def shapes(self, identity: Mesh, driving: Clip) -> Shapes:
        """As `PaperNetwork.shapes`."""
        ranked = canonical_order(identity.vertices)
        rest = ranked.merge(identity.vertices)
        points_at, pairings = self._paired(ranked, identity, driving.mesh)

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            return self._run(rest, points_at(self._driving_input(vertices)), pairings)[ranked.group]

        return lambda frames: map(pose, frames)

    def _paired(
        self, ranked: CanonicalOrder, identity: Mesh, driving: Mesh
    ) -> tuple[PointsAt, list[Int[np.ndarray, " N"]]]:
        """Choose the driving points, and their order for each run of the network."""
        # A pooled pose does not depend on the order of the driving points: there is no pairing to average over.
        pooled = self.pose_code == "global_max"
        if self.pairing == "order":
            self._check_same_mesh(identity, driving)
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


OVERLAP = 1
"""Frames that a window shares with the next one. On `val` two of three frames cost more for the same PMD (to three
digits) and 1 % less jitter; none makes 5 to 20 % more jitter."""
Window = Float[np.ndarray, "T N 3"]
Run = Callable[[Window], Float[np.ndarray, "R V 3"]]
"""Maps the driving frames of a window to results: one for each frame, or one for the middle frame."""
Pairing = tuple[Int[np.ndarray, " W"], Int[np.ndarray, " W"]]
"""Order in which the network gets the identity's points, and order in which it gets the driving's."""


@dataclass(frozen=True, eq=False, kw_only=True)
class AniFormerMethod(PaperNetwork):
    """The method `aniformer`, ready for any identity."""

    frames: int
    """Driving frames of a window (T)."""
    head: str
    """"frames": one result for each frame of a window; "regression": one for its middle frame."""
    vertices: int = 0
    """Vertices that both meshes must have, in the order of the network's training; 0: any two meshes."""

    def shapes(self, identity: Mesh, driving: Clip) -> Shapes:
        """As `PaperNetwork.shapes`."""
        match = self._in_file_order if self.vertices else self._paired
        ranked, points_at, pairings = match(identity, driving.mesh)
        rest = ranked.merge(identity.vertices)

        def points_of(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
            return points_at(self._driving_input(vertices))

        def run(window: Window) -> Float[np.ndarray, "R V 3"]:
            return self._run(rest, window, pairings)

        def posed(frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
            points = map(points_of, frames)
            if self.head == "regression":
                results = middles(points, run, self.frames)
            else:
                results = blended(points, run, self.frames, max(1, self.frames - OVERLAP))
            return (result[ranked.group] for result in results)

        return posed

    def _paired(self, identity: Mesh, driving: Mesh) -> tuple[CanonicalOrder, PointsAt, list[Pairing]]:
        """Weld both meshes, and pair their points at random, or as they correspond: in the same random order."""
        ranked = canonical_order(identity.vertices)
        if self.pairing == "order":
            orders = [self._pairing(k, len(ranked), len(ranked))[0] for k in range(self.ensemble)]
            pairings = [(order, order) for order in orders]
            self._check_same_mesh(identity, driving)
            return ranked, ranked.merge, pairings
        points = padded_vertices(driving, len(ranked), generator(self.seed, 0))
        return ranked, points.at, [self._pairing(k, len(ranked), len(points)) for k in range(self.ensemble)]

    def _in_file_order(self, identity: Mesh, driving: Mesh) -> tuple[CanonicalOrder, PointsAt, list[Pairing]]:
        """Take all vertices of both meshes as they are numbered; only their count can be checked."""
        for mesh in (identity, driving):
            if len(mesh.vertices) != self.vertices:
                raise InputError(
                    f"{mesh.name}: expected the {self.vertices} vertices that {self.name} was trained on, in their "
                    f"order, found {len(mesh.vertices)}; choose another model"
                )
        order = file_order(self.vertices)
        return order, order.merge, [(order.order, order.order)]

    def _pairing(self, k: int, points: int, driving_points: int) -> Pairing:
        """Return random orders of both meshes' points.

        The identity's is random too, because all points attend to the first ones, which must be spread over the body.
        """
        rng = generator(self.seed, 1 + k)
        return rng.permutation(points), rng.permutation(driving_points)[:points]

    def _run(
        self, identity: Float[np.ndarray, "W 3"], window: Window, pairings: list[Pairing]
    ) -> Float[np.ndarray, "R W 3"]:
        """Run the network for each pairing; return the mean result (float64) in the identity's order."""
        total = np.zeros((1 if self.head == "regression" else len(window), *identity.shape))
        for identity_order, driving_order in pairings:
            inputs = {
                "identity": batch_of_one(identity[identity_order]),
                "driving": batch_of_one(window[:, driving_order]),
            }
            total[:, identity_order] += np.asarray(self.session.run(["result"], inputs)[0])[0]
        return total / len(pairings)


def blended(
    frames: Iterable[Float[np.ndarray, "N 3"]], run: Run, length: int, stride: int
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield one result a frame: the mean over all windows that contain it, weighted by a triangle over the window.

    A clip shorter than a window is padded with its last frame. `stride` is at most `length`.
    """
    weights = np.minimum(np.arange(length) + 1, length - np.arange(length))
    sums: deque[tuple[Float[np.ndarray, "V 3"], int]] = deque()  # of results and of weights, one pair a frame
    first = remaining = 0  # the frame of sums[0], and how many frames from there on are no padding
    for start, window, count in windows(frames, length, stride):
        # No later window contains the frames before this one's first: their results are complete.
        for total, weight in [sums.popleft() for _ in range(start - first)]:
            yield total / weight
        first, remaining = start, count
        for offset, (result, weight) in enumerate(zip(run(window), weights, strict=True)):
            if offset < len(sums):
                sums[offset] = sums[offset][0] + weight * result, sums[offset][1] + weight
            else:
                sums.append((weight * result, weight))
    for total, weight in itertools.islice(sums, remaining):
        yield total / weight


def middles(frames: Iterable[Float[np.ndarray, "N 3"]], run: Run, length: int) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield one result a frame: that of the window around it; past its ends, the clip is padded with copies of them."""
    before, after = length // 2, length - 1 - length // 2
    for _, window, _ in windows(_padded(frames, before, after), length, 1):
        yield run(window)[0]


def _padded(frames: Iterable[np.ndarray], before: int, after: int) -> Iterator[np.ndarray]:
    frame = None
    for frame in frames:
        yield from itertools.repeat(frame, before + 1)
        before = 0
    if frame is not None:
        yield from itertools.repeat(frame, after)


def windows(frames: Iterable[Float[np.ndarray, "N 3"]], length: int, stride: int) -> Iterator[tuple[int, Window, int]]:
    """Yield the index of a window's first frame, its `length` successive frames, and how many of them are no padding.

    One window every `stride` frames, and one at the clip's end. Only a clip shorter than a window is padded, with
    copies of its last frame.
    """
    window: deque[np.ndarray] = deque(maxlen=length)
    read = 0
    for read, frame in enumerate(frames, 1):
        window.append(frame)
        if read >= length and (read - length) % stride == 0:
            yield read - length, np.stack(window), length
    if 0 < read < length:
        yield 0, np.stack([*window, *itertools.repeat(window[-1], length - read)]), read
    elif read > length and (read - length) % stride:
        yield read - length, np.stack(window), length
