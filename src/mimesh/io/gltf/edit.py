"""Writes the glTF file that a Mesh was read from again, with other vertices and nothing else changed.

Kept: nodes, names, materials, textures, images, samplers, UV sets, colours, extras, extensions, cameras, lights,
primitives, index accessors, vertex order and count. Changed: positions, normals, tangents and morph targets of what the
scene shows. Dropped: skins, JOINTS/WEIGHTS and animations. The new positions are final: a skin would pose them once
more, and an animation would move them away.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float

from ...core.geometry import vertex_normals, weld
from ...core.mesh import Mesh
from .animation import animation_names, document_details, fbx_facts
from .check import ANIMATION_POINTER
from .deformed_attributes import needs_rotations, surface_rotations
from .document import Document, uri_file_name, without_extensions
from .draft import AccessorCopier, Draft
from .primitives import EditContext, PrimitiveGroup, copy_primitive, edit_primitives
from .read import RestScene, VertexRange
from .scene import scene_nodes

LOCAL_TOLERANCE = 1e-6
"""Largest allowed rounding error of positions stored as float32 in a node's frame, relative to the mesh's extent."""
MAX_CONDITION = 1e12
"""Condition number of a node's matrix from which on it counts as singular."""


@dataclass(frozen=True, eq=False)
class GltfSource:
    """The open glTF file that a Mesh was read from (see `Mesh.source`)."""

    document: Document
    rest: RestScene = field(repr=False)
    vertices: Float[np.ndarray, "V 3"] = field(repr=False)
    """The Mesh's vertices at rest."""
    suffix: str
    """Suffix of the file, in lower case."""
    notes: tuple[str, ...]
    """One line for each part of the file that is lost or changed when it is written again."""

    @property
    def details(self) -> tuple[tuple[str, str], ...]:
        """Describe unit, skins, blend shapes and animations of the file as (name, text)."""
        return document_details(self.document)

    @property
    def animations(self) -> tuple[str, ...]:
        """Return the names of the file's animations."""
        return animation_names(self.document)

    @property
    def missing_images(self) -> tuple[str, ...]:
        """List the images that the file names and that do not exist, or are no images."""
        images = zip(self.document.gltf.get("images", []), self.document.images, strict=True)
        missing = [unquote(image["uri"]) for image, content in images if content is None and uri_file_name(image)]
        return (*missing, *fbx_facts(self.document).get("missingTextures", []))

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write the file again with the vertices of `mesh`, as .gltf or .glb by the suffix of `path`."""
        edit_document(self, mesh)[0].save(path)


def edit_document(source: GltfSource, mesh: Mesh, keep_targets: bool = True) -> tuple[Draft, list[PrimitiveGroup]]:
    """Return the source's document with the vertices of `mesh`, and the primitives that show them.

    A mesh that several nodes show becomes one for each, because their vertices may now differ. The vertices are written
    in the frame of their node. Where float32 numbers in that frame are too coarse (a flattened node, or a skinned one
    far from the origin), the mesh moves to a new node at the root of the scene, and the old node stays without it.

    Raises:
        ValueError: `mesh` does not have the vertices and faces of the source.
    """
    _check_topology(source, mesh)
    # `old` is the JSON of the source, which is never changed; the copier's draft is the new document.
    old, copier = source.document.gltf, AccessorCopier(source.document)
    vertex_ranges: dict[int, list[VertexRange]] = {node: [] for node in _edited_nodes(source)}
    for span in source.rest.vertex_ranges:
        vertex_ranges[span.node].append(span)
    mesh_of_node = _assign_meshes(old, list(vertex_ranges))
    edited = set(mesh_of_node.values())
    # Meshes of edited nodes are filled in below; all others are copied.
    meshes = [{} if index in edited else _copy_mesh(copier, entry) for index, entry in enumerate(old["meshes"])]
    meshes += [{} for index in edited if index >= len(meshes)]
    copier.draft.gltf["meshes"] = meshes
    rotations = _surface_rotations(source, mesh, mesh_of_node)
    edit = EditContext(source.document, source.rest, with_normals(mesh), rotations, copier, keep_targets)
    groups = []
    for node, mesh_index in mesh_of_node.items():
        T_world_local = _choose_transform(edit, node, vertex_ranges[node])
        new_node = _attach_mesh(edit, node, mesh_index, T_world_local)
        primitives, node_groups = edit_primitives(edit, node, vertex_ranges[node], T_world_local)
        meshes[mesh_index] = _replace_primitives(old["meshes"][old["nodes"][node]["mesh"]], primitives, keep_targets)
        groups += [dataclasses.replace(group, node=new_node) for group in node_groups]
    _drop_skins_and_animations(copier)
    return copier.draft, groups


def with_normals(mesh: Mesh) -> Mesh:
    """Add smooth corner normals to a mesh that has faces but no normals; vertices at one position share a normal."""
    if mesh.corner_normals is not None or not len(mesh.faces):
        return mesh
    merged, index = weld(mesh.vertices)
    faces = index[mesh.faces]
    return dataclasses.replace(mesh, corner_normals=vertex_normals(merged, faces)[faces])


def _check_topology(source: GltfSource, mesh: Mesh) -> None:
    """Raise a ValueError where a mesh does not have as many vertices and faces as its source."""
    faces = max((stop for _, stop in source.rest.faces.values()), default=0)
    if len(mesh.vertices) != len(source.vertices) or len(mesh.faces) != faces:
        raise ValueError(
            f"mesh must have the {len(source.vertices)} vertices and {faces} faces of its source, got "
            f"{len(mesh.vertices)} and {len(mesh.faces)}; set its source to None to write it as a file of its own"
        )


def _edited_nodes(source: GltfSource) -> list[int]:
    """List the nodes, in scene order, that show vertices of the Mesh, or whose mesh would move without its skin."""
    nodes, shown = source.document.gltf.get("nodes", []), {span.node for span in source.rest.vertex_ranges}
    return [n for n in scene_nodes(source.document) if n in shown or ("mesh" in nodes[n] and "skin" in nodes[n])]


def _assign_meshes(gltf: dict[str, Any], edited: list[int]) -> dict[int, int]:
    """Assign each edited node a mesh of its own, by index in the new document.

    The first edited node of a mesh keeps its index, unless an unedited node shows that mesh too; others get new ones.
    """
    edited_nodes = set(edited)
    taken = {node.get("mesh") for index, node in enumerate(gltf["nodes"]) if index not in edited_nodes}
    mesh_of_node: dict[int, int] = {}
    free = len(gltf["meshes"])
    for node in edited:
        mesh = gltf["nodes"][node]["mesh"]
        mesh_of_node[node], free = (free, free + 1) if mesh in taken else (mesh, free)
        taken.add(mesh)
    return mesh_of_node


def _surface_rotations(source: GltfSource, mesh: Mesh, mesh_of_node: dict[int, int]) -> Float[np.ndarray, "M 3 3"]:
    """Return the surface rotation at each vertex since rest, or one identity where no primitive needs rotations."""
    gltf = source.document.gltf
    primitives = [p for node in mesh_of_node for p in gltf["meshes"][gltf["nodes"][node]["mesh"]]["primitives"]]
    if not any(needs_rotations(primitive) for primitive in primitives):
        return np.eye(3)[None]
    return surface_rotations(source.vertices, mesh.vertices, mesh.faces)


def _choose_transform(edit: EditContext, node: int, vertex_ranges: list[VertexRange]) -> Float[np.ndarray, "4 4"]:
    """Choose the world transform of the node that shows the new mesh: the old one if float32 allows, else the root's.

    A mirroring node is replaced by a mirroring one, because a negative determinant reverses the winding order (glTF
    2.0, 3.7.4 Instantiation).
    """
    T_world_node = edit.rest.T_world_node[node]
    root = np.diag([-1.0 if np.linalg.det(T_world_node) < 0 else 1.0, 1.0, 1.0, 1.0])
    # Far from the origin float32 is coarse at the root too: then the node may be up to twice as coarse.
    points = np.concatenate([np.zeros((0, 3))] + [edit.mesh.vertices[span.start : span.stop] for span in vertex_ranges])
    allowed = max(LOCAL_TOLERANCE * np.ptp(edit.mesh.vertices, axis=0).max(), 2 * _storage_error(root, points))
    return T_world_node if _storage_error(T_world_node, points) <= allowed else root


def _storage_error(T_world_local: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "N 3"]) -> float:
    """Return the largest world-space error of points stored as float32 in a frame; infinite for a singular frame."""
    linear, origin = T_world_local[:3, :3], T_world_local[:3, 3]
    if not np.linalg.cond(linear) < MAX_CONDITION:
        return np.inf
    with np.errstate(over="ignore", invalid="ignore"):  # float32 may overflow; the error is then infinite
        stored = ((points - origin) @ np.linalg.inv(linear).T).astype(np.float32).astype(np.float64)
        error = np.abs(stored @ linear.T + origin - points).max(initial=0.0)
    return float(error) if np.isfinite(error) else np.inf


def _attach_mesh(edit: EditContext, node: int, mesh_index: int, T_world_local: Float[np.ndarray, "4 4"]) -> int:
    """Show a mesh at `T_world_local`: by the node itself, or by a new node at the root. Returns the node's index."""
    gltf = edit.copier.draft.gltf
    entry = gltf["nodes"][node]
    entry.pop("skin", None)
    shown = {"mesh": mesh_index} | ({"weights": entry["weights"]} if "weights" in entry and edit.keep_targets else {})
    for key in ("mesh", "weights"):
        entry.pop(key, None)
    if np.array_equal(T_world_local, edit.rest.T_world_node[node]):
        entry |= shown
        return node
    # The old node keeps its name, children and extensions; the new one gets the name, and a mirroring scale if needed.
    scale = {"scale": np.diag(T_world_local)[:3].tolist()} if T_world_local[0, 0] < 0 else {}
    gltf["nodes"].append({**{key: entry[key] for key in ("name",) if key in entry}, **scale, **shown})
    if gltf.get("scenes"):
        gltf["scenes"][gltf.get("scene", 0)].setdefault("nodes", []).append(len(gltf["nodes"]) - 1)
    return len(gltf["nodes"]) - 1


def _copy_mesh(copier: AccessorCopier, mesh: dict[str, Any]) -> dict[str, Any]:
    """Copy a mesh with the accessors of its primitives into the draft."""
    return {**mesh, "primitives": [copy_primitive(copier, primitive) for primitive in mesh["primitives"]]}


def _replace_primitives(mesh: dict[str, Any], primitives: list[dict[str, Any]], keep_targets: bool) -> dict[str, Any]:
    """Return a mesh with other primitives; without morph targets, their weights and names are dropped too."""
    mesh = {**mesh, "primitives": primitives}
    if keep_targets:
        return mesh
    mesh.pop("weights", None)
    if isinstance(mesh.get("extras"), dict):
        mesh["extras"] = {key: value for key, value in mesh["extras"].items() if key != "targetNames"}
    return mesh


def _drop_skins_and_animations(copier: AccessorCopier) -> None:
    """Remove all animations, and all skins unless a node outside the scene still uses one."""
    gltf = copier.draft.gltf
    gltf.pop("animations", None)
    gltf |= without_extensions(gltf, [ANIMATION_POINTER])
    if any("skin" in node for node in gltf["nodes"]):
        for skin in gltf["skins"]:
            if "inverseBindMatrices" in skin:
                skin["inverseBindMatrices"] = copier.copy_accessor(skin["inverseBindMatrices"], None)
    else:
        gltf.pop("skins", None)
