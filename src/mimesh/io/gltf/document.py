"""Opens glTF 2.0 files: the JSON and the buffers of a .glb or .gltf, and the arrays (accessors) inside them.

All buffers, embedded or in files beside it, are joined into one on opening, so that a `Document` needs no other file.
Large binary files are memory-mapped: they take only the memory of the pages that are being read. Numbers in comments
are sections of the glTF 2.0 specification.
"""

from __future__ import annotations

import base64
import json
import mmap
import struct
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from ...core.budgets import EMPTY, JOINED, UNPACKED
from ...core.errors import InputError, damaged
from ...core.frame_buffer import LARGE
from ..beside import find_beside
from ..fbx import fbx_as_glb
from .check import (
    COMPONENT_TYPES,
    COMPRESSION_EXTENSIONS,
    DRACO,
    INDEX_TYPES,
    MESHOPT,
    attribute_accessors,
    check_document,
    check_sizes,
    element_size,
    list_primitives,
)
from .compression import compressed_views, decompress, is_fallback, missing_decoders, need_decoders

JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
"""Chunk types of a GLB file (4.4.3 Chunks): "JSON" and "BIN"."""
NO_INDEX = ("scene", "mesh", "skin", "skeleton", "camera", "material", "indices")
"""Optional indices that exporters write as -1 where there is none."""
IMAGE_TYPES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp", b"\xabKTX": "image/ktx2"}
"""MIME type by the first bytes of an image: PNG and JPEG (3.8.3 Images), WebP and KTX2 through extensions."""


@dataclass(frozen=True, eq=False)
class Document:
    """An open glTF file: its JSON, whose buffer views all point into `binary`, and the contents of its images."""

    path: Path
    gltf: dict[str, Any] = field(repr=False)
    binary: bytes | memoryview = field(repr=False)
    """All buffers, joined: bytes in memory, or a memory-mapped file where they are large."""
    images: tuple[bytes | None, ...] = field(repr=False)
    """Content of each image; None where its file does not exist or is not an image."""
    mapped_files: MappedFiles = field(repr=False)


def open_document(path: Path) -> Document:
    """Read and check a .glb, .vrm or .gltf file with all buffers and images it refers to; an .fbx file is converted.

    Raises:
        InputError: the file is truncated, inconsistent, not glTF 2.0, or requires an extension that is not supported.
    """
    files = MappedFiles(path)
    if path.suffix.lower() == ".fbx":
        with fbx_as_glb(path) as glb:
            content = files.read(glb)
    else:
        content = files.read(path)
    gltf, chunk = _read_json(content, path)
    check_document(gltf, path)
    compressed = compressed_views(gltf, path)
    gltf, binary = _join_buffers(gltf, chunk, files)
    gltf, binary = decompress(gltf, binary, compressed, path)
    gltf = _drop_compression(gltf)
    check_sizes(gltf, len(binary), path)
    images = _read_images(gltf, binary, files)
    document = Document(path, gltf, binary, images, files)
    # Damaged accessors of primitives and skins are reported on reading, not later on writing; those of animations when
    # an animation is read.
    used = {skin["inverseBindMatrices"] for skin in gltf.get("skins", []) if "inverseBindMatrices" in skin}
    for primitive in list_primitives(gltf):
        used.update(attribute_accessors(primitive), [primitive["indices"]] if "indices" in primitive else [])
    for index in sorted(used):
        element_bytes(document, index)
    return document


def check_decoders(path: Path) -> None:
    """Check that what decodes the compressed data of a .glb, .vrm or .gltf file is installed; damaged files pass.

    Raises:
        NotInstalledError: it is not.
    """
    if not missing_decoders():
        return
    try:
        gltf, _ = _read_json(MappedFiles(path).read(path), path)
    except (InputError, OSError):
        return
    required = gltf.get("extensionsRequired") if isinstance(gltf, dict) else None
    names = {str(name) for name in required} if isinstance(required, list) else set()
    need_decoders(["draco"] * (DRACO in names) + ["meshopt"] * bool(names.intersection(MESHOPT)), path)


def element_bytes(document: Document, index: int) -> UInt8[np.ndarray, "N S"]:
    """Return the bytes of each element of an accessor, one element a row, without strides and with sparse values.

    Raises:
        InputError: the accessor has an unknown type, reaches beyond its buffer view, or is large without having one
            (it then stands for zeros).
    """
    accessor = document.gltf["accessors"][index]
    count, size = accessor["count"], element_size(accessor, index, document.path)
    if "bufferView" in accessor:
        rows = _read_rows(document, accessor, count, size, f"accessor {index}")
    else:
        EMPTY.check(count, document.path)
        rows = np.zeros((count, size), np.uint8)
    if "sparse" not in accessor:
        return rows
    # Sparse values replace elements of the dense array, or of zeros where there is none (3.6.2.3 Sparse Accessors).
    sparse, rows = accessor["sparse"], rows.copy()
    indices = _read_sparse_indices(document, sparse, index, count)
    rows[indices] = _read_rows(document, sparse["values"], len(indices), size, f"sparse accessor {index}")
    return rows


def read_accessor(document: Document, index: int) -> Shaped[np.ndarray, "N C"]:
    """Return the values of an accessor as stored, one element a row, with the padding of small integer matrices."""
    rows = np.ascontiguousarray(element_bytes(document, index))
    dtype = np.dtype(COMPONENT_TYPES[document.gltf["accessors"][index]["componentType"]])
    return rows.view(dtype).reshape(len(rows), rows.shape[1] // dtype.itemsize)


def read_floats(document: Document, index: int) -> Float[np.ndarray, "N C"]:
    """Return the values of an accessor in float64; normalized integers are scaled to -1..1 or 0..1."""
    values = read_accessor(document, index)
    if not document.gltf["accessors"][index].get("normalized") or values.dtype.kind == "f":
        with np.errstate(invalid="ignore"):  # of signalling NaN in damaged files; what must be finite is checked later
            return values.astype(np.float64)
    # 3.11 Animations, equations for normalized integers: f = max(c / 127.0, -1.0) and likewise for other widths.
    return np.maximum(values / np.iinfo(values.dtype).max, -1.0)


def image_type(content: bytes) -> str | None:
    """Return the MIME type of an image from its first bytes; None where no glTF image starts like this."""
    return next((mime for magic, mime in IMAGE_TYPES.items() if content.startswith(magic)), None)


def uri_file_name(entry: dict[str, Any]) -> str:
    """Return the name, without folders, of the file that an image or buffer is in; an empty string for none."""
    uri = entry.get("uri", "")
    return "" if uri.startswith("data:") else PurePosixPath(unquote(uri).replace("\\", "/")).name


class MappedFiles:
    """The files of one document, memory-mapped from `frame_buffer.LARGE` bytes on."""

    def __init__(self, document: Path) -> None:
        self.document = document
        self.maps: list[mmap.mmap] = []
        """All maps, for `release_pages`; each lives as long as a view of it."""

    def release_pages(self) -> None:
        """Release the memory of the pages that have been read; the data stays readable."""
        for mapped in self.maps:
            if hasattr(mapped, "madvise"):
                mapped.madvise(mmap.MADV_DONTNEED)

    def read(self, path: Path) -> memoryview:
        """Return the bytes of a file, mapped where it is large."""
        if path.stat().st_size < LARGE:
            return memoryview(path.read_bytes())
        with path.open("rb") as file:
            self.maps.append(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        return memoryview(self.maps[-1])

    def fetch(self, uri: str) -> bytes | memoryview | None:
        """Return the bytes behind a URI of the document; None where there is no such file.

        Only data: URIs and files are read; nothing is ever fetched from the network.

        Raises:
            InputError: a data: URI is not valid base64.
        """
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except ValueError as error:  # binascii.Error, or characters that are not ASCII
                raise damaged(self.document, "base64 data in a data: URI", error) from error
        # URIs are percent-encoded, but some exporters write names without encoding.
        name = find_beside(self.document.parent, (unquote(uri), uri))
        return None if name is None else self.read(self.document.parent / name)


def _read_sparse_indices(document: Document, sparse: dict[str, Any], index: int, count: int) -> np.ndarray:
    """Read the element indices of a sparse accessor and check that they are below `count`."""
    component = sparse["indices"]["componentType"]
    if component not in INDEX_TYPES:
        raise damaged(document.path, f"unsigned sparse indices in accessor {index}", component)
    dtype = np.dtype(COMPONENT_TYPES[component])
    rows = _read_rows(document, sparse["indices"], sparse["count"], dtype.itemsize, f"sparse accessor {index}")
    indices = np.ascontiguousarray(rows).view(dtype).ravel().astype(np.int64)
    if len(indices) and indices.max() >= count:
        raise damaged(document.path, f"sparse indices below {count} in accessor {index}", indices.max())
    return indices


def _read_rows(document: Document, owner: dict[str, Any], count: int, size: int, name: str) -> np.ndarray:
    """Return `count` rows of `size` bytes from the buffer view that `owner` refers to, without a copy."""
    view = document.gltf["bufferViews"][owner["bufferView"]]
    start, stride = owner.get("byteOffset", 0), view.get("byteStride") or size
    # An accessor must fit its buffer view, by the formula of 3.6.2.4 Data Alignment; the checks keep as_strided safe.
    end = start + (count - 1) * stride + size
    if count and end > view["byteLength"]:
        raise damaged(document.path, f"{end} bytes for {name}", f"{view['byteLength']} in its buffer view")
    memory = np.frombuffer(document.binary, np.uint8)[view["byteOffset"] + start :]
    return np.lib.stride_tricks.as_strided(memory, (count, size), (stride, 1), writeable=False)


def _read_json(content: memoryview, path: Path) -> tuple[Any, memoryview | bytes]:
    """Return the JSON of a glTF file, not checked, and its binary chunk."""
    magic = bytes(content[:4])
    text, chunk = _split_glb(content, path) if magic == b"glTF" else (bytes(content), b"")
    if path.suffix.lower() != ".gltf" and magic != b"glTF":
        raise damaged(path, "a binary glTF ('glTF' at the start)", repr(magic))
    return _parse_json(text, path), chunk


def _split_glb(content: memoryview, path: Path) -> tuple[bytes, memoryview | bytes]:
    """Split a GLB file into its JSON and its binary chunk, which may be missing (4.4 Binary glTF Layout).

    Chunks that are there as a whole are read, whatever the length in the header and the type of the second chunk: some
    exporters count neither all headers nor the padding of the JSON, or write 1 for BIN.
    """
    if len(content) < 20:
        raise _truncated(path, "a GLB header of 20 bytes", len(content))
    version, _, json_length, kind = struct.unpack_from("<IIII", content, 4)
    if version != 2:
        raise InputError(f"{path}: expected GLB version 2, found {version}; export it again as glTF 2.0")
    if 20 + json_length > len(content):
        raise _truncated(path, f"{20 + json_length} bytes", len(content))
    if kind != JSON_CHUNK:
        raise damaged(path, "the JSON chunk first", f"chunk type {kind:#x}")
    text, start = bytes(content[20 : 20 + json_length]), 20 + json_length + -json_length % 4
    if start + 8 > len(content):
        return text, b""
    binary_length, _ = struct.unpack_from("<II", content, start)
    if start + 8 + binary_length > len(content):
        raise _truncated(path, f"a binary chunk of {binary_length} bytes", len(content) - start - 8)
    return text, content[start + 8 : start + 8 + binary_length]


def _truncated(path: Path, expected: str, found: int) -> InputError:
    return InputError(f"{path}: expected {expected}, found {found}; the file is truncated, copy it again")


def _parse_json(text: bytes, path: Path) -> Any:
    """Parse the JSON text of a glTF file, strictly: NaN and Infinity are refused.

    What is null or an index of -1 is left out, and so is the padding with zeros of some exporters; an empty node may be
    null.
    """

    def reject_constant(constant: str) -> None:
        raise ValueError(f"{constant} is not a JSON number")  # json.loads accepts NaN and Infinity by default

    try:
        plain = text.rstrip(b"\0").decode("utf-8-sig")
        gltf = _without_absent(json.loads(plain, parse_constant=reject_constant))
        if b"\\ud" in text.lower():  # halves of surrogate pairs, which JSON can escape, are no text
            whole = json.dumps(gltf, ensure_ascii=False).encode("utf-16", "surrogatepass").decode("utf-16", "replace")
            gltf = json.loads(whole)
        return gltf
    except (ValueError, RecursionError) as error:
        raise damaged(path, "glTF JSON", f"text that does not parse ({error})") from error


def _without_absent(value: Any) -> Any:
    """Leave out the members of JSON objects that stand for none; extras and extensions stay as they are."""
    if isinstance(value, list):
        return [_without_absent(item) if isinstance(item, dict | list) else item for item in value]
    if not isinstance(value, dict):
        return value
    kept = {
        key: item if key in ("extras", "extensions") else _without_absent(item)
        for key, item in value.items()
        if item is not None and not (key in NO_INDEX and item == -1)
    }
    if isinstance(kept.get("nodes"), list):
        kept["nodes"] = [{} if node is None else node for node in kept["nodes"]]
    return kept


def without_extensions(gltf: dict[str, Any], dropped: Collection[str]) -> dict[str, Any]:
    """Return the JSON with some extensions no longer listed as used or required."""
    lists = {key: gltf[key] for key in ("extensionsUsed", "extensionsRequired") if key in gltf}
    return {**gltf, **{key: [name for name in names if name not in dropped] for key, names in lists.items()}}


def _drop_compression(gltf: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON without references to compressed copies of the data, which would be stale in a file we write."""
    gltf = without_extensions(gltf, COMPRESSION_EXTENSIONS)
    for owner in [*gltf.get("bufferViews", []), *list_primitives(gltf)]:
        if COMPRESSION_EXTENSIONS & owner.get("extensions", {}).keys():
            owner["extensions"] = {
                key: value for key, value in owner["extensions"].items() if key not in COMPRESSION_EXTENSIONS
            }
            if not owner["extensions"]:
                del owner["extensions"]
    return gltf


def _join_buffers(
    gltf: dict[str, Any], chunk: bytes | memoryview, files: MappedFiles
) -> tuple[dict[str, Any], bytes | memoryview]:
    """Join all buffers into one: returns the JSON with views into it, and the buffer. A single buffer is not copied."""
    path, starts, parts, total = files.document, [], [], 0
    for index, buffer in enumerate(gltf.get("buffers", [])):
        size, uri = buffer["byteLength"], buffer.get("uri")
        if is_fallback(buffer):
            content, size = b"", 0
        else:  # only the first buffer may be the binary chunk (3.6.1.2 GLB-stored Buffer)
            content = (chunk if index == 0 else None) if uri is None else files.fetch(uri)
        if content is None:
            raise InputError(
                f"{path}: expected the data of buffer {index}, found no file {str(uri or 'inside')[:80]!r}; keep the "
                "files together or export as one .glb"
            )
        if len(content) < size:
            raise _truncated(path, f"{size} bytes in buffer {index}", len(content))
        content = content[:size]
        padding = bytes(-len(content) % 4)
        JOINED.check(total + len(content), path)
        starts.append(total)
        parts += [content, padding]
        total += len(content) + len(padding)
    views = []
    for index, view in enumerate(gltf.get("bufferViews", [])):
        rebased = _rebase_range(view, index, gltf["buffers"], starts, path)
        # Compressed data has a range of its own, with the same properties.
        for name in view.get("extensions", {}).keys() & {*MESHOPT}:
            inner = _rebase_range(view["extensions"][name], index, gltf["buffers"], starts, path)
            rebased["extensions"] = {**rebased["extensions"], name: inner}
        views.append(rebased)
    return {**gltf, "bufferViews": views}, parts[0] if len(starts) == 1 else b"".join(parts)


def _rebase_range(
    view: dict[str, Any], index: int, buffers: list[dict[str, Any]], starts: list[int], path: Path
) -> dict[str, Any]:
    """Return a range of bytes with its offset in the joined buffer; `starts` are the offsets of the buffers in it."""
    offset, size = view.get("byteOffset", 0), buffers[view["buffer"]]["byteLength"]
    if offset + view["byteLength"] > size:
        expected = f"buffer view {index} inside its buffer of {size} bytes"
        raise damaged(path, expected, f"an end at {offset + view['byteLength']}")
    return {**view, "buffer": 0, "byteOffset": starts[view["buffer"]] + offset}


def _read_images(gltf: dict[str, Any], binary: bytes | memoryview, files: MappedFiles) -> tuple[bytes | None, ...]:
    """Read all images; those of one buffer view or file are read once. None where a file is missing, or no image."""
    images = gltf.get("images", [])
    keys = [(image.get("bufferView"), image.get("uri", "")) for image in images]
    contents: dict[tuple[int | None, str], bytes | None] = {}
    size = 0
    for number, uri in dict.fromkeys(keys):
        if number is None:
            content = bytes(files.fetch(uri) or b"")
            # A document may refer to any file of the machine: one that is not an image must not be copied.
            contents[number, uri] = content if content and image_type(content) else None
            continue
        view = gltf["bufferViews"][number]
        contents[number, uri] = bytes(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
        size += view["byteLength"]
        UNPACKED.check(size, files.document, len(binary))  # views may overlap
    return tuple(contents[key] for key in keys)
