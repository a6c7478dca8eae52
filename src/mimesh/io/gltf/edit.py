"""Builds a glTF document for a Mesh: that of its file with other vertices, or a new one of a primitive for each part.

Kept: nodes, names, materials, textures, images, samplers, UV sets, colours, extras, extensions, cameras, lights,
primitives, index accessors, vertex order and count. Changed: positions and normals of what the scene shows. Dropped:
skins, JOINTS/WEIGHTS, morph targets, animations, and tangents, which readers compute where there are none (glTF 2.0,
3.7.2.1). The new positions are final: a skin would pose them once more, and an animation would move them away.

From the file down to its numbers: `edit_document` gives each node a mesh of its own, `_edit_primitives` the primitives
of a mesh, `_add_attributes` the attributes of a primitive.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float, Int

from ...core.geometry import distinct_rows, unit_vectors, vertex_normals, weld
from ...core.mesh import Material, Mesh, Part
from ..mtl import image_type
from ..usd import stage_axes
from .animation import animation_names, document_details, fbx_facts
from .check import ANIMATION_POINTER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER
from .document import Document, uri_file_name, without_extensions
from .draft import AccessorCopier, Draft
from .read import (
    DEFAULT_MATERIAL,
    POINTS,
    TRIANGLES,
    RestScene,
    VertexRange,
    get_primitive,
    read_rest_normals,
    read_rest_positions,
)
from .scene import scene_nodes

LOCAL_TOLERANCE = 1e-6
"""Largest allowed rounding error of positions stored as float32 in a node's frame, relative to the mesh's extent."""
MAX_CONDITION = 1e12
"""Condition number of a node's matrix from which on it counts as singular."""
DROPPED = ("JOINTS_", "WEIGHTS_", "TANGENT")
"""First characters of the names of attributes that what has moved does not keep."""


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


@dataclass(frozen=True, eq=False)
class PrimitiveGroup:
    """Primitives of a draft with the same N elements (vertices in the file), and the vertices of the Mesh they show."""

    node: int
    """Node that shows them."""
    primitives: list[dict[str, Any]]
    """Their JSON in the draft."""
    vertex_of: Int[np.ndarray, " N"]
    """Mesh vertex of each element."""
    corner_of: Int[np.ndarray, " N"]
    """A corner (3 * face + k) of the Mesh at each element, whose normal it has; -1 where no face uses it."""
    T_world_local: Float[np.ndarray, "4 4"]
    """World transform of the node."""
    has_normals: bool


@dataclass(frozen=True, eq=False)
class _Edit:
    """Source, new mesh and options of one rewriting of a document."""

    document: Document
    rest: RestScene
    mesh: Mesh
    """The new vertices, with corner normals if any primitive of the file has normals."""
    copier: AccessorCopier
    skinned: bool
    """Whether the mesh gets a skin, with which its node moves nothing."""


def edit_document(source: GltfSource, mesh: Mesh, skinned: bool = False) -> tuple[Draft, list[PrimitiveGroup]]:
    """Return the source's document with the vertices of `mesh`, and the primitives that show them.

    A mesh that several nodes show becomes one for each, because their vertices may now differ. The vertices are written
    in the frame of their node. Where float32 numbers in that frame are too coarse (a flattened node, or a skinned one
    far from the origin), the mesh moves to a new node at the root of the scene, and the old node stays without it. So
    do meshes that get a skin from nodes that mirror them: what a skin moves is not mirrored by its node.

    Raises:
        ValueError: `mesh` does not have the vertices and faces of the source.
    """
    faces = max((stop for _, stop in source.rest.faces.values()), default=0)
    if len(mesh.vertices) != len(source.vertices) or len(mesh.faces) != faces:
        raise ValueError(
            f"mesh must have the {len(source.vertices)} vertices and {faces} faces of its source, got "
            f"{len(mesh.vertices)} and {len(mesh.faces)}; set its source to None to write it as a file of its own"
        )
    # `old` is the JSON of the source, which is never changed; the copier's draft is the new document.
    old, copier = source.document.gltf, AccessorCopier(source.document)
    nodes, shown = old.get("nodes", []), {span.node for span in source.rest.vertex_ranges}
    # Besides those that show vertices of the Mesh, nodes whose mesh would move without its skin.
    edited_nodes = [
        n for n in scene_nodes(source.document) if n in shown or ("mesh" in nodes[n] and "skin" in nodes[n])
    ]
    vertex_ranges: dict[int, list[VertexRange]] = {node: [] for node in edited_nodes}
    for span in source.rest.vertex_ranges:
        vertex_ranges[span.node].append(span)
    mesh_of_node = _assign_meshes(old, list(vertex_ranges))
    edited = set(mesh_of_node.values())
    # Meshes of edited nodes, the last ones of which are new, are filled in below.
    meshes: list[dict[str, Any]] = [{} for _ in range(max(len(old["meshes"]), 1 + max(edited, default=-1)))]
    for index, entry in enumerate(old["meshes"]):
        if index not in edited:
            meshes[index] = {**entry, "primitives": [_copy_primitive(copier, p) for p in entry["primitives"]]}
    copier.draft.gltf["meshes"] = meshes
    edit = _Edit(source.document, source.rest, with_normals(mesh), copier, skinned)
    groups = []
    for node, mesh_index in mesh_of_node.items():
        T_world_local = _choose_transform(edit, node, vertex_ranges[node])
        new_node = _attach_mesh(edit, node, mesh_index, T_world_local)
        primitives, node_groups = _edit_primitives(edit, node, vertex_ranges[node], T_world_local)
        # Without the weights and names of its morph targets.
        entry = {key: value for key, value in old["meshes"][nodes[node]["mesh"]].items() if key != "weights"}
        if isinstance(entry.get("extras"), dict):
            entry["extras"] = {key: value for key, value in entry["extras"].items() if key != "targetNames"}
        meshes[mesh_index] = entry | {"primitives": primitives}
        groups += [dataclasses.replace(group, node=new_node) for group in node_groups]
    gltf = copier.draft.gltf
    gltf.pop("animations", None)
    gltf |= without_extensions(gltf, [ANIMATION_POINTER])
    if any("skin" in node for node in gltf["nodes"]):  # outside the scene
        for skin in gltf["skins"]:
            if "inverseBindMatrices" in skin:
                skin["inverseBindMatrices"] = copier.copy_accessor(skin["inverseBindMatrices"], None)
    else:
        gltf.pop("skins", None)
    return copier.draft, groups


def with_normals(mesh: Mesh) -> Mesh:
    """Add smooth corner normals to a mesh that has faces but no normals; vertices at one position share a normal."""
    if mesh.corner_normals is not None or not len(mesh.faces):
        return mesh
    merged, index = weld(mesh.vertices)
    faces = index[mesh.faces]
    return dataclasses.replace(mesh, corner_normals=vertex_normals(merged, faces)[faces])


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


def _choose_transform(edit: _Edit, node: int, vertex_ranges: list[VertexRange]) -> Float[np.ndarray, "4 4"]:
    """Choose the world transform of the node that shows the new mesh: the old one if float32 allows, else the root's.

    A mirroring node is replaced by a mirroring one, because a negative determinant reverses the winding order (glTF
    2.0, 3.7.4 Instantiation); with a skin the order of corners is reversed instead (`_outward`).
    """
    T_world_node = edit.rest.T_world_node[node]
    mirrored = np.linalg.det(T_world_node) < 0
    if mirrored and edit.skinned:
        return np.eye(4)
    root = np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0, 1.0])
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


def _attach_mesh(edit: _Edit, node: int, mesh_index: int, T_world_local: Float[np.ndarray, "4 4"]) -> int:
    """Show a mesh at `T_world_local`: by the node itself, or by a new node at the root. Returns the node's index."""
    gltf = edit.copier.draft.gltf
    entry = gltf["nodes"][node]
    for key in ("skin", "mesh", "weights"):
        entry.pop(key, None)
    if np.array_equal(T_world_local, edit.rest.T_world_node[node]):
        entry["mesh"] = mesh_index
        return node
    # The old node keeps its name, children and extensions; the new one gets the name, and a mirroring scale if needed.
    scale = {"scale": np.diag(T_world_local)[:3].tolist()} if T_world_local[0, 0] < 0 else {}
    gltf["nodes"].append({**{key: entry[key] for key in ("name",) if key in entry}, **scale, "mesh": mesh_index})
    if gltf.get("scenes"):
        gltf["scenes"][gltf.get("scene", 0)].setdefault("nodes", []).append(len(gltf["nodes"]) - 1)
    return len(gltf["nodes"]) - 1


def _edit_primitives(
    edit: _Edit, node: int, vertex_ranges: list[VertexRange], T_world_local: Float[np.ndarray, "4 4"]
) -> tuple[list[dict[str, Any]], list[PrimitiveGroup]]:
    """Rewrite the primitives of `node` without skinning; returns them, and the groups of those that show the Mesh.

    Those of `vertex_ranges` get the vertices of the new mesh. Others (lines, points) keep their world positions, and
    are copied unchanged where these need no new accessors.
    """
    old = edit.document.gltf["meshes"][edit.document.gltf["nodes"][node]["mesh"]]["primitives"]
    new: dict[int, dict[str, Any]] = {}
    groups = []
    for span in vertex_ranges:
        points, shared = edit.mesh.vertices[span.start : span.stop], {}  # positions are shared by the whole range
        with_one_normal: dict[int | None, list[int]] = {}
        for p in span.primitives:
            with_one_normal.setdefault(old[p]["attributes"].get("NORMAL"), []).append(p)
        for members in with_one_normal.values():
            corner_of = np.full(len(points), -1)  # of each vertex of the range, in the faces of these primitives
            for p in members:
                start, stop = edit.rest.faces.get((node, p), (0, 0))
                corner_of[edit.mesh.faces[start:stop].ravel() - span.start] = np.arange(3 * start, 3 * stop)
            # New world normals, those at rest where no face uses one.
            normals = read_rest_normals(edit.document, span.node, members[0], edit.rest.T_world_node)
            if normals is not None and edit.mesh.corner_normals is not None:
                used = corner_of >= 0
                normals[used] = edit.mesh.corner_normals.reshape(-1, 3)[corner_of[used]]
            attributes = shared | _add_attributes(edit, T_world_local, None if shared else points, normals)
            shared = {"POSITION": attributes["POSITION"]}
            new |= {p: _replace_attributes(edit.copier, old[p], attributes) for p in members}
            if np.linalg.det(T_world_local) * np.linalg.det(edit.rest.T_world_node[node]) < 0:
                new |= {p: _outward(edit, span, p, new[p]) for p in members}
            vertex_of, entries = np.arange(span.start, span.stop), [new[p] for p in members]
            groups.append(PrimitiveGroup(node, entries, vertex_of, corner_of, T_world_local, "NORMAL" in attributes))
    for p in range(len(old)):
        if p not in new:
            new[p] = _rewrite_in_place(edit, node, p, T_world_local)
    return [new[p] for p in range(len(old))], groups


def _outward(edit: _Edit, span: VertexRange, index: int, primitive: dict[str, Any]) -> dict[str, Any]:
    """Write a primitive that its node no longer mirrors with the triangles of the Mesh, which face outwards."""
    if (span.node, index) not in edit.rest.faces:  # lines and points
        return primitive
    start, stop = edit.rest.faces[span.node, index]
    indices = edit.copier.draft.add_indices((edit.mesh.faces[start:stop] - span.start).ravel())
    return {**primitive, "indices": indices, "mode": TRIANGLES}


def _rewrite_in_place(edit: _Edit, node: int, index: int, T_world_local: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    """Rewrite a primitive so that its world positions stay, although skin, node or morph targets are removed."""
    primitive, T_world_node = get_primitive(edit.document, (node, index)), edit.rest.T_world_node
    moved = "skin" in edit.document.gltf["nodes"][node] or (T_world_local != T_world_node[node]).any()
    if "POSITION" not in primitive["attributes"] or not (moved or primitive.get("targets")):
        return _copy_primitive(edit.copier, primitive)
    points = read_rest_positions(edit.document, node, index, T_world_node)
    normals = read_rest_normals(edit.document, node, index, T_world_node)
    return _replace_attributes(edit.copier, primitive, _add_attributes(edit, T_world_local, points, normals))


def _add_attributes(
    edit: _Edit,
    T_world_local: Float[np.ndarray, "4 4"],
    points: Float[np.ndarray, "N 3"] | None,
    normals: Float[np.ndarray, "N 3"] | None,
) -> dict[str, int]:
    """Add accessors, in a node's frame, of world positions and normals, if there are any; returns their indices."""
    draft, linear, attributes = edit.copier.draft, T_world_local[:3, :3], {}
    if points is not None:
        local = (points - T_world_local[:3, 3]) @ np.linalg.inv(linear).T
        attributes["POSITION"] = draft.add_floats(local, ARRAY_BUFFER, bounds=True)
    if normals is not None:
        # Normals transform by inverse transposes: from the world to the node's frame that is the transpose of `linear`.
        attributes["NORMAL"] = draft.add_floats(unit_vectors(normals @ linear), ARRAY_BUFFER)
    return attributes


def _copy_primitive(copier: AccessorCopier, primitive: dict[str, Any]) -> dict[str, Any]:
    copied = _replace_attributes(copier, primitive, {}, dropped=())
    owners = primitive.get("targets", [])
    targets = [{name: copier.copy_accessor(index) for name, index in owner.items()} for owner in owners]
    return copied | ({"targets": targets} if targets else {})


def _replace_attributes(
    copier: AccessorCopier, primitive: dict[str, Any], new: dict[str, int], dropped: tuple[str, ...] = DROPPED
) -> dict[str, Any]:
    """Return the JSON of a primitive with new attributes, copies of those that are kept, and no morph targets."""
    kept = {name: index for name, index in primitive["attributes"].items() if not name.startswith(dropped)}
    copied = {name: new[name] if name in new else copier.copy_accessor(index) for name, index in kept.items()}
    entry = {key: value for key, value in primitive.items() if key != "targets"} | {"attributes": copied}
    if "indices" in primitive:
        entry["indices"] = copier.copy_accessor(primitive["indices"], ELEMENT_ARRAY_BUFFER)
    return entry


WHITE_MATERIAL = Material("default", (1.0, 1.0, 1.0, 1.0))
"""Written instead of DEFAULT_MATERIAL where vertices have colours, which the base colour multiplies: it is white."""


def build_document(mesh: Mesh, moved: Mesh, skinned: bool = False) -> tuple[Draft, list[PrimitiveGroup]]:
    """Build a document that shows `moved`, and describe its primitives; of a mesh with a glTF source edit that file.

    Objects of the mesh (`_objects`) have nodes of their own.

    Vertices are split where the uv or the normal of `mesh` changes: glTF has one set of attributes for each vertex.
    `moved` is `mesh` with other vertices (or itself); both have corner normals. Within a part the vertices keep their
    order, so a part without seams keeps its numbering. Vertices that no face uses are written with the first part; a
    mesh without faces becomes POINTS.
    """
    if isinstance(mesh.source, GltfSource):
        return edit_document(mesh.source, moved, skinned)
    draft = Draft({"asset": {"version": "2.0", "generator": "mimesh"}, "scene": 0})
    objects = _objects(mesh)
    node_of = {part.start: node for node, of in enumerate(objects.values()) for part in of}
    primitives: list[list[dict[str, Any]]] = [[] for _ in objects]
    groups = []
    materials: dict[Material, int] = {}
    default = DEFAULT_MATERIAL if mesh.vertex_colors is None else WHITE_MATERIAL
    for part, vertex_of, corner_of, indices in _split_parts(mesh):
        primitive = _add_primitive(draft, moved, vertex_of, corner_of)
        if len(indices):
            primitive["indices"] = draft.add_indices(indices)
            primitive["material"] = materials.setdefault(part.material or default, len(materials))
        node = node_of.get(part.start, 0)  # what is no part of a mesh is all of it
        primitives[node].append(primitive)
        groups.append(
            PrimitiveGroup(node, [primitive], vertex_of, corner_of, np.eye(4), "NORMAL" in primitive["attributes"])
        )
    draft.gltf["scenes"] = [{"nodes": list(range(len(objects)))}]
    draft.gltf["nodes"] = [{"name": name, "mesh": k, **stage_transform(mesh)} for k, name in enumerate(objects)]
    draft.gltf["meshes"] = [{"name": name, "primitives": of} for name, of in zip(objects, primitives, strict=True)]
    _add_materials(draft, list(materials), textured=mesh.corner_uv is not None)
    return draft, groups


def _objects(mesh: Mesh) -> dict[str, list[Part]]:
    """Return the parts of each object of a mesh by its name: objects of an OBJ file, or groups where there is one.

    All have names, and no vertex is of two of them: groups of one surface, such as its hip and its thigh, are no
    objects. Else the mesh is one.
    """
    parts = [part for part in mesh.parts if part.stop > part.start]
    several = len({part.object for part in parts}) > 1
    objects: dict[str, list[Part]] = {}
    for part in parts:
        objects.setdefault(part.object if several else part.name, []).append(part)
    used = [len(np.unique(np.concatenate([mesh.faces[p.start : p.stop] for p in of]))) for of in objects.values()]
    if len(objects) < 2 or "" in objects or sum(used) > len(np.unique(mesh.faces)):
        return {mesh.name: parts}
    return objects


def stage_transform(mesh: Mesh) -> dict[str, list[float]]:
    """Return the rotation and scale of a node that make a mesh y up and in metres (glTF 2.0, 3.4).

    Only meshes that are known to have other axes, and files with another unit (USD), need them. Vertices stay as they
    are, below the node.
    """
    (axis, angle), unit = stage_axes(mesh)
    sine, cosine = np.sin(np.radians(angle / 2)), np.cos(np.radians(angle / 2))
    quaternion = [sine * (axis == "x"), 0.0, sine * (axis == "z"), cosine]
    rotation = {"rotation": [float(x) for x in quaternion]} if angle else {}
    return rotation | ({"scale": [unit] * 3} if unit != 1 else {})


def _split_parts(mesh: Mesh) -> list[tuple[Part, Int[np.ndarray, " N"], Int[np.ndarray, " N"], Int[np.ndarray, " I"]]]:
    """Split each part that has faces into elements: returns (part, vertex_of, corner_of, triangles of elements).

    `vertex_of` and `corner_of` are the Mesh vertex and one corner (3 * face + k, or -1) of each element.
    """
    loose = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.faces)
    if not len(mesh.faces):
        return [(Part(mesh.name, 0, 0), loose, np.full(len(loose), -1), np.zeros(0, np.int64))]
    result = []
    for part in mesh.parts or (Part(mesh.name, 0, len(mesh.faces)),):
        if part.stop > part.start:
            result.append((part, *_split_corners(mesh, part, loose)))
            loose = loose[:0]  # written once, with the first part
    return result


def _split_corners(mesh: Mesh, part: Part, loose: Int[np.ndarray, " L"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge the corners of a part that agree in vertex, uv and normal into elements, sorted by vertex.

    `loose` vertices, which no face uses, become elements without a corner.
    """
    # Keys of each corner: vertex index, uv, normal. Corners with equal keys are one element.
    corner = np.arange(3 * part.start, 3 * part.stop)
    vertex = mesh.faces.ravel()[corner]
    columns = [vertex]
    for values in (mesh.corner_uv, mesh.corner_normals):
        if values is not None:
            columns += list(values.reshape(3 * len(mesh.faces), -1)[corner].T)
    first, element = distinct_rows(columns)
    vertex_of, corner_of = (
        np.concatenate([vertex[first], loose]),
        np.concatenate([corner[first], np.full(len(loose), -1)]),
    )
    # Elements are sorted by all keys; sort by vertex alone, so that a part without seams keeps its numbering.
    order = np.argsort(vertex_of, kind="stable")
    new_index = np.argsort(order)
    return vertex_of[order], corner_of[order], new_index[element]


def _add_primitive(
    draft: Draft, moved: Mesh, vertex_of: Int[np.ndarray, " N"], corner_of: Int[np.ndarray, " N"]
) -> dict[str, Any]:
    """Add a primitive with positions and colours of all elements, and with normals and uv where there are faces."""
    attributes = {"POSITION": draft.add_floats(moved.vertices[vertex_of], ARRAY_BUFFER, bounds=True)}
    if moved.vertex_colors is not None:
        attributes["COLOR_0"] = draft.add_floats(moved.vertex_colors[vertex_of], ARRAY_BUFFER)
    if not (corner_of >= 0).any():
        return {"attributes": attributes, "mode": POINTS}
    # Elements without a corner are in no triangle; their normal only has to be a valid unit vector.
    if moved.corner_normals is not None:
        normals = _gather_corners(moved.corner_normals, corner_of, [0.0, 1.0, 0.0])
        attributes["NORMAL"] = draft.add_floats(normals, ARRAY_BUFFER)
    if moved.corner_uv is not None:
        # glTF has v down (3.8.3 Images: the origin is the upper left corner), a Mesh has v up.
        u, v = _gather_corners(moved.corner_uv, corner_of, [0.0, 0.0]).T
        attributes["TEXCOORD_0"] = draft.add_floats(np.stack([u, 1.0 - v], axis=1), ARRAY_BUFFER)
    return {"attributes": attributes}


def _gather_corners(
    values: Float[np.ndarray, "F 3 C"], corner_of: Int[np.ndarray, " N"], default: list[float]
) -> Float[np.ndarray, "N C"]:
    """Return the value at the corner of each element; `default` where it has none."""
    return np.where(corner_of[:, None] >= 0, values.reshape(-1, values.shape[2])[corner_of], default)


def _add_materials(draft: Draft, materials: list[Material], textured: bool) -> None:
    """Add rough, non-metallic materials with textures; double sided, as formats without back-face culling show them."""
    textures: dict[bytes, int] = {}
    entries = []
    for material in materials:
        surface: dict[str, Any] = {
            "baseColorFactor": list(material.base_color),
            "metallicFactor": 0.0,
            "roughnessFactor": 0.9,
        }
        if textured and material.texture is not None:
            surface["baseColorTexture"] = {"index": textures.setdefault(material.texture, len(textures))}
        alpha = {"alphaMode": "BLEND"} if material.base_color[3] < 1 else {}
        entries.append({"name": material.name, "pbrMetallicRoughness": surface, "doubleSided": True, **alpha})
    draft.gltf["materials"] = entries
    draft.gltf["textures"] = [{"source": number, "sampler": 0} for number in range(len(textures))]
    draft.gltf["samplers"] = [{"wrapS": 10497, "wrapT": 10497}] if textures else []
    draft.gltf["images"] = [
        {"bufferView": draft.add_view(content), "mimeType": image_type(content) or "image/png"} for content in textures
    ]
