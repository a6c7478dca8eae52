"""Bakes glTF animations to vertex positions: node transforms, skins and morph weights are evaluated frame by frame.

What is the same in all frames is read once (`UnposedVertices`). Files split a vertex at texture and normal seams; such
duplicates are posed once and copied.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.budgets import FRAMES, POSED_JOINTS
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
"""Frames whose node transforms are computed at once: bounds memory at 64 matrices a node."""
AnimatedValues = dict[tuple[int, str], Float[np.ndarray, "T _"]]
"""Values of the animated properties in T frames, by (node, target path)."""


@dataclass(frozen=True, eq=False)
class UnposedVertices:
    """The distinct vertices of a `VertexRange` before skinning, and the data that no frame changes."""

    node: int
    primitive: dict[str, Any]
    positions: Float[np.ndarray, "U 3"] | None
    """Positions of the distinct vertices before skinning; None where morph weights are animated."""
    binding: SkinBinding | None
    """Joints and weights of the distinct vertices; None where the primitive is not skinned."""
    distinct_of: Int[np.ndarray, " V"]
    """Index of the distinct vertex that each vertex of the range equals."""


def bake_frames(
    document: Document, rest: RestScene, channels: list[AnimationChannel], fps: float
) -> tuple[int, Iterator[Float[np.ndarray, "V 3"]]]:
    """Return the number of frames of an animation and the Mesh's vertices in each; frame k is at k / fps seconds."""
    times = frame_times(document, channels, fps)
    return len(times), sample_frames(document, rest, channels, times)


def frame_times(document: Document, channels: list[AnimationChannel], fps: float) -> Float[np.ndarray, " T"]:
    """Return the times of an animation's frames in seconds, from zero to its last key.

    Raises:
        InputError: the last key is later than an hour, which only damaged times are, or there are too many frames.
    """
    last = max((float(channel.times[-1]) for channel in channels), default=0.0)
    last = max(last, 0.0)  # of keys before zero, which damaged files have, the last one is played
    if last > LONGEST:
        raise InputError(f"{document.path}: expected an animation of up to an hour, found {last:.0f} s; cut it")
    count = frame_count(last, fps)
    FRAMES.check(count, document.path)
    moved = len({channel.node for channel in channels})
    POSED_JOINTS.check(count * moved, document.path, len(document.binary))
    return np.arange(count) / fps


def sample_nodes(
    document: Document, channels: list[AnimationChannel], times: Float[np.ndarray, " T"]
) -> Iterator[tuple[AnimatedValues, Float[np.ndarray, "B N 4 4"]]]:
    """Yield the animated values and the world transforms of all nodes, for blocks of B frames."""
    for start in range(0, len(times), FRAMES_PER_BLOCK):
        block_times = times[start : start + FRAMES_PER_BLOCK]
        values = {(channel.node, channel.path): channel.sample(block_times) for channel in channels}
        yield values, world_matrices(document, animated_matrices(document, values, len(block_times)))
        document.release_pages()


def sample_frames(
    document: Document, rest: RestScene, channels: list[AnimationChannel], times: Float[np.ndarray, " T"]
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the vertices of the Mesh at times in seconds."""
    morphing = {channel.node for channel in channels if channel.path == "weights"}
    yield from _posed_blocks(document, rest, morphing, sample_nodes(document, channels, times))


def pose_frames(
    document: Document, rest: RestScene, values: AnimatedValues, frames: int
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the vertices of the Mesh in frames in which some properties of nodes have given values."""
    morphing = {node for node, path in values if path == "weights"}
    return _posed_blocks(document, rest, morphing, pose_nodes(document, values, frames))


def pose_nodes(
    document: Document, values: AnimatedValues, frames: int
) -> Iterator[tuple[AnimatedValues, Float[np.ndarray, "B N 4 4"]]]:
    """Yield given values of properties of nodes, and the world transforms of all nodes, for blocks of B frames."""
    for start in range(0, frames, FRAMES_PER_BLOCK):
        some = {key: value[start : start + FRAMES_PER_BLOCK] for key, value in values.items()}
        count = min(FRAMES_PER_BLOCK, frames - start)
        yield some, world_matrices(document, animated_matrices(document, some, count))


def _posed_blocks(
    document: Document,
    rest: RestScene,
    morphing: set[int],
    blocks: Iterator[tuple[AnimatedValues, Float[np.ndarray, "B N 4 4"]]],
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the vertices of the Mesh in each frame of blocks of frames, as `sample_nodes` yields them."""
    parts = [_prepare_vertices(document, span, span.node in morphing) for span in rest.vertex_ranges]
    for values, T_world_node in blocks:
        morph_weights = {node: value for (node, path), value in values.items() if path == "weights"}
        # Positions of one frame at a time: only node transforms are computed for a whole block.
        for t in range(len(T_world_node)):
            frame_weights = {node: value[t].tolist() for node, value in morph_weights.items()}
            yield np.concatenate([_pose_vertices(document, part, T_world_node[t], frame_weights) for part in parts])


def _prepare_vertices(document: Document, span: VertexRange, morphs: bool) -> UnposedVertices:
    """Read the distinct vertices of a range; all of them where their morph weights are animated."""
    primitive = get_primitive(document, (span.node, span.primitives[0]))
    binding = read_skin_binding(document, span.node, primitive)
    if morphs:
        return UnposedVertices(span.node, primitive, None, binding, np.arange(span.stop - span.start))
    positions = read_morphed_attribute(document, primitive, "POSITION", read_morph_weights(document, span.node))
    assert positions is not None
    # Vertices with one position and one set of influences stay together in all frames.
    keys = positions if binding is None else np.concatenate([positions, binding.joints, binding.weights], axis=1)
    _, first, distinct_of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    if binding is not None:
        binding = SkinBinding(binding.nodes, binding.T_joint_bind, binding.joints[first], binding.weights[first])
    return UnposedVertices(span.node, primitive, positions[first], binding, distinct_of.reshape(-1))


def _pose_vertices(
    document: Document,
    part: UnposedVertices,
    T_world_node: Float[np.ndarray, "N 4 4"],
    morph_weights: Mapping[int, list[float]],
) -> Float[np.ndarray, "V 3"]:
    """Return the world positions of a range's vertices in one frame; `morph_weights` are the animated ones by node."""
    positions = part.positions
    if positions is None:
        positions = read_morphed_attribute(document, part.primitive, "POSITION", morph_weights[part.node])
    assert positions is not None
    # glTF 2.0, 3.7.3.2 Joint Hierarchy: a skinned mesh ignores the transform of its own node.
    matrices = T_world_node[part.node][None, :3] if part.binding is None else part.binding.matrices(T_world_node)
    return transform_points(matrices, positions)[part.distinct_of]
