"""Take the heading out of a mesh: the same normalised points for every angle at which it stands in its file.

The horizontal principal axes of a surface turn with it, so the front is sought at eight angles from them, 45 degrees
apart, by the detector of the orientation. They are axes of the surface, not of its vertices: other triangles of the
same surface have the same.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from .geometry import face_areas, turned
from .mesh import Mesh
from .normalization import (
    ORIENTATIONS,
    ROTATIONS,
    Normalization,
    axis_name,
    bbox_centre,
    detector,
    mesh_occupancy,
    orientation_scores,
    radius,
    rotate_axes,
    up_margin,
)

ROUND = 1e-5
"""Relative difference of the two horizontal moments below which a mesh has no principal axes and keeps its heading."""
DIGITS = 12
"""Decimals of the principal angle (radians) that are kept: the last bits depend on the order of the vertices."""
WITHIN = np.radians(60)
"""Largest angle between a given front and the heading that is taken out."""
LEVEL = 0.5
"""Smallest horizontal part of a front that has a heading."""
FRONT_DIGITS = 1
"""Decimals of the angle of a predicted front (radians) that are kept."""
QUARTERS = ("+z", "+x", "-z", "-x")
"""Axes at 0, 1, 2 and 3 right angles from z towards x."""


def turn(angle: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation about y by an angle (radians) from z towards x."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def without_heading(mesh: Mesh, norm: Normalization, front_known: bool, person: bool = True) -> Normalization:
    """Return a normalization that takes the heading out as well.

    Args:
        mesh: the mesh that `norm` was fitted to.
        norm: its normalization by an axis rotation.
        front_known: whether its front was given: a person's is then sought within WITHIN of it. Else it is detected
            again from the turned mesh, and the axis of the file that is nearest to it becomes the front.
        person: whether the mesh is a person, which the detector knows. The body of an animal lies along its front: of
            the principal axes the one that is nearest to the front is taken.
    """
    upright = _at(mesh, rotate_axes(np.asarray(mesh.vertices, np.float64), norm.rotation))
    principal = principal_heading(upright)
    if principal is None:
        return norm
    headings = principal + np.arange(8) * np.pi / 4
    headings = (headings + np.pi) % (2 * np.pi) - np.pi
    if not person:
        return _turned(upright, norm, norm.rotation, min(headings[::2], key=abs))
    scores = _front_scores(upright, principal)
    if front_known:
        best = int(np.where(np.abs(headings) <= WITHIN, scores, -np.inf).argmax())
        return _turned(upright, norm, norm.rotation, headings[best])
    best = int(scores.argmax())
    quarter = int(np.round(headings[best] / (np.pi / 2)))
    rotation = ROTATIONS[ORIENTATIONS.index(("+y", QUARTERS[quarter % 4]))] @ norm.rotation
    # Margin over the fronts at right angles to the best one, as for a mesh that stands along the axes.
    probability = np.exp(scores[best % 2 :: 2] - scores[best])
    margin = float((1 - np.sort(probability)[-2]) / probability.sum())
    margin = margin if norm.up_from != "shape" else min(margin, up_margin(mesh, norm.up))
    detected = dataclasses.replace(norm, front=axis_name(rotation.T @ np.array([0.0, 0.0, 1.0])), margin=margin)
    upright = _at(mesh, rotate_axes(np.asarray(mesh.vertices, np.float64), rotation))
    return _turned(upright, detected, rotation, headings[best] - quarter * np.pi / 2)


def turned_to_front(
    mesh: Mesh, norm: Normalization, front: Float[np.ndarray, " 3"], front_known: bool
) -> Normalization:
    """Return a normalization in which a predicted front faces +z.

    Args:
        mesh: the mesh that `norm` was fitted to.
        norm: its normalization without the heading.
        front: the front that a model has predicted from the normalised mesh, a unit vector. One that points up or down
            has no heading, and changes nothing.
        front_known: whether the front of `norm` was given: a prediction that contradicts it is turned around.
    """
    if np.hypot(front[0], front[2]) < LEVEL:
        return norm
    # Rounded: inputs that differ in their last bits give predictions that differ by some thousandths.
    heading = norm.heading + np.round(np.arctan2(front[0], front[2]), FRONT_DIGITS)
    heading = (heading + np.pi) % (2 * np.pi) - np.pi
    if front_known and abs(heading) > np.pi / 2:
        heading -= np.sign(heading) * np.pi
    upright = _at(mesh, rotate_axes(np.asarray(mesh.vertices, np.float64), norm.axes))
    return _turned(upright, norm, norm.axes, heading)


def principal_heading(upright: Mesh) -> float | None:
    """Return the angle of the longer horizontal principal axis of a surface, radians from z towards x, 0 to pi.

    None where both are of one length. Of a point cloud, the axes of its points.
    """
    corners = upright.vertices[:, None, [0, 2]]
    areas = np.ones(len(corners))
    if len(upright.faces) > 1:
        corners, areas = upright.vertices[:, [0, 2]][upright.faces], face_areas(upright.vertices, upright.faces)
    areas = areas / areas.sum()
    corners = corners - areas @ corners.mean(axis=1)
    # Second moments of a triangle: those of its three corners and of three times its centroid, over 12.
    count = corners.shape[1]
    points = np.concatenate([corners, corners.sum(axis=1, keepdims=True)], axis=1)
    xx, zz, xz = (
        areas @ (points[..., j] * points[..., k]).sum(axis=1) / (count * (count + 1))
        for j, k in ((0, 0), (1, 1), (0, 1))
    )
    if np.hypot(zz - xx, 2 * xz) <= ROUND * (xx + zz):
        return None
    return float(np.round(np.arctan2(2 * xz, zz - xx) / 2, DIGITS) % np.pi)


def _front_scores(upright: Mesh, principal: float) -> Float[np.ndarray, "8"]:
    """Score the fronts at `principal` + k * 45 degrees by the detector of the orientation."""
    scores = np.empty(8)
    fronts = [ORIENTATIONS.index(("+y", axis)) for axis in QUARTERS]
    for k in range(2):
        aligned = _at(upright, turned(upright.vertices, -principal - k * np.pi / 4))
        scores[k::2] = orientation_scores(mesh_occupancy(aligned), detector())[fronts]
    # Rounded, so that the rounding of a sum cannot decide between the equal fronts of a symmetric shape.
    return np.round(scores, 6)


def _at(mesh: Mesh, vertices: Float[np.ndarray, "V 3"]) -> Mesh:
    """Replace the points of a mesh without its normals, which nothing here reads: turning them costs more than all."""
    return dataclasses.replace(mesh, vertices=vertices, corner_normals=None)


def _turned(upright: Mesh, norm: Normalization, rotation: Float[np.ndarray, "3 3"], heading: float) -> Normalization:
    """Return a normalization that applies an axis rotation, then takes out a heading, then centres and scales."""
    vertices = turned(upright.vertices, -heading)
    centre = bbox_centre(vertices)
    return dataclasses.replace(
        norm,
        rotation=turn(-heading) @ rotation,
        centre=centre,
        radius=radius(vertices - centre),
        heading=float(heading),
    )
