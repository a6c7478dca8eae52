"""Builds a glTF document for a Mesh; for one without a glTF source: one node, one primitive for each part."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.geometry import distinct_rows
from ...core.mesh import Material, Mesh, Part
from ..usd import stage_axes
from .check import ARRAY_BUFFER
from .document import image_type
from .draft import Draft
from .edit import GltfSource, PrimitiveGroup, edit_document
from .read import DEFAULT_MATERIAL, POINTS

WHITE_MATERIAL = Material("default", (1.0, 1.0, 1.0, 1.0))
"""Written instead of DEFAULT_MATERIAL where vertices have colours, which the base colour multiplies: it is white."""


def build_document(mesh: Mesh, moved: Mesh, skinned: bool = False) -> tuple[Draft, list[PrimitiveGroup]]:
    """Build a document that shows `moved`, and describe its primitives; of a mesh with a glTF source edit that file.

    Vertices are split where the uv or the normal of `mesh` changes: glTF has one set of attributes for each vertex.
    `moved` is `mesh` with other vertices (or itself); both have corner normals. Within a part the vertices keep their
    order, so a part without seams keeps its numbering. Vertices that no face uses are written with the first part; a
    mesh without faces becomes POINTS.
    """
    if isinstance(mesh.source, GltfSource):
        return edit_document(mesh.source, moved, skinned)
    draft = Draft({"asset": {"version": "2.0", "generator": "mimesh"}, "scene": 0, "scenes": [{"nodes": [0]}]})
    primitives, groups = [], []
    materials: dict[Material, int] = {}
    default = DEFAULT_MATERIAL if mesh.vertex_colors is None else WHITE_MATERIAL
    for part, vertex_of, corner_of, indices in _split_parts(mesh):
        primitive = _add_primitive(draft, moved, vertex_of, corner_of)
        if len(indices):
            primitive["indices"] = draft.add_indices(indices)
            primitive["material"] = materials.setdefault(part.material or default, len(materials))
        primitives.append(primitive)
        groups.append(
            PrimitiveGroup(0, [primitive], vertex_of, corner_of, np.eye(4), "NORMAL" in primitive["attributes"])
        )
    draft.gltf["nodes"] = [{"name": mesh.name, "mesh": 0, **stage_transform(mesh)}]
    draft.gltf["meshes"] = [{"name": mesh.name, "primitives": primitives}]
    _add_materials(draft, list(materials), textured=mesh.corner_uv is not None)
    return draft, groups


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
