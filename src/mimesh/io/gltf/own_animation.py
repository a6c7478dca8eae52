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
from jaxtyping import Bool, Float

from ...core.animated_rig import frames_around
from ...core.errors import InputError
from .animation import PATH_WIDTHS, slerp
from .bake import AnimatedValues, pose_frames, pose_nodes
from .document import Document
from .draft import AccessorCopier, Draft
from .edit import GltfSource
from .keys import choose_keys
from .scene import (
    local_matrices,
    node_parents,
    node_properties,
    normalized_quaternions,
    scene_nodes,
    sort_parents_first,
    world_matrices,
)

TRUNK = ("LowerBack", "Spine", "Spine1")
"""Our joints between hips and neck."""
KEY_LIMIT = 3e-6
"""Largest distance, over the size of the file's mesh, by which thinned keys move a vertex: the precision that copied
animations keep is 1e-5."""


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
    root_bone: str | None = None
    """Name of a new node above the hips that carries the displacement over the ground."""

    def with_layout(self, bones: Mapping[str, str], root_bone: str | None) -> OwnAnimation:
        """Rename the bones of a person, and add a root bone.

        Args:
            bones: our name of a joint -> new name of its bone; empty leaves all names.
            root_bone: name of the new bone; None adds none.

        Raises:
            InputError: the rig is not known to be a person's.
        """
        if (bones or root_bone) and "Hips" not in self.joints:
            raise InputError(
                f"--names, --root-bone: expected the bones of a person in {self.source.document.path}, found others; "
                "leave the options out"
            )
        old = [str(node.get("name", "")) for node in self.source.document.gltf["nodes"]]
        return dataclasses.replace(self, renamed=new_names(self.joints, bones, old), root_bone=root_bone)

    def resampled(self, fps: float) -> OwnAnimation:
        """Sample the animation at another frame rate, between frames as players of glTF do."""
        before, after, fraction = frames_around(self.frames, self.fps, fps)
        tracks = {
            (node, path): _between(values[before], values[after], fraction[:, None], path == "rotation")
            for (node, path), values in self.tracks.items()
        }
        return dataclasses.replace(self, tracks=tracks, fps=fps, frames=len(before))

    @property
    def morphs(self) -> bool:
        """Whether morph targets are animated."""
        return any(path == "weights" for _, path in self.tracks)

    def node_matrices(self, nodes: Sequence[int]) -> Float[np.ndarray, "T N 4 4"]:
        """Compute the world transforms of some nodes in every frame."""
        blocks = pose_nodes(self.source.document, self.tracks, self.frames)
        return np.concatenate([matrices[:, list(nodes)] for _, matrices in blocks])

    def vertices(self) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the vertices of the Mesh in every frame."""
        return pose_frames(self.source.document, self.source.rest, self.tracks, self.frames)


def write_own_animations(animations: Sequence[OwnAnimation], path: Path) -> None:
    """Write the file of an identity with new animations, before those that it has.

    What only some of all animations move, old and new, has one key in the other new ones, with the value of the file:
    where an animation leaves a node out, Blender and blending engines keep the pose of another animation.

    Args:
        animations: of one file, with the same layout.
    """
    draft = _copied_file(animations)
    moved = [_with_root_bone(animation, draft) for animation in animations]
    used = dict.fromkeys(key for tracks in moved for key in tracks) | dict.fromkeys(_animated_values(draft))
    tolerance = _tolerances(animations[0].source.document, animations[0].source.vertices)
    entries = []
    for animation, tracks in zip(animations, moved, strict=True):
        still = {key: node_value(draft.gltf["nodes"][key[0]], key[1], animation.source.document) for key in used}
        complete = {key: tracks.get(key, still[key]) for key in used}
        if complete:
            entries.append(_add_animation(draft, animation, complete, tolerance))
    old = copy.deepcopy(draft.gltf.get("animations", []))
    if entries or old:
        draft.gltf["animations"] = [*entries, *old]
    draft.save(path)


def write_own_pose(animation: OwnAnimation, path: Path) -> None:
    """Write the file of an identity with its nodes as they are in the first frame, and nothing else changed."""
    draft = _copied_file([animation])
    for (node, target), values in animation.tracks.items():
        draft.gltf["nodes"][node][target] = values[0].tolist()
    draft.save(path)


def node_value(entry: dict[str, Any], path: str, document: Document) -> Float[np.ndarray, "1 C"]:
    """Return what a node has for a target path, as a track of one frame."""
    if path != "weights":
        return node_properties(entry)[path][None]
    mesh = document.gltf["meshes"][entry["mesh"]]
    count = max(len(primitive.get("targets", [])) for primitive in mesh["primitives"])
    return np.array(entry.get("weights") or mesh.get("weights") or [0.0] * count, float)[None]


def new_names(joints: Mapping[str, int], bones: Mapping[str, str], old: Sequence[str]) -> dict[int, str]:
    """Assign new names to the nodes of a person's joints, whose names were `old`.

    A trunk of fewer joints than ours gets the names from the hips up, because programs require the first of them. A
    joint that is called neck is one, even if it carries the arms, as in 3ds Max.
    """
    trunk = [joints[name] for name in TRUNK if name in joints]
    if "Neck" not in joints and len(trunk) > 1 and "neck" in old[trunk[-1]].lower():
        joints = {**joints, "Neck": trunk.pop()}
    names = {1: TRUNK[:1], 2: (TRUNK[0], TRUNK[-1])}.get(len(trunk), TRUNK)
    known = {name: node for name, node in joints.items() if name not in TRUNK} | dict(zip(names, trunk, strict=False))
    return {node: bones[name] for name, node in known.items() if name in bones}


def _copied_file(animations: Sequence[OwnAnimation]) -> Draft:
    """Copy the document, with new names, and with properties in place of the matrix of each node that moves.

    Animated nodes must not have a matrix (glTF 2.0, 3.5.3 Transformations).
    """
    first = animations[0]
    draft = AccessorCopier(first.source.document, whole=True).draft
    nodes = draft.gltf["nodes"]
    for node in {node for animation in animations for node, _ in animation.tracks}:
        if "matrix" in nodes[node]:
            properties = {key: value.tolist() for key, value in node_properties(nodes[node]).items()}
            nodes[node] = {key: value for key, value in nodes[node].items() if key != "matrix"} | properties
    taken = {*first.renamed.values(), first.root_bone}
    for number, node in enumerate(nodes):
        if number in first.renamed:
            node["name"] = first.renamed[number]
        elif node.get("name") is not None and node["name"] in taken:
            node["name"] = f"{node['name']} (of the file)"
    if first.root_bone is not None:
        _insert_root(draft, first)
    return draft


def _insert_root(draft: Draft, animation: OwnAnimation) -> None:
    """Add a node, the last one, between the hips and what is above them."""
    hips, gltf = animation.joints["Hips"], draft.gltf
    above, root = node_parents(animation.source.document)[hips], len(gltf["nodes"])
    gltf["nodes"].append({"name": animation.root_bone, "children": [hips]})
    owners = [gltf["nodes"][above]["children"]] if above >= 0 else [scene.get("nodes", []) for scene in gltf["scenes"]]
    for children in owners:
        children[:] = [root if node == hips else node for node in children]


def _with_root_bone(animation: OwnAnimation, draft: Draft) -> AnimatedValues:
    """Return the tracks with the hips' displacement over the ground on the root bone, if there is one."""
    path = None if animation.root_bone is None else animation.tracks.get((animation.joints["Hips"], "translation"))
    if path is None:
        return animation.tracks
    document, hips = animation.source.document, animation.joints["Hips"]
    above = node_parents(document)[hips]
    linear = np.eye(3) if above < 0 else world_matrices(document, local_matrices(document))[above, :3, :3]
    moved = (path - path[0]) @ linear.T * [1.0, 0.0, 1.0]
    local = moved @ np.linalg.inv(linear).T
    root = len(draft.gltf["nodes"]) - 1
    return {**animation.tracks, (hips, "translation"): path - local, (root, "translation"): local}


def _add_animation(
    draft: Draft, animation: OwnAnimation, tracks: AnimatedValues, tolerance: dict[tuple[int, str], float]
) -> dict[str, Any]:
    """Add the keys of an animation; one track at least has a key in every frame, from which readers know the rate.

    Channels with keys in the same frames share their times.
    """
    keys = {key: _chosen_keys(values, key[1], tolerance.get(key, 0.0)) for key, values in tracks.items()}
    if not any(len(is_key) == animation.frames and is_key.all() for is_key in keys.values()):
        first = next(iter(tracks))
        tracks = {**tracks, first: np.broadcast_to(tracks[first], (animation.frames, tracks[first].shape[1]))}
        keys[first] = np.ones(animation.frames, bool)
    times: dict[bytes, int] = {}
    samplers, channels = [], []
    for key, values in tracks.items():
        is_key = keys[key]
        if is_key.tobytes() not in times:
            times[is_key.tobytes()] = draft.add_floats(np.flatnonzero(is_key)[:, None] / animation.fps, bounds=True)
        chosen = values[is_key]
        output = draft.add_floats(chosen.reshape(-1, 1) if key[1] == "weights" else chosen)
        channels.append({"sampler": len(samplers), "target": {"node": key[0], "path": key[1]}})
        samplers.append({"input": times[is_key.tobytes()], "interpolation": "LINEAR", "output": output})
    return {"name": animation.name, "samplers": samplers, "channels": channels}


def _animated_values(draft: Draft) -> list[tuple[int, str]]:
    """List the properties of nodes that the file's own animations move."""
    channels = [channel for animation in draft.gltf.get("animations", []) for channel in animation["channels"]]
    targets = [channel["target"] for channel in channels]
    found = [(target["node"], target["path"]) for target in targets if isinstance(target.get("node"), int)]
    return [key for key in found if key[1] in PATH_WIDTHS and key[0] < len(draft.gltf["nodes"])]


def _chosen_keys(values: Float[np.ndarray, "T C"], path: str, tolerance: float) -> Bool[np.ndarray, " T"]:
    """Choose the frames that become keys: of rotations as few as the tolerance allows, of others all or one."""
    if path != "rotation":
        return np.ones(len(values), bool) if np.ptp(values, axis=0).max() > 0 else np.arange(len(values)) == 0
    quaternions = normalized_quaternions(values)
    return choose_keys(quaternions[None], np.array([tolerance]), rotations=True)[0]


def _tolerances(document: Document, vertices: Float[np.ndarray, "V 3"]) -> dict[tuple[int, str], float]:
    """Compute the error of each node's rotation (radians) with which no vertex moves farther than KEY_LIMIT.

    Errors along a chain of nodes add up: each gets an equal share, over the size of the whole mesh, because any kind of
    node may move all of it.
    """
    parent, depth = node_parents(document), {-1: 0}
    for node in sort_parents_first(document, parent):
        depth[node] = depth[parent[node]] + 1
    longest = max((depth[node] for node in scene_nodes(document)), default=1)
    reach = np.linalg.norm(np.ptp(vertices, axis=0)) / np.ptp(vertices, axis=0).max()
    return {(node, "rotation"): KEY_LIMIT / (longest * reach) for node in depth if node >= 0}


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
