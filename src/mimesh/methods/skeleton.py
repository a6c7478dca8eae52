"""The baseline "skeleton" (NPT, appendix C.1): fit a body to both meshes, bind the identity to its skeleton, move that.

The fits see point sets only and half of the shape components. The identity keeps its own limb lengths: each of its
bones turns as the driving's bone stands to its own, and hangs where its parent ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody, load_body
from ..bodies.body_parameters import BodyParameters, thin_body
from ..bodies.chamfer_fit import fit_points
from ..core.canonical_order import CanonicalOrder, canonical_order
from ..core.mesh import Clip, Mesh
from ..core.skinning import place_joints, skin_points
from ..core.surface_points import rounded, surface_sampler
from .base import Drive
from .heat_weights import heat_weights
from .root_motion import with_root_motion

POINTS = 4000
"""Points of each mesh, and of the body, that the fits compare."""


@dataclass(frozen=True, eq=False)
class SkeletonBaseline:
    """Moves people only, shaped and posed somewhat like our body: anything else gets some result."""

    rough: ClassVar[bool] = False
    name: str = "skeleton"
    seed: int = 0

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Fit and bind the identity, and choose the driving's points, once for all frames."""
        body = load_body()
        thin = thin_body(body, POINTS, len(body.components) // 2)
        sample = surface_sampler(identity, POINTS, np.random.default_rng([self.seed, 0]))
        own = fit_points(thin, sample(identity.vertices), seed=self.seed)
        # Everything is moved in ranked order: sums of a matrix product may depend on the row that they stand in.
        ranked = canonical_order(identity.vertices)
        still, weights = ranked.merge(identity.vertices), bind(identity, ranked, thin, own)
        watch = surface_sampler(driving.mesh, POINTS, np.random.default_rng([self.seed, 0]))

        def poser() -> Callable[[Float[np.ndarray, "U 3"]], Float[np.ndarray, "V 3"]]:
            last: BodyParameters | None = None

            def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
                nonlocal last
                last = fit_points(thin, watch(vertices), last, self.seed)
                rotation, offset = bone_transforms(thin, own, last)
                return skin_points(still, weights, rotation, offset)[ranked.group]

            return pose

        return lambda frames: with_root_motion(frames, poser(), driving.mesh.name)


def bind(identity: Mesh, ranked: CanonicalOrder, body: RiggedBody, fit: BodyParameters) -> Float[np.ndarray, "W J"]:
    """Heat weights of the identity's distinct positions for the joints of the fit."""
    vertices = rounded(ranked.merge(identity.vertices))
    faces = ranked.group[identity.faces]
    first_corner = faces.argmin(axis=1)[:, None]
    faces = np.unique(np.take_along_axis(faces, (first_corner + np.arange(3)) % 3, axis=1), axis=0)
    segments, owners = bone_segments(body, fit)
    return heat_weights(vertices, faces, segments, owners, len(body.parents))


def bone_segments(body: RiggedBody, fit: BodyParameters) -> tuple[Float[np.ndarray, "S 2 3"], Int[np.ndarray, " S"]]:
    """Segments from each joint to its children, and the joint that owns each.

    The last joint of a limb ends as far beyond the middle of its points as this is from the joint.
    """
    joints = fit.joints(body)
    points = fit.points(body)
    segments, owners = [], []
    for j in range(len(joints)):
        children = [c for c, parent in enumerate(body.parents) if parent == j]
        ends = joints[children] if children else [2 * _middle(points, body.weights[:, j]) - joints[j]]
        segments += [(joints[j], end) for end in ends]
        owners += [j] * len(ends)
    return np.array(segments), np.array(owners)


def _middle(points: Float[np.ndarray, "V 3"], weights: Float[np.ndarray, " V"]) -> Float[np.ndarray, " 3"]:
    """Mean of points by their weights for one joint."""
    assert weights.sum() > 0, "a joint at the end of a limb moves none of the body's points: take more of them"
    return weights @ points / weights.sum()


def bone_transforms(
    body: RiggedBody, own: BodyParameters, other: BodyParameters
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]:
    """What each bone of the skeleton `own` does to take the directions of `other`: x -> rotation x + offset."""
    rotation = other.rotations(body) @ own.rotations(body).transpose(0, 2, 1)
    joints = own.joints(body)
    bones = joints[1:] - joints[list(body.parents[1:])]
    places = place_joints(joints[0], bones, rotation, body.parents)
    return rotation, places - np.einsum("jkl,jl->jk", rotation, joints)
