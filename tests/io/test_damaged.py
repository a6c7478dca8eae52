"""Damaged files of native libraries give a mesh, a clip or one line, within limits, and this process goes on."""

from __future__ import annotations

import importlib.util
import resource
from pathlib import Path

import numpy as np
import pytest
from zoo import grid

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import load_clip, save_clip

SUFFIXES = {".usda": "pxr", ".usdc": "pxr", ".usdz": "pxr", ".abc": "alembic3d"}
"""Formats, and the library of each."""
SECONDS = 10
MEMORY = 2 * 2**30
"""Bytes of resident memory."""


def sound_file(path: Path) -> bytes:
    """Write a clip of six frames with a material, and return the bytes of the file."""
    mesh = grid(6)
    part = Part("cloth", 0, len(mesh.faces), Material("red wool", (1.0, 0.0, 0.0, 1.0)))
    noise = np.random.default_rng(0).normal(0.0, 0.01, (6, *mesh.vertices.shape))
    save_clip(Clip(mesh.__class__(mesh.vertices, mesh.faces, parts=(part,)), mesh.vertices + noise, 24.0), path)
    return path.read_bytes()


def mutated(content: bytes, seed: int) -> bytes:
    """Damage a file: some bytes changed, a run of equal bytes, a part cut out, or the end cut off."""
    rng, data = np.random.default_rng(seed), bytearray(content)
    kind = seed % 4
    start = int(rng.integers(len(data)))
    length = int(rng.integers(1, 64))
    if kind == 0:
        for place in rng.integers(len(data), size=rng.integers(1, 9)).tolist():
            data[place] ^= int(rng.integers(1, 256))
    elif kind == 1:
        data[start : start + length] = bytes([int(rng.choice([0, 0x7F, 0xFF]))]) * length
    elif kind == 2:
        del data[start : start + length]
    else:
        del data[start:]
    return bytes(data)


def outcome(path: Path) -> str:
    """Read a file within the limits; returns what was found. Other exceptions than InputError fail the test."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        clip = load_clip(path)
        assert np.isfinite(clip.vertices).all()
        found = "clip"
    except InputError as error:
        found = str(error)
        assert "\n" not in found
        assert str(path) in found
        assert len(found) < 2000
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < SECONDS
    assert after.ru_maxrss * 1024 < MEMORY  # of the largest child so far
    return found
