"""The primitives of one node rewritten for new vertices: new positions and normals, everything else carried over."""

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


@dataclass(frozen=True, eq=False)
class PrimitiveGroup:
    """Primitives of a draft that show vertices of the Mesh: what an animation needs to add its frames to them."""

    node: int
    primitives: list[dict[str, Any]]
    vertex_of: Int[np.ndarray, " N"]
    """The Mesh vertex that each element is."""
    corner_of: Int[np.ndarray, " N"]
    """A corner (3 * face + k) of the Mesh at each element, whose normal it has; -1 where no face uses it."""
    T_world_local: Float[np.ndarray, "4 4"]
    has_normals: bool


@dataclass(frozen=True, eq=False)
class EditContext:
    """One rewriting of a document: what all of its primitives need to know."""

    document: Document
    rest: RestScene
    mesh: Mesh
    """The wanted vertices, with corner normals if any primitive of the file has normals."""
    turns: Float[np.ndarray, "M 3 3"]
    """How the surface turned at each vertex since rest, or one rotation for all."""
    copier: AccessorCopier
    keep_targets: bool


def edit_primitives(
    edit: EditContext, node: int, vertex_ranges: list[VertexRange], T_world_local: Float[np.ndarray, "4 4"]
) -> tuple[list[dict[str, Any]], list[PrimitiveGroup]]:
    """The primitives that `node` shows, without skinning, for a node that stands at `T_world_local`.

    Those of `vertex_ranges` get the wanted vertices. Others (lines, points) stay where they are in the world, and are taken over
    untouched where that needs no change.
    """
    old = edit.document.gltf["meshes"][edit.document.gltf["nodes"][node]["mesh"]]["primitives"]
    new: dict[int, dict[str, Any]] = {}
    written = []
    for span in vertex_ranges:
        positions = None  # shared by all groups of the run
        for group in _group_by_attributes(old, span.primitives):
            corner_of = _corner_of_elements(edit, span, group)
            wanted = _deformed_vertices(edit, span, group[0], corner_of)
            attributes, targets = _add_attributes(edit, node, old[group[0]], T_world_local, wanted, positions)
            positions = attributes["POSITION"]
            new |= {p: _replace_attributes(edit.copier, old[p], attributes, targets) for p in group}
            vertex_of, members = np.arange(span.start, span.stop), [new[p] for p in group]
            written.append(PrimitiveGroup(node, members, vertex_of, corner_of, T_world_local, "NORMAL" in attributes))
    for p in range(len(old)):
        if p not in new:
            new[p] = _rewrite_in_place(edit, node, p, T_world_local)
    return [new[p] for p in range(len(old))], written


def copy_primitive(copier: AccessorCopier, primitive: dict[str, Any]) -> dict[str, Any]:
    """A primitive taken over as it is."""
    targets = [
        {name: copier.copy_accessor(index) for name, index in target.items()} for target in primitive.get("targets", [])
    ]
    attributes = {name: copier.copy_accessor(index) for name, index in primitive["attributes"].items()}
    return _assemble(copier, primitive, attributes, targets)


def _rewrite_in_place(
    edit: EditContext, node: int, index: int, T_world_local: Float[np.ndarray, "4 4"]
) -> dict[str, Any]:
    """A primitive that keeps its place in the world although skin, node or morph targets go."""
    primitive, T_world_node = get_primitive(edit.document, (node, index)), edit.rest.T_world_node
    moved = "skin" in edit.document.gltf["nodes"][node] or (T_world_local != T_world_node[node]).any()
    if "POSITION" not in primitive["attributes"] or not (moved or (primitive.get("targets") and not edit.keep_targets)):
        return copy_primitive(edit.copier, primitive)
    points = read_rest_positions(edit.document, node, index, T_world_node)
    wanted = DeformedVertices(points, read_rest_normals(edit.document, node, index, T_world_node), np.eye(3)[None])
    return _replace_attributes(
        edit.copier, primitive, *_add_attributes(edit, node, primitive, T_world_local, wanted, None)
    )


def _group_by_attributes(primitives: list[dict[str, Any]], members: tuple[int, ...]) -> list[list[int]]:
    """The primitives of a run, those together that share their normals, tangents and morph targets too."""
    groups: dict[str, list[int]] = {}
    for index in members:
        attributes = primitives[index]["attributes"]
        key = repr((attributes.get("NORMAL"), attributes.get("TANGENT"), primitives[index].get("targets")))
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def _corner_of_elements(edit: EditContext, span: VertexRange, group: list[int]) -> Int[np.ndarray, " N"]:
    corner_of = np.full(span.stop - span.start, -1)
    for primitive in group:
        start, stop = edit.rest.faces.get((span.node, primitive), (0, 0))
        corner_of[edit.mesh.faces[start:stop].ravel() - span.start] = np.arange(3 * start, 3 * stop)
    return corner_of


def _deformed_vertices(
    edit: EditContext, span: VertexRange, primitive: int, corner_of: Int[np.ndarray, " N"]
) -> DeformedVertices:
    normals = read_rest_normals(edit.document, span.node, primitive, edit.rest.T_world_node)
    if normals is not None and edit.mesh.corner_normals is not None:
        used = corner_of >= 0
        normals[used] = edit.mesh.corner_normals.reshape(-1, 3)[corner_of[used]]
    turns = edit.turns if len(edit.turns) == 1 else edit.turns[span.start : span.stop]
    return DeformedVertices(edit.mesh.vertices[span.start : span.stop], normals, turns)


def _add_attributes(
    edit: EditContext,
    node: int,
    primitive: dict[str, Any],
    T_world_local: Float[np.ndarray, "4 4"],
    wanted: DeformedVertices,
    positions: int | None,
) -> tuple[dict[str, int], list[dict[str, int]]]:
    """Accessors in the draft of a primitive's new attributes and morph targets; `positions` if it is there already."""
    matrices = vertex_matrices(edit.document, node, primitive, edit.rest.T_world_node)
    weights = read_morph_weights(edit.document, node)
    base, deltas = deformed_attributes(
        edit.document, primitive, matrices, weights, T_world_local, wanted, edit.keep_targets
    )
    draft = edit.copier.draft
    attributes = {} if positions is None else {"POSITION": positions}
    for name, values in base.items():
        if name not in attributes:
            attributes[name] = draft.add_floats(values, ARRAY_BUFFER, bounds=name == "POSITION")
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
    kept = {name: index for name, index in primitive["attributes"].items() if not name.startswith(SKINNING)}
    merged = {
        name: attributes[name] if name in attributes else copier.copy_accessor(index) for name, index in kept.items()
    }
    return _assemble(copier, primitive, merged, targets)


def _assemble(
    copier: AccessorCopier, primitive: dict[str, Any], attributes: dict[str, int], targets: list[dict[str, int]]
) -> dict[str, Any]:
    """The primitive's JSON with new attributes and targets, its indices taken over, all else as it was."""
    entry = {**primitive, "attributes": attributes}
    if "indices" in primitive:
        entry["indices"] = copier.copy_accessor(primitive["indices"], ELEMENT_ARRAY_BUFFER)
    entry.pop("targets", None)
    return {**entry, "targets": targets} if targets else entry
