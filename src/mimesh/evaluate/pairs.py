"""A pair of a test set: how it is made from two people and two poses, and how its vertices are shuffled."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody, load_body
from ..bodies.body_model import landmarks
from ..core.mesh import Mesh, permute_vertices
from .remesh import Remesh

MISSING_DISTANCE = 0.08
"""Metres. A landmark is missing on a damaged mesh if no vertex is closer than this. 8 cm because coarse meshings, whose
vertices are some centimetres apart, must keep their landmarks."""


P = TypeVar("P", bound="Pair")


@dataclass(frozen=True, eq=False)
class Pair:
    """A pair of a test set: the meshes that methods get, the true result, and extra inputs for some methods.

    Lengths are in metres; those of pairs of rigged characters are in the units of their files.
    Arrays with V rows are in the identity's vertex order, those with U rows in the driving mesh's.
    """

    identity: Mesh
    """The mesh to be moved; methods get this and `driving`."""
    driving: Mesh
    """The mesh that has the wanted pose."""
    truth: Float[np.ndarray, "V 3"]
    """The true result: the identity person in the driving pose."""
    height: float
    """The identity person's height at rest, without hair or shoes."""
    metres: float = 1.0
    """Length of a unit in metres, for the public formula (`metrics.pmd_public`). Files of others do not say it: their
    people are scaled to 1.7 m, as for millimetres."""
    aligned: Float[np.ndarray, "V 3"] | None = None
    """The driving person with true correspondence, complete and dressed like the identity, for the baseline `copy`."""
    aligned_reference: Float[np.ndarray, "V 3"] | None = None
    """`aligned` in the identity's pose; None where the driving mesh has other vertices than the identity."""
    reference: Float[np.ndarray, "U 3"] | None = None
    """The driving mesh in the identity's pose: the third mesh of deformation transfer."""
    markers: Int[np.ndarray, "M 2"] | None = None
    """Identity and driving vertex of each landmark of the body; -1 where the driving mesh lacks it."""
    truth_name: str = "truth"
    """Name of the true result's file: id<person>_<pose>."""
    truth_known: bool = True
    """Whether `truth` is the true result. If not, it is an estimate, for its size and for pictures."""
    groups: tuple[str, str] = ("", "")
    """The identity person, and the driving person (in clips the take): pairs that share one are not independent."""

    def shuffled(self: P, rng: np.random.Generator) -> P:
        """Shuffle the vertices of both meshes independently; truth, extra inputs and markers follow."""
        return self.reordered(*(rng.permutation(len(mesh.vertices)) for mesh in (self.identity, self.driving)))

    def reordered(self: P, order: Int[np.ndarray, " V"], driving_order: Int[np.ndarray, " U"]) -> P:
        """Reorder the vertices of a pair: new vertex k of the identity is old vertex `order[k]`, and so on."""
        # Markers are vertex numbers, so they need the inverse orders: the rank of each old vertex in the new order.
        ranks = np.argsort(order), np.argsort(driving_order)
        markers = None
        if self.markers is not None:
            columns = zip(ranks, self.markers.T, strict=True)
            markers = np.stack([np.where(column < 0, -1, rank[column]) for rank, column in columns], axis=1)
        return dataclasses.replace(
            self,
            identity=permute_vertices(self.identity, order),
            driving=permute_vertices(self.driving, driving_order),
            truth=self.truth[order],
            aligned=_rows(self.aligned, order),
            aligned_reference=_rows(self.aligned_reference, order),
            reference=_rows(self.reference, driving_order),
            markers=markers,
        )


@dataclass(frozen=True, eq=False)
class Pose:
    """Local joint rotations of the shipped body, and a name."""

    rotmat: Float[np.ndarray, "J 3 3"]
    label: str


@dataclass(frozen=True, eq=False)
class Person:
    """A body of a shape."""

    body: RiggedBody
    """The shipped body, plain or dressed."""
    shape: Float[np.ndarray, " K"]
    """Shape coefficients."""
    label: str
    """The person's number in file names."""

    def posed_vertices(self, rotmat: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "V 3"]:
        """Return the vertices (metres) in a pose, given as local joint rotations."""
        return self.body.posed(self.shape, rotmat)

    def posed_mesh(self, pose: Pose) -> Mesh:
        """Return the mesh in a pose, named id<person>_<pose> like the papers' released data."""
        return Mesh(self.posed_vertices(pose.rotmat), self.body.faces, name=f"id{self.label}_{pose.label}")


@cache
def human() -> RiggedBody:
    """Return the shipped body, read once."""
    return load_body()


def make_pair(identity: Person, driving: Person, rest: Pose, pose: Pose) -> Pair:
    """Make a pair from two people and two poses, in the body's vertex order.

    The identity mesh is the identity person in the pose `rest`, the driving mesh is the driving person in `pose`, and
    the true result is the identity person in `pose`.
    """
    # The driving person's shape with the identity's garments has the identity's vertices: the true correspondence.
    aligned = dataclasses.replace(identity, shape=driving.shape)
    # Garments come after the body's own vertices, so landmarks have the same numbers on a dressed body.
    body = identity.body if identity.body.name == "quadruped" else human()
    points = list(landmarks(body).values())
    return Pair(
        identity=identity.posed_mesh(rest),
        driving=driving.posed_mesh(pose),
        truth=identity.posed_vertices(pose.rotmat),
        height=float(np.ptp(body.shaped(identity.shape)[0][:, 1])),
        aligned=aligned.posed_vertices(pose.rotmat),
        aligned_reference=aligned.posed_vertices(rest.rotmat),
        reference=driving.posed_vertices(rest.rotmat),
        markers=np.stack([points, points], axis=1),
        truth_name=f"id{identity.label}_{pose.label}",
        groups=(identity.label, driving.label),
    )


def remesh_driving(pair: Pair, remesh: Remesh) -> Pair:
    """Replace the vertices and triangles of the driving mesh, and of its reference alike, by those of a remeshing."""
    assert pair.reference is not None
    assert pair.markers is not None
    vertices = remesh.positions(pair.driving.vertices)
    nearest = remesh.nearest(pair.driving.vertices, pair.markers[:, 1])
    distance = np.linalg.norm(vertices[nearest] - pair.driving.vertices[pair.markers[:, 1]], axis=1)
    return dataclasses.replace(
        pair,
        driving=Mesh(vertices, remesh.faces, name=pair.driving.name),
        reference=remesh.positions(pair.reference),
        aligned_reference=None,
        markers=np.stack([pair.markers[:, 0], np.where(distance < MISSING_DISTANCE, nearest, -1)], axis=1),
    )


def _rows(array: Float[np.ndarray, "N 3"] | None, order: Int[np.ndarray, " N"]) -> Float[np.ndarray, "N 3"] | None:
    return None if array is None else array[order]
