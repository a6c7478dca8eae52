"""A new USD file for a Mesh or Clip: one mesh prim, its points as time samples, polygons whole.

    /root (Xform, the default prim)
        <name of the mesh> (Mesh)
            <name of a part> (GeomSubset)
        materials (Scope)
            <name of a material> (Material)

Time code k is frame k. Frames are saved in blocks, so that memory does not grow with their number. Text is exported
from a binary file, because layers of text are held in memory until they are saved.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Sdf, Usd, UsdGeom, Vt

from ...core.frame_buffer import PAGED, Progress, each_frame
from ...core.geometry import normal_turner
from ...core.mesh import Clip, Mesh
from ..polygons import polygon_corners, polygon_sizes
from .material import Names, add_parts, call
from .package import pack
from .source import UsdSource
from .stage import REST

# usd-core tells type checkers nothing of what is in it.
# pyright: reportAttributeAccessIssue=false

AT_CORNERS = UsdGeom.Tokens.faceVarying
Normals = Callable[[Float[np.ndarray, "V 3"]], Float[np.ndarray, "N 3"]]
"""From moved points to the normals to be written."""


def write_new(clip: Clip, path: Path, final: Path, progress: Progress | None = None) -> None:
    """Write a clip at `path`, to be renamed to `final` in the same folder; one frame is written without time.

    Stages have y up and metres unless the mesh came from a USD file, whose axis and unit they then have. Textures go
    into a package, or beside other files into the folder `<stem>_textures`. Normals are written where the mesh has any,
    and turn along with the surface. Numbers are float32. A mesh without faces is a Mesh prim without faces.
    """
    textures = final.parent / f"{final.stem}_textures"
    suffix = path.suffix.lower()
    if suffix in (".usd", ".usdc"):
        _write_binary(clip, path, textures, f"./{textures.name}", progress)
        return
    with tempfile.TemporaryDirectory(prefix=".usd-", dir=path.parent) as folder:
        binary = Path(folder) / f"{final.stem}.usdc"
        if suffix == ".usdz":
            inside = Path(folder) / "textures"
            _write_binary(clip, binary, inside, f"./{inside.name}", progress)
            images = sorted(f"{inside.name}/{image.name}" for image in inside.glob("*"))
            pack(Path(folder), [binary.name, *images], path)
        else:
            _write_binary(clip, binary, textures, f"./{textures.name}", progress)
            Sdf.Layer.FindOrOpen(str(binary)).Export(str(path))


def _write_binary(clip: Clip, path: Path, textures: Path, shown: str, progress: Progress | None) -> None:
    stage = Usd.Stage.CreateNew(str(path))
    _set_metadata(stage, clip)
    root = UsdGeom.Xform.Define(stage, "/root")
    stage.SetDefaultPrim(root.GetPrim())
    names = Names(root.GetPath())
    scope = UsdGeom.Scope.Define(stage, names.path("materials"))
    made = UsdGeom.Mesh.Define(stage, names.path(clip.mesh.name))
    call(made.GetPrim(), clip.mesh.name)
    sizes = polygon_sizes(clip.mesh)
    corner_at = polygon_corners(sizes) if len(sizes) else np.zeros(0, np.int64)
    _set_faces(made, clip.mesh, sizes, corner_at)
    add_parts(clip.mesh, sizes, made.GetPrim(), Names(scope.GetPath()), textures, shown)
    _set_frames(made, clip, _normals(made, clip.mesh, corner_at), progress)
    stage.GetRootLayer().Save()


def _set_metadata(stage: Usd.Stage, clip: Clip) -> None:
    source = clip.mesh.source
    own = isinstance(source, UsdSource)
    UsdGeom.SetStageUpAxis(stage, source.up_axis if own else UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, source.meters_per_unit if own else 1.0)
    stage.SetTimeCodesPerSecond(clip.fps)
    stage.SetFramesPerSecond(clip.fps)
    if len(clip) > 1:
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(len(clip) - 1)


def _set_faces(made: UsdGeom.Mesh, mesh: Mesh, sizes: Int[np.ndarray, " P"], corner_at: Int[np.ndarray, " C"]) -> None:
    """Polygons and their texture coordinates."""
    made.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    made.CreateFaceVertexCountsAttr(_integers(sizes))
    made.CreateFaceVertexIndicesAttr(_integers(mesh.faces.reshape(-1)[corner_at]))
    if mesh.corner_uv is not None:
        uv, index = np.unique(mesh.corner_uv.reshape(-1, 2)[corner_at], axis=0, return_inverse=True)
        primvar = UsdGeom.PrimvarsAPI(made).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, AT_CORNERS)
        primvar.Set(Vt.Vec2fArray.FromNumpy(uv.astype(np.float32)))
        primvar.SetIndices(_integers(index.reshape(-1)))


def _set_frames(made: UsdGeom.Mesh, clip: Clip, normals: Normals | None, progress: Progress | None) -> None:
    layer = made.GetPrim().GetStage().GetRootLayer()
    for number, vertices in enumerate(each_frame(clip.vertices, progress)):
        time = Usd.TimeCode(number) if len(clip) > 1 else REST
        made.GetPointsAttr().Set(_vectors(vertices), time)
        made.GetExtentAttr().Set(_vectors(np.stack([vertices.min(axis=0), vertices.max(axis=0)])), time)
        if normals is not None:
            made.GetNormalsAttr().Set(_vectors(normals(vertices)), time)
        if number % PAGED == PAGED - 1:
            layer.Save()


def _normals(made: UsdGeom.Mesh, mesh: Mesh, corner_at: Int[np.ndarray, " C"]) -> Normals | None:
    """One for each vertex if it has but one, else one for each corner of the polygons; None where there are none."""
    if mesh.corner_normals is None or not len(mesh.faces):
        return None
    turned = normal_turner(mesh.corner_normals, mesh.faces, mesh.vertices)
    rest, vertex_of = mesh.corner_normals.reshape(-1, 3), mesh.faces.ravel()
    corner = np.full(len(mesh.vertices), -1)
    corner[vertex_of] = np.arange(len(vertex_of))
    smooth = bool((rest[corner[vertex_of]] == rest).all())
    made.SetNormalsInterpolation(UsdGeom.Tokens.vertex if smooth else AT_CORNERS)

    def at(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "N 3"]:
        normals = turned(vertices).reshape(-1, 3)
        return np.where(corner[:, None] >= 0, normals[corner], [0.0, 1.0, 0.0]) if smooth else normals[corner_at]

    return at


def _integers(values: np.ndarray) -> Vt.IntArray:
    return Vt.IntArray.FromNumpy(values.astype(np.int32))


def _vectors(values: Float[np.ndarray, "N 3"]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(values.astype(np.float32))
