"""transfer() and animate(): what they take, read and checked; `moving.py` does the work."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh, check_clip, check_mesh, cut_clip
from ..core.normalization import Normalization
from ..methods.base import Method
from ..methods.find import find_method
from .result import ClipResult, Result, Timer
from .run import Choice, MotionOptions, move


def transfer(
    identity: Mesh | str | Path,
    driving: Mesh | str | Path,
    model: str | Method = "mime",
    *,
    up: str | None = None,
    front: str | None = None,
    driving_up: str | None = None,
    driving_front: str | None = None,
    ensemble: int = 1,
    seed: int = 0,
    refine: bool | None = None,
    reference: Mesh | str | Path | None = None,
    markers: ArrayLike | str | Path | None = None,
) -> Result:
    """Give the identity the pose of the driving mesh: animate() with one frame, in double precision.

    Takes meshes or paths. Axes ("+y", "-z") that are not given are found from the shapes. The result stands where the
    identity stood and heads where the driving does.

    Args:
        model: a name of `mimesh models`, the path of an .onnx file, or a method of your own (see `methods.Method`),
            which is taken as it is: `ensemble`, `seed`, `reference` and `markers` are for names and paths alone.
        ensemble: average over this many random pairings (index-paired networks only).
        refine: smooth the result as the identity's surface allows; None leaves it to the model.
        reference: the driving mesh in the identity's pose (deformation transfer only).
        markers: pairs (identity vertex, driving vertex) that correspond, or a file of them (deformation transfer only).

    Raises:
        InputError: a file, an axis, the model or its options cannot be used; the message says why and what to do.
    """
    timer = Timer()
    with timer.step("load"):
        identity, driving = _read_mesh(identity), _read_mesh(driving)
    axes = (up, front, driving_up, driving_front)
    choice = _choice(model, ensemble, seed, reference, markers)
    moved = move(identity, Clip.still(driving), choice, axes, refine, timer)
    mesh = identity.with_vertices(moved.vertices[0])
    return Result(mesh, _name(model), timer, moved.report, moved.notes, identity, driving)


def animate(
    identity: Mesh | str | Path,
    driving: Clip | str | Path,
    model: str | Method = "mime",
    *,
    up: str | None = None,
    front: str | None = None,
    driving_up: str | None = None,
    driving_front: str | None = None,
    ensemble: int = 1,
    seed: int = 0,
    refine: bool | None = None,
    reference: Mesh | str | Path | None = None,
    markers: ArrayLike | str | Path | None = None,
    fps: float | None = None,
    animation: str | None = None,
    start: int = 0,
    stop: int | None = None,
    step: int = 1,
    root: str = "scale",
    ground: bool = False,
    smooth: float = 0.0,
    skinned: bool = False,
    progress: Progress | None = None,
) -> ClipResult:
    """Make the identity move as the driving clip does; see `transfer` for the arguments they share.

    Args:
        animation: which one of a driving glTF file, by name or number; the first by default.
        fps: frame rate of the driving clip, where its file has none or a wrong one. Every `step`-th frame of it is
            taken from `start` up to `stop`, and the result plays at fps / step: as fast as the driving.
        root: how far the result goes over the ground (mime only but for the default): "scale", as far as its legs take
            it; "keep", as far as the driving; "drop", nowhere.
        ground: keep feet where they stand on the floor (mime only). Where the driving's feet slide, they still slide.
        smooth: average turns and ways of the joints over time, with a Gaussian of so many seconds (mime only).
        skinned: refuse a model without joints, for `ClipResult.save_skinned`, before it has done its work.

    The first frame taken stands where the identity stood; later ones move by the driving's displacement, in the
    identity's size unless `root` says otherwise.

    Raises:
        InputError: a file, an axis, the range, the model or its options cannot be used.
    """
    timer = Timer()
    with timer.step("load"):
        identity = _read_mesh(identity)
        clip = cut_clip(_read_clip(driving, fps, animation), start, stop, step)
    axes = (up, front, *driving_axes(clip, driving_up, driving_front))
    choice = _choice(model, ensemble, seed, reference, markers)
    options = MotionOptions(root, ground, smooth, skinned)
    moved = move(identity, clip, choice, axes, refine, timer, options, progress, np.float32)
    notes = moved.notes
    if len(clip) == 1:
        notes += (f"{clip.mesh.name} has one frame, a pose: give an animated .glb or a folder of frames",)
    mesh = identity.with_vertices(moved.vertices[0].astype(np.float64))
    result = Clip(mesh, moved.vertices, clip.fps)
    return ClipResult(result, _name(model), timer, moved.report, notes, moved.skeleton, identity, clip)


def _choice(model: str | Method, ensemble: int, seed: int, reference, markers) -> Choice:
    """The method of a name with its options, once the driving's frame is known; a method itself has its own."""
    if isinstance(model, Method):
        return lambda frame: model
    mesh = None if reference is None else _read_mesh(reference)
    if isinstance(markers, (str, Path)):
        from ..io.markers import load_markers

        markers = load_markers(Path(markers))
    elif markers is not None:
        markers = _pairs(markers)

    def choose(frame: Normalization) -> Method:
        third = None if mesh is None else dataclasses.replace(mesh, vertices=frame.apply(mesh.vertices))
        return find_method(model, ensemble=ensemble, seed=seed, reference=third, markers=markers)

    return choose


def _name(model: str | Method) -> str:
    return model.name if isinstance(model, Method) else model


def _pairs(markers: ArrayLike) -> Int[np.ndarray, "M 2"]:
    try:
        found = np.asarray(markers)
    except ValueError:  # rows of different lengths
        found = np.asarray(markers, object)
    if found.ndim != 2 or found.shape[1] != 2 or found.dtype.kind not in "iu":
        raise InputError(
            f"markers: expected whole numbers of shape (M, 2), found {found.dtype} {found.shape}; "
            "rows are (identity vertex, driving vertex)"
        )
    return found.astype(np.int64)


def driving_axes(clip: Clip, up: str | None, front: str | None) -> tuple[str | None, str | None]:
    """Up and front of the driving's first frame: as they were given, else as its joints say, else to be found."""
    if up is not None or front is not None or clip.headings is None:
        return up, front
    x, y, z = clip.headings[0]
    if abs(y) > max(abs(x), abs(z)):  # lies or bows: the hips look up or down
        return "+y", None
    return "+y", ("+" if max(x, z, key=abs) > 0 else "-") + ("x" if abs(x) > abs(z) else "z")


def _read_mesh(mesh: Mesh | str | Path) -> Mesh:
    if isinstance(mesh, Mesh):
        return check_mesh(mesh, mesh.name)
    from ..io import load_mesh

    return load_mesh(Path(mesh))


def _read_clip(clip: Clip | str | Path, fps: float | None, animation: str | None) -> Clip:
    if isinstance(clip, Clip):
        return check_clip(clip if fps is None else dataclasses.replace(clip, fps=fps), clip.mesh.name)
    from ..io import load_clip

    return load_clip(Path(clip), fps=fps, animation=animation)
