"""Keep what mime has found on a mesh in memory, for a process that has many jobs with the same meshes.

Predictions are functions of a network, its options and a mesh alone: an identity is read once for all its drivings, and
a driving without joints once for all identities. Nothing is kept unless `keep_results` was called, so that single runs
need no memory for it and time measurements measure the work.
"""

from __future__ import annotations

import functools
import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np

from ..core.mesh import Clip, Mesh

_switch = {"on": False}


def keep_results(on: bool = True) -> None:
    """Keep the results of decorated methods in this process from now on, or stop it."""
    _switch["on"] = on


def kept(most: int) -> Callable[[Callable], Callable]:
    """Decorate a method of a mesh or clip, whose last `most` results are kept while `keep_results` is on.

    The object's `kept_key` tells objects with different results apart.
    """

    def decorate(function: Callable) -> Callable:
        results: OrderedDict[Hashable, Any] = OrderedDict()

        @functools.wraps(function)
        def call(method: Any, shape: Mesh | Clip) -> Any:
            if not _switch["on"]:
                return function(method, shape)
            key = (method.kept_key, _digest(shape))
            if key in results:
                results.move_to_end(key)
                return results[key]
            result = function(method, shape)
            results[key] = result
            if len(results) > most:
                results.popitem(last=False)
            return result

        return call

    return decorate


def _digest(shape: Mesh | Clip) -> bytes:
    faces = shape.faces if isinstance(shape, Mesh) else shape.mesh.faces
    digest = hashlib.blake2b(digest_size=16)
    for array in (shape.vertices, faces):
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()
