"""Write a Mesh or Clip as a new USD file: one Mesh prim with polygons, its points as time samples.

    /root (Xform, the default prim)
        <name of the mesh> (Mesh)
            <name of a part> (GeomSubset)
        materials (Scope)
            <name of a material> (Material)

Time code k is frame k. Frames are saved in blocks, so that memory does not grow with their number. Text (.usda) is
exported from a temporary binary file, because a text layer stays in memory until it is saved.

The first file of a package (.usdz) is the root layer.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, Vt

from ...core.errors import InputError
from ...core.frame_buffer import PAGED, Progress, each_frame
from ...core.geometry import normal_turner
from ...core.mesh import Clip, Material, Mesh
from ...core.printable import numbered
from ..atomic import scratch_folder
from ..mtl import write_image
from ..polygons import polygon_corners, polygon_sizes, smooth_normals

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

LARGEST = 2**31 - 1
"""Bytes in one package; larger archives need the zip64 extension, which the USDZ specification excludes."""
ROUGHNESS = 0.9
"""Roughness (0..1) of written materials: nearly matt, since `mesh.Material` has no gloss."""
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
            names = [binary.name, *images]  # the first one is the root layer
            size = sum((folder / name).stat().st_size for name in names)
            if size > LARGEST:
                found = f"{size / 2**30:.1f}"
                raise InputError(f"{path}: expected at most 2 GiB in a package, found {found}; write .usdc instead")
            with Sdf.ZipFileWriter.CreateNew(str(path)) as package:
                for name in names:
                    package.AddFile(str(folder / name), name)
        else:
            _write_binary(clip, binary, textures, f"./{textures.name}", progress)
            Sdf.Layer.FindOrOpen(str(binary)).Export(str(path))


def _write_binary(clip: Clip, path: Path, textures: Path, asset_folder: str, progress: Progress | None) -> None:
    """Write the stage of the module docstring as .usdc; asset paths refer to `textures` as `asset_folder`."""
    stage = Usd.Stage.CreateNew(str(path))
    source = clip.mesh.source
    UsdGeom.SetStageUpAxis(stage, getattr(source, "up_axis", UsdGeom.Tokens.y))  # only sources of USD know both
    UsdGeom.SetStageMetersPerUnit(stage, getattr(source, "meters_per_unit", 1.0))
    stage.SetTimeCodesPerSecond(clip.fps)
    stage.SetFramesPerSecond(clip.fps)
    if len(clip) > 1:
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(len(clip) - 1)
    root = UsdGeom.Xform.Define(stage, "/root")
    stage.SetDefaultPrim(root.GetPrim())
    names = _PrimNames(root.GetPath())
    scope = UsdGeom.Scope.Define(stage, names.path("materials"))
    usd_mesh = UsdGeom.Mesh.Define(stage, names.path(clip.mesh.name))
    _set_display_name(usd_mesh.GetPrim(), clip.mesh.name)
    sizes = polygon_sizes(clip.mesh)
    corner_at = polygon_corners(sizes) if len(sizes) else np.zeros(0, np.int64)
    usd_mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    usd_mesh.CreateFaceVertexCountsAttr(_integers(sizes))
    usd_mesh.CreateFaceVertexIndicesAttr(_integers(clip.mesh.faces.reshape(-1)[corner_at]))
    if clip.mesh.corner_uv is not None:  # equal coordinates are stored once and indexed
        uv, index = np.unique(clip.mesh.corner_uv.reshape(-1, 2)[corner_at], axis=0, return_inverse=True)
        primvar = UsdGeom.PrimvarsAPI(usd_mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, FACE_VARYING)
        primvar.Set(Vt.Vec2fArray.FromNumpy(uv.astype(np.float32)))
        primvar.SetIndices(_integers(index.reshape(-1)))
    _add_subsets(clip.mesh, sizes, usd_mesh.GetPrim(), _PrimNames(scope.GetPath()), textures, asset_folder)
    _set_frames(usd_mesh, clip, _normal_function(usd_mesh, clip.mesh, corner_at), progress)
    stage.GetRootLayer().Save()


def _set_frames(usd_mesh: UsdGeom.Mesh, clip: Clip, normals: NormalFunction | None, progress: Progress | None) -> None:
    """Write points, extent and normals of every frame, and release them from memory every `PAGED` frames."""
    layer = usd_mesh.GetPrim().GetStage().GetRootLayer()
    for number, vertices in enumerate(each_frame(clip.vertices, progress)):
        time = Usd.TimeCode(number) if len(clip) > 1 else Usd.TimeCode.Default()
        usd_mesh.GetPointsAttr().Set(_vectors(vertices), time)
        usd_mesh.GetExtentAttr().Set(_vectors(np.stack([vertices.min(axis=0), vertices.max(axis=0)])), time)
        if normals is not None:
            usd_mesh.GetNormalsAttr().Set(_vectors(normals(vertices)), time)
        if number % PAGED == PAGED - 1:
            layer.Save()


def _normal_function(usd_mesh: UsdGeom.Mesh, mesh: Mesh, corner_at: Int[np.ndarray, " C"]) -> NormalFunction | None:
    """Return what computes a frame's normals, one a vertex if smooth, else one a corner, and set that; None without."""
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


class _PrimNames:
    """Allocator of legal and unique prim names below one parent prim."""

    def __init__(self, parent: Sdf.Path) -> None:
        self.parent = parent
        self.taken: set[str] = set()

    def path(self, name: str) -> Sdf.Path:
        """Return a new child path for an object of any name: illegal characters replaced, a number added if taken."""
        unique = next(free for free in numbered(Tf.MakeValidIdentifier(name), "_") if free not in self.taken)
        self.taken.add(unique)
        return self.parent.AppendChild(unique)


def _set_display_name(prim: Usd.Prim, name: str) -> None:
    """Store a name as the prim's display name where it is not a legal or free prim name."""
    if prim.GetName() != name:
        prim.SetDisplayName(name)


def _add_subsets(
    mesh: Mesh, sizes: Int[np.ndarray, " P"], prim: Usd.Prim, names: _PrimNames, folder: Path, asset_folder: str
) -> None:
    """Write a GeomSubset of family materialBind for each part that has faces, bound to the part's material."""
    first = np.cumsum(sizes - 2) - (sizes - 2)  # each polygon's first face
    subset_names = _PrimNames(prim.GetPath())
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    materials: dict[Material, UsdShade.Material] = {}
    for part in mesh.parts:
        polygons = np.flatnonzero((first >= part.start) & (first < part.stop))
        if not len(polygons):
            continue
        name = subset_names.path(part.name).name
        subset = binding.CreateMaterialBindSubset(name, _integers(polygons))
        _set_display_name(subset.GetPrim(), part.name)
        if part.material is None:
            continue
        if part.material not in materials:
            stage, textured = prim.GetStage(), mesh.corner_uv is not None
            materials[part.material] = _add_material(stage, part.material, names, folder, asset_folder, textured)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[part.material])
    if mesh.parts:
        binding.SetMaterialBindSubsetsFamilyType(UsdGeom.Tokens.nonOverlapping)


def _add_material(
    stage: Usd.Stage, material: Material, names: _PrimNames, folder: Path, asset_folder: str, textured: bool
) -> UsdShade.Material:
    """Write a non-metallic UsdPreviewSurface; with a texture, the base colour becomes the texture's scale."""
    usd_material = UsdShade.Material.Define(stage, names.path(material.name))
    _set_display_name(usd_material.GetPrim(), material.name)
    surface = _shader(usd_material, "surface", "UsdPreviewSurface")
    *color, alpha = material.base_color
    diffuse = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    diffuse.Set(Gf.Vec3f(*color))
    surface.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(alpha)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(ROUGHNESS)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    usd_material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    if textured and material.texture is not None:
        file = write_image(material.texture, folder, usd_material.GetPath().name)
        diffuse.ConnectToSource(_add_texture(usd_material, f"{asset_folder}/{file}", color).ConnectableAPI(), "rgb")
    return usd_material


def _add_texture(material: UsdShade.Material, file: str, color: list[float]) -> UsdShade.Shader:
    """Write a UsdUVTexture that reads the primvar `st`; `file` is an asset path."""
    reader = _shader(material, "uv", "UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    texture = _shader(material, "texture", "UsdUVTexture")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(file))
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
    for axis in ("wrapS", "wrapT"):
        texture.CreateInput(axis, Sdf.ValueTypeNames.Token).Set("repeat")
    if color != [1.0, 1.0, 1.0]:
        texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*color, 1.0))
    reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    return texture


def _shader(material: UsdShade.Material, name: str, shader_id: str) -> UsdShade.Shader:
    shader = UsdShade.Shader.Define(material.GetPrim().GetStage(), material.GetPath().AppendChild(name))
    shader.CreateIdAttr(shader_id)
    if shader_id == "UsdPreviewSurface":
        shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    return shader
