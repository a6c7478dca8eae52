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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from .errors import InputError

NAMES = {
    "numpy": ("ndarray", "dtype", "matrix", "_reconstruct", "scalar", "_frombuffer"),
    "scipy.sparse": ("csr_matrix", "csr_array", "csc_matrix", "csc_array", "coo_matrix", "coo_array"),
    "chumpy": ("Ch", "Select"),
    "copyreg": ("_reconstructor",),
    "copy_reg": ("_reconstructor",),
    "builtins": ("object", "set", "bytes"),
    "__builtin__": ("object", "set", "bytes"),
    "_codecs": ("encode",),
}
"""Package -> classes and functions that a pickle may name, in whatever module of the package a version has them."""
TYPES = {f"{kind}{size}" for kind, sizes in {"f": "248", "i": "1248", "u": "1248", "b": "1"}.items() for size in sizes}
"""Types of arrays that are read, as NumPy names them in a pickle."""
LARGEST_SPARSE = 1 << 24
"""Entries, zeros included, up to which a sparse matrix is accepted: joints times vertices, 1.6 million for SMPL+H."""
LARGEST_KEY = 1 << 60
"""Numbers below this are keys of dictionaries."""
DAMAGE = (
    *(pickle.UnpicklingError, ValueError, TypeError, LookupError, AttributeError, EOFError, OverflowError),
    *(RuntimeError, SystemError, MemoryError, struct.error),
)
"""What the pickle machine, NumPy and SciPy raise for a damaged pickle."""


@dataclass(frozen=True, eq=False)
class PickledArrays:
    """A pickled dictionary; its arrays are made when they are asked for."""

    path: Path
    """File, for errors."""
    entries: dict[str, object]

    def array(self, name: str) -> np.ndarray:
        """Make one array; sparse matrices become dense, chumpy's variables the arrays that they hold.

        Raises:
            InputError: the entry is no array of numbers, or is damaged.
        """
        try:
            array = _array(self.entries[name])
            if array.dtype.kind not in "fiub":
                raise ValueError(f"{array.dtype} instead of numbers")
            return array
        except DAMAGE as error:
            raise InputError(
                f"{self.path}: expected '{name}' to be an array of numbers, found {error!r:.80}; save it as one"
            ) from error


def read_pickled_arrays(path: Path) -> PickledArrays:
    """Read a pickled dictionary of arrays.

    Raises:
        InputError: the pickle names anything but NAMES, is damaged, or holds no dictionary.
    """
    entries = _load(path.read_bytes(), path)
    if not isinstance(entries, dict):
        raise InputError(f"{path}: expected a pickled dictionary of arrays, found something else; check the file")
    if any(isinstance(key, int) and abs(key) >= LARGEST_KEY for key in entries):  # Python refuses to print long ones
        raise InputError(f"{path}: expected names of arrays, found a number of many digits; check the file")
    return PickledArrays(path, {_text(key): value for key, value in entries.items()})


def read_object_array(data: bytes, path: Path, name: str) -> np.ndarray:
    """Read a pickled array of one object, as .npz archives hold sparse matrices; errors name `path` and `name`.

    Raises:
        InputError: as `read_pickled_arrays`, or the object is no array.
    """
    return PickledArrays(path, {name: _load(data, path)}).array(name)


def _load(data: bytes, path: Path) -> object:
    try:
        return _Unpickler(data, path).load()
    except InputError:
        raise
    except DAMAGE as error:
        raise InputError(
            f"{path}: expected a pickle of arrays, found it damaged ({error!r:.80}); copy or download it again"
        ) from error


class _Record:
    """What a pickle makes by a call: the arguments, and the state that the result would get."""

    def __new__(cls, *arguments: Any) -> _Record:
        record = super().__new__(cls)
        record.arguments, record.state = arguments, None
        return record

    arguments: tuple
    state: Any

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Unpickler(pickle._Unpickler):
    """Python's pickle machine, which makes records.

    It is the one written in Python: that in C makes room for as many objects as a number in the file says.
    """

    records: ClassVar[dict[str, type]] = {
        name: type(name, (_Record,), {}) for names in NAMES.values() for name in names if name != "_reconstructor"
    }

    def __init__(self, data: bytes, path: Path) -> None:
        # Python 2 has one type for text and bytes: Latin-1 keeps every byte.
        super().__init__(io.BytesIO(data), encoding="latin1")
        self._path = path

    def find_class(self, module: str, name: str) -> Any:
        """Find what stands for a name; raise InputError for one that is not allowed."""
        if not any(f"{module}.".startswith(f"{package}.") and name in names for package, names in NAMES.items()):
            raise InputError(
                f"{self._path}: expected a pickle of NumPy, SciPy and chumpy arrays, found {f'{module}.{name}'!r:.100} "
                "in it, which is not run; open only files whose source you trust, or save the arrays as .npz"
            )
        return self.records.get(name, _reconstructor)

    def load_bytearray8(self) -> None:
        """Read a byte array as bytes: the machine would make room for what the file claims."""
        (size,) = struct.unpack("<Q", self.read(8))
        self.append(self.read(size))

    dispatch: ClassVar[dict[int, Callable[..., None]]] = {
        **pickle._Unpickler.dispatch,
        pickle.BYTEARRAY8[0]: load_bytearray8,
    }
    append: Callable[[object], None]
    read: Callable[[int], bytes]


def _reconstructor(kind: type, *_: object) -> _Record:
    """Make an empty object of a class, as `copyreg._reconstructor` does."""
    if not issubclass(kind, _Record):
        raise TypeError("an object of no class")
    return kind()


def _array(value: Any) -> np.ndarray:
    """Make the array of a record, or of a plain number or list of numbers."""
    if not isinstance(value, _Record):
        if isinstance(value, list | tuple) and not all(isinstance(number, int | float) for number in value):
            raise ValueError("a list of other things than numbers")
        return np.asarray(value)
    kind = type(value).__name__
    if kind == "_reconstruct":  # the state is (version, shape, type, column-major, bytes)
        shape, dtype, column_major, data = value.state[-4:]
        name = dtype.arguments[0]
        if isinstance(name, str) and name.startswith("O"):  # an array of one object is that object
            (content,) = data
            return _array(content)
        return np.frombuffer(_bytes(data), _dtype(dtype)).reshape(shape, order="F" if column_major else "C")
    if kind == "_frombuffer":
        data, dtype, shape, order = value.arguments[:4]
        return np.frombuffer(_bytes(data), _dtype(dtype)).reshape(shape, order=order)
    if kind == "scalar":
        dtype, data = value.arguments
        return np.frombuffer(_bytes(data), _dtype(dtype)).reshape(())
    if kind == "Ch":
        return _array(value.state["x"])
    if kind == "Select":  # entries `idxs` of the flattened array `a`, in another shape
        index = value.state["idxs"]
        if type(index).__name__ == "Select":  # of selections of selections a short pickle could ask 2^40 times
            raise ValueError("a selection by a selection")
        chosen = _array(value.state["a"]).reshape(-1)[_array(index)]
        shape = value.state.get("preferred_shape")
        return chosen if shape is None else chosen.reshape(shape)
    if kind in NAMES["scipy.sparse"]:
        return _dense(kind, value.state)
    raise ValueError(f"{kind}, which is no array")


def _dense(kind: str, state: dict[str, Any]) -> np.ndarray:
    """Make the array of a sparse matrix from its attributes."""
    from scipy import sparse

    rows, columns = shape = state["_shape"] if "_shape" in state else state["shape"]
    if not 0 < rows * columns <= LARGEST_SPARSE:
        raise ValueError(f"a sparse matrix of {rows} x {columns}")
    data = _array(state["data"])
    if kind.startswith("coo"):
        places = state["coords"] if "coords" in state else (state["row"], state["col"])
        return sparse.coo_matrix((data, tuple(map(_array, places))), shape=shape).toarray()
    make = sparse.csr_matrix if kind.startswith("csr") else sparse.csc_matrix
    matrix = make((data, _array(state["indices"]), _array(state["indptr"])), shape=shape)
    matrix.check_format(full_check=True)  # without it a wrong index is written anywhere
    return matrix.toarray()


def _dtype(record: _Record) -> np.dtype:
    """Make the type of `numpy.dtype(name, ...)`, whose state has the byte order in second place."""
    name, order = record.arguments[0], record.state[1] if record.state else "="
    if not isinstance(name, str) or name not in TYPES or order not in ("<", ">", "=", "|"):
        raise ValueError("an array of another type than numbers")
    return np.dtype(name).newbyteorder(order)


def _bytes(value: Any) -> bytes:
    """Return the bytes of an array, which protocols before 3 write as text."""
    if type(value).__name__ == "encode" and value.arguments[1] == "latin1":
        value = value.arguments[0]
    return value.encode("latin1") if isinstance(value, str) else bytes(memoryview(value))


def _text(key: object) -> str:
    return key.decode("latin1") if isinstance(key, bytes) else str(key)
