"""Write prim names, materials and material subsets (GeomSubset) of a new USD file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, Vt

from ...core.mesh import Material, Mesh
from ..mtl import write_image

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

ROUGHNESS = 0.9
"""Roughness (0..1) of written materials: nearly matt, since `mesh.Material` has no gloss."""


class PrimNames:
    """Allocator of legal and unique prim names below one parent prim."""

    def __init__(self, parent: Sdf.Path) -> None:
        self.parent = parent
        self.taken: set[str] = set()

    def path(self, name: str) -> Sdf.Path:
        """Return a new child path for an object of any name: illegal characters replaced, a number added if taken."""
        identifier = unique = Tf.MakeValidIdentifier(name)
        number = 2
        while unique in self.taken:
            unique, number = f"{identifier}_{number}", number + 1
        self.taken.add(unique)
        return self.parent.AppendChild(unique)


def set_display_name(prim: Usd.Prim, name: str) -> None:
    """Store a name as the prim's display name where it is not a legal or free prim name."""
    if prim.GetName() != name:
        prim.SetDisplayName(name)


def add_subsets(
    mesh: Mesh, sizes: Int[np.ndarray, " P"], prim: Usd.Prim, names: PrimNames, folder: Path, asset_folder: str
) -> None:
    """Write a GeomSubset of family materialBind for each part that has faces, bound to the part's material.

    Args:
        sizes: corners of each polygon; a polygon of n corners is n - 2 consecutive faces of `mesh`.
        prim: the mesh prim, parent of the subsets.
        names: of the scope that materials are written below.
        folder: where texture files are written.
        asset_folder: how asset paths of the layer refer to `folder`.
    """
    first = np.cumsum(sizes - 2) - (sizes - 2)  # each polygon's first face
    subset_names = PrimNames(prim.GetPath())
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    materials: dict[Material, UsdShade.Material] = {}
    for part in mesh.parts:
        polygons = np.flatnonzero((first >= part.start) & (first < part.stop))
        if not len(polygons):
            continue
        name = subset_names.path(part.name).name
        subset = binding.CreateMaterialBindSubset(name, Vt.IntArray.FromNumpy(polygons.astype(np.int32)))
        set_display_name(subset.GetPrim(), part.name)
        if part.material is None:
            continue
        if part.material not in materials:
            stage, textured = prim.GetStage(), mesh.corner_uv is not None
            materials[part.material] = _add_material(stage, part.material, names, folder, asset_folder, textured)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(materials[part.material])
    if mesh.parts:
        binding.SetMaterialBindSubsetsFamilyType(UsdGeom.Tokens.nonOverlapping)


def _add_material(
    stage: Usd.Stage, material: Material, names: PrimNames, folder: Path, asset_folder: str, textured: bool
) -> UsdShade.Material:
    """Write a non-metallic UsdPreviewSurface; with a texture, the base colour becomes the texture's scale."""
    usd_material = UsdShade.Material.Define(stage, names.path(material.name))
    set_display_name(usd_material.GetPrim(), material.name)
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
