"""Read a USD stage as a mesh, or frame by frame, in world coordinates.

This runs in a child process (`child_process.child_result`): the library ends the process at some damage (an abort or a
segmentation fault), and for some files it never ends.

Points come from time samples, blend shapes, linear blend skinning by UsdSkel, and the transforms of prims.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils

from ...core.budgets import check_clip_size
from ...core.errors import InputError, damaged
from ...core.frame_buffer import Progress
from ...core.geometry import normal_turner, unit_vectors
from ...core.mesh import Material, Mesh, Part
from ..beside import confining_folder, may_be_read
from ..mtl import image_suffix
from ..polygons import fan_corners, joined_corners, with_face_normals
from ..timing import LONGEST, frame_count
from . import UsdSource, hand_over_clip, hand_over_mesh

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

ALL_PRIMS = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
"""Traversal predicate: active, defined, loaded prims that are not abstract, including those inside instances."""
DEFAULT_TIME = Usd.TimeCode.Default()
"""The time of values that are authored without a time code."""
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
    """
    with _opened(source) as (stage, mesh_prims):
        hand_over_mesh(target, _join_prims(stage, mesh_prims, source))


def read_clip(source: Path, target: Path, fps: float | None, progress: Progress) -> None:
    """Read the meshes of a stage as a clip, a frame per time code from the first to the last, and hand it over.

    With `fps`, frame k is k / fps seconds after the first time code instead; USD interpolates between samples. A stage
    in which nothing moves is one frame. Prims and coordinates as in `read_mesh`.
    """
    with _opened(source) as (stage, mesh_prims):
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
def _opened(path: Path) -> Iterator[tuple[Usd.Stage, list[MeshPrim]]]:
    """Open the stage of a file with all its payloads, and find its meshes; errors of the library become InputErrors.

    USD reads values lazily, so an error may come long after the stage was opened: the whole read runs in this block.
    """
    check_package(path)
    try:
        if confining_folder() is not None:
            _check_references(path)
        stage = Usd.Stage.Open(str(path))
        yield stage, find_skinning(stage, shown_meshes(stage, path))
    except Tf.ErrorException as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        found = lines[0].rpartition(" : ")[2] if lines else "nothing"
        if "bad_alloc" in found:
            raise MemoryError from error
        raise InputError(f"{path}: expected a USD stage, found {found}; export it again") from error


def check_package(path: Path) -> None:
    """Check the checksums of the files in a package, which the library does not; other files pass."""
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
    start, stop = time_code_range(stage, mesh_prims, path)
    codes = stage.GetTimeCodesPerSecond()
    if not codes > 0:
        raise InputError(f"{path}: expected some time codes a second, found {codes:g}; set timeCodesPerSecond to 24")
    if (stop - start) / codes > LONGEST:
        raise InputError(
            f"{path}: expected at most {LONGEST:g} s, found time codes {start:g} to {stop:g} at {codes:g} a second; "
            "export a shorter range"
        )
    return start, (stop - start) / codes, codes


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
        for k, (mesh_prim, before, now) in enumerate(zip(mesh_prims, first_points, points, strict=True)):
            found = f"{len(now)} points after {len(before)}" if len(before) != len(now) else ""
            if k in varying and _topology(mesh_prim.prim, xforms.GetTime()) != topologies[k]:
                found = "other faces"
            if found:
                raise InputError(
                    f"{path}: expected one topology for the whole clip, found {found} in frame {frame} of "
                    f"{mesh_prim.prim.GetPath()}; export without changing topology"
                )
        yield np.concatenate(points)


def _topology(prim: Usd.Prim, time: Usd.TimeCode):
    mesh = UsdGeom.Mesh(prim)
    return mesh.GetFaceVertexCountsAttr().Get(time), mesh.GetFaceVertexIndicesAttr().Get(time)


def _join_prims(stage: Usd.Stage, mesh_prims: list[MeshPrim], path: Path) -> Mesh:
    """Join all prims at the time of the rest shape to one Mesh with its source."""
    at_default_time = all(has_default_values(mesh_prim.prim) for mesh_prim in mesh_prims)
    first = time_code_range(stage, mesh_prims, path)[0]
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
    counts, corners = (np.array(value or [], np.int64) for value in _topology(prim, time))
    if (counts < 0).any() or counts.sum() != len(corners):
        expected = f"as many face vertices in {prim.GetPath()} as its faces have corners ({counts.sum()})"
        raise damaged(path, expected, len(corners))
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
    return normal_turner(normals, faces, bind)(vertices)


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
        # PNG or JPEG, also inside a package; other formats and missing files are left out.
        asset = _input_value(image, "file", None)
        place = Ar.ResolvedPath(asset.resolvedPath) if asset and asset.resolvedPath else None
        opened = Ar.GetResolver().OpenAsset(place) if place else None
        content = bytes(opened.GetBuffer()) if opened else b""
        texture = content if image_suffix(content) else None
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


def shown_meshes(stage: Usd.Stage, path: Path) -> list[Usd.Prim]:
    """Find the Mesh prims that have points, are visible and of purpose default or render, in stage order.

    Visibility is that of the stage's first time code. Meshes below point instancers are left out: they are prototypes,
    shown only where the instancer places them.
    """
    time = Usd.TimeCode(stage.GetStartTimeCode())
    points = ((prim, UsdGeom.Mesh(prim).GetPointsAttr()) for prim in _visible(stage, time))
    shown = [prim for prim, of in points if of.Get(DEFAULT_TIME) or of.Get(Usd.TimeCode.EarliestTime())]
    if not shown:
        kinds = Counter(str(prim.GetTypeName()) or "untyped prim" for prim in stage.Traverse(ALL_PRIMS))
        found = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(6)) or "no prims"
        # An unresolved reference is the usual reason for an empty stage, so the first one is quoted.
        errors = [str(error) for error in stage.GetCompositionErrors()]
        found += f" (and not: {errors[0].splitlines()[0][:200]})" if errors else ""
        raise InputError(
            f"{path}: expected a visible mesh of purpose default or render, found {found}; "
            "export the meshes, without instancing them by points"
        )
    return shown


def column_matrix(value) -> Float[np.ndarray, "4 4"]:
    """Convert a USD matrix, which multiplies row vectors (x' = x M), to one for column vectors (x' = M x)."""
    return np.array(value, np.float64).T


def transform_chain(prim: Usd.Prim) -> Iterator[UsdGeom.Xformable]:
    """Yield the prims whose transforms place a prim in the world, from the prim itself up to the root.

    It ends early at a prim that resets the transform stack: its ancestors have no effect.
    """
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            yield UsdGeom.Xformable(prim)
            if UsdGeom.Xformable(prim).GetResetXformStack():
                return
        prim = prim.GetParent()


def time_code_range(stage: Usd.Stage, mesh_prims: list[MeshPrim], path: Path) -> tuple[float, float]:
    """Return the first and last time code of a stage: as authored, else those of the samples of its meshes.

    Without samples nothing moves, and both are 0.
    """
    sample_times = [time for mesh_prim in mesh_prims for time in mesh_prim.sample_times()]
    if not sample_times:
        return 0.0, 0.0
    start, stop = min(sample_times), max(sample_times)
    if stage.HasAuthoredTimeCodeRange():
        start, stop = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not np.isfinite([start, stop]).all():
        raise InputError(f"{path}: expected finite time codes, found {start:g} to {stop:g}; export it again")
    return start, max(start, stop)


def has_default_values(prim: Usd.Prim) -> bool:
    """Return whether points, faces and transforms of a mesh prim all have values at the default time."""
    attributes = [op.GetAttr() for xform in transform_chain(prim) for op in xform.GetOrderedXformOps()]
    mesh = UsdGeom.Mesh(prim)
    attributes += [mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()]
    return all(attribute.Get(DEFAULT_TIME) is not None for attribute in attributes)


@dataclass(frozen=True, eq=False)
class MeshPrim:
    """A mesh prim with the skeleton, skin weights and blend shapes that deform it."""

    prim: Usd.Prim
    skeleton: UsdSkel.SkeletonQuery | None = None
    """The bound skeleton and its animation; None for a mesh without UsdSkel binding."""
    skinning: UsdSkel.SkinningQuery | None = None
    """Joint influences and blend shape mapping of the mesh; None for a mesh without UsdSkel binding."""
    blend_shapes: UsdSkel.BlendShapeQuery | None = None

    @property
    def is_skinned(self) -> bool:
        """Whether joints deform the mesh."""
        return self.skinning is not None and self.skinning.HasJointInfluences()

    @property
    def placing_prim(self) -> Usd.Prim:
        """The prim whose transform places the deformed points: UsdSkel takes that of the skeleton if there is one."""
        return self.skeleton.GetPrim() if self.skeleton is not None and self.is_skinned else self.prim

    def sample_times(self) -> list[float]:
        """Collect the time codes of all samples that move the points; empty for a mesh that does not move."""
        points = UsdGeom.Mesh(self.prim).GetPointsAttr()
        times = list(points.GetTimeSamples()) if points.ValueMightBeTimeVarying() else []
        for xform in transform_chain(self.placing_prim):
            times += xform.GetTimeSamples() if xform.TransformMightBeTimeVarying() else []
        animation = self.skeleton.GetAnimQuery() if self.skeleton is not None else None
        if animation and self.is_skinned and animation.JointTransformsMightBeTimeVarying():
            times += animation.GetJointTransformTimeSamples()
        if animation and self.blend_shapes is not None and animation.BlendShapeWeightsMightBeTimeVarying():
            times += animation.GetBlendShapeWeightTimeSamples()
        return times

    def T_world_points(self, xforms: UsdGeom.XformCache) -> Float[np.ndarray, "4 4"]:
        """Return the transform from the frame of the deformed points to the world, at the time of `xforms`."""
        return column_matrix(xforms.GetLocalToWorldTransform(self.placing_prim))

    def T_world_bind(self, xforms: UsdGeom.XformCache) -> Float[np.ndarray, "4 4"]:
        """Return the transform from the frame of the authored points to the world, with all joints in bind pose."""
        T_world_points = self.T_world_points(xforms)
        if self.skinning is None or not self.is_skinned:
            return T_world_points
        return T_world_points @ column_matrix(self.skinning.GetGeomBindTransform(xforms.GetTime()))

    def points(self, xforms: UsdGeom.XformCache) -> Float[np.ndarray, "V 3"]:
        """Compute the world positions of the points at the time of `xforms`; empty where none are authored then.

        The order is that of UsdSkel: blend shapes in the frame of the authored points, then skinning, which takes the
        points to the skeleton's frame, then the transform to the world.
        """
        time = xforms.GetTime()
        points = UsdGeom.Mesh(self.prim).GetPointsAttr().Get(time)
        if not points:
            return np.zeros((0, 3))
        animation = self.skeleton.GetAnimQuery() if self.skeleton is not None else None
        weights = animation.ComputeBlendShapeWeights(time) if animation and self.blend_shapes is not None else None
        if weights and self.blend_shapes is not None and self.skinning is not None:
            # The animation may list blend shapes in another order than the mesh.
            mapper = self.skinning.GetBlendShapeMapper()
            self.blend_shapes.ComputeDeformedPoints(  # with their in-betweens; changes `points` in place
                *self.blend_shapes.ComputeSubShapeWeights(mapper.Remap(weights) if mapper else weights),
                self.blend_shapes.ComputeBlendShapePointIndices(),
                self.blend_shapes.ComputeSubShapePointOffsets(),
                points,
            )
        if self.skeleton is not None and self.skinning is not None and self.is_skinned:
            joint_transforms = self.skeleton.ComputeSkinningTransforms(time)
            self.skinning.ComputeSkinnedPoints(joint_transforms, points, time)  # changes `points` in place
        return transform_points(self.T_world_points(xforms), np.array(points, np.float64))


def find_skinning(stage: Usd.Stage, prims: list[Usd.Prim]) -> list[MeshPrim]:
    """Return each mesh prim with the skeleton, skinning and blend shapes that UsdSkel binds to it."""
    cache = UsdSkel.Cache()
    bindings = {}
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), ALL_PRIMS):
        # UsdSkel binds skeletons only to meshes below a SkelRoot.
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, ALL_PRIMS)
            for binding in cache.ComputeSkelBindings(root, ALL_PRIMS):
                skeleton = cache.GetSkelQuery(binding.GetSkeleton())
                for skinning in binding.GetSkinningTargets():
                    bindings[skinning.GetPrim().GetPath()] = (skeleton, skinning)
    mesh_prims = []
    for prim in prims:
        skeleton, skinning = bindings.get(prim.GetPath(), (None, None))
        has_blend_shapes = skinning is not None and skinning.HasBlendShapes()
        blend_shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim)) if has_blend_shapes else None
        mesh_prims.append(MeshPrim(prim, skeleton, skinning, blend_shapes))
    return mesh_prims


def transform_points(transform: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Apply an affine transform (of column vectors) to points."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def _check_references(path: Path) -> None:
    """Check every layer, payload, clip and asset that a file refers to, directly or not, before any of them is opened.

    Opening a stage opens all of them, so a file of a stranger could otherwise read any file of this machine. References
    to files that do not exist are harmless and pass.
    """
    pending, visited = [str(path)], set()
    while pending:
        layer = Sdf.Layer.FindOrOpen(pending.pop())
        if layer is None or layer.identifier in visited:
            continue
        visited.add(layer.identifier)
        for name in filter(None, itertools.chain(*UsdUtils.ExtractExternalReferences(layer.identifier))):
            found = Ar.GetResolver().Resolve(layer.ComputeAbsolutePath(name)).GetPathString()
            # A file inside a package resolves to "package.usdz[file]": the file to check is the package.
            file = Ar.SplitPackageRelativePathOuter(found)[0] if found else ""
            if file and not may_be_read(file):
                raise InputError(
                    f"{path}: expected the names of files that came with it, found {name[:80]!r}; give them together"
                )
            if (
                file and Sdf.FileFormat.FindByExtension(found.rstrip("]")) is not None
            ):  # "a.usdz[b.usda]" is a layer, too
                pending.append(found)


def _visible(stage: Usd.Stage, time: Usd.TimeCode) -> Iterator[Usd.Prim]:
    """Yield the Mesh prims that are visible at a time and meant for rendering."""
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot(), ALL_PRIMS))
    for prim in prims:
        # An invisible prim hides all of its descendants.
        shown = UsdGeom.Imageable(prim)
        hidden = prim.IsA(UsdGeom.Imageable) and shown.GetVisibilityAttr().Get(time) == UsdGeom.Tokens.invisible
        if hidden or prim.IsA(UsdGeom.PointInstancer):
            prims.PruneChildren()
        elif prim.IsA(UsdGeom.Mesh) and shown.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render):
            yield prim
