"""Compares a rigged file with the file that `animate` wrote from it: the motion of its own clips, and all else.

Both files are read here byte by byte, without the reader of the tool, which could lose the same thing twice. Only
compressed files are compared as the tool decompresses them.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from mimesh.core.mesh import Clip
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.check import COMPRESSION_EXTENSIONS
from mimesh.io.gltf.document import open_document

SAME_MATRIX = 1e-6
"""Largest difference, over the largest entry, of a node's matrix from the translation, rotation and scale in place of
it: nodes that are animated must not have a matrix (glTF 2.0, 3.5.3)."""


@dataclass(frozen=True)
class RawFile:
    """The JSON of a .glb or .gltf file, and its buffers."""

    gltf: dict[str, Any]
    buffers: tuple[bytes, ...]

    def view(self, index: int) -> bytes:
        """Return the bytes of a buffer view."""
        view = self.gltf["bufferViews"][index]
        start = view.get("byteOffset", 0)
        return self.buffers[view["buffer"]][start : start + view["byteLength"]]


def playback_error(path: Path, animation: str | None, output: Path) -> float:
    """Compute the largest distance of a vertex in a written file from the file's own animation, over its size.

    Infinite if the written animation is shorter. `animation` None is a file without animations.
    """
    if animation is None:
        own, written = Clip.still(load_mesh(path)), Clip.still(load_mesh(output))
    else:
        own = load_clip(path, animation=animation)
        written = load_clip(output, fps=own.fps)
    if len(written) < len(own):
        return float("inf")
    size = float(np.ptp(own.vertices[0], axis=0).max())
    return max(float(np.abs(written.vertices[t] - own.vertices[t]).max()) for t in range(len(own))) / size


def is_compressed(path: Path) -> bool:
    """Return whether a .glb or .gltf has compressed vertices, which are written without compression."""
    return not COMPRESSION_EXTENSIONS.isdisjoint(_read_raw(path).gltf.get("extensionsUsed", []))


def lost_content(path: Path, output: Path) -> list[str]:
    """List what of a .glb or .gltf is not the same in a file written from it, apart from one animation, the first.

    The bytes of buffers are compared as a whole and by buffer view, images by their bytes. All else is the same if its
    JSON is.
    """
    source, written = _read_source(path), _read_raw(output)
    old, new = source.gltf, written.gltf
    lost = [] if _same_buffers(source, written) else ["buffers"]
    for key, value in old.items():
        if key == "bufferViews":
            same = all(_same_view(source, written, index) for index in range(len(value)))
        elif key == "nodes":
            same = len(new[key]) == len(value) and all(map(_same_node, value, new[key]))
        elif key == "images":
            same = len(new.get(key, [])) == len(value) and all(
                _image(source, image, path) in (_image(written, other, output), None)
                for image, other in zip(value, new[key], strict=True)
            )
        elif key == "animations":
            same = new.get(key, [])[1:] == value
        elif key == "accessors":
            same = new[key][: len(value)] == value
        else:
            same = key == "buffers" or (new.get(key) or None) == (value or None)  # empty lists are not written
        lost += [] if same else [key]
    return lost


@lru_cache(maxsize=1)
def _read_source(path: Path) -> RawFile:
    """Read a file without compression; the last one stays in memory, because decompression takes seconds."""
    if not is_compressed(path):
        return _read_raw(path)
    document = open_document(path)
    return RawFile(document.gltf, (bytes(document.binary),))


def _read_raw(path: Path) -> RawFile:
    content, binary = path.read_bytes(), b""
    if content[:4] == b"glTF":
        (length,) = struct.unpack_from("<I", content, 12)
        text, rest = content[20 : 20 + length], content[20 + length :]
        binary = rest[8 : 8 + struct.unpack_from("<I", rest)[0]] if rest else b""
    else:
        text = content
    gltf = json.loads(text)
    buffers = [
        _fetch(buffer["uri"], path) if "uri" in buffer else binary[: buffer["byteLength"]]
        for buffer in gltf.get("buffers", [])
    ]
    return RawFile(gltf, tuple(buffers))


def _fetch(uri: str, path: Path) -> bytes:
    """Read a data: URI, or a file beside the document; no bytes if there is none."""
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    file = path.parent / unquote(uri)
    return file.read_bytes() if file.is_file() else b""


def _same_buffers(source: RawFile, written: RawFile) -> bool:
    """Tell whether the one buffer of a written file begins with those of its source, aligned to 4 bytes."""
    start = 0
    for content in source.buffers:
        if not written.buffers or written.buffers[0][start : start + len(content)] != content:
            return False
        start += len(content) + -len(content) % 4
    return True


def _same_view(source: RawFile, written: RawFile, index: int) -> bool:
    old, new = source.gltf["bufferViews"][index], written.gltf["bufferViews"][index]
    rest = [{key: v for key, v in view.items() if key not in ("buffer", "byteOffset")} for view in (old, new)]
    return rest[0] == rest[1] and source.view(index) == written.view(index)


def _image(file: RawFile, image: dict[str, Any], path: Path) -> bytes | None:
    """Return the bytes of an image; None where its file does not exist."""
    content = file.view(image["bufferView"]) if "bufferView" in image else _fetch(image.get("uri", ""), path)
    return content or None


def _same_node(old: dict[str, Any], new: dict[str, Any]) -> bool:
    """Compare two nodes; a matrix may have become translation, rotation and scale."""
    if old == new:
        return True
    placed = ("matrix", "translation", "rotation", "scale")
    rest = [{key: value for key, value in node.items() if key not in placed} for node in (old, new)]
    if rest[0] != rest[1] or "matrix" not in old or "matrix" in new:
        return False
    from scipy.spatial.transform import Rotation

    before, after = np.array(old["matrix"], float).reshape(4, 4).T, np.eye(4)
    after[:3, :3] = Rotation.from_quat(new["rotation"]).as_matrix() * np.array(new["scale"])
    after[:3, 3] = new["translation"]
    return bool(np.abs(before - after).max() <= SAME_MATRIX * np.abs(before).max())
