"""A glTF document for a Mesh that came from elsewhere: one node, one primitive for each part."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.mesh import Material, Mesh, Part
from ..usd import stage_axes
from .document import image_type
from .draft import ARRAY_BUFFER, Draft
from .primitives import PrimitiveGroup
from .read import DEFAULT_MATERIAL, POINTS

WHITE_MATERIAL = Material("default", (1.0, 1.0, 1.0, 1.0))
"""BARE where vertices have colours, which it multiplies."""


def build_document(mesh: Mesh, moved: Mesh) -> tuple[Draft, list[PrimitiveGroup]]:
    """A document that shows `moved`, with its vertices split where the uv or the normal of `mesh` changes.

    `moved` is `mesh` with other vertices (or itself); both have corner normals. Within a part the vertices keep their
    order, so a part without seams keeps its numbering. Vertices that no face uses come with the first part; a mesh
    without faces becomes POINTS.
    """
    draft = Draft({"asset": {"version": "2.0", "generator": "mimesh"}, "scene": 0, "scenes": [{"nodes": [0]}]})
    primitives, written = [], []
    materials: dict[Material, int] = {}
    bare = DEFAULT_MATERIAL if mesh.vertex_colors is None else WHITE_MATERIAL
    for part, vertex_of, corner_of, indices in _split_parts(mesh):
        primitive = _add_primitive(draft, moved, vertex_of, corner_of)
        if len(indices):
            primitive["indices"] = draft.add_indices(indices)
            primitive["material"] = materials.setdefault(part.material or bare, len(materials))
        primitives.append(primitive)
        written.append(
            PrimitiveGroup(0, [primitive], vertex_of, corner_of, np.eye(4), "NORMAL" in primitive["attributes"])
        )
    draft.gltf["nodes"] = [{"name": mesh.name, "mesh": 0, **stage_transform(mesh)}]
    draft.gltf["meshes"] = [{"name": mesh.name, "primitives": primitives}]
    _add_materials(draft, list(materials), textured=mesh.corner_uv is not None)
    return draft, written


def stage_transform(mesh: Mesh) -> dict[str, list[float]]:
    """The turn and scale of a node that stands a mesh up as glTF wants it: y up, in metres.

    Only files that say other axes and units (USD) need one. Vertices stay as they are, below the node.
    """
    z_up, unit = stage_axes(mesh)
    found = {"rotation": [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]} if z_up else {}
    return found | ({"scale": [unit] * 3} if unit != 1 else {})


def _split_parts(mesh: Mesh) -> list[tuple[Part, Int[np.ndarray, " N"], Int[np.ndarray, " N"], Int[np.ndarray, " I"]]]:
    """For each part that has faces: the Mesh vertex and a corner of each element, and the triangles of elements."""
    loose = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.faces)
    if not len(mesh.faces):
        return [(Part(mesh.name, 0, 0), loose, np.full(len(loose), -1), np.zeros(0, np.int64))]
    result = []
    for part in mesh.parts or (Part(mesh.name, 0, len(mesh.faces)),):
        if part.stop > part.start:
            result.append((part, *_split_corners(mesh, part, loose)))
            loose = loose[:0]
    return result


def _split_corners(mesh: Mesh, part: Part, loose: Int[np.ndarray, " L"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    corner = np.arange(3 * part.start, 3 * part.stop)
    vertex = mesh.faces.ravel()[corner]
    columns = [vertex[:, None].astype(np.float64)]
    columns += [
        values.reshape(3 * len(mesh.faces), -1)[corner]
        for values in (mesh.corner_uv, mesh.corner_normals)
        if values is not None
    ]
    keys = np.concatenate(columns, axis=1)
    _, first, element = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    vertex_of, corner_of = (
        np.concatenate([vertex[first], loose]),
        np.concatenate([corner[first], np.full(len(loose), -1)]),
    )
    order = np.argsort(vertex_of, kind="stable")
    place = np.argsort(order)
    return vertex_of[order], corner_of[order], place[element.reshape(-1)]


def _add_primitive(
    draft: Draft, moved: Mesh, vertex_of: Int[np.ndarray, " N"], corner_of: Int[np.ndarray, " N"]
) -> dict[str, Any]:
    """Positions and colours of all elements; normals and uv too where there are faces."""
    attributes = {"POSITION": draft.add_floats(moved.vertices[vertex_of], ARRAY_BUFFER, bounds=True)}
    if moved.vertex_colors is not None:
        attributes["COLOR_0"] = draft.add_floats(moved.vertex_colors[vertex_of], ARRAY_BUFFER)
    if not (corner_of >= 0).any():
        return {"attributes": attributes, "mode": POINTS}
    if moved.corner_normals is not None:
        normals = _gather_corners(moved.corner_normals, corner_of, [0.0, 1.0, 0.0])
        attributes["NORMAL"] = draft.add_floats(normals, ARRAY_BUFFER)
    if moved.corner_uv is not None:
        u, v = _gather_corners(moved.corner_uv, corner_of, [0.0, 0.0]).T
        attributes["TEXCOORD_0"] = draft.add_floats(np.stack([u, 1.0 - v], axis=1), ARRAY_BUFFER)
    return {"attributes": attributes}


def _gather_corners(
    values: Float[np.ndarray, "F 3 C"], corner_of: Int[np.ndarray, " N"], default: list[float]
) -> Float[np.ndarray, "N C"]:
    return np.where(corner_of[:, None] >= 0, values.reshape(-1, values.shape[2])[corner_of], default)


def _add_materials(draft: Draft, materials: list[Material], textured: bool) -> None:
    """Rough, non-metallic materials, seen from both sides as formats without such a switch show them."""
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
