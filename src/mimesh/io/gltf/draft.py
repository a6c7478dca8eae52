"""A glTF document while it is written: JSON that grows, byte chunks that are never joined, and saving both."""

from __future__ import annotations

import base64
import copy
import io
import json
import shutil
import struct
import tempfile
import weakref
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from .check import is_supported
from .document import BINARY_CHUNK, JSON_CHUNK, Document, element_bytes, image_type

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
ACCESSOR_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


ENCODE_BLOCK = 3 * 2**20
"""Bytes that are encoded at once; a multiple of three."""
BUFFER_MARK = "\ue000buffer\ue000"
"""Where the buffer goes in the text of a .gltf; these characters are for private use."""


class Spool:
    """Arrays of one shape, one after the other on disk: a clip's frames on their way into a file, never in memory."""

    def __init__(self) -> None:
        self.file = tempfile.TemporaryFile()  # noqa: SIM115 (closed with this)
        weakref.finalize(self, self.file.close)
        self.nbytes = 0
        self.bounds: list[dict[str, list[float]]] = []
        """`min` and `max` of each array."""

    def append(self, values: Float[np.ndarray, "N C"]) -> None:
        """Write one more array, as float32."""
        values = np.ascontiguousarray(values, "<f4")
        self.bounds.append(accessor_bounds(values))
        self.nbytes += self.file.write(values.data)

    def copy_to(self, file: io.BufferedIOBase) -> None:
        """Write all arrays into a file."""
        self.file.seek(0)
        shutil.copyfileobj(self.file, file)


class Draft:
    """JSON and byte chunks of a file to be; accessors and views are only ever appended."""

    def __init__(self, gltf: dict[str, Any]) -> None:
        self.gltf: dict[str, Any] = {**gltf, "accessors": [], "bufferViews": [], "buffers": []}
        self.chunks: list[memoryview | Spool] = []
        self.size = 0

    def add_view(self, content: bytes | memoryview | np.ndarray | Spool, **properties: int | None) -> int:
        """Append bytes, an array (not copied) or a spool, and a buffer view of them; each starts at a multiple of 4."""
        chunk = content if isinstance(content, Spool) else _as_bytes(content)
        given = {name: value for name, value in properties.items() if value is not None}
        self.gltf["bufferViews"].append({"buffer": 0, "byteOffset": self.size, "byteLength": chunk.nbytes, **given})
        self.chunks += [chunk, memoryview(bytes(-chunk.nbytes % 4))]
        self.size += chunk.nbytes + -chunk.nbytes % 4
        return len(self.gltf["bufferViews"]) - 1

    def add_accessor(self, accessor: dict[str, Any]) -> int:
        """Append an accessor as it is."""
        self.gltf["accessors"].append(accessor)
        return len(self.gltf["accessors"]) - 1

    def add_floats(self, values: Float[np.ndarray, "N C"], target: int | None = None, bounds: bool = False) -> int:
        """Append an accessor of float32 values, with `min` and `max` if asked (a must for positions and times)."""
        values = np.asarray(values, "<f4")
        view = self.add_view(values, target=target)
        accessor = {
            "bufferView": view,
            "componentType": 5126,
            "count": len(values),
            "type": ACCESSOR_TYPES[values.shape[1]],
        }
        return self.add_accessor({**accessor, **(accessor_bounds(values) if bounds else {})})

    def add_indices(self, indices: np.ndarray) -> int:
        """Append an index accessor, 16 bits wide where that is enough (65535 itself is not an index in glTF)."""
        small = indices.max(initial=0) < 65535
        view = self.add_view(indices.astype("<u2" if small else "<u4").ravel(), target=ELEMENT_ARRAY_BUFFER)
        kind = {"componentType": 5123 if small else 5125, "count": indices.size, "type": "SCALAR"}
        return self.add_accessor({"bufferView": view, **kind})

    def save(self, path: Path) -> None:
        """Write a .gltf with the buffer inside as base64, or a .glb for any other suffix."""
        gltf = {**self.gltf, "buffers": [{"byteLength": self.size}] if self.size else []}
        if path.suffix.lower() == ".gltf":
            self._save_text(gltf, path)
            return
        text = _to_json(gltf)
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + (8 + self.size if self.size else 0)
        with path.open("wb") as file:
            file.write(struct.pack("<4sIIII", b"glTF", 2, total, len(text), JSON_CHUNK) + text)
            if self.size:
                file.write(struct.pack("<II", self.size, BINARY_CHUNK))
                self._write(file)

    def _save_text(self, gltf: dict[str, Any], path: Path) -> None:
        """Write JSON with the buffer in it, piece by piece."""
        for buffer in gltf["buffers"]:
            buffer["uri"] = f"data:application/octet-stream;base64,{BUFFER_MARK}"
        head, _, tail = _to_json(gltf).partition(BUFFER_MARK.encode())
        with path.open("wb") as file, tempfile.TemporaryFile() as whole:
            file.write(head)
            if self.size:
                self._write(whole)
                whole.seek(0)
            while piece := whole.read(ENCODE_BLOCK):
                file.write(base64.b64encode(piece))
            file.write(tail)

    def _write(self, file: io.BufferedIOBase) -> None:
        for chunk in self.chunks:
            if isinstance(chunk, Spool):
                chunk.copy_to(file)
            else:
                file.write(chunk)


class AccessorCopier:
    """Takes accessors of an opened document over into a draft, each once, and nothing that is not asked for.

    A file with an extension we do not know may point at accessors and views from places we do not know either: there,
    everything is taken over under its old number, and the parts that are replaced stay behind as dead weight.
    """

    def __init__(self, document: Document) -> None:
        self.document = document
        gltf = copy.deepcopy(document.gltf)
        self.draft = Draft(gltf)
        self.copies_all = not all(is_supported(name) for name in gltf.get("extensionsUsed", []))
        self.moved: dict[int, int] = {}
        if self.copies_all:
            self.draft.add_view(document.binary)
            self.draft.gltf |= {"bufferViews": gltf["bufferViews"], "accessors": gltf.get("accessors", [])}
        self._copy_images()

    def copy_accessor(self, index: int, target: int | None = ARRAY_BUFFER) -> int:
        """The number in the draft of an accessor of the document; vertex data gets its elements at multiples of 4."""
        if self.copies_all:
            return index
        if index not in self.moved:
            self.moved[index] = self._copy(index, target)
        return self.moved[index]

    def _copy(self, index: int, target: int | None) -> int:
        accessor = self.document.gltf["accessors"][index]
        kept = {key: value for key, value in accessor.items() if key not in ("bufferView", "byteOffset", "sparse")}
        if "bufferView" not in accessor and "sparse" not in accessor:
            return self.draft.add_accessor(kept)
        rows = element_bytes(self.document, index)
        padding = -rows.shape[1] % 4 if target == ARRAY_BUFFER else 0
        rows = np.pad(rows, ((0, 0), (0, padding)))
        view = self.draft.add_view(rows, target=target, byteStride=rows.shape[1] if padding else None)
        return self.draft.add_accessor({"bufferView": view, **kept})

    def _copy_images(self) -> None:
        """Images move into the buffer, from files beside the document and from data: URIs too."""
        images = []
        for image, content in zip(self.document.gltf.get("images", []), self.document.images, strict=True):
            if content is None or (self.copies_all and "bufferView" in image):
                images.append(image)
                continue
            kept = {key: value for key, value in image.items() if key != "uri"}
            mime = image.get("mimeType") or image_type(content) or "image/png"
            images.append({**kept, "mimeType": mime, "bufferView": self.draft.add_view(content)})
        if images:
            self.draft.gltf["images"] = images


def _as_bytes(content: bytes | memoryview | np.ndarray) -> memoryview:
    chunk = np.ascontiguousarray(content).data if isinstance(content, np.ndarray) else memoryview(content)
    return chunk.cast("B") if chunk.nbytes else memoryview(b"")


def accessor_bounds(values: Float[np.ndarray, "N C"]) -> dict[str, list[float]]:
    """`min` and `max` of an accessor, exactly as its float32 values are."""
    if not len(values):
        return {}
    return {"min": values.min(axis=0).astype(float).tolist(), "max": values.max(axis=0).astype(float).tolist()}


def _to_json(gltf: dict[str, Any]) -> bytes:
    """Compact JSON; top-level lists that ended up empty are left out, as glTF forbids them."""
    kept = {key: value for key, value in gltf.items() if value != []}
    return json.dumps(kept, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()
