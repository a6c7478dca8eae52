"""Read the appearance of a USD mesh prim: material subsets, UsdPreviewSurface materials, UVs and normals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Ar, Sdf, Usd, UsdGeom, UsdShade

from ...core.errors import InputError
from ...core.mesh import Material
from ..mtl import image_suffix
from .stage import DEFAULT_TIME

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

DEFAULT_DIFFUSE = (0.18, 0.18, 0.18)
"""Linear RGB; default of `diffuseColor` in the UsdPreviewSurface specification."""


def display_name(prim: Usd.Prim) -> str:
    """Return the display name of a prim if it has one, else the prim's name."""
    return prim.GetDisplayName() or prim.GetName()


def material_subsets(prim: Usd.Prim, polygons: int, path: Path) -> tuple[list[Usd.Prim], Int[np.ndarray, " P"]]:
    """Return the prims that materials are bound to, and for each polygon the index of its prim among them.

    The first prim is the mesh itself, for polygons outside of all subsets; the others are its GeomSubsets of family
    materialBind. A polygon in several subsets belongs to the last of them.

    Raises:
        InputError: a subset has polygon indices that are out of range.
    """
    binding_prims = [prim]
    labels = np.zeros(polygons, np.int64)
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        indices = np.array(subset.GetIndicesAttr().Get(Usd.TimeCode.EarliestTime()) or [], np.int64)
        if len(indices) and (indices.min() < 0 or indices.max() >= polygons):
            raise InputError(
                f"{path}: expected faces 0..{polygons - 1} in {subset.GetPath()}, found {indices.min()} to "
                f"{indices.max()}; the file is damaged, export it again"
            )
        labels[indices] = len(binding_prims)
        binding_prims.append(subset.GetPrim())
    return binding_prims, labels


def bound_material(prim: Usd.Prim) -> UsdShade.Material | None:
    """Return the material bound to a prim, inherited bindings included; None where there is none."""
    return UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0] or None


def read_material(bound: UsdShade.Material) -> Material:
    """Read diffuse colour, opacity and diffuse texture of a UsdPreviewSurface.

    The scale of a texture becomes the base colour that multiplies it. Of materials with another surface shader only the
    name is read.
    """
    surface = bound.ComputeSurfaceSource()[0]
    if not surface or surface.GetShaderId() != "UsdPreviewSurface":
        return Material(display_name(bound.GetPrim()))
    color, texture = _input_value(surface, "diffuseColor", DEFAULT_DIFFUSE), None
    image = _diffuse_texture(surface)
    if image is not None:
        color = _input_value(image, "scale", (1.0, 1.0, 1.0, 1.0))
        texture = _read_asset(_input_value(image, "file", None))
    opacity = _input_value(surface, "opacity", 1.0)
    red, green, blue = (float(value) for value in color[:3])
    return Material(display_name(bound.GetPrim()), (red, green, blue, float(opacity)), texture)


def uv_primvar_name(binding_prims: list[Usd.Prim]) -> str:
    """Return the name of the primvar with the texture coordinates: the one that the first texture reads, else `st`.

    A UsdTransform2d between the primvar reader and the texture is skipped, not applied.
    """
    for prim in binding_prims:
        bound = bound_material(prim)
        surface = bound.ComputeSurfaceSource()[0] if bound else None
        node = _diffuse_texture(surface) if surface else None
        # Walk from the texture upstream: `st` is the input of a texture, `in` that of a UsdTransform2d.
        while node is not None and not (node.GetShaderId() or "").startswith("UsdPrimvarReader"):
            node = _input_shader(node, "st") or _input_shader(node, "in")
        if node is not None and _input_value(node, "varname", None):
            return str(_input_value(node, "varname", None))
    return "st"


def corner_values(
    values: Float[np.ndarray, "N C"],
    interpolation: str,
    corners: Int[np.ndarray, " K"],
    polygon: Int[np.ndarray, " K"],
    label: str,
) -> Float[np.ndarray, "K C"]:
    """Expand values of any USD interpolation to one value per polygon corner.

    Args:
        interpolation: faceVarying (a value per corner), vertex or varying (per vertex), uniform (per polygon), else
            constant.
        corners: vertex index of each corner, the `faceVertexIndices` of the mesh.
        polygon: polygon index of each corner.
        label: what the values are, for the error message; path of the file first.

    Raises:
        InputError: too few values for this interpolation.
    """
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


def primvar_values(prim: Usd.Prim, name: str, width: int) -> tuple[Float[np.ndarray, "N C"], str] | None:
    """Read the values of a primvar, with its indices resolved, and their interpolation.

    Returns None where there is no such primvar or its values do not have `width` components.
    """
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return None
    time = DEFAULT_TIME if primvar.Get(DEFAULT_TIME) is not None else Usd.TimeCode.EarliestTime()
    values = np.array(primvar.ComputeFlattened(time), np.float64)
    return (values, primvar.GetInterpolation()) if values.ndim == 2 and values.shape[1] == width else None


def authored_normals(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[Float[np.ndarray, "N 3"], str] | None:
    """Read the normals of a mesh in its local frame and their interpolation; None where it has none.

    `primvars:normals` takes precedence over the attribute `normals`, as UsdGeomPointBased documents.
    """
    primvar = primvar_values(prim, "normals", 3)
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
