"""AniFormer as an ONNX file, run by onnxruntime over overlapping windows of the driving clip.

Inputs "identity" (1, V, 3) and "driving" (1, T, V, 3); output "result" (1, T, V, 3), or (1, 1, V, 3), the window's
middle frame, with the regression head. Each input mesh is centred on its bounding box and divided by its largest
distance from there, each driving frame by its own; every frame of the result is centred on its own bounding box.
The result of a frame is known when it is known which windows hold it: up to two windows of driving frames are held.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..core.canonical_order import canonical_order
from ..core.geometry import edges
from ..core.mesh import Clip, Mesh
from ..core.normalization import bbox_centre, radius
from ..core.surface_points import padded_vertices
from .base import Drive
from .npt import EdgeLengths, batch_of_one, generator
from .root_motion import check_size, with_root_motion

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

OVERLAP = 1
"""Frames that a window shares with the next one. More cost more and change nothing: on `val` the PMD is the same
to three digits, the jitter 1 % less with two of three frames and 5 to 20 % more with none."""
Window = Float[np.ndarray, "T N 3"]
Run = Callable[[Window], Float[np.ndarray, "R V 3"]]
"""Driving frames of a window to results: one for each, or one for the middle."""
Pairing = tuple[Int[np.ndarray, " W"], Int[np.ndarray, " W"]]
"""The order in which the identity's points, and those of the driving, are given to the network."""


@dataclass(frozen=True, eq=False)
class AniFormerMethod:
    """A loaded network, ready for any identity."""

    rough: ClassVar[bool] = True
    name: str
    session: InferenceSession
    frames: int
    """T, the driving frames of a window."""
    head: str
    """"frames", or "regression": then a window gives its middle frame only."""
    target_scale: str
    """As Network's."""
    ensemble: int = 1
    seed: int = 0

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Rank both meshes and choose the driving points and their pairings, once for all frames."""
        ranked = canonical_order(identity.vertices)
        still = ranked.merge(identity.vertices)
        points = padded_vertices(driving.mesh, len(ranked), generator(self.seed, 0))
        pairings = [self._pairing(k, len(ranked), len(points)) for k in range(self.ensemble)]
        lengths = EdgeLengths.of(still, edges(ranked.group[identity.faces]))

        def points_of(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
            centred = vertices - bbox_centre(vertices)
            return points.at(centred / radius(centred))

        def run(window: Window) -> Float[np.ndarray, "R V 3"]:
            return self._run(still, window, pairings)

        def drive(frames: Iterable[Float[np.ndarray, "U 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
            ahead, now = itertools.tee(check_size(frames, driving.mesh.name))
            points = map(points_of, ahead)
            if self.head == "regression":
                results = middles(points, run, self.frames)
            else:
                results = blended(points, run, self.frames, max(1, self.frames - OVERLAP))

            def pose(_: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
                result = next(results)
                return (lengths.resized(result, still) if self.target_scale == "truth" else result)[ranked.group]

            return with_root_motion(now, pose, driving.mesh.name)

        return drive

    def _pairing(self, k: int, points: int, driving_points: int) -> Pairing:
        """Both orders are random: the vertices that all others attend to are the first ones, and should be anywhere."""
        rng = generator(self.seed, 1 + k)
        return rng.permutation(points), rng.permutation(driving_points)[:points]

    def _run(
        self, identity: Float[np.ndarray, "W 3"], window: Window, pairings: list[Pairing]
    ) -> Float[np.ndarray, "R W 3"]:
        """Mean result over the pairings (float64), in the identity's order."""
        total = np.zeros((1 if self.head == "regression" else len(window), *identity.shape))
        for own, theirs in pairings:
            inputs = {"identity": batch_of_one(identity[own]), "driving": batch_of_one(window[:, theirs])}
            total[:, own] += np.asarray(self.session.run(["result"], inputs)[0])[0]
        return total / len(pairings)


def blended(
    frames: Iterable[Float[np.ndarray, "N 3"]], run: Run, length: int, stride: int
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """One result a frame: the mean over all windows that hold it, weighted by a triangle over the window.

    A clip shorter than a window is filled up with its last frame. `stride` is at most `length`.
    """
    weights = np.minimum(np.arange(length) + 1, length - np.arange(length))
    sums: deque[tuple[Float[np.ndarray, "V 3"], int]] = deque()  # of results and of weights, one pair a frame
    first = left = 0  # the frame of sums[0], and how many frames are the clip's own from there on
    for start, window, own in windows(frames, length, stride):
        for total, weight in [sums.popleft() for _ in range(start - first)]:
            yield total / weight
        first, left = start, own
        for offset, (result, weight) in enumerate(zip(run(window), weights, strict=True)):
            if offset < len(sums):
                sums[offset] = sums[offset][0] + weight * result, sums[offset][1] + weight
            else:
                sums.append((weight * result, weight))
    for total, weight in itertools.islice(sums, left):
        yield total / weight


def middles(frames: Iterable[Float[np.ndarray, "N 3"]], run: Run, length: int) -> Iterator[Float[np.ndarray, "V 3"]]:
    """One result a frame: that of the window around it, its first and last frames repeated past the ends."""
    before, after = length // 2, length - 1 - length // 2
    for _, window, _ in windows(_lengthened(frames, before, after), length, 1):
        yield run(window)[0]


def _lengthened(frames: Iterable[np.ndarray], before: int, after: int) -> Iterator[np.ndarray]:
    """The frames, with the first and the last repeated."""
    frame = None
    for frame in frames:
        yield from itertools.repeat(frame, before + 1)
        before = 0
    if frame is not None:
        yield from itertools.repeat(frame, after)


def windows(frames: Iterable[Float[np.ndarray, "N 3"]], length: int, stride: int) -> Iterator[tuple[int, Window, int]]:
    """The first frame of a window, its `length` successive frames, and how many of them are the clip's own.

    One window every `stride` frames, and one at the clip's end. Only in a clip shorter than a window are frames not its
    own: then the last one is repeated.
    """
    held: deque[np.ndarray] = deque(maxlen=length)
    read = 0
    for read, frame in enumerate(frames, 1):
        held.append(frame)
        if read >= length and (read - length) % stride == 0:
            yield read - length, np.stack(held), length
    if 0 < read < length:
        yield 0, np.stack([*held, *itertools.repeat(held[-1], length - read)]), read
    elif read > length and (read - length) % stride:
        yield read - length, np.stack(held), length
