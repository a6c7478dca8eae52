"""New animations for the nodes of a glTF file: computes the file's vertices with them, and writes the file again.

The file keeps everything: the bytes of its buffers, nodes, names, skins, morph targets, materials, extensions and
animations. New animations come first, because programs that play one animation play the first.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...bodies.joint_names import with_named_neck
from ...core.animated_rig import frames_around
from ..timing import DEFAULT_FPS, frame_count
from .animation import PATH_WIDTHS, AnimationChannel, add_animation, frame_rate, slerp
from .bake import AnimatedValues, pose_frames, pose_nodes, sample_frames
from .document import Document
from .draft import AccessorCopier, Draft
from .edit import GltfSource
from .keys import KEY_LIMIT
from .own_keys import Tracks, node_keys, rounding
from .read import RestScene
from .root_bone import RootBone, place_root_bone
from .scene import (
    node_properties,
    normalized_quaternions,
    read_morph_weights,
    target_count,
)
from .vrm import json_object, vrm_version

TRUNK = ("LowerBack", "Spine", "Spine1")
"""Our joints between hips and neck."""


@dataclass(frozen=True, eq=False)
class OwnAnimation:
    """A new animation of the nodes of a glTF file, with which the file can be written again."""

    source: GltfSource
    name: str
    tracks: AnimatedValues
    """Values of the properties that are animated, in every frame."""
    fps: float
    frames: int
    joints: dict[str, int]
    """Node of each joint that is known to be a person's, by our name."""
    renamed: dict[int, str] = field(default_factory=dict)
    """New names of nodes."""
    key_limit: float = KEY_LIMIT
    """Distance, over the mesh's size, by which thinned keys may move a vertex."""
    root_bone: str | None = None
    """Name of a bone on the floor above all joints; None: the file has those that it has."""
    root_moves: bool = False
    """Whether that bone carries the way over the ground."""
    keys: Mapping[tuple[int, str], AnimationChannel] = field(default_factory=dict)
    """Keys that are written as they are, of properties that `tracks` has the values of in every frame."""

    def with_layout(self, bones: Mapping[str, str], root_bone: str | None, root_moves: bool) -> OwnAnimation:
        """Rename the bones of a person, and add a root bone.

        Args:
            bones: our name of a joint -> new name of its bone; empty leaves all names.
            root_bone: name of the new bone; None adds none.
            root_moves: let it carry the way over the ground; the hips have to be known for it.
        """
        old = [str(node.get("name", "")) for node in self.source.document.gltf["nodes"]]
        return dataclasses.replace(
            self, renamed=new_names(self.joints, bones, old), root_bone=root_bone, root_moves=root_moves
        )

    def resampled(self, fps: float) -> OwnAnimation:
        """Sample the animation at another frame rate, between frames as players of glTF do."""
        before, after, fraction = frames_around(self.frames, self.fps, fps)
        tracks = {
            (node, path): _between(values[before], values[after], fraction[:, None], path == "rotation")
            for (node, path), values in self.tracks.items()
        }
        return dataclasses.replace(self, tracks=tracks, fps=fps, frames=len(before), keys={})

    def moves(self, key: tuple[int, str]) -> bool:
        """Tell whether a node is anywhere else than in the file, beyond rounding."""
        values, entry = self.tracks[key], self.source.document.gltf["nodes"][key[0]]
        if key[1] == "weights":
            return False
        still = node_value(entry, key, self.source.document)
        if key[1] == "rotation":
            values = values * np.where((values * still).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
        return bool(np.abs(values - still).max() > rounding(self.source, key, values))

    @property
    def morphs(self) -> bool:
        """Whether morph targets are animated."""
        return any(path == "weights" for _, path in self.tracks)

    def node_matrices(self, nodes: Sequence[int]) -> Float[np.ndarray, "T N 4 4"]:
        """Compute the world transforms of some nodes in every frame."""
        blocks = pose_nodes(self.source.document, self.tracks, self.frames)
        return np.concatenate([matrices[:, list(nodes)] for _, matrices in blocks])

    def vertices(self, frames: Int[np.ndarray, " F"] | None = None) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the vertices of the Mesh in some frames, or in every one."""
        tracks = self.tracks if frames is None else {key: values[frames] for key, values in self.tracks.items()}
        count = self.frames if frames is None else len(frames)
        return pose_frames(self.source.document, self.source.rest, tracks, count)


@dataclass(frozen=True, eq=False)
class PlayedAnimation:
    """An animation of a written file as programs play it."""

    document: Document
    """The nodes of the written file, with the meshes of the one that it was made of."""
    rest: RestScene
    channels: list[AnimationChannel]

    def vertices(self, times: Float[np.ndarray, " T"]) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the vertices of the Mesh at times in seconds."""
        return sample_frames(self.document, self.rest, self.channels, times)


def write_own_animations(animations: Sequence[OwnAnimation], path: Path) -> list[PlayedAnimation]:
    """Write the file of an identity with new animations, before those that it has.

    What only some of all animations move, old and new, has one key in the other new ones, with the value of the file:
    where an animation leaves a node out, Blender and blending engines keep the pose of another animation.

    Args:
        animations: of one file, with the same layout.

    Returns:
        The animations as clients of the file play them.
    """
    root = _root_bone(animations)
    draft = _copied_file(animations, root)
    moved = [animation.tracks if root is None else _with_root_bone(animation, root, draft) for animation in animations]
    played = _new_channels(animations, moved, draft)
    entries = _entries(animations, played, draft)
    old = copy.deepcopy(draft.gltf.get("animations", []))
    if entries or old:
        draft.gltf["animations"] = [*entries, *old]
    draft.save(path)
    # Meshes and skins move as before; what is new in them is in the written file alone.
    source = animations[0].source
    written = dataclasses.replace(source.document, gltf={**source.document.gltf, "nodes": draft.gltf["nodes"]})
    return [PlayedAnimation(written, source.rest, channels) for channels in played]


def write_own_pose(animation: OwnAnimation, path: Path) -> None:
    """Write the file of an identity with its nodes as they are in the first frame of an animation.

    A file with animations gets one more, of one key: programs play the first one of a file on opening it, which would
    hide the pose. A VRM has none by its specification.
    """
    draft = _copied_file([animation])
    for (node, target), values in animation.tracks.items():
        draft.gltf["nodes"][node][target] = values[0].tolist()
    old = draft.gltf.get("animations", [])
    if old and vrm_version(animation.source.document) is None:
        pose = {key: values[:1] for key, values in animation.tracks.items()}
        first = [dataclasses.replace(animation, frames=1)]
        draft.gltf["animations"] = [*_entries(first, _new_channels(first, [pose], draft), draft), *old]
    draft.save(path)


def _new_channels(
    animations: Sequence[OwnAnimation], tracks: Sequence[Tracks], draft: Draft
) -> list[list[AnimationChannel]]:
    """Choose the keys of new animations: those of each for all that any of them moves, old and new."""
    document = animations[0].source.document
    exact = [_exact_keys(animation, values) for animation, values in zip(animations, tracks, strict=True)]
    used = dict.fromkeys(key for values in (*tracks, *exact) for key in values)
    used |= dict.fromkeys(_animated_values(document))
    chosen = []
    for animation, values, keys in zip(animations, tracks, exact, strict=True):
        still = {key: node_value(draft.gltf["nodes"][key[0]], key, document) for key in used}
        complete = {key: values.get(key, still[key]) for key in used}
        chosen.append([channel.stored() for channel in _channels(animation, complete, keys)] if complete else [])
    return chosen


def _entries(
    animations: Sequence[OwnAnimation], chosen: Sequence[list[AnimationChannel]], draft: Draft
) -> list[dict[str, Any]]:
    """Add new animations to the copy of a file."""
    pairs = zip(animations, chosen, strict=True)
    return [add_animation(draft, animation.name, channels) for animation, channels in pairs if channels]


def node_value(entry: dict[str, Any], key: tuple[int, str], document: Document) -> Float[np.ndarray, "1 C"]:
    """Return what a node has for a target path, as a track of one frame.

    Args:
        entry: the node, which may be new in a file that is written.
        key: its index and the target path.
        document: the file that has the morph targets.
    """
    node, path = key
    value = read_morph_weights(document, node) if path == "weights" else node_properties(entry)[path]
    return np.array(value, float)[None]


def new_names(joints: Mapping[str, int], bones: Mapping[str, str], old: Sequence[str]) -> dict[int, str]:
    """Assign new names to the nodes of a person's joints, whose names were `old`.

    A trunk of fewer joints than ours gets the names from the hips up, because programs require the first of them. A
    joint that is called neck is one, even if it carries the arms, as in 3ds Max.
    """
    joints = with_named_neck(joints, old)
    trunk = [joints[name] for name in TRUNK if name in joints]
    names = {1: TRUNK[:1], 2: (TRUNK[0], TRUNK[-1])}.get(len(trunk), TRUNK)
    known = {name: node for name, node in joints.items() if name not in TRUNK} | dict(zip(names, trunk, strict=False))
    return {node: bones[name] for name, node in known.items() if name in bones}


def _root_bone(animations: Sequence[OwnAnimation]) -> RootBone | None:
    """Find the place of the root bone of a file, if there is to be one."""
    first = animations[0]
    if first.root_bone is None:
        return None
    moving = {key[0] for animation in animations for key in animation.tracks if animation.moves(key)}
    return place_root_bone(first.source, first.joints, moving)


def _copied_file(animations: Sequence[OwnAnimation], root: RootBone | None = None) -> Draft:
    """Copy the document, with new names, and with properties in place of the matrix of each node that moves.

    Animated nodes must not have a matrix (glTF 2.0, 3.5.3 Transformations).
    """
    first = animations[0]
    draft = AccessorCopier(first.source.document, whole=True).draft
    nodes = draft.gltf["nodes"]
    moving = {node for animation in animations for node, _ in animation.tracks}
    renamed = dict(first.renamed)
    if root is not None:
        moving |= set(root.staying) | set(() if root.is_new else (root.node,))
        # A bone that is there keeps its name where the others do.
        if renamed and not root.is_new and first.root_bone is not None:
            renamed[root.node] = first.root_bone
    for node in moving:
        if "matrix" in nodes[node]:
            properties = {key: value.tolist() for key, value in node_properties(nodes[node]).items()}
            nodes[node] = {key: value for key, value in nodes[node].items() if key != "matrix"} | properties
    taken = set(renamed.values())
    if root is not None and root.is_new:
        taken.add(str(first.root_bone))
    for number, node in enumerate(nodes):
        if number in renamed:
            node["name"] = renamed[number]
        elif node.get("name") is not None and node["name"] in taken:
            node["name"] = f"{node['name']} (of the file)"
    if root is not None and root.is_new and first.root_bone is not None:
        root.insert(draft, first.root_bone)
    return draft


def _with_root_bone(animation: OwnAnimation, root: RootBone, draft: Draft) -> AnimatedValues:
    """Return the values of an animation in the file with a root bone, which carries the way over the ground or not."""
    tracks = root.tracks(animation.tracks)
    if not animation.root_moves:
        return tracks
    return root.carrying(tracks, animation.node_matrices([animation.joints["Hips"]])[:, 0, :3, 3], draft)


def _exact_keys(animation: OwnAnimation, tracks: Tracks) -> dict[tuple[int, str], AnimationChannel]:
    """Return the keys that are written as they are: not where tracks have changed since, nor at another speed."""
    last = max((float(channel.times[-1]) for channel in animation.keys.values()), default=0.0)
    if frame_count(last, animation.fps) != animation.frames:
        return {}
    return {key: keys for key, keys in animation.keys.items() if tracks.get(key) is animation.tracks.get(key)}


def _channels(
    animation: OwnAnimation,
    tracks: Tracks,
    exact: Mapping[tuple[int, str], AnimationChannel],
) -> list[AnimationChannel]:
    """Choose the keys of an animation, from which readers know its rate.

    Unless copied keys show the rate, one track at least has a key in every frame.
    """
    frames = node_keys(animation.source, tracks, animation.key_limit)
    start = min((keys.times[0] for keys in exact.values()), default=0.0)
    shown = any(len(is_key) == animation.frames and is_key.all() for key, is_key in frames.items() if key not in exact)
    copied = bool(exact) and (frame_rate(list(exact.values())) or DEFAULT_FPS) == animation.fps
    if not (shown or copied):
        first = next((key for key in tracks if key not in exact), next(iter(tracks)))
        exact = {key: keys for key, keys in exact.items() if key != first}
        tracks = {**tracks, first: np.broadcast_to(tracks[first], (animation.frames, tracks[first].shape[1]))}
        frames[first] = np.ones(animation.frames, bool)
    channels = []
    for key, track in tracks.items():
        times = np.flatnonzero(frames[key]) / animation.fps
        # A single key is where copied ones begin, so that it changes neither their length nor their rate.
        times = times if len(times) > 1 else times + start
        channels.append(exact[key] if key in exact else AnimationChannel(*key, times, track[frames[key]]))
    return channels


def _animated_values(document: Document) -> list[tuple[int, str]]:
    """List the properties of nodes that the file's own animations move; damaged channels are left out."""
    count, found = len(document.gltf["nodes"]), []
    for animation in document.gltf.get("animations", []):
        channels = animation.get("channels")
        for channel in channels if isinstance(channels, list) else []:
            target = json_object(channel, "target")
            node, path = target.get("node"), str(target.get("path"))
            if path in PATH_WIDTHS and type(node) is int and 0 <= node < count:
                found += [(node, path)] if path != "weights" or target_count(document, node) else []
    return found


def _between(
    before: Float[np.ndarray, "T C"],
    after: Float[np.ndarray, "T C"],
    fraction: Float[np.ndarray, "T 1"],
    rotation: bool,
) -> Float[np.ndarray, "T C"]:
    """Interpolate linearly, quaternions along the shorter arc."""
    if rotation:
        return normalized_quaternions(slerp(before, after, fraction))
    return (1 - fraction) * before + fraction * after
