"""Gives the own rig of a glTF person a root bone: a joint on the floor that carries the way over the ground.

The bone is above all joints of the person, has the axes of the world at rest, and never turns. All other nodes keep
their transforms in the world, also in the animations of the file, and so do all vertices. Only nodes that neither move
nor show anything go along with the bone: other roots, handles and pole targets.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from ...bodies.joint_names import ancestors
from ...core.geometry import nearest_rotation
from .animation import read_channels
from .bake import AnimatedValues
from .document import read_floats
from .draft import Draft
from .edit import GltfSource
from .read import get_primitive
from .scene import DEFAULT_TRS, joint_matrices, node_parents, read_skin_binding

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
BARE = {"name", "children", "matrix", *DEFAULT_TRS, "extras"}
"""Properties of nodes that show nothing."""


@dataclass(frozen=True, eq=False)
class RootBone:
    """A joint above all others of a person: a new node of a file, or one that the file has."""

    source: GltfSource
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

    def insert(self, draft: Draft, name: str) -> None:
        """Add a new bone to the copy of a document: its node, the nodes below it with their keys, and its skins."""
        gltf = draft.gltf
        local = self.T_parent_root
        turn = _quaternion(local)
        entry = {"name": name, "translation": local[:3, 3].tolist(), "children": list(self.children)}
        gltf["nodes"].append(entry | ({} if turn is None else {"rotation": turn.tolist()}))
        above = [gltf["nodes"][self.parent]] if self.parent >= 0 else gltf.get("scenes", [])
        for owner in above:
            _replace(owner, "nodes" if self.parent < 0 else "children", self.children, self.node)
        for node in self.children:
            _move_entry(gltf["nodes"][node], np.linalg.inv(local))
        for number, animation in enumerate(gltf.get("animations", [])):
            self._move_keys(draft, animation, number)
        parents = tuple(node_parents(self.source.document))
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
            tracks: as the nodes of the draft have them.
            hips: path of the hips in the world; y is up.
            draft: the file with the bone.
        """
        way = (hips - hips[0]) * [1.0, 0.0, 1.0]
        moved = dict(tracks)
        for node, into_parent in self.staying.items():
            still = np.array(draft.gltf["nodes"][node].get("translation", DEFAULT_TRS["translation"]), float)
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
        document, joints = self.source.document, list(skin["joints"])
        columns = np.tile(np.eye(4).reshape(16), (len(joints), 1))
        if "inverseBindMatrices" in skin:
            columns = read_floats(document, skin["inverseBindMatrices"])[: len(joints)]
        # Nodes may have another pose than the skin was bound in: the bone is placed relative to the topmost joint.
        depth = [len(ancestors(parents, joint)) for joint in joints]
        T_world_bind = joint_matrices(document, number, self.source.rest.T_world_node)[int(np.argmin(depth))]
        own = np.linalg.inv(self.T_world_root) @ T_world_bind
        own[3] = [0, 0, 0, 1]  # exactly, as 3.7.3.1 demands, in spite of rounding
        columns = np.concatenate([columns, own.T.reshape(1, 16)]).astype("<f4")
        accessor = {"bufferView": draft.add_view(columns), "componentType": 5126, "count": len(columns), "type": "MAT4"}
        skin |= {"joints": [*joints, self.node], "inverseBindMatrices": draft.add_accessor(accessor)}
        # It has to be above all joints (glTF 2.0, 5.28.2 skin.skeleton).
        if "skeleton" in skin and skin["skeleton"] not in ancestors(parents, self.parent):
            skin["skeleton"] = self.node


def place_root_bone(source: GltfSource, person: Mapping[str, int], moving: Collection[int]) -> RootBone:
    """Find the place of a root bone, or the joint of the file that is one.

    Args:
        person: node of each joint of the person, by our name.
        moving: nodes that the new animations move.
    """
    document, world = source.document, source.rest.T_world_node
    parents = tuple(node_parents(document))
    skins = [set(skin["joints"]) for skin in document.gltf.get("skins", [])]
    joints = set(person.values()).union(*(skin for skin in skins if skin.intersection(person.values())))
    weighted = _weighted_nodes(source)
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
            return RootBone(source, node, parents[node], world[node], staying=staying)
        if node in joints or np.abs(_unit(world[node]) - nearest_rotation(_unit(world[node]))).max() > SIMILAR:
            break
        parent = node
    T_world_root = np.eye(4)
    T_world_root[:3, :3] *= np.cbrt(np.linalg.det(_world(source, parent)[:3, :3]))
    T_world_root[:3, 3] = origin
    above_joints = {node for joint in joints for node in ancestors(parents, joint)}
    children = tuple(node for node in sorted(above_joints) if parents[node] == parent)
    staying = _staying(source, children, T_world_root, moving, weighted)
    return RootBone(source, len(world), parent, T_world_root, children, staying)


def _staying(
    source: GltfSource,
    children: Iterable[int],
    T_world_parent: Float[np.ndarray, "4 4"],
    moving: Collection[int],
    weighted: Collection[int],
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """Find the topmost nodes below a root bone that must not go along with it.

    Returns:
        Node -> the matrix that takes directions of the world to the frame of its parent.
    """
    nodes, world = source.document.gltf["nodes"], source.rest.T_world_node
    found = {}
    for node in children:
        if node in moving or node in weighted or not set(nodes[node]) <= BARE:
            found[node] = np.linalg.inv(T_world_parent[:3, :3])
        else:
            found |= _staying(source, nodes[node].get("children", []), world[node], moving, weighted)
    return found


def _weighted_nodes(source: GltfSource) -> set[int]:
    """List the joints with a vertex that has a weight for them."""
    weighted: set[int] = set()
    for span in source.rest.vertex_ranges:
        for number in span.primitives:
            primitive = get_primitive(source.document, (span.node, number))
            binding = read_skin_binding(source.document, span.node, primitive)
            if binding is not None:
                weighted |= set(binding.nodes[binding.joints[binding.weights > 0]].tolist())
    return weighted


def _world(source: GltfSource, node: int) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a node at rest, the identity for none (-1)."""
    return np.eye(4) if node < 0 else source.rest.T_world_node[node]


def _unit(transform: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    """Divide the axes of a transform by their mean length."""
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


def _move_entry(entry: dict[str, Any], transform: Float[np.ndarray, "4 4"]) -> None:
    """Change the transform of a node for another parent, in whose frame the old one has some transform."""
    if "matrix" in entry:
        entry["matrix"] = (transform @ np.reshape(entry["matrix"], (4, 4)).T).T.ravel().tolist()
        return
    for path in ("translation", "rotation"):
        moved = _in_frame(np.array([entry.get(path, DEFAULT_TRS[path])], float), path, transform)[0]
        if path in entry or not np.array_equal(moved, DEFAULT_TRS[path]):
            entry[path] = moved.tolist()


def _replace(owner: dict[str, Any], key: str, old: Collection[int], new: int) -> None:
    """Put one node in the place of the first of several ones in a list of nodes."""
    listed = owner.get(key, [])
    of_old = [node in old for node in listed]
    if any(of_old):
        first = of_old.index(True)
        owner[key] = [*listed[:first], new, *(node for node in listed[first:] if node not in old)]
