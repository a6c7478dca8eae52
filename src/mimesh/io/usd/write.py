"""Write a Mesh or Clip as a new USD file: one Mesh prim with polygons, its points as time samples.

    /root (Xform, the default prim)
        <name of the mesh> (Mesh)
            <name of a part> (GeomSubset)
        materials (Scope)
            <name of a material> (Material)

Time code k is frame k. Frames are saved in blocks, so that memory does not grow with their number. Text (.usda) is
exported from a temporary binary file, because a text layer stays in memory until it is saved.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Sdf, Usd, UsdGeom, Vt

from ...core.frame_buffer import PAGED, Progress, each_frame
from ...core.geometry import normal_turner
from ...core.mesh import Clip, Mesh
from ..atomic import scratch_folder
from ..polygons import polygon_corners, polygon_sizes, smooth_normals
from .package import pack
from .source import UsdSource
from .stage import DEFAULT_TIME
from .write_material import PrimNames, add_subsets, set_display_name

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

FACE_VARYING = UsdGeom.Tokens.faceVarying
NormalFunction = Callable[[Float[np.ndarray, "V 3"]], Float[np.ndarray, "N 3"]]
"""Maps the vertices of a frame to the normals that are written for it."""


def write_new(clip: Clip, path: Path, final: Path, progress: Progress | None = None) -> None:
    """Write a clip at the temporary `path`, which the caller renames to `final` in the same folder.

    A clip of one frame is written at the default time, without time samples. The stage has y up and metres unless the
    mesh came from a USD file: then that file's axis and unit. Textures go into the package (.usdz), else into the
    folder `<stem>_textures` beside the file. Normals, where the mesh has any, rotate with the surface. Numbers are
    float32. A point cloud becomes a Mesh prim without faces.
    """
    textures = final.parent / f"{final.stem}_textures"
    suffix = path.suffix.lower()
    if suffix in (".usd", ".usdc"):
        _write_binary(clip, path, textures, f"./{textures.name}", progress)
        return
    with scratch_folder(path.parent) as folder:
        binary = folder / f"{final.stem}.usdc"
        if suffix == ".usdz":
            packed_textures = folder / "textures"
            _write_binary(clip, binary, packed_textures, f"./{packed_textures.name}", progress)
            images = sorted(f"{packed_textures.name}/{image.name}" for image in packed_textures.glob("*"))
            pack(folder, [binary.name, *images], path)
        else:
            _write_binary(clip, binary, textures, f"./{textures.name}", progress)
            Sdf.Layer.FindOrOpen(str(binary)).Export(str(path))


def _write_binary(clip: Clip, path: Path, textures: Path, asset_folder: str, progress: Progress | None) -> None:
    """Write the stage of the module docstring as .usdc; asset paths refer to `textures` as `asset_folder`."""
    stage = Usd.Stage.CreateNew(str(path))
    _set_metadata(stage, clip)
    root = UsdGeom.Xform.Define(stage, "/root")
    stage.SetDefaultPrim(root.GetPrim())
    names = PrimNames(root.GetPath())
    scope = UsdGeom.Scope.Define(stage, names.path("materials"))
    usd_mesh = UsdGeom.Mesh.Define(stage, names.path(clip.mesh.name))
    set_display_name(usd_mesh.GetPrim(), clip.mesh.name)
    sizes = polygon_sizes(clip.mesh)
    corner_at = polygon_corners(sizes) if len(sizes) else np.zeros(0, np.int64)
    _set_faces(usd_mesh, clip.mesh, sizes, corner_at)
    add_subsets(clip.mesh, sizes, usd_mesh.GetPrim(), PrimNames(scope.GetPath()), textures, asset_folder)
    _set_frames(usd_mesh, clip, _normal_function(usd_mesh, clip.mesh, corner_at), progress)
    stage.GetRootLayer().Save()


def _set_metadata(stage: Usd.Stage, clip: Clip) -> None:
    source = clip.mesh.source
    from_usd = isinstance(source, UsdSource)
    UsdGeom.SetStageUpAxis(stage, source.up_axis if from_usd else UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, source.meters_per_unit if from_usd else 1.0)
    stage.SetTimeCodesPerSecond(clip.fps)
    stage.SetFramesPerSecond(clip.fps)
    if len(clip) > 1:
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(len(clip) - 1)


def _set_faces(
    usd_mesh: UsdGeom.Mesh, mesh: Mesh, sizes: Int[np.ndarray, " P"], corner_at: Int[np.ndarray, " C"]
) -> None:
    """Write polygons and texture coordinates; equal coordinates are stored once and indexed."""
    usd_mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    usd_mesh.CreateFaceVertexCountsAttr(_integers(sizes))
    usd_mesh.CreateFaceVertexIndicesAttr(_integers(mesh.faces.reshape(-1)[corner_at]))
    if mesh.corner_uv is not None:
        uv, index = np.unique(mesh.corner_uv.reshape(-1, 2)[corner_at], axis=0, return_inverse=True)
        primvar = UsdGeom.PrimvarsAPI(usd_mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, FACE_VARYING)
        primvar.Set(Vt.Vec2fArray.FromNumpy(uv.astype(np.float32)))
        primvar.SetIndices(_integers(index.reshape(-1)))


def _set_frames(usd_mesh: UsdGeom.Mesh, clip: Clip, normals: NormalFunction | None, progress: Progress | None) -> None:
    """Write points, extent and normals of every frame, and release them from memory every `PAGED` frames."""
    layer = usd_mesh.GetPrim().GetStage().GetRootLayer()
    for number, vertices in enumerate(each_frame(clip.vertices, progress)):
        time = Usd.TimeCode(number) if len(clip) > 1 else DEFAULT_TIME
        usd_mesh.GetPointsAttr().Set(_vectors(vertices), time)
        usd_mesh.GetExtentAttr().Set(_vectors(np.stack([vertices.min(axis=0), vertices.max(axis=0)])), time)
        if normals is not None:
            usd_mesh.GetNormalsAttr().Set(_vectors(normals(vertices)), time)
        if number % PAGED == PAGED - 1:
            layer.Save()


def _normal_function(usd_mesh: UsdGeom.Mesh, mesh: Mesh, corner_at: Int[np.ndarray, " C"]) -> NormalFunction | None:
    """Return the function that computes the normals of a frame, and set their interpolation; None without normals.

    Normals are written per vertex where all corners of each vertex share one, else per polygon corner (faceVarying).
    """
    if mesh.corner_normals is None or not len(mesh.faces):
        return None
    rotated_normals = normal_turner(mesh.corner_normals, mesh.faces, mesh.vertices)
    vertex_of = mesh.faces.ravel()
    corner_of_vertex = np.full(len(mesh.vertices), -1)  # any corner of each vertex, -1 for a vertex without faces
    corner_of_vertex[vertex_of] = np.arange(len(vertex_of))
    is_smooth = smooth_normals(mesh) is not None
    usd_mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex if is_smooth else FACE_VARYING)

    def frame_normals(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "N 3"]:
        normals = rotated_normals(vertices).reshape(-1, 3)
        if not is_smooth:
            return normals[corner_at]
        return np.where(corner_of_vertex[:, None] >= 0, normals[corner_of_vertex], [0.0, 1.0, 0.0])

    return frame_normals


def _integers(values: np.ndarray) -> Vt.IntArray:
    return Vt.IntArray.FromNumpy(values.astype(np.int32))


def _vectors(values: Float[np.ndarray, "N 3"]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(values.astype(np.float32))
