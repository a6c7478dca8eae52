"""Move an identity by a method that moves vertices: networks of the papers, deformation transfer, a user's."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.frame_buffer import LazyFrames, Progress, each_frame, store_frames
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..core.options import MotionOptions
from ..methods.base import Drive, Method
from ..methods.find import find_method
from ..methods.npt import PaperNetwork
from ..rigs.retarget import JointMotion
from .file_rigs import NO_RIGS, Rigs
from .known import Known
from .look import check_known_body, normalised, trained_on_people, turned_as_animal
from .placed import SOLE_ERROR, Moved, Placed, first_frame, keyframes_of, surface_report, with_up
from .refine import Refinement
from .report import MeshReport, TransferReport, facing, torn_note
from .result import Timer
from .same_mesh import ReferenceFrame, paired_note


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
        self,
        timer: Timer,
        options: MotionOptions,
        progress: Progress | None = None,
        dtype: type[np.floating] = np.float64,
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

    Raises:
        InputError: an axis, the model or its options cannot be used.
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
    if isinstance(method, PaperNetwork):
        method = method.with_sizes((identity.name, norms[0].radius), (clip.mesh.name, norms[1].radius))
    rest = normalised(identity, norms[0])
    drive = method.prepare(rest, keyframes_of(clip, norms[1]))
    identity = identity if norms[0].unsure else with_up(identity, norms[0])
    return VertexRoute(identity, clip, norms, rest, None, rigs, notes, method=method, drive=drive)
