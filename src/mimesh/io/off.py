"""Read OFF text files with their COFF, NOFF and STOFF variants, and write new ones."""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Int

from ..core.budgets import CORNERS
from ..core.errors import InputError, damaged
from ..core.geometry import unit_vectors
from ..core.mesh import Mesh
from .atomic import whole_file
from .polygons import PolygonSource, fan_corners, polygons_of
from .text import line_number, read_numbers, without_comments

_HEADER = re.compile(rb"\s*(?P<kind>(ST)?[CN]*(?P<other>4?n?)OFF)?(?P<binary>\s+BINARY)?(?P<rest>.*)", re.DOTALL)
"""First line: the keyword, which may be missing, and the counts, which may follow it without a space (ModelNet)."""

LONGEST_COUNT = 19
"""Digits of a count from which on it is damaged: larger ones do not fit into 64 bits."""


def read_off(path: Path) -> Mesh:
    """Read an OFF file with one vertex or face per line; polygons become triangle fans, colours are not read.

    Binary, four-dimensional and n-dimensional OFF are not supported.

    Raises:
        InputError: another kind of file, fewer lines than its counts declare, or words that are no numbers.
    """
    lines = path.read_bytes().splitlines(keepends=True)
    plain = without_comments(lines)
    non_empty = [i for i, line in enumerate(plain) if line.strip()]
    vertex_count, face_count, start, has_normals = _read_header(plain, non_empty, path)
    rows = non_empty[start : start + vertex_count + face_count]
    if len(rows) < vertex_count + face_count:
        raise damaged(path, f"{vertex_count} vertex and {face_count} face lines", f"{len(rows)} in all")
    vertex_lines, face_lines = rows[:vertex_count], rows[vertex_count:]
    vertices = read_numbers(lines, vertex_lines, 0, 3, path)
    faces, sizes = _read_faces(plain, face_lines, vertex_count, path)
    normals = unit_vectors(read_numbers(lines, vertex_lines, 3, 3, path)) if has_normals else None
    corner_normals = normals[faces] if normals is not None and len(faces) else None
    source = PolygonSource(".off", sizes)
    return Mesh(vertices, faces, name=path.stem, corner_normals=corner_normals, source=source)


def write_off(mesh: Mesh, path: Path) -> None:
    """Write any mesh as a new OFF file of polygons; normals, texture coordinates, colours and materials are omitted."""
    polygons = polygons_of(mesh, mesh.faces)
    lines = ["OFF", f"{len(mesh.vertices)} {len(polygons)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.astype(np.float64).tolist()]
    lines += [" ".join(map(str, [len(polygon), *polygon])) for polygon in polygons]
    with whole_file(path) as temporary:
        temporary.write_bytes("\n".join([*lines, ""]).encode())


def _read_header(lines: list[bytes], non_empty: list[int], path: Path) -> tuple[int, int, int, bool]:
    """Read vertex count, face count, number of non-empty lines of the header, and whether vertices have normals."""
    match = _HEADER.match(lines[non_empty[0]]) if non_empty else None
    counts = match["rest"].split() if match else []
    header_lines = 1
    if match and match["kind"] and not counts and len(non_empty) > 1:
        counts, header_lines = lines[non_empty[1]].split(), 2
    if (
        not match
        or match["binary"]
        or match["other"]
        or len(counts) < 2
        or not all(word.isdigit() and len(word) < LONGEST_COUNT for word in counts[:2])
    ):
        found = lines[non_empty[0]].strip().decode("utf-8", "replace")[:40] if non_empty else ""
        raise InputError(
            f"{path}: expected text that begins with OFF and its counts, found {found!r}; export it as OFF"
        )
    return int(counts[0]), int(counts[1]), header_lines, b"N" in (match["kind"] or b"")


def _read_faces(
    lines: list[bytes], index: list[int], vertex_count: int, path: Path
) -> tuple[Int[np.ndarray, "F 3"], Int[np.ndarray, " P"]]:
    rows = [lines[i].split() for i in index]
    try:
        polygons = [list(map(int, row[1 : 1 + int(row[0])])) for row in rows]
    except ValueError as error:
        raise InputError(
            f"{path}: expected whole numbers in face lines, found {error!r:.80}; export it again"
        ) from error
    for i, row, polygon in zip(index, rows, polygons, strict=True):
        if len(polygon) != int(row[0]) or (polygon and not 0 <= min(polygon) <= max(polygon) < vertex_count):
            found = b" ".join(row).decode("utf-8", "replace")[:60]
            found = f"{found!r} in line {line_number(lines, i)}"
            raise damaged(path, f"a corner count and indices in 0..{vertex_count - 1}", found)
    sizes = np.array([len(polygon) for polygon in polygons], int)
    CORNERS.check(int(sizes.max(initial=0)), path)
    return np.array(list(chain.from_iterable(polygons)), np.int64)[fan_corners(sizes)[0]], sizes
