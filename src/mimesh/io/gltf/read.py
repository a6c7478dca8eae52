"""A glTF scene at rest as one Mesh in world coordinates, and the account of which vertex came from where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.geometry import unit_vectors
from ...core.mesh import Material, Mesh, Part
from ..colors import with_alpha
from ..polygons import joined_corners, with_face_normals
from .document import Document, image_type
from .scene import (
    local_matrices,
    normal_matrices,
    read_attribute,
    read_indices,
    read_morph_weights,
    read_morphed_attribute,
    scene_nodes,
    transform_points,
    transform_vectors,
    vertex_matrices,
    world_matrices,
)

POINTS, TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = 0, 4, 5, 6
DEFAULT_MATERIAL = Material("default")
"""Written for parts without a material, and read as none: glTF's own default is a bare metal, which looks black in most
viewers."""
PrimitiveKey = tuple[int, int]
"""A node and the number of one of its mesh's primitives."""


@dataclass(frozen=True)
class VertexRange:
    """Vertices `start:stop` of the Mesh: one POSITION accessor (with one skinning of it) as one node shows it."""

    node: int
    start: int
    stop: int
    primitives: tuple[int, ...]
    """All primitives that draw these vertices, lines and points over the surface included."""


@dataclass(frozen=True, eq=False)
class RestScene:
    """A scene at rest: where each node is, which vertices and faces of the Mesh each primitive has."""

    T_world_node: Float[np.ndarray, "N 4 4"]
    vertex_ranges: tuple[VertexRange, ...]
    faces: dict[PrimitiveKey, tuple[int, int]]


def read_rest(document: Document) -> tuple[Mesh, RestScene]:
    """The default scene's triangles, baked at its rest nodes: node transforms, default morph weights and skins applied.

    Vertices are the distinct (node, POSITION) accessors in scene order, so a mesh shown by two nodes comes twice. A
    scene without any triangles gives the vertices of its POINTS. Lines are not read. The Mesh is not checked.

    Raises:
        InputError: the scene shows no triangles and no points, or an array does not fit what it is used for.
    """
    T_world_node = world_matrices(document, local_matrices(document))
    vertex_ranges = _find_vertex_ranges(document)
    start = {(span.node, primitive): span.start for span in vertex_ranges for primitive in span.primitives}
    shown = [key for key in primitives_in_scene_order(vertex_ranges) if _get_mode(document, key) >= TRIANGLES]
    rows = [_read_faces(document, key) for key in shown]
    rows = [
        row[:, ::-1] if np.linalg.det(T_world_node[key[0]]) < 0 else row for key, row in zip(shown, rows, strict=True)
    ]
    faces = np.concatenate(
        [row + start[key] for key, row in zip(shown, rows, strict=True)] or [np.zeros((0, 3), np.int64)]
    )
    ends = np.cumsum([0] + [len(row) for row in rows]).tolist()
    rest = RestScene(T_world_node, vertex_ranges, {key: (ends[i], ends[i + 1]) for i, key in enumerate(shown)})
    vertices = np.concatenate(
        [read_rest_positions(document, span.node, span.primitives[0], T_world_node) for span in vertex_ranges]
    )
    mesh = Mesh(
        vertices,
        faces,
        name=document.path.stem,
        corner_uv=_read_corner_uv(document, shown, rows),
        corner_normals=_read_corner_normals(document, shown, rows, T_world_node, vertices, faces),
        vertex_colors=_read_vertex_colors(document, vertex_ranges, len(vertices)),
        parts=_read_parts(document, rest),
    )
    return mesh, rest


def read_rest_positions(
    document: Document, node: int, primitive: int, T_world_node: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "V 3"]:
    """The world positions of a primitive's vertices."""
    entry = get_primitive(document, (node, primitive))
    points = read_morphed_attribute(document, entry, "POSITION", read_morph_weights(document, node))
    assert points is not None
    return transform_points(vertex_matrices(document, node, entry, T_world_node), points)


def read_rest_normals(
    document: Document, node: int, primitive: int, T_world_node: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "V 3"] | None:
    """The world normals of a primitive's vertices, or None where it has none; a zero normal stays zero."""
    entry = get_primitive(document, (node, primitive))
    normals = read_morphed_attribute(document, entry, "NORMAL", read_morph_weights(document, node))
    if normals is None:
        return None
    linear = vertex_matrices(document, node, entry, T_world_node)[:, :, :3]
    return unit_vectors(transform_vectors(normal_matrices(linear), normals))


def get_primitive(document: Document, shown: PrimitiveKey) -> dict[str, Any]:
    """The JSON of a primitive that a node shows."""
    node, primitive = shown
    return document.gltf["meshes"][document.gltf["nodes"][node]["mesh"]]["primitives"][primitive]


def primitives_in_scene_order(vertex_ranges: tuple[VertexRange, ...]) -> list[PrimitiveKey]:
    """All primitives of the runs, nodes in scene order and each node's primitives in file order."""
    place = {node: i for i, node in enumerate(dict.fromkeys(span.node for span in vertex_ranges))}
    return sorted(
        ((span.node, p) for span in vertex_ranges for p in span.primitives),
        key=lambda key: (place[key[0]], key[1]),
    )


def _find_vertex_ranges(document: Document) -> tuple[VertexRange, ...]:
    groups: dict[tuple[Any, ...], list[PrimitiveKey]] = {}
    for node in scene_nodes(document):
        mesh = document.gltf["nodes"][node].get("mesh")
        primitives = document.gltf["meshes"][mesh]["primitives"] if mesh is not None else []
        for index, primitive in enumerate(primitives):
            position = primitive["attributes"].get("POSITION")
            if position is not None and document.gltf["accessors"][position]["count"]:
                groups.setdefault((node, *_deformation_key(primitive)), []).append((node, index))
    wanted = [group for group in groups.values() if any(_get_mode(document, key) >= TRIANGLES for key in group)]
    wanted = wanted or [group for group in groups.values() if any(_get_mode(document, key) == POINTS for key in group)]
    if not wanted:
        raise InputError(
            f"{document.path}: expected a scene with triangles, found none "
            f"({len(document.gltf.get('meshes', []))} meshes, {len(document.gltf.get('animations', []))} animations); "
            "give the file that holds the character"
        )
    vertex_ranges, start = [], 0
    for group in wanted:
        count = document.gltf["accessors"][get_primitive(document, group[0])["attributes"]["POSITION"]]["count"]
        vertex_ranges.append(VertexRange(group[0][0], start, start + count, tuple(index for _, index in group)))
        start += count
    return tuple(vertex_ranges)


def _deformation_key(primitive: dict[str, Any]) -> tuple[Any, ...]:
    """All that decides where a primitive's vertices are: two that agree in it share their vertices."""
    attributes = primitive["attributes"]
    skinning = sorted(item for item in attributes.items() if item[0].startswith(("JOINTS_", "WEIGHTS_")))
    return (
        attributes["POSITION"],
        tuple(skinning),
        tuple(target.get("POSITION") for target in primitive.get("targets", [])),
    )


def _get_mode(document: Document, shown: PrimitiveKey) -> int:
    return get_primitive(document, shown).get("mode", TRIANGLES)


def _read_faces(document: Document, shown: PrimitiveKey) -> Int[np.ndarray, "F 3"]:
    """Triangles of a primitive, counted from its first vertex; what strips repeat to turn a corner is left out."""
    indices, mode = read_indices(document, get_primitive(document, shown)), _get_mode(document, shown)
    if mode == TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)  # as in OpenGL, an incomplete triangle is not drawn
    if mode == TRIANGLE_FAN:
        rows = np.stack([indices[1:-1], indices[2:], np.broadcast_to(indices[:1], max(len(indices) - 2, 0))], axis=1)
    else:
        rows = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
        rows[1::2, 1:] = rows[1::2, :0:-1]
    return rows[(rows[:, 0] != rows[:, 1]) & (rows[:, 1] != rows[:, 2]) & (rows[:, 2] != rows[:, 0])]


def _read_corner_normals(
    document: Document,
    shown: list[PrimitiveKey],
    rows: list[np.ndarray],
    T_world_node: Float[np.ndarray, "N 4 4"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
) -> Float[np.ndarray, "F 3 3"] | None:
    """Normals of all corners, or None where no primitive has any; flat ones where one lacks them, as glTF asks."""
    given = [read_rest_normals(document, node, primitive, T_world_node) for node, primitive in shown]
    corners = [None if normals is None else normals[row] for normals, row in zip(given, rows, strict=True)]
    normals = joined_corners(corners, list(map(len, rows)))
    return None if normals is None else with_face_normals(normals, vertices, faces)


def _read_vertex_colors(
    document: Document, vertex_ranges: tuple[VertexRange, ...], count: int
) -> Float[np.ndarray, "V 4"] | None:
    """COLOR_0 of all vertices, white where a primitive has none; None where no primitive has any.

    Of primitives that draw one vertex in several colours the last one counts.
    """
    colors = np.ones((count, 4))
    found = False
    for span in vertex_ranges:
        for number in span.primitives:
            primitive = get_primitive(document, (span.node, number))
            values = read_attribute(document, primitive, "COLOR_0")
            if values is not None:
                drawn = read_indices(document, primitive)
                colors[span.start + drawn] = with_alpha(values)[drawn]
                found = True
    return colors if found else None


def _read_corner_uv(
    document: Document, shown: list[PrimitiveKey], rows: list[np.ndarray]
) -> Float[np.ndarray, "F 3 2"] | None:
    """Texture coordinates of all corners as the base colour uses them, v up; zeros where a primitive lacks them."""
    given = [_read_vertex_uv(document, get_primitive(document, key)) for key in shown]
    return joined_corners(
        [None if uv is None else uv[row] for uv, row in zip(given, rows, strict=True)], list(map(len, rows))
    )


def _read_vertex_uv(document: Document, primitive: dict[str, Any]) -> Float[np.ndarray, "V 2"] | None:
    texture = _get_base_texture(_get_material(document, primitive))
    change = texture.get("extensions", {}).get("KHR_texture_transform", {})
    number = change.get("texCoord", texture.get("texCoord", 0))
    uv = read_attribute(document, primitive, f"TEXCOORD_{number}")
    uv = read_attribute(document, primitive, "TEXCOORD_0") if uv is None else uv
    if uv is None:
        return None
    sine, cosine = np.sin(change.get("rotation", 0.0)), np.cos(change.get("rotation", 0.0))
    turned = (uv * change.get("scale", [1, 1])) @ np.array([[cosine, -sine], [sine, cosine]]) + change.get(
        "offset", [0, 0]
    )
    return np.stack([turned[:, 0], 1.0 - turned[:, 1]], axis=1)


def _read_parts(document: Document, rest: RestScene) -> tuple[Part, ...]:
    materials: dict[int | None, Material | None] = {None: None}
    parts = []
    for shown, (start, stop) in rest.faces.items():
        primitive, node = get_primitive(document, shown), document.gltf["nodes"][shown[0]]
        name = node.get("name") or document.gltf["meshes"][node["mesh"]].get("name") or f"node{shown[0]}"
        index = primitive.get("material")
        if index is not None and index not in materials:
            materials[index] = _read_material(document, index)
        parts.append(Part(name, start, stop, materials[index]))
    return tuple(parts)


def _read_material(document: Document, index: int) -> Material | None:
    entry = document.gltf["materials"][index]
    gloss = entry.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    color = entry.get("pbrMetallicRoughness", {}).get("baseColorFactor") or gloss.get("diffuseFactor") or [1, 1, 1, 1]
    r, g, b, a = (float(value) for value in color)
    material = Material(
        entry.get("name", f"material{index}"), (r, g, b, a), _read_texture(document, _get_base_texture(entry))
    )
    return None if material == DEFAULT_MATERIAL else material


def _get_material(document: Document, primitive: dict[str, Any]) -> dict[str, Any]:
    return document.gltf["materials"][primitive["material"]] if "material" in primitive else {}


def _get_base_texture(material: dict[str, Any]) -> dict[str, Any]:
    gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    return material.get("pbrMetallicRoughness", {}).get("baseColorTexture") or gloss.get("diffuseTexture") or {}


def _read_texture(document: Document, info: dict[str, Any]) -> bytes | None:
    """The PNG or JPEG behind a texture reference; None for other kinds, which Material cannot hold."""
    if "index" not in info:
        return None
    image = document.gltf["textures"][info["index"]].get("source")
    content = None if image is None else document.images[image]
    return content if content and image_type(content) in ("image/png", "image/jpeg") else None
