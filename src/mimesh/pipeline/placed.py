"""What all routes from an identity and a clip to a result share: the place of results, and their report."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core.animated_rig import AnimatedRig
from ..core.errors import InputError
from ..core.frame_buffer import LazyFrames, evenly_spread
from ..core.mesh import Clip, Mesh, drawn_points
from ..core.normalization import Normalization, bbox_centre, turn
from ..core.surface_points import SurfacePoints
from ..io.beside import missing_images, missing_images_notes
from .file_rigs import NO_RIGS, Rigs
from .refine import Refinement
from .report import MeshReport, TransferReport, facing, facing_note, quality
from .result import ClipResult, Timer

if TYPE_CHECKING:
    from ..io.gltf.own_animation import OwnAnimation

KEYFRAMES = 16
"""Largest number of frames, evenly spread over a clip, that are looked at before it is moved."""
MOTION_FRAMES = 120
"""Largest number of frames, evenly spread, in which points of the surface are followed to tell whether fingers move."""
FEWEST_VERTICES = 4
"""Vertices of the smallest solid, a tetrahedron; two points and one triangle have no pose."""
SOLE_ERROR = 0.05
"""Radii of a mesh by which its lowest vertex may be below its soles and still be one of them."""
JointPositions = dict[str, Float[np.ndarray, " 3"]]
"""Joint -> position in the axes, unit and position of a mesh's file."""


@dataclass(frozen=True, eq=False)
class Moved:
    """A result in the identity's axes, unit and position, with its report."""

    frames: LazyFrames
    skeleton: AnimatedRig | None
    """Joints, skinning weights and motion of the identity, if the model has joints."""
    own: OwnAnimation | None
    """The motion on the bones of the identity's own file, if it has a rig that is used."""
    report: TransferReport
    notes: tuple[str, ...]
    driving_joints: JointPositions | None = None
    """Joints of the driving in its first frame, in its axes, unit and position, if the model has joints."""

    def clip_result(self, identity: Mesh, clip: Clip, model: str, timer: Timer, notes: tuple[str, ...]) -> ClipResult:
        """Return the result of a clip, with all notes."""
        return ClipResult(
            identity.with_vertices(self.frames.first()),
            self.frames,
            clip.fps,
            model,
            timer,
            self.report,
            notes,
            self.skeleton,
            identity,
            clip,
            self.driving_joints,
            self.own,
        )


@dataclass(frozen=True, eq=False)
class FoundJoints:
    """Joints of both meshes, without those of fingers."""

    body: str
    """Name of the shipped body whose joints they are."""
    identity: JointPositions
    driving: JointPositions


@dataclass(frozen=True, eq=False)
class Placed:
    """An identity and a clip in their normalisations; results get from there to the identity's place."""

    identity: Mesh
    clip: Clip
    norms: tuple[Normalization, Normalization]
    """Of the identity, and of the driving's first frame, which is used for all of its frames: so its path is kept."""
    rest: Mesh
    """The identity, normalised."""
    refinement: Refinement | None = None
    """Refines results; None leaves them as they are."""
    rigs: Rigs = NO_RIGS
    """The rigs of the files that are used."""
    notes: tuple[str, ...] = ()
    """Notes for the user on what the meshes show."""

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """The turn of results about y: results have the driving's heading, not the identity's.

        Where the rest pose of a rig faces between the axes, results are turned from there.
        """
        return turn(self.norms[1].heading - self.norms[0].heading + self.rigs.heading)

    @property
    def stride(self) -> float:
        """Displacement of the result over the driving's, each normalised."""
        return 1.0

    def floor(self, lowest: float) -> float:
        """Return the height of the driving's floor, normalised; `lowest` is that of its lowest vertex in keyframes."""
        return lowest

    def shift(self, first: Float[np.ndarray, "V 3"], lift: float | None) -> Float[np.ndarray, " 3"]:
        """Return the displacement that brings a result to the identity's position; normalised.

        Args:
            first: its first frame, whose bounding box is centred where the identity's is.
            lift: how far up it goes to stand on the identity's floor (`Retarget.lift`); None: the lowest vertex of the
                first frame is as high over the identity's lowest as the driving's is over its floor, scaled. So it is
                in a single pose without a rest pose, too, unless something hangs below the soles: soles are means of
                points, over the edges of feet that tilt.
        """
        upright = turn(self.norms[0].heading)  # bounding boxes are those in the axes of the file
        own, moved = (drawn_points(self.rest, points) @ upright.T for points in (self.rest.vertices, first))
        if lift is None or len(self.clip) == 1:
            chosen = evenly_spread(len(self.clip), KEYFRAMES)
            lowest = self.norms[1].apply(drawn_points(self.clip.mesh, self.clip.vertices[chosen]))[..., 1].min(axis=1)
            above = self.stride * (lowest[0] - self.floor(float(lowest.min())))
            lowest_on_floor = float(own[:, 1].min() + above - moved[:, 1].min())
            alike = lift is not None and above == 0 and abs(lift - lowest_on_floor) < SOLE_ERROR
            lift = lowest_on_floor if lift is None or alike else lift
        x, _, z = bbox_centre(own) - bbox_centre(moved)
        return np.array([x, lift, z]) @ upright

    def refined(self, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """Refine a frame of a result, if results are refined."""
        return vertices if self.refinement is None else self.refinement(vertices)

    def driving_frame(self, t: int) -> Float[np.ndarray, "U 3"]:
        """Return a frame of the driving, normalised."""
        return self.norms[1].apply(np.asarray(self.clip.vertices[t], np.float64))

    @property
    def names(self) -> tuple[str, str]:
        """Names of identity and driving."""
        return self.identity.name, self.clip.mesh.name

    @property
    def facings(self) -> tuple[MeshReport, MeshReport]:
        """Axes of both meshes for the report."""
        return facing(self.norms[0]), facing(self.norms[1])

    def all_notes(self, keeps_file: bool) -> tuple[str, ...]:
        """Return the notes, and those on uncertain axes, on rigs that are not used, and on the identity's file."""
        notes = facing_note(self.norms[0], self.names[0], "front")
        notes += facing_note(self.norms[1], self.names[1], "driving_front")
        of_file = () if keeps_file else tuple(getattr(self.identity.source, "notes", ()))
        missing = missing_images_notes(missing_images(self.identity))
        return self.notes + notes + self.rigs.notes + of_file + missing


def surface_report(identity: Mesh, moved: LazyFrames, facings: tuple[MeshReport, MeshReport]) -> dict[str, Any]:
    """Return the part of the report that all results have."""
    return {**quality(identity, moved), "identity": facings[0], "driving": facings[1]}


def with_up(identity: Mesh, norm: Normalization) -> Mesh:
    """Name the up axis of an identity whose file defines none: formats that define one are then written standing."""
    return identity if identity.up is not None else dataclasses.replace(identity, up=norm.up)


def check_identity(identity: Mesh) -> None:
    """Raise InputError for a mesh to move that has too few points for a pose: they have no volume."""
    if len(identity.vertices) < FEWEST_VERTICES:
        raise InputError(
            f"{identity.name}: expected at least {FEWEST_VERTICES} vertices in the mesh to move, found "
            f"{len(identity.vertices)}; check that it is the whole character"
        )


def first_frame(clip: Clip) -> Mesh:
    """Return the driving mesh in the first frame of a clip, in double precision."""
    return dataclasses.replace(clip.mesh, vertices=clip.vertices[0].astype(np.float64))


def keyframes_of(clip: Clip, norm: Normalization) -> Clip:
    """Return at most KEYFRAMES frames of a clip, evenly spread and normalised, the first one first."""
    vertices = norm.apply(np.asarray(clip.vertices[evenly_spread(len(clip), KEYFRAMES)]))
    return Clip(dataclasses.replace(clip.mesh, vertices=vertices[0], up="+y"), vertices, clip.fps)


def surface_motion(clip: Clip, norm: Normalization, samples: SurfacePoints) -> Float[np.ndarray, "T N 3"]:
    """Return points of a clip's surface in at most MOTION_FRAMES frames, normalised; of each, only these are read."""
    chosen = evenly_spread(len(clip), MOTION_FRAMES)
    return np.stack([norm.apply(samples.points(clip.vertices[t])) for t in chosen])
