"""Write the animation stacks of an FBX scene into a glTF draft, sampled at the file's frame rate.

FBX curves have pivots, rotation orders and curve types that glTF has not: every frame is evaluated. Channels that keep
the value of the node are left out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import ufbx
from jaxtyping import Float

from ...core.errors import InputError
from ...core.geometry import continuous_quaternions
from ..gltf.animation import AnimationChannel, add_animation
from ..gltf.draft import Draft
from ..timing import DEFAULT_FPS, HIGHEST_FPS, LONGEST, frame_count
from .elements import items, own
from .geometry import MorphChannels

# ufbx declares the arguments of its functions only in a stub that type checkers do not all follow.
# pyright: reportAttributeAccessIssue=false

SAME = 1e-6
"""Largest difference, relative to values above 1, between a channel and the node's own value that counts as none."""
PATHS = ("translation", "rotation", "scale")


def add_animations(
    draft: Draft, scene: Any, nodes: list[Any], morphs: dict[int, tuple[list[int], MorphChannels]], path: Path
) -> None:
    """Add all animation stacks of a scene.

    Args:
        nodes: the scene's nodes by `typed_id`; the first is the root, node k of glTF is the one after it.
        morphs: mesh -> the nodes of glTF that show it, and its blend shapes.

    Raises:
        InputError: an animation of more than an hour.
    """
    fps = own(scene.settings).frames_per_second
    fps = float(fps) if 0 < fps <= HIGHEST_FPS else DEFAULT_FPS
    animations = []
    for number, stack in enumerate(items(scene.anim_stacks)):
        curves = own(stack.anim)
        baked = own(ufbx.bake_anim(scene, curves, resample_rate=fps))
        begin, end = _time_range(stack, baked, path)
        seconds = np.arange(frame_count(end - begin, fps)) / fps
        reader = _ChannelReader(seconds)
        for moved in items(baked.nodes):
            if moved.typed_id > 0:
                reader.add_node(nodes[moved.typed_id], curves, begin)
        for shown_by, mesh_morphs in morphs.values():
            reader.add_weights(shown_by, mesh_morphs, curves, begin)
        if reader.channels:
            animations.append(add_animation(draft, stack.name or f"animation {number}", reader.channels))
    if animations:
        draft.gltf["animations"] = animations


def _time_range(stack: Any, baked: Any, path: Path) -> tuple[float, float]:
    """Return the seconds in which a stack is played: its own range, or that of its keys where it states none."""
    ranges = ((stack.time_begin, stack.time_end), (baked.key_time_min, baked.key_time_max))
    stated = [(begin, end) for begin, end in ranges if np.isfinite([begin, end]).all() and end > begin]
    begin, end = next((bounds for bounds in stated if bounds[1] - bounds[0] <= LONGEST), (0.0, 0.0))
    if stated and end <= begin:
        begin, end = stated[-1]
        raise InputError(f"{path}: expected an animation of up to an hour, found {end - begin:.0f} s; cut it")
    return begin, end


class _ChannelReader:
    """The channels of one animation."""

    def __init__(self, seconds: Float[np.ndarray, " T"]) -> None:
        self.seconds = seconds
        self.channels: list[AnimationChannel] = []

    def add_node(self, node: Any, curves: Any, begin: float) -> None:
        """Add the channels of a node that moves."""
        frames = [ufbx.evaluate_transform(curves, node, begin + time) for time in self.seconds.tolist()]
        for path in PATHS:
            values = np.array([tuple(getattr(frame, path)) for frame in frames])
            rest = np.array(getattr(node.local_transform, path))
            if path == "rotation":
                values = continuous_quaternions(values, rest)
            self._add(node.typed_id - 1, path, values, rest)

    def add_weights(self, nodes: list[int], morphs: MorphChannels, curves: Any, begin: float) -> None:
        """Add the weights of the blend shapes of a mesh to all nodes that show it."""
        if not morphs.shapes:
            return
        weights = np.array(
            [
                [ufbx.evaluate_blend_weight(curves, channel, begin + time) for channel in morphs.channels]
                for time in self.seconds.tolist()
            ]
        )
        rest = np.array([[channel.weight for channel in morphs.channels]])
        for node in nodes:
            self._add(node, "weights", morphs.target_weights(weights), morphs.target_weights(rest)[0])

    def _add(self, node: int, path: str, values: Float[np.ndarray, "T C"], rest: Float[np.ndarray, " C"]) -> None:
        """Add a channel unless it keeps the node's own value; one that keeps another value has one key."""
        same = SAME * np.maximum(np.abs(rest), 1.0)
        if not np.isfinite(values).all() or (np.abs(values - rest) <= same).all():
            return
        if (np.abs(values - values[0]) <= same).all():
            values = values[:1]
        self.channels.append(AnimationChannel(node, path, self.seconds[: len(values)], values))
