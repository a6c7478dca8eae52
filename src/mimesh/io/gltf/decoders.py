"""Decode Draco and meshopt data; runs in a child process (`compression.decompress` writes the request)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError


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
            results = _decode_draco(job, blob, source) if job["codec"] == "draco" else [_decode_meshopt(job, blob)]
            for result in results:
                file.write(result + bytes(-len(result) % 4))


def _decode_meshopt(job: dict[str, Any], blob: bytes) -> bytes:
    """Decode the contents of a buffer view."""
    import meshopt

    kind = None if job["filter"] == "NONE" else job["filter"]
    return meshopt.decode_gltf_buffer(blob, job["count"], job["stride"], job["mode"], kind).tobytes()


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
            raise InputError(
                f"{source}: expected {shape[0]} x {shape[1]} numbers in {name} of its Draco data, found "
                f"{None if found is None else found.shape}; the file is damaged, export it again"
            )
        rows = np.ascontiguousarray(found.astype(output["dtype"])).view(np.uint8).reshape(len(found), -1)
        results.append(np.pad(rows, ((0, 0), (0, output["padding"]))).tobytes())
    return results
