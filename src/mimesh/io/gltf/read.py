"""Reads a glTF scene at rest as one Mesh in world coordinates, with a record of where each vertex came from.

With the joints of its skins, the scene is a rigged character. Several skins over one set of nodes (a character in
pieces), several sets of influences, and unskinned meshes below a joint become one form: every vertex has K influences,
each with a joint, a weight, and the position to which that joint alone would take the vertex at rest. These positions
contain the inverse bind matrices, node scales (100 is common) and z-up roots: the vertex is their weighted mean, and a
pose moves each of them rigidly with its joint.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...bodies.skinned_character import SkinnedCharacter
from ...core.budgets import VERTICES
from ...core.errors import InputError
from ...core.geometry import unit_vectors
from ...core.mesh import Material, Mesh, Part
from ..colors import with_alpha
from ..mtl import image_type
from ..polygons import joined_corners, with_face_normals
from . import scene
from .document import Document, read_floats

POINTS, TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = 0, 4, 5, 6
"""Values of a primitive's `mode` (glTF 2.0, 5.24 Mesh Primitive); 1 to 3 are lines."""
DEFAULT_MATERIAL = Material("default")
"""Written for parts without a material, and read as no material. The default of glTF 2.0 (3.9.6 Default Material) is a
polished metal, which looks black in most viewers."""
UNSKINNED, UNSKINNED_PARTS = 0.02, 0.1
"""Largest share of vertices without any joint, in parts that have some and in whole parts such as a prop or a floor;
more of them is a damaged skin."""
PrimitiveKey = tuple[int, int]
"""A node and the index of one primitive of its mesh."""


@dataclass(frozen=True)
class VertexRange:
    """Vertices `start:stop` of the Mesh: one POSITION accessor with one skinning of it, shown by one node."""

    node: int
    start: int
    stop: int
    primitives: tuple[int, ...]
    """Indices, in the node's mesh, of all primitives that draw these vertices, lines and points included."""


@dataclass(frozen=True, eq=False)
class RestScene:
    """A scene at rest: the transform of each node, and the vertices and faces of the Mesh that each primitive has."""

    T_world_node: Float[np.ndarray, "N 4 4"]
    """World transform of each node."""
    vertex_ranges: tuple[VertexRange, ...]
    """All vertices of the Mesh, in order."""
    faces: dict[PrimitiveKey, tuple[int, int]]
    """First face of each primitive in the Mesh, and the one after its last."""


def read_rest(document: Document) -> tuple[Mesh, RestScene]:
    """Read the triangles of the default scene, with node transforms, default morph weights and skins applied.

    Vertices are the distinct (node, POSITION) accessors in scene order, so a mesh shown by two nodes comes twice. A
    scene without any triangles gives the vertices of its POINTS. Lines are not read. The Mesh is not checked.

    Raises:
        InputError: the scene shows no triangles and no points, or an array does not fit what it is used for.
    """
    T_world_node = scene.world_matrices(document)
    vertex_ranges = _find_vertex_ranges(document)
    start = {(span.node, primitive): span.start for span in vertex_ranges for primitive in span.primitives}
    # Nodes in scene order, and the primitives of each in file order.
    rank = {node: i for i, node in enumerate(dict.fromkeys(span.node for span in vertex_ranges))}
    keys = sorted(start, key=lambda key: (rank[key[0]], key[1]))
    keys = [key for key in keys if _get_mode(document, key) >= TRIANGLES]
    triangles = [_read_faces(document, key) for key in keys]
    # A negative determinant of the node's global transform reverses the winding order (glTF 2.0, 3.7.4 Instantiation).
    triangles = [
        local_faces[:, ::-1] if np.linalg.det(T_world_node[key[0]]) < 0 else local_faces
        for key, local_faces in zip(keys, triangles, strict=True)
    ]
    faces = np.concatenate(
        [local_faces + start[key] for key, local_faces in zip(keys, triangles, strict=True)]
        or [np.zeros((0, 3), np.int64)]
    )
    # Faces of primitive i are ends[i]:ends[i + 1] of the Mesh.
    ends = np.cumsum([0] + [len(local_faces) for local_faces in triangles]).tolist()
    rest = RestScene(T_world_node, vertex_ranges, {key: (ends[i], ends[i + 1]) for i, key in enumerate(keys)})
    vertices = np.concatenate(
        [read_rest_positions(document, span.node, span.primitives[0], T_world_node) for span in vertex_ranges]
    )
    vertex_normals = [read_rest_normals(document, node, primitive, T_world_node) for node, primitive in keys]
    normals = _corner_values(vertex_normals, triangles)
    mesh = Mesh(
        vertices,
        faces,
        name=document.path.stem,
        corner_uv=_corner_values([_read_vertex_uv(document, get_primitive(document, key)) for key in keys], triangles),
        # A primitive without normals among others gets face normals (glTF 2.0, 3.7.2.1: "calculate flat normals").
        corner_normals=None if normals is None else with_face_normals(normals, vertices, faces),
        vertex_colors=_read_vertex_colors(document, vertex_ranges, len(vertices)),
        parts=_read_parts(document, rest),
        up="+y",  # glTF 2.0, 3.4 Coordinate System and Units
    )
    return mesh, rest


def read_rest_positions(
    document: Document, node: int, primitive: int, T_world_node: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "V 3"]:
    """Read the world positions of the vertices of a node's primitive."""
    entry = get_primitive(document, (node, primitive))
    positions = scene.read_morphed_attribute(document, entry, "POSITION", scene.read_morph_weights(document, node))
    assert positions is not None
    return scene.transform_points(scene.vertex_matrices(document, node, entry, T_world_node), positions)


def read_rest_normals(
    document: Document, node: int, primitive: int, T_world_node: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "V 3"] | None:
    """Read the world normals of the vertices of a node's primitive; None where it has none. Zero normals stay zero."""
    entry = get_primitive(document, (node, primitive))
    normals = scene.read_morphed_attribute(document, entry, "NORMAL", scene.read_morph_weights(document, node))
    if normals is None:
        return None
    linear = scene.vertex_matrices(document, node, entry, T_world_node)[:, :, :3]
    return unit_vectors(scene.transform_vectors(scene.normal_matrices(linear), normals))


def get_primitive(document: Document, key: PrimitiveKey) -> dict[str, Any]:
    """Return the JSON of a node's primitive."""
    node, primitive = key
    return document.gltf["meshes"][document.gltf["nodes"][node]["mesh"]]["primitives"][primitive]


def _find_vertex_ranges(document: Document) -> tuple[VertexRange, ...]:
    """Group the primitives of the scene by the vertices that they draw, and number these vertices.

    Ranges that no triangle uses are left out, unless the scene has no triangles at all: then POINTS are kept.
    """
    # Dictionaries keep insertion order, so the vertices follow the scene.
    groups: dict[tuple[Any, ...], list[PrimitiveKey]] = {}
    for node in scene.scene_nodes(document):
        mesh = document.gltf["nodes"][node].get("mesh")
        primitives = document.gltf["meshes"][mesh]["primitives"] if mesh is not None else []
        for index, primitive in enumerate(primitives):
            position = primitive["attributes"].get("POSITION")
            if position is not None and document.gltf["accessors"][position]["count"]:
                # Primitives with the same accessors for their vertex positions share vertices.
                deforming = ("JOINTS_", "WEIGHTS_")
                skinning = sorted(item for item in primitive["attributes"].items() if item[0].startswith(deforming))
                targets = [target.get("POSITION") for target in primitive.get("targets", [])]
                groups.setdefault((node, position, *skinning, *targets), []).append((node, index))
    drawn_groups = [group for group in groups.values() if any(_get_mode(document, key) >= TRIANGLES for key in group)]
    drawn_groups = drawn_groups or [
        group for group in groups.values() if any(_get_mode(document, key) == POINTS for key in group)
    ]
    if not drawn_groups:
        raise InputError(
            f"{document.path}: expected a scene with triangles, found none "
            f"({len(document.gltf.get('meshes', []))} meshes, {len(document.gltf.get('animations', []))} animations); "
            "give the file that holds the character"
        )
    vertex_ranges, start = [], 0
    for group in drawn_groups:
        count = document.gltf["accessors"][get_primitive(document, group[0])["attributes"]["POSITION"]]["count"]
        vertex_ranges.append(VertexRange(group[0][0], start, start + count, tuple(index for _, index in group)))
        start += count
    VERTICES.check(start, document.path)
    return tuple(vertex_ranges)


def _get_mode(document: Document, key: PrimitiveKey) -> int:
    return get_primitive(document, key).get("mode", TRIANGLES)


def _read_faces(document: Document, key: PrimitiveKey) -> Int[np.ndarray, "F 3"]:
    """Read the triangles of a primitive, with vertices counted from its first one.

    Strips and fans become triangles by the equations of glTF 2.0, 3.7.2.1. Degenerate triangles, which strips contain
    where they change direction, are left out.
    """
    indices, mode = scene.read_indices(document, get_primitive(document, key)), _get_mode(document, key)
    if mode == TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)  # as in OpenGL, an incomplete triangle is not drawn
    if mode == TRIANGLE_FAN:
        # Triangle i is (v[i + 1], v[i + 2], v[0]).
        centre = np.broadcast_to(indices[:1], max(len(indices) - 2, 0))
        triangles = np.stack([indices[1:-1], indices[2:], centre], axis=1)
    else:
        # Triangle i is (v[i], v[i + 1], v[i + 2]); every second one has the last two exchanged, to keep the winding.
        triangles = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
        triangles[1::2, 1:] = triangles[1::2, :0:-1]
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def _corner_values(values_of: Sequence[np.ndarray | None], triangles: list[np.ndarray]) -> np.ndarray | None:
    """Return values at vertices of primitives at all corners; zeros where one has none, None where no one has any."""
    pairs = zip(values_of, triangles, strict=True)
    return joined_corners(
        [None if values is None else values[faces] for values, faces in pairs], list(map(len, triangles))
    )


def _read_vertex_colors(
    document: Document, vertex_ranges: tuple[VertexRange, ...], count: int
) -> Float[np.ndarray, "V 4"] | None:
    """Read COLOR_0 of all vertices, of the last primitive that has any, else white; None where no primitive has any."""
    colors = np.ones((count, 4))
    found = False
    for span in vertex_ranges:
        for number in span.primitives:
            primitive = get_primitive(document, (span.node, number))
            values = scene.read_attribute(document, primitive, "COLOR_0")
            if values is not None:
                drawn = scene.read_indices(document, primitive)
                colors[span.start + drawn] = with_alpha(values)[drawn]
                found = True
    return colors if found else None


def _read_vertex_uv(document: Document, primitive: dict[str, Any]) -> Float[np.ndarray, "V 2"] | None:
    """Read the texture coordinates of the base colour texture, with its KHR_texture_transform applied and v turned up.

    The extension's matrix is translation * rotation * scale, and it may name another TEXCOORD set. glTF has v down
    (3.8.3 Images: the origin is the upper left corner), a Mesh has v up.
    """
    material = document.gltf["materials"][primitive["material"]] if "material" in primitive else {}
    texture = base_texture_of(material)
    uv_transform = texture.get("extensions", {}).get("KHR_texture_transform", {})
    number = uv_transform.get("texCoord", texture.get("texCoord", 0))
    uv = scene.read_attribute(document, primitive, f"TEXCOORD_{number}")
    uv = scene.read_attribute(document, primitive, "TEXCOORD_0") if uv is None else uv
    if uv is None:
        return None
    sine, cosine = np.sin(uv_transform.get("rotation", 0.0)), np.cos(uv_transform.get("rotation", 0.0))
    scale, offset = uv_transform.get("scale", [1, 1]), uv_transform.get("offset", [0, 0])
    transformed = (uv * scale) @ np.array([[cosine, -sine], [sine, cosine]]) + offset
    return np.stack([transformed[:, 0], 1.0 - transformed[:, 1]], axis=1)


def _read_parts(document: Document, rest: RestScene) -> tuple[Part, ...]:
    """Read one Part for each primitive with faces, named after its node, else its mesh."""
    materials: dict[int | None, Material | None] = {None: None}
    parts = []
    for key, (start, stop) in rest.faces.items():
        primitive, node = get_primitive(document, key), document.gltf["nodes"][key[0]]
        name = node.get("name") or document.gltf["meshes"][node["mesh"]].get("name") or f"node{key[0]}"
        index = primitive.get("material")
        if index is not None and index not in materials:
            materials[index] = _read_material(document, index)
        parts.append(Part(name, start, stop, materials[index]))
    return tuple(parts)


def _read_material(document: Document, index: int) -> Material | None:
    """Read name, base colour and base colour texture of a material; None for the one that stands for no material."""
    entry = document.gltf["materials"][index]
    texture = _read_texture(document, base_texture_of(entry))
    material = Material(entry.get("name", f"material{index}"), base_color_of(entry), texture)
    return None if material == DEFAULT_MATERIAL else material


def base_color_of(material: dict[str, Any]) -> tuple[float, float, float, float]:
    """Return the base colour of a material, linear RGBA; the diffuse colour of one with specular and glossiness."""
    gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    color = material.get("pbrMetallicRoughness", {}).get("baseColorFactor") or gloss.get("diffuseFactor")
    r, g, b, a = (float(value) for value in color or [1, 1, 1, 1])
    return r, g, b, a


def base_texture_of(material: dict[str, Any]) -> dict[str, Any]:
    """Return the reference to the texture of the base or diffuse colour; an empty one where there is none."""
    gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    return material.get("pbrMetallicRoughness", {}).get("baseColorTexture") or gloss.get("diffuseTexture") or {}


def _read_texture(document: Document, info: dict[str, Any]) -> bytes | None:
    """Return the PNG or JPEG bytes of a texture reference; None for other formats, which Material does not support."""
    if "index" not in info:
        return None
    image = document.gltf["textures"][info["index"]].get("source")
    content = None if image is None else document.images[image]
    return content if content and image_type(content) in ("image/png", "image/jpeg") else None


def skin_joints(document: Document, rest: RestScene) -> set[int]:
    """List the nodes that are joints of the shown skins."""
    skins = {skin for span in rest.vertex_ranges if (skin := find_skin(document, span)) is not None}
    return {node for skin in skins for node in document.gltf["skins"][skin]["joints"]}


def rig_on_nodes(
    mesh: Mesh, document: Document, rest: RestScene, joint_nodes: Collection[int]
) -> tuple[SkinnedCharacter, list[int]]:
    """Read the influences on the vertices of a scene with given joints, and the node of each joint of the rig.

    The mesh is left as it is: its vertices are those of `rest` only where the mesh was read with it.
    """
    # One tree for all skins of the scene, so that their joints have one numbering: each node has the joint that it is,
    # or the nearest one above it, else -1.
    node_parent = scene.node_parents(document)
    nodes: list[int] = []
    joint_of_node = {-1: -1}
    for node in scene.sort_parents_first(document, node_parent):
        joint_of_node[node] = joint_of_node[node_parent[node]]
        if node in joint_nodes:
            joint_of_node[node] = len(nodes)
            nodes.append(node)
    parts = [_read_range_influences(document, rest, span, joint_of_node, len(nodes)) for span in rest.vertex_ranges]
    columns = max(weights.shape[1] for _, weights, _ in parts)
    padded = []
    for part in parts:
        padding = [(0, 0), (0, columns - part[1].shape[1]), (0, 0)]
        # With weight zero, it does not matter that the joint of the padding is 0.
        padded.append([np.pad(values, padding[: values.ndim]) for values in part])
    joint_of, weights, points = (np.concatenate(some) for some in zip(*padded, strict=True))
    names = tuple(scene.node_name(document, node) for node in nodes)
    parents = tuple(joint_of_node[node_parent[node]] for node in nodes)
    return SkinnedCharacter(mesh, names, parents, rest.T_world_node[nodes], joint_of, weights, points), nodes


def unweighted_parts(document: Document, rest: RestScene) -> tuple[str, ...]:
    """List the parts of a skin that have no finite weights at all; they follow a joint (see `read_influences`)."""
    total = sum(span.stop - span.start for span in rest.vertex_ranges)
    some, parts = 0, {}
    for span in rest.vertex_ranges:
        if find_skin(document, span) is None:
            continue
        primitive = get_primitive(document, (span.node, span.primitives[0]))
        sets = [name for name in primitive["attributes"] if name.startswith("WEIGHTS_")]
        weight = np.asarray(sum(read_floats(document, primitive["attributes"][name]).sum(axis=1) for name in sets))
        bare = ~((weight > 0) & np.isfinite(weight))
        if bare.all():
            name = scene.node_name(document, span.node)
            parts[name] = parts.get(name, 0) + len(bare)
        else:
            some += int(bare.sum())
    check_weights(some / total, sum(parts.values()) / total, document.path)
    return tuple(parts)


def check_weights(bare: float, parts: float, path: object) -> None:
    """Check that only a small share of the vertices is without weights.

    Args:
        bare: share of vertices without weights, in parts of which others have some.
        parts: share of the vertices of parts that have none at all, such as a prop.
    """
    if bare > UNSKINNED or parts > UNSKINNED_PARTS:
        raise InputError(
            f"{path}: expected a skin with weights, found {bare + parts:.0%} of the vertices without; "
            "bind the mesh again"
        )


def find_skin(document: Document, span: VertexRange) -> int | None:
    """Return the skin of a range's vertices; None where they are unskinned, by the same rule as `vertex_matrices`."""
    skinned = "JOINTS_0" in get_primitive(document, (span.node, span.primitives[0]))["attributes"]
    return document.gltf["nodes"][span.node].get("skin") if skinned else None


def _read_range_influences(
    document: Document, rest: RestScene, span: VertexRange, joint_of_node: dict[int, int], joints: int
) -> tuple[Int[np.ndarray, "N K"], Float[np.ndarray, "N K"], Float[np.ndarray, "N K 3"]]:
    """Read the joints, weights and world positions of all influences on the vertices of one range.

    Unskinned vertices have one influence: the nearest joint above their node, else the world (joint index J).
    """
    primitive = get_primitive(document, (span.node, span.primitives[0]))
    positions = scene.read_morphed_attribute(
        document, primitive, "POSITION", scene.read_morph_weights(document, span.node)
    )
    assert positions is not None
    skin = find_skin(document, span)
    if skin is None:
        # -1, no joint, becomes J, the world.
        joint_of = np.full((len(positions), 1), joint_of_node[span.node] % (joints + 1))
        world = scene.transform_points(rest.T_world_node[span.node, None, :3], positions)
        return joint_of, np.ones(joint_of.shape), world[:, None]
    skin_joints, weights = scene.read_influences(document, primitive)
    T_world_bind = scene.joint_matrices(document, skin, rest.T_world_node)
    points = [scene.transform_points(T_world_bind[column, :3], positions) for column in skin_joints.T]
    # Skins list the same nodes in different orders: count joints by node.
    joint_of_skin = np.array([joint_of_node[node] for node in document.gltf["skins"][skin]["joints"]])
    return joint_of_skin[skin_joints], weights, np.stack(points, axis=1)
