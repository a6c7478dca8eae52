"""Writes the glTF file that a Mesh was read from again, with other vertices and nothing else changed.

Kept: nodes, names, materials, textures, images, samplers, UV sets, colours, extras, extensions, cameras, lights,
primitives, index accessors, vertex order and count. Changed: positions, normals, tangents and morph targets of what the
scene shows. Dropped: skins, JOINTS/WEIGHTS and animations. The new positions are final: a skin would pose them once
more, and an animation would move them away.

From the file down to its numbers: `edit_document` gives each node a mesh of its own, `_edit_primitives` the primitives
of a mesh, `_deformed_attributes` the attributes of a primitive.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float, Int

from ...core.geometry import face_vectors, unit_vectors, vertex_normals, weld
from ...core.mesh import Mesh
from .animation import animation_names, document_details, fbx_facts
from .check import ANIMATION_POINTER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER
from .document import Document, uri_file_name, without_extensions
from .draft import AccessorCopier, Draft
from .read import TRIANGLES, RestScene, VertexRange, get_primitive, read_rest_normals, read_rest_positions
from .scene import (
    normal_matrices,
    read_morph_delta,
    read_morph_weights,
    read_morphed_attribute,
    scene_nodes,
    transform_vectors,
    vertex_matrices,
)

LOCAL_TOLERANCE = 1e-6
"""Largest allowed rounding error of positions stored as float32 in a node's frame, relative to the mesh's extent."""
MAX_CONDITION = 1e12
"""Condition number of a node's matrix from which on it counts as singular."""
SKINNING = ("JOINTS_", "WEIGHTS_")
"""First characters of the names of skinning attributes."""
AttributeArrays = dict[str, Float[np.ndarray, "V C"]]
"""Values of vertex attributes (or their morph deltas, C = 3) by attribute name."""


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
    rotations: Float[np.ndarray, "M 3 3"]
    """Rotation of the surface since rest at each vertex of the Mesh (M = V), or one for all (M = 1)."""
    copier: AccessorCopier
    keep_targets: bool
    """Whether morph targets of the source are written."""
    skinned: bool
    """Whether the mesh gets a skin, with which its node moves nothing."""


def edit_document(
    source: GltfSource, mesh: Mesh, keep_targets: bool = True, skinned: bool = False
) -> tuple[Draft, list[PrimitiveGroup]]:
    """Return the source's document with the vertices of `mesh`, and the primitives that show them.

    A mesh that several nodes show becomes one for each, because their vertices may now differ. The vertices are written
    in the frame of their node. Where float32 numbers in that frame are too coarse (a flattened node, or a skinned one
    far from the origin), the mesh moves to a new node at the root of the scene, and the old node stays without it. So
    do meshes that get a skin from nodes that mirror them: what a skin moves is not mirrored by its node.

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
    # Meshes of edited nodes, the last ones of which are new, are filled in below.
    meshes: list[dict[str, Any]] = [{} for _ in range(max(len(old["meshes"]), 1 + max(edited, default=-1)))]
    for index, entry in enumerate(old["meshes"]):
        if index not in edited:
            meshes[index] = {**entry, "primitives": [_copy_primitive(copier, p) for p in entry["primitives"]]}
    copier.draft.gltf["meshes"] = meshes
    rotations = _surface_rotations(source, mesh, mesh_of_node)
    edit = _Edit(source.document, source.rest, with_normals(mesh), rotations, copier, keep_targets, skinned)
    groups = []
    for node, mesh_index in mesh_of_node.items():
        T_world_local = _choose_transform(edit, node, vertex_ranges[node])
        new_node = _attach_mesh(edit, node, mesh_index, T_world_local)
        primitives, node_groups = _edit_primitives(edit, node, vertex_ranges[node], T_world_local)
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
    # Tangents and morph targets turn with the surface.
    if not any("TANGENT" in primitive["attributes"] or primitive.get("targets") for primitive in primitives):
        return np.eye(3)[None]
    return _fit_rotations(source.vertices, mesh.vertices, mesh.faces)


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


def _edit_primitives(
    edit: _Edit, node: int, vertex_ranges: list[VertexRange], T_world_local: Float[np.ndarray, "4 4"]
) -> tuple[list[dict[str, Any]], list[PrimitiveGroup]]:
    """Rewrite the primitives of `node` without skinning, for a node with world transform `T_world_local`.

    Those of `vertex_ranges` get the vertices of the new mesh. Others (lines, points) keep their world positions, and
    are copied unchanged where these need no new accessors.

    Returns:
        The JSON of all primitives of the node's mesh, and the groups of those that show the Mesh.
    """
    old = edit.document.gltf["meshes"][edit.document.gltf["nodes"][node]["mesh"]]["primitives"]
    new: dict[int, dict[str, Any]] = {}
    groups = []
    for span in vertex_ranges:
        positions = None  # accessor index, shared by all primitives of the range
        for members in _group_by_attributes(old, span.primitives):
            corner_of = _corner_of_elements(edit, span, members)
            deformed = _deformed_vertices(edit, span, members[0], corner_of)
            attributes, targets = _add_attributes(edit, node, old[members[0]], T_world_local, deformed, positions)
            positions = attributes["POSITION"]
            new |= {p: _replace_attributes(edit.copier, old[p], attributes, targets) for p in members}
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


def _copy_primitive(copier: AccessorCopier, primitive: dict[str, Any]) -> dict[str, Any]:
    """Copy a primitive and its accessors into the draft, unchanged."""
    targets = [_copy_attributes(copier, target, {}) for target in primitive.get("targets", [])]
    return _assemble(copier, primitive, _copy_attributes(copier, primitive["attributes"], {}), targets)


def _rewrite_in_place(edit: _Edit, node: int, index: int, T_world_local: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    """Rewrite a primitive so that its world positions stay, although skin, node or morph targets are removed."""
    primitive, T_world_node = get_primitive(edit.document, (node, index)), edit.rest.T_world_node
    # New positions are needed where the skin or another node moves the primitive, or its morph weights are dropped.
    moved = "skin" in edit.document.gltf["nodes"][node] or (T_world_local != T_world_node[node]).any()
    if "POSITION" not in primitive["attributes"] or not (moved or (primitive.get("targets") and not edit.keep_targets)):
        return _copy_primitive(edit.copier, primitive)
    positions = read_rest_positions(edit.document, node, index, T_world_node)
    deformed = _DeformedVertices(
        positions, read_rest_normals(edit.document, node, index, T_world_node), np.eye(3)[None]
    )
    attributes, targets = _add_attributes(edit, node, primitive, T_world_local, deformed, None)
    return _replace_attributes(edit.copier, primitive, attributes, targets)


def _group_by_attributes(primitives: list[dict[str, Any]], members: tuple[int, ...]) -> list[list[int]]:
    """Group primitives of one vertex range by their normals, tangents and morph targets, which they then share."""
    groups: dict[str, list[int]] = {}
    for index in members:
        attributes = primitives[index]["attributes"]
        key = repr((attributes.get("NORMAL"), attributes.get("TANGENT"), primitives[index].get("targets")))
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _corner_of_elements(edit: _Edit, span: VertexRange, members: list[int]) -> Int[np.ndarray, " N"]:
    """Find a corner of the Mesh at each vertex of a range, in the faces of some primitives; -1 where there is none."""
    corner_of = np.full(span.stop - span.start, -1)
    for primitive in members:
        start, stop = edit.rest.faces.get((span.node, primitive), (0, 0))
        corner_of[edit.mesh.faces[start:stop].ravel() - span.start] = np.arange(3 * start, 3 * stop)
    return corner_of


def _deformed_vertices(
    edit: _Edit, span: VertexRange, primitive: int, corner_of: Int[np.ndarray, " N"]
) -> _DeformedVertices:
    """Return the new vertices of a range; elements that no face uses keep the normals they had at rest."""
    normals = read_rest_normals(edit.document, span.node, primitive, edit.rest.T_world_node)
    if normals is not None and edit.mesh.corner_normals is not None:
        used = corner_of >= 0
        normals[used] = edit.mesh.corner_normals.reshape(-1, 3)[corner_of[used]]
    rotations = edit.rotations if len(edit.rotations) == 1 else edit.rotations[span.start : span.stop]
    return _DeformedVertices(edit.mesh.vertices[span.start : span.stop], normals, rotations)


def _add_attributes(
    edit: _Edit,
    node: int,
    primitive: dict[str, Any],
    T_world_local: Float[np.ndarray, "4 4"],
    deformed: _DeformedVertices,
    positions: int | None,
) -> tuple[dict[str, int], list[dict[str, int]]]:
    """Add accessors for a primitive's new attributes and morph targets; returns their indices by attribute name.

    `positions` is the POSITION accessor where another primitive of the range has added it.
    """
    base, deltas = _deformed_attributes(edit, node, primitive, T_world_local, deformed)

    def add(arrays: AttributeArrays) -> dict[str, int]:
        draft = edit.copier.draft
        return {name: draft.add_floats(row, ARRAY_BUFFER, bounds=name == "POSITION") for name, row in arrays.items()}

    shared = {} if positions is None else {"POSITION": positions}
    attributes = shared | add({name: values for name, values in base.items() if name not in shared})
    # Attributes of a target that are not recomputed (texture coordinates, colours) are copied.
    old_targets = primitive.get("targets", []) if edit.keep_targets else []
    pairs = zip(old_targets, deltas, strict=True)
    return attributes, [_copy_attributes(edit.copier, old, add(new)) for old, new in pairs]


def _copy_attributes(copier: AccessorCopier, attributes: dict[str, int], new: dict[str, int]) -> dict[str, int]:
    """Return new accessors of some attributes, and copies of the others."""
    return {name: new[name] if name in new else copier.copy_accessor(index) for name, index in attributes.items()}


def _replace_attributes(
    copier: AccessorCopier, primitive: dict[str, Any], attributes: dict[str, int], targets: list[dict[str, int]]
) -> dict[str, Any]:
    """Return the JSON of a primitive with new attributes and targets; other attributes are copied, skinning is not."""
    kept = {name: index for name, index in primitive["attributes"].items() if not name.startswith(SKINNING)}
    return _assemble(copier, primitive, _copy_attributes(copier, kept, attributes), targets)


def _assemble(
    copier: AccessorCopier, primitive: dict[str, Any], attributes: dict[str, int], targets: list[dict[str, int]]
) -> dict[str, Any]:
    """Return the JSON of a primitive with new attributes and targets, and with its indices copied into the draft."""
    entry = {**primitive, "attributes": attributes}
    if "indices" in primitive:
        entry["indices"] = copier.copy_accessor(primitive["indices"], ELEMENT_ARRAY_BUFFER)
    entry.pop("targets", None)
    return {**entry, "targets": targets} if targets else entry


@dataclass(frozen=True, eq=False)
class _DeformedVertices:
    """New positions, normals and surface rotations of a primitive's vertices, in world coordinates."""

    positions: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"] | None
    """None where the primitive shall have no normals."""
    rotations: Float[np.ndarray, "M 3 3"]
    """Rotation of the surface since rest at each vertex (M = V), or one for all (M = 1)."""


def _deformed_attributes(
    edit: _Edit,
    node: int,
    primitive: dict[str, Any],
    T_world_local: Float[np.ndarray, "4 4"],
    deformed: _DeformedVertices,
) -> tuple[AttributeArrays, list[AttributeArrays]]:
    """Return POSITION, NORMAL and TANGENT of a primitive, and the deltas of its morph targets, in a node's frame.

    A morph delta is taken to the world by the skin or the node at rest, rotated with the surface and taken to the
    frame of the node that will show the primitive (`T_world_local`). With the morph weights at rest, vertices are then
    exactly at `deformed.positions`. A tangent is rotated with the surface and made perpendicular to its new normal; its
    w (handedness) stays.
    """
    document = edit.document
    matrices = vertex_matrices(document, node, primitive, edit.rest.T_world_node)
    weights = read_morph_weights(document, node)
    linear, inverse = T_world_local[:3, :3], np.linalg.inv(T_world_local[:3, :3])
    vector_matrices = inverse @ deformed.rotations @ matrices[:, :, :3]
    # Normals transform by inverse transposes: from the world to the node's frame that is the transpose of `linear`.
    normals_to_local = linear.T @ deformed.rotations @ normal_matrices(matrices[:, :, :3])
    base: AttributeArrays = {"POSITION": (deformed.positions - T_world_local[:3, 3]) @ inverse.T}
    # Directions are scaled to unit length after the transform, and their deltas by the same factor.
    scale = {"POSITION": np.ones((1, 1))}
    rest_normals = read_morphed_attribute(document, primitive, "NORMAL", weights)
    if rest_normals is not None and deformed.normals is not None:
        base["NORMAL"] = unit_vectors(deformed.normals @ linear)
        scale["NORMAL"] = _inverse_length(transform_vectors(normals_to_local, rest_normals))
    tangents = read_morphed_attribute(document, primitive, "TANGENT", weights)
    if tangents is not None:
        local_tangents = transform_vectors(vector_matrices, tangents[:, :3])
        scale["TANGENT"] = _inverse_length(local_tangents)
        base["TANGENT"] = np.concatenate([_orthogonalize(local_tangents, base.get("NORMAL")), tangents[:, 3:]], axis=1)
    if not edit.keep_targets:
        return base, []
    delta_matrices = {"POSITION": vector_matrices, "NORMAL": normals_to_local, "TANGENT": vector_matrices}
    targets = [
        {
            name: scale[name] * transform_vectors(delta_matrices[name], delta)
            for name in scale
            if (delta := read_morph_delta(document, primitive, number, name)) is not None
        }
        for number in range(len(primitive.get("targets", [])))
    ]
    return _subtract_morphs(base, targets, weights), targets


def _subtract_morphs(base: AttributeArrays, targets: list[AttributeArrays], weights: list[float]) -> AttributeArrays:
    """Return the attributes that become `base` when the weighted targets are added.

    Positions are exact; the sums for normals and tangents are parallel to those of `base`, but not of unit length.
    """
    result = dict(base)
    for name in base if any(weights) else ():
        added = sum(weight * target[name] for weight, target in zip(weights, targets, strict=False) if name in target)
        vectors = base[name][:, :3]
        length = 1.0 if name == "POSITION" else _length_for_unit(vectors, added)
        result[name] = np.concatenate([vectors * length - added, base[name][:, 3:]], axis=1)
    return result


def _length_for_unit(directions: Float[np.ndarray, "V 3"], added: Float[np.ndarray, "V 3"] | int) -> np.ndarray:
    """Solve |s n - d| = 1 for s, with unit `directions` n and `added` d: s n - d then is a unit vector to store."""
    along = (directions * added).sum(-1, keepdims=True)
    square = 1.0 + along**2 - np.square(np.broadcast_to(added, directions.shape)).sum(-1, keepdims=True)
    return along + np.sqrt(np.maximum(square, 0.0))


def _orthogonalize(
    tangents: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "V 3"] | None
) -> Float[np.ndarray, "V 3"]:
    """Return unit tangents, perpendicular to the normals where there are any (Gram-Schmidt)."""
    if normals is None:
        return unit_vectors(tangents)
    return unit_vectors(tangents - normals * (tangents * normals).sum(-1, keepdims=True))


def _inverse_length(vectors: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 1"]:
    """Return 1 / length of each vector, 1 for zero vectors."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return 1.0 / np.where(length > 0, length, 1.0)


def _fit_rotations(
    vertices: Float[np.ndarray, "V 3"], moved: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "V 3 3"]:
    """Fit the rotation of the surface around each vertex from `vertices` to `moved`.

    Kabsch's algorithm on the edges and face normals around the vertex: the local step of as-rigid-as-possible
    deformation (Sorkine and Alexa 2007). Vertices at one rest position get one rotation, so that split seams stay
    closed; a vertex without faces gets the identity.
    """
    _, index = weld(vertices)
    covariance = np.zeros((index.max(initial=-1) + 1, 3, 3))
    welded_faces = index[faces]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        before, after = (points[faces[:, j]] - points[faces[:, i]] for points in (vertices, moved))
        _add_to_rows(covariance, welded_faces[:, [i, j]], after[:, :, None] * before[:, None])
    # The edges around a vertex of a flat surface span two directions; face normals add the third one.
    normals, moved_normals = (_scaled_face_normals(face_vectors(points, faces)) for points in (vertices, moved))
    _add_to_rows(covariance, welded_faces, moved_normals[:, :, None] * normals[:, None])
    u, _, vt = np.linalg.svd(covariance)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]  # a rotation, not a reflection
    rotations = u @ vt
    rotations[~covariance.any(axis=(1, 2))] = np.eye(3)
    return rotations[index]


def _scaled_face_normals(vectors: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Scale face vectors (of length twice the area) to the root of their length, comparable to edge lengths."""
    return vectors * np.sqrt(_inverse_length(vectors))


def _add_to_rows(
    total: Float[np.ndarray, "W 3 3"], rows: Int[np.ndarray, "F K"], values: Float[np.ndarray, "F 3 3"]
) -> None:
    """Add the matrix of each face to all of its K rows of `total`, in place.

    One `np.bincount` for each matrix entry, because `np.add.at` is ten times slower.
    """
    index = rows.ravel()
    for i in range(3):
        for j in range(3):
            spread = np.repeat(values[:, i, j], rows.shape[1])
            total[:, i, j] += np.bincount(index, spread, minlength=len(total))
