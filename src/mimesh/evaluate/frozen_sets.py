"""Checksums of test sets."""

from __future__ import annotations

import hashlib

import numpy as np

from .pairs import Pair


def pair_checksum(pair: Pair) -> str:
    """Return the first 8 hex digits of a checksum of a pair."""
    rounded = [np.round(v * 1e5).astype(np.int64) for v in (pair.identity.vertices, pair.driving.vertices, pair.truth)]
    arrays = [*rounded, pair.identity.faces, pair.driving.faces]
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:8]
