"""Animations of a glTF file, baked: node transforms, skins and morph weights become points, frame by frame.

What no frame changes is read once (`Held`). Of the vertices that a file splits at seams one is posed for all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..timing import LONGEST, frame_count
from .animation import Channel
from .document import Document
from .read import Rest, Run, primitive_of
from .scene import Binding, binding, morph_weights, morphed, moved_matrices, transform, world_matrices

BLOCK = 64
"""Frames whose node transforms are found at once."""
Moved = dict[tuple[int, str], Float[np.ndarray, "T C"]]
"""Values of what moves in some frames, by node and name."""


@dataclass(frozen=True, eq=False)
class Held:
    """The vertices of a run of primitives, as no frame changes them."""

    node: int
    primitive: dict[str, Any]
    points: Float[np.ndarray, "U 3"] | None
    """Each distinct vertex before its skin; None where morph targets move in the animation."""
    bound: Binding | None
    """What holds these vertices; None where the node does."""
    vertex: Int[np.ndarray, " V"]
    """Which of them each vertex of the run is."""


def baked_frames(
    document: Document, rest: Rest, channels: list[Channel], fps: float
) -> tuple[int, Iterator[Float[np.ndarray, "V 3"]]]:
    """How many frames an animation has, and the vertices of the Mesh in each: frame k is at k / fps seconds."""
    times = frame_times(document, channels, fps)
    return len(times), _frames(document, rest, channels, times)


def frame_times(document: Document, channels: list[Channel], fps: float) -> Float[np.ndarray, " T"]:
    """Seconds of the frames of an animation, from zero to its last key."""
    last = max((float(channel.times[-1]) for channel in channels), default=0.0)
    if last > LONGEST:
        raise InputError(f"{document.path}: expected an animation of up to an hour, found {last:.0f} s; cut it")
    return np.arange(frame_count(last, fps)) / fps


def node_blocks(
    document: Document, channels: list[Channel], times: Float[np.ndarray, " T"]
) -> Iterator[tuple[Moved, Float[np.ndarray, "B N 4 4"]]]:
    """What moves and the world transforms of all nodes, for some frames at a time."""
    for start in range(0, len(times), BLOCK):
        some = times[start : start + BLOCK]
        values = {(channel.node, channel.path): channel.at(some) for channel in channels}
        yield values, world_matrices(document, moved_matrices(document, values, len(some)))
        document.let_go()


def _frames(
    document: Document, rest: Rest, channels: list[Channel], times: Float[np.ndarray, " T"]
) -> Iterator[Float[np.ndarray, "V 3"]]:
    morphing = {channel.node for channel in channels if channel.path == "weights"}
    runs = [_hold(document, run, run.node in morphing) for run in rest.runs]
    for values, T_world_node in node_blocks(document, channels, times):
        weights = {node: value for (node, path), value in values.items() if path == "weights"}
        for t in range(len(T_world_node)):
            now = {node: value[t].tolist() for node, value in weights.items()}
            yield np.concatenate([_posed(document, held, T_world_node[t], now) for held in runs])


def _hold(document: Document, run: Run, morphs: bool) -> Held:
    primitive = primitive_of(document, (run.node, run.primitives[0]))
    bound = binding(document, run.node, primitive)
    if morphs:
        return Held(run.node, primitive, None, bound, np.arange(run.stop - run.start))
    points = morphed(document, primitive, "POSITION", morph_weights(document, run.node))
    assert points is not None
    held = points if bound is None else np.concatenate([points, bound.joints, bound.weights], axis=1)
    _, first, vertex = np.unique(held, axis=0, return_index=True, return_inverse=True)
    if bound is not None:
        bound = Binding(bound.nodes, bound.T_joint_bind, bound.joints[first], bound.weights[first])
    return Held(run.node, primitive, points[first], bound, vertex.reshape(-1))


def _posed(
    document: Document, held: Held, T_world_node: Float[np.ndarray, "N 4 4"], weights: Mapping[int, list[float]]
) -> Float[np.ndarray, "V 3"]:
    """The vertices of a run in one frame."""
    points = held.points
    if points is None:
        points = morphed(document, held.primitive, "POSITION", weights[held.node])
    assert points is not None
    matrices = T_world_node[held.node][None, :3] if held.bound is None else held.bound.matrices(T_world_node)
    return transform(matrices, points)[held.vertex]
