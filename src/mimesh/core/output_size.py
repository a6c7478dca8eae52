"""Sizes of outputs: estimated before the work, and limited where a caller asks for it (the command line does)."""

from __future__ import annotations

from contextvars import ContextVar
from pathlib import Path

from .errors import InputError

LARGEST_OUTPUT = 100e6
"""Bytes of an output that the command line does not write without --large."""
TOLD_OUTPUT = 25e6
"""Bytes from which on the expected size is told before the work."""
_limited: ContextVar[bool] = ContextVar("mimesh outputs limited", default=False)
FRAME_BYTES = {".glb": 24, ".gltf": 32, ".fbx": 24, ".npz": 11, ".usda": 37, ".ply": 38, ".obj": 93}
"""Suffix -> bytes of a vertex in a frame of a clip, measured on 20 and 40 frames of the shipped body
(docs/log/formats.md): .glb has normals, .gltf is text in base 64, .ply and .obj have the triangles in every frame. That
of .fbx was not measured."""
POINT_BYTES = 12
"""The same of formats that store the points alone, in single precision: .pc2 .usdc .usdz."""


def limit_outputs(limited: bool) -> None:
    """Limit the outputs of the current context to LARGEST_OUTPUT, or lift the limit."""
    _limited.set(limited)


def frames_size(suffix: str, vertices: int, frames: int) -> int:
    """Estimate the bytes of a clip that is written frame by frame; for a folder give the suffix of its meshes."""
    return FRAME_BYTES.get(suffix.lower(), POINT_BYTES) * vertices * frames


def check_output_size(size: int, path: str | Path, advice: str, estimated: bool = True) -> None:
    """Check the size (bytes) of an output where outputs are limited.

    Raises:
        InputError: it is larger than LARGEST_OUTPUT; the message has `advice`.
    """
    if size > LARGEST_OUTPUT and _limited.get():
        raise InputError(
            f"{path}: expected an output of at most {LARGEST_OUTPUT / 1e6:.0f} MB, found {'about ' * estimated}"
            f"{size / 1e6:,.0f} MB to write; {advice}, or add --large"
        )
