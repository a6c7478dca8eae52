"""Opens glTF 2.0 files: the JSON and the buffers of a .glb or .gltf, and the arrays (accessors) inside them.

All buffers, embedded or in files beside it, are joined into one on opening, so that a `Document` needs no other file.
Large binary files are memory-mapped: they take only the memory of the pages that are being read. Numbers in comments
are sections of the glTF 2.0 specification.

Draco (KHR_draco_mesh_compression) compresses the attributes and indices of a primitive, meshopt (EXT_ and
KHR_meshopt_compression) the contents of a buffer view. Both are decoded by libraries (the extra `compressed`), in a
child process. The decoded data is appended to the document's buffer, so that the document is then one without
compression. Where a file has its data uncompressed too, that is read instead. Draco may quantize: weights then add up
to 0.999, and positions leave the bounds that the JSON states. These weights are divided by their sum, and bounds are
those of the decoded values, as glTF 2.0 demands of what is written (3.7.3.3, 3.6.2.5).
"""

from __future__ import annotations

import base64
import importlib.util
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
from ...core.errors import InputError, NotInstalledError, damaged
from ...core.frame_buffer import LARGE
from ..atomic import scratch_folder
from ..beside import find_beside
from ..child_process import Limits, child_result
from ..fbx import fbx_as_glb
from ..mtl import image_type
from . import check

JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
"""Chunk types of a GLB file (4.4.3 Chunks): "JSON" and "BIN"."""
NO_INDEX = ("scene", "mesh", "skin", "skeleton", "camera", "material", "indices")
"""Optional indices that exporters write as -1 where there is none."""
DECODER = "mimesh.io.gltf.document:decode"
PACKAGES = {"draco": ("DracoPy", "Draco"), "meshopt": ("meshopt", "meshopt compression")}
"""Module that decodes each codec, and the codec's name in messages."""
FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")
"""Values of `filter` of both meshopt extensions."""
SUMMED = 2e-7
"""Deviation from one of a vertex's weights' sum from which on they are divided by it: float32 rounds to 6e-8 at one."""


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
    check.check_document(gltf, path)
    compressed = compressed_views(gltf, path)
    gltf, binary = _join_buffers(gltf, chunk, files)
    gltf, binary = decompress(gltf, binary, compressed, path)
    gltf = _drop_compression(gltf)
    check.check_sizes(gltf, len(binary), path)
    images = _read_images(gltf, binary, files)
    document = Document(path, gltf, binary, images, files)
    # Damaged accessors of primitives and skins are reported on reading, not later on writing; those of animations when
    # an animation is read.
    used = {skin["inverseBindMatrices"] for skin in gltf.get("skins", []) if "inverseBindMatrices" in skin}
    for primitive in check.list_primitives(gltf):
        owners = primitive["attributes"], *primitive.get("targets", [])
        used.update(*(owner.values() for owner in owners), [primitive["indices"]] if "indices" in primitive else [])
    for index in sorted(used):
        element_bytes(document, index)
    return document


def check_decoders(path: Path) -> None:
    """Check that what decodes the compressed data of a .glb, .vrm or .gltf file is installed; damaged files pass."""
    if not missing_decoders():
        return
    try:
        gltf, _ = _read_json(MappedFiles(path).read(path), path)
    except (InputError, OSError):
        return
    required = gltf.get("extensionsRequired") if isinstance(gltf, dict) else None
    names = {str(name) for name in required} if isinstance(required, list) else set()
    need_decoders(["draco"] * (check.DRACO in names) + ["meshopt"] * bool(names.intersection(check.MESHOPT)), path)


def element_bytes(document: Document, index: int) -> UInt8[np.ndarray, "N S"]:
    """Return the bytes of each element of an accessor, one element a row, without strides and with sparse values."""
    accessor = document.gltf["accessors"][index]
    count, size = accessor["count"], check.element_size(accessor, index, document.path)
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
    dtype = np.dtype(check.COMPONENT_TYPES[document.gltf["accessors"][index]["componentType"]])
    return rows.view(dtype).reshape(len(rows), rows.shape[1] // dtype.itemsize)


def read_floats(document: Document, index: int) -> Float[np.ndarray, "N C"]:
    """Return the values of an accessor in float64; normalized integers are scaled to -1..1 or 0..1."""
    values = read_accessor(document, index)
    if not document.gltf["accessors"][index].get("normalized") or values.dtype.kind == "f":
        with np.errstate(invalid="ignore"):  # of signalling NaN in damaged files; what must be finite is checked later
            return values.astype(np.float64)
    # 3.11 Animations, equations for normalized integers: f = max(c / 127.0, -1.0) and likewise for other widths.
    return np.maximum(values / np.iinfo(values.dtype).max, -1.0)


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
    if component not in check.INDEX_TYPES:
        raise damaged(document.path, f"unsigned sparse indices in accessor {index}", component)
    dtype = np.dtype(check.COMPONENT_TYPES[component])
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
    gltf = without_extensions(gltf, check.COMPRESSION_EXTENSIONS)
    for owner in [*gltf.get("bufferViews", []), *check.list_primitives(gltf)]:
        if check.COMPRESSION_EXTENSIONS & owner.get("extensions", {}).keys():
            owner["extensions"] = {
                key: value for key, value in owner["extensions"].items() if key not in check.COMPRESSION_EXTENSIONS
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
        for name in view.get("extensions", {}).keys() & {*check.MESHOPT}:
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


@dataclass(eq=False)
class _Work:
    """What is to be decoded, and where the results go: each result is padded to a multiple of 4 bytes."""

    blobs: list[bytes | memoryview] = field(default_factory=list)
    jobs: list[dict[str, Any]] = field(default_factory=list)
    views: list[dict[str, Any]] = field(default_factory=list)
    """New buffer views, with offsets in the decoded data."""
    size: int = 0
    """Bytes of the decoded data."""

    def add(self, job: dict[str, Any], blob: bytes | memoryview, sizes: list[int]) -> list[dict[str, Any]]:
        """Add a job whose results have given sizes in bytes; returns a buffer view of each result."""
        self.jobs.append(job)
        self.blobs.append(blob)
        added = []
        for size in sizes:
            added.append({"buffer": 0, "byteOffset": self.size, "byteLength": size})
            self.size += size + -size % 4
        self.views += added
        return added


def is_fallback(buffer: dict[str, Any]) -> bool:
    """Return whether a buffer stands for data that exists compressed only, and has no bytes itself."""
    extensions = buffer.get("extensions")
    marks = [extensions.get(name) for name in check.MESHOPT] if isinstance(extensions, dict) else []
    return "uri" not in buffer and any(isinstance(mark, dict) and mark.get("fallback") is True for mark in marks)


def compressed_views(gltf: dict[str, Any], path: Path) -> dict[int, str]:
    """List the buffer views that have to be decoded, with the name of the extension that says how."""
    required = {str(name) for name in gltf.get("extensionsRequired", [])}
    found = {}
    for number, view in enumerate(gltf.get("bufferViews", [])):
        names = [name for name in check.MESHOPT if name in view.get("extensions", {})]
        without_bytes = is_fallback(gltf["buffers"][view["buffer"]])
        if names and (without_bytes or names[0] in required):
            found[number] = names[0]
        elif without_bytes:
            raise damaged(path, f"compressed data in buffer view {number}", "none")
    return found


def decompress(
    gltf: dict[str, Any], binary: bytes | memoryview, views: dict[int, str], path: Path
) -> tuple[dict[str, Any], bytes | memoryview]:
    """Decode all compressed data of a document that it does not have uncompressed too.

    Args:
        gltf: its JSON, checked, with all buffer views and compressed ranges inside `binary`.
        views: the buffer views to decode (see `compressed_views`).

    Returns:
        The JSON with views of the decoded data, and the buffer with that data in place of the compressed.

    Raises:
        InputError: a decoder is not installed, fails, or gives other data than the JSON says.
    """
    work = _Work()
    gltf = {**gltf, "bufferViews": [*gltf.get("bufferViews", [])], "accessors": [*gltf.get("accessors", [])]}
    # Draco data may lie in a view that meshopt compresses too: nobody writes that, and it fails as damaged data.
    by_draco = _plan_draco(work, gltf, binary, path)
    _plan_meshopt(work, gltf, binary, views, path)
    dead = {primitive["extensions"][check.DRACO]["bufferView"] for primitive in _draco_primitives(gltf)}
    dead -= {accessor.get("bufferView") for accessor in gltf["accessors"]}
    by_meshopt = [view for view in gltf["bufferViews"] if view.get("extensions", {}).keys() & {*check.MESHOPT}]
    if not (work.jobs or dead or by_meshopt):
        return gltf, binary
    UNPACKED.check(work.size, path, sum(map(len, work.blobs)))
    decoded = _decode(work, path) if work.jobs else b""
    if by_draco:
        decoded = _corrected(gltf, by_draco, bytearray(decoded))
    kept = _keep_used(gltf, dead, work.views, binary)
    start = sum(len(part) for part in kept)
    for view in work.views:
        view["byteOffset"] += start
    return gltf, b"".join([*kept, decoded])


def _draco_primitives(gltf: dict[str, Any]) -> list[dict[str, Any]]:
    return [primitive for primitive in check.list_primitives(gltf) if check.DRACO in primitive.get("extensions", {})]


def _plan_meshopt(
    work: _Work, gltf: dict[str, Any], binary: bytes | memoryview, views: dict[int, str], path: Path
) -> None:
    """Add the buffer views that meshopt compresses to the work, and replace them by views of the results."""
    for number, name in views.items():
        view = gltf["bufferViews"][number]
        extension = view["extensions"][name]
        count, stride = extension["count"], extension["byteStride"]
        mode, decoded_filter = extension["mode"], extension.get("filter", "NONE")
        strides = {"ATTRIBUTES": range(4, 257, 4), "TRIANGLES": (2, 4), "INDICES": (2, 4)}.get(mode, ())
        if stride not in strides or decoded_filter not in FILTERS or count * stride != view["byteLength"]:
            expected = f"{view['byteLength']} bytes of ATTRIBUTES, TRIANGLES or INDICES in buffer view {number}"
            raise damaged(path, expected, f"{count} x {stride} of {mode!s:.20}")
        job = {"codec": "meshopt", "count": count, "stride": stride, "mode": mode, "filter": decoded_filter}
        start = extension["byteOffset"]
        new = {**view, **work.add(job, binary[start : start + extension["byteLength"]], [count * stride])[0]}
        gltf["bufferViews"][number] = new
        work.views[-1] = new


def _plan_draco(work: _Work, gltf: dict[str, Any], binary: bytes | memoryview, path: Path) -> set[int]:
    """Add the primitives that Draco compresses to the work, and give their accessors views of the results.

    Returns these accessors.
    """
    required = check.DRACO in gltf.get("extensionsRequired", [])
    planned: set[int] = set()
    for primitive in _draco_primitives(gltf):
        extension = primitive["extensions"][check.DRACO]
        ids = extension["attributes"]
        wanted = {name: index for name, index in primitive["attributes"].items() if name in ids}
        accessors = [primitive[key] for key in ("indices",) if key in primitive] + list(wanted.values())
        # Where Draco is optional, the accessors have the data uncompressed.
        has_data = all("bufferView" in gltf["accessors"][index] for index in accessors)
        if planned.issuperset(accessors) or (has_data and not required):
            continue
        planned.update(accessors)
        outputs = [_draco_output(gltf, primitive["indices"], None, path)] if "indices" in primitive else []
        outputs += [_draco_output(gltf, index, ids[name], path) for name, index in wanted.items()]
        view = gltf["bufferViews"][extension["bufferView"]]
        blob = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        sizes = [output["stride"] * output["count"] for output in outputs]
        new_views = work.add({"codec": "draco", "outputs": outputs}, blob, sizes)
        for index, new_view, output in zip(accessors, new_views, outputs, strict=True):
            new_view |= {"byteStride": output["stride"]} if output["padding"] else {}
            added = {"bufferView": len(gltf["bufferViews"]), "byteOffset": 0}
            gltf["accessors"][index] = {**gltf["accessors"][index], **added}
            gltf["bufferViews"].append(new_view)
    return planned


def _corrected(gltf: dict[str, Any], by_draco: set[int], decoded: bytearray) -> bytearray:
    """Return decoded data with weights that add up to one, and state the bounds of its accessors anew.

    Args:
        by_draco: accessors whose views lie in `decoded`.
    """

    def values(index: int) -> np.ndarray:
        accessor = gltf["accessors"][index]
        view, dtype = (
            gltf["bufferViews"][accessor["bufferView"]],
            np.dtype(check.COMPONENT_TYPES[accessor["componentType"]]),
        )
        columns = check.COMPONENT_COUNTS[accessor["type"]]
        strides = view.get("byteStride", columns * dtype.itemsize), dtype.itemsize
        return np.ndarray((accessor["count"], columns), dtype, decoded, view["byteOffset"], strides)

    for primitive in _draco_primitives(gltf):
        sets = [index for name, index in primitive["attributes"].items() if name.startswith("WEIGHTS_")]
        weights = [values(index) for index in sets] if by_draco.issuperset(sets) else []
        # Integers are compressed without loss.
        if weights and all(each.dtype.kind == "f" for each in weights):
            total = np.sum([each.sum(axis=1, dtype=float) for each in weights], axis=0)
            lossy = (np.abs(total - 1) > SUMMED) & (total > 0)
            for each in weights:
                each[lossy] /= total[lossy, None]
    for index in by_draco:
        accessor, found = gltf["accessors"][index], values(index)
        bounds = {"min": found.min(axis=0), "max": found.max(axis=0)} if len(found) and np.isfinite(found).all() else {}
        accessor |= {key: bound.tolist() for key, bound in bounds.items() if key in accessor}
    return decoded


def _draco_output(gltf: dict[str, Any], index: int, attribute: int | None, path: Path) -> dict[str, Any]:
    """Describe the array that Draco is to give for an accessor of a vertex attribute, or of indices (None)."""
    accessor = gltf["accessors"][index]
    size = check.element_size(accessor, index, path)
    if accessor["type"].startswith("MAT"):
        raise damaged(path, "vectors in Draco data", accessor["type"])
    # Elements of vertex attributes start at multiples of 4 bytes (3.6.2.4 Data Alignment).
    padding = 0 if attribute is None else -size % 4
    kind = {
        "dtype": check.COMPONENT_TYPES[accessor["componentType"]],
        "columns": check.COMPONENT_COUNTS[accessor["type"]],
    }
    place = {"count": accessor["count"], "padding": padding, "stride": size + padding}
    return kind | place | ({} if attribute is None else {"id": attribute})


def _keep_used(
    gltf: dict[str, Any], dead: set[int], decoded: list[dict[str, Any]], binary: bytes | memoryview
) -> list[bytes | memoryview]:
    """Cut what is compressed out of the buffer, and move the views of the rest; returns the parts that remain.

    Views of compressed data stay, because removing them would renumber the others: they get a byte of any other data.
    """
    views = gltf["bufferViews"]
    is_decoded = {id(view) for view in decoded}
    used = [k for k, view in enumerate(views) if id(view) not in is_decoded and k not in dead]
    parts: list[bytes | memoryview] = []
    size = stop = shift = 0  # of the parts; end of the last range that was kept; its new start less its old one
    for k in sorted(used, key=lambda k: views[k]["byteOffset"]):
        offset = views[k]["byteOffset"]
        start, end = max(offset - offset % 4, stop), offset + views[k]["byteLength"]
        if end > stop:
            if start > stop:
                shift = size - start
            part = binary[start : end + -end % 4]
            parts += [part, bytes(-len(part) % 4)]
            size += len(part) + -len(part) % 4
            stop = end + -end % 4
        views[k] = {**views[k], "byteOffset": offset + shift}
    for k in dead:
        views[k] = {**views[k], "byteOffset": 0, "byteLength": 1}
    return parts


def missing_decoders() -> list[str]:
    """List the codecs (keys of PACKAGES) whose decoders are not installed."""
    return [codec for codec, (package, _) in PACKAGES.items() if importlib.util.find_spec(package) is None]


def need_decoders(codecs: Collection[str], path: Path) -> None:
    """Raise NotInstalledError where the decoder of one of some codecs (keys of PACKAGES) is not installed."""
    for package, words in (PACKAGES[codec] for codec in missing_decoders() if codec in codecs):
        raise NotInstalledError(
            f"{path}: expected {package} to read {words}, found it not installed; "
            "pip install 'mimesh[compressed]', or export without compression"
        )


def _decode(work: _Work, path: Path) -> bytes:
    """Run the decoders in a child process; returns the results one after another, padded."""
    need_decoders({job["codec"] for job in work.jobs}, path)
    head = json.dumps([{**job, "bytes": len(blob)} for job, blob in zip(work.jobs, work.blobs, strict=True)]).encode()
    with scratch_folder() as folder:
        request = folder / "request"
        with request.open("wb") as file:
            file.write(len(head).to_bytes(8, "little") + head)
            file.writelines(work.blobs)
        limits = Limits.for_size(request.stat().st_size + work.size)
        with child_result(DECODER, request, path, limits) as result:
            content = result.read_bytes()
    if len(content) != work.size:
        raise damaged(path, f"{work.size:,} bytes of decoded data", f"{len(content):,}")
    return content


def decode(source: Path, target: Path) -> None:
    """Decode the jobs of a request and write their results one after another, padded to multiples of 4 bytes.

    A request is the length of its JSON (8 bytes), the JSON, and the compressed data of all jobs.
    """
    content = source.read_bytes()
    start = 8 + int.from_bytes(content[:8], "little")
    with target.open("wb") as file:
        for job in json.loads(content[8:start]):
            blob, start = content[start : start + job["bytes"]], start + job["bytes"]
            if job["codec"] == "draco":
                results = _decode_draco(job, blob, source)
            else:  # the contents of a buffer view
                import meshopt

                kind = None if job["filter"] == "NONE" else job["filter"]
                decoded = meshopt.decode_gltf_buffer(blob, job["count"], job["stride"], job["mode"], kind)
                results = [decoded.tobytes()]
            for result in results:
                file.write(result + bytes(-len(result) % 4))


def _decode_draco(job: dict[str, Any], blob: bytes, source: Path) -> list[bytes]:
    """Decode the indices and attributes of a primitive, in the types of their accessors."""
    import DracoPy

    mesh = DracoPy.decode(blob)
    results = []
    for output in job["outputs"]:
        if "id" in output:
            attribute = mesh.get_attribute_by_unique_id(output["id"])
            found = None if attribute is None else np.asarray(attribute["data"])
        else:
            found = np.asarray(mesh.faces).reshape(-1, 1)
        shape = (output["count"], output["columns"])
        if found is None or found.shape != shape:
            name = "indices" if "id" not in output else f"attribute {output['id']}"
            expected = f"{shape[0]} x {shape[1]} numbers in {name} of its Draco data"
            raise damaged(source, expected, None if found is None else found.shape)
        rows = np.ascontiguousarray(found.astype(output["dtype"])).view(np.uint8).reshape(len(found), -1)
        results.append(np.pad(rows, ((0, 0), (0, output["padding"]))).tobytes())
    return results
