"""One trial of a test set, how it is staged from people, and how its vertices are shuffled."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody, load_body
from ..bodies.body_model import landmarks
from ..core.mesh import Mesh, permute_vertices
from .remesh import Remesh

LOST = 0.08
"""Metres from a landmark to the nearest vertex left, beyond which a damaged mesh has lost it."""


@dataclass(frozen=True, eq=False)
class Pair:
    """One trial in metres. Methods get `identity` and `driving`; the rest is truth, or help that a method may ask for.

    Arrays with V rows are in the identity's vertex order, those with U rows in the driving's.
    """

    identity: Mesh
    driving: Mesh
    truth: Float[np.ndarray, "V 3"]
    height: float
    """The identity person's height at rest in metres, without hair or shoes."""
    aligned: Float[np.ndarray, "V 3"] | None = None
    """The driving person with true correspondence, dressed as the identity, whole: what the row `copy` is made of."""
    aligned_reference: Float[np.ndarray, "V 3"] | None = None
    """The same in the identity's pose; None where the driving mesh as given has other vertices."""
    reference: Float[np.ndarray, "U 3"] | None = None
    """The same on the driving's own vertices: the third mesh that deformation transfer is given."""
    markers: Int[np.ndarray, "M 2"] | None = None
    """Identity and driving vertex of each of `bodies.landmarks.LANDMARKS`; -1 where the driving mesh lacks it."""
    truth_name: str = "truth"


@dataclass(frozen=True, eq=False)
class Person:
    """Somebody in a pose."""

    body: RiggedBody
    """Whose vertices; may be dressed."""
    shape: Float[np.ndarray, " K"]
    label: str

    def posed(self, rotmat: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "V 3"]:
        """Vertices in metres."""
        return self.body.posed(self.shape, rotmat)

    def mesh(self, rotmat: Float[np.ndarray, "J 3 3"], pose: str) -> Mesh:
        """The same as a mesh, called id<person>_<pose> as the papers' released data are."""
        return Mesh(self.posed(rotmat), self.body.faces, name=f"id{self.label}_{pose}")


@dataclass(frozen=True, eq=False)
class Pose:
    """Joint rotations and what they are called."""

    rotmat: Float[np.ndarray, "J 3 3"]
    label: str


@cache
def human() -> RiggedBody:
    """The shipped body, read once."""
    return load_body()


def stage(mover: Person, actor: Person, stand: Pose, played: Pose) -> Pair:
    """The mover stands, the actor plays; truth is the mover playing. No vertex is shuffled yet."""
    twin = dataclasses.replace(mover, shape=actor.shape)
    # Garments come after the body's own vertices, so its landmarks keep their numbers.
    points = list(landmarks(human()).values())
    return Pair(
        identity=mover.mesh(stand.rotmat, stand.label),
        driving=actor.mesh(played.rotmat, played.label),
        truth=mover.posed(played.rotmat),
        height=float(np.ptp(human().shaped(mover.shape)[0][:, 1])),
        aligned=twin.posed(played.rotmat),
        aligned_reference=twin.posed(stand.rotmat),
        reference=actor.posed(stand.rotmat),
        markers=np.stack([points, points], axis=1),
        truth_name=f"id{mover.label}_{played.label}",
    )


def remeshed(pair: Pair, remesh: Remesh, noise: Callable[[Float[np.ndarray, "U 3"]], np.ndarray] | None = None) -> Pair:
    """The driving mesh (and its reference alike) on other vertices; `noise` then moves those of the driving alone."""
    assert pair.reference is not None
    assert pair.markers is not None
    vertices = remesh.at(pair.driving.vertices)
    nearest = remesh.nearest(pair.driving.vertices, pair.markers[:, 1])
    away = np.linalg.norm(vertices[nearest] - pair.driving.vertices[pair.markers[:, 1]], axis=1)
    return dataclasses.replace(
        pair,
        driving=Mesh(vertices if noise is None else noise(vertices), remesh.faces, name=pair.driving.name),
        reference=remesh.at(pair.reference),
        aligned_reference=None,
        markers=np.stack([pair.markers[:, 0], np.where(away < LOST, nearest, -1)], axis=1),
    )


def shuffled(pair: Pair, rng: np.random.Generator) -> Pair:
    """Both meshes with their vertices in random orders, independent of each other; truth and markers follow."""
    return reordered(pair, *random_orders(pair, rng))


def random_orders(pair: Pair, rng: np.random.Generator) -> tuple[Int[np.ndarray, " V"], Int[np.ndarray, " U"]]:
    """New orders of the identity's and of the driving's vertices."""
    return rng.permutation(len(pair.identity.vertices)), rng.permutation(len(pair.driving.vertices))


def reordered(pair: Pair, order: Int[np.ndarray, " V"], driving_order: Int[np.ndarray, " U"]) -> Pair:
    """The pair with its identity's and its driving's vertices in other orders; truth and markers follow."""
    ranks = np.argsort(order), np.argsort(driving_order)
    markers = None
    if pair.markers is not None:
        columns = zip(ranks, pair.markers.T, strict=True)
        markers = np.stack([np.where(column < 0, -1, rank[column]) for rank, column in columns], axis=1)
    return dataclasses.replace(
        pair,
        identity=permute_vertices(pair.identity, order),
        driving=permute_vertices(pair.driving, driving_order),
        truth=pair.truth[order],
        aligned=_reordered(pair.aligned, order),
        aligned_reference=_reordered(pair.aligned_reference, order),
        reference=_reordered(pair.reference, driving_order),
        markers=markers,
    )


def _reordered(array: Float[np.ndarray, "N 3"] | None, order: Int[np.ndarray, " N"]) -> Float[np.ndarray, "N 3"] | None:
    return None if array is None else array[order]
