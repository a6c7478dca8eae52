"""The file an identity came from, given back with its vertices elsewhere and nothing else changed.

Kept: nodes, names, materials, textures, images, samplers, UV sets, colours, extras, extensions, cameras, lights,
primitives, index buffers, vertex order and count. Changed: positions, normals, tangents and morph targets of what the
scene shows. Dropped: skins, JOINTS/WEIGHTS and animations. The wanted positions are the final ones: a skin would pose
them once more, and an animation would move them away.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.geometry import vertex_normals, weld
from ...core.mesh import Mesh
from .animation import animation_names, document_details
from .deformed_attributes import needs_rotations, surface_rotations
from .document import Document
from .draft import AccessorCopier, Draft
from .primitives import EditContext, PrimitiveGroup, copy_primitive, edit_primitives
from .read import RestScene, VertexRange
from .scene import scene_nodes

LOCAL_TOLERANCE = 1e-6
"""How far from its place, relative to the size of the mesh, float32 numbers in a node's frame may put a vertex."""


@dataclass(frozen=True, eq=False)
class GltfSource:
    """The opened file behind a Mesh (see `Mesh.source`)."""

    document: Document
    rest: RestScene = field(repr=False)
    vertices: Float[np.ndarray, "V 3"] = field(repr=False)
    """The Mesh's vertices at rest."""
    suffix: str
    notes: tuple[str, ...]
    """One line for each thing of the file that is not in the written one."""

    @property
    def details(self) -> tuple[tuple[str, str], ...]:
        """What the file has besides a surface, name and value."""
        return document_details(self.document)

    @property
    def animations(self) -> tuple[str, ...]:
        """Names of the file's animations."""
        return animation_names(self.document)

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write the file with the vertices of `mesh`, as .gltf or .glb by the suffix of `path`."""
        edit_document(self, mesh)[0].save(path)


def edit_document(source: GltfSource, mesh: Mesh, keep_targets: bool = True) -> tuple[Draft, list[PrimitiveGroup]]:
    """The source's document with the vertices of `mesh`, and where they are in it.

    A mesh that several nodes show becomes one for each, because their vertices now move apart. The vertices are written
    in the frame of their node. Where float32 numbers in that frame cannot hold them (a flattened node, or a skinned
    one far off), the mesh moves to a new node at the root of the scene and the old node stays, empty.

    Raises:
        ValueError: `mesh` does not have the vertices and faces of the source.
    """
    _check_topology(source, mesh)
    old, copier = source.document.gltf, AccessorCopier(source.document)
    vertex_ranges: dict[int, list[VertexRange]] = {node: [] for node in _edited_nodes(source)}
    for span in source.rest.vertex_ranges:
        vertex_ranges[span.node].append(span)
    slots = _assign_meshes(old, list(vertex_ranges))
    own = set(slots.values())
    meshes = [{} if slot in own else _copy_mesh(copier, entry) for slot, entry in enumerate(old["meshes"])]
    meshes += [{} for slot in own if slot >= len(meshes)]
    copier.draft.gltf["meshes"] = meshes
    edit = EditContext(
        source.document, source.rest, with_normals(mesh), _surface_rotations(source, mesh, slots), copier, keep_targets
    )
    groups = []
    for node, slot in slots.items():
        T_world_local = _choose_transform(edit, node, vertex_ranges[node])
        at = _attach_mesh(edit, node, slot, T_world_local)
        primitives, node_groups = edit_primitives(edit, node, vertex_ranges[node], T_world_local)
        meshes[slot] = _replace_primitives(old["meshes"][old["nodes"][node]["mesh"]], primitives, keep_targets)
        groups += [dataclasses.replace(group, node=at) for group in node_groups]
    _drop_skins_and_animations(copier)
    return copier.draft, groups


def with_normals(mesh: Mesh) -> Mesh:
    """The mesh with smooth corner normals if it has faces but no normals; vertices at one position share theirs."""
    if mesh.corner_normals is not None or not len(mesh.faces):
        return mesh
    merged, index = weld(mesh.vertices)
    faces = index[mesh.faces]
    return dataclasses.replace(mesh, corner_normals=vertex_normals(merged, faces)[faces])


def _check_topology(source: GltfSource, mesh: Mesh) -> None:
    faces = max((stop for _, stop in source.rest.faces.values()), default=0)
    if len(mesh.vertices) != len(source.vertices) or len(mesh.faces) != faces:
        raise ValueError(
            f"mesh must have the {len(source.vertices)} vertices and {faces} faces of its source, got "
            f"{len(mesh.vertices)} and {len(mesh.faces)}; set its source to None to write it as a file of its own"
        )


def _edited_nodes(source: GltfSource) -> list[int]:
    """Nodes in scene order that show vertices of the Mesh, or would lose their place with their skin."""
    nodes, moved = (
        source.document.gltf.get("nodes", []),
        {span.node for span in source.rest.vertex_ranges},
    )
    return [n for n in scene_nodes(source.document) if n in moved or ("mesh" in nodes[n] and "skin" in nodes[n])]


def _assign_meshes(gltf: dict[str, Any], edited: list[int]) -> dict[int, int]:
    """For each edited node the number of a mesh of its own: the old one for its first node, unless others keep it."""
    shown = set(edited)
    taken = {node.get("mesh") for index, node in enumerate(gltf["nodes"]) if index not in shown}
    slots: dict[int, int] = {}
    free = len(gltf["meshes"])
    for node in edited:
        mesh = gltf["nodes"][node]["mesh"]
        slots[node], free = (free, free + 1) if mesh in taken else (mesh, free)
        taken.add(mesh)
    return slots


def _surface_rotations(source: GltfSource, mesh: Mesh, slots: dict[int, int]) -> Float[np.ndarray, "M 3 3"]:
    gltf = source.document.gltf
    primitives = [p for node in slots for p in gltf["meshes"][gltf["nodes"][node]["mesh"]]["primitives"]]
    if not any(needs_rotations(primitive) for primitive in primitives):
        return np.eye(3)[None]
    return surface_rotations(source.vertices, mesh.vertices, mesh.faces)


def _choose_transform(edit: EditContext, node: int, vertex_ranges: list[VertexRange]) -> Float[np.ndarray, "4 4"]:
    """Where the node that shows the mesh shall stand: where it stands if that will do, else at the origin.

    A mirroring node is replaced by a mirroring one, because glTF turns the winding of its faces around.
    """
    T_world_node = edit.rest.T_world_node[node]
    root = np.diag([-1.0 if np.linalg.det(T_world_node) < 0 else 1.0, 1.0, 1.0, 1.0])
    points = np.concatenate([np.zeros((0, 3))] + [edit.mesh.vertices[span.start : span.stop] for span in vertex_ranges])
    allowed = max(LOCAL_TOLERANCE * np.ptp(edit.mesh.vertices, axis=0).max(), 2 * _storage_error(root, points))
    return T_world_node if _storage_error(T_world_node, points) <= allowed else root


def _storage_error(T_world_local: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "N 3"]) -> float:
    """How far float32 storage in a frame puts a point from its place at worst; infinite for a flattening frame."""
    linear, origin = T_world_local[:3, :3], T_world_local[:3, 3]
    if not np.linalg.cond(linear) < 1e12:
        return np.inf
    with np.errstate(over="ignore", invalid="ignore"):
        stored = ((points - origin) @ np.linalg.inv(linear).T).astype(np.float32).astype(np.float64)
        error = np.abs(stored @ linear.T + origin - points).max(initial=0.0)
    return float(error) if np.isfinite(error) else np.inf


def _attach_mesh(edit: EditContext, node: int, slot: int, T_world_local: Float[np.ndarray, "4 4"]) -> int:
    """Let the draft show mesh `slot` at `T_world_local`: by the node itself, or by a new one. Returns its number."""
    gltf = edit.copier.draft.gltf
    entry = gltf["nodes"][node]
    entry.pop("skin", None)
    shown = {"mesh": slot} | ({"weights": entry["weights"]} if "weights" in entry and edit.keep_targets else {})
    for key in ("mesh", "weights"):
        entry.pop(key, None)
    if np.array_equal(T_world_local, edit.rest.T_world_node[node]):
        entry |= shown
        return node
    scale = {"scale": np.diag(T_world_local)[:3].tolist()} if T_world_local[0, 0] < 0 else {}
    gltf["nodes"].append({**{key: entry[key] for key in ("name",) if key in entry}, **scale, **shown})
    if gltf.get("scenes"):
        gltf["scenes"][gltf.get("scene", 0)].setdefault("nodes", []).append(len(gltf["nodes"]) - 1)
    return len(gltf["nodes"]) - 1


def _copy_mesh(copier: AccessorCopier, mesh: dict[str, Any]) -> dict[str, Any]:
    return {**mesh, "primitives": [copy_primitive(copier, primitive) for primitive in mesh["primitives"]]}


def _replace_primitives(mesh: dict[str, Any], primitives: list[dict[str, Any]], keep_targets: bool) -> dict[str, Any]:
    mesh = {**mesh, "primitives": primitives}
    if keep_targets:
        return mesh
    mesh.pop("weights", None)
    if isinstance(mesh.get("extras"), dict):
        mesh["extras"] = {key: value for key, value in mesh["extras"].items() if key != "targetNames"}
    return mesh


def _drop_skins_and_animations(copier: AccessorCopier) -> None:
    """Animations go; skins go unless a node outside the scene still has one."""
    gltf = copier.draft.gltf
    gltf.pop("animations", None)
    if any("skin" in node for node in gltf["nodes"]):
        for skin in gltf["skins"]:
            if "inverseBindMatrices" in skin:
                skin["inverseBindMatrices"] = copier.copy_accessor(skin["inverseBindMatrices"], None)
    else:
        gltf.pop("skins", None)
