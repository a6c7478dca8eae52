"""Rewrites the primitives of one node for new vertices: new positions, normals, tangents; everything else is copied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.mesh import Mesh
from .deformed_attributes import DeformedVertices, deformed_attributes
from .document import Document
from .draft import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, AccessorCopier
from .read import RestScene, VertexRange, get_primitive, read_rest_normals, read_rest_positions
from .scene import read_morph_weights, vertex_matrices

SKINNING = ("JOINTS_", "WEIGHTS_")
"""First characters of the names of skinning attributes."""


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
class EditContext:
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


def edit_primitives(
    edit: EditContext, node: int, vertex_ranges: list[VertexRange], T_world_local: Float[np.ndarray, "4 4"]
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
            vertex_of, entries = np.arange(span.start, span.stop), [new[p] for p in members]
            groups.append(PrimitiveGroup(node, entries, vertex_of, corner_of, T_world_local, "NORMAL" in attributes))
    for p in range(len(old)):
        if p not in new:
            new[p] = _rewrite_in_place(edit, node, p, T_world_local)
    return [new[p] for p in range(len(old))], groups


def copy_primitive(copier: AccessorCopier, primitive: dict[str, Any]) -> dict[str, Any]:
    """Copy a primitive and its accessors into the draft, unchanged."""
    targets = [
        {name: copier.copy_accessor(index) for name, index in target.items()} for target in primitive.get("targets", [])
    ]
    attributes = {name: copier.copy_accessor(index) for name, index in primitive["attributes"].items()}
    return _assemble(copier, primitive, attributes, targets)


def _rewrite_in_place(
    edit: EditContext, node: int, index: int, T_world_local: Float[np.ndarray, "4 4"]
) -> dict[str, Any]:
    """Rewrite a primitive so that its world positions stay, although skin, node or morph targets are removed."""
    primitive, T_world_node = get_primitive(edit.document, (node, index)), edit.rest.T_world_node
    # New positions are needed where the skin or another node moves the primitive, or its morph weights are dropped.
    moved = "skin" in edit.document.gltf["nodes"][node] or (T_world_local != T_world_node[node]).any()
    if "POSITION" not in primitive["attributes"] or not (moved or (primitive.get("targets") and not edit.keep_targets)):
        return copy_primitive(edit.copier, primitive)
    positions = read_rest_positions(edit.document, node, index, T_world_node)
    deformed = DeformedVertices(positions, read_rest_normals(edit.document, node, index, T_world_node), np.eye(3)[None])
    return _replace_attributes(
        edit.copier, primitive, *_add_attributes(edit, node, primitive, T_world_local, deformed, None)
    )


def _group_by_attributes(primitives: list[dict[str, Any]], members: tuple[int, ...]) -> list[list[int]]:
    """Group primitives of one vertex range by their normals, tangents and morph targets, which they then share."""
    groups: dict[str, list[int]] = {}
    for index in members:
        attributes = primitives[index]["attributes"]
        key = repr((attributes.get("NORMAL"), attributes.get("TANGENT"), primitives[index].get("targets")))
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _corner_of_elements(edit: EditContext, span: VertexRange, members: list[int]) -> Int[np.ndarray, " N"]:
    """Find a corner of the Mesh at each vertex of a range, in the faces of some primitives; -1 where there is none."""
    corner_of = np.full(span.stop - span.start, -1)
    for primitive in members:
        start, stop = edit.rest.faces.get((span.node, primitive), (0, 0))
        corner_of[edit.mesh.faces[start:stop].ravel() - span.start] = np.arange(3 * start, 3 * stop)
    return corner_of


def _deformed_vertices(
    edit: EditContext, span: VertexRange, primitive: int, corner_of: Int[np.ndarray, " N"]
) -> DeformedVertices:
    """Return the new vertices of a range; elements that no face uses keep the normals they had at rest."""
    normals = read_rest_normals(edit.document, span.node, primitive, edit.rest.T_world_node)
    if normals is not None and edit.mesh.corner_normals is not None:
        used = corner_of >= 0
        normals[used] = edit.mesh.corner_normals.reshape(-1, 3)[corner_of[used]]
    rotations = edit.rotations if len(edit.rotations) == 1 else edit.rotations[span.start : span.stop]
    return DeformedVertices(edit.mesh.vertices[span.start : span.stop], normals, rotations)


def _add_attributes(
    edit: EditContext,
    node: int,
    primitive: dict[str, Any],
    T_world_local: Float[np.ndarray, "4 4"],
    deformed: DeformedVertices,
    positions: int | None,
) -> tuple[dict[str, int], list[dict[str, int]]]:
    """Add accessors for a primitive's new attributes and morph targets; returns their indices by attribute name.

    `positions` is the POSITION accessor where another primitive of the range has added it.
    """
    matrices = vertex_matrices(edit.document, node, primitive, edit.rest.T_world_node)
    weights = read_morph_weights(edit.document, node)
    base, deltas = deformed_attributes(
        edit.document, primitive, matrices, weights, T_world_local, deformed, edit.keep_targets
    )
    draft = edit.copier.draft
    attributes = {} if positions is None else {"POSITION": positions}
    for name, values in base.items():
        if name not in attributes:
            attributes[name] = draft.add_floats(values, ARRAY_BUFFER, bounds=name == "POSITION")
    # Attributes of a target that are not recomputed (texture coordinates, colours) are copied.
    targets = []
    for old, new in zip(primitive.get("targets", []) if edit.keep_targets else [], deltas, strict=True):
        added = {
            name: draft.add_floats(values, ARRAY_BUFFER, bounds=name == "POSITION") for name, values in new.items()
        }
        targets.append(
            {name: added[name] if name in added else edit.copier.copy_accessor(index) for name, index in old.items()}
        )
    return attributes, targets


def _replace_attributes(
    copier: AccessorCopier, primitive: dict[str, Any], attributes: dict[str, int], targets: list[dict[str, int]]
) -> dict[str, Any]:
    """Return the JSON of a primitive with new attributes and targets; other attributes are copied, skinning is not."""
    kept = {name: index for name, index in primitive["attributes"].items() if not name.startswith(SKINNING)}
    merged = {
        name: attributes[name] if name in attributes else copier.copy_accessor(index) for name, index in kept.items()
    }
    return _assemble(copier, primitive, merged, targets)


def _assemble(
    copier: AccessorCopier, primitive: dict[str, Any], attributes: dict[str, int], targets: list[dict[str, int]]
) -> dict[str, Any]:
    """Return the JSON of a primitive with new attributes and targets, and with its indices copied into the draft."""
    entry = {**primitive, "attributes": attributes}
    if "indices" in primitive:
        entry["indices"] = copier.copy_accessor(primitive["indices"], ELEMENT_ARRAY_BUFFER)
    entry.pop("targets", None)
    return {**entry, "targets": targets} if targets else entry
