"""Convert an FBX file to a .glb with the library ufbx; runs in a child process (`child_process.child_result`).

The scene is turned to y up, right-handed, and scaled to metres, as glTF has it (3.4 Coordinate System and Units). Nodes
keep names, order and transforms; what glTF has not (geometry transforms, scale that children do not inherit) goes into
the vertices, or into nodes of its own where that is not possible. FBX curves have pivots, rotation orders and types
that glTF has not: every frame of an animation is evaluated, at the frame rate of the file.

FBX has one normal, texture coordinate and colour for each polygon corner; glTF has one for each vertex. Corners of one
position that agree in all of them become one vertex; vertices keep the order of the positions.

A texture is embedded in the FBX file, or a file beside it. Images that glTF does not have (TGA, BMP, TIFF) become PNG.

ufbx 0.0.5 returns an element or an exported buffer a second time without counting the new reference, so Python frees
objects that are still in use (a crash). Every object that is read from the library therefore gets references that are
never given back (`own`). They end with the process, which reads one file.
"""

from __future__ import annotations

import ctypes
import io
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
import ufbx
from jaxtyping import Float, Int

from ...core.arguments import HIGHEST_FPS
from ...core.errors import InputError, damaged
from ...core.geometry import continuous_quaternions
from ..beside import is_there
from ..gltf.animation import AnimationChannel, add_animation
from ..gltf.check import ARRAY_BUFFER
from ..gltf.draft import PER_SET, Draft, NumberTooLarge, accessor_bounds
from ..gltf.scene import DEFAULT_TRS
from ..mtl import image_type
from ..polygons import fan_corners
from ..timing import DEFAULT_FPS, LONGEST, frame_count

# ufbx declares the arguments of its functions only in a stub that type checkers do not all follow.
# pyright: reportAttributeAccessIssue=false

OPTIONS = {
    "file_format": ufbx.FileFormat.FBX,
    "target_axes": ufbx.axes_right_handed_y_up,
    "target_unit_meters": 1.0,
    "geometry_transform_handling": ufbx.GeometryTransformHandling.MODIFY_GEOMETRY,
    "inherit_mode_handling": ufbx.InheritModeHandling.COMPENSATE,
    "geometry_transform_helper_name": "geometry",
    "scale_helper_name": "scale",
    "generate_missing_normals": True,
    "clean_skin_weights": True,
    "use_blender_pbr_material": True,
}
"""Options of `ufbx.load_file`."""
SAME = 1e-6
"""Largest difference, relative to values above 1, between a channel and the node's own value that counts as none."""
ROUGHNESS = 0.9
"""Roughness of materials that state none, as in other files that this package writes."""
MOST_PIXELS = 2**28
"""Pixels of the largest image that is converted."""
REPEAT, CLAMP_TO_EDGE = 10497, 33071
"""Values of `wrapS` and `wrapT` (glTF 2.0, 5.26 Sampler)."""


def write_glb(source: Path, target: Path) -> None:
    """Read an FBX file and write it as a .glb with all images embedded."""
    try:
        scene = _load(source)
    except ufbx.UfbxError as error:
        found = " ".join(str(error).split())
        raise InputError(f"{source}: expected an FBX file, found '{found}'; export it again") from error
    try:
        _draft(scene, source).save(target.with_suffix(".glb"))
    except NumberTooLarge as error:
        raise damaged(source, "finite numbers up to 3.4e38", "others") from error
    target.with_suffix(".glb").rename(target)


def _load(source: Path) -> Any:
    """Load a scene in metres.

    The factor of the unit goes into vertices and translations, so that no scale remains in the nodes. Blender does the
    opposite: centimetres, and a scale of 100 on each object. There the factor goes into these scales, which become 1.
    """

    def load(conversion: Any) -> Any:
        return own(ufbx.load_file(str(source), space_conversion=conversion, **OPTIONS))

    scene = load(ufbx.SpaceConversion.MODIFY_GEOMETRY)
    unit = _unit(scene)
    scales = [np.array(node.local_transform.scale) for node in items(own(scene.root_node).children)]
    if unit > 0 and unit != 1 and scales and np.allclose(scales, 1 / unit, rtol=1e-4):
        return load(ufbx.SpaceConversion.ADJUST_TRANSFORMS)
    return scene


def _unit(scene: Any) -> float:
    """Return the unit of the file in metres; files store centimetres."""
    return float(ufbx.find_real(own(own(scene.settings).props), "UnitScaleFactor", 1.0)) / 100


def _draft(scene: Any, source: Path) -> Draft:
    draft = Draft({"asset": {"version": "2.0", "generator": "mimesh"}, "scene": 0, "scenes": [{}]})
    nodes = items(scene.nodes)
    draft.gltf["nodes"] = [_node(node) for node in nodes[1:]]
    draft.gltf["scenes"][0]["nodes"] = [child.typed_id - 1 for child in items(nodes[0].children)]
    materials = MaterialWriter(draft, source)
    morphs = _add_meshes(draft, nodes[1:], materials)
    bones = [index for index, node in enumerate(nodes[1:]) if node.bone is not None]
    if bones and "meshes" not in draft.gltf:
        # A motion without a mesh: the skin says which nodes are joints, also those that no animation moves.
        draft.gltf["skins"] = [{"joints": bones}]
    _add_animations(draft, scene, nodes, morphs, source)
    props = own(own(scene.settings).props)
    axis, sign = (ufbx.find_int(props, name, 1) for name in ("UpAxis", "UpAxisSign"))
    up = ("-" if sign < 0 else "+") + "xyz"[axis if 0 <= axis < 3 else 1]
    facts: dict[str, Any] = {"unit": _unit(scene), "up": up}
    facts |= {"missingTextures": sorted(set(materials.missing))} if materials.missing else {}
    draft.gltf["asset"]["extras"] = {"fbx": facts}
    return draft


def _node(node: Any) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": node.name} if node.name else {}
    transform = node.local_transform
    for key, default in DEFAULT_TRS.items():
        value = [float(number) for number in getattr(transform, key)]
        if not np.isfinite(value).all():
            value = list(default)
        if tuple(value) != tuple(default):
            entry[key] = value
    children = [child.typed_id - 1 for child in items(node.children)]
    return entry | ({"children": children} if children else {})


def _add_meshes(
    draft: Draft, nodes: list[Any], materials: MaterialWriter
) -> dict[int, tuple[list[int], MorphChannels]]:
    """Add the meshes of visible nodes, else of all; returns for each with blend shapes its nodes, and the shapes."""
    shown = [(index, node, mesh) for index, node in enumerate(nodes) if (mesh := own(node.mesh)) is not None]
    visible = [entry for entry in shown if entry[1].visible]
    splits: dict[int, SeamSplit | None] = {}
    written: dict[tuple[int, ...], tuple[int, int | None]] = {}
    morphs: dict[int, tuple[list[int], MorphChannels]] = {}
    for index, node, mesh in visible or shown:
        number = mesh.typed_id
        if number not in splits:
            splits[number] = _split_mesh(mesh)
        split = splits[number]
        if split is None:
            continue
        # Nodes that show one mesh with the same materials share it.
        own_materials = items(node.materials) or items(mesh.materials)
        key = (number, *(material.typed_id for material in own_materials))
        if number not in morphs:
            morphs[number] = ([], _read_morphs(mesh))
        if key not in written:
            written[key] = _add_mesh(draft, mesh, split, own_materials, materials, morphs[number][1], index)
        mesh_index, skin = written[key]
        morphs[number][0].append(index)
        draft.gltf["nodes"][index] |= {"mesh": mesh_index} | ({} if skin is None else {"skin": skin})
    return morphs


def _add_mesh(
    draft: Draft,
    mesh: Any,
    split: SeamSplit,
    own_materials: list[Any],
    materials: MaterialWriter,
    morphs: MorphChannels,
    node: int,
) -> tuple[int, int | None]:
    """Add a mesh with a primitive for each of its materials; returns its index and that of its skin."""
    T_world_mesh = _bind_matrix(mesh)
    attributes = _add_attributes(draft, mesh, split, T_world_mesh)
    skin = _add_skin(draft, mesh, split, T_world_mesh, node)
    if skin is not None:
        attributes |= skin[0]
    offsets = (offset[split.position_of] @ T_world_mesh[:3, :3].T for offset in morphs.offsets)
    targets = [{"POSITION": _add_sparse(draft, offset)} for offset in offsets]
    uv_names = [entry.name for entry in items(mesh.uv_sets)]
    of_polygon = np.array(mesh.face_material, np.int64) if len(own(mesh.face_material)) else np.zeros(1, np.int64)
    of_triangle = of_polygon[split.polygon] if len(of_polygon) > 1 else np.zeros(len(split.polygon), np.int64)
    primitives = []
    for number in np.unique(of_triangle).tolist():
        primitive: dict[str, Any] = {"attributes": attributes}
        primitive["indices"] = draft.add_indices(split.triangles[of_triangle == number])
        if number < len(own_materials):
            primitive["material"] = materials.add(own_materials[number], uv_names)
        primitives.append(primitive | ({"targets": targets} if targets else {}))
    entry: dict[str, Any] = {"primitives": primitives} | ({"name": mesh.name} if mesh.name else {})
    if targets:
        weights = morphs.target_weights(np.array([[channel.weight for channel in morphs.channels]]))
        entry |= {"weights": weights[0].tolist(), "extras": {"targetNames": morphs.names}}
    meshes = draft.gltf.setdefault("meshes", [])
    meshes.append(entry)
    return len(meshes) - 1, None if skin is None else skin[1]


@dataclass(frozen=True, eq=False)
class SeamSplit:
    """A mesh of FBX with vertices of glTF, of which there are N at P positions."""

    position_of: Int[np.ndarray, " N"]
    """Position that each vertex has."""
    corner_of: Int[np.ndarray, " N"]
    """A polygon corner that each vertex is."""
    triangles: Int[np.ndarray, "F 3"]
    polygon: Int[np.ndarray, " F"]
    """Polygon that each triangle is a part of."""


@dataclass(frozen=True, eq=False)
class MorphChannels:
    """The channels of a mesh, which drive one shape each, or several in a row (in-between shapes)."""

    channels: list[Any]
    knots: list[Float[np.ndarray, " K"]]
    """Weights of each channel at which its shapes have their full effect."""
    names: list[str]
    """Name of each shape, which is written as a morph target."""
    offsets: list[Float[np.ndarray, "P 3"]]
    """Of each shape, at the positions of the mesh."""

    def target_weights(self, channel_weights: Float[np.ndarray, "T C"]) -> Float[np.ndarray, "T S"]:
        """Return the weight of each morph target for weights of the channels.

        It is linear between zero and the shapes of a channel; shape k acts alone at knot k.
        """
        columns, rows = [np.zeros((len(channel_weights), 0))], np.arange(len(channel_weights))
        for weights, knots in zip(channel_weights.T, self.knots, strict=True):
            order = np.argsort(np.append(knots, 0.0), kind="stable")
            places = np.append(knots, 0.0)[order]
            upper = np.clip(np.searchsorted(places, weights, side="right"), 1, len(knots))
            length = places[upper] - places[upper - 1]
            share = np.where(length > 0, (weights - places[upper - 1]) / np.where(length > 0, length, 1.0), 0.0)
            of_shapes = np.zeros((len(weights), len(places)))
            of_shapes[rows, order[upper - 1]] = 1 - share
            of_shapes[rows, order[upper]] = share
            columns.append(of_shapes[:, :-1])  # the last one is the zero, which has no shape
        return np.concatenate(columns, axis=1)


def _split_mesh(mesh: Any) -> SeamSplit | None:
    """Split a mesh at the seams of its attributes; None where it has no triangle."""
    position = array(own(mesh.vertex_indices)).astype(np.int64)
    sizes = array(mesh.faces, 2)[:, 1].astype(np.int64)
    corners, polygon = fan_corners(sizes)
    if not len(corners):
        return None
    key = position
    # Normals, all sets of texture coordinates, and all sets of colours split vertices.
    attributes = [own(mesh.vertex_normal), *(own(entry.vertex_uv) for entry in items(mesh.uv_sets))]
    attributes += [own(entry.vertex_color) for entry in items(mesh.color_sets)]
    for values in (values for values in attributes if values.exists and len(own(values.values))):
        # Equal values get one number: exporters write the same normal once for each corner.
        number = np.unique(array(values.values).astype(np.float32), axis=0, return_inverse=True)[1].reshape(-1)
        of_corner = number[array(values.indices)]
        # Numbering the pairs keeps the order of positions and the keys small.
        key = np.unique(key * (number.max() + 1) + of_corner, return_inverse=True)[1]
    drawn = np.unique(corners)
    _, first, element = np.unique(key[drawn], return_index=True, return_inverse=True)
    corner_of = drawn[first]
    vertex_of_corner = np.full(len(position), -1)
    vertex_of_corner[drawn] = element
    return SeamSplit(position[corner_of], corner_of, vertex_of_corner[corners], polygon)


def _bind_matrix(mesh: Any) -> Float[np.ndarray, "4 4"]:
    """Return the transform from a mesh to the world in its bind pose; the identity for a mesh without a skin.

    A skinned mesh of glTF ignores the transform of its node (3.7.3.3), so its vertices may have any frame. In that of
    the world they are the character at rest, upright and in its size, which a bind pose in FBX knows and in glTF not.
    """
    for deformer in items(mesh.skin_deformers):
        for cluster in items(deformer.clusters):
            T_world_mesh = matrix(cluster.bind_to_world) @ matrix(cluster.geometry_to_bone)
            if np.isfinite(T_world_mesh).all() and np.linalg.det(T_world_mesh) > 0:
                return T_world_mesh
    return np.eye(4)


def _add_attributes(
    draft: Draft, mesh: Any, split: SeamSplit, T_world_mesh: Float[np.ndarray, "4 4"]
) -> dict[str, int]:
    """Add positions, normals, texture coordinates and colours of a mesh; returns the accessors by attribute name."""

    def at_vertices(values: Any, columns: int) -> np.ndarray:
        return array(values.values, columns)[array(values.indices)[split.corner_of]]

    linear = T_world_mesh[:3, :3]
    positions = (array(mesh.vertices, 3) @ linear.T + T_world_mesh[:3, 3])[split.position_of]
    attributes = {"POSITION": draft.add_floats(positions, ARRAY_BUFFER, bounds=True)}
    normals = own(mesh.vertex_normal)
    if normals.exists:
        # Normals turn with the inverse transpose; only their direction counts.
        turned = at_vertices(normals, 3) @ np.linalg.inv(linear)
        lengths = np.linalg.norm(turned, axis=1, keepdims=True)
        turned = np.where(lengths > 0, turned / np.where(lengths > 0, lengths, 1.0), [0.0, 1.0, 0.0])
        attributes["NORMAL"] = draft.add_floats(turned, ARRAY_BUFFER)
    for number, entry in enumerate(items(mesh.uv_sets)):
        values = own(entry.vertex_uv)
        if values.exists and len(own(values.values)):
            # glTF has v down (3.8.3 Images: the origin is the upper left corner), FBX has v up.
            uv = at_vertices(values, 2) * [1.0, -1.0] + [0.0, 1.0]
            attributes[f"TEXCOORD_{number}"] = draft.add_floats(uv, ARRAY_BUFFER)
    for number, entry in enumerate(items(mesh.color_sets)):
        values = own(entry.vertex_color)
        if values.exists and len(own(values.values)):
            colors = np.clip(at_vertices(values, 4), 0.0, 1.0)
            attributes[f"COLOR_{number}"] = draft.add_floats(colors, ARRAY_BUFFER)
    return attributes


def _add_skin(
    draft: Draft, mesh: Any, split: SeamSplit, T_world_mesh: Float[np.ndarray, "4 4"], mesh_node: int
) -> tuple[dict[str, int], int] | None:
    """Add the skin of a mesh: the accessors of its joints and weights, and the index of the skin; None without one.

    All influences are kept. Vertices without any follow the node of their mesh, which becomes a joint for them.
    """
    deformers = [deformer for deformer in items(mesh.skin_deformers) if len(own(deformer.clusters))]
    if not deformers:
        return None
    clusters = items(deformers[0].clusters)
    joint_of, joints, matrices = _joints(clusters)
    chosen, weights = _influences(deformers[0], joint_of, len(array(mesh.vertices, 3)))
    loose = weights.sum(axis=1) <= 0
    if loose[split.position_of].any():
        chosen[loose, 0], weights[loose, 0] = len(joints), 1.0
        joints, matrices = [*joints, mesh_node], [*matrices, np.eye(4)]
    if not joints:
        return None
    matrices = np.stack(matrices) @ np.linalg.inv(T_world_mesh)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    chosen = chosen.astype("<u1" if len(joints) < 256 else "<u2")
    attributes = draft.add_influences(chosen[split.position_of], weights[split.position_of])
    skins = draft.gltf.setdefault("skins", [])
    skins.append({"inverseBindMatrices": draft.add_matrices(matrices), "joints": joints})
    return attributes, len(skins) - 1


def _joints(clusters: list[Any]) -> tuple[Int[np.ndarray, " C"], list[int], list[Float[np.ndarray, "4 4"]]]:
    """Return the joint of each cluster (-1 for none), the node of each joint, and its inverse bind matrix."""
    joint_of, joints, matrices = np.full(len(clusters), -1), [], []
    for number, cluster in enumerate(clusters):
        bone = own(cluster.bone_node)
        if bone is None:
            continue
        node = bone.typed_id - 1
        if node not in joints:  # joints of a skin are unique (5.28 Skin)
            joints.append(node)
            matrices.append(matrix(cluster.geometry_to_bone))
        joint_of[number] = joints.index(node)
    return joint_of, joints, matrices


def _influences(
    deformer: Any, joint_of: Int[np.ndarray, " C"], count: int
) -> tuple[Int[np.ndarray, "P K"], Float[np.ndarray, "P K"]]:
    """Return joints and weights of all influences of each position, largest first, K a multiple of four."""
    of_vertex, pairs = array(deformer.vertices, 3)[:count], array(deformer.weights, 2)
    numbers = of_vertex[:, 1].astype(np.int64)
    columns = np.arange(-(-max(int(numbers.max(initial=0)), 1) // PER_SET) * PER_SET)
    index = of_vertex[:, :1].astype(np.int64) + columns
    used = columns < numbers[:, None]
    rows = pairs[np.where(used, index, 0)] if len(pairs) else np.zeros((*index.shape, 2))
    joints = np.where(used, joint_of[rows[..., 0].astype(np.int64)], -1)
    weights = np.where(used & (joints >= 0) & np.isfinite(rows[..., 1]), np.maximum(rows[..., 1], 0.0), 0.0)
    # A joint without weight is 0 (3.7.3.1: unused joint values should be zero).
    padding = [(0, count - len(joints)), (0, 0)]
    return np.pad(np.where(weights > 0, joints, 0), padding), np.pad(weights, padding)


def _read_morphs(mesh: Any) -> MorphChannels:
    """Read the blend shapes of a mesh: one morph target for each shape, in-between shapes included."""
    channels, knots, names, shapes = [], [], [], []
    count = len(array(mesh.vertices, 3))
    for deformer in items(mesh.blend_deformers):
        for channel in items(deformer.channels):
            keys = [key for key in items(channel.keyframes) if key.target_weight != 0]
            if not keys:
                continue
            # Maya names channels "deformer.shape".
            name = channel.name.removeprefix(f"{deformer.name}.") or own(keys[-1].shape).name
            for key in keys:
                shape = own(key.shape)
                offsets = np.zeros((count, 3))
                index = array(shape.offset_vertices).astype(np.int64)
                inside = index < count
                offsets[index[inside]] = array(shape.position_offsets, 3)[inside]
                names.append(name if key is keys[-1] else f"{name} {key.target_weight:g}")
                shapes.append(offsets)
            knots.append(np.array([float(key.target_weight) for key in keys]))
            channels.append(channel)
    return MorphChannels(channels, knots, names, shapes)


def _add_sparse(draft: Draft, offsets: Float[np.ndarray, "N 3"]) -> int:
    """Append an accessor of which only the elements that are not zero are stored (3.6.2.3 Sparse Accessors)."""
    values = offsets.astype("<f4")
    moved = np.flatnonzero(values.any(axis=1))
    # The bounds are those of all elements (3.6.2.5).
    accessor = {"componentType": 5126, "count": len(values), "type": "VEC3", **accessor_bounds(values)}
    if len(moved):
        indices = {"bufferView": draft.add_view(moved.astype("<u4")), "componentType": 5125}
        stored = {"bufferView": draft.add_view(np.ascontiguousarray(values[moved]))}
        accessor["sparse"] = {"count": len(moved), "indices": indices, "values": stored}
    return draft.add_accessor(accessor)


class MaterialWriter:
    """Adds each material, texture and image of a scene once."""

    def __init__(self, draft: Draft, path: Path) -> None:
        self.draft = draft
        self.path = path
        self.missing: list[str] = []
        """Names of the images that do not exist or that cannot be read."""
        self._materials: dict[int, int] = {}
        self._textures: dict[int, int | None] = {}
        self._images: dict[bytes, int] = {}

    def add(self, material: Any, uv_names: list[str]) -> int:
        """Add a material for a mesh with given names of its sets of texture coordinates; returns its index."""
        key = material.typed_id
        if key not in self._materials:
            entries = self.draft.gltf.setdefault("materials", [])
            entries.append(self._entry(material, uv_names))
            self._materials[key] = len(entries) - 1
        return self._materials[key]

    def _entry(self, material: Any, uv_names: list[str]) -> dict[str, Any]:
        maps = own(material.pbr)
        base, factor, opacity = own(maps.base_color), own(maps.base_factor), own(maps.opacity)
        roughness, metalness = own(maps.roughness), own(maps.metalness)
        texture = own(base.texture) if base.texture_enabled else None
        reference = None if texture is None else self._reference(texture, uv_names)
        strength = factor.value_vec4.x if factor.has_value else 1.0
        # In FBX a texture replaces the colour, in glTF it multiplies it.
        color = [1.0] * 3 if texture is not None else [_share(value * strength) for value in base.value_vec4[:3]]
        # Exporters write 0 where they mean nothing; a material that nobody sees is not one.
        alpha = _share(opacity.value_vec4.x) if opacity.has_value and opacity.value_vec4.x > 0 else 1.0
        surface: dict[str, Any] = {
            "baseColorFactor": [*color, alpha],
            "metallicFactor": _share(metalness.value_vec4.x) if metalness.has_value else 0.0,
            "roughnessFactor": _share(roughness.value_vec4.x) if roughness.has_value else ROUGHNESS,
        }
        if reference is not None:
            surface["baseColorTexture"] = reference
        entry = {"name": material.name, "pbrMetallicRoughness": surface, "doubleSided": True}
        return entry | ({"alphaMode": "BLEND"} if alpha < 1 else {})

    def _reference(self, texture: Any, uv_names: list[str]) -> dict[str, Any] | None:
        """Return the JSON of a reference to a texture; None where its image is not there."""
        if texture.typed_id not in self._textures:
            self._textures[texture.typed_id] = self._add_texture(texture)
        index = self._textures[texture.typed_id]
        if index is None:
            return None
        uv_set = uv_names.index(texture.uv_set) if texture.uv_set in uv_names else 0
        reference: dict[str, Any] = {"index": index} | ({"texCoord": uv_set} if uv_set else {})
        if texture.has_uv_transform:
            self.draft.gltf["extensionsUsed"] = ["KHR_texture_transform"]
            reference["extensions"] = {"KHR_texture_transform": _uv_transform(matrix(texture.uv_to_texture))}
        return reference

    def _add_texture(self, texture: Any) -> int | None:
        """Add a texture with its image and sampler; returns its index, or None where the image is not there."""
        files = [texture, *items(texture.file_textures)]
        content = next((found for file in files if (found := self._image(file)) is not None), None)
        paths = [file.relative_filename or file.absolute_filename for file in files]
        names = [PureWindowsPath(path).name for path in paths if not path.endswith(("/", "\\"))]
        names = [name for name in names if name]
        name = next(iter(names), texture.name)
        if content is None:
            self.missing += names[:1]  # exporters write textures whose image was never set, too
            return None
        gltf = self.draft.gltf
        images, samplers, textures = (gltf.setdefault(key, []) for key in ("images", "samplers", "textures"))
        if content not in self._images:
            self._images[content] = len(images)
            view = self.draft.add_view(content)
            images.append({"name": PureWindowsPath(name).stem, "bufferView": view, "mimeType": image_type(content)})
        wraps = [CLAMP_TO_EDGE if int(wrap) else REPEAT for wrap in (texture.wrap_u, texture.wrap_v)]
        sampler = dict(zip(("wrapS", "wrapT"), wraps, strict=True))
        if sampler not in samplers:
            samplers.append(sampler)
        textures.append({"source": self._images[content], "sampler": samplers.index(sampler)})
        return len(textures) - 1

    def _image(self, texture: Any) -> bytes | None:
        """Return the image of a texture as PNG or JPEG: the embedded one, else a file beside the FBX file."""
        if texture.content:
            return _as_png(texture.content)
        names = [PureWindowsPath(name) for name in (texture.relative_filename, texture.absolute_filename) if name]
        folder = self.path.parent
        places = [folder / names[0].as_posix()] if names and not names[0].drive and not names[0].root else []
        # ".fbm" is where Autodesk's library unpacks embedded files.
        for name in names:
            places += [folder / inner / name.name for inner in ("", f"{self.path.stem}.fbm", "textures", "Textures")]
        found = next((place for place in places if is_there(place)), None)
        return None if found is None else _as_png(found.read_bytes())


def _uv_transform(uv_to_texture: np.ndarray) -> dict[str, Any]:
    """Return the properties of KHR_texture_transform for an affine map of texture coordinates with v up.

    With v' = 1 - v on both sides the map u -> A u + b becomes F (A F u + b) with F u = D u + (0, 1), D = diag(1, -1).
    The extension's matrix is [[sx cos, sy sin], [-sx sin, sy cos]].
    """
    linear, offset = uv_to_texture[:2, :2], uv_to_texture[:2, 3]
    flip, one = np.diag([1.0, -1.0]), np.array([0.0, 1.0])
    turned = flip @ linear @ flip
    shifted = flip @ (linear @ one + offset) + one
    scale_u = float(np.hypot(*turned[:, 0]))
    scale_v = float(np.linalg.det(turned) / scale_u) if scale_u else 0.0
    rotation = float(np.arctan2(-turned[1, 0], turned[0, 0]))
    return {"offset": shifted.tolist(), "rotation": rotation, "scale": [scale_u, scale_v]}


def _as_png(content: bytes) -> bytes | None:
    """Return an image as it is if glTF has its format, PNG or JPEG, else as PNG; None where it cannot be read."""
    if image_type(content) in ("image/png", "image/jpeg"):
        return content
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content)) as image:
            if image.width * image.height > MOST_PIXELS:
                return None
            written = io.BytesIO()
            image.convert("RGBA" if "A" in image.getbands() else "RGB").save(written, "PNG")
            return written.getvalue()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None  # what Pillow raises on images that it does not know, or that are damaged


def _share(value: float) -> float:
    return float(min(max(value, 0.0), 1.0)) if np.isfinite(value) else 1.0


def _add_animations(
    draft: Draft, scene: Any, nodes: list[Any], morphs: dict[int, tuple[list[int], MorphChannels]], path: Path
) -> None:
    """Add all animation stacks of a scene.

    Args:
        nodes: the scene's nodes by `typed_id`; the first is the root, node k of glTF is the one after it.
        morphs: mesh -> the nodes of glTF that show it, and its blend shapes.
    """
    fps = own(scene.settings).frames_per_second
    fps = float(fps) if 0 < fps <= HIGHEST_FPS else DEFAULT_FPS
    animations = []
    for number, stack in enumerate(items(scene.anim_stacks)):
        curves = own(stack.anim)
        baked = own(ufbx.bake_anim(scene, curves, resample_rate=fps))
        begin, end = _time_range(stack, baked, path)
        seconds = np.arange(frame_count(end - begin, fps)) / fps
        times, channels = [begin + time for time in seconds.tolist()], []
        for moved in (moved for moved in items(baked.nodes) if moved.typed_id > 0):
            node = nodes[moved.typed_id]
            frames = [ufbx.evaluate_transform(curves, node, time) for time in times]
            for target in DEFAULT_TRS:
                values = np.array([tuple(getattr(frame, target)) for frame in frames])
                rest = np.array(getattr(node.local_transform, target))
                if target == "rotation":
                    values = continuous_quaternions(values, rest)
                channels += _channel(node.typed_id - 1, target, seconds, values, rest)
        for shown_by, of_mesh in morphs.values():
            if of_mesh.names:
                weights = [[ufbx.evaluate_blend_weight(curves, c, time) for c in of_mesh.channels] for time in times]
                values = of_mesh.target_weights(np.array(weights))
                rest = of_mesh.target_weights(np.array([[channel.weight for channel in of_mesh.channels]]))[0]
                for index in shown_by:
                    channels += _channel(index, "weights", seconds, values, rest)
        if channels:
            animations.append(add_animation(draft, stack.name or f"animation {number}", channels))
    if animations:
        draft.gltf["animations"] = animations


def _time_range(stack: Any, baked: Any, path: Path) -> tuple[float, float]:
    """Return the seconds in which a stack is played: its own range, or that of its keys where it states none."""
    ranges = ((stack.time_begin, stack.time_end), (baked.key_time_min, baked.key_time_max))
    stated = [(begin, end) for begin, end in ranges if np.isfinite([begin, end]).all() and end > begin]
    begin, end = next((bounds for bounds in stated if bounds[1] - bounds[0] <= LONGEST), (0.0, 0.0))
    if stated and end <= begin:
        begin, end = stated[-1]
        raise InputError(f"{path}: expected an animation of up to an hour, found {end - begin:.0f} s; cut it")
    return begin, end


def _channel(
    node: int,
    path: str,
    seconds: Float[np.ndarray, " T"],
    values: Float[np.ndarray, "T C"],
    rest: Float[np.ndarray, " C"],
) -> list[AnimationChannel]:
    """Return a channel, unless it keeps the node's own value; one that keeps another value has one key."""
    same = SAME * np.maximum(np.abs(rest), 1.0)
    if not np.isfinite(values).all() or (np.abs(values - rest) <= same).all():
        return []
    if (np.abs(values - values[0]) <= same).all():
        values = values[:1]
    return [AnimationChannel(node, path, seconds[: len(values)], values)]


_add_reference = ctypes.pythonapi.Py_IncRef
_add_reference.argtypes = [ctypes.py_object]


def own(element: Any) -> Any:
    """Return an object of the library that may be used until the process ends; None stays None."""
    if element is not None:
        # One reference for the library's cache of objects, one for the caller.
        _add_reference(element)
        _add_reference(element)
    return element


def items(elements: Any) -> list[Any]:
    """Return all objects of a list of the library."""
    own(elements)
    return [own(elements[i]) for i in range(len(elements))]


def array(values: Any, columns: int | None = None) -> np.ndarray:
    """Copy a list of numbers, or of vectors with `columns` components, into an array."""
    own(values)
    try:
        result = np.array(memoryview(values))
    except TypeError:  # some lists export no buffer
        result = np.array(values)
    return result if columns is None else result.reshape(-1, columns)


def matrix(columns: Any) -> Float[np.ndarray, "4 4"]:
    """Return an affine matrix of the library, which has four columns of three numbers."""
    result = np.eye(4)
    result[:3] = np.array([tuple(column) for column in columns]).T
    return result
