"""Types of glTF accessors and the sizes of their elements (glTF 2.0, 3.6.2)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError

COMPONENT_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy dtype of each `componentType` (3.6.2.2 Accessor Data Types); buffers are little endian."""
COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Components of an element of each accessor `type` (3.6.2.2)."""

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
"""Values of `bufferView.target`: vertex attributes and indices (5.11 Buffer View)."""


def element_size(accessor: dict[str, Any], index: int, path: Path) -> int:
    """Return the bytes of one element; columns of matrices start at multiples of 4 bytes (3.6.2.4 Data Alignment).

    Raises:
        InputError: the component type or the type is not one of glTF 2.0.
    """
    component, kind = accessor["componentType"], accessor["type"]
    if component not in COMPONENT_TYPES or kind not in COMPONENT_COUNTS:
        raise InputError(
            f"{path}: expected a glTF 2.0 type in accessor {index}, found {component} {kind}; export it again"
        )
    width = np.dtype(COMPONENT_TYPES[component]).itemsize
    if not kind.startswith("MAT"):
        return COMPONENT_COUNTS[kind] * width
    columns = int(kind[3])
    return columns * (-(-columns * width // 4) * 4)
