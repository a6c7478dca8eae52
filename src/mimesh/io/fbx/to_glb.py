"""Convert an FBX file to a .glb with the library ufbx; runs in a child process (`child_process.child_result`).

The scene is turned to y up, right-handed, and scaled to metres, as glTF has it (3.4 Coordinate System and Units). Nodes
keep names, order and transforms; what glTF has not (geometry transforms, scale that children do not inherit) goes into
the vertices, or into nodes of its own where that is not possible.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import ufbx

from ...core.errors import InputError
from ..beside import confined
from ..gltf.draft import Draft, NumberTooLarge
from ..gltf.scene import DEFAULT_TRS
from .animation import add_animations
from .elements import items, own
from .geometry import (
    MorphChannels,
    SeamSplit,
    add_attributes,
    add_skin,
    add_targets,
    bind_matrix,
    read_morphs,
    split_mesh,
)
from .materials import MaterialWriter

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


def write_glb(source: Path, target: Path, confined_to: str | None = None) -> None:
    """Read an FBX file and write it as a .glb with all images embedded.

    Args:
        confined_to: folder outside of which textures count as missing; None for any.

    Raises:
        InputError: no FBX file, or a damaged one.
    """
    try:
        scene = _load(source)
    except ufbx.UfbxError as error:
        found = " ".join(str(error).split())
        raise InputError(f"{source}: expected an FBX file, found '{found}'; export it again") from error
    folder = contextlib.nullcontext() if confined_to is None else confined(Path(confined_to))
    with folder:
        try:
            _draft(scene, source).save(target.with_suffix(".glb"))
        except NumberTooLarge as error:
            raise InputError(
                f"{source}: expected finite numbers up to 3.4e38, found others; the file is damaged, export it again"
            ) from error
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


def _up_axis(scene: Any) -> str:
    """Return the axis of the file that is up, such as +z."""
    props = own(own(scene.settings).props)
    axis, sign = (ufbx.find_int(props, name, 1) for name in ("UpAxis", "UpAxisSign"))
    return ("-" if sign < 0 else "+") + "xyz"[axis if 0 <= axis < 3 else 1]


def _draft(scene: Any, source: Path) -> Draft:
    """Return a glTF draft of a scene."""
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
    add_animations(draft, scene, nodes, morphs, source)
    facts: dict[str, Any] = {"unit": _unit(scene), "up": _up_axis(scene)}
    facts |= {"missingTextures": sorted(set(materials.missing))} if materials.missing else {}
    draft.gltf["asset"]["extras"] = {"fbx": facts}
    return draft


def _node(node: Any) -> dict[str, Any]:
    """Return the JSON of a node without its mesh."""
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
    """Add the meshes of all visible nodes, or of all where none is visible.

    Returns for each mesh with blend shapes the nodes that show it, and the shapes.
    """
    shown = [(index, node, mesh) for index, node in enumerate(nodes) if (mesh := own(node.mesh)) is not None]
    visible = [entry for entry in shown if entry[1].visible]
    splits: dict[int, SeamSplit | None] = {}
    written: dict[tuple[int, ...], tuple[int, int | None]] = {}
    morphs: dict[int, tuple[list[int], MorphChannels]] = {}
    for index, node, mesh in visible or shown:
        number = mesh.typed_id
        if number not in splits:
            splits[number] = split_mesh(mesh)
        split = splits[number]
        if split is None:
            continue
        # Nodes that show one mesh with the same materials share it.
        own_materials = items(node.materials) or items(mesh.materials)
        key = (number, *(material.typed_id for material in own_materials))
        if number not in morphs:
            morphs[number] = ([], read_morphs(mesh))
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
    T_world_mesh = bind_matrix(mesh)
    attributes = add_attributes(draft, mesh, split, T_world_mesh)
    skin = add_skin(draft, mesh, split, T_world_mesh, node)
    if skin is not None:
        attributes |= skin[0]
    targets = add_targets(draft, morphs, split, T_world_mesh)
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
        entry |= {"weights": weights[0].tolist(), "extras": {"targetNames": [shape.name for shape in morphs.shapes]}}
    meshes = draft.gltf.setdefault("meshes", [])
    meshes.append(entry)
    return len(meshes) - 1, None if skin is None else skin[1]
