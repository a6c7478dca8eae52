"""Move an identity by a method that moves vertices: networks of the papers, deformation transfer, a user's.

An identity without a rig is moved by another shape of the same mesh with deformation transfer, by vertex index; the
reference that this needs is the frame of the driving that is nearest to the identity.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError, option
from ..core.frame_buffer import LazyFrames, Progress, each_frame, store_frames
from ..core.geometry import nearest_rotation
from ..core.mesh import Clip, Mesh, same_mesh
from ..core.normalization import ORIENTATIONS, ROTATIONS, Normalization
from ..core.options import MotionOptions
from ..methods.base import Drive, Method
from ..methods.deformation_transfer import DeformationTransfer
from ..methods.find import find_method
from ..rigs.retarget import JointMotion
from .file_rigs import NO_RIGS, Rigs
from .known import Known
from .look import check_known_body, normalised, trained_on_people, turned_as_animal
from .placed import SOLE_ERROR, Moved, Placed, first_frame, keyframes_of, surface_report, with_up
from .refine import Refinement
from .report import MeshReport, ReferenceReport, TransferReport, facing, torn_note
from .result import Precision, Timer


@dataclass(frozen=True, eq=False)
class NamedMethod:
    """A method that is opened by name when the driving's normalisation is known, which its reference needs too."""

    name: str
    options: dict[str, Any]
    """Options of `find_method`."""
    reference: Mesh | None

    def open(self, norm: Normalization) -> Method:
        """Open it."""
        reference = None if self.reference is None else normalised(self.reference, norm)
        return find_method(self.name, reference=reference, **self.options)


@dataclass(frozen=True, eq=False)
class VertexRoute(Placed):
    """A method that is ready to move an identity."""

    method: Method = field(kw_only=True)
    drive: Drive = field(kw_only=True)
    reference: ReferenceFrame | None = field(default=None, kw_only=True)
    """The frame of the driving in about the identity's pose, for deformation transfer of what is no body."""
    found_axes: tuple[MeshReport, MeshReport] | None = field(default=None, kw_only=True)
    """Axes for the report, where those of `norms` are not the caller's but were found with the reference."""

    @property
    def facings(self) -> tuple[MeshReport, MeshReport]:
        """Axes of both meshes for the report."""
        return self.found_axes or super().facings

    def floor(self, lowest: float) -> float:
        """Return the height of the driving's floor, normalised; `lowest` is that of its lowest vertex in keyframes."""
        driving, norm = self.rigs.driving, self.norms[1]
        if driving is None or driving.rest_vertices is None:
            return lowest
        motion = JointMotion.of_file(driving, normalised(first_frame(self.clip), norm), self.clip.fps, norm)
        heights = norm.apply(driving.rest_vertices)[:, 1]
        at_rest = heights[heights > motion.floor(lowest) - SOLE_ERROR].min()
        return float(at_rest) if motion.floor(lowest) == motion.rest_floor else lowest

    def with_refinement(self, refine: bool | None) -> VertexRoute:
        """Switch refinement on or off; None takes the method's default."""
        wanted = self.method.rough if refine is None else refine
        return dataclasses.replace(self, refinement=Refinement.of(self.rest) if wanted else None)

    def frame(self, t: int) -> Float[np.ndarray, "V 3"]:
        """Make the identity's vertices in frame t only, at their position in the whole clip.

        Methods that work in windows of frames get frames 0 and t alone: their result may differ from that of the clip.
        """
        # Frame 0 is needed too: it fixes the position of the whole clip, and the size of results of some methods.
        chosen = [0] if t == 0 else [0, t]
        frames = list(self._placed(map(self.driving_frame, chosen), Timer()))
        return frames[-1]

    def joints(self, t: int) -> None:
        """Return the joints of both meshes: there are none."""

    def play(
        self, timer: Timer, options: MotionOptions, progress: Progress | None = None, dtype: Precision = np.float64
    ) -> Moved:
        """Make all frames, and report."""
        identity, clip = self.identity, self.clip
        with timer.step("drive"):
            driving = (self.norms[1].apply(vertices) for vertices in each_frame(clip.vertices))
            frames = self._placed(driving, timer)
            stored = store_frames(frames, len(clip), len(identity.vertices), np.dtype(dtype), progress)
            moved = LazyFrames.stored(stored)
            report = surface_report(identity, moved, self.facings)
        report |= {} if self.reference is None else {"reference": self.reference.facts()}
        notes = torn_note(report, identity.name, found=False) + self.all_notes(False)
        return Moved(moved, None, None, cast(TransferReport, report), notes)

    def _placed(self, driving: Iterable[Float[np.ndarray, "U 3"]], timer: Timer) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield frames at the identity's place: the first one has its position."""
        frames = (vertices @ self.turn.T for vertices in self._refined(self._checked(self.drive(driving)), timer))
        first = next(frames)
        shift = self.shift(first, None)
        return (self.norms[0].undo(vertices + shift) for vertices in itertools.chain([first], frames))

    def _checked(self, frames: Iterable[Float[np.ndarray, "V 3"]]) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the frames of the method, which may be a program's own; raise InputError where they cannot be used."""
        shape, count = self.rest.vertices.shape, 0
        for count, vertices in enumerate(frames, 1):
            if np.shape(vertices) != shape or not np.isfinite(vertices).all():
                found = f"some of shape {np.shape(vertices)}" if np.shape(vertices) != shape else "NaN or infinity"
                raise InputError(
                    f"{self.method.name}: expected finite points of shape {shape} in frame {count - 1}, found {found}; "
                    "correct the method"
                )
            yield vertices
        if not count:
            raise InputError(f"{self.method.name}: expected a frame for each of the driving's, found none; correct it")

    def _refined(self, frames: Iterable[Float[np.ndarray, "V 3"]], timer: Timer) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the frames refined. Their time is moved from the step "drive", inside which this runs, to "refine"."""
        for vertices in frames:
            before = timer["refine"]
            with timer.step("refine"):
                refined = self.refined(vertices)
            timer["drive"] -= timer["refine"] - before
            yield refined


def vertex_route(
    identity: Mesh, clip: Clip, model: NamedMethod | Method, known: Known, options: MotionOptions, rigs: Rigs
) -> VertexRoute:
    """Normalise both meshes and prepare a method.

    Args:
        rigs: joints in the files say how both meshes stand; they are not moved.
    """
    first, asked = first_frame(clip), known.asked_body
    subjects = rigs.subjects(identity, first, known.axes)
    norms = subjects[0].norm, subjects[1].norm
    method = model.open(norms[1]) if isinstance(model, NamedMethod) else model
    options.refuse_without_joints(method.name)
    notes = trained_on_people(method, asked, subjects) + paired_note(method, identity, first)
    check_known_body(method, asked)
    if getattr(method, "body", "human") == "quadruped":
        norms = turned_as_animal(subjects[0]), turned_as_animal(subjects[1])
    known.corrections.refuse_without_joints(method.name)
    return _prepared(identity, clip, method, norms, rigs, notes)


def reference_route(
    identity: Mesh, clip: Clip, reference: ReferenceFrame, known: Known, options: MotionOptions
) -> VertexRoute:
    """Prepare deformation transfer from a frame of the driving that has about the identity's pose."""
    options.refuse_without_joints("deformation-transfer")
    given = Normalization.fit(identity, *known.axes[:2])
    axes = given.up, given.front, *reference.axes(given)
    norms = Normalization.fit(identity, *axes[:2]), Normalization.fit(first_frame(clip), *axes[2:])
    note = reference.note((identity.name, clip.mesh.name))
    route = _prepared(identity, clip, reference.method(clip.mesh, given, norms[1]), norms, NO_RIGS, (note,))
    driving = facing(norms[1]) | {"up_from": "identity"}
    return dataclasses.replace(route, reference=reference, found_axes=(facing(given), driving))


def _prepared(
    identity: Mesh,
    clip: Clip,
    method: Method,
    norms: tuple[Normalization, Normalization],
    rigs: Rigs,
    notes: tuple[str, ...],
) -> VertexRoute:
    from ..methods.npt import PaperNetwork

    if isinstance(method, PaperNetwork):
        method = method.with_sizes((identity.name, norms[0].radius), (clip.mesh.name, norms[1].radius))
    rest = normalised(identity, norms[0])
    drive = method.prepare(rest, keyframes_of(clip, norms[1]))
    identity = identity if norms[0].unsure else with_up(identity, norms[0])
    return VertexRoute(identity, clip, norms, rest, None, rigs, notes, method=method, drive=drive)


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
