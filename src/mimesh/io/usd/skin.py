"""The points of a USD mesh at a time, in world coordinates: time samples, blend shapes, joints and transforms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from pxr import Usd, UsdGeom, UsdSkel

from .stage import EVERYTHING, matrix, transform_samples

# usd-core tells type checkers nothing of what is in it.
# pyright: reportAttributeAccessIssue=false


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh prim and what deforms it."""

    prim: Usd.Prim
    skeleton: UsdSkel.SkeletonQuery | None = None
    skin: UsdSkel.SkinningQuery | None = None
    shapes: UsdSkel.BlendShapeQuery | None = None

    @property
    def jointed(self) -> bool:
        """Whether joints move it: it then stands where its skeleton does, not where its own transform puts it."""
        return self.skin is not None and self.skin.HasJointInfluences()

    def samples(self) -> list[float]:
        """Time codes at which something was authored that moves its points; empty where nothing does."""
        points = UsdGeom.Mesh(self.prim).GetPointsAttr()
        found = list(points.GetTimeSamples()) if points.ValueMightBeTimeVarying() else []
        if self.skeleton is None or not self.jointed:
            found += transform_samples(self.prim)
        else:
            found += transform_samples(self.skeleton.GetPrim())
        animation = self.skeleton.GetAnimQuery() if self.skeleton is not None else None
        if animation and self.jointed and animation.JointTransformsMightBeTimeVarying():
            found += animation.GetJointTransformTimeSamples()
        if animation and self.shapes is not None and animation.BlendShapeWeightsMightBeTimeVarying():
            found += animation.GetBlendShapeWeightTimeSamples()
        return found

    def T_world_points(self, frames: UsdGeom.XformCache) -> Float[np.ndarray, "4 4"]:
        """From the frame that `local_points` are in to the world, at the time of `frames`."""
        stands = self.skeleton.GetPrim() if self.skeleton is not None and self.jointed else self.prim
        return matrix(frames.GetLocalToWorldTransform(stands))

    def T_world_bind(self, frames: UsdGeom.XformCache) -> Float[np.ndarray, "4 4"]:
        """From the frame of the authored points to the world, before joints turn."""
        placed = self.T_world_points(frames)
        if self.skin is None or not self.jointed:
            return placed
        return placed @ matrix(self.skin.GetGeomBindTransform(frames.GetTime()))

    def points(self, frames: UsdGeom.XformCache) -> Float[np.ndarray, "V 3"]:
        """World positions at the time of `frames`; empty where it has none then."""
        time = frames.GetTime()
        points = UsdGeom.Mesh(self.prim).GetPointsAttr().Get(time)
        if not points:
            return np.zeros((0, 3))
        if self.shapes is not None:
            self._add_shapes(points, time)
        if self.skeleton is not None and self.skin is not None and self.jointed:
            turns = self.skeleton.ComputeSkinningTransforms(time)
            self.skin.ComputeSkinnedPoints(turns, points, time)  # changes `points`
        return moved_by(self.T_world_points(frames), np.array(points, np.float64))

    def _add_shapes(self, points, time: Usd.TimeCode) -> None:
        """Add the blend shapes, and those between them, to `points`."""
        assert self.shapes is not None
        assert self.skeleton is not None
        assert self.skin is not None
        animation = self.skeleton.GetAnimQuery()
        weights = animation.ComputeBlendShapeWeights(time) if animation else None
        if not weights:
            return
        mapper = self.skin.GetBlendShapeMapper()
        weights = mapper.Remap(weights) if mapper else weights
        self.shapes.ComputeDeformedPoints(
            *self.shapes.ComputeSubShapeWeights(weights),
            self.shapes.ComputeBlendShapePointIndices(),
            self.shapes.ComputeSubShapePointOffsets(),
            points,
        )


def with_skins(stage: Usd.Stage, prims: list[Usd.Prim]) -> list[Body]:
    """Each prim with the skeleton, skin and blend shapes that UsdSkel binds to it."""
    cache = UsdSkel.Cache()
    skins = {}
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), EVERYTHING):
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, EVERYTHING)
            for binding in cache.ComputeSkelBindings(root, EVERYTHING):
                skeleton = cache.GetSkelQuery(binding.GetSkeleton())
                for skin in binding.GetSkinningTargets():
                    skins[skin.GetPrim().GetPath()] = (skeleton, skin)
    return [_body(prim, *skins.get(prim.GetPath(), (None, None))) for prim in prims]


def moved_by(transform: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Points taken to another frame."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def _body(prim: Usd.Prim, skeleton, skin) -> Body:
    shaped = skin is not None and skin.HasBlendShapes()
    shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim)) if shaped else None
    return Body(prim, skeleton, skin, shapes)
