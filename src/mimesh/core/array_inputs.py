"""What programs give as arrays, converted: lists, integers, tensors; messages say what to do with all else."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .arguments import KINDS, described
from .errors import InputError


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
    if array.dtype.kind == "u" or (array.dtype.kind == "f" and _are_whole(array)):
        return array.astype(np.int64)
    raise InputError(f"{name}: expected whole numbers, found {_kind(array)}; give the indices of vertices, from 0")


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
    if values is None or isinstance(values, (str, bytes)) or KINDS["Mesh"](values) or KINDS["Clip"](values):
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
    """Return float32 or float64: other real numbers become float64."""
    if array.dtype.kind == "f" and array.dtype.itemsize in (4, 8):
        return array
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected real numbers, found {array.dtype}; convert them with astype(float)")
    return array.astype(np.float64)


def _are_whole(array: np.ndarray) -> bool:
    return bool(np.isfinite(array).all() and (array == np.floor(array)).all())


def _kind(array: np.ndarray) -> str:
    """Say of what kind numbers are that are not whole."""
    return f"{array.dtype}" if array.dtype.kind != "f" or np.isfinite(array).all() else "NaN or infinity"
