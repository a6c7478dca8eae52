"""Points of the driving that correspond to the vertices of the identity, whatever faces both meshes have.

The shipped body is fitted to both meshes. A vertex of the identity lies near some vertices of the body at its own
fit; the same vertices at the driving's fit say where it belongs there, and the nearest point of the driving is taken.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...bodies.sampled_body import PosedBody
from ...core.canonical_order import canonical_faces, canonical_order
from ...core.errors import InputError
from ...core.geometry import closest_on_mesh
from ...core.mesh import Mesh
from ...core.surface_points import SurfacePoints
from ..npt import generator
from .body_fit import NEAREST, RELIABLE_MISMATCH, fit_predictions, whole_body
from .consensus import consensus
from .denoise import Denoiser, face_outward
from .ensemble import ENSEMBLE, sampled_points
from .surface_sample import SurfaceSample

if TYPE_CHECKING:
    from .drive import MimeMethod


def body_pairs(mime: MimeMethod, identity: Mesh, driving: Mesh) -> SurfacePoints:
    """Find the point of the driving for each distinct position of the identity, by rank (`canonical_order`).

    Both meshes are normalised. The order of their vertices and faces has no influence.

    Raises:
        InputError: the body does not have the shape of one of the meshes.
    """
    from scipy.spatial import KDTree

    mine, theirs = fitted_body(mime, identity), fitted_body(mime, driving)
    distance, index = KDTree(mine.points).query(canonical_order(identity.vertices).merge(identity.vertices), k=NEAREST)
    share = 1 / np.maximum(distance, 1e-9 * mine.state.size) ** 2
    share /= share.sum(axis=1, keepdims=True)
    targets = np.einsum("wn,wnc->wc", share, theirs.points[index])
    ranked = canonical_order(driving.vertices)
    points, vertex = ranked.merge(driving.vertices), ranked.order[ranked.start]
    if len(driving.faces) == 0:
        nearest = vertex[np.asarray(KDTree(points).query(targets)[1])]
        return SurfacePoints(np.repeat(nearest[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(targets), 1)))
    faces = ranked.group[canonical_faces(driving.faces, ranked.group)]
    face, barycentric, _ = closest_on_mesh(targets, points, faces)
    return SurfacePoints(vertex[faces[face]], barycentric)


def fitted_body(mime: MimeMethod, mesh: Mesh) -> PosedBody:
    """Fit the shipped body to a normalised mesh, and return it with all of its vertices.

    Raises:
        InputError: the body does not have the shape of the mesh.
    """
    mesh = face_outward(mesh)
    ranked = canonical_order(mesh.vertices)
    denoised = Denoiser.of(mesh, ranked)(mesh.vertices)
    samples = sampled_points(mesh, denoised, ranked, ENSEMBLE * mime.points, generator(mime.seed, 0))
    rigs = [mime.ensemble.predict(samples, denoised, k) for k in range(ENSEMBLE)]
    surface = SurfaceSample(samples.points(mesh.vertices), samples.normals(denoised))
    fit = fit_predictions(surface, consensus(rigs), rigs, mime.body)
    if fit.distance > RELIABLE_MISMATCH:
        raise InputError(
            f"{mesh.name}: expected a shape that the shipped {mime.body} can be fitted to, found one that differs by "
            f"{1e3 * fit.distance:.1f} mm; give --pairing random"
        )
    return PosedBody(whole_body(mime.body), fit.posed.state)
