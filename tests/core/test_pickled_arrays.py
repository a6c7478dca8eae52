"""Pickled arrays: every protocol and layout gives its numbers back, and no pickle makes anything happen."""

from __future__ import annotations

import os
import pickle
import pickletools
import sys
import time
import types
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from smpl_files import Ch, Select, chumpy_modules

from mimesh.core.errors import InputError
from mimesh.core.pickled_arrays import array_of, read_pickle

RNG = np.random.default_rng(0)
DENSE = RNG.random((3, 4)) * (RNG.random((3, 4)) > 0.4)
ENTRIES = {
    "row-major": DENSE,
    "column-major": np.asfortranarray(DENSE.astype(np.float32)),
    "big-endian": np.arange(5, dtype=">i8"),
    "unsigned": np.array([2**32 - 1, 0], np.uint32),
    "half": DENSE.astype(np.float16),
    "truth": DENSE > 0,
    "number": np.float64(3.5),
    "list": [1, 2.5],
    "csc": sp.csc_matrix(DENSE),
    "csr": sp.csr_matrix(DENSE),
    "coo": sp.coo_matrix(DENSE),
    "csc array": sp.csc_array(DENSE),
    "object": np.array([sp.csc_matrix(DENSE), None], object)[:1],
}
OTHERS = {"text": "lbs", "set": {1, 2}, "nothing": None, "texts": np.array(["ab"]), "empty": np.zeros(0), "bytes": b""}
"""Entries that are no arrays of numbers, and do not keep the others from being read."""


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def read_array(path: Path, name: str) -> np.ndarray:
    found = read_pickle(path.read_bytes(), path)
    return array_of(found.get(name) if isinstance(found, dict) else None, name, path)


def error_of(data: bytes, tmp_path: Path, name: str = "a") -> str:
    """Read a pickle and one of its arrays; return the message of the InputError, which is one line."""
    path = write(tmp_path / "a.pkl", data)
    with pytest.raises(InputError) as caught:
        read_array(path, name)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: expected ")
    assert " found " in message
    assert "; " in message
    return message


@pytest.mark.filterwarnings("ignore:the matrix subclass")
@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_of_every_layout_are_read_exactly(protocol, tmp_path):
    entries = {**ENTRIES, "matrix": np.matrix(DENSE)}
    path = write(tmp_path / "a.pkl", pickle.dumps({**entries, **OTHERS}, protocol))
    assert set(read_pickle(path.read_bytes(), path)) == {*entries, *OTHERS}
    for name, value in entries.items():
        array = read_array(path, name)
        true = DENSE if name == "object" else value.toarray() if sp.issparse(value) else np.asarray(value)
        assert array.dtype == true.dtype
        np.testing.assert_array_equal(array, true)
    for name in ("text", "nothing", "texts"):
        with pytest.raises(InputError, match=f"expected '{name}' to be an array of numbers"):
            read_array(path, name)


@pytest.mark.parametrize("protocol", range(3))
def test_chumpy_variables_give_their_arrays_without_chumpy(protocol, tmp_path):
    with chumpy_modules():
        entries = {"v": Ch(DENSE), "twice": Ch(Ch(DENSE)), "some": Select(Ch(DENSE), np.array([5, 1]), (2, 1))}
        data = pickle.dumps(entries, protocol)
    assert b"chumpy" in data
    assert "chumpy" not in sys.modules
    path = write(tmp_path / "a.pkl", data)
    np.testing.assert_array_equal(read_array(path, "v"), DENSE)
    np.testing.assert_array_equal(read_array(path, "twice"), DENSE)
    np.testing.assert_array_equal(read_array(path, "some"), DENSE.reshape(-1)[[[5], [1]]])


PYTHON_2 = (
    b"(dp0\nS'a'\np1\ncnumpy.core.multiarray\n_reconstruct\np2\n(cnumpy\nndarray\np3\n(I0\ntS'b'\ntRp4\n"
    b"(I1\n(I2\ntcnumpy\ndtype\np5\n(S'f8'\nI0\nI1\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntbI00\n"
    b"S'\\x00\\x00\\x00\\x00\\x00\\x00\\xf8?\\x00\\x00\\x00\\x00\\x00\\x00\\x00\\xc0'\ntbs."
)
"""What Python 2 writes by default for {"a": numpy.array([1.5, -2.0])}: text with escapes."""


def test_a_pickle_of_python_2_is_read(tmp_path):
    assert read_array(write(tmp_path / "a.pkl", PYTHON_2), "a").tolist() == [1.5, -2.0]


class Reduced:
    """An object whose pickle asks for a call."""

    def __init__(self, function, *arguments):
        self.reduced = function, arguments

    def __reduce__(self):
        return self.reduced


def stack_global(module: str, name: str, *arguments: str) -> bytes:
    """A pickle of protocol 4 that names by STACK_GLOBAL and calls."""
    texts = b"".join(b"\x8c" + bytes([len(text)]) + text.encode() for text in (module, name))
    given = b"(" + b"".join(b"\x8c" + bytes([len(text)]) + text.encode() for text in arguments) + b"t"
    return b"\x80\x04" + texts + b"\x93" + given + b"R."


def touching(mark: Path) -> dict[str, tuple[bytes, str]]:
    """Pickles that would create the file `mark` if they were run, and what the error names."""
    shell, code = f"touch {mark}", f"__import__('pathlib').Path({str(mark)!r}).touch()"
    return {
        "os.system": (pickle.dumps({"a": Reduced(os.system, shell)}, 2), "posix.system"),
        "eval": (pickle.dumps({"a": Reduced(eval, code)}, 2), "__builtin__.eval"),
        "nested": (pickle.dumps({"a": [({"b": (Reduced(os.system, shell),)},)]}, 4), "posix.system"),
        "as an argument of numpy": (
            pickle.dumps({"a": Reduced(np._core.multiarray.scalar, np.dtype("f8"), Reduced(os.system, shell))}, 2),
            "posix.system",
        ),
        "INST": (b"(S'" + shell.encode() + b"'\nios\nsystem\n.", "os.system"),
        "OBJ": (b"(cos\nsystem\nS'" + shell.encode() + b"'\no.", "os.system"),
        "STACK_GLOBAL": (stack_global("os", "system", shell), "os.system"),
        "STACK_GLOBAL, dotted": (stack_global("numpy", "core.multiarray.os.system", shell), "numpy.core.multiarray.os"),
        "a class's attribute": (stack_global("numpy", "ndarray.tofile", str(mark)), "numpy.ndarray.tofile"),
        "numpy that runs": (stack_global("numpy.testing._private.utils", "runstring", code, "{}"), "runstring"),
        "a function of ours": (stack_global("mimesh.core.pickled_arrays", "read_pickle", "x", "y"), "read_pickle"),
    }


@pytest.mark.parametrize("name", touching(Path("mark")))
def test_a_malicious_pickle_is_refused_by_name_and_nothing_happens(name, tmp_path):
    data, named = touching(tmp_path / "mark")[name]
    assert named in error_of(data, tmp_path)
    assert not (tmp_path / "mark").exists()


CODES = {
    "persistent identifier": b"\x80\x02Pfile\n.",
    "extension registry": b"\x80\x02\x82\x01.",
    "out-of-band buffer": b"\x80\x05\x97.",
    "state of a dictionary": b"\x80\x02}}b.",
    "state of a name": b"\x80\x02cnumpy\nndarray\nN}S'__setstate__'\nN\x86b.",
    "call of a text": b"\x80\x02S'eval'\n(S'1'\ntR.",
    "reconstructor of a text": b"\x80\x02ccopy_reg\n_reconstructor\n(S'os.system'\nNNtR.",
    "append to a dictionary": b"\x80\x02}K\x01a.",
    "empty stack": b"\x80\x020.",
    "unknown memo": b"\x80\x02h\x07.",
    "unknown code": b"\x80\x02\xfe.",
    "nothing": b"",
    "no dictionary": b"\x80\x02K\x01.",
    "an HTML page": b"<!DOCTYPE html><title>Sign in</title>",
}


@pytest.mark.parametrize("name", CODES)
def test_odd_codes_give_one_error(name, tmp_path):
    error_of(CODES[name], tmp_path)


@pytest.mark.filterwarnings("ignore:the matrix subclass")
def test_a_state_that_sets_attributes_of_a_class_stays_in_its_file(tmp_path):
    error_of(b"\x80\x02}S'a'\ncscipy.sparse\ncsr_matrix\nN}S'data'\nK\x01s\x86bs.", tmp_path)
    test_arrays_of_every_layout_are_read_exactly(2, tmp_path)


def array_pickle(shape: bytes, kind: bytes = b"f8", data: bytes = b"12345678", order: bytes = b"<") -> bytes:
    """A pickle of {"a": array} with the pickled shape, the type and the bytes given."""
    return (
        b"\x80\x02}U\x01acnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01"
        + shape + b"cnumpy\ndtype\n(U" + bytes([len(kind)]) + kind + b"K\x00K\x01tR"
        + b"(K\x03U" + bytes([len(order)]) + order
        + b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U" + bytes([len(data)]) + data + b"tbs."
    )  # fmt: skip


BOMBS = {
    "shape larger than the bytes": array_pickle(b"J\xff\xff\xff\x7fJ\xff\xff\xff\x7f\x86"),
    "shape that overflows": array_pickle(b"\x8a\x08" + b"\x00" * 7 + b"\x10" + b"K\x20\x86"),
    "type of a terabyte": array_pickle(b"K\x01\x85", b"V999999999999"),
    "type of objects": array_pickle(b"K\x01\x85", b"O8"),
    "odd byte order": array_pickle(b"K\x01\x85", order=b"f8,<"),
    "shape of the empty array": b"\x80\x02}U\x01acnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\n"
    b"\x8a\x05\x00\x00\x00\x00\x7f\x85U\x01b\x87Rs.",
    "memo of four billion": b"\x80\x02}r\xff\xff\xff\xffK\x01.",
    "bytes of an exabyte": b"\x80\x04}\x8c\x01a\x8e" + b"\xff" * 7 + b"\x00" + b"s.",
    "frame of an exabyte": b"\x80\x04\x95" + b"\xff" * 6 + b"\x0f\x00}.",
    "number of a million digits": b"I" + b"9" * 1_000_000 + b"\n.",
    "nested lists": b"\x80\x02}U\x01a" + b"]" * 100_000 + b"a" * 99_999 + b"s.",
    "variable of itself": b"\x80\x02}U\x01acchumpy.ch\nCh\n)\x81q\x01}U\x01xh\x01sbs.",
    "variables of variables": b"\x80\x02}U\x01a"
    + b"cchumpy.ch\nCh\n)\x81}U\x01x" * 50_000
    + b"K\x01"
    + b"sb" * 50_000
    + b"s.",
}


TWINS = b"K\x01" + b"2\x86" * 60
"""A tuple of a tuple of ... twice each: to print, to hash and to compare it takes 2^60 steps. As a key it does, and so
do many keys of one hash: see the page of formats."""
BOMBS |= {
    "nested tuples as a type": b"\x80\x02}U\x01acnumpy.core.multiarray\nscalar\ncnumpy\ndtype\n("
    + TWINS + b"K\x00K\x01tRU\x0812345678\x86Rs.",
    "nested tuples as the type of an array": array_pickle(b"K\x01\x85").replace(b"U\x02f8", TWINS),
    "nested tuples as an order": b"\x80\x02}U\x01acnumpy.core.numeric\n_frombuffer\n(U\x0812345678cnumpy\ndtype\n"
    + b"(U\x02f8K\x00K\x01tRK\x01\x85" + TWINS + b"tRs.",
    "number of ten thousand digits as a key": b"\x80\x02}\x8b\x70\x17\x00\x00" + b"\x01" * 6000 + b"K\x01s.",
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_claims_of_great_size_cost_nothing(name, tmp_path):
    import resource

    before, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    error_of(BOMBS[name], tmp_path)
    assert time.process_time() - started < 5
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB


def spoilt(**changes) -> dict:
    """Entries of a sparse matrix whose arrays do not fit together."""
    matrix = sp.csc_matrix(np.eye(3))
    vars(matrix).update(changes)
    return {"a": matrix}


@pytest.mark.parametrize(
    "entries",
    [
        spoilt(indices=np.array([0, 1, 7], np.int32)),
        spoilt(indices=np.array([0, 1, -1], np.int32)),
        spoilt(indptr=np.array([0, 2**31 - 1, 1, 3], np.int32)),
        spoilt(indptr=np.array([0, 1, 2, 2**30], np.int32)),
        spoilt(indptr=np.array([1, 1, 2, 3], np.int32)),
        spoilt(data=np.ones(2)),
        spoilt(_shape=(2**20, 2**20)),
        spoilt(_shape=(-3, -3)),
        spoilt(_shape=(3, 1)),
        spoilt(_shape=3),
        spoilt(data="abc"),
    ],
)
def test_sparse_matrices_that_do_not_fit_together_are_refused(entries, tmp_path):
    assert "expected 'a' to be an array of numbers" in error_of(pickle.dumps(entries, 2), tmp_path)


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_a_pickle_cut_short_anywhere_is_refused(protocol, tmp_path):
    data = pickletools.optimize(pickle.dumps({"a": DENSE, "b": ENTRIES["csc"]}, protocol))
    for end in range(0, len(data) - 1, 13):
        error_of(data[:end], tmp_path)


def test_an_object_array_of_an_archive_is_read(tmp_path):
    data = pickle.dumps(np.array([sp.csr_matrix(DENSE), None], object)[:1], 3)
    np.testing.assert_array_equal(array_of(read_pickle(data, tmp_path), "J", tmp_path), DENSE)
    with pytest.raises(InputError, match="system"):
        read_pickle(pickle.dumps(Reduced(os.system, "true")), tmp_path)


def test_no_module_is_imported(tmp_path):
    assert isinstance(sys.modules.get("this"), types.ModuleType | None)
    error_of(b"\x80\x02cthis\ns\n.", tmp_path)
    assert "this" not in sys.modules
