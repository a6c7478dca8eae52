"""How a USD mesh looks: its parts with their UsdPreviewSurface materials, and values at the corners of its faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Ar, Sdf, Usd, UsdGeom, UsdShade

from ...core.errors import InputError
from ...core.mesh import Material
from ..mtl import image_suffix
from .stage import REST

# usd-core tells type checkers nothing of what is in it.
# pyright: reportAttributeAccessIssue=false

GREY = (0.18, 0.18, 0.18)
"""Colour of a UsdPreviewSurface that names none."""


def name_of(prim: Usd.Prim) -> str:
    """Its display name, else its name."""
    return prim.GetDisplayName() or prim.GetName()


def subset_labels(prim: Usd.Prim, polygons: int, path: Path) -> tuple[list[Usd.Prim], Int[np.ndarray, " P"]]:
    """The prims that parts are named and painted by, and which of them each polygon belongs to.

    The first is the mesh itself, for polygons of no subset; the others are its subsets of family materialBind. A
    polygon of several belongs to the last.

    Raises:
        InputError: a subset names polygons that are not there.
    """
    owners = [prim]
    labels = np.zeros(polygons, np.int64)
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        indices = np.array(subset.GetIndicesAttr().Get(Usd.TimeCode.EarliestTime()) or [], np.int64)
        if len(indices) and (indices.min() < 0 or indices.max() >= polygons):
            raise InputError(
                f"{path}: expected faces 0..{polygons - 1} in {subset.GetPath()}, found {indices.min()} to "
                f"{indices.max()}; the file is damaged, export it again"
            )
        labels[indices] = len(owners)
        owners.append(subset.GetPrim())
    return owners, labels


def bound_material(prim: Usd.Prim) -> UsdShade.Material | None:
    """The material that a prim is painted with."""
    return UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0] or None


def read_material(bound: UsdShade.Material) -> Material:
    """Diffuse colour, opacity and diffuse texture of a UsdPreviewSurface.

    A texture's scale is the colour it is multiplied by. Other kinds of surface give no more than their name.
    """
    surface = bound.ComputeSurfaceSource()[0]
    if not surface or surface.GetShaderId() != "UsdPreviewSurface":
        return Material(name_of(bound.GetPrim()))
    color, texture = _value(surface, "diffuseColor", GREY), None
    image = _texture_node(surface)
    if image is not None:
        color = _value(image, "scale", (1.0, 1.0, 1.0, 1.0))
        texture = _content(_value(image, "file", None))
    opacity = _value(surface, "opacity", 1.0)
    red, green, blue = (float(value) for value in color[:3])
    return Material(name_of(bound.GetPrim()), (red, green, blue, float(opacity)), texture)


def uv_name(owners: list[Usd.Prim]) -> str:
    """The primvar that holds the texture coordinates of a mesh: what its first texture reads, else `st`.

    Changes that a material makes to them (UsdTransform2d) are not applied.
    """
    for prim in owners:
        bound = bound_material(prim)
        surface = bound.ComputeSurfaceSource()[0] if bound else None
        node = _texture_node(surface) if surface else None
        while node is not None and not (node.GetShaderId() or "").startswith("UsdPrimvarReader"):
            node = _node(node, "st") or _node(node, "in")
        if node is not None and _value(node, "varname", None):
            return str(_value(node, "varname", None))
    return "st"


def at_corners(
    values: Float[np.ndarray, "N C"],
    interpolation: str,
    corners: Int[np.ndarray, " K"],
    polygon: Int[np.ndarray, " K"],
    what: str,
) -> Float[np.ndarray, "K C"]:
    """The value at each of the given corners of a mesh; `corners` are its flat list of vertices.

    `polygon` says which polygon each corner is of.

    Raises:
        InputError: too few values. `what` says of what, path first.
    """
    if interpolation == UsdGeom.Tokens.faceVarying:
        index = np.arange(len(corners))
    elif interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
        index = corners
    else:
        index = polygon if interpolation == UsdGeom.Tokens.uniform else np.zeros(len(corners), np.int64)
    if len(index) and index.max() >= len(values):
        raise InputError(
            f"{what}: expected {index.max() + 1} values ({interpolation}), found {len(values)}; export it again"
        )
    return values[index]


def primvar_values(prim: Usd.Prim, name: str, width: int) -> tuple[Float[np.ndarray, "N C"], str] | None:
    """A primvar's values, looked up by its indices, and their interpolation; None if it is not there or wider."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return None
    time = REST if primvar.Get(REST) is not None else Usd.TimeCode.EarliestTime()
    values = np.array(primvar.ComputeFlattened(time), np.float64)
    return (values, primvar.GetInterpolation()) if values.ndim == 2 and values.shape[1] == width else None


def authored_normals(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[Float[np.ndarray, "N 3"], str] | None:
    """The normals of a mesh in its own coordinates and their interpolation: `primvars:normals`, else `normals`."""
    given = primvar_values(prim, "normals", 3)
    if given is not None:
        return given
    attribute = UsdGeom.Mesh(prim).GetNormalsAttr()
    values = attribute.Get(time) or attribute.Get(Usd.TimeCode.EarliestTime())
    return (np.array(values, np.float64), UsdGeom.Mesh(prim).GetNormalsInterpolation()) if values else None


def _texture_node(surface: UsdShade.Shader) -> UsdShade.Shader | None:
    node = _node(surface, "diffuseColor")
    return node if node is not None and node.GetShaderId() == "UsdUVTexture" else None


def _node(shader: UsdShade.Shader, name: str) -> UsdShade.Shader | None:
    """The shader that feeds an input, through node graphs."""
    source = _producer(shader, name)
    is_output = source is not None and source.GetName().startswith("outputs:")
    return UsdShade.Shader(source.GetPrim()) if source is not None and is_output else None


def _value(shader: UsdShade.Shader, name: str, default):
    """The constant that an input has; the default where another shader feeds it or nothing is said."""
    source = _producer(shader, name)
    if source is None or source.GetName().startswith("outputs:"):
        return default
    value = source.Get(Usd.TimeCode.EarliestTime())
    return default if value is None else value


def _producer(shader: UsdShade.Shader, name: str) -> Usd.Attribute | None:
    given = shader.GetInput(name)
    found = given.GetValueProducingAttributes() if given else []
    return found[0] if found else None


def _content(asset: Sdf.AssetPath | None) -> bytes | None:
    """The PNG or JPEG file behind an asset path, packages included; None for others and those that are not there."""
    opened = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(asset.resolvedPath)) if asset and asset.resolvedPath else None
    content = bytes(opened.GetBuffer()) if opened else b""
    return content if image_suffix(content) else None
