"""Builds and saves glTF documents: a `Draft` collects JSON and byte chunks, which are never joined in memory."""

from __future__ import annotations

import base64
import copy
import io
import json
import shutil
import struct
import tempfile
import weakref
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Integer

from ...core.errors import InputError
from ..mtl import image_type
from .check import ARRAY_BUFFER, COMPONENT_TYPES, ELEMENT_ARRAY_BUFFER, is_supported
from .document import BINARY_CHUNK, JSON_CHUNK, Document, element_bytes, uri_file_name

ACCESSOR_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
"""Accessor `type` by number of components."""
PER_SET = 4
"""Joints and weights in each of JOINTS_n and WEIGHTS_n, which are always VEC4 (3.7.3.3 Skinned Mesh Attributes)."""
LARGEST_GLB = 2**32 - 1
"""Largest number of bytes that the header of a GLB file can state (4.4.2 Header)."""
ENCODE_BLOCK = 3 * 2**20
"""Bytes that are base64-encoded at once; a multiple of three, so that only the last block is padded."""
BUFFER_MARK = "\ue000buffer\ue000"
"""Stands for the base64 buffer in the JSON of a .gltf while it is serialized; U+E000 is a private-use character."""


class Spool:
    """Arrays of one shape in a temporary file, one after the other: a clip's frames need no memory while they wait."""

    def __init__(self) -> None:
        self.file = tempfile.TemporaryFile()  # noqa: SIM115 (closed together with this object)
        weakref.finalize(self, self.file.close)
        self.nbytes = 0
        """Bytes of all arrays together."""
        self.bounds: list[dict[str, list[float]]] = []
        """Accessor properties `min` and `max` of each array."""

    def append(self, values: Float[np.ndarray, "N C"]) -> None:
        """Append an array, as float32."""
        values = _as_float32(values)
        self.bounds.append(accessor_bounds(values))
        self.nbytes += self.file.write(values.data)


class Draft:
    """A glTF document under construction: its JSON and the chunks of its one buffer. Entries are only appended."""

    def __init__(self, gltf: dict[str, Any]) -> None:
        self.gltf: dict[str, Any] = {**gltf, "accessors": [], "bufferViews": [], "buffers": []}
        self.chunks: list[memoryview | Spool] = []
        """Contents of the buffer views, each followed by its padding."""
        self.size = 0
        """Bytes of all chunks."""

    def add_view(self, content: bytes | memoryview | np.ndarray | Spool, **properties: int | None) -> int:
        """Append bytes, an array (not copied) or a spool, and a buffer view of them; returns the index of the view.

        Views start at multiples of 4 bytes (glTF 2.0, 3.6.2.4 Data Alignment). `properties` that are None are left out.
        """
        chunk = content
        if not isinstance(chunk, Spool):  # a view of the bytes, without a copy where they are contiguous
            chunk = np.ascontiguousarray(chunk).data if isinstance(chunk, np.ndarray) else memoryview(chunk)
            chunk = chunk.cast("B") if chunk.nbytes else memoryview(b"")
        present = {name: value for name, value in properties.items() if value is not None}
        self.gltf["bufferViews"].append({"buffer": 0, "byteOffset": self.size, "byteLength": chunk.nbytes, **present})
        # The chunk itself is written when the document is saved.
        self.chunks += [chunk, memoryview(bytes(-chunk.nbytes % 4))]
        self.size += chunk.nbytes + -chunk.nbytes % 4
        return len(self.gltf["bufferViews"]) - 1

    def add_accessor(self, accessor: dict[str, Any]) -> int:
        """Append an accessor as it is; returns its index."""
        self.gltf["accessors"].append(accessor)
        return len(self.gltf["accessors"]) - 1

    def add_array(self, values: np.ndarray, kind: str, target: int | None = None, **more: Any) -> int:
        """Append an accessor of the type `kind` with the values of an array, in its own type; returns its index."""
        view = self.add_view(values, target=target)
        component = next(number for number, dtype in COMPONENT_TYPES.items() if values.dtype == dtype)
        accessor = {"bufferView": view, "componentType": component, "count": len(values), "type": kind}
        return self.add_accessor(accessor | more)

    def add_floats(self, values: Float[np.ndarray, "N C"], target: int | None = None, bounds: bool = False) -> int:
        """Append an accessor of float32 values; returns its index.

        `bounds` adds `min` and `max`, which positions and animation times must have (3.6.2.5 Accessors Bounds).
        """
        values = _as_float32(values)
        return self.add_array(
            values, ACCESSOR_TYPES[values.shape[1]], target, **(accessor_bounds(values) if bounds else {})
        )

    def add_matrices(self, matrices: Float[np.ndarray, "J 4 4"]) -> int:
        """Append an accessor of affine transforms, as the inverse bind matrices of a skin; returns its index."""
        matrices = matrices.copy()
        matrices[:, 3] = [0, 0, 0, 1]  # exactly, as 3.7.3.1 demands, in spite of rounding
        return self.add_array(matrices.swapaxes(-1, -2).astype("<f4"), "MAT4")  # column-major (3.6.2.4)

    def add_influences(self, joints: Integer[np.ndarray, "N K"], weights: Float[np.ndarray, "N K"]) -> dict[str, int]:
        """Append the joints, in their own type, and the weights of vertices in sets JOINTS_n and WEIGHTS_n.

        Returns:
            The accessors by attribute name.
        """
        attributes = {}
        for number in range(joints.shape[1] // PER_SET):
            columns = slice(number * PER_SET, (number + 1) * PER_SET)
            attributes[f"JOINTS_{number}"] = self.add_array(joints[:, columns], "VEC4", ARRAY_BUFFER)
            attributes[f"WEIGHTS_{number}"] = self.add_floats(weights[:, columns], ARRAY_BUFFER)
        return attributes

    def add_indices(self, indices: np.ndarray) -> int:
        """Append an index accessor, 16 bits wide where that is enough; returns its index.

        The largest value of a component type, 65535, is not allowed as an index (3.7.2.1).
        """
        small = indices.max(initial=0) < 65535
        return self.add_array(indices.astype("<u2" if small else "<u4").ravel(), "SCALAR", ELEMENT_ARRAY_BUFFER)

    def save(self, path: Path) -> None:
        """Write a .gltf with the buffer as a base64 data: URI; for any other suffix a .glb (4.4 Binary glTF Layout).

        Raises:
            InputError: a .glb of 4 GiB or more.
        """
        gltf = {**self.gltf, "buffers": [{"byteLength": self.size}] if self.size else []}
        if path.suffix.lower() == ".gltf":
            self._save_text(gltf, path)
            return
        text = _to_json(gltf)
        text += b" " * (-len(text) % 4)  # the JSON chunk is padded with spaces (4.4.3.2)
        # A header of 12 bytes and two chunks with headers of 8 bytes; an empty binary chunk is left out.
        total = 12 + 8 + len(text) + (8 + self.size if self.size else 0)
        if total > LARGEST_GLB:
            raise InputError(
                f"{path}: expected less than 4 GiB in a .glb, found {total:,} bytes; write a .gltf, or fewer frames"
            )
        with path.open("wb") as file:
            file.write(struct.pack("<4sIIII", b"glTF", 2, total, len(text), JSON_CHUNK) + text)
            if self.size:
                file.write(struct.pack("<II", self.size, BINARY_CHUNK))
                self._write(file)

    def _save_text(self, gltf: dict[str, Any], path: Path) -> None:
        """Write the JSON with the buffer as base64 in the place of `BUFFER_MARK`, block by block."""
        for buffer in gltf["buffers"]:
            buffer["uri"] = f"data:application/octet-stream;base64,{BUFFER_MARK}"
        head, _, tail = _to_json(gltf).partition(BUFFER_MARK.encode())
        # Chunks have any length, base64 needs multiples of three bytes: join the chunks on disk first.
        with path.open("wb") as file, tempfile.TemporaryFile() as joined:
            file.write(head)
            if self.size:
                self._write(joined)
                joined.seek(0)
            while block := joined.read(ENCODE_BLOCK):
                file.write(base64.b64encode(block))
            file.write(tail)

    def _write(self, file: io.BufferedIOBase) -> None:
        for chunk in self.chunks:
            if isinstance(chunk, Spool):
                chunk.file.seek(0)
                shutil.copyfileobj(chunk.file, file)
            else:
                file.write(chunk)


class AccessorCopier:
    """Copies accessors of an opened document into a new draft, each at most once.

    Extensions that are not supported may refer to accessors and buffer views in unknown places. A document that uses
    one is copied as a whole, with all indices unchanged; data that is replaced then stays in the file unused. `whole`
    does that with any document.
    """

    def __init__(self, document: Document, whole: bool = False) -> None:
        self.document = document
        gltf = copy.deepcopy(document.gltf)
        self.draft = Draft(gltf)
        self.copies_all = whole or not all(is_supported(name) for name in gltf.get("extensionsUsed", []))
        self.new_index: dict[int, int] = {}
        """Index in the draft of each copied accessor."""
        if self.copies_all:
            self.draft.add_view(document.binary)
            self.draft.gltf |= {"bufferViews": gltf["bufferViews"], "accessors": gltf.get("accessors", [])}
        self._copy_images()

    def copy_accessor(self, index: int, target: int | None = ARRAY_BUFFER) -> int:
        """Copy an accessor with its data, unless that is done already; returns its index in the draft.

        Elements of vertex attributes are padded to multiples of 4 bytes (3.6.2.4 Data Alignment).
        """
        if self.copies_all:
            return index
        if index not in self.new_index:
            accessor, not_copied = self.document.gltf["accessors"][index], ("bufferView", "byteOffset", "sparse")
            properties = {key: value for key, value in accessor.items() if key not in not_copied}
            if "bufferView" in accessor or "sparse" in accessor:
                rows = element_bytes(self.document, index)
                padding = -rows.shape[1] % 4 if target == ARRAY_BUFFER else 0
                rows = np.pad(rows, ((0, 0), (0, padding)))
                view = self.draft.add_view(rows, target=target, byteStride=rows.shape[1] if padding else None)
                properties = {"bufferView": view, **properties}
            self.new_index[index] = self.draft.add_accessor(properties)
        return self.new_index[index]

    def _copy_images(self) -> None:
        """Copy all images into the buffer, those of files beside the document and of data: URIs too."""
        images = []
        for image, content in zip(self.document.gltf.get("images", []), self.document.images, strict=True):
            if content is None or (self.copies_all and "bufferView" in image):
                images.append(image)
                continue
            properties = {key: value for key, value in image.items() if key != "uri"}
            if file := uri_file_name(image):
                properties.setdefault("name", PurePosixPath(file).stem)
            mime = image.get("mimeType") or image_type(content) or "image/png"
            images.append({**properties, "mimeType": mime, "bufferView": self.draft.add_view(content)})
        if images:
            self.draft.gltf["images"] = images


class NumberTooLarge(InputError):
    """A number that glTF has no type for."""


def _as_float32(values: Float[np.ndarray, "N C"]) -> Float32[np.ndarray, "N C"]:
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(values, "<f4")
    if not np.isfinite(stored).all():
        raise NumberTooLarge(
            "glTF: expected numbers up to 3.4e38, the largest of its type, found larger ones in the frame of a node; "
            "write another format, or scale the mesh"
        )
    return stored


def accessor_bounds(values: Float[np.ndarray, "N C"]) -> dict[str, list[float]]:
    """Return the properties `min` and `max` of an accessor; they must equal its float32 values (3.6.2.5)."""
    if not len(values):
        return {}
    return {"min": values.min(axis=0).astype(float).tolist(), "max": values.max(axis=0).astype(float).tolist()}


def _to_json(gltf: dict[str, Any]) -> bytes:
    """Serialize to compact JSON without empty top-level lists, which the glTF JSON schema does not allow."""
    without_empty = {key: value for key, value in gltf.items() if value != []}
    return json.dumps(without_empty, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode(
        "utf-8", "replace"
    )
