"""Names, materials and material subsets of a new USD file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, Vt

from ...core.mesh import Material, Mesh
from ..atomic import whole_file
from ..mtl import image_suffix

# usd-core tells type checkers nothing of what is in it.
# pyright: reportAttributeAccessIssue=false

ROUGHNESS = 0.9


class Names:
    """Legal prim names below one prim, each given out once; what they stand for is kept as their display names."""

    def __init__(self, parent: Sdf.Path) -> None:
        self.parent = parent
        self.taken: set[str] = set()

    def path(self, name: str) -> Sdf.Path:
        """A path for something of any name."""
        wanted = legal = Tf.MakeValidIdentifier(name)
        number = 2
        while legal in self.taken:
            legal, number = f"{wanted}_{number}", number + 1
        self.taken.add(legal)
        return self.parent.AppendChild(legal)


def call(prim: Usd.Prim, name: str) -> None:
    """Keep a name that the prim's own could not be."""
    if prim.GetName() != name:
        prim.SetDisplayName(name)


def add_parts(mesh: Mesh, sizes: Int[np.ndarray, " P"], prim: Usd.Prim, names: Names, folder: Path, shown: str) -> None:
    """One subset of family materialBind for each part that has faces, bound to its material.

    Textures are written into `folder`, which layers call `shown`; `names` are those beside the mesh.
    """
    first = np.cumsum(sizes - 2) - (sizes - 2)
    inside = Names(prim.GetPath())
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    materials: dict[Material, UsdShade.Material] = {}
    for part in mesh.parts:
        polygons = np.flatnonzero((first >= part.start) & (first < part.stop))
        if not len(polygons):
            continue
        name = inside.path(part.name).name
        subset = binding.CreateMaterialBindSubset(name, Vt.IntArray.FromNumpy(polygons.astype(np.int32)))
        call(subset.GetPrim(), part.name)
        if part.material is None:
            continue
        if part.material not in materials:
            stage, textured = prim.GetStage(), mesh.corner_uv is not None
            materials[part.material] = _add_material(stage, part.material, names, folder, shown, textured)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[part.material])
    if mesh.parts:
        binding.SetMaterialBindSubsetsFamilyType(UsdGeom.Tokens.nonOverlapping)


def _add_material(
    stage: Usd.Stage, material: Material, names: Names, folder: Path, shown: str, textured: bool
) -> UsdShade.Material:
    """A rough, non-metallic UsdPreviewSurface; a colour that multiplies the texture is the texture's scale."""
    made = UsdShade.Material.Define(stage, names.path(material.name))
    call(made.GetPrim(), material.name)
    surface = _shader(made, "surface", "UsdPreviewSurface")
    *color, alpha = material.base_color
    diffuse = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    diffuse.Set(Gf.Vec3f(*color))
    surface.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(alpha)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(ROUGHNESS)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    made.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    if textured and material.texture is not None:
        file = _write_image(material.texture, folder, made.GetPath().name)
        diffuse.ConnectToSource(_add_texture(made, f"{shown}/{file}", color).ConnectableAPI(), "rgb")
    return made


def _add_texture(material: UsdShade.Material, file: str, color: list[float]) -> UsdShade.Shader:
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


def _shader(material: UsdShade.Material, name: str, kind: str) -> UsdShade.Shader:
    shader = UsdShade.Shader.Define(material.GetPrim().GetStage(), material.GetPath().AppendChild(name))
    shader.CreateIdAttr(kind)
    if kind == "UsdPreviewSurface":
        shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    return shader


def _write_image(content: bytes, folder: Path, stem: str) -> str:
    """Put an image into a folder, unless it is there, under the first free name; returns that name."""
    name, number = f"{stem}{image_suffix(content)}", 2
    while (folder / name).exists() and (folder / name).read_bytes() != content:
        name, number = f"{stem}-{number}{image_suffix(content)}", number + 1
    if not (folder / name).exists():
        with whole_file(folder / name) as temporary:
            temporary.write_bytes(content)
    return name
