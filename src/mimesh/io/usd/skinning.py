"""Evaluate the points of a USD mesh prim at a time code, in world coordinates.

Points come from time samples, blend shapes, linear blend skinning by UsdSkel, and the transforms of prims.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from pxr import Usd, UsdGeom, UsdSkel

from .stage import ALL_PRIMS, column_matrix, transform_sample_times

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false


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
    return [_mesh_prim(prim, *bindings.get(prim.GetPath(), (None, None))) for prim in prims]


def transform_points(transform: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Apply an affine transform (of column vectors) to points."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def _mesh_prim(prim: Usd.Prim, skeleton, skinning) -> MeshPrim:
    has_blend_shapes = skinning is not None and skinning.HasBlendShapes()
    blend_shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim)) if has_blend_shapes else None
    return MeshPrim(prim, skeleton, skinning, blend_shapes)
