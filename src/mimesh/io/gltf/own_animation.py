"""New animations for the nodes of a glTF file: computes the file's vertices with them, and writes the file again.

The file keeps everything: the bytes of its buffers, nodes, names, skins, morph targets, materials, extensions and
animations. New animations come first, because programs that play one animation play the first.

A root bone can be added: a joint on the floor that carries the way over the ground. The bone is above all joints of
the person, has the axes of the world at rest, and never turns. All other nodes keep their transforms in the world, also
in the animations of the file, and so do all vertices. Only nodes that neither move nor show anything go along with the
bone: other roots, handles and pole targets.
"""

from __future__ import annotations

import copy
import dataclasses
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...bodies.engine_names import SCHEMES, root_name
from ...bodies.joint_names import ancestors
from ...core.animated_rig import frames_around
from ...core.geometry import nearest_rotation
from ...core.mesh import check_cut
from ...core.options import Layout
from ...motions.bone_motion import TRUNK
from ..timing import DEFAULT_FPS
from . import scene
from .animation import (
    PATH_WIDTHS,
    AnimatedValues,
    AnimationChannel,
    UnposedVertices,
    add_animation,
    animation_names,
    find_animation,
    frame_rate,
    frame_times,
    pose_nodes,
    posed_vertices,
    read_channels,
    select_channels,
    slerp,
    unposed_vertices,
)
from .document import Document
from .draft import AccessorCopier, Draft
from .edit import GltfSource
from .own_rig import OwnRig
from .read import get_primitive
from .vrm import json_object, vrm_version

ROOT_NAME = re.compile(r"(.*[:|])?root", re.IGNORECASE)
"""Names of a joint that may be a root bone already, with or without a namespace."""
SAME_AXES = 1e-2
"""Largest deviation of such a joint's unit axes from those of the world."""
SAME_PLACE = 0.1
"""Largest distance, over the size of the mesh, of such a joint from the floor below the hips: many rigs have it below
the middle of the feet."""
SIMILAR = 1e-4
"""Largest deviation of a parent's unit axes from a rotation. A joint below others would need a shear to have the axes
of the world, which nodes cannot have (glTF 2.0, 3.5.3 Transformations)."""
UNTURNED = 1e-9
"""Largest deviation of a rotation from none with which quaternions stay as they are, to the last bit."""
ROUNDING, SCALE_ROUNDING = 1e-7, 5e-6
"""Changes that count as none: of a value, over itself or over the mesh's size, because float32 stores values no better;
of a scale, relative, because scales that are computed from matrices in float32 change as much where bones keep their
lengths (measured on a file of Kenney's)."""
Tracks = Mapping[tuple[int, str], Float[np.ndarray, "_ _"]]
"""Values by (node, target path): in every frame, or in one of what does not move."""
BARE = {"name", "children", "matrix", *scene.DEFAULT_TRS, "extras"}
"""Properties of nodes that show nothing."""


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
    """Name of a bone on the floor above all joints; None: the file has those that it has."""
    root_moves: bool = False
    """Whether that bone carries the way over the ground."""

    def with_layout(self, bones: Mapping[str, str], root_bone: str | None, root_moves: bool) -> OwnAnimation:
        """Rename the bones of a person, and add a root bone.

        Args:
            bones: our name of a joint -> new name of its bone; empty leaves all names.
            root_bone: name of the new bone; None adds none.
            root_moves: let it carry the way over the ground; the hips have to be known for it.

        A trunk of fewer joints than ours gets the names from the hips up, because programs require the first of them.
        """
        trunk = [self.joints[name] for name in TRUNK if name in self.joints]
        names = {1: TRUNK[:1], 2: (TRUNK[0], TRUNK[-1])}.get(len(trunk), TRUNK)
        known = {name: node for name, node in self.joints.items() if name not in TRUNK}
        known |= dict(zip(names, trunk, strict=False))
        renamed = {node: bones[name] for name, node in known.items() if name in bones}
        return dataclasses.replace(self, renamed=renamed, root_bone=root_bone, root_moves=root_moves)

    def resampled(self, fps: float) -> OwnAnimation:
        """Sample the animation at another frame rate, between frames as players of glTF do."""
        before, after, fraction = frames_around(self.frames, self.fps, fps)
        between, tracks = fraction[:, None], {}
        for (node, path), values in self.tracks.items():
            a, b = values[before], values[after]
            if path == "rotation":
                tracks[node, path] = scene.normalized_quaternions(slerp(a, b, between))
            else:
                tracks[node, path] = (1 - between) * a + between * b
        return dataclasses.replace(self, tracks=tracks, fps=fps, frames=len(before))

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
        document = self.source.document
        return posed_vertices(document, self._unposed, pose_nodes(document, tracks, count))

    @cached_property
    def _unposed(self) -> list[UnposedVertices]:
        """The vertices before skinning, which are asked for several times: by report, picture, page and file."""
        return unposed_vertices(self.source.document, self.source.rest, self.tracks)


def laid_out(animation: OwnAnimation, layout: Layout) -> OwnAnimation:
    """Give the bones of a file the names and the root bone of a layout."""
    return animation.with_layout(SCHEMES[layout.names].bones, root_name(layout), layout.root_bone)


def own_pose(own: OwnRig, name: str, layout: Layout, tracks: AnimatedValues | None = None) -> OwnAnimation:
    """Return the bones of a file in a layout, in one pose: that of its nodes, but for the values in `tracks`."""
    return laid_out(OwnAnimation(own.source, name, tracks or {}, DEFAULT_FPS, 1, own.person), layout)


def write_own_animations(animations: Sequence[OwnAnimation], path: Path) -> None:
    """Write the file of an identity with new animations, before those that it has.

    What only some of all animations move, old and new, has one key in the other new ones, with the value of the file:
    where an animation leaves a node out, Blender and blending engines keep the pose of another animation.
    """
    root = _place_root_bone(animations)
    draft = _copied_file(animations, root)
    moved = [animation.tracks if root is None else root.tracks(animation.tracks) for animation in animations]
    for k, animation in enumerate(animations):
        if root is not None and animation.root_moves:
            hips = animation.node_matrices([animation.joints["Hips"]])[:, 0, :3, 3]
            moved[k] = root.carrying(moved[k], hips, draft)
    entries = _new_entries(animations, moved, draft)
    old = copy.deepcopy(draft.gltf.get("animations", []))
    if entries or old:
        draft.gltf["animations"] = [*entries, *old]
    draft.save(path)


def cut_animation(source: GltfSource, animation: str | None, fps: float | None, frames: slice) -> OwnAnimation:
    """Sample an animation of a file in some of its frames; the animation is the only one of what it is written to.

    Args:
        animation: its name or number; None: the first, with those that complement it.
        fps: frames a second; None: the rate that its keys lie on.
    """
    document, names = source.document, animation_names(source.document)
    channels = select_channels(document, animation)
    fps = fps or frame_rate(channels) or DEFAULT_FPS
    times = frame_times(document, channels, fps)
    check_cut(document.path.name, len(times), frames)
    times, rate = times[frames], fps / (frames.step or 1)
    tracks = {(channel.node, channel.path): channel.sample(times) for channel in channels}
    bare = {key: value for key, value in document.gltf.items() if key != "animations"}
    alone = dataclasses.replace(source, document=dataclasses.replace(document, gltf=bare))
    name = names[0 if animation is None else find_animation(names, animation, document.path)]
    return OwnAnimation(alone, name, tracks, rate, len(times), {})


def write_own_rig(rig: OwnAnimation, path: Path) -> None:
    """Write the file of an identity with new names of its bones, and a root bone, as `with_layout` has set them."""
    _copied_file([rig], _place_root_bone([rig])).save(path)


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
        draft.gltf["animations"] = [*_new_entries(first, [pose], draft), *old]
    draft.save(path)


def _new_entries(animations: Sequence[OwnAnimation], tracks: Sequence[Tracks], draft: Draft) -> list[dict[str, Any]]:
    """Add new animations to the copy of a file: the keys of each for all that any of them moves, old and new."""
    document = animations[0].source.document
    used = dict.fromkeys([*(key for values in tracks for key in values), *_animated_values(document)])
    still = {key: node_value(draft.gltf["nodes"][key[0]], key, document) for key in used}
    return [
        add_animation(
            draft,
            animation.name,
            _channels(animation, {key: values.get(key, still[key]) for key in used}),
            animation.fps,
        )
        for animation, values in zip(animations, tracks, strict=True)
        if used
    ]


def node_value(entry: dict[str, Any], key: tuple[int, str], document: Document) -> Float[np.ndarray, "1 C"]:
    """Return what a node has for a target path, as a track of one frame."""
    node, path = key
    value = scene.read_morph_weights(document, node) if path == "weights" else scene.node_properties(entry)[path]
    return np.array(value, float)[None]


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
        if renamed and not root.is_new:
            renamed[root.node] = root.name
    for node in moving:
        if "matrix" in nodes[node]:
            properties = {key: value.tolist() for key, value in scene.node_properties(nodes[node]).items()}
            nodes[node] = {key: value for key, value in nodes[node].items() if key != "matrix"} | properties
    taken = set(renamed.values()) | ({root.name} if root is not None and root.is_new else set())
    for number, node in enumerate(nodes):
        if number in renamed:
            node["name"] = renamed[number]
        elif node.get("name") is not None and node["name"] in taken:
            node["name"] = f"{node['name']} (of the file)"
    document = first.source.document
    for number, skin in enumerate(draft.gltf.get("skins", [])):
        if scene.unbound_joints(document, number):
            skin["inverseBindMatrices"] = draft.add_matrices(scene.read_inverse_bind_matrices(document, number))
    if root is not None and root.is_new:
        root.insert(draft)
    return draft


def _channels(animation: OwnAnimation, tracks: Tracks) -> list[AnimationChannel]:
    """Return the keys of an animation, in every frame or where nothing changes in the first one.

    One track at least has a key in every frame, from which readers know the rate.
    """
    counts = {key: key_count(animation.source, key, track) for key, track in tracks.items()}
    if animation.frames not in counts.values():
        first = next(iter(tracks))
        tracks = {**tracks, first: np.broadcast_to(tracks[first], (animation.frames, tracks[first].shape[1]))}
        counts[first] = animation.frames
    return [
        AnimationChannel(*key, np.arange(counts[key]) / animation.fps, track[: counts[key]])
        for key, track in tracks.items()
    ]


def key_count(source: GltfSource, key: tuple[int, str], values: Float[np.ndarray, "T C"]) -> int:
    """Count the keys of animated values: one for each frame, or one where nothing changes."""
    return len(values) if np.abs(values - values[0]).max() > rounding(source, key, values) else 1


def rounding(source: GltfSource, key: tuple[int, str], values: Float[np.ndarray, "T C"]) -> float:
    """Return the change of animated values that is no more than rounding, in their unit."""
    node, path = key
    if path == "scale":
        return SCALE_ROUNDING * float(np.abs(values).max())
    unit = {"rotation": 1.0, "weights": 1.0}.get(path, 0.0)
    if path == "translation" and node < len(source.rest.T_world_node):
        above = _world(source, scene.node_parents(source.document)[node])[:3, :3]
        unit = float(np.ptp(source.vertices, axis=0).max() / max(np.linalg.norm(above, axis=0).max(), 1e-12))
    return ROUNDING * max(float(np.abs(values).max()), unit)


def _animated_values(document: Document) -> list[tuple[int, str]]:
    """List the properties of nodes that the file's own animations move; damaged channels are left out."""
    count, found = len(document.gltf["nodes"]), []
    for animation in document.gltf.get("animations", []):
        channels = animation.get("channels")
        for channel in channels if isinstance(channels, list) else []:
            target = json_object(channel, "target")
            node, path = target.get("node"), str(target.get("path"))
            if path in PATH_WIDTHS and type(node) is int and 0 <= node < count:
                found += [(node, path)] if path != "weights" or scene.target_count(document, node) else []
    return found


@dataclass(frozen=True, eq=False)
class RootBone:
    """A joint above all others of a person: a new node of a file, or one that the file has."""

    source: GltfSource
    name: str
    """Its name, in a file where bones get new ones or it is new."""
    node: int
    """Its index; of a new node, that after the last one of the file."""
    parent: int
    """The node above it, -1 for none."""
    T_world_root: Float[np.ndarray, "4 4"]
    """Its transform at rest."""
    children: tuple[int, ...] = ()
    """Nodes whose parent a new node becomes."""
    staying: Mapping[int, Float[np.ndarray, "3 3"]] = field(default_factory=dict)
    """Nodes below the bone that stay when it moves -> matrix that takes directions of the world into the parent."""

    @property
    def is_new(self) -> bool:
        """Whether the file has no such node."""
        return self.node == len(self.source.document.gltf["nodes"])

    @property
    def T_parent_root(self) -> Float[np.ndarray, "4 4"]:
        """Its local transform at rest."""
        return np.linalg.inv(_world(self.source, self.parent)) @ self.T_world_root

    def insert(self, draft: Draft) -> None:
        """Add a new bone to the copy of a document: its node, the nodes below it with their keys, and its skins."""
        gltf = draft.gltf
        local = self.T_parent_root
        turn = _quaternion(local)
        entry = {"name": self.name, "translation": local[:3, 3].tolist(), "children": list(self.children)}
        gltf["nodes"].append(entry | ({} if turn is None else {"rotation": turn.tolist()}))
        above = [gltf["nodes"][self.parent]] if self.parent >= 0 else gltf.get("scenes", [])
        key = "nodes" if self.parent < 0 else "children"
        for owner in above:  # the bone takes the place of the first of those that are below it now
            of_old = [node in self.children for node in owner.get(key, [])]
            if any(of_old):
                listed, first = owner[key], of_old.index(True)
                after = [node for node in listed[first:] if node not in self.children]
                owner[key] = [*listed[:first], self.node, *after]
        for node in self.children:
            entry, T_root_parent = gltf["nodes"][node], np.linalg.inv(local)
            if "matrix" in entry:
                entry["matrix"] = (T_root_parent @ np.reshape(entry["matrix"], (4, 4)).T).T.ravel().tolist()
                continue
            for path in ("translation", "rotation"):
                moved = _in_frame(np.array([entry.get(path, scene.DEFAULT_TRS[path])], float), path, T_root_parent)[0]
                if path in entry or not np.array_equal(moved, scene.DEFAULT_TRS[path]):
                    entry[path] = moved.tolist()
        for number, animation in enumerate(gltf.get("animations", [])):
            self._move_keys(draft, animation, number)
        parents = tuple(scene.node_parents(self.source.document))
        for number, skin in enumerate(gltf.get("skins", [])):
            if any(set(ancestors(parents, joint)).intersection(self.children) for joint in skin["joints"]):
                self._add_to_skin(draft, skin, number, parents)

    def tracks(self, tracks: AnimatedValues) -> AnimatedValues:
        """Return the values of an animation for the nodes that are below a new bone now."""
        T_root_parent = np.linalg.inv(self.T_parent_root)
        return {
            (node, path): _in_frame(values, path, T_root_parent) if node in self.children else values
            for (node, path), values in tracks.items()
        }

    def carrying(self, tracks: AnimatedValues, hips: Float[np.ndarray, "T 3"], draft: Draft) -> AnimatedValues:
        """Return the values of an animation with the way over the ground on the bone.

        Args:
            hips: path of the hips in the world; y is up.
        """
        way = (hips - hips[0]) * [1.0, 0.0, 1.0]
        moved = dict(tracks)
        for node, into_parent in self.staying.items():
            still = np.array(draft.gltf["nodes"][node].get("translation", scene.DEFAULT_TRS["translation"]), float)
            moved[node, "translation"] = moved.get((node, "translation"), still) - way @ into_parent.T
        into_parent = np.linalg.inv(_world(self.source, self.parent)[:3, :3])
        moved[self.node, "translation"] = self.T_parent_root[:3, 3] + way @ into_parent.T
        return moved

    def _move_keys(self, draft: Draft, animation: dict[str, Any], number: int) -> None:
        """Change the keys that one of the file's animations has for the nodes that are below a new bone now."""
        T_root_parent = np.linalg.inv(self.T_parent_root)
        mine = [c for c in animation["channels"] if c.get("target", {}).get("node") in self.children]
        if not mine:
            return
        read = {(c.node, c.path): c for c in read_channels(self.source.document, number)}
        for channel in mine:
            found = read.get((channel["target"]["node"], channel["target"]["path"]))
            if found is None or found.path not in ("translation", "rotation"):
                continue
            rows = found.values.reshape(len(found.times), -1, 3 if found.path == "translation" else 4)
            moved = np.stack(
                [
                    # The first and last of three rows of a cubic spline are tangents, which are directions.
                    _in_frame(rows[:, k], found.path, T_root_parent, tangents=rows.shape[1] == 3 and k != 1)
                    for k in range(rows.shape[1])
                ],
                axis=1,
            )
            # Other channels may share the sampler.
            sampler = {**animation["samplers"][channel["sampler"]]}
            sampler["output"] = draft.add_floats(moved.reshape(-1, rows.shape[2]))
            animation["samplers"].append(sampler)
            channel["sampler"] = len(animation["samplers"]) - 1

    def _add_to_skin(self, draft: Draft, skin: dict[str, Any], number: int, parents: tuple[int, ...]) -> None:
        """Append the bone to the joints of a skin, bound where it is at rest; no vertex has a weight for it."""
        document, joints = self.source.document, skin["joints"]
        # Nodes may have another pose than the skin was bound in: the bone is placed relative to the topmost joint.
        depth = [len(ancestors(parents, joint)) for joint in joints]
        T_world_bind = scene.joint_matrices(document, number, self.source.rest.T_world_node)[int(np.argmin(depth))]
        own = np.linalg.inv(self.T_world_root) @ T_world_bind
        inverse_bind = np.concatenate([scene.read_inverse_bind_matrices(document, number), own[None]])
        skin |= {"joints": [*joints, self.node], "inverseBindMatrices": draft.add_matrices(inverse_bind)}
        # It has to be above all joints (glTF 2.0, 5.28.2 skin.skeleton).
        if "skeleton" in skin and skin["skeleton"] not in ancestors(parents, self.parent):
            skin["skeleton"] = self.node


def _place_root_bone(animations: Sequence[OwnAnimation]) -> RootBone | None:
    """Find the place of the root bone of a file, if there is to be one, or the joint of the file that is one."""
    source, name, person = animations[0].source, animations[0].root_bone, animations[0].joints
    if name is None:
        return None
    moving = {key[0] for animation in animations for key in animation.tracks if animation.moves(key)}
    document, world = source.document, source.rest.T_world_node
    parents = scene.node_parents(document)
    skins = [set(skin["joints"]) for skin in document.gltf.get("skins", [])]
    joints = set(person.values()).union(*(skin for skin in skins if skin.intersection(person.values())))
    weighted: set[int] = set()  # joints with a vertex that has a weight for them
    for span in source.rest.vertex_ranges:
        for number in span.primitives:
            binding = scene.read_skin_binding(document, span.node, get_primitive(document, (span.node, number)))
            if binding is not None:
                weighted |= set(binding.nodes[binding.joints[binding.weights > 0]].tolist())
    size = np.ptp(source.vertices, axis=0).max()
    origin = world[person["Hips"], :3, 3].copy()
    origin[1] = source.vertices[:, 1].min()
    common = set.intersection(*(set(ancestors(parents, joint)) for joint in joints))
    parent = -1
    for node in ancestors(parents, person["Hips"])[::-1]:
        if node in moving or node not in common:
            break
        # Figures of rigid parts have no skin whose joints it could be one of.
        free = (node in joints or not skins) and node not in weighted and set(document.gltf["nodes"][node]) <= BARE
        named = ROOT_NAME.fullmatch(str(document.gltf["nodes"][node].get("name", ""))) is not None
        placed = np.linalg.norm(world[node, :3, 3] - origin) < SAME_PLACE * size
        if free and named and placed and np.abs(_unit(world[node]) - np.eye(3)).max() < SAME_AXES:
            children = document.gltf["nodes"][node].get("children", [])
            staying = _staying(source, children, world[node], moving, weighted)
            return RootBone(source, name, node, parents[node], world[node], staying=staying)
        if node in joints or np.abs(_unit(world[node]) - nearest_rotation(_unit(world[node]))).max() > SIMILAR:
            break
        parent = node
    T_world_root = np.eye(4)
    T_world_root[:3, :3] *= np.cbrt(np.linalg.det(_world(source, parent)[:3, :3]))
    T_world_root[:3, 3] = origin
    above_joints = {node for joint in joints for node in ancestors(parents, joint)}
    children = tuple(node for node in sorted(above_joints) if parents[node] == parent)
    staying = _staying(source, children, T_world_root, moving, weighted)
    return RootBone(source, name, len(world), parent, T_world_root, children, staying)


def _staying(
    source: GltfSource,
    children: Iterable[int],
    T_world_parent: Float[np.ndarray, "4 4"],
    moving: Collection[int],
    weighted: Collection[int],
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """Find the topmost nodes below a root bone that stay: node -> matrix from world directions to its parent."""
    nodes, world = source.document.gltf["nodes"], source.rest.T_world_node
    found = {}
    for node in children:
        if node in moving or node in weighted or not set(nodes[node]) <= BARE:
            found[node] = np.linalg.inv(T_world_parent[:3, :3])
        else:
            found |= _staying(source, nodes[node].get("children", []), world[node], moving, weighted)
    return found


def _world(source: GltfSource, node: int) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a node at rest, the identity for none (-1)."""
    return np.eye(4) if node < 0 else source.rest.T_world_node[node]


def _unit(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    return transform[:3, :3] / max(float(np.linalg.norm(transform[:3, :3], axis=0).mean()), 1e-12)


def _quaternion(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 4"] | None:
    """Return the rotation (xyzw) of a similarity; None for none."""
    from scipy.spatial.transform import Rotation

    rotation = nearest_rotation(transform[:3, :3])
    return None if np.abs(rotation - np.eye(3)).max() < UNTURNED else Rotation.from_matrix(rotation).as_quat()


def _in_frame(
    values: Float[np.ndarray, "T C"], path: str, transform: Float[np.ndarray, "4 4"], tangents: bool = False
) -> Float[np.ndarray, "T C"]:
    """Change values of a node for another parent, in whose frame the old one has a similarity as its transform."""
    if path == "translation":
        return values @ transform[:3, :3].T + (0.0 if tangents else transform[:3, 3])
    turn = _quaternion(transform)
    if path != "rotation" or turn is None:
        return values
    x, y, z, w = turn
    # The product of quaternions is linear in the second one, so tangents change in the same way.
    return values @ np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]]).T
