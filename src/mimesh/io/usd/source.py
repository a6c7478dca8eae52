"""The USD file an identity came from, given back with its points elsewhere and nothing else changed.

Kept: all prims, materials, subsets, primvars, metadata and custom attributes of the root layer, and what it refers to.
Changed: points, authored normals and extent of the meshes that were read, in their own coordinates, at all times.
Dropped: their skins, blend shapes and animation, that of what they hang from included: it would move the wanted points
away.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, UsdUtils, Vt

from ...core.errors import InputError
from ...core.geometry import unit_vectors
from ...core.mesh import Mesh
from .looks import at_corners, authored_normals
from .package import pack, unpack
from .skin import Body
from .stage import EVERYTHING, REST, matrix, turned_about

# usd-core tells type checkers nothing of what is in it.
# pyright: reportAttributeAccessIssue=false

LOCAL_TOLERANCE = 1e-6
"""How far from its place, relative to the size of the mesh, float32 numbers in a prim's frame may put a point."""
FLAT = 1e12
"""Condition number from which on a transform flattens what it moves."""
_OF_SKINS = (
    "primvars:skel:jointIndices",
    "primvars:skel:jointWeights",
    "primvars:skel:geomBindTransform",
    "skel:blendShapes",
)


@dataclass(frozen=True)
class FaceRun:
    """Vertices `start:stop` of the Mesh and its faces from `first_face` on: those of one prim."""

    prim: str
    start: int
    stop: int
    first_face: int
    corner_of: Int[np.ndarray, "F 3"] = field(repr=False)
    """Which of the prim's corners each corner of its faces is."""
    mirrored: bool
    """Whether the prim's transform turned the winding of its faces around."""


@dataclass(frozen=True, eq=False)
class UsdSource:
    """The file behind a Mesh (see `Mesh.source`); it is opened again when it is written."""

    path: Path
    suffix: str
    vertices: Float[np.ndarray, "V 3"] = field(repr=False)
    """The Mesh's vertices as they were read."""
    sizes: Int[np.ndarray, " P"] = field(repr=False)
    """Corners of the polygons that the Mesh's faces are fans of."""
    runs: tuple[FaceRun, ...] = field(repr=False)
    by_default: bool
    """Whether it was read at the default time, else at `first`."""
    first: float
    """First time code."""
    up_axis: str
    meters_per_unit: float
    notes: tuple[str, ...]
    """One line for each thing of the file that is not in the written one, or in another way."""

    @property
    def details(self) -> tuple[tuple[str, str], ...]:
        """The stage's unit and axis, name and value."""
        return (("unit", f"{self.meters_per_unit:g} m, {self.up_axis.lower()} up"),)

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write the file with the points of `mesh`, in the format of `path`'s suffix.

        In another folder, what the file refers to is named by absolute paths; a package holds all of it.

        Raises:
            InputError: the file is gone, or no longer has the prims that were read.
        """
        if mesh.vertices.shape != self.vertices.shape or len(mesh.faces) != (self.sizes - 2).sum():
            raise ValueError(f"the file has vertices {self.vertices.shape}, the mesh {mesh.vertices.shape}")
        if not self.path.is_file():
            raise InputError(f"{self.path}: expected the file that was read, found none; put it back to write its copy")
        if path.suffix.lower() != ".usdz":
            self._export(path)
            self._move(mesh, path)
            return
        with tempfile.TemporaryDirectory(prefix=".usdz-", dir=path.parent) as folder:
            if self.suffix == ".usdz":
                files = unpack(self.path, Path(folder))
                self._move(mesh, Path(folder) / files[0])
                pack(Path(folder), files, path)
            else:
                root = Path(folder) / f"{self.path.stem}.usdc"
                self._export(root)
                self._move(mesh, root)
                UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(root)), str(path))

    def _export(self, path: Path) -> None:
        """Copy the root layer; its relative paths stay where they lead to the same files."""
        layer = Sdf.Layer.FindOrOpen(str(self.path))
        layer.Export(str(path))
        if self.suffix == ".usdz" or path.parent.resolve() != self.path.parent:
            copy = Sdf.Layer.FindOrOpen(str(path))
            UsdUtils.ModifyAssetPaths(copy, lambda name: layer.ComputeAbsolutePath(name) if name else name)
            copy.Save()

    def _move(self, mesh: Mesh, root: Path) -> None:
        stage = Usd.Stage.Open(str(root))
        frames = UsdGeom.XformCache(REST if self.by_default else Usd.TimeCode(self.first))
        # All are placed as they were read, before the first of them changes what the others inherit.
        prims = [_own_prim(stage, run.prim, self.path) for run in self.runs]
        places = [matrix(frames.GetLocalToWorldTransform(prim)) for prim in prims]
        for run, prim, T_world_prim in zip(self.runs, prims, places, strict=True):
            points = mesh.vertices[run.start : run.stop]
            unfit = _storage_error(T_world_prim, points) > LOCAL_TOLERANCE * np.ptp(mesh.vertices, axis=0).max()
            mirrored = bool(np.linalg.det(T_world_prim[:3, :3]) < 0)
            _freeze(prim, frames.GetTime())
            if unfit or mirrored != run.mirrored:
                T_world_prim = _place(prim, frames.GetTime(), run.mirrored)
            linear, origin = T_world_prim[:3, :3], T_world_prim[:3, 3]
            if mesh.corner_normals is not None:
                faces = slice(run.first_face, run.first_face + len(run.corner_of))
                _set_normals(prim, frames.GetTime(), run, unit_vectors(mesh.corner_normals[faces] @ linear))
            _set_points(prim, (points - origin) @ np.linalg.inv(linear).T)
            _drop_skin(prim)
        stage.GetRootLayer().Save()


def notes_of(stage: Usd.Stage, bodies: list[Body]) -> tuple[str, ...]:
    """What a written file does not have, or has in another way, one line each."""
    notes = []
    skinned = sum(body.skin is not None for body in bodies)
    moving = sum(bool(body.samples()) for body in bodies)
    instances = {prim.GetPath() for body in bodies if (prim := _instance_root(body.prim))}
    instancers = sum(prim.IsA(UsdGeom.PointInstancer) for prim in stage.Traverse(EVERYTHING))
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
    """The outermost instance that a prim is in."""
    path = prim.GetPath()
    found = [prim.GetStage().GetPrimAtPath(prefix) for prefix in path.GetPrefixes()]
    return next((one for one in found if one.IsInstance()), None)


def _own_prim(stage: Usd.Stage, path: str, file: Path) -> Usd.Prim:
    """A prim that can be edited: the instances around it become prims of their own."""
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
    """How far float32 storage in a frame puts a point from its place, beyond what it does in the world's."""
    linear, origin = T_world_prim[:3, :3], T_world_prim[:3, 3]
    if not np.linalg.cond(linear) < FLAT:
        return np.inf
    local = ((points - origin) @ np.linalg.inv(linear).T).astype(np.float32).astype(np.float64)
    at_best = np.abs(points.astype(np.float32) - points).max(initial=0.0)
    return float(np.abs(local @ linear.T + origin - points).max(initial=0.0) - 2 * at_best)


def _freeze(prim: Usd.Prim, time: Usd.TimeCode) -> None:
    """Let all that places a prim stay as it is at a time."""
    for one in turned_about(prim):
        for op in one.GetOrderedXformOps():
            if op.MightBeTimeVarying():
                _set_always(op.GetAttr(), op.GetAttr().Get(time))


def _place(prim: Usd.Prim, time: Usd.TimeCode, mirrored: bool) -> Float[np.ndarray, "4 4"]:
    """Let a prim stand at the origin; mirrored, if its faces are wound for that. Returns how it stands.

    Blender does not know that a prim may ignore its parents, so that is said only where they flatten all.
    """
    T_world_prim = np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0, 1.0])
    T_world_parent = matrix(UsdGeom.XformCache(time).GetParentToWorldTransform(prim))
    mesh = UsdGeom.Xformable(prim)
    mesh.ClearXformOpOrder()
    flat = not np.linalg.cond(T_world_parent[:3, :3]) < FLAT
    mesh.SetResetXformStack(flat)
    T_parent_prim = T_world_prim if flat else np.linalg.inv(T_world_parent) @ T_world_prim
    mesh.AddTransformOp(opSuffix="placed").Set(Gf.Matrix4d(T_parent_prim.T.tolist()))
    return T_world_prim


def _set_points(prim: Usd.Prim, points: Float[np.ndarray, "V 3"]) -> None:
    """Points at all times, and the extent if there was one; velocities would move them between samples."""
    mesh = UsdGeom.Mesh(prim)
    values = points.astype(np.float32)
    if mesh.GetExtentAttr().HasAuthoredValue():
        _set_always(mesh.GetExtentAttr(), _vectors(np.stack([values.min(axis=0), values.max(axis=0)])))
    _set_always(mesh.GetPointsAttr(), _vectors(values))
    for attribute in (mesh.GetVelocitiesAttr(), mesh.GetAccelerationsAttr()):
        if attribute.HasAuthoredValue():
            attribute.Block()


def _set_normals(prim: Usd.Prim, time: Usd.TimeCode, run: FaceRun, normals: Float[np.ndarray, "F 3 3"]) -> None:
    """Normals at all times, where the file has any; those of corners without a face stay."""
    given = authored_normals(prim, time)
    if given is None:
        return
    values, interpolation = given
    mesh = UsdGeom.Mesh(prim)
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
        topology = mesh.GetFaceVertexIndicesAttr()
        corners = np.array(topology.Get(time) or topology.Get(Usd.TimeCode.EarliestTime()), np.int64)
        index = corners[run.corner_of]
    else:
        counts, corners = (
            np.array(a.Get(time), np.int64) for a in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
        )
        values = at_corners(values, interpolation, corners, np.repeat(np.arange(len(counts)), counts), prim.GetName())
        index, interpolation = run.corner_of, UsdGeom.Tokens.faceVarying
    values = values.astype(np.float32)
    values[index.ravel()] = normals.reshape(-1, 3)
    if primvar and primvar.HasValue():
        if primvar.IsIndexed():
            primvar.BlockIndices()
        primvar.SetInterpolation(interpolation)
        _set_always(primvar.GetAttr(), _vectors(values))
    else:
        mesh.SetNormalsInterpolation(interpolation)
        _set_always(mesh.GetNormalsAttr(), _vectors(values))


def _set_always(attribute: Usd.Attribute, value) -> None:
    attribute.Clear()  # its time samples too
    attribute.Set(value)


def _vectors(values: Float[np.ndarray, "N 3"]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(values)


def _drop_skin(prim: Usd.Prim) -> None:
    for name in _OF_SKINS:
        attribute = prim.GetAttribute(name)
        if attribute and attribute.HasAuthoredValue():
            attribute.Block()
    for name in ("skel:skeleton", "skel:blendShapeTargets", "skel:animationSource"):
        if prim.GetRelationship(name):
            prim.GetRelationship(name).SetTargets([])
    if prim.HasAPI(UsdSkel.BindingAPI):
        prim.RemoveAPI(UsdSkel.BindingAPI)
