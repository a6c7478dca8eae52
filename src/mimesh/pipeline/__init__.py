"""The public functions `transfer`, `animate` and `prepare`: they read and check arguments; others do the work."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike

from ..core.arguments import described, for_caller, public
from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh, cut_clip
from ..methods.base import Method
from ..methods.find import find_model, ordered_weights
from ..mime.model import Mime
from ..motions.humanoid_rig import HumanoidRig
from .corrections import Corrections, GivenJoints
from .file_rigs import still_clip
from .live import LiveSession, limited_threads, live_session
from .odd_frames import far_frames_note, first_frame_note
from .options import Hints, MotionOptions
from .read import driving_axes, read_clip, read_mesh
from .report import TransferReport
from .result import ClipResult, Result, Timer
from .route import Model, find_route
from .same_mesh import same_triangles
from .vertex_route import NamedMethod


@public()
def transfer(
    identity: Mesh | str | Path,
    driving: Mesh | str | Path,
    model: str | Path | Mime | Method = "mime",
    *,
    up: str | None = None,
    front: str | None = None,
    driving_up: str | None = None,
    driving_front: str | None = None,
    ensemble: int = 1,
    seed: int = 0,
    pairing: str = "auto",
    refine: bool | None = None,
    reference: Mesh | str | Path | None = None,
    markers: ArrayLike | str | Path | None = None,
    rig: str | HumanoidRig = "own",
    body: str = "auto",
    joints: GivenJoints = None,
    driving_joints: GivenJoints = None,
) -> Result:
    """Give the identity the pose of the driving mesh: `animate` with one frame, in double precision.

    The result has the identity's axes, unit and position, and the driving's heading.

    Args:
        identity: the mesh to move, or its path.
        driving: the mesh whose pose is taken, or its path.
        model: a name of `mimesh models`, the path of an .onnx file, or a method of your own (see `methods.Method`),
            which is used as it is: `ensemble`, `seed`, `pairing`, `reference` and `markers` are for names and paths
            only.
        up: the identity's axis away from the ground ("+y", "-z"); detected from its shape by default.
        front: the identity's axis to its front; detected by default.
        driving_up: as `up`, of the driving.
        driving_front: as `front`, of the driving.
        ensemble: average over this many random pairings (index-paired networks only).
        seed: seed of all random choices of the model.
        pairing: driving vertex of each of the identity's (npt and aniformer only): "random"; "order", that of its own
            index, of two shapes of one mesh; "body", that of the same place on the shipped body, which is fitted to
            both; or "auto", by index where both have the same triangles and there is a network for it.
        refine: smooth the result, keeping the identity's surface details; None leaves it to the model.
        reference: the driving mesh in the identity's pose (deformation transfer only).
        markers: pairs (identity vertex, driving vertex) that correspond, or a file of them (deformation transfer only).
        rig: "own": a glTF identity with a sound rig moves on its own bones (mime only); "mimesh": joints are found on
            its surface, and its skin is dropped. A program that has the identity's bones passes the rig that
            `pipeline.bone_rigs.rig_of_bones` makes of them; their motion is the result's `skeleton`.
        body: what both meshes are: "human", "quadruped" (four-legged animals), "other" (creatures and things whose rigs
            are matched with each other), or "auto", found by their rigs or shapes (mime only).
        joints: positions of some of the identity's joints, where the model finds them wrongly (mime only): joint ->
            (x, y, z) in the axes and unit of its file, or the path of a .joints.json (docs/formats.md). The names are
            the keys of `Result.joints`.
        driving_joints: the same of the driving mesh.

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
    chosen = _model(model, (identity, driving), ensemble, seed, pairing, reference, markers)
    clip = still_clip(driving)
    corrections = Corrections.read(joints, driving_joints, clip)
    hints = Hints((up, front, driving_up, driving_front), _usable_rig(rig, chosen), body, corrections)
    options = MotionOptions()
    with timer.step("prepare"):
        route = find_route(identity, clip, chosen, hints, options).with_refinement(refine)
    moved = route.play(timer, options)
    _name_axis_sources(moved.report, up, driving_up)
    return Result(
        identity.with_vertices(moved.frames.first()),
        _name(chosen),
        timer,
        moved.report,
        tuple(map(for_caller, moved.notes)),
        identity,
        driving,
        moved.skeleton,
        moved.driving_joints,
        moved.own,
    )


@public()
def animate(
    identity: Mesh | str | Path,
    driving: Clip | str | Path,
    model: str | Path | Mime | Method = "mime",
    *,
    up: str | None = None,
    front: str | None = None,
    driving_up: str | None = None,
    driving_front: str | None = None,
    ensemble: int = 1,
    seed: int = 0,
    pairing: str = "auto",
    refine: bool | None = None,
    reference: Mesh | str | Path | None = None,
    markers: ArrayLike | str | Path | None = None,
    fps: float | None = None,
    animation: str | int | None = None,
    start: int = 0,
    stop: int | None = None,
    step: int = 1,
    root: str = "scale",
    ground: bool = True,
    smooth: float = 0.0,
    skinned: bool | None = False,
    rig: str | HumanoidRig = "own",
    body: str = "auto",
    progress: Progress | None = None,
    joints: GivenJoints = None,
    driving_joints: GivenJoints = None,
) -> ClipResult:
    """Give the identity the motion of the driving clip; see `transfer` for the arguments they share.

    The first frame taken has the identity's position; later ones move by the driving's displacement, scaled to the
    identity's size unless `root` says otherwise.

    Args:
        identity: the mesh to move, or its path.
        driving: the clip whose motion is taken, or its path.
        model: see `transfer`.
        up, front, driving_up, driving_front: see `transfer`.
        ensemble, seed, pairing, refine, reference, markers: see `transfer`.
        fps: frame rate of the driving clip, where its file has none or a wrong one.
        animation: which animation of a driving glTF file, by name or number; the first by default.
        start: first frame to take, counted from 0.
        stop: frame to stop before; None takes all.
        step: take every `step`-th frame; the result then has the rate fps / step, so that its speed is the driving's.
        root: displacement over the ground (other values than "scale" for mime only): "scale", the driving's scaled by
            leg length; "keep", the driving's; "drop", none.
        ground: plant soles where the driving's stand, by the root path and the legs (mime only; others ignore it). They
            slide as far as the driving's do, in units of the identity's size. With `root` "keep" only the legs are
            corrected, with "drop" only heights.
        smooth: standard deviation (seconds) of a Gaussian filter over rotations and root positions (mime only).
        skinned: move each vertex by its four largest weights only, so that the frames are those of the file that
            `save_skinned` writes, and raise an error at once if the model has no joints. How far vertices are then from
            where all weights take them, over the mesh's size, is in the report ("influence_deviation"). None does so
            for clips of more than one frame, if the model has joints.
        rig: see `transfer`.
        body: see `transfer`.
        progress: is called with the frames done and the frames in all.
        joints: see `transfer`.
        driving_joints: the same in the driving clip's first frame, or in the frame that a file of them names; frames
            count from 0 in the whole clip.

    Returns:
        The identity in every frame, in its own axes, unit and order, with a report and notes.

    Raises:
        InputError: a file, an axis, the range, the model or its options cannot be used.

    Example:
        >>> moving = mimesh.animate("hero.glb", "walk.npz", stop=4)
        >>> moving.clip.vertices.shape  # (T, V, 3)
        (4, 502, 3)
        >>> path = moving.save_skinned("walking.glb")
    """
    from ..io import load_driving

    timer = Timer()
    with timer.step("load"):
        identity = read_mesh(identity, "identity")
        if driving_joints is None and not isinstance(driving, Clip):
            clip = load_driving(driving, fps=fps, animation=animation, frames=slice(start, stop, step))
            corrections = Corrections.read(joints, None, clip)
        else:  # corrected joints may be in a frame that is not taken
            whole = read_clip(driving, fps, animation)
            corrections = Corrections.read(joints, driving_joints, whole)
            clip = cut_clip(whole, start, stop, step)
    chosen = _model(model, (identity, clip.mesh), ensemble, seed, pairing, reference, markers)
    axes = (up, front, *driving_axes(clip, driving_up, driving_front))
    hints = Hints(axes, _usable_rig(rig, chosen), body, corrections)
    options = MotionOptions(root, ground, smooth, skinned)
    with timer.step("prepare"):
        route = find_route(identity, clip, chosen, hints, options).with_refinement(refine)
    moved = route.play(timer, options, progress, np.float32)
    _name_axis_sources(moved.report, up, driving_up)
    notes = clip.notes + moved.notes + far_frames_note(clip, clip.mesh.name)
    if not isinstance(driving, Clip):
        notes += first_frame_note(clip, start, Path(driving).name)
    if len(clip) == 1:
        notes += (f"{clip.mesh.name} has one frame, a pose: give an animated .glb or a folder of frames",)
    return ClipResult(
        identity.with_vertices(moved.frames.first()),
        moved.frames,
        clip.fps,
        _name(chosen),
        timer,
        moved.report,
        tuple(map(for_caller, notes)),
        moved.skeleton,
        identity,
        clip,
        moved.driving_joints,
        moved.own,
    )


@public()
def prepare(
    identity: Mesh | str | Path,
    driving: Mesh | Clip | str | Path,
    model: str | Path | Mime | Method = "mime",
    *,
    up: str | None = None,
    front: str | None = None,
    driving_up: str | None = None,
    driving_front: str | None = None,
    ensemble: int = 1,
    seed: int = 0,
    pairing: str = "auto",
    refine: bool | None = None,
    reference: Mesh | str | Path | None = None,
    markers: ArrayLike | str | Path | None = None,
    root: str = "scale",
    rig: str | HumanoidRig = "own",
    body: str = "auto",
    joints: GivenJoints = None,
    driving_joints: GivenJoints = None,
    threads: int | None = 1,
) -> LiveSession:
    """Prepare an identity for a live stream; the session then poses it by one driving frame at a time.

    All frames must have the vertices and triangles of `driving`, in the same order. Its first frame fixes axes, size
    and place: there the result has the identity's position. One frame is enough. Of a clip up to 16 keyframes are
    looked at, as by `animate`, which finds joints more exactly and tells whether fingers move (docs/api.md has the
    figures): record some seconds with various poses where you can.

    A session makes the frames of `animate` with `ground=False` and `smooth=0`, which both need later frames. Joints in
    the driving's file are not used, because frames of a stream are vertices only; the rig of the identity's file is.

    Args:
        identity: the mesh to move, or its path.
        driving: the driving mesh in one frame, or in some frames of its motion, or the path of either.
        root: displacement over the ground, as in `animate`; other values than "scale" for mime only.
        model: see `transfer`.
        up, front, driving_up, driving_front: see `transfer`.
        ensemble, seed, pairing, refine, reference, markers: see `transfer`.
        rig, body, joints, driving_joints: see `transfer`.
        threads: threads of linear algebra while a session is prepared and used; None leaves what the libraries are set
            to. They are set for the whole process during each call, and set back.

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
    identity = read_mesh(identity, "identity")
    known = Clip.still(read_mesh(driving, "driving")) if isinstance(driving, Mesh) else driving
    clip = dataclasses.replace(read_clip(known, None, None), skeleton=None)
    corrections = Corrections.read(joints, driving_joints, clip)
    axes = (up, front, *driving_axes(clip, driving_up, driving_front))
    with limited_threads(threads)():
        chosen = _model(model, (identity, clip.mesh), ensemble, seed, pairing, reference, markers)
        hints = Hints(axes, _usable_rig(rig, chosen), body, corrections)
        options = MotionOptions(root, ground=False)
        route = find_route(identity, clip, chosen, hints, options, live=True).with_refinement(refine)
    session = live_session(route, _name(chosen), root, threads)
    _name_axis_sources(session.report, up, driving_up)
    return session


def _name_axis_sources(report: TransferReport, up: str | None, driving_up: str | None) -> None:
    """Write "joints" as the source of an up axis that the caller did not give: a rig's or a motion's joints define it.

    The normalisation gets such axes as it gets those of the caller.
    """
    for facing, given in ((report["identity"], up), (report["driving"], driving_up)):
        if facing["up_from"] == "given" and given is None:
            facing["up_from"] = "joints"


def _model(
    model: str | Path | Mime | Method,
    meshes: tuple[Mesh, Mesh],
    ensemble: int,
    seed: int,
    pairing: str,
    reference,
    markers,
) -> Model:
    """Return a model, opened if it has joints; `meshes` are those by which `pairing` "auto" is decided.

    Raises:
        InputError: no model, or it has no such options.
    """
    if isinstance(model, type):
        raise InputError(f"model: expected a method, found its class {model.__name__}; give {model.__name__}()")
    if isinstance(model, Mime | Method):
        return model
    if not isinstance(model, (str, Path)):
        raise InputError(
            f"model: expected a name, the path of an .onnx file, or a method with `rough`, `name` and `prepare`, found "
            f"{described(model)}; mimesh models lists the names"
        )
    name = str(model)
    ordered = ordered_weights(name)
    if pairing == "auto" and ordered is not None and ordered.is_file() and same_triangles(*meshes):
        pairing = "order"
    if isinstance(markers, (str, Path)):
        from ..io.markers import load_markers

        markers = load_markers(Path(markers))
    elif markers is not None:
        markers = _checked_pairs(markers)
    reference = None if reference is None else read_mesh(reference, "reference")
    options = {"ensemble": ensemble, "seed": seed, "pairing": pairing, "markers": markers}
    opened = find_model(name, reference=reference, **options)
    return opened if isinstance(opened, Mime) else NamedMethod(name, options, reference)


def _usable_rig(rig: str | HumanoidRig, model: Model) -> str | HumanoidRig:
    """Return the choice of the identity's rig; models without joints use none.

    Raises:
        InputError: the rig itself is given, and the model has no joints.
    """
    if isinstance(model, Mime):
        return rig
    if isinstance(rig, HumanoidRig):
        raise InputError(f"--rig: expected a model with joints (mime), found {_name(model)}; choose it with -m")
    return "mimesh"


def _name(model: Model) -> str:
    return model.model if isinstance(model, NamedMethod) else model.name


def _checked_pairs(markers: ArrayLike) -> Int[np.ndarray, "M 2"]:
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
