"""The public functions `transfer`, `animate` and `prepare`: they read and check arguments; others do the work."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike

from ..core.arguments import described, public
from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh, far_note, is_far
from ..core.options import FrameRange, Hints, ModelOptions, MotionOptions, needs_joints
from ..methods.base import Method
from ..methods.find import find_model, ordered_weights
from ..mime.model import Mime
from .file_rigs import still_clip
from .known import Known
from .read import read_clip, read_frames, read_mesh
from .report import TransferReport
from .result import ClipResult, Result, Timer
from .route import Model, find_route

if TYPE_CHECKING:
    from .live import LiveSession

NO_HINTS, USUAL, UNCHANGED, ALL_FRAMES = Hints(), ModelOptions(), MotionOptions(), FrameRange()


@public
def transfer(
    identity: Mesh | str | Path,
    driving: Mesh | str | Path,
    model: str | Path | Mime | Method = "mime",
    *,
    hints: Hints = NO_HINTS,
    options: ModelOptions = USUAL,
    motion: MotionOptions = UNCHANGED,
) -> Result:
    """Give the identity the pose of the driving mesh: `animate` with one frame, in double precision.

    The result has the identity's axes, unit and position, and the driving's heading.

    Args:
        identity: the mesh to move, or its path.
        driving: the mesh whose pose is taken, or its path.
        model: a name of `mimesh models`, the path of an .onnx file, or a method of your own (see `methods.Method`),
            which is used as it is: `options` are for names and paths only, but `refine`.
        hints: axes, rig, body and joints of both meshes, where they are known.
        options: what the model is asked for.
        motion: how joints move; of a single pose only `contacts` and `skinned` have an effect.

    Returns:
        The identity with other vertices, in its own axes, unit and order, with a report and notes.

    Raises:
        InputError: a file, an axis, the model or its options cannot be used; the message says why and what to do.

    Example:
        >>> result = mimesh.transfer("hero.glb", "pose.obj")
        >>> result.vertices.shape  # (V, 3), in the axes and unit of hero.glb
        (502, 3)
        >>> path = result.save("posed.glb")
    """
    timer = Timer()
    with timer.step("load"):
        identity, driving = read_mesh(identity, "identity"), read_mesh(driving, "driving")
    clip = still_clip(driving)
    chosen = _model(model, (identity, driving), options)
    known = _known(hints, chosen, clip)
    with timer.step("prepare"):
        route = find_route(identity, clip, chosen, known, motion).with_refinement(options.refine)
    moved = route.play(timer, motion)
    _name_axis_sources(moved.report, hints)
    return Result(
        route.identity.with_vertices(moved.frames.first()),
        chosen.name,
        timer,
        moved.report,
        moved.notes + far_note(identity),
        identity,
        driving,
        moved.skeleton,
        moved.driving_joints,
        moved.own,
    )


@public
def animate(
    identity: Mesh | str | Path,
    driving: Clip | str | Path,
    model: str | Path | Mime | Method = "mime",
    *,
    hints: Hints = NO_HINTS,
    options: ModelOptions = USUAL,
    motion: MotionOptions = UNCHANGED,
    frames: FrameRange = ALL_FRAMES,
    animation: str | int | None = None,
    progress: Progress | None = None,
) -> ClipResult:
    """Give the identity the motion of the driving clip.

    The first frame taken has the identity's position; later ones move by the driving's displacement, scaled to the
    identity's size unless `motion.root` says otherwise.

    Args:
        identity: the mesh to move, or its path.
        driving: the clip whose motion is taken, or its path. Frames of a clip in memory are not copied: leave them
            unchanged until the result is saved.
        model, hints, options: see `transfer`. Corrected joints of the driving are in its first frame, or in the frame
            that a file of them names; frames count from 0 in the whole clip.
        motion: how joints move.
        frames: the frames of the driving clip that are taken, and its rate.
        animation: which animation of a driving glTF file, by name or number; the first by default.
        progress: is called with the frames done and the frames in all.

    Returns:
        The identity in every frame, in its own axes, unit and order, with a report and notes.

    Raises:
        InputError: a file, an axis, the range, the model or its options cannot be used.

    Example:
        >>> moving = mimesh.animate("hero.glb", "walk.npz", frames=mimesh.FrameRange(stop=4))
        >>> moving.clip.vertices.shape  # (T, V, 3)
        (4, 502, 3)
        >>> saved = moving.save_skinned("walking.glb")
    """
    from .read import far_frames_note, first_frame_note

    timer = Timer()
    with timer.step("load"):
        identity = read_mesh(identity, "identity")
        told = (hints.driving_up, hints.driving_front, hints.body)
        clip, whole = read_frames(driving, frames, animation, hints.driving_joints is not None, told)
    chosen = _model(model, (identity, clip.mesh), options)
    known = _known(hints, chosen, clip, whole)
    with timer.step("prepare"):
        route = find_route(identity, clip, chosen, known, motion).with_refinement(options.refine)
    moved = route.play(timer, motion, progress, np.float64 if is_far(identity) else np.float32)
    _name_axis_sources(moved.report, hints)
    notes = clip.notes + moved.notes + far_note(identity) + far_frames_note(clip, clip.mesh.name)
    if not isinstance(driving, Clip):
        notes += first_frame_note(clip, frames.start, Path(driving).name)
    if len(clip) == 1:
        notes += (f"{clip.mesh.name} has one frame, a pose: give an animated .glb or a folder of frames",)
    return moved.clip_result(route.identity, clip, chosen.name, timer, notes)


@public
def prepare(
    identity: Mesh | str | Path,
    driving: Mesh | Clip | str | Path,
    model: str | Path | Mime | Method = "mime",
    *,
    hints: Hints = NO_HINTS,
    options: ModelOptions = USUAL,
    root: str = "scale",
) -> LiveSession:
    """Prepare an identity for a live stream; the session then poses it by one driving frame at a time.

    All frames must have the vertices and triangles of `driving`, in the same order. Its first frame fixes axes, size
    and place: there the result has the identity's position. One frame is enough. Of a clip up to 16 keyframes are
    looked at, as by `animate`, which finds joints more exactly and tells whether fingers move (docs/api.md has the
    figures): record some seconds with various poses where you can.

    A session makes the frames of `animate` with `ground=False`, `contacts=False` and `smooth=0`: all need later frames.
    Joints in the driving's file are not used, because frames of a stream are vertices only; the rig of the
    identity's file is.

    Args:
        identity: the mesh to move, or its path.
        driving: the driving mesh in one frame, or in some frames of its motion, or the path of either.
        model, hints, options: see `transfer`.
        root: displacement over the ground, as in `MotionOptions`; other values than "scale" for mime only.

    Returns:
        The session, whose `pose` maps vertices (U, 3) of the driving to vertices (V, 3) of the identity.

    Raises:
        InputError: a file, an axis, the model or its options cannot be used; or a model that needs later frames
            (aniformer).

    Example:
        >>> session = mimesh.prepare("hero.glb", "walk.npz")
        >>> frame = mimesh.load_clip("walk.npz").vertices[3]  # (U, 3)
        >>> session.pose(frame).shape  # (V, 3)
        (502, 3)
    """
    from .live import live_session

    identity = read_mesh(identity, "identity")
    shown = Clip.still(read_mesh(driving, "driving")) if isinstance(driving, Mesh) else driving
    clip = dataclasses.replace(read_clip(shown, None, None), skeleton=None)
    motion = MotionOptions(root, ground=False)
    chosen = _model(model, (identity, clip.mesh), options)
    known = _known(hints, chosen, clip)
    route = find_route(identity, clip, chosen, known, motion, live=True).with_refinement(options.refine)
    session = live_session(route, chosen.name, root)
    _name_axis_sources(session.report, hints)
    return session


def _name_axis_sources(report: TransferReport, hints: Hints) -> None:
    """Write "joints" as the source of an up axis that the caller did not give: a rig's or a motion's joints define it.

    The normalisation gets such axes as it gets those of the caller.
    """
    for facing, given in ((report["identity"], hints.up), (report["driving"], hints.driving_up)):
        if facing["up_from"] == "given" and given is None:
            facing["up_from"] = "joints"


def _model(model: str | Path | Mime | Method, meshes: tuple[Mesh, Mesh], options: ModelOptions) -> Model:
    """Return a model, opened if it has joints; `meshes` are those by which `pairing` "auto" is decided."""
    if isinstance(model, type):
        raise InputError(f"model: expected a method, found its class {model.__name__}; give {model.__name__}()")
    if isinstance(model, Mime | Method):
        return model
    if not isinstance(model, (str, Path)):
        raise InputError(
            f"model: expected a name, the path of an .onnx file, or a method with `rough`, `name` and `prepare`, found "
            f"{described(model)}; mimesh models lists the names"
        )
    name, pairing = str(model), options.pairing
    ordered = ordered_weights(name)
    if pairing == "auto" and ordered is not None and ordered.is_file():
        from .vertex_route import same_triangles

        pairing = "order" if same_triangles(*meshes) else pairing
    reference = None if options.reference is None else read_mesh(options.reference, "reference")
    given = {"ensemble": options.ensemble, "seed": options.seed, "pairing": pairing}
    given["markers"] = None if options.markers is None else _markers(options.markers)
    opened = find_model(name, reference=reference, **given)
    if isinstance(opened, Mime):
        return opened
    from .vertex_route import NamedMethod

    return NamedMethod(name, given, reference)


def _known(hints: Hints, model: Model, clip: Clip, whole: Clip | None = None) -> Known:
    """Return what is known of both meshes, see `Known.of`; models without joints use no rig of the identity's."""
    known = Known.of(hints, clip, whole)
    if isinstance(model, Mime):
        return known
    if not isinstance(hints.rig, str):
        raise needs_joints("rig", model.name)
    return dataclasses.replace(known, rig="mimesh")


def _markers(markers: ArrayLike | str | Path) -> Int[np.ndarray, "M 2"]:
    """Read pairs of vertices that correspond, or check those in memory."""
    if isinstance(markers, (str, Path)):
        from ..io.text import load_markers

        return load_markers(Path(markers))
    try:
        pairs = np.asarray(markers)
    except ValueError:  # rows of different lengths
        pairs = np.asarray(markers, object)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise InputError(
            f"markers: expected whole numbers of shape (M, 2), found {pairs.dtype} {pairs.shape}; "
            "rows are (identity vertex, driving vertex)"
        )
    return pairs.astype(np.int64)
