"""The way of all results: normalise, prepare, drive, refine, place, undo, and say how well it went."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.frame_buffer import PAGED, Progress, each_frame, let_go, new_frames
from ..core.joint_tracks import Track, skate
from ..core.mesh import Clip, Mesh
from ..core.normalization import Frame
from ..core.rig import Rig, Skeleton
from ..methods.base import Drive, Method
from ..methods.mime.drive import Mime, Puppet
from .refine import Refinement
from .reorient import known
from .report import accelerations, doubt_notes, doubts, facing, facing_note, quality
from .result import no_time_yet, timed

Choice = Callable[[Frame], Method]
"""A method with its options, but for the driving's frame."""
Axes = tuple[str | None, str | None, str | None, str | None]
"""Up and front of the identity and of the driving; None is found."""
GLIMPSES = 16
"""Frames of a clip that a method may look at before it begins."""
ROOTS = ("scale", "keep", "drop")


@dataclass(frozen=True)
class Travel:
    """What is wanted of a model with joints; see `pipeline.animate`."""

    root: str = "scale"
    ground: bool = False
    smooth: float = 0.0
    skinned: bool = False

    def check(self, method: Method) -> None:
        """Raise InputError where a value makes no sense, or needs joints that the model has not."""
        if self.root not in ROOTS:
            raise InputError(f"--root: expected one of {', '.join(ROOTS)}, found {self.root!r}; choose one of them")
        if not 0 <= self.smooth < np.inf:
            raise InputError(f"--smooth: expected seconds, 0 or more, found {self.smooth}; try 0.05")
        if not isinstance(method, Mime):
            for field in dataclasses.fields(self):
                if getattr(self, field.name) != field.default:
                    raise InputError(
                        f"--{field.name}: expected a model with joints (mime), found {method.name}; choose it with -m"
                    )


@dataclass(frozen=True, eq=False)
class Moved:
    """A result in the identity's axes, unit and place."""

    vertices: Float[np.ndarray, "T V 3"]
    skeleton: Skeleton | None
    """What moved the identity, if the method has joints."""
    report: dict
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Played:
    """What a puppet does in a clip."""

    puppet: Puppet
    track: Track
    path: Float[np.ndarray, "T 3"]

    def frames(self) -> Iterator[Float[np.ndarray, "V 3"]]:
        return (self.puppet.posed(*pose) for pose in zip(self.track.rotation, self.path, strict=True))


@dataclass(frozen=True, eq=False)
class Ready:
    """An identity and a clip that have been read: frames follow without looking at either again."""

    identity: Mesh
    clip: Clip
    method: Method
    drive: Drive
    own: Frame
    theirs: Frame
    still: Mesh
    """The identity in its Frame."""
    surface: Refinement | None
    """What results are refined on."""

    def refined(self, refine: bool | None) -> Ready:
        """The same with results refined, or not, or as the model has it (None)."""
        surface = Refinement.of(self.still) if (self.method.rough if refine is None else refine) else None
        return dataclasses.replace(self, surface=surface)


def prepare(identity: Mesh, clip: Clip, choice: Choice, axes: Axes, refine: bool | None, travel: Travel) -> Ready:
    """All that is done before the first frame; of `travel` only whether the model can do it is looked at.

    Raises:
        InputError: an axis, the model or its options cannot be used.
    """
    first = dataclasses.replace(clip.mesh, vertices=clip.vertices[0].astype(np.float64))
    own, theirs = Frame.fit(identity, *axes[:2]), Frame.fit(first, *axes[2:])
    method = choice(theirs)
    travel.check(method)
    drive = method.prepare(_seen(identity, own), _glimpses(clip, first, theirs))
    if isinstance(method, Mime) and isinstance(drive, Puppet):
        before, (ours, others) = (own, theirs), drive.doubts
        own, theirs = known(method, identity, own, axes[:2], ours), known(method, first, theirs, axes[2:], others)
        if (own, theirs) != before:
            drive = method.prepare(_seen(identity, own), _glimpses(clip, first, theirs))
    return Ready(identity, clip, method, drive, own, theirs, _seen(identity, own), None).refined(refine)


def posed(ready: Ready, t: int) -> Float[np.ndarray, "V 3"]:
    """The identity in frame t alone, where that frame of the whole clip stands; models of windows see it out of line.

    Paths of joints that are smoothed, grounded or not scaled are for whole clips: see `play`.
    """
    chosen = [0] if t == 0 else [0, t]
    given = (ready.theirs.apply(np.asarray(ready.clip.vertices[k], np.float64)) for k in chosen)
    shift, frames = _placed(_refined(ready.drive(given), ready.surface, no_time_yet()), ready.still.vertices)
    *_, vertices = frames
    return ready.own.undo(vertices + shift)


def move(
    identity: Mesh,
    clip: Clip,
    choice: Choice,
    axes: Axes,
    refine: bool | None,
    seconds: dict[str, float],
    travel: Travel = Travel(),
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
) -> Moved:
    """Give the identity the motion of a clip; `seconds` of each step are added up on the way.

    Raises:
        InputError: an axis, the model or its options cannot be used.
    """
    with timed(seconds, "prepare"):
        ready = prepare(identity, clip, choice, axes, refine, travel)
    return play(ready, seconds, travel, progress, dtype)


def play(
    ready: Ready,
    seconds: dict[str, float],
    travel: Travel = Travel(),
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
) -> Moved:
    """All frames of a clip, and what is to be said of them; `travel` has been checked."""
    identity, clip, own, theirs, still = ready.identity, ready.clip, ready.own, ready.theirs, ready.still
    with timed(seconds, "drive"):
        count, size = len(clip), theirs.radius / own.radius
        given, played, done = _normalised(clip, theirs), None, 0
        if isinstance(ready.drive, Puppet):
            # The driving is followed to its end before the first frame is made: half of the work.
            given, done = _told(given, progress, count), count
            played = _played(ready.drive, given, clip.fps, travel, size)
        frames = ready.drive(given) if played is None else played.frames()
        shift, frames = _placed(_refined(frames, ready.surface, seconds), still.vertices)
        moved = new_frames(count, len(identity.vertices), dtype)
        for t, vertices in enumerate(frames):
            moved[t] = own.undo(vertices + shift)
            if t % PAGED == 0:
                let_go(moved)
            if progress is not None:
                progress((done + t + 1) * count // (done + count), count)
    report = {
        **quality(identity, moved),
        **accelerations(clip, moved),
        "identity": facing(own),
        "driving": facing(theirs),
    }
    name = clip.mesh.name
    notes = facing_note(own, identity.name, "--front") + facing_note(theirs, name, "--driving-front")
    skeleton = None
    if played is not None:
        skeleton = _skeleton(identity, played, own, shift)
        notes += _judged(played, report, (identity.name, name), np.ptp(still.vertices[:, 1]))
        if travel.root == "drop":
            report["foot_skate"] = None  # in place, feet slide as they should
    return Moved(moved, skeleton, report, notes + tuple(getattr(identity.source, "notes", ())))


def _played(
    puppet: Puppet, frames: Iterable[Float[np.ndarray, "U 3"]], fps: float, travel: Travel, size: float
) -> _Played:
    """What the puppet does, and its way through the world; `size` is the driving's unit over the identity's."""
    track = puppet.track(frames, fps).smoothed(travel.smooth)
    across = size if travel.root == "keep" else None
    return _Played(puppet, track, puppet.path(track, across, travel.root == "drop", travel.ground))


def _judged(played: _Played, report: dict, names: tuple[str, str], height: float) -> tuple[str, ...]:
    """Add to the report what the puppet knows of itself; notes where that is little."""
    notes = ()
    for which, doubt, name in zip(("identity", "driving"), played.puppet.doubts, names, strict=True):
        report[which] |= doubts(doubt)
        notes += doubt_notes(doubt, name)
    slide = skate(played.track, played.path, played.puppet.skinned, played.puppet.feet)
    report["foot_skate"] = None if slide is None else slide / height
    return notes


def _normalised(clip: Clip, frame: Frame) -> Iterator[Float[np.ndarray, "U 3"]]:
    """The driving's frames in its Frame, without keeping what was read."""
    return (frame.apply(vertices) for vertices in each_frame(clip.vertices))


def _told(frames: Iterable[Float[np.ndarray, "U 3"]], progress: Progress | None, count: int) -> Iterator[np.ndarray]:
    """The frames; each counts half."""
    for t, vertices in enumerate(frames):
        yield vertices
        if progress is not None:
            progress((t + 1) // 2, count)


def _seen(mesh: Mesh, frame: Frame) -> Mesh:
    """A mesh in its Frame."""
    return dataclasses.replace(mesh, vertices=frame.apply(mesh.vertices))


def _glimpses(clip: Clip, first: Mesh, frame: Frame) -> Clip:
    """The driving as methods are prepared for it: normalised, a few frames of it."""
    chosen = np.linspace(0, len(clip) - 1, min(len(clip), GLIMPSES)).round().astype(int)
    vertices = frame.apply(clip.vertices[chosen])
    return Clip(dataclasses.replace(first, vertices=vertices[0]), vertices, clip.fps)


def _refined(
    frames: Iterable[Float[np.ndarray, "V 3"]], surface: Refinement | None, seconds: dict[str, float]
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """The frames on the identity's surface; the time that takes is taken off that of driving."""
    for vertices in frames:
        before = seconds["refine"]
        with timed(seconds, "refine"):
            refined = vertices if surface is None else surface(vertices)
        seconds["drive"] -= seconds["refine"] - before
        yield refined


def _placed(
    frames: Iterator[Float[np.ndarray, "V 3"]], still: Float[np.ndarray, "V 3"]
) -> tuple[Float[np.ndarray, " 3"], Iterator[Float[np.ndarray, "V 3"]]]:
    """What shifts all frames so that the first stands on the identity's ground, in the middle of its place; frames."""
    first = next(frames)
    return _stand(still) - _stand(first), itertools.chain([first], frames)


def _skeleton(identity: Mesh, played: _Played, own: Frame, shift: Float[np.ndarray, " 3"]) -> Skeleton:
    """The joints of a result in the identity's axes, unit and place."""
    back, puppet = own.rotation.T, played.puppet
    rig = Rig(back @ puppet.rig.rotation, own.undo(puppet.rig.joints), puppet.rig.weights)
    turned, root = back @ played.track.rotation, own.undo(played.path + shift)
    return Skeleton(identity, puppet.joints, puppet.skinned.parents, rig, turned, root)


def _stand(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
    """Middle of the bounding box across the ground, its lowest point along up (y)."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
