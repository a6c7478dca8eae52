"""AniFormer as an ONNX file, run by onnxruntime over overlapping windows of the driving clip.

Inputs "identity" (1, V, 3) and "driving" (1, T, V, 3); output "result" (1, T, V, 3), or (1, 1, V, 3), the window's
middle frame, with the regression head. Each input mesh is centred on its bounding box and divided by its largest
distance from there, each driving frame by its own; every frame of the result is centred on its own bounding box. A
network with weights for each vertex (metadata `vertices`) gets all vertices of both meshes in the order of their files.
The result of a frame is the mean over all windows that contain it: at most two windows of driving frames are in memory.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..core.canonical_order import CanonicalOrder, canonical_order, file_order
from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from ..core.surface_points import batch_of_one, generator, padded_vertices
from .base import Drive, Shapes
from .npt import PointsAt, check_same_mesh, drive_of, driving_input

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

OVERLAP = 1
"""Frames that a window shares with the next one. On `val` two of three frames cost more for the same PMD (to three
digits) and 1 % less jitter; none makes 5 to 20 % more jitter."""
Window = Float[np.ndarray, "T N 3"]
Run = Callable[[Window], Float[np.ndarray, "R V 3"]]
"""Maps the driving frames of a window to results: one for each frame, or one for the middle frame."""
Pairing = tuple[Int[np.ndarray, " W"], Int[np.ndarray, " W"]]
"""Order in which the network gets the identity's points, and order in which it gets the driving's."""


@dataclass(frozen=True, eq=False)
class AniFormerMethod:
    """The method `aniformer`: a loaded network, ready for any identity."""

    rough: ClassVar[bool] = True
    name: str
    session: InferenceSession
    frames: int
    """Driving frames of a window (T)."""
    head: str
    """"frames": one result for each frame of a window; "regression": one for its middle frame."""
    target_scale: str
    """As in `NPTMethod`."""
    ensemble: int = 1
    """Random pairings over which results are averaged."""
    seed: int = 0
    vertices: int = 0
    """Vertices that both meshes must have, in the order of the network's training; 0: any two meshes."""
    body: str = "human"
    """As in `NPTMethod`."""
    pairing: str = "random"
    """As in `NPTMethod`."""

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Rank both meshes and choose the driving points and their pairings, once for all frames.

        Raises:
            InputError: the network needs a vertex count that one of the meshes has not, or meshes that correspond.
        """
        return drive_of(self, identity, driving)

    def shapes(self, identity: Mesh, driving: Clip) -> Shapes:
        """As `ShapeMethod.shapes`."""
        match = self._in_file_order if self.vertices else self._paired
        ranked, points_at, pairings = match(identity, driving.mesh)
        rest = ranked.merge(identity.vertices)

        def points_of(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
            return points_at(driving_input(vertices))

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
            check_same_mesh(self.name, identity, driving)
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
