"""The baseline `skeleton` (NPT, appendix C.1): fit a body to both meshes, skin the identity to its bones, move those.

The fits use point sets only, and half of the shape components. The identity keeps its own bone lengths: each bone takes
the rotation from its fit to the driving's fit, and starts where its parent ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody, load_body
from ..bodies.chamfer_fit import BodyParameters, fit_points, thin_body
from ..core.canonical_order import CanonicalOrder, canonical_order
from ..core.mesh import Clip, Mesh
from ..core.skinning import place_joints, skin_points
from ..core.surface_points import rounded, surface_sampler
from .base import Drive
from .heat_weights import heat_weights
from .root_motion import with_root_motion

POINTS = 4000
"""Points of each mesh, and of the body, between which the fits measure distances."""


@dataclass(frozen=True, eq=False)
class SkeletonBaseline:
    """The method `skeleton`, for people whose shape and pose the body can fit; other results are arbitrary."""

    rough: ClassVar[bool] = False
    name: str = "skeleton"
    seed: int = 0

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Fit a body to the identity, compute its weights, and choose the driving's points, once for all frames."""
        body = load_body()
        thin = thin_body(body, POINTS, len(body.components) // 2)
        sample = surface_sampler(identity, POINTS, np.random.default_rng([self.seed, 0]))
        identity_fit = fit_points(thin, sample(identity.vertices), seed=self.seed)
        # Skinning is done in ranked order: the last bits of a matrix product may depend on the order of its rows.
        ranked = canonical_order(identity.vertices)
        rest, weights = ranked.merge(identity.vertices), bind(identity, ranked, thin, identity_fit)
        driving_sample = surface_sampler(driving.mesh, POINTS, np.random.default_rng([self.seed, 0]))

        # One function for each run over the clip, so that a second run starts without a previous fit.
        def pose_function() -> Callable[[Float[np.ndarray, "U 3"]], Float[np.ndarray, "V 3"]]:
            fit: BodyParameters | None = None

            def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
                nonlocal fit  # the fit to a frame starts from the one before
                fit = fit_points(thin, driving_sample(vertices), fit, self.seed)
                rotation, offset = bone_transforms(thin, identity_fit, fit)
                return skin_points(rest, weights, rotation, offset)[ranked.group]

            return pose

        return lambda frames: with_root_motion(frames, partial(map, pose_function()), driving.mesh.name)


def bind(identity: Mesh, ranked: CanonicalOrder, body: RiggedBody, fit: BodyParameters) -> Float[np.ndarray, "W J"]:
    """Compute heat weights of the identity's distinct positions for the joints of a fit."""
    vertices = rounded(ranked.merge(identity.vertices))
    faces = ranked.group[identity.faces]
    # Faces start at their smallest index and are sorted, so that the result does not depend on their order.
    first_corner = faces.argmin(axis=1)[:, None]
    faces = np.unique(np.take_along_axis(faces, (first_corner + np.arange(3)) % 3, axis=1), axis=0)
    segments, owners = bone_segments(body, fit)
    return heat_weights(vertices, faces, segments, owners, len(body.parents))


def bone_segments(body: RiggedBody, fit: BodyParameters) -> tuple[Float[np.ndarray, "S 2 3"], Int[np.ndarray, " S"]]:
    """Return the segments from each joint to its children, and the joint that owns each.

    The segment of a joint without children is twice as long as the way to the centroid of its points.
    """
    joints = fit.joints(body)
    points = fit.points(body)
    segments, owners = [], []
    for j in range(len(joints)):
        children = [c for c, parent in enumerate(body.parents) if parent == j]
        ends = joints[children] if children else [2 * _centroid(points, body.weights[:, j]) - joints[j]]
        segments += [(joints[j], end) for end in ends]
        owners += [j] * len(ends)
    return np.array(segments), np.array(owners)


def _centroid(points: Float[np.ndarray, "V 3"], weights: Float[np.ndarray, " V"]) -> Float[np.ndarray, " 3"]:
    """Return the mean of points by their weights for one joint."""
    assert weights.sum() > 0, "a joint at the end of a limb moves none of the body's points: take more of them"
    return weights @ points / weights.sum()


def bone_transforms(
    body: RiggedBody, identity_fit: BodyParameters, driving_fit: BodyParameters
) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]:
    """Return the map x -> rotation x + offset of each bone that gives the identity the driving's pose.

    Bones keep the identity's lengths; the root joint stays.
    """
    rotation = driving_fit.rotations(body) @ identity_fit.rotations(body).transpose(0, 2, 1)
    joints = identity_fit.joints(body)
    bones = joints[1:] - joints[list(body.parents[1:])]
    positions = place_joints(joints[0], bones, rotation, body.parents)
    return rotation, positions - np.einsum("jkl,jl->jk", rotation, joints)
