"""Animations of a glTF file, baked: node transforms, skins and morph weights become points, frame by frame.

What no frame changes is read once (`UnposedVertices`). Of the vertices that a file splits at seams one is posed for all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..timing import LONGEST, frame_count
from .animation import AnimationChannel
from .document import Document
from .read import RestScene, VertexRange, get_primitive
from .scene import (
    SkinBinding,
    animated_matrices,
    read_morph_weights,
    read_morphed_attribute,
    read_skin_binding,
    transform_points,
    world_matrices,
)

FRAMES_PER_BLOCK = 64
"""Frames whose node transforms are found at once."""
AnimatedValues = dict[tuple[int, str], Float[np.ndarray, "T C"]]
"""Values of what moves in some frames, by node and name."""


@dataclass(frozen=True, eq=False)
class UnposedVertices:
    """The vertices of a run of primitives, as no frame changes them."""

    node: int
    primitive: dict[str, Any]
    points: Float[np.ndarray, "U 3"] | None
    """Each distinct vertex before its skin; None where morph targets move in the animation."""
    binding: SkinBinding | None
    """What holds these vertices; None where the node does."""
    vertex: Int[np.ndarray, " V"]
    """Which of them each vertex of the run is."""


def bake_frames(
    document: Document, rest: RestScene, channels: list[AnimationChannel], fps: float
) -> tuple[int, Iterator[Float[np.ndarray, "V 3"]]]:
    """How many frames an animation has, and the vertices of the Mesh in each: frame k is at k / fps seconds."""
    times = frame_times(document, channels, fps)
    return len(times), _pose_frames(document, rest, channels, times)


def frame_times(document: Document, channels: list[AnimationChannel], fps: float) -> Float[np.ndarray, " T"]:
    """Seconds of the frames of an animation, from zero to its last key."""
    last = max((float(channel.times[-1]) for channel in channels), default=0.0)
    if last > LONGEST:
        raise InputError(f"{document.path}: expected an animation of up to an hour, found {last:.0f} s; cut it")
    return np.arange(frame_count(last, fps)) / fps


def sample_nodes(
    document: Document, channels: list[AnimationChannel], times: Float[np.ndarray, " T"]
) -> Iterator[tuple[AnimatedValues, Float[np.ndarray, "B N 4 4"]]]:
    """What moves and the world transforms of all nodes, for some frames at a time."""
    for start in range(0, len(times), FRAMES_PER_BLOCK):
        some = times[start : start + FRAMES_PER_BLOCK]
        values = {(channel.node, channel.path): channel.sample(some) for channel in channels}
        yield values, world_matrices(document, animated_matrices(document, values, len(some)))
        document.release_pages()


def _pose_frames(
    document: Document, rest: RestScene, channels: list[AnimationChannel], times: Float[np.ndarray, " T"]
) -> Iterator[Float[np.ndarray, "V 3"]]:
    morphing = {channel.node for channel in channels if channel.path == "weights"}
    vertex_ranges = [_prepare_vertices(document, span, span.node in morphing) for span in rest.vertex_ranges]
    for values, T_world_node in sample_nodes(document, channels, times):
        weights = {node: value for (node, path), value in values.items() if path == "weights"}
        for t in range(len(T_world_node)):
            now = {node: value[t].tolist() for node, value in weights.items()}
            yield np.concatenate([_pose_vertices(document, held, T_world_node[t], now) for held in vertex_ranges])


def _prepare_vertices(document: Document, span: VertexRange, morphs: bool) -> UnposedVertices:
    primitive = get_primitive(document, (span.node, span.primitives[0]))
    binding = read_skin_binding(document, span.node, primitive)
    if morphs:
        return UnposedVertices(span.node, primitive, None, binding, np.arange(span.stop - span.start))
    points = read_morphed_attribute(document, primitive, "POSITION", read_morph_weights(document, span.node))
    assert points is not None
    held = points if binding is None else np.concatenate([points, binding.joints, binding.weights], axis=1)
    _, first, vertex = np.unique(held, axis=0, return_index=True, return_inverse=True)
    if binding is not None:
        binding = SkinBinding(binding.nodes, binding.T_joint_bind, binding.joints[first], binding.weights[first])
    return UnposedVertices(span.node, primitive, points[first], binding, vertex.reshape(-1))


def _pose_vertices(
    document: Document,
    held: UnposedVertices,
    T_world_node: Float[np.ndarray, "N 4 4"],
    weights: Mapping[int, list[float]],
) -> Float[np.ndarray, "V 3"]:
    """The vertices of a run in one frame."""
    points = held.points
    if points is None:
        points = read_morphed_attribute(document, held.primitive, "POSITION", weights[held.node])
    assert points is not None
    matrices = T_world_node[held.node][None, :3] if held.binding is None else held.binding.matrices(T_world_node)
    return transform_points(matrices, points)[held.vertex]
