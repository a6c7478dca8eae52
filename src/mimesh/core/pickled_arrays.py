"""Read arrays of untrusted pickles (.pkl) of Python 2 and 3: nothing that a pickle names is imported or called.

The body models of the field are pickled dictionaries of NumPy arrays, SciPy's sparse matrices and chumpy's variables.
`pickle.load` would import and call whatever such a file names. Here every call that a pickle asks for is only recorded,
and only the calls in CONSTRUCTORS may be named; the arrays are then made from the recorded arguments and states.
Neither SciPy nor chumpy is needed.

The pickle machine is Python's own, written in Python, with opcodes left out: the one written in C allocates as much
memory as a few bytes claim, and sets attributes of what it builds.
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

NUMBERS = {
    f"{kind}{size}" for kind, sizes in {"f": "248", "i": "1248", "u": "1248", "b": "1"}.items() for size in sizes
}
"""Types of arrays that are read, as NumPy names them in a pickle."""
LARGEST_SPARSE = 1 << 24
"""Entries, zeros included, up to which a sparse matrix is accepted: joints times vertices, 1.6 million for SMPL+H."""
LARGEST_KEY = 1 << 60
"""Numbers below this are keys of dictionaries: each has a hash of its own, while many larger ones may share theirs."""
# What the pickle machine and NumPy raise for a damaged pickle.
_DAMAGE = (
    pickle.UnpicklingError, ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError, OverflowError,
    RecursionError, MemoryError, struct.error,
)  # fmt: skip


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
        except _DAMAGE as error:
            raise InputError(
                f"{self.path}: expected '{name}' to be an array of numbers, found {error!r:.80}; save it as one"
            ) from error


def read_pickled_arrays(path: Path) -> PickledArrays:
    """Read a pickled dictionary of arrays.

    Raises:
        InputError: the pickle names anything but CONSTRUCTORS, is damaged, or holds no dictionary.
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
    """Run the pickle machine; calls are recorded."""
    try:
        return _Recorder(data, path).load()
    except InputError:
        raise
    except _DAMAGE as error:
        raise InputError(
            f"{path}: expected a pickle of arrays, found it damaged ({error!r:.80}); copy or download it again"
        ) from error


@dataclass(frozen=True)
class _Name:
    """A class or function that a pickle names, by module and name."""

    module: str
    name: str


@dataclass(eq=False)
class _Call:
    """A call that a pickle asks for, as it is written there, with the state that its result would get."""

    target: _Name
    arguments: tuple
    state: Any = None


class _Recorder(pickle._Unpickler):
    """Python's pickle machine with fewer opcodes, which records calls instead of making them."""

    # What the machine has besides its documented methods (see Python's pickle.py).
    dispatch: ClassVar[dict[int, Callable[..., None]]]
    stack: list[Any]
    append: Callable[[object], None]
    read: Callable[[int], bytes]
    readline: Callable[[], bytes]
    pop_mark: Callable[[], list]

    def __init__(self, data: bytes, path: Path) -> None:
        # Python 2 has one type for text and bytes: Latin-1 keeps every byte.
        super().__init__(io.BytesIO(data), encoding="latin1")
        self._path = path

    def find_class(self, module: str, name: str) -> _Name:
        """Record a name; raise InputError for one that is not in CONSTRUCTORS."""
        if (module, name) not in CONSTRUCTORS:
            raise InputError(
                f"{self._path}: expected a pickle of NumPy, SciPy and chumpy arrays, found {f'{module}.{name}'!r:.100} "
                "in it, which is not run; open only files whose source you trust, or save the arrays as .npz"
            )
        return _Name(module, name)

    def record(self, target: object, arguments: object) -> _Call:
        """Record a call; `copyreg._reconstructor(class, ...)` makes an empty object of the class."""
        if not isinstance(target, _Name) or not isinstance(arguments, tuple):
            raise ValueError("a call of no function")
        if target.name == "_reconstructor":
            return self.record(arguments[0], ())
        return _Call(target, arguments)

    def load_call(self) -> None:
        """REDUCE and NEWOBJ: call the function, or make an object of the class, below the arguments."""
        arguments, target = self.stack.pop(), self.stack.pop()
        self.append(self.record(target, arguments))

    def load_inst(self) -> None:
        """INST: a call with the arguments above the mark; module and name follow in the file."""
        module, name = (self.readline()[:-1].decode("ascii") for _ in range(2))
        arguments = tuple(self.pop_mark())
        self.append(self.record(self.find_class(module, name), arguments))

    def load_state(self) -> None:
        """BUILD: keep the state of the object below it."""
        state, call = self.stack.pop(), self.stack[-1]
        if not isinstance(call, _Call):
            raise ValueError("a state of no object")
        call.state = state

    def load_item(self) -> None:
        """SETITEM: put a pair into the dictionary below it."""
        value, key = self.stack.pop(), self.stack.pop()
        _put(self.stack[-1], [key, value])

    def load_items(self) -> None:
        """SETITEMS: put the pairs above the mark into the dictionary below it."""
        items = self.pop_mark()
        _put(self.stack[-1], items)

    def load_pairs(self) -> None:
        """DICT: make a dictionary of the pairs above the mark."""
        items = self.pop_mark()
        self.append(_put({}, items))

    def load_no_set(self) -> None:
        """EMPTY_SET: no array depends on a set, so a list stands for it."""
        self.append([])

    def load_bytearray(self) -> None:
        """BYTEARRAY8: as bytes; Python's own would allocate what the file claims."""
        (size,) = struct.unpack("<Q", self.read(8))
        self.append(self.read(size))


def _put(entries: object, items: list) -> dict:
    """Put keys and values that alternate into a dictionary; other keys than text and numbers may take forever to hash.

    A tuple of a tuple of ... twice each has a hash that takes time exponential in its depth.
    """
    keys, values = items[::2], items[1::2]
    if not isinstance(entries, dict) or not all(map(_is_key, keys)):
        raise ValueError("a dictionary with odd keys")
    entries.update(zip(keys, values, strict=True))
    return entries


def _is_key(key: object) -> bool:
    return isinstance(key, str | bytes | float) or (isinstance(key, int) and abs(key) < LARGEST_KEY)


_PLAIN = (
    pickle.PROTO, pickle.FRAME, pickle.STOP, pickle.MARK, pickle.POP, pickle.POP_MARK, pickle.DUP,
    pickle.NONE, pickle.NEWTRUE, pickle.NEWFALSE, pickle.INT, pickle.BININT, pickle.BININT1, pickle.BININT2,
    pickle.LONG, pickle.LONG1, pickle.LONG4, pickle.FLOAT, pickle.BINFLOAT,
    pickle.STRING, pickle.BINSTRING, pickle.SHORT_BINSTRING, pickle.BINBYTES, pickle.SHORT_BINBYTES, pickle.BINBYTES8,
    pickle.UNICODE, pickle.BINUNICODE, pickle.SHORT_BINUNICODE, pickle.BINUNICODE8,
    pickle.TUPLE, pickle.EMPTY_TUPLE, pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3,
    pickle.EMPTY_LIST, pickle.LIST, pickle.APPEND, pickle.APPENDS, pickle.EMPTY_DICT,
    pickle.PUT, pickle.BINPUT, pickle.LONG_BINPUT, pickle.MEMOIZE, pickle.GET, pickle.BINGET, pickle.LONG_BINGET,
    pickle.GLOBAL, pickle.STACK_GLOBAL,
)  # fmt: skip
"""Opcodes that Python's machine runs: values, containers, names and the memo. Left out: OBJ, NEWOBJ_EX, the extension
registry, persistent identifiers and out-of-band buffers, which no array needs."""
_Recorder.dispatch = {code[0]: pickle._Unpickler.dispatch[code[0]] for code in _PLAIN} | {
    pickle.REDUCE[0]: _Recorder.load_call,
    pickle.NEWOBJ[0]: _Recorder.load_call,
    pickle.INST[0]: _Recorder.load_inst,
    pickle.BUILD[0]: _Recorder.load_state,
    pickle.SETITEM[0]: _Recorder.load_item,
    pickle.SETITEMS[0]: _Recorder.load_items,
    pickle.DICT[0]: _Recorder.load_pairs,
    pickle.EMPTY_SET[0]: _Recorder.load_no_set,
    pickle.ADDITEMS[0]: pickle._Unpickler.dispatch[pickle.APPENDS[0]],
    pickle.BYTEARRAY8[0]: _Recorder.load_bytearray,
}


def _array(value: object) -> np.ndarray:
    """Make the array of a recorded call, or of a plain number or list of numbers."""
    if isinstance(value, _Call):
        return CONSTRUCTORS[value.target.module, value.target.name](value)
    if isinstance(value, list | tuple) and not all(isinstance(number, int | float) for number in value):
        raise ValueError("a list of other things than numbers")
    return np.asarray(value)


def _part(value: object) -> np.ndarray:
    """Make an array that another one is made of: it must hold its numbers itself.

    If selections of selections were among them, a short pickle could ask for one array 2^40 times.
    """
    if isinstance(value, _Call) and (value.target.name not in ("_reconstruct", "_frombuffer") or _holds_object(value)):
        raise ValueError(f"a part made by {value.target.name}")
    return _array(value)


def _holds_object(call: _Call) -> bool:
    return call.target.name == "_reconstruct" and _type_name(call.state[-3]).startswith("O")


def _stored(call: _Call) -> np.ndarray:
    """numpy.core.multiarray._reconstruct: the state is (version, shape, type, column-major, bytes)."""
    shape, dtype, column_major, data = call.state[-4:]
    if _holds_object(call):  # an array of one object is that object
        (content,) = data
        return _array(content)
    return np.frombuffer(_bytes(data), _dtype(dtype)).reshape(shape, order="F" if column_major else "C")


def _buffer(call: _Call) -> np.ndarray:
    """numpy.core.numeric._frombuffer(bytes, type, shape, order), from protocol 5 on."""
    data, dtype, shape, order = call.arguments[:4]
    if order not in ("C", "F"):
        raise ValueError("an array in another order than C and F")
    return np.frombuffer(_bytes(data), _dtype(dtype)).reshape(shape, order=order)


def _scalar(call: _Call) -> np.ndarray:
    """numpy.core.multiarray.scalar(type, bytes)."""
    dtype, data = call.arguments
    return np.frombuffer(_bytes(data), _dtype(dtype)).reshape(())


def _compressed(call: _Call) -> np.ndarray:
    """csr_matrix and csc_matrix: row or column k has the entries indptr[k] to indptr[k + 1] of indices and data."""
    data, indices, starts = (_part(call.state[name]).reshape(-1) for name in ("data", "indices", "indptr"))
    if starts[0] != 0 or starts[-1] != len(indices) or (starts[1:] < starts[:-1]).any():
        raise ValueError("a sparse matrix whose indptr do not divide its indices")
    lines = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    return _scattered(call, (lines, indices) if call.target.name.startswith("csr") else (indices, lines), data)


def _coordinates(call: _Call) -> np.ndarray:
    """coo_matrix: entry k is at row[k], col[k]; newer versions of SciPy call both coords."""
    rows, columns = call.state["coords"] if "coords" in call.state else (call.state["row"], call.state["col"])
    return _scattered(call, (_part(rows), _part(columns)), _part(call.state["data"]))


def _scattered(call: _Call, places: tuple[np.ndarray, np.ndarray], data: np.ndarray) -> np.ndarray:
    """Make a dense matrix of the entries at (row, column); entries at one place are added."""
    rows, columns = call.state["_shape"] if "_shape" in call.state else call.state["shape"]
    if not 0 < int(rows) * int(columns) <= LARGEST_SPARSE or rows < 0:
        raise ValueError(f"a sparse matrix of {rows} x {columns}")
    if len({len(places[0]), len(places[1]), len(data)}) != 1:
        raise ValueError("a sparse matrix with more places than entries or fewer")
    if any(len(place) and place.min() < 0 for place in places):
        raise ValueError("a sparse matrix with negative indices")
    dense = np.zeros((int(rows), int(columns)), data.dtype)
    np.add.at(dense, places, data)
    return dense


def _variable(call: _Call) -> np.ndarray:
    """chumpy.ch.Ch: a variable holds its array as x."""
    return _array(call.state["x"])


def _selection(call: _Call) -> np.ndarray:
    """chumpy.reordering.Select: entries idxs of the flattened array a, in another shape."""
    chosen = _array(call.state["a"]).reshape(-1)[_part(call.state["idxs"])]
    shape = call.state.get("preferred_shape")
    return chosen if shape is None else chosen.reshape(shape)


def _no_array(call: _Call) -> np.ndarray:
    """What arrays are described with, and what other entries of a file may hold."""
    raise ValueError(f"{call.target.name}, which is no array")


def _dtype(call: _Call) -> np.dtype:
    """numpy.dtype(name, ...), whose state has the byte order in second place."""
    name, order = _type_name(call), call.state[1] if call.state else "="
    if call.target.name != "dtype" or name not in NUMBERS or order not in ("<", ">", "=", "|"):
        raise ValueError(f"an array of the type {name!r:.20}")
    return np.dtype(name).newbyteorder(order)


def _type_name(call: _Call) -> str:
    """Return the name of a numpy.dtype; anything else may take forever to compare or print (`_put`)."""
    name = call.arguments[0]
    if not isinstance(name, str):
        raise ValueError("an array of a type without a name")
    return name


def _bytes(value: object) -> bytes:
    """Return the bytes of an array, which protocols before 3 write as text."""
    if isinstance(value, _Call) and value.target.name == "encode" and value.arguments[1] == "latin1":
        value = value.arguments[0]
    if isinstance(value, str):
        return value.encode("latin1")
    if not isinstance(value, bytes):
        raise ValueError("an array without bytes")
    return value


def _text(key: object) -> str:
    return key.decode("latin1") if isinstance(key, bytes) else str(key)


def _named(modules: str, names: str, make: Callable[[_Call], np.ndarray]) -> dict:
    return {(module, name): make for module in modules.split() for name in names.split()}


CONSTRUCTORS: dict[tuple[str, str], Callable[[_Call], np.ndarray]] = {
    **_named("numpy.core.multiarray numpy._core.multiarray", "_reconstruct", _stored),
    **_named("numpy.core.multiarray numpy._core.multiarray", "scalar", _scalar),
    **_named("numpy.core.numeric numpy._core.numeric", "_frombuffer", _buffer),
    **_named("scipy.sparse.csr scipy.sparse._csr", "csr_matrix csr_array", _compressed),
    **_named("scipy.sparse.csc scipy.sparse._csc", "csc_matrix csc_array", _compressed),
    **_named("scipy.sparse.coo scipy.sparse._coo", "coo_matrix coo_array", _coordinates),
    **_named("chumpy.ch chumpy", "Ch", _variable),
    **_named("chumpy.reordering", "Select", _selection),
    **_named("numpy", "ndarray dtype", _no_array),
    **_named("numpy.matrixlib.defmatrix numpy", "matrix", _no_array),
    **_named("__builtin__ builtins", "object set bytes", _no_array),
    **_named("copy_reg copyreg", "_reconstructor", _no_array),
    **_named("_codecs", "encode", _no_array),
}
"""All that a pickle may name, by module and name, and what makes an array of the recorded call."""
