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
        writer = _AnimationWriter(draft, seconds)
        for moved in items(baked.nodes):
            if moved.typed_id > 0:
                writer.add_node(nodes[moved.typed_id], curves, begin)
        for shown_by, mesh_morphs in morphs.values():
            writer.add_weights(shown_by, mesh_morphs, curves, begin)
        if writer.channels:
            name = stack.name or f"animation {number}"
            animations.append({"name": name, "samplers": writer.samplers, "channels": writer.channels})
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


class _AnimationWriter:
    """The channels and samplers of one animation."""

    def __init__(self, draft: Draft, seconds: Float[np.ndarray, " T"]) -> None:
        self.draft = draft
        self.seconds = seconds
        self.channels: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []
        self._times: dict[int, int] = {}
        """Accessor of the times of a number of keys."""

    def add_node(self, node: Any, curves: Any, begin: float) -> None:
        """Add the channels of a node that moves."""
        frames = [ufbx.evaluate_transform(curves, node, begin + time) for time in self.seconds.tolist()]
        for path in PATHS:
            values = np.array([tuple(getattr(frame, path)) for frame in frames])
            rest = np.array(getattr(node.local_transform, path))
            if path == "rotation":
                values, rest = _continuous(values, rest), rest
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
        if len(values) not in self._times:
            self._times[len(values)] = self.draft.add_floats(self.seconds[: len(values), None], bounds=True)
        # The weights of all targets at one key lie next to each other (glTF 2.0, 3.11 Animations).
        output = self.draft.add_floats(values if path in PATHS else values.reshape(-1, 1))
        sampler = {"input": self._times[len(values)], "interpolation": "LINEAR", "output": output}
        self.channels.append({"sampler": len(self.samplers), "target": {"node": node, "path": path}})
        self.samplers.append(sampler)


def _continuous(rotations: Float[np.ndarray, "T 4"], rest: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "T 4"]:
    """Choose the signs of unit quaternions so that each is near the one before, and the first near `rest`.

    q and -q are one rotation, but interpolation between both passes through zero.
    """
    before = np.concatenate([rest[None], rotations[:-1]])
    turned = np.where((rotations * before).sum(axis=1) < 0, -1.0, 1.0)
    return rotations * np.cumprod(turned)[:, None]
