"""Open a USD stage for reading: its visible mesh prims, their transforms and points, and the range of time codes.

Points come from time samples, blend shapes, linear blend skinning by UsdSkel, and the transforms of prims.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pxr import Ar, Sdf, Usd, UsdGeom, UsdSkel, UsdUtils

from ...core.errors import InputError
from ..beside import confining_folder, may_be_read

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

ALL_PRIMS = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
"""Traversal predicate: active, defined, loaded prims that are not abstract, including those inside instances."""
DEFAULT_TIME = Usd.TimeCode.Default()
"""The time of values that are authored without a time code."""


def open_stage(path: Path) -> Usd.Stage:
    """Open the stage of a file with all its payloads, for reading only.

    Raises:
        InputError: reading is confined to a folder (see `beside.confined`) and the file refers to files outside of it.
    """
    if confining_folder() is not None:
        _check_references(path)
    return Usd.Stage.Open(str(path))


def shown_meshes(stage: Usd.Stage, path: Path) -> list[Usd.Prim]:
    """Find the Mesh prims that have points, are visible and of purpose default or render, in stage order.

    Visibility is that of the stage's first time code. Meshes below point instancers are left out: they are prototypes,
    shown only where the instancer places them.

    Raises:
        InputError: there are none; the message lists the prims that were found.
    """
    time = Usd.TimeCode(stage.GetStartTimeCode())
    shown = [prim for prim in _visible(stage, time) if prim.IsA(UsdGeom.Mesh) and _has_points(prim)]
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


def time_code_range(stage: Usd.Stage, sample_times: list[float], path: Path) -> tuple[float, float]:
    """Return the first and last time code of a stage: as authored, else those of the samples.

    Without samples nothing moves, and both are 0.

    Raises:
        InputError: the authored range is not finite.
    """
    if not sample_times:
        return 0.0, 0.0
    start, stop = min(sample_times), max(sample_times)
    if stage.HasAuthoredTimeCodeRange():
        start, stop = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not np.isfinite([start, stop]).all():
        raise InputError(f"{path}: expected finite time codes, found {start:g} to {stop:g}; export it again")
    return start, max(start, stop)


def transform_sample_times(prim: Usd.Prim) -> list[float]:
    """Collect the time codes of all samples of the transforms that place a prim in the world."""
    chain = transform_chain(prim)
    return [time for xform in chain if xform.TransformMightBeTimeVarying() for time in xform.GetTimeSamples()]


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
        """Whether joints deform the mesh. UsdSkel then places it by the skeleton's transform, not by its own."""
        return self.skinning is not None and self.skinning.HasJointInfluences()

    def sample_times(self) -> list[float]:
        """Collect the time codes of all samples that move the points; empty for a mesh that does not move."""
        points = UsdGeom.Mesh(self.prim).GetPointsAttr()
        times = list(points.GetTimeSamples()) if points.ValueMightBeTimeVarying() else []
        if self.skeleton is None or not self.is_skinned:
            times += transform_sample_times(self.prim)
        else:
            times += transform_sample_times(self.skeleton.GetPrim())
        animation = self.skeleton.GetAnimQuery() if self.skeleton is not None else None
        if animation and self.is_skinned and animation.JointTransformsMightBeTimeVarying():
            times += animation.GetJointTransformTimeSamples()
        if animation and self.blend_shapes is not None and animation.BlendShapeWeightsMightBeTimeVarying():
            times += animation.GetBlendShapeWeightTimeSamples()
        return times

    def T_world_points(self, xforms: UsdGeom.XformCache) -> Float[np.ndarray, "4 4"]:
        """Return the transform from the frame of the deformed points to the world, at the time of `xforms`."""
        placing_prim = self.skeleton.GetPrim() if self.skeleton is not None and self.is_skinned else self.prim
        return column_matrix(xforms.GetLocalToWorldTransform(placing_prim))

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
        if self.blend_shapes is not None:
            self._add_blend_shapes(points, time)
        if self.skeleton is not None and self.skinning is not None and self.is_skinned:
            joint_transforms = self.skeleton.ComputeSkinningTransforms(time)
            self.skinning.ComputeSkinnedPoints(joint_transforms, points, time)  # changes `points` in place
        return transform_points(self.T_world_points(xforms), np.array(points, np.float64))

    def _add_blend_shapes(self, points, time: Usd.TimeCode) -> None:
        """Add the weighted offsets of the blend shapes and of their in-betweens to `points`, in place."""
        assert self.blend_shapes is not None
        assert self.skeleton is not None
        assert self.skinning is not None
        animation = self.skeleton.GetAnimQuery()
        weights = animation.ComputeBlendShapeWeights(time) if animation else None
        if not weights:
            return
        # The animation may list blend shapes in another order than the mesh.
        mapper = self.skinning.GetBlendShapeMapper()
        weights = mapper.Remap(weights) if mapper else weights
        self.blend_shapes.ComputeDeformedPoints(
            *self.blend_shapes.ComputeSubShapeWeights(weights),
            self.blend_shapes.ComputeBlendShapePointIndices(),
            self.blend_shapes.ComputeSubShapePointOffsets(),
            points,
        )


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


def _has_points(prim: Usd.Prim) -> bool:
    points = UsdGeom.Mesh(prim).GetPointsAttr()
    return bool(points.Get(DEFAULT_TIME) or points.Get(Usd.TimeCode.EarliestTime()))
