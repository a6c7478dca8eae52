"""Write the USD file that a mesh was read from again, with other points and all else as it was.

Kept: all prims, materials, subsets, primvars, metadata and custom attributes of the root layer, and its references.
Changed: points, authored normals and extent of the meshes that were read, in each prim's local frame, at all times.
Removed: their skinning, blend shapes and animation, and the animation of their ancestors, any of which would move the
new points.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, UsdUtils, Vt

from ...core.errors import InputError
from ...core.geometry import unit_vectors
from ...core.mesh import Mesh
from ..atomic import scratch_folder
from .appearance import authored_normals, corner_values
from .package import pack, unpack
from .skinning import MeshPrim
from .source import PrimRange, UsdSource
from .stage import ALL_PRIMS, DEFAULT_TIME, column_matrix, transform_chain

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

LOCAL_TOLERANCE = 1e-6
"""Largest error of a point stored as float32 in a prim's local frame, as a fraction of the mesh's longest extent."""
MAX_CONDITION = 1e12
"""Condition number of a 3x3 transform from which on it counts as singular (it flattens the mesh)."""
_SKINNING_ATTRIBUTES = (
    "primvars:skel:jointIndices",
    "primvars:skel:jointWeights",
    "primvars:skel:geomBindTransform",
    "skel:blendShapes",
)


def write_again(source: UsdSource, mesh: Mesh, path: Path) -> None:
    """Write the file of a source with the points of `mesh`, in the format of `path`'s suffix.

    Written to another folder, the file refers to its layers and assets by absolute paths; a package contains them.

    Raises:
        InputError: the file no longer has the prims that were read.
    """
    if path.suffix.lower() != ".usdz":
        _export(source, path)
        _write_points(source, mesh, path)
        return
    with scratch_folder() as folder:
        if source.suffix == ".usdz":
            files = unpack(source.path, folder)
            _write_points(source, mesh, folder / files[0])
            pack(folder, files, path)
        else:
            root = folder / f"{source.path.stem}.usdc"
            _export(source, root)
            _write_points(source, mesh, root)
            UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(root)), str(path))


def _export(source: UsdSource, path: Path) -> None:
    """Copy the root layer; asset paths become absolute where relative ones would no longer resolve."""
    layer = Sdf.Layer.FindOrOpen(str(source.path))
    layer.Export(str(path))
    if source.suffix == ".usdz" or path.parent.resolve() != source.path.parent:
        copy = Sdf.Layer.FindOrOpen(str(path))
        UsdUtils.ModifyAssetPaths(copy, lambda name: layer.ComputeAbsolutePath(name) if name else name)
        copy.Save()


def _write_points(source: UsdSource, mesh: Mesh, root: Path) -> None:
    """Write the vertices and normals of `mesh` into the prims of the copied root layer.

    A prim keeps its transform where the new points can be stored in its local frame with enough precision and with
    the winding of the faces as read; otherwise it gets a transform that places it at the world's origin.
    """
    stage = Usd.Stage.Open(str(root))
    xforms = UsdGeom.XformCache(DEFAULT_TIME if source.at_default_time else Usd.TimeCode(source.first))
    # All transforms are taken before the first prim changes what others inherit.
    prims = [_editable_prim(stage, prim_range.prim, source.path) for prim_range in source.ranges]
    transforms = [column_matrix(xforms.GetLocalToWorldTransform(prim)) for prim in prims]
    for prim_range, prim, T_world_prim in zip(source.ranges, prims, transforms, strict=True):
        points = mesh.vertices[prim_range.start : prim_range.stop]
        tolerance = LOCAL_TOLERANCE * np.ptp(mesh.vertices, axis=0).max()
        is_imprecise = _storage_error(T_world_prim, points) > tolerance
        is_mirrored = bool(np.linalg.det(T_world_prim[:3, :3]) < 0)
        _freeze_transforms(prim, xforms.GetTime())
        if is_imprecise or is_mirrored != prim_range.is_mirrored:
            T_world_prim = _reset_transform(prim, xforms.GetTime(), prim_range.is_mirrored)
        linear, origin = T_world_prim[:3, :3], T_world_prim[:3, 3]
        if mesh.corner_normals is not None:
            faces = slice(prim_range.first_face, prim_range.first_face + len(prim_range.corner_of))
            _set_normals(prim, xforms.GetTime(), prim_range, unit_vectors(mesh.corner_normals[faces] @ linear))
        _set_points(prim, (points - origin) @ np.linalg.inv(linear).T)
        _remove_skinning(prim)
    stage.GetRootLayer().Save()


def writing_notes(stage: Usd.Stage, mesh_prims: list[MeshPrim]) -> tuple[str, ...]:
    """List what a written file will lack or store differently, one line each."""
    notes = []
    skinned = sum(mesh_prim.skinning is not None for mesh_prim in mesh_prims)
    moving = sum(bool(mesh_prim.sample_times()) for mesh_prim in mesh_prims)
    instances = {prim.GetPath() for mesh_prim in mesh_prims if (prim := _instance_root(mesh_prim.prim))}
    instancers = sum(prim.IsA(UsdGeom.PointInstancer) for prim in stage.Traverse(ALL_PRIMS))
    if skinned:
        notes.append(f"dropped the skins or blend shapes of {_count(skinned, 'mesh')}: the points now carry the pose")
    if moving:
        notes.append(f"dropped the animation of {_count(moving, 'mesh')}: the points stay where they were put")
    if instances:
        notes.append(f"gave {_count(len(instances), 'instance')} prims of their own: they now move apart")
    if instancers:
        notes.append(f"kept {_count(instancers, 'point instancer')} as they were: they do not follow the new shape")
    return tuple(notes)


def _count(number: int, name: str) -> str:
    plural = name + ("es" if name.endswith("sh") else "s")
    return f"1 {name}" if number == 1 else f"{number} {plural}"


def _instance_root(prim: Usd.Prim) -> Usd.Prim | None:
    """Return the outermost instance that contains a prim, or None."""
    ancestors = [prim.GetStage().GetPrimAtPath(prefix) for prefix in prim.GetPath().GetPrefixes()]
    return next((ancestor for ancestor in ancestors if ancestor.IsInstance()), None)


def _editable_prim(stage: Usd.Stage, path: str, file: Path) -> Usd.Prim:
    """Return a mesh prim after turning off instancing around it: prims inside an instance cannot be edited.

    Raises:
        InputError: there is no mesh at this path.
    """
    prim = stage.GetPrimAtPath(path)
    while prim and prim.IsInstanceProxy():
        root = _instance_root(prim)
        assert root is not None
        root.SetInstanceable(False)
        prim = stage.GetPrimAtPath(path)
    if not prim or not prim.IsA(UsdGeom.Mesh):
        raise InputError(f"{file}: expected the mesh {path} that was read, found none; read the file again")
    return prim


def _storage_error(T_world_prim: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "V 3"]) -> float:
    """Return the error that float32 storage in a prim's frame adds to that of storage in the world frame, world units.

    It is infinite for a transform that cannot be inverted. A far translation or a strong scale makes it large.
    """
    linear, origin = T_world_prim[:3, :3], T_world_prim[:3, 3]
    if not np.linalg.cond(linear) < MAX_CONDITION:
        return np.inf
    local = ((points - origin) @ np.linalg.inv(linear).T).astype(np.float32).astype(np.float64)
    world_error = np.abs(points.astype(np.float32) - points).max(initial=0.0)
    return float(np.abs(local @ linear.T + origin - points).max(initial=0.0) - 2 * world_error)


def _freeze_transforms(prim: Usd.Prim, time: Usd.TimeCode) -> None:
    """Make the transforms of a prim and its ancestors constant, with their values at a time."""
    for xformable in transform_chain(prim):
        for op in xformable.GetOrderedXformOps():
            if op.MightBeTimeVarying():
                _set_constant(op.GetAttr(), op.GetAttr().Get(time))


def _reset_transform(prim: Usd.Prim, time: Usd.TimeCode, is_mirrored: bool) -> Float[np.ndarray, "4 4"]:
    """Replace the transform of a prim so that its world transform is the identity, and return that world transform.

    With `mirrored` it is a reflection in x instead, for faces whose winding was read through a mirroring transform.
    The parent's transform is inverted in the prim's own. Only a parent that cannot be inverted is bypassed by
    resetting the transform stack, since Blender ignores that flag.
    """
    T_world_prim = np.diag([-1.0 if is_mirrored else 1.0, 1.0, 1.0, 1.0])
    T_world_parent = column_matrix(UsdGeom.XformCache(time).GetParentToWorldTransform(prim))
    mesh = UsdGeom.Xformable(prim)
    mesh.ClearXformOpOrder()
    is_singular = not np.linalg.cond(T_world_parent[:3, :3]) < MAX_CONDITION
    mesh.SetResetXformStack(is_singular)
    T_parent_prim = T_world_prim if is_singular else np.linalg.inv(T_world_parent) @ T_world_prim
    mesh.AddTransformOp(opSuffix="placed").Set(Gf.Matrix4d(T_parent_prim.T.tolist()))
    return T_world_prim


def _set_points(prim: Usd.Prim, points: Float[np.ndarray, "V 3"]) -> None:
    """Set points for all times and update an authored extent; velocities, which would move the points, are blocked."""
    mesh = UsdGeom.Mesh(prim)
    values = points.astype(np.float32)
    if mesh.GetExtentAttr().HasAuthoredValue():
        _set_constant(mesh.GetExtentAttr(), _vectors(np.stack([values.min(axis=0), values.max(axis=0)])))
    _set_constant(mesh.GetPointsAttr(), _vectors(values))
    for attribute in (mesh.GetVelocitiesAttr(), mesh.GetAccelerationsAttr()):
        if attribute.HasAuthoredValue():
            attribute.Block()


def _set_normals(
    prim: Usd.Prim, time: Usd.TimeCode, prim_range: PrimRange, normals: Float[np.ndarray, "F 3 3"]
) -> None:
    """Set normals for all times where the prim has authored ones; corners outside of all faces keep theirs.

    Per-vertex normals stay per vertex. All others become faceVarying, since corners that shared one value may have been
    rotated differently. They are written to the attribute that they were read from.
    """
    authored = authored_normals(prim, time)
    if authored is None:
        return
    values, interpolation = authored
    mesh = UsdGeom.Mesh(prim)
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
        topology = mesh.GetFaceVertexIndicesAttr()
        corners = np.array(topology.Get(time) or topology.Get(Usd.TimeCode.EarliestTime()), np.int64)
        index = corners[prim_range.corner_of]
    else:
        counts, corners = (
            np.array(a.Get(time), np.int64) for a in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
        )
        values = corner_values(
            values, interpolation, corners, np.repeat(np.arange(len(counts)), counts), prim.GetName()
        )
        index, interpolation = prim_range.corner_of, UsdGeom.Tokens.faceVarying
    # Corners that were not read (holes, polygons of two corners) keep the values that were read.
    values = values.astype(np.float32)
    values[index.ravel()] = normals.reshape(-1, 3)
    if primvar and primvar.HasValue():
        # The new values are one per vertex or corner, so indices into the old values no longer apply.
        if primvar.IsIndexed():
            primvar.BlockIndices()
        primvar.SetInterpolation(interpolation)
        _set_constant(primvar.GetAttr(), _vectors(values))
    else:
        mesh.SetNormalsInterpolation(interpolation)
        _set_constant(mesh.GetNormalsAttr(), _vectors(values))


def _set_constant(attribute: Usd.Attribute, value) -> None:
    attribute.Clear()  # removes the time samples too
    attribute.Set(value)


def _vectors(values: Float[np.ndarray, "N 3"]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(values)


def _remove_skinning(prim: Usd.Prim) -> None:
    """Remove the UsdSkel binding of a prim: skin weights, blend shapes, skeleton and animation."""
    for name in _SKINNING_ATTRIBUTES:
        attribute = prim.GetAttribute(name)
        if attribute and attribute.HasAuthoredValue():
            attribute.Block()
    for name in ("skel:skeleton", "skel:blendShapeTargets", "skel:animationSource"):
        if prim.GetRelationship(name):
            prim.GetRelationship(name).SetTargets([])
    if prim.HasAPI(UsdSkel.BindingAPI):
        prim.RemoveAPI(UsdSkel.BindingAPI)
