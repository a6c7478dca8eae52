"""Access to the objects of the library ufbx: lists, arrays and matrices, with the references that it forgets to count.

ufbx 0.0.5 returns an element or an exported buffer a second time without counting the new reference, so Python frees
objects that are still in use (a crash). Every object that is read from the library therefore gets references that are
never given back. They end with the process: this runs in a child process that reads one file.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from jaxtyping import Float

_add_reference = ctypes.pythonapi.Py_IncRef
_add_reference.argtypes = [ctypes.py_object]


def own(element: Any) -> Any:
    """Return an object of the library that may be used until the process ends; None stays None."""
    if element is not None:
        # One reference for the library's cache of objects, one for the caller.
        _add_reference(element)
        _add_reference(element)
    return element


def items(elements: Any) -> list[Any]:
    """Return all objects of a list of the library."""
    own(elements)
    return [own(elements[i]) for i in range(len(elements))]


def array(values: Any, columns: int | None = None) -> np.ndarray:
    """Copy a list of numbers, or of vectors with `columns` components, into an array."""
    own(values)
    try:
        result = np.array(memoryview(values))
    except TypeError:  # some lists export no buffer
        result = np.array(values)
    return result if columns is None else result.reshape(-1, columns)


def matrix(columns: Any) -> Float[np.ndarray, "4 4"]:
    """Return an affine matrix of the library, which has four columns of three numbers."""
    result = np.eye(4)
    result[:3] = np.array([tuple(column) for column in columns]).T
    return result
