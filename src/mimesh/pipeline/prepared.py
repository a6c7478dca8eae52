"""Prepare a transfer: normalise both inputs, choose the method, read rigs, and do all work that is done once.

No model is named here. Methods that move joints return a `SkinnedDrive`; `MotionOptions` are for these only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..bodies.character_limbs import FindJoints
from ..core.errors import InputError
from ..core.frame_buffer import evenly_spread
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization, turn, turned_to_front, without_heading
from ..methods.base import (
    BodyMethod,
    Drive,
    Method,
    MotionMethod,
    QuickPredictor,
    SizedMethod,
    SkinnedDrive,
    SkinnedMethod,
    SurfaceMotion,
)
from ..motions.humanoid_rig import HumanoidRig
from .body_choice import check_body, trained_on_people, with_body
from .corrections import NO_CORRECTIONS, Corrections
from .matched_rigs import finds_joints, joint_finder
from .orientation import normalised, reorient
from .refine import Refinement
from .rigs import NO_RIGS, Axes, Rigs
from .same_mesh import paired_note
from .second_look import body_after_all

Choice = Callable[[Normalization], Method]
"""Makes a method with its options, given the driving's normalisation."""
KEYFRAMES = 16
"""Largest number of frames, evenly spread over a clip, that a method gets in `prepare`."""
MOTION_FRAMES = 120
"""Largest number of frames, evenly spread, in which a method that asks for it gets points of the surface."""
ROOTS = ("scale", "keep", "drop")
FEWEST_VERTICES = 4
"""Vertices of the smallest solid, a tetrahedron; two points and one triangle have no pose."""


@dataclass(frozen=True)
class MotionOptions:
    """Options of models with joints; see `pipeline.animate`."""

    root: str = "scale"
    ground: bool = True
    """Has no effect on a single pose, nor with a method without joints."""
    smooth: float = 0.0
    skinned: bool | None = False
    """Move each vertex by its INFLUENCES largest weights, as files of skinned meshes do; None: if the method has joints
    and the clip is more than a pose."""
    rig: str | HumanoidRig = "own"
    """One of `rigs.RIGS`, or the identity's rig itself. Other values have no effect on a method without joints."""
    body: str = "auto"
    """One of `body_choice.BODIES`."""

    @property
    def changes_motion(self) -> bool:
        """Whether the result differs from the driving's motion on the same skeleton."""
        return self.root != "scale" or self.smooth > 0

    def __post_init__(self) -> None:
        """Raise InputError if a value is not allowed."""
        if self.root not in ROOTS:
            raise InputError(f"--root: expected one of {', '.join(ROOTS)}, found {self.root!r}; choose one of them")
        if not 0 <= self.smooth < np.inf:
            raise InputError(f"--smooth: expected seconds, 0 or more, found {self.smooth}; try 0.05")
        check_body(self.body)

    def check(self, method: Method) -> None:
        """Raise InputError if a value needs joints and the method has none."""
        if not isinstance(method, SkinnedMethod):
            for field in dataclasses.fields(self):
                if field.name not in ("ground", "rig", "body") and getattr(self, field.name) not in (
                    field.default,
                    None,
                ):
                    raise InputError(
                        f"--{field.name}: expected a model with joints (mime), found {method.name}; choose it with -m"
                    )


@dataclass(frozen=True, eq=False)
class Prepared:
    """An identity and a clip after all work that is done once; frames are then made one by one."""

    identity: Mesh
    clip: Clip
    method: Method
    drive: Drive
    identity_norm: Normalization
    driving_norm: Normalization
    rest: Mesh
    """The identity, normalised."""
    refinement: Refinement | None
    """Refines results; None leaves them as they are."""
    rigs: Rigs = NO_RIGS
    """The rigs of the files that are used."""
    notes: tuple[str, ...] = ()
    """Notes for the user on what the meshes show."""

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """The turn of results about y: results have the driving's heading, not the identity's."""
        return turn(self.driving_norm.heading - self.identity_norm.heading)

    def shift(self, first: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
        """Return the displacement that brings the first frame of a result to the identity's position; normalised."""
        upright = turn(self.identity_norm.heading)  # bounding boxes are those in the axes of the file
        return (ground_point(self.rest.vertices @ upright.T) - ground_point(first @ upright.T)) @ upright

    def with_refinement(self, refine: bool | None) -> Prepared:
        """Switch refinement on or off; None takes the method's default."""
        refinement = Refinement.of(self.rest) if (self.method.rough if refine is None else refine) else None
        return dataclasses.replace(self, refinement=refinement)


def prepare(
    identity: Mesh,
    clip: Clip,
    choice: Choice,
    axes: Axes,
    refine: bool | None,
    options: MotionOptions,
    corrections: Corrections = NO_CORRECTIONS,
    rigs: Rigs | None = None,
) -> Prepared:
    """Normalise both inputs, choose the method and prepare it.

    The options are only checked here; `play` applies them. Rigs are read if none are given.

    Raises:
        InputError: an axis, the model, its options or the corrections cannot be used.
    """
    check_identity(identity)
    # The normalisation of the first frame is used for the whole clip, so that the driving's displacement is kept.
    first = first_frame(clip)
    rigs = read_rigs(identity, clip, options, corrections, copy=False) if rigs is None else rigs
    norms = fitted_norms(identity, first, rigs.axes(axes))
    chosen = choice(norms[1])
    options.check(chosen)
    body = (corrections.body or options.body) if options.body == "auto" else options.body
    notes = trained_on_people(chosen, body, (identity, first), norms, rigs.axes(axes))
    notes += paired_note(chosen, identity, first)
    method, norms = with_body(chosen, body, rigs, (identity, first), norms, rigs.axes(axes))
    if any(rigs.unnamed) and finds_joints(method):
        find = joint_finder(method, axes[:2]), joint_finder(method, axes[2:])
        matched = read_rigs(identity, clip, options, corrections, copy=False, find=find)
        rigs = matched.with_notes((identity.name, clip.mesh.name), rigs)
        norms = fitted_norms(identity, first, rigs.axes(axes))
    given_axes, axes = axes, rigs.axes(axes)
    turned = _without_headings(method, (identity, first), norms, axes)
    drive = _prepared_drive(method, identity, clip, first, turned, corrections, rigs)
    corrected = _corrected_norms(method, drive, (identity, first), norms, axes)
    if corrected != norms:  # `reorient` returns the same object where it changes nothing
        known = [axis for norm in corrected for axis in (norm.up, norm.front)]
        turned = _without_headings(method, (identity, first), corrected, known)
        drive = _prepared_drive(method, identity, clip, first, turned, corrections, rigs)
    if options.body == "auto" and not corrections.given and isinstance(drive, SkinnedDrive):
        other = body_after_all((chosen, method), rigs, (identity, first), axes, drive.confidence)
        if other is not None:
            options = dataclasses.replace(options, body=other)
            return prepare(identity, clip, choice, given_axes, refine, options, corrections, rigs)
    rest = normalised(identity, turned[0])
    prepared = Prepared(identity, clip, method, drive, turned[0], turned[1], rest, None, rigs, notes)
    return prepared.with_refinement(refine)


def _corrected_norms(
    method: Method, drive: Drive, meshes: tuple[Mesh, Mesh], norms: tuple[Normalization, Normalization], axes: Axes
) -> tuple[Normalization, Normalization]:
    """Correct detected axes; the confidence is known only after preparing. Where axes were wrong, it is done again."""
    if not (isinstance(method, QuickPredictor) and isinstance(drive, SkinnedDrive) and drive.confidence is not None):
        return norms
    return (
        reorient(method, meshes[0], norms[0], axes[:2], drive.confidence[0]),
        reorient(method, meshes[1], norms[1], axes[2:], drive.confidence[1]),
    )


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


def read_rigs(
    identity: Mesh,
    clip: Clip,
    options: MotionOptions,
    corrections: Corrections,
    copy: bool,
    find: tuple[FindJoints | None, FindJoints | None] = (None, None),
) -> Rigs:
    """Read the rigs of both files (see `Rigs.read`); that of a mesh whose joints the user has corrected is not used."""
    choice = options.rig if corrections.identity is None else "mimesh"
    rigs = Rigs.read(identity, clip, choice, copy and corrections.driving is None, find, options.body)
    return rigs if corrections.driving is None else dataclasses.replace(rigs, driving=None)


def fitted_norms(identity: Mesh, first: Mesh, axes: Axes) -> tuple[Normalization, Normalization]:
    """Fit the normalisations of the identity and of the driving's first frame."""
    return Normalization.fit(identity, *axes[:2]), Normalization.fit(first, *axes[2:])


def _without_headings(
    method: Method, meshes: tuple[Mesh, Mesh], norms: tuple[Normalization, Normalization], axes: Sequence[str | None]
) -> tuple[Normalization, Normalization]:
    """Take the headings of both meshes out for a method whose predictions depend on them; `axes` are those known."""
    if not isinstance(method, QuickPredictor):
        return norms
    # The front of an animal was found by its network (see `with_body`).
    person = not isinstance(method, BodyMethod) or method.body == "human"
    turned = []
    for mesh, norm, front in zip(meshes, norms, axes[1::2], strict=True):
        known = front is not None or not norm.detected
        rough = without_heading(mesh, norm, known, person)
        _, hips = method.quick_predict(normalised(mesh, rough))
        turned.append(turned_to_front(mesh, rough, hips[:, 2], known or not person))
    return turned[0], turned[1]


def _prepared_drive(
    method: Method,
    identity: Mesh,
    clip: Clip,
    first: Mesh,
    norms: tuple[Normalization, Normalization],
    corrections: Corrections,
    rigs: Rigs,
) -> Drive:
    """Prepare a method with the rigs of the files and the corrected joints."""
    method = rigs.apply(method, clip.fps, norms)
    corrected, keyframes = corrections.apply(method, identity, _keyframes(clip, first, norms[1]), norms)
    if isinstance(corrected, MotionMethod):
        corrected = corrected.with_motion(_surface_motion(clip, norms[1]))
    if isinstance(corrected, SizedMethod):
        corrected = corrected.with_sizes((identity.name, norms[0].radius), (clip.mesh.name, norms[1].radius))
    return corrected.prepare(normalised(identity, norms[0]), keyframes)


def _surface_motion(clip: Clip, norm: Normalization) -> SurfaceMotion:
    """Return the motion of a clip's surface in at most MOTION_FRAMES frames; of each, only the points are read."""
    chosen = evenly_spread(len(clip), MOTION_FRAMES)
    return lambda samples: np.stack([norm.apply(samples.points(clip.vertices[t])) for t in chosen])


def _keyframes(clip: Clip, first: Mesh, norm: Normalization) -> Clip:
    """Return at most KEYFRAMES frames of a clip, evenly spread and normalised; `first` is its first frame."""
    vertices = norm.apply(clip.vertices[evenly_spread(len(clip), KEYFRAMES)])
    return Clip(dataclasses.replace(first, vertices=vertices[0], up="+y"), vertices, clip.fps)


def ground_point(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
    """Return the centre of the bounding box in x and z, at its lowest y."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
