"""Read binary and text STL files, and write new binary ones.

STL is a triangle soup without shared vertices: corners at one position are welded on reading, and written files have
the triangles in the same order.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError, damaged
from ..core.geometry import face_vectors, unit_vectors, weld
from ..core.mesh import Mesh, Part
from .atomic import whole_file
from .text import decoded, read_numbers

_RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""One triangle of a binary file."""
_HEADER_SIZE = 84
"""Bytes of a binary file before the triangles: 80 of any content and the triangle count."""


def read_stl(path: Path) -> Mesh:
    """Read an STL file; corners at exactly the same position become one vertex, in order of first appearance.

    Each `solid` of a text file is a part. Facet normals are not kept: they follow from the triangles.

    Raises:
        InputError: the file is truncated, or is no STL file.
    """
    data = path.read_bytes()
    # Some exporters begin the free header of a binary file with `solid`, too: such a file has the size of a binary one.
    is_text = data.lstrip()[:5].lower() == b"solid" and len(data) != _binary_size(data)
    soup, parts = _read_text(data, path) if is_text else (_read_binary(data, path), ())
    merged, index = weld(soup)
    # `weld` sorts by position; renumber the vertices by the first corner that uses each.
    _, first, unique_index = np.unique(index, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return Mesh(merged[order], rank[unique_index].reshape(-1, 3), name=path.stem, parts=parts)


def write_stl(mesh: Mesh, path: Path) -> None:
    """Write any mesh as a new binary STL file: triangles only, without vertex order, parts or materials."""
    if not len(mesh.faces):
        raise InputError(f"{path}: expected a mesh with faces for STL, found a point cloud; write .ply or .obj")
    records = np.zeros(len(mesh.faces), _RECORD)
    records["normal"] = unit_vectors(face_vectors(mesh.vertices, mesh.faces))
    records["corners"] = mesh.vertices[mesh.faces]
    with whole_file(path) as temporary:
        temporary.write_bytes(bytes(80) + len(records).to_bytes(4, "little") + records.tobytes())


def _binary_size(data: bytes) -> int:
    return _HEADER_SIZE + int.from_bytes(data[80:84], "little") * _RECORD.itemsize


def _read_binary(data: bytes, path: Path) -> Float[np.ndarray, "C 3"]:
    count = int.from_bytes(data[80:84], "little")
    if len(data) < _HEADER_SIZE or len(data) < _binary_size(data):
        size = max(_binary_size(data), _HEADER_SIZE)
        raise damaged(path, f"an STL file of {size} bytes ({count} triangles)", len(data))
    records = np.frombuffer(data, _RECORD, count=count, offset=_HEADER_SIZE)
    return records["corners"].astype(np.float64).reshape(-1, 3)


def _read_text(data: bytes, path: Path) -> tuple[Float[np.ndarray, "C 3"], tuple[Part, ...]]:
    lines = data.splitlines(keepends=True)
    index: defaultdict[bytes, list[int]] = defaultdict(list)  # lines by their first word in lower case
    for i, line in enumerate(lines):
        index[b"".join(line.split(None, 1)[:1]).lower()].append(i)
    facets, corners, solids, closed = index[b"facet"], index[b"vertex"], index[b"solid"], len(index[b"endfacet"])
    if len(corners) != 3 * len(facets) or closed != len(facets):
        expected = f"three vertex lines and one endfacet for each of {len(facets)} facets"
        raise damaged(path, expected, f"{len(corners)} and {closed}")
    read_numbers(lines, facets, 2, 3, path)  # only checks the normals
    soup = read_numbers(lines, corners, 1, 3, path)
    if len(solids) < 2:
        return soup, ()
    starts = np.searchsorted(facets, solids).tolist()
    names = [decoded(b" ".join(lines[i].split()[1:])) for i in solids]
    spans = zip(names, starts, [*starts[1:], len(facets)], strict=True)
    return soup, tuple(Part(name, start, stop) for name, start, stop in spans if start < stop)
