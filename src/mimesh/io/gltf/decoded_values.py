"""Corrects decoded vertex data where lossy compression has broken rules of glTF that the compressed file kept.

Quantized weights no longer add up to 1, handedness is no longer 1 or -1, and positions leave the bounds that the JSON
states. Only values that break a rule are changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from .accessor_types import ARRAY_BUFFER, COMPONENT_COUNTS, COMPONENT_TYPES, ELEMENT_ARRAY_BUFFER

WEIGHT_TOLERANCE = 2e-7
"""Deviation of the sum of weights from 1 that the Khronos validator allows for each weight that is not 0."""


def correct_decoded(gltf: dict[str, Any], decoded: bytearray, views: set[int]) -> None:
    """Correct weights, tangents, bounds and buffer view targets, in the JSON and in the decoded data.

    Args:
        gltf: its lists of accessors and buffer views are its own; entries of the lists are replaced.
        decoded: the decoded data, which is changed.
        views: the buffer views of it, with offsets in it.
    """
    arrays = _Arrays(gltf, decoded, views)
    for primitive in _primitives(gltf):
        _correct_weights(arrays, primitive["attributes"])
        tangents = arrays.floats(primitive["attributes"].get("TANGENT"), 4)
        if tangents is not None:
            tangents[:, 3] = np.where(tangents[:, 3] < 0, -1.0, 1.0)
    for index, accessor in enumerate(gltf["accessors"]):
        values = arrays.get(index)
        if values is not None and len(values) and ("min" in accessor or "max" in accessor):
            bounds = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
            gltf["accessors"][index] = {**accessor, **{key: bounds[key] for key in bounds if key in accessor}}
    for view, target in _targets(gltf).items():
        if view in views:
            gltf["bufferViews"][view].setdefault("target", target)


class _Arrays:
    """Gives writable arrays of the accessors of decoded data."""

    def __init__(self, gltf: dict[str, Any], decoded: bytearray, views: set[int]) -> None:
        self.gltf = gltf
        self.decoded = decoded
        self.views = views

    def get(self, index: int) -> Shaped[np.ndarray, "N C"] | None:
        """Return the elements of an accessor; None if it is not decoded data, sparse, of matrices, or out of range."""
        accessor = self.gltf["accessors"][index]
        if accessor.get("bufferView") not in self.views or "sparse" in accessor or accessor["type"].startswith("MAT"):
            return None
        if accessor["componentType"] not in COMPONENT_TYPES or accessor["type"] not in COMPONENT_COUNTS:
            return None  # reported when the accessor is read, as a wrong range is
        view = self.gltf["bufferViews"][accessor["bufferView"]]
        dtype, columns = np.dtype(COMPONENT_TYPES[accessor["componentType"]]), COMPONENT_COUNTS[accessor["type"]]
        offset, stride = accessor.get("byteOffset", 0), view.get("byteStride") or columns * dtype.itemsize
        end = offset + (accessor["count"] - 1) * stride + columns * dtype.itemsize
        if end > view["byteLength"] or accessor["count"] < 1:
            return None
        start = view["byteOffset"] + offset
        shape, strides = (accessor["count"], columns), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, self.decoded, start, strides)

    def floats(self, index: int | None, columns: int) -> Float[np.ndarray, "N C"] | None:
        """Return the elements of an accessor of so many floats; None if it is none."""
        values = None if index is None else self.get(index)
        return values if values is not None and values.dtype == np.float32 and values.shape[1] == columns else None


def _primitives(gltf: dict[str, Any]) -> Iterator[dict[str, Any]]:
    return (primitive for mesh in gltf.get("meshes", []) for primitive in mesh["primitives"])


def _correct_weights(arrays: _Arrays, attributes: dict[str, int]) -> None:
    """Divide the weights of each vertex by their sum where that is not 1; the joints of weights of 0 become 0.

    Weights that are integers are coded without loss.
    """
    count = sum(name.startswith("WEIGHTS_") for name in attributes)
    found = (arrays.floats(attributes.get(f"WEIGHTS_{number}"), 4) for number in range(count))
    sets = [weights for weights in found if weights is not None]
    if not sets or len(sets) < count or len({len(weights) for weights in sets}) > 1:
        return
    weights = np.maximum(np.concatenate(sets, axis=1).astype(np.float64), 0.0)
    total = weights.sum(axis=1, keepdims=True)
    wrong = np.abs(total - 1.0) > WEIGHT_TOLERANCE * (weights > 0).sum(axis=1, keepdims=True)
    weights = np.where(wrong & (total > 0), weights / np.where(total > 0, total, 1.0), weights)
    for number, stored in enumerate(sets):
        stored[:] = weights[:, 4 * number : 4 * number + 4]
        joints = arrays.get(attributes[f"JOINTS_{number}"]) if f"JOINTS_{number}" in attributes else None
        if joints is not None and joints.shape == stored.shape:
            joints[stored == 0] = 0


def _targets(gltf: dict[str, Any]) -> dict[int, int]:
    """Return the target of each buffer view that only vertex attributes, or only indices, lie in."""
    found: dict[int, set[int]] = {}
    for primitive in _primitives(gltf):
        attributes = [
            index for owner in (primitive["attributes"], *primitive.get("targets", [])) for index in owner.values()
        ]
        used = [(index, ARRAY_BUFFER) for index in attributes]
        used += [(primitive["indices"], ELEMENT_ARRAY_BUFFER)] if "indices" in primitive else []
        for index, target in used:
            if "bufferView" in gltf["accessors"][index]:
                found.setdefault(gltf["accessors"][index]["bufferView"], set()).add(target)
    return {view: targets.pop() for view, targets in found.items() if len(targets) == 1}
