"""Read a USD stage as a mesh, or frame by frame, in world coordinates.

This runs in a child process (`child_process.child_result`): the library ends the process at some damage (an abort or a
segmentation fault), and for some files it never ends.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdShade

from ...core.budgets import check_clip_size
from ...core.errors import InputError, damaged
from ...core.frame_buffer import Progress
from ...core.geometry import turn_normals, unit_vectors
from ...core.mesh import Material, Mesh, Part
from ..guarded import hand_over_clip, hand_over_mesh
from ..mtl import image_suffix
from ..polygons import fan_corners, joined_corners, with_face_normals
from ..timing import LONGEST, frame_count
from .source import UsdSource
from .stage import (
    ALL_PRIMS,
    DEFAULT_TIME,
    MeshPrim,
    find_skinning,
    has_default_values,
    open_stage,
    shown_meshes,
    time_code_range,
    transform_points,
)

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

MaterialCache = dict[Sdf.Path, Material]
"""Materials of the stage by prim path, so that each is read once."""
DEFAULT_DIFFUSE = (0.18, 0.18, 0.18)
"""Linear RGB; default of `diffuseColor` in the UsdPreviewSurface specification."""


def read_mesh(source: Path, target: Path) -> None:
    """Read all visible, renderable Mesh prims of a stage as one mesh, joined in stage order, and hand it over.

    Instances are read with their transforms. Point instancers, curves and points are not read; of a subdivision surface
    the control mesh is read. Axes and unit are the file's (z up stays z up). Skinning and blend shapes are applied. The
    time is the default time where all meshes have values then, else the first time code. Polygons become triangle fans,
    material subsets or prims become parts.

    Raises:
        InputError: the file is damaged, or has no visible meshes.
    """
    with _reading(source):
        stage = open_stage(source)
        mesh = _join_prims(stage, find_skinning(stage, shown_meshes(stage, source)), source)
        hand_over_mesh(target, mesh)


def read_clip(source: Path, target: Path, fps: float | None, progress: Progress) -> None:
    """Read the meshes of a stage as a clip, a frame per time code from the first to the last, and hand it over.

    With `fps`, frame k is k / fps seconds after the first time code instead; USD interpolates between samples. A stage
    in which nothing moves is one frame. Prims and coordinates as in `read_mesh`.

    Raises:
        InputError: as `read_mesh`; faces or number of points change over time; longer than `timing.LONGEST`.
    """
    with _reading(source):
        stage = open_stage(source)
        mesh_prims = find_skinning(stage, shown_meshes(stage, source))
        mesh = _join_prims(stage, mesh_prims, source)
        start, seconds, codes = _time_range(stage, mesh_prims, source)
        count, step = frame_count(seconds, fps or codes), codes / (fps or codes)
        check_clip_size(count, len(mesh.vertices), source)
        time_codes = [start + k * step for k in range(count)]
        frames = _frames(stage, mesh_prims, time_codes, source)
        first = next(frames)
        frames = itertools.chain([first], frames)
        hand_over_clip(target, mesh.with_vertices(first), frames, count, fps or codes, progress)


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn errors of the library into an InputError of one line.

    USD reads values lazily, so an error may come long after the stage was opened: the whole read runs in this block.
    """
    check_package(path)
    try:
        yield
    except Tf.ErrorException as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        found = lines[0].rpartition(" : ")[2] if lines else "nothing"
        if "bad_alloc" in found:
            raise MemoryError from error
        raise InputError(f"{path}: expected a USD stage, found {found}; export it again") from error


def check_package(path: Path) -> None:
    """Check the checksums of the files in a package, which the library does not; other files pass.

    Raises:
        InputError: the file is no zip archive, its files are compressed, or one has another checksum.
    """
    if path.suffix.lower() != ".usdz":
        return
    try:
        with zipfile.ZipFile(path) as package:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in package.infolist()):
                raise zipfile.BadZipFile("compressed files in it")
            broken = package.testzip()
    except (zipfile.BadZipFile, EOFError, RuntimeError, NotImplementedError, ValueError) as error:
        raise InputError(f"{path}: expected a .usdz package, found {error}; export it again") from error
    if broken is not None:
        raise damaged(path, f"the checksum of {broken[:80]!r} in it", "another")


def _time_range(stage: Usd.Stage, mesh_prims: list[MeshPrim], path: Path) -> tuple[float, float, float]:
    """Return the first time code of a stage, its duration in seconds, and its time codes a second."""
    start, stop = time_code_range(stage, _samples(mesh_prims), path)
    codes = stage.GetTimeCodesPerSecond()
    if not codes > 0:
        raise InputError(f"{path}: expected some time codes a second, found {codes:g}; set timeCodesPerSecond to 24")
    if (stop - start) / codes > LONGEST:
        raise InputError(
            f"{path}: expected at most {LONGEST:g} s, found time codes {start:g} to {stop:g} at {codes:g} a second; "
            "export a shorter range"
        )
    return start, (stop - start) / codes, codes


def _samples(mesh_prims: list[MeshPrim]) -> list[float]:
    return [time for mesh_prim in mesh_prims for time in mesh_prim.sample_times()]


def _frames(
    stage: Usd.Stage, mesh_prims: list[MeshPrim], time_codes: list[float], path: Path
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the joined world positions of all prims at each time code; prims that do not move are evaluated once.

    The stage is an argument because its prims are gone when nothing refers to it any more.
    """
    xforms = UsdGeom.XformCache(Usd.TimeCode(time_codes[0]))
    moves = [bool(mesh_prim.sample_times()) for mesh_prim in mesh_prims]
    first_points = [mesh_prim.points(xforms) for mesh_prim in mesh_prims]
    topologies = [_topology(mesh_prim.prim, Usd.TimeCode(time_codes[0])) for mesh_prim in mesh_prims]
    varying = [
        k
        for k, mesh in enumerate(UsdGeom.Mesh(mesh_prim.prim) for mesh_prim in mesh_prims)
        if mesh.GetFaceVertexCountsAttr().ValueMightBeTimeVarying()
        or mesh.GetFaceVertexIndicesAttr().ValueMightBeTimeVarying()
    ]
    for frame, time_code in enumerate(time_codes):
        xforms.SetTime(Usd.TimeCode(time_code))
        points = [mesh_prim.points(xforms) if moves[k] else first_points[k] for k, mesh_prim in enumerate(mesh_prims)]
        for k in varying:
            if _topology(mesh_prims[k].prim, xforms.GetTime()) != topologies[k]:
                raise _topology_error(path, mesh_prims[k].prim, frame, "other faces")
        for mesh_prim, before, now in zip(mesh_prims, first_points, points, strict=True):
            if len(before) != len(now):
                raise _topology_error(path, mesh_prim.prim, frame, f"{len(now)} points after {len(before)}")
        yield np.concatenate(points)


def _topology_error(path: Path, prim: Usd.Prim, frame: int, found: str) -> InputError:
    return InputError(
        f"{path}: expected one topology for the whole clip, found {found} in frame {frame} of {prim.GetPath()}; "
        "export without changing topology"
    )


def _topology(prim: Usd.Prim, time: Usd.TimeCode):
    mesh = UsdGeom.Mesh(prim)
    return mesh.GetFaceVertexCountsAttr().Get(time), mesh.GetFaceVertexIndicesAttr().Get(time)


def _join_prims(stage: Usd.Stage, mesh_prims: list[MeshPrim], path: Path) -> Mesh:
    """Join all prims at the time of the rest shape to one Mesh with its source."""
    at_default_time = all(has_default_values(mesh_prim.prim) for mesh_prim in mesh_prims)
    first = time_code_range(stage, _samples(mesh_prims), path)[0]
    xforms = UsdGeom.XformCache(DEFAULT_TIME if at_default_time else Usd.TimeCode(first))
    materials: MaterialCache = {}
    meshes, sizes = zip(*(_read_prim(mesh_prim, xforms, materials, path) for mesh_prim in mesh_prims), strict=True)
    mesh = _concatenate(meshes, path.stem)
    source = UsdSource(
        suffix=path.suffix.lower(),
        sizes=np.concatenate(sizes),
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        meters_per_unit=float(UsdGeom.GetStageMetersPerUnit(stage)),
        notes=_writing_notes(stage, mesh_prims),
    )
    # A stage without this metadatum counts as y up, but says nothing about what its exporter did.
    authored = stage.HasAuthoredMetadata(UsdGeom.Tokens.upAxis)
    return dataclasses.replace(mesh, source=source, up=f"+{source.up_axis.lower()}" if authored else None)


def _concatenate(meshes: Sequence[Mesh], name: str) -> Mesh:
    """Concatenate meshes to one of the given name, with shifted vertex indices and face ranges of parts."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes]).tolist()
    face_starts = np.cumsum([0] + [len(mesh.faces) for mesh in meshes]).tolist()
    counts = [len(mesh.faces) for mesh in meshes]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    normals = joined_corners([mesh.corner_normals for mesh in meshes], counts)
    return Mesh(
        vertices,
        faces,
        name=name,
        corner_uv=joined_corners([mesh.corner_uv for mesh in meshes], counts),
        # Prims without authored normals among prims with them get those of their faces.
        corner_normals=None if normals is None else with_face_normals(normals, vertices, faces),
        parts=tuple(
            dataclasses.replace(part, start=part.start + start, stop=part.stop + start)
            for mesh, start in zip(meshes, face_starts, strict=False)
            for part in mesh.parts
        ),
    )


def _writing_notes(stage: Usd.Stage, mesh_prims: list[MeshPrim]) -> tuple[str, ...]:
    """List what a new file of the meshes of a stage will lack, one line each; other prims are not listed."""
    counts = {
        "skin or blend shapes": sum(mesh_prim.skinning is not None for mesh_prim in mesh_prims),
        "animation": sum(bool(mesh_prim.sample_times()) for mesh_prim in mesh_prims),
    }
    notes = [f"dropped the {what} of {count} of {len(mesh_prims)} meshes" for what, count in counts.items() if count]
    instancers = sum(prim.IsA(UsdGeom.PointInstancer) for prim in stage.Traverse(ALL_PRIMS))
    notes += [f"left out {instancers} point instancer{'s' * (instancers > 1)}"] * bool(instancers)
    return tuple(notes)


def _read_prim(
    mesh_prim: MeshPrim, xforms: UsdGeom.XformCache, materials: MaterialCache, path: Path
) -> tuple[Mesh, Int[np.ndarray, " P"]]:
    """Read a prim in world coordinates at the time of `xforms`, sorted by part, and the corners of each polygon."""
    prim, time = mesh_prim.prim, xforms.GetTime()
    counts, corners = _polygons(prim, time, path)
    vertices = mesh_prim.points(xforms)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        worst = int(corners.max() if corners.max() >= len(vertices) else corners.min())
        raise damaged(path, f"points 0..{len(vertices) - 1} in the faces of {prim.GetPath()}", worst)
    binding_prims, labels = _material_subsets(prim, len(counts), path)
    order = _shown_polygons(prim, counts, labels)
    # Faces come out counter-clockwise seen from outside: left-handed orientation and a mirroring transform each
    # reverse the winding, and both together leave it.
    is_mirrored = bool(np.linalg.det(mesh_prim.T_world_bind(xforms)[:3, :3]) < 0)
    left_handed = UsdGeom.Mesh(prim).GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    corner_of, polygon = _fans(counts, order, is_mirrored != left_handed)
    faces = corners[corner_of]
    polygon_of = np.repeat(np.arange(len(counts)), counts)  # polygon of each corner in `faceVertexIndices`
    uv = _primvar_values(prim, _uv_primvar_name(binding_prims), 2)
    what = f"{path}: texture coordinates of {prim.GetPath()}"
    mesh = Mesh(
        vertices,
        faces,
        corner_uv=None if uv is None else _corner_values(*uv, corners, polygon_of, what)[corner_of],
        corner_normals=_normals(mesh_prim, xforms, vertices, faces, corners, polygon_of, corner_of, path),
        parts=_parts(binding_prims, labels[polygon], materials),
    )
    return mesh, counts[order]


def _polygons(prim: Usd.Prim, time: Usd.TimeCode, path: Path) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " C"]]:
    """Read the corner count of each polygon and the vertex index of each corner."""
    counts, corners = (np.array(value or [], np.int64) for value in _topology(prim, time))
    if (counts < 0).any() or counts.sum() != len(corners):
        expected = f"as many face vertices in {prim.GetPath()} as its faces have corners ({counts.sum()})"
        raise damaged(path, expected, len(corners))
    return counts, corners


def _shown_polygons(prim: Usd.Prim, counts, labels) -> Int[np.ndarray, " P"]:
    """Return the polygons to read: three corners or more and not a hole, sorted by part, parts by first appearance."""
    is_shown = counts > 2
    holes = np.array(UsdGeom.Mesh(prim).GetHoleIndicesAttr().Get() or [], np.int64)
    is_shown[holes[(holes >= 0) & (holes < len(counts))]] = False
    polygons = np.flatnonzero(is_shown)
    # Sorting by the first polygon of each part keeps the order in which the parts appear; stable within a part.
    used, first, part = np.unique(labels[polygons], return_index=True, return_inverse=True)
    return polygons[np.argsort(first[part.reshape(-1)], kind="stable")] if len(used) else polygons


def _fans(counts, order, flip: bool) -> tuple[Int[np.ndarray, "F 3"], Int[np.ndarray, " F"]]:
    """Triangulate the polygons `order` as fans; returns indices of the triangles' corners, and their polygons."""
    sizes = counts[order]
    step = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)  # 0, 1, 2, ... within each polygon
    if flip:
        step = -step % np.repeat(sizes, sizes)  # 0, n - 1, n - 2, ...: the first corner stays first
    triangles, polygon = fan_corners(sizes)
    flat = np.repeat((np.cumsum(counts) - counts)[order], sizes) + step
    return flat[triangles], order[polygon]


def _normals(mesh_prim: MeshPrim, xforms, vertices, faces, corners, polygon_of, corner_of, path):
    """Read the authored normals at the face corners, in world coordinates; None where the prim has none.

    Normals are authored for the bind pose: skinning and blend shapes then rotate them with the surface.
    """
    prim = mesh_prim.prim
    authored = _authored_normals(prim, xforms.GetTime())
    if authored is None:
        return None
    local = _corner_values(*authored, corners, polygon_of, f"{path}: normals of {prim.GetPath()}")[corner_of]
    T_world_bind = mesh_prim.T_world_bind(xforms)
    # Normals transform by the inverse transpose; the pseudo-inverse also serves transforms that flatten the mesh.
    normals = unit_vectors(local @ np.linalg.pinv(T_world_bind[:3, :3]))
    if mesh_prim.skinning is None:
        return normals
    bind = transform_points(
        T_world_bind, np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(xforms.GetTime()), np.float64)
    )
    return turn_normals(normals, faces, bind, vertices)


def _parts(binding_prims: list[Usd.Prim], labels: Int[np.ndarray, " F"], materials: MaterialCache) -> tuple[Part, ...]:
    """Return a part for each run of consecutive faces with equal labels."""
    ends = [*np.flatnonzero(np.diff(labels, prepend=-1)).tolist(), len(labels)]
    parts = []
    for start, stop in itertools.pairwise(ends):
        prim = binding_prims[labels[start]]
        bound = _bound_material(prim)
        if bound is not None and bound.GetPath() not in materials:
            materials[bound.GetPath()] = _read_material(bound)
        parts.append(Part(_display_name(prim), start, stop, bound and materials[bound.GetPath()]))
    return tuple(parts)


def _display_name(prim: Usd.Prim) -> str:
    """Return the display name of a prim if it has one, else the prim's name."""
    return prim.GetDisplayName() or prim.GetName()


def _material_subsets(prim: Usd.Prim, polygons: int, path: Path) -> tuple[list[Usd.Prim], Int[np.ndarray, " P"]]:
    """Return the prims that materials are bound to, and for each polygon the index of its prim among them.

    The first prim is the mesh itself, for polygons outside of all subsets; the others are its GeomSubsets of family
    materialBind. A polygon in several subsets belongs to the last of them.
    """
    binding_prims = [prim]
    labels = np.zeros(polygons, np.int64)
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        indices = np.array(subset.GetIndicesAttr().Get(Usd.TimeCode.EarliestTime()) or [], np.int64)
        if len(indices) and (indices.min() < 0 or indices.max() >= polygons):
            found = f"{indices.min()} to {indices.max()}"
            raise damaged(path, f"faces 0..{polygons - 1} in {subset.GetPath()}", found)
        labels[indices] = len(binding_prims)
        binding_prims.append(subset.GetPrim())
    return binding_prims, labels


def _bound_material(prim: Usd.Prim) -> UsdShade.Material | None:
    """Return the material bound to a prim, inherited bindings included; None where there is none."""
    return UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0] or None


def _read_material(bound: UsdShade.Material) -> Material:
    """Read diffuse colour, opacity and diffuse texture of a UsdPreviewSurface.

    The scale of a texture becomes the base colour that multiplies it. Of materials with another surface shader only the
    name is read.
    """
    surface = bound.ComputeSurfaceSource()[0]
    if not surface or surface.GetShaderId() != "UsdPreviewSurface":
        return Material(_display_name(bound.GetPrim()))
    color, texture = _input_value(surface, "diffuseColor", DEFAULT_DIFFUSE), None
    image = _diffuse_texture(surface)
    if image is not None:
        color = _input_value(image, "scale", (1.0, 1.0, 1.0, 1.0))
        texture = _read_asset(_input_value(image, "file", None))
    opacity = _input_value(surface, "opacity", 1.0)
    red, green, blue = (float(value) for value in color[:3])
    return Material(_display_name(bound.GetPrim()), (red, green, blue, float(opacity)), texture)


def _uv_primvar_name(binding_prims: list[Usd.Prim]) -> str:
    """Return the name of the primvar with the texture coordinates: the one that the first texture reads, else `st`.

    A UsdTransform2d between the primvar reader and the texture is skipped, not applied.
    """
    for prim in binding_prims:
        bound = _bound_material(prim)
        surface = bound.ComputeSurfaceSource()[0] if bound else None
        node = _diffuse_texture(surface) if surface else None
        # Walk from the texture upstream: `st` is the input of a texture, `in` that of a UsdTransform2d.
        while node is not None and not (node.GetShaderId() or "").startswith("UsdPrimvarReader"):
            node = _input_shader(node, "st") or _input_shader(node, "in")
        if node is not None and _input_value(node, "varname", None):
            return str(_input_value(node, "varname", None))
    return "st"


def _corner_values(
    values: Float[np.ndarray, "N C"],
    interpolation: str,
    corners: Int[np.ndarray, " K"],
    polygon: Int[np.ndarray, " K"],
    label: str,
) -> Float[np.ndarray, "K C"]:
    """Expand values of any USD interpolation to one value per polygon corner; `label` begins the error message."""
    if interpolation == UsdGeom.Tokens.faceVarying:
        index = np.arange(len(corners))
    elif interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
        index = corners
    else:
        index = polygon if interpolation == UsdGeom.Tokens.uniform else np.zeros(len(corners), np.int64)
    if len(index) and index.max() >= len(values):
        raise InputError(
            f"{label}: expected {index.max() + 1} values ({interpolation}), found {len(values)}; export it again"
        )
    return values[index]


def _primvar_values(prim: Usd.Prim, name: str, width: int) -> tuple[Float[np.ndarray, "N C"], str] | None:
    """Read the values of a primvar, its indices resolved, and their interpolation; None without any of that width."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return None
    # Blender 5.3 writes values without a time, and their indices as a time sample.
    attributes = [primvar.GetAttr(), *([primvar.GetIndicesAttr()] if primvar.IsIndexed() else [])]
    at_default = all(attribute.Get(DEFAULT_TIME) is not None for attribute in attributes)
    values = np.array(primvar.ComputeFlattened(DEFAULT_TIME if at_default else Usd.TimeCode.EarliestTime()), np.float64)
    return (values, primvar.GetInterpolation()) if values.ndim == 2 and values.shape[1] == width else None


def _authored_normals(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[Float[np.ndarray, "N 3"], str] | None:
    """Read the local normals of a mesh and their interpolation, `primvars:normals` first; None where it has none."""
    primvar = _primvar_values(prim, "normals", 3)
    if primvar is not None:
        return primvar
    attribute = UsdGeom.Mesh(prim).GetNormalsAttr()
    values = attribute.Get(time) or attribute.Get(Usd.TimeCode.EarliestTime())
    return (np.array(values, np.float64), UsdGeom.Mesh(prim).GetNormalsInterpolation()) if values else None


def _diffuse_texture(surface: UsdShade.Shader) -> UsdShade.Shader | None:
    """Return the UsdUVTexture connected to the diffuse colour of a surface."""
    node = _input_shader(surface, "diffuseColor")
    return node if node is not None and node.GetShaderId() == "UsdUVTexture" else None


def _input_shader(shader: UsdShade.Shader, name: str) -> UsdShade.Shader | None:
    """Return the shader connected to an input, directly or through node graphs; None where the input is a constant."""
    source = _producing_attribute(shader, name)
    is_output = source is not None and source.GetName().startswith("outputs:")
    return UsdShade.Shader(source.GetPrim()) if source is not None and is_output else None


def _input_value(shader: UsdShade.Shader, name: str, default):
    """Return the constant value of an input; the default where it is connected to a shader or not authored."""
    source = _producing_attribute(shader, name)
    if source is None or source.GetName().startswith("outputs:"):
        return default
    value = source.Get(Usd.TimeCode.EarliestTime())
    return default if value is None else value


def _producing_attribute(shader: UsdShade.Shader, name: str) -> Usd.Attribute | None:
    """Return the attribute that the value of an input comes from: a shader output or a constant."""
    shader_input = shader.GetInput(name)
    attributes = shader_input.GetValueProducingAttributes() if shader_input else []
    return attributes[0] if attributes else None


def _read_asset(asset: Sdf.AssetPath | None) -> bytes | None:
    """Read the PNG or JPEG file of an asset path, also inside a package; None for other formats and missing files."""
    opened = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(asset.resolvedPath)) if asset and asset.resolvedPath else None
    content = bytes(opened.GetBuffer()) if opened else b""
    return content if image_suffix(content) else None
