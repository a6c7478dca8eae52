"""Drives an identity without a rig by another shape of the same mesh: deformation transfer, by vertex index.

The reference, which deformation transfer needs, is the frame of the driving that is nearest to the identity.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError, option
from ..core.geometry import nearest_rotation
from ..core.mesh import Clip, Mesh, same_mesh
from ..core.normalization import ORIENTATIONS, ROTATIONS, Normalization
from ..methods.base import Method
from ..methods.deformation_transfer import DeformationTransfer
from .report import ReferenceReport

FRAMES = 240
"""Most frames, evenly spread over a clip, among which the reference is looked for."""


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """The frame of a driving that is nearest to an identity of the same mesh."""

    frame: int
    vertices: Float[np.ndarray, "V 3"]
    """Of that frame, turned as the identity is turned, in the axes of the identity's file."""
    turn: Float[np.ndarray, "3 3"]
    """The rotation that did it."""
    distance: float
    """Root mean square distance from the identity after scaling, over the root mean square radius of the identity."""

    def axes(self, norm: Normalization) -> tuple[str, str]:
        """Return up and front of the driving: those of the identity, whose normalisation is given.

        Where the reference had to be turned from one up axis to another, the files have other axes.
        """
        nearest = ROTATIONS[int(np.einsum("rkl,kl->r", ROTATIONS, self.turn).argmax())]
        same_up = np.array_equal(norm.rotation[1] @ nearest, norm.rotation[1])
        rotation = norm.rotation if same_up else norm.rotation @ nearest
        return ORIENTATIONS[int(np.abs(ROTATIONS - rotation).sum(axis=(1, 2)).argmin())]

    def method(self, driving: Mesh, identity: Normalization, norm: Normalization) -> Method:
        """Make the method, from the normalisations of the identity and of the driving."""
        vertices = self.vertices @ identity.rotation.T / norm.radius
        return DeformationTransfer(dataclasses.replace(driving, vertices=vertices))

    def facts(self) -> ReferenceReport:
        """Return the figures for the report."""
        return {"frame": self.frame, "distance": round(self.distance, 4)}

    def note(self, names: tuple[str, str]) -> str:
        """Tell what was done with identity and driving, whose names are given."""
        return (
            f"{names[0]} is moved as another shape of the mesh {names[1]}, vertex by vertex (deformation transfer): "
            f"frame {self.frame}, which differs by {self.distance:.0%} of the size, is taken to have its pose; "
            f"{option('model', 'deformation-transfer')} takes another one with {option('reference', ...)}"
        )


def same_triangles(identity: Mesh, driving: Mesh) -> bool:
    """Tell whether identity and driving are shapes of one mesh, so that their vertices correspond; points need not."""
    return len(identity.faces) > 0 and same_mesh(identity, driving)


def paired_note(method: Method, identity: Mesh, driving: Mesh) -> tuple[str, ...]:
    """Tell that a network pairs the vertices of the two meshes by index, if it does."""
    paired = getattr(method, "pairing", "random") == "order" and same_triangles(identity, driving)
    return ("both meshes have the same triangles, so vertices are paired by index",) if paired else ()


def nearest_frame(identity: Mesh, clip: Clip) -> ReferenceFrame:
    """Find the frame of a clip of the same mesh that is nearest to the identity, whatever its heading and size.

    Raises:
        InputError: other meshes, one frame only, or all vertices of the identity or of each frame are at one point.
    """
    if not same_mesh(identity, clip.mesh):
        raise InputError(
            f"{identity.name}, {clip.mesh.name}: expected rigs in both files, or two shapes of one mesh, found "
            f"neither; rig both, or give {option('markers', ...)} and {option('reference', ...)} with "
            f"{option('model', 'deformation-transfer')}"
        )
    if len(clip) == 1:
        raise InputError(
            f"{clip.mesh.name}: expected a clip, in which one frame has about the pose of {identity.name}, found one "
            f"pose; give it with {option('reference', ...)}, and {option('model', 'deformation-transfer')}"
        )
    target = identity.vertices - identity.vertices.mean(axis=0)
    radius = float(np.sqrt(np.square(target).sum()))
    found = None
    for t in np.unique(np.linspace(0, len(clip) - 1, FRAMES).round().astype(int)):
        points = np.asarray(clip.vertices[t], np.float64)
        points = points - points.mean(axis=0)
        size = float(np.sqrt(np.square(points).sum()))
        if size == 0 or radius == 0:
            continue
        turn = nearest_rotation(target.T @ points)
        turned = points @ turn.T
        cosine = float((turned * target).sum()) / (size * radius)
        distance = float(np.sqrt(max(1 - cosine**2, 0.0)))  # of the best scale
        if found is None or distance < found.distance:
            found = ReferenceFrame(int(t), turned, turn, distance)
    if found is None:
        raise InputError(f"{identity.name}, {clip.mesh.name}: expected meshes with a size, found points; repair them")
    return found
