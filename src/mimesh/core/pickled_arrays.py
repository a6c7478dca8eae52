"""Read arrays of pickles (.pkl) of Python 2 and 3: nothing that a pickle names is imported or called but ALLOWED.

The body models of the field are pickled dictionaries of NumPy arrays, SciPy's sparse matrices and chumpy's variables.
`pickle.load` would import and call whatever such a file names. Objects of SciPy and chumpy are read as plain records of
their attributes, so that chumpy is not needed and versions of SciPy do not matter.
"""

from __future__ import annotations

import importlib
import io
import pickle
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError

ALLOWED = {
    "numpy": ("ndarray", "dtype", "matrix"),
    "numpy.matrixlib.defmatrix": ("matrix",),
    "numpy._core.multiarray": ("_reconstruct", "scalar"),
    "numpy._core.numeric": ("_frombuffer",),
    "builtins": ("object", "set", "bytes"),
    "copyreg": ("_reconstructor",),
    "_codecs": ("encode",),
}
"""Module -> what a pickle may use of it: it makes arrays and numbers, and does nothing else."""
RECORDS = {
    **dict.fromkeys(("csr_matrix", "csr_array", "csc_matrix", "csc_array", "coo_matrix", "coo_array"), "scipy.sparse"),
    **{"Ch": "chumpy", "Select": "chumpy.reordering"},
}
"""Class -> package, of objects that are read as records of their attributes."""
FORMER = {"numpy.core": "numpy._core", "__builtin__": "builtins", "copy_reg": "copyreg"}
"""Beginning of the names of modules in older files -> today's."""
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
        InputError: the pickle names anything but ALLOWED and RECORDS, is damaged, or holds no dictionary.
    """
    entries = _load(path.read_bytes(), path)
    if not isinstance(entries, dict):
        raise InputError(f"{path}: expected a pickled dictionary of arrays, found something else; check the file")
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


class _Unpickler(pickle._Unpickler):
    """Python's pickle machine, which finds only what is allowed.

    It is the one written in Python: that in C makes room for as many objects as a number in the file says.
    """

    def __init__(self, data: bytes, path: Path) -> None:
        # Python 2 has one type for text and bytes: Latin-1 keeps every byte.
        super().__init__(io.BytesIO(data), encoding="latin1")
        self._path = path
        self._records: dict[str, type] = {}

    def find_class(self, module: str, name: str) -> Any:
        """Find a class or function by name; raise InputError for one that is not allowed."""
        if module.startswith(RECORDS.get(name, "-")):
            # A class of this file's own: the state of another file never gets at it.
            return self._records.setdefault(name, type(name, (), {}))
        for former, today in FORMER.items():
            module = today + module.removeprefix(former) if module.startswith(former) else module
        if name not in ALLOWED.get(module, ()):
            raise InputError(
                f"{self._path}: expected a pickle of NumPy, SciPy and chumpy arrays, found {f'{module}.{name}'!r:.100} "
                "in it, which is not run; open only files whose source you trust, or save the arrays as .npz"
            )
        return getattr(importlib.import_module(module), name)


def _array(value: Any) -> np.ndarray:
    """Make the array of a record, of an array of one object, or of a plain number or list of numbers."""
    kind = type(value).__name__
    if kind in RECORDS:
        return _array_of_record(kind, vars(value))
    array = np.asarray(value)
    return _array(array.item()) if array.dtype.hasobject and array.size == 1 and value is not None else array


def _array_of_record(kind: str, state: dict[str, Any]) -> np.ndarray:
    """Make the array of an object of SciPy or chumpy from its attributes."""
    if kind == "Ch":
        return _array(state["x"])
    if kind == "Select":  # entries `idxs` of the flattened array `a`, in another shape
        chosen = _array(state["a"]).reshape(-1)[_array(state["idxs"])]
        shape = state.get("preferred_shape")
        return chosen if shape is None else chosen.reshape(shape)
    from scipy import sparse

    shape = state["_shape"] if "_shape" in state else state["shape"]
    if kind.startswith("coo"):
        places = state["coords"] if "coords" in state else (state["row"], state["col"])
        return sparse.coo_matrix((state["data"], places), shape=shape).toarray()
    make = sparse.csr_matrix if kind.startswith("csr") else sparse.csc_matrix
    matrix = make((state["data"], state["indices"], state["indptr"]), shape=shape)
    matrix.check_format(full_check=True)  # without it a wrong index writes anywhere
    return matrix.toarray()


def _text(key: object) -> str:
    return key.decode("latin1") if isinstance(key, bytes) else str(key)
