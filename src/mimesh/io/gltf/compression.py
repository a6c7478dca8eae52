"""Decompresses glTF files: KHR_draco_mesh_compression, EXT_meshopt_compression and KHR_meshopt_compression.

Draco compresses the attributes and indices of a primitive, meshopt the contents of a buffer view. Both are decoded by
libraries (the extra `compressed`), in a child process. The decoded data is appended to the document's buffer, so that
the document is then one without compression. Where a file has its data uncompressed too, that is read instead.

Draco may quantize: weights then add up to 0.999, and positions leave the bounds that the JSON states. These weights are
divided by their sum, and bounds are those of the decoded values, as glTF 2.0 demands of what is written (3.7.3.3,
3.6.2.5).
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...core.budgets import UNPACKED
from ...core.errors import NotInstalledError, damaged
from ..atomic import scratch_folder
from ..child_process import Limits, child_result
from .check import COMPONENT_COUNTS, COMPONENT_TYPES, DRACO, MESHOPT, element_size, list_primitives

DECODER = "mimesh.io.gltf.compression:decode"
PACKAGES = {"draco": ("DracoPy", "Draco"), "meshopt": ("meshopt", "meshopt compression")}
"""Module that decodes each codec, and the codec's name in messages."""
FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")
"""Values of `filter` of both meshopt extensions."""
SUMMED = 2e-7
"""Deviation from one of a vertex's weights' sum from which on they are divided by it: float32 rounds to 6e-8 at one."""


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
    marks = [extensions.get(name) for name in MESHOPT] if isinstance(extensions, dict) else []
    return "uri" not in buffer and any(isinstance(mark, dict) and mark.get("fallback") is True for mark in marks)


def compressed_views(gltf: dict[str, Any], path: Path) -> dict[int, str]:
    """List the buffer views that have to be decoded, with the name of the extension that says how.

    Raises:
        InputError: a view lies in a buffer without bytes and is not compressed.
    """
    required = {str(name) for name in gltf.get("extensionsRequired", [])}
    found = {}
    for number, view in enumerate(gltf.get("bufferViews", [])):
        names = [name for name in MESHOPT if name in view.get("extensions", {})]
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
    dead = {primitive["extensions"][DRACO]["bufferView"] for primitive in _draco_primitives(gltf)}
    dead -= {accessor.get("bufferView") for accessor in gltf["accessors"]}
    by_meshopt = [view for view in gltf["bufferViews"] if view.get("extensions", {}).keys() & {*MESHOPT}]
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
    """List the primitives that have compressed data."""
    return [primitive for primitive in list_primitives(gltf) if DRACO in primitive.get("extensions", {})]


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
    required = DRACO in gltf.get("extensionsRequired", [])
    planned: set[int] = set()
    for primitive in _draco_primitives(gltf):
        extension = primitive["extensions"][DRACO]
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
        view, dtype = gltf["bufferViews"][accessor["bufferView"]], np.dtype(COMPONENT_TYPES[accessor["componentType"]])
        columns = COMPONENT_COUNTS[accessor["type"]]
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
    size = element_size(accessor, index, path)
    if accessor["type"].startswith("MAT"):
        raise damaged(path, "vectors in Draco data", accessor["type"])
    # Elements of vertex attributes start at multiples of 4 bytes (3.6.2.4 Data Alignment).
    padding = 0 if attribute is None else -size % 4
    kind = {"dtype": COMPONENT_TYPES[accessor["componentType"]], "columns": COMPONENT_COUNTS[accessor["type"]]}
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

    Raises:
        InputError: the data has another number of elements than the JSON says.
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
