"""Convert an FBX file to a .glb with the library ufbx; runs in a child process (`child_process.child_result`).

The scene is turned to y up, right-handed, and scaled to metres, as glTF has it (3.4 Coordinate System and Units). Nodes
keep names, order and transforms; what glTF has not (geometry transforms, scale that children do not inherit) goes into
the vertices, or into nodes of its own where that is not possible. FBX curves have pivots, rotation orders and types
that glTF has not: every frame of an animation is evaluated, at the frame rate of the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import ufbx
from jaxtyping import Float

from ...core.errors import InputError
from ...core.geometry import continuous_quaternions
from ..gltf.animation import AnimationChannel, add_animation
from ..gltf.draft import Draft, NumberTooLarge
from ..gltf.scene import DEFAULT_TRS
from ..timing import DEFAULT_FPS, HIGHEST_FPS, LONGEST, frame_count
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
PATHS = ("translation", "rotation", "scale")


def write_glb(source: Path, target: Path) -> None:
    """Read an FBX file and write it as a .glb with all images embedded.

    Raises:
        InputError: no FBX file, or a damaged one.
    """
    try:
        scene = _load(source)
    except ufbx.UfbxError as error:
        found = " ".join(str(error).split())
        raise InputError(f"{source}: expected an FBX file, found '{found}'; export it again") from error
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
    _add_animations(draft, scene, nodes, morphs, source)
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


def _add_animations(
    draft: Draft, scene: Any, nodes: list[Any], morphs: dict[int, tuple[list[int], MorphChannels]], path: Path
) -> None:
    """Add all animation stacks of a scene.

    Args:
        nodes: the scene's nodes by `typed_id`; the first is the root, node k of glTF is the one after it.
        morphs: mesh -> the nodes of glTF that show it, and its blend shapes.

    Raises:
        InputError: an animation of more than an hour.
    """
    fps = own(scene.settings).frames_per_second
    fps = float(fps) if 0 < fps <= HIGHEST_FPS else DEFAULT_FPS
    animations = []
    for number, stack in enumerate(items(scene.anim_stacks)):
        curves = own(stack.anim)
        baked = own(ufbx.bake_anim(scene, curves, resample_rate=fps))
        begin, end = _time_range(stack, baked, path)
        seconds = np.arange(frame_count(end - begin, fps)) / fps
        reader = _ChannelReader(seconds)
        for moved in items(baked.nodes):
            if moved.typed_id > 0:
                reader.add_node(nodes[moved.typed_id], curves, begin)
        for shown_by, mesh_morphs in morphs.values():
            reader.add_weights(shown_by, mesh_morphs, curves, begin)
        if reader.channels:
            animations.append(add_animation(draft, stack.name or f"animation {number}", reader.channels))
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


class _ChannelReader:
    """The channels of one animation."""

    def __init__(self, seconds: Float[np.ndarray, " T"]) -> None:
        self.seconds = seconds
        self.channels: list[AnimationChannel] = []

    def add_node(self, node: Any, curves: Any, begin: float) -> None:
        """Add the channels of a node that moves."""
        frames = [ufbx.evaluate_transform(curves, node, begin + time) for time in self.seconds.tolist()]
        for path in PATHS:
            values = np.array([tuple(getattr(frame, path)) for frame in frames])
            rest = np.array(getattr(node.local_transform, path))
            if path == "rotation":
                values = continuous_quaternions(values, rest)
            self._add(node.typed_id - 1, path, values, rest)

    def add_weights(self, nodes: list[int], morphs: MorphChannels, curves: Any, begin: float) -> None:
        """Add the weights of the blend shapes of a mesh to all nodes that show it."""
        if not morphs.shapes:
            return
        weights = np.array(
            [
                [ufbx.evaluate_blend_weight(curves, channel, begin + time) for channel in morphs.channels]
                for time in self.seconds.tolist()
            ]
        )
        rest = np.array([[channel.weight for channel in morphs.channels]])
        for node in nodes:
            self._add(node, "weights", morphs.target_weights(weights), morphs.target_weights(rest)[0])

    def _add(self, node: int, path: str, values: Float[np.ndarray, "T C"], rest: Float[np.ndarray, " C"]) -> None:
        """Add a channel unless it keeps the node's own value; one that keeps another value has one key."""
        same = SAME * np.maximum(np.abs(rest), 1.0)
        if not np.isfinite(values).all() or (np.abs(values - rest) <= same).all():
            return
        if (np.abs(values - values[0]) <= same).all():
            values = values[:1]
        self.channels.append(AnimationChannel(node, path, self.seconds[: len(values)], values))
