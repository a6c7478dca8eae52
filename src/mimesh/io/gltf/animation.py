"""Reads and writes animations of a glTF file, samples their channels, and bakes them to vertex positions.

Interpolation is STEP, LINEAR (slerp for rotations) or CUBICSPLINE (glTF 2.0, 3.11 Animations and Appendix C). Before
its first key and after its last one, a channel keeps the value of that key. KHR_animation_pointer is not read.

Node transforms, skins and morph weights are evaluated frame by frame; what is the same in all frames is read once
(`UnposedVertices`). Files split a vertex at texture and normal seams; such duplicates are posed once and copied.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.arguments import HIGHEST_FPS, LOWEST_FPS
from ...core.budgets import FRAMES, KEYS, POSED_JOINTS
from ...core.errors import InputError, damaged, option
from ...core.geometry import continuous_quaternions
from ...core.rig import local_rotations
from ..timing import LONGEST, RATES, frame_count, lie_on, sample_rate, usual_rate
from . import scene
from .document import Document, read_floats
from .draft import Draft
from .read import RestScene, get_primitive

AnimatedValues = dict[tuple[int, str], Float[np.ndarray, "T _"]]
"""Values of the animated properties in T frames, by (node, target path)."""
NodeBlocks = Iterator[tuple[AnimatedValues, Float[np.ndarray, "B N 4 4"]]]
"""Animated values and the world transforms of all nodes, for blocks of B frames."""
FRAMES_PER_BLOCK = 64
"""Frames whose node transforms are computed at once: bounds memory at 64 matrices a node."""
LINEAR_COSINE = 0.9995
"""Cosine of the angle between two quaternions (1.8 degrees) from which on they are interpolated linearly."""

STILL = 1e-6
"""Largest change of a unit quaternion that is not written: 2 micrometres at the end of a limb of a metre."""
RATE = ("mimesh", "fps")
"""Where the extras of an animation have its frame rate, if it has a key a frame: keys half a second apart alone do not
tell frames from the few keys of a smooth curve."""
PATH_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3, "weights": 0}
"""Target paths and the numbers in one value of each; 0 for weights, which have one number for each morph target."""


@dataclass(frozen=True, eq=False)
class AnimationChannel:
    """A channel with its sampler: the keys of one node's translation, rotation, scale or weights."""

    node: int
    path: str
    """Target path: a key of `PATH_WIDTHS`."""
    times: Float[np.ndarray, " K"]
    """Times of the keys in seconds, strictly increasing."""
    values: Float[np.ndarray, "K C"]
    """Values at the keys; with CUBICSPLINE, rows are in-tangent, value, out-tangent, one after the other."""
    interpolation: str = "LINEAR"
    """STEP, LINEAR or CUBICSPLINE."""
    fps: float | None = None
    """Frames a second that the animation says it was written with (see `RATE`); None: it does not say."""

    @property
    def constant(self) -> bool:
        """Whether the value is the same at all times."""
        parts = self.values.reshape(len(self.times), 3 if self.interpolation == "CUBICSPLINE" else 1, -1)
        still = np.ptp(parts, axis=0).max(initial=0) == 0
        return bool(still and (parts.shape[1] == 1 or not parts[:, ::2].any()))

    def sample(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T C"]:
        """Return the values at times in seconds; quaternions (x, y, z, w) have length 1."""
        width = self.values.shape[1] // (3 if self.interpolation == "CUBICSPLINE" else 1)
        value_columns = slice(width, 2 * width) if self.interpolation == "CUBICSPLINE" else slice(0, width)
        next_key = np.searchsorted(self.times, times, side="right")
        # Clamped to the first and last key; times between two keys are overwritten.
        values = self.values[np.minimum(next_key, len(self.times) - 1), value_columns]
        inside = (next_key > 0) & (next_key < len(self.times))
        values[inside] = self._interpolate(next_key[inside], times[inside], value_columns)
        return scene.normalized_quaternions(values) if self.path == "rotation" else values

    def _interpolate(
        self, next_key: Int[np.ndarray, " T"], times: Float[np.ndarray, " T"], value_columns: slice
    ) -> Float[np.ndarray, "T C"]:
        """Interpolate between the keys before `next_key` and `next_key`, by the equations of Appendix C."""
        a, b = self.values[next_key - 1], self.values[next_key]
        if self.interpolation == "STEP":
            return a[:, value_columns]
        duration = (self.times[next_key] - self.times[next_key - 1])[:, None]
        s = (times - self.times[next_key - 1])[:, None] / duration
        if self.interpolation == "CUBICSPLINE":
            # Cubic Hermite spline: tangents are stored per second and scaled by the time between the keys.
            width = value_columns.stop - value_columns.start
            out_tangent, in_tangent = duration * a[:, 2 * width :], duration * b[:, :width]
            h = (2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s, 3 * s**2 - 2 * s**3, s**3 - s**2)
            return h[0] * a[:, value_columns] + h[1] * out_tangent + h[2] * b[:, value_columns] + h[3] * in_tangent
        return slerp(a, b, s) if self.path == "rotation" else (1 - s) * a + s * b


def add_animation(
    draft: Draft, name: str, channels: Iterable[AnimationChannel], fps: float | None = None
) -> dict[str, Any]:
    """Add the keys of an animation to a document, as float32; channels with the same times share them.

    Args:
        fps: its frame rate, if it has a key a frame, for readers.

    Returns:
        The entry for `animations`.
    """
    times: dict[bytes, int] = {}
    samplers: list[dict[str, Any]] = []
    targets: list[dict[str, Any]] = []
    for channel in channels:
        seconds = channel.times.astype("<f4")
        if seconds.tobytes() not in times:
            times[seconds.tobytes()] = draft.add_floats(seconds[:, None], bounds=True)
        # Tangents and values of a key are elements of their own; so are the weights of all targets.
        output = draft.add_floats(channel.values.reshape(-1, PATH_WIDTHS[channel.path] or 1))
        targets.append({"sampler": len(samplers), "target": {"node": channel.node, "path": channel.path}})
        input_times = times[seconds.tobytes()]
        samplers.append({"input": input_times, "interpolation": channel.interpolation, "output": output})
    return {"name": name, "samplers": samplers, "channels": targets} | rate_extras(fps)


def rate_extras(fps: float | None) -> dict[str, Any]:
    """Return what tells the frame rate in an animation's entry; nothing for None."""
    return {} if fps is None else {"extras": {RATE[0]: {RATE[1]: float(fps)}}}


def _stated_rate(entry: dict[str, Any]) -> float | None:
    found: Any = entry
    for key in ("extras", *RATE):
        found = found.get(key) if isinstance(found, dict) else None
    return float(found) if type(found) in (int, float) and LOWEST_FPS <= found <= HIGHEST_FPS else None


def rotation_channels(
    nodes: Sequence[int], rotation: Float[np.ndarray, "T J 3 3"], parents: tuple[int, ...], fps: float
) -> list[AnimationChannel]:
    """Return the channels of joints with world rotations: a key in each frame, or one where a joint keeps its parent's.

    Joints that stay have a key, too: where an animation leaves a joint out, Blender and blending engines keep the pose
    of another animation.
    """
    quaternions, channels = local_quaternions(rotation, parents), []
    times = np.arange(len(quaternions)) / fps
    for node, track in zip(nodes, quaternions.swapaxes(0, 1), strict=True):
        count = len(track) if np.abs(track - track[0]).max() > STILL else 1
        channels.append(AnimationChannel(node, "rotation", times[:count], track[:count]))
    return channels


def local_quaternions(rotation: Float[np.ndarray, "T J 3 3"], parents: tuple[int, ...]) -> Float[np.ndarray, "T J 4"]:
    """Return each joint's rotation in the frame of its parent, from world rotations, as quaternions (x, y, z, w)."""
    from scipy.spatial.transform import Rotation

    local = local_rotations(rotation, parents)
    quat_xyzw = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_quat().reshape(*local.shape[:2], 4)
    return continuous_quaternions(quat_xyzw)


def animation_names(document: Document) -> tuple[str, ...]:
    """Return the names of all animations; the index stands for a missing name."""
    return tuple(str(entry.get("name") or i) for i, entry in enumerate(document.gltf.get("animations", [])))


def document_details(document: Document) -> tuple[tuple[str, str], ...]:
    """Describe unit, skins, blend shapes and animations as (name, text); entries that a file lacks are left out."""
    gltf = document.gltf
    facts = fbx_facts(document)
    stated = f"converted from {facts['unit']:g} m, {facts.get('up', 'no')} up" if facts else "all glTF files"
    details = [("unit", f"metre, y up ({stated})")]
    if joint_counts := [len(skin["joints"]) for skin in gltf.get("skins", [])]:
        details.append(("skins", f"{len(joint_counts)}, of {', '.join(map(str, joint_counts))} joints"))
    target_counts = [
        max((len(primitive.get("targets", [])) for primitive in mesh["primitives"]), default=0)
        for mesh in gltf.get("meshes", [])
    ]
    if any(target_counts):
        details.append(("blend shapes", ", ".join(str(count) for count in target_counts if count)))
    for number, name in enumerate(animation_names(document)):
        times = [channel.times[-1] for channel in read_channels(document, number)]
        details.append((f"animation {number}", f"{name}, {max(times, default=0.0):.2f} s"))
    return tuple(details)


def fbx_facts(document: Document) -> dict[str, Any]:
    """Return what the converter of an .fbx file noted: its `unit` in metres, its axis that is `up`, `missingTextures`.

    Empty for other files, whose extras may be anything.
    """
    is_fbx = document.path.suffix.lower() == ".fbx"
    return document.gltf["asset"]["extras"]["fbx"] if is_fbx else {}


def find_animation(names: Sequence[str], selector: str, path: Path) -> int:
    """Return the index of an animation by its name, the part of its name after the last "|", or its index.

    Blender exports names such as "Armature|Walk". Case is ignored where no name is equal.

    Raises:
        InputError: no animation matches, or several do; the message lists their names.
    """
    if selector in names:
        return names.index(selector)
    last_parts = [name.rpartition("|")[2] for name in names]
    folded, folded_parts = ([name.casefold() for name in some] for some in (names, last_parts))
    if last_parts.count(selector) == 1:
        return last_parts.index(selector)
    if selector.isdecimal() and int(selector) < len(names):
        return int(selector)
    for candidates in (folded, folded_parts):
        if candidates.count(selector.casefold()) == 1:
            return candidates.index(selector.casefold())
    raise InputError(
        f"{path}: expected one of its animations ({', '.join(names) or 'it has none'}), found {selector!r}; "
        f"check {option('animation')}"
    )


def read_channels(document: Document, animation: int) -> list[AnimationChannel]:
    """Read the channels of an animation.

    Channels without a target node and those of extensions are left out, as 3.11 Animations recommends, and so are
    weights of nodes without morph targets.

    Raises:
        InputError: keys without values, times that do not increase, or an unknown interpolation.
    """
    return _from_zero(_read_channels(document, animation))


def _from_zero(channels: list[AnimationChannel]) -> list[AnimationChannel]:
    """Shift keys so that an animation with keys before zero, which glTF does not have, begins at zero."""
    first = min((float(channel.times[0]) for channel in channels if len(channel.times)), default=0.0)
    return [replace(channel, times=channel.times - first) for channel in channels] if first < 0 else channels


def _read_channels(document: Document, animation: int) -> list[AnimationChannel]:
    """Read the channels of an animation with the times that the file has; see `read_channels`."""
    channels, numbers = [], 0
    try:
        entry = document.gltf["animations"][animation]
        for channel in entry["channels"]:
            target = channel["target"]
            if target["path"] in PATH_WIDTHS and target.get("node") is not None:
                read = _read_channel(document, target, entry["samplers"][channel["sampler"]], _stated_rate(entry))
                numbers += read.times.size + read.values.size
                KEYS.check(numbers, document.path, len(document.binary))
                if read.path != "weights" or scene.target_count(document, read.node):
                    channels.append(read)
    except (KeyError, IndexError, TypeError) as error:
        expected = f"channels with samplers in animation {animation}"
        raise damaged(document.path, expected, f"a gap ({error!r})") from error
    return channels


def animated_nodes(document: Document, paths: Collection[str]) -> set[int]:
    """List the nodes whose properties of some target paths any animation moves, without reading keys."""
    count, found = len(document.gltf.get("nodes", [])), set()
    for number, entry in enumerate(document.gltf.get("animations", [])):
        try:
            targets = [channel["target"] for channel in entry["channels"]]
            found |= {target.get("node") for target in targets if target["path"] in paths}
        except (KeyError, TypeError) as error:
            expected = f"channels with targets in animation {number}"
            raise damaged(document.path, expected, f"a gap ({error!r})") from error
    return {node for node in found if isinstance(node, int) and 0 <= node < count}


def select_channels(document: Document, selector: str | None) -> list[AnimationChannel]:
    """Read the channels of the selected animation; with None, of the first one and of those that complement it."""
    if selector is not None:
        return read_channels(document, find_animation(animation_names(document), selector, document.path))
    return _from_zero([channel for channels in _complementing(document).values() for channel in channels])


def taken_animations(document: Document) -> tuple[int, ...]:
    """List the animations that are played together where none is selected: the first, and those that complement it.

    Complementing animations are those, in file order, whose targets no chosen animation has. Blender writes one
    animation for each object that moves, and all of them belong together; animations of the same targets are
    alternatives (measured with Blender 4.5 and 5.0, docs/log/formats.md).
    """
    return tuple(_complementing(document))


def _named_targets(animation: Any) -> set[tuple[Any, Any]]:
    """List nodes and paths that an animation moves, without reading keys; none of a damaged one."""
    try:
        return {(channel["target"].get("node"), channel["target"]["path"]) for channel in animation["channels"]}
    except (AttributeError, KeyError, TypeError):
        return set()


def _complementing(document: Document) -> dict[int, list[AnimationChannel]]:
    """Read the channels of `taken_animations`, with the times that the file has; keys of alternatives are not read."""
    taken: dict[int, list[AnimationChannel]] = {}
    targets: set[tuple[int, str]] = set()
    for number, entry in enumerate(document.gltf.get("animations", [])):
        if not targets.isdisjoint(_named_targets(entry)):
            continue
        try:
            channels = _read_channels(document, number)
        except InputError:
            if not targets:
                raise
            continue  # an animation that is not asked for may be damaged
        if channels:
            taken[number] = channels
            targets |= {(channel.node, channel.path) for channel in channels}
    return taken


def frame_rate(channels: list[AnimationChannel]) -> float | None:
    """Estimate the frames a second of an animation from its key times; None where they fit no usual rate.

    A rate that the animation states is taken where the keys lie on its frames: another program may have moved them.
    Evenly spaced keys of at least the lowest usual rate are taken as one key a frame. Sparser keys are those of a curve
    that was drawn at a usual rate: then all keys lie on whole frames of it.
    """
    times = np.unique(np.concatenate([channel.times for channel in channels] or [np.zeros(0)]))
    stated = {channel.fps for channel in channels}
    if len(stated) == 1 and (fps := stated.pop()) is not None and lie_on(times, fps):
        return fps
    rate = sample_rate(times)
    if rate is not None and rate >= min(RATES) and lie_on(times, rate):
        return rate
    return usual_rate(times)


def _read_channel(
    document: Document, target: dict[str, Any], sampler: dict[str, Any], fps: float | None
) -> AnimationChannel:
    """Read and check the keys of a sampler for one target."""
    times, values = (read_floats(document, sampler[key]) for key in ("input", "output"))
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in ("STEP", "LINEAR", "CUBICSPLINE"):
        raise damaged(document.path, "keys of STEP, LINEAR or CUBICSPLINE", interpolation)
    times = times[:, 0]
    keys = len(times)
    per_key = values.size // keys if keys else 0
    rows_per_key = 3 if interpolation == "CUBICSPLINE" else 1  # in-tangent, value, out-tangent
    width = rows_per_key * PATH_WIDTHS[target["path"]]
    fits = per_key == width or (target["path"] == "weights" and per_key and not per_key % rows_per_key)
    node_exists = type(target["node"]) is int and 0 <= target["node"] < len(document.gltf.get("nodes", []))
    rising = np.isfinite(times).all() and (np.diff(times) >= 0).all()
    if not (fits and node_exists and rising and values.size == keys * per_key):
        found = f"{keys} times and {values.size} numbers"
        raise damaged(document.path, "rising times with a value each", found)
    # Sketchfab's exporter rounds times of 60 Hz to 30 Hz: of keys at one time the last one counts.
    last = np.append(np.diff(times) > 0, True)[:keys]
    values = values.reshape(keys, per_key)[last]
    return AnimationChannel(target["node"], target["path"], times[last], values, interpolation, fps)


def slerp(
    a: Float[np.ndarray, "T 4"], b: Float[np.ndarray, "T 4"], s: Float[np.ndarray, "T 1"]
) -> Float[np.ndarray, "T 4"]:
    """Interpolate between unit quaternions along the shorter arc (Appendix C, spherical linear interpolation).

    Nearly equal ones are interpolated linearly, because the formula divides by the sine of their angle; the caller
    normalizes.
    """
    cosine = scene.inner_products(a, b)
    b, cosine = np.where(cosine < 0, -b, b), np.abs(cosine)
    values = (1 - s) * a + s * b
    far = cosine[:, 0] <= LINEAR_COSINE
    angle, s = np.arccos(cosine[far]), s[far]
    values[far] = (np.sin((1 - s) * angle) * a[far] + np.sin(s * angle) * b[far]) / np.sin(angle)
    return values


@dataclass(frozen=True, eq=False)
class UnposedVertices:
    """The distinct vertices of a `VertexRange` before skinning, and the data that no frame changes."""

    node: int
    primitive: dict[str, Any]
    positions: Float[np.ndarray, "U 3"] | None
    """Positions of the distinct vertices before skinning; None where morph weights are animated."""
    binding: scene.SkinBinding | None
    """Joints and weights of the distinct vertices; None where the primitive is not skinned."""
    distinct_of: Int[np.ndarray, " V"]
    """Index of the distinct vertex that each vertex of the range equals."""


def frame_times(document: Document, channels: list[AnimationChannel], fps: float) -> Float[np.ndarray, " T"]:
    """Return the times of an animation's frames in seconds, from zero to its last key.

    Raises:
        InputError: the last key is later than an hour, which only damaged times are, or there are too many frames.
    """
    last = max((float(channel.times[-1]) for channel in channels), default=0.0)
    if last > LONGEST:
        raise InputError(f"{document.path}: expected an animation of up to an hour, found {last:.0f} s; cut it")
    count = frame_count(last, fps)
    FRAMES.check(count, document.path)
    moved = len({channel.node for channel in channels})
    POSED_JOINTS.check(count * moved, document.path, len(document.binary))
    return np.arange(count) / fps


def sample_nodes(document: Document, channels: list[AnimationChannel], times: Float[np.ndarray, " T"]) -> NodeBlocks:
    """Yield the animated values and the world transforms of all nodes, for blocks of B frames."""
    for start in range(0, len(times), FRAMES_PER_BLOCK):
        block_times = times[start : start + FRAMES_PER_BLOCK]
        values = {(channel.node, channel.path): channel.sample(block_times) for channel in channels}
        yield from pose_nodes(document, values, len(block_times))
        document.mapped_files.release_pages()


def sample_joints(
    document: Document, channels: list[AnimationChannel], times: Float[np.ndarray, " T"], nodes: list[int]
) -> Float[np.ndarray, "T J 4 4"]:
    """Return the world transforms of some nodes at times in seconds."""
    return np.concatenate([matrices[:, nodes] for _, matrices in sample_nodes(document, channels, times)])


def pose_nodes(document: Document, values: AnimatedValues, frames: int) -> NodeBlocks:
    """Yield given values of properties of nodes, and the world transforms of all nodes, for blocks of B frames."""
    for start in range(0, frames, FRAMES_PER_BLOCK):
        some = {key: value[start : start + FRAMES_PER_BLOCK] for key, value in values.items()}
        count = min(FRAMES_PER_BLOCK, frames - start)
        yield some, scene.world_matrices(document, scene.animated_matrices(document, some, count))


def unposed_vertices(document: Document, rest: RestScene, animated: Iterable[tuple[int, str]]) -> list[UnposedVertices]:
    """Read the vertices of the Mesh before skinning; `animated` are the nodes and properties that frames change."""
    morphed, parts = {node for node, path in animated if path == "weights"}, []
    for span in rest.vertex_ranges:
        primitive = get_primitive(document, (span.node, span.primitives[0]))
        binding = scene.read_skin_binding(document, span.node, primitive)
        if span.node in morphed:  # all vertices, because any of them may get a position of its own
            every = np.arange(span.stop - span.start)
            parts.append(UnposedVertices(span.node, primitive, None, binding, every))
            continue
        positions = scene.read_morphed_attribute(
            document, primitive, "POSITION", scene.read_morph_weights(document, span.node)
        )
        assert positions is not None
        # Vertices with one position and one set of influences stay together in all frames.
        keys = positions if binding is None else np.concatenate([positions, binding.joints, binding.weights], axis=1)
        _, first, distinct_of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        if binding is not None:
            binding = replace(binding, joints=binding.joints[first], weights=binding.weights[first])
        parts.append(UnposedVertices(span.node, primitive, positions[first], binding, distinct_of.reshape(-1)))
    return parts


def posed_vertices(
    document: Document, parts: list[UnposedVertices], blocks: NodeBlocks
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the vertices of the Mesh in each frame of blocks of frames."""
    for values, T_world_node in blocks:
        morph_weights = {node: value for (node, path), value in values.items() if path == "weights"}
        # Positions of one frame at a time: only node transforms are computed for a whole block.
        for t, T_world in enumerate(T_world_node):
            shown = []
            for part in parts:
                positions = part.positions
                if positions is None:
                    weights = morph_weights[part.node][t].tolist()
                    positions = scene.read_morphed_attribute(document, part.primitive, "POSITION", weights)
                assert positions is not None
                # glTF 2.0, 3.7.3.2 Joint Hierarchy: a skinned mesh ignores the transform of its own node.
                matrices = T_world[part.node][None, :3] if part.binding is None else part.binding.matrices(T_world)
                shown.append(scene.transform_points(matrices, positions)[part.distinct_of])
            yield np.concatenate(shown)
