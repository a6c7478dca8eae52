"""Public functions as programs call them: arguments and arrays are checked.

Lists, integers and tensors become arrays (`as_vertices` and others); messages say what to do with all else.
"""

from __future__ import annotations

import functools
import inspect
import numbers
import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from jaxtyping import Float, Int

from .errors import InputError
from .threads import one_thread

F = TypeVar("F", bound=Callable[..., Any])
LOWEST_FPS, HIGHEST_FPS = 1e-3, 1e4
"""Frames a second; other rates are mistakes, and lead to as many frames, or none."""


def public(function: F) -> F:
    """Make a function one that programs call: wrong arguments raise InputError, linear algebra has `one_thread`."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        check_call(signature, args, kwargs)
        with one_thread():
            return function(*args, **kwargs)

    return cast(F, call)


def check_call(signature: inspect.Signature, args: tuple[Any, ...], given: dict[str, Any]) -> None:
    """Raise InputError for arguments of another kind than the annotation says.

    Missing and unknown ones are left to the call itself, which raises Python's own TypeError.
    """
    try:
        values = signature.bind(*args, **given).arguments
    except TypeError:
        return
    for name, value in values.items():
        check_kind(name, value, str(signature.parameters[name].annotation))


def check_kind(name: str, value: object, annotation: str) -> None:
    """Raise InputError for a value of another kind than its annotation, which may be "Mesh | str | Path".

    Kinds that are not in KINDS are left to the function.
    """
    allowed = [kind.strip() for kind in annotation.split("|")]
    if not all(kind in KINDS for kind in allowed) or any(KINDS[kind][1](value) for kind in allowed):
        return
    words = [KINDS[kind][0] for kind in allowed if kind != "str" or "Path" not in allowed]
    *others, last = words
    expected = f"{', '.join(others)} or {last}" if others else last
    raise InputError(f"{name}: expected {expected}, found {described(value)}; {_advice(value, allowed)}")


def check_rate(fps: float, where: object, advice: str) -> None:
    """Raise InputError for a frame rate that is none."""
    if not LOWEST_FPS <= fps <= HIGHEST_FPS:
        expected = f"a frame rate from {LOWEST_FPS:g} to {HIGHEST_FPS:,.0f}"
        raise InputError(f"{where}: expected {expected}, found {fps:g}; {advice}")


def described(value: object) -> str:
    """Say in a few words what a value is, for messages."""
    if value is None or isinstance(value, (bool, numbers.Number, str, bytes)):
        return repr(value)[:60]
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if _is("Clip")(value):
        return f"a Clip of {len(cast(Any, value))} frames"
    name = type(value).__name__
    return f"{'an' if name[0] in 'aeiouAEIO' else 'a'} {name}"


def _advice(value: object, allowed: list[str]) -> str:
    if hasattr(value, "panels"):  # results
        return "give its mesh (Result) or clip (ClipResult)"
    if "Clip" in allowed and _is("Mesh")(value):
        return "mimesh.Clip.still(mesh) is a clip of one frame, transfer takes a pose, save_mesh writes a mesh"
    if "Mesh" in allowed and _is("Clip")(value):
        return (
            "clip.mesh.with_vertices(clip.vertices[0]) is one frame; animate takes whole clips, save_clip writes them"
        )
    if {"Mesh", "Clip"} & set(allowed) and isinstance(value, (np.ndarray, list, tuple)):
        return "make one of arrays: " + (
            "mimesh.Mesh(vertices, faces)" if "Mesh" in allowed else "mimesh.Clip(mesh, vertices)"
        )
    if allowed in (["Mesh"], ["Clip"]) and isinstance(value, (str, os.PathLike)):
        return "load_mesh and load_clip read files; where something is saved, it comes first, then its path"
    return f"give {KINDS['Path' if 'Path' in allowed else allowed[0]][0]}"


def _is(kind: str, module: str = "mesh") -> Callable[[object], bool]:
    """Return the test of a class of a module of `core`, by its name: these modules import this one."""
    return lambda value: any(
        (base.__module__, base.__name__) == (f"mimesh.core.{module}", kind) for base in type(value).__mro__
    )


def _is_number(kind: type) -> Callable[[object], bool]:
    """Return the test of numbers of a kind; arrays without dimensions, as archives hold them, are numbers."""

    def test(value: object) -> bool:
        scalar = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
        return isinstance(scalar, kind) and not isinstance(scalar, (bool, np.bool_))

    return test


KINDS: dict[str, tuple[str, Callable[[object], bool]]] = {
    "None": ("None", lambda value: value is None),
    "str": ("text", lambda value: isinstance(value, str)),
    "Path": ("a path", lambda value: isinstance(value, os.PathLike)),
    "int": ("a whole number", _is_number(numbers.Integral)),
    "float": ("a number", _is_number(numbers.Real)),
    "bool": ("True or False", lambda value: isinstance(value, (bool, np.bool_))),
    "slice": ("a slice", lambda value: isinstance(value, slice)),
    "Progress": ("a function of (done, total)", callable),
    "Mesh": ("a Mesh", _is("Mesh")),
    "Clip": ("a Clip", _is("Clip")),
    **{
        kind: (f"mimesh.{kind}(...)", _is(kind, "options"))
        for kind in ("Hints", "FrameRange", "MotionOptions", "ModelOptions", "Layout")
    },
}
"""Kind in annotations -> what messages call it, and whether a value is of it."""


def as_vertices(values: Any, name: str = "Mesh.vertices") -> Float[np.ndarray, "V 3"]:
    """Convert anything that is like an array to vertices; arrays of float32 and float64 stay what they are.

    Raises:
        InputError: another shape, or no real numbers.
    """
    array = _as_array(name, values)
    if array.ndim != 2 or array.shape[1] != 3:
        hint = "give an array with a row x, y, z for each vertex"
        if array.ndim == 2 and array.shape[0] == 3:
            hint = "give vertices.T"
        elif array.ndim == 3:
            hint = "frames are those of a clip: mimesh.Clip(mesh, frames)"
        raise InputError(f"{name}: expected shape (V, 3), found {array.shape}; {hint}")
    return _as_real(name, array)


def as_faces(values: Any) -> Int[np.ndarray, "F 3"]:
    """Convert anything that is like an array of triangles to whole numbers; arrays of these stay what they are.

    Quads are refused: splitting them here would change the number of faces that the caller knows.

    Raises:
        InputError: another shape, or numbers that are not whole.
    """
    name = "Mesh.faces"
    if values is None:
        raise InputError(f"{name}: expected shape (F, 3), found None; leave it out for a point cloud")
    array = _as_array(name, values)
    if array.shape == (0,):
        array = np.zeros((0, 3), np.int64)
    if array.ndim != 2 or array.shape[1] != 3:
        hint = "give an array with three vertices for each triangle"
        if array.ndim == 2 and array.shape[1] == 4:
            hint = "split quads into triangles: faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)"
        elif array.ndim == 2 and array.shape[0] == 3:
            hint = "give faces.T"
        elif array.ndim == 1 and len(array) % 3 == 0:
            hint = "give faces.reshape(-1, 3)"
        raise InputError(f"{name}: expected shape (F, 3), found {array.shape}; {hint}")
    if array.dtype.kind == "i":
        return array
    # Text files are often read as floats.
    finite = array.dtype.kind != "f" or bool(np.isfinite(array).all())
    if array.dtype.kind == "u" or (array.dtype.kind == "f" and finite and (array == np.floor(array)).all()):
        return array.astype(np.int64)
    found = array.dtype if finite else "NaN or infinity"
    raise InputError(f"{name}: expected whole numbers, found {found}; give the indices of vertices, from 0")


def as_frames(values: Any, mesh: str, count: int) -> Float[np.ndarray, "T V 3"]:
    """Convert anything that is like an array to the frames of a mesh, given by its name and number of vertices.

    Raises:
        InputError: another shape, or no real numbers.
    """
    array = _as_array("Clip.vertices", values)
    if array.ndim != 3 or array.shape[1:] != (count, 3):
        hint = f"give an array with a row x, y, z for each vertex of {mesh} in each frame"
        if array.shape == (count, 3):
            hint = "mimesh.Clip.still(mesh) is a clip of one frame"
        elif array.ndim == 3 and array.shape[1:] == (3, count):
            hint = "give vertices.transpose(0, 2, 1)"
        elif array.ndim == 3 and array.shape[::2] == (count, 3):
            hint = "give vertices.transpose(1, 0, 2)"
        raise InputError(
            f"Clip.vertices: expected shape (T, {count}, 3), one topology for the whole clip, found {array.shape}; "
            + hint
        )
    return _as_real("Clip.vertices", array)


def as_floats(name: str, values: Any, shape: tuple[int, ...], hint: str) -> Float[np.ndarray, "..."]:
    """Convert anything that is like an array to floats of a shape; whole numbers from 0 to 1 and -1 are floats, too.

    Larger ones are refused: they are bytes or pixels.

    Raises:
        InputError: another shape, with a hint for it, or other numbers.
    """
    array = _as_array(name, values)
    if array.shape == shape and array.dtype.kind in "iu" and (abs(array.astype(np.float64)) <= 1).all():
        return array.astype(np.float64)
    if array.shape != shape or array.dtype.kind != "f":
        raise InputError(
            f"{name}: expected floats of shape {shape}, found {array.dtype} of shape {array.shape}; {hint}"
        )
    return array


def _as_array(name: str, values: Any) -> np.ndarray:
    """Convert to an array; memory maps stay what they are, other subclasses calculate in another way."""
    if type(values) in (np.ndarray, np.memmap):
        return values
    if values is None or isinstance(values, (str, bytes)) or _is("Mesh")(values) or _is("Clip")(values):
        raise InputError(f"{name}: expected an array, found {described(values)}; give one of NumPy")
    if isinstance(values, np.ma.MaskedArray):
        raise InputError(f"{name}: expected an array, found one with a mask; give one without, such as array.filled(0)")
    try:
        return np.asarray(values)
    except ValueError as error:
        raise InputError(f"{name}: expected an array, found '{error}'; give rows of one length") from error
    except (TypeError, RuntimeError) as error:  # tensors on a GPU, or with gradients
        advice = "convert it to an array of NumPy first (of PyTorch: tensor.detach().cpu().numpy())"
        raise InputError(f"{name}: expected an array, found '{error}'; {advice}") from error


def _as_real(name: str, array: np.ndarray) -> np.ndarray:
    if array.dtype.kind == "f" and array.dtype.itemsize in (4, 8):
        return array
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected real numbers, found {array.dtype}; convert them with astype(float)")
    return array.astype(np.float64)
