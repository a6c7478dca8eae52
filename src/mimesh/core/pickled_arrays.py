"""Read arrays of pickles (.pkl) of Python 2 and 3: nothing that a pickle names is imported or called.

The body models of the field are pickled dictionaries of NumPy arrays, SciPy's sparse matrices and chumpy's variables.
`pickle.load` would import and call whatever such a file names. Here a pickle may name what is in NAMES alone, and gets
records for it, which keep arguments and state; the arrays are made from the records. NumPy's own objects are not built
by the pickle either: a damaged state changes types of NumPy for the whole process. chumpy is not needed.
"""

from __future__ import annotations

import io
import pickle
import struct
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from .errors import InputError

NAMES = {
    "numpy": ("ndarray", "dtype", "matrix", "_reconstruct", "scalar", "_frombuffer"),
    "scipy": ("csr_matrix", "csr_array", "csc_matrix", "csc_array", "coo_matrix", "coo_array"),
    "chumpy": ("Ch", "Select"),
    **dict.fromkeys(("copyreg", "copy_reg"), ("_reconstructor",)),
    **dict.fromkeys(("builtins", "__builtin__"), ("object", "set", "bytes")),
    "_codecs": ("encode",),
}
"""Package -> classes and functions that a pickle may name, in whatever module of the package a version has them."""
DAMAGE = (
    *(pickle.UnpicklingError, ValueError, TypeError, LookupError, AttributeError, EOFError, OverflowError),
    *(RuntimeError, SystemError, MemoryError, struct.error),
)
"""What the pickle machine, NumPy and SciPy raise for a damaged pickle."""


class _Record:
    """What a pickle makes by a call: the arguments, and the state that the result would get."""

    arguments: tuple
    state: Any

    def __new__(cls, *arguments: Any) -> _Record:
        record = super().__new__(cls)
        record.arguments, record.state = arguments, None
        return record

    def __setstate__(self, state: Any) -> None:
        self.state = state


def _push_bytes(machine: Any) -> None:
    """Read a bytearray as the bytes that the file has; the machine would first make room for as many as it claims."""
    machine.append(machine.read(struct.unpack("<Q", machine.read(8))[0]))


class _Unpickler(pickle._Unpickler):
    """Python's pickle machine, which makes records. That in C makes room for as many objects as a file claims."""

    dispatch: ClassVar[dict] = {**pickle._Unpickler.dispatch, pickle.BYTEARRAY8[0]: _push_bytes}

    def find_class(self, module: str, name: str) -> Any:
        """Make a class of records for a name that is allowed."""
        if name not in NAMES.get(module.partition(".")[0], ()):
            raise pickle.UnpicklingError(f"{module}.{name} in it, which is not run")
        if name == "_reconstructor":  # makes an empty object of a class
            return lambda kind, *_: kind()
        return type(name, (_Record,), {})


def read_pickle(data: bytes, path: Path) -> Any:
    """Read a pickle to plain objects and records; `array_of` makes an array of either. Errors name `path`.

    Raises:
        InputError: it names anything but NAMES, or is damaged.
    """
    try:  # Python 2 has one type for text and bytes: Latin-1 keeps every byte
        found = _Unpickler(io.BytesIO(data), encoding="latin1").load()
        if isinstance(found, dict):
            return {key.decode("latin1") if isinstance(key, bytes) else str(key): found[key] for key in found}
        return found
    except DAMAGE as error:
        raise InputError(
            f"{path}: expected a pickle of NumPy, SciPy and chumpy arrays, found {str(error)!r:.120}; open only files "
            "whose source you trust, copy this one again, or save the arrays as .npz"
        ) from error


def array_of(value: Any, name: str, path: Path) -> np.ndarray:
    """Make the array of an entry of a pickle; sparse matrices become dense, chumpy's variables what they hold.

    Raises:
        InputError: it is no array of numbers, or is damaged.
    """
    try:
        array = _array(value)
        if array.dtype.kind not in "fiub":
            raise ValueError(f"{array.dtype} instead of numbers")
        return array
    except DAMAGE as error:
        raise InputError(
            f"{path}: expected '{name}' to be an array of numbers, found {error!r:.80}; save it as one"
        ) from error


def _array(value: Any) -> np.ndarray:
    match type(value).__name__, value:
        case "_reconstruct", _:  # the state is (version, shape, type, column-major, bytes)
            shape, dtype, column_major, data = value.state[-4:]
            if dtype.arguments[0] in ("O", "O4", "O8"):  # an array of one object is that object
                (content,) = data
                return _array(content)
            return _numbers(data, dtype).reshape(shape, order="F" if column_major else "C")
        case "_frombuffer", _:
            data, dtype, shape, order = value.arguments[:4]
            return _numbers(data, dtype).reshape(shape, order=order)
        case "scalar", _:
            dtype, data = value.arguments
            return _numbers(data, dtype).reshape(())
        case "Ch", _:
            return _array(value.state["x"])
        case "Select", _:  # entries `idxs` of the flattened array `a`, in another shape
            chosen = _array(value.state["a"]).reshape(-1)[_array(value.state["idxs"])]
            shape = value.state.get("preferred_shape")
            return chosen if shape is None else chosen.reshape(shape)
        case kind, _Record() if kind in NAMES["scipy"]:
            from scipy import sparse

            shape = value.state["_shape"] if "_shape" in value.state else value.state["shape"]
            if kind.startswith("coo"):
                places = value.state["coords"] if "coords" in value.state else (value.state["row"], value.state["col"])
                return sparse.coo_matrix(
                    (_array(value.state["data"]), tuple(map(_array, places))), shape=shape
                ).toarray()
            make = sparse.csr_matrix if kind.startswith("csr") else sparse.csc_matrix
            matrix = make(tuple(_array(value.state[name]) for name in ("data", "indices", "indptr")), shape=shape)
            matrix.check_format(full_check=True)  # without it a wrong index is written anywhere
            return matrix.toarray()
        case _, int() | float():
            return np.asarray(value)
        case _, list() | tuple() if all(isinstance(number, int | float) for number in value):
            return np.asarray(value)
    raise ValueError(f"{type(value).__name__}, which is no array")


def _numbers(data: Any, dtype: _Record) -> np.ndarray:
    """Make the numbers of bytes, of the type `numpy.dtype(name, ...)`, whose state has the byte order in second place.

    Protocols before 3 write bytes as text.
    """
    name, order = dtype.arguments[0], dtype.state[1] if dtype.state else "="
    if not (isinstance(name, str) and name.isalnum() and order in ("<", ">", "=", "|")):
        raise ValueError("an array of another type than numbers")
    if type(data).__name__ == "encode":
        data = data.arguments[0]
    data = data.encode("latin1") if isinstance(data, str) else bytes(memoryview(data))
    return np.frombuffer(data, np.dtype(f"{order}{name}"))
