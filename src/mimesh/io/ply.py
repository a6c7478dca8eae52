"""Read PLY files in all three encodings (ASCII, little and big endian), and write new binary ones.

One scheme serves all encodings: the numbers of an ASCII file become a binary body, in which each of them has 64 bits.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.budgets import CORNERS, ELEMENTS
from ..core.errors import InputError, damaged
from ..core.geometry import finite_or_zero, unit_vectors
from ..core.mesh import Material, Mesh, Part
from .atomic import whole_file
from .beside import find_beside
from .colors import linear_rgba, srgb_rgba
from .mtl import read_image, write_image
from .polygons import PolygonSource, fan_corners, polygon_corners, polygon_sizes, smooth_normals
from .text import decoded, encoded

_TYPES = {  # type names of the original specification and of later writers -> NumPy types
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_BYTE_ORDERS = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}

_COLOR_NAMES = ("red", "green", "blue", "alpha")
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
"""Names of texture coordinates of vertices; PLY does not standardise them, and exporters differ."""
ROUNDING = 1e-6
"""Largest rounding of a written vertex, as a fraction of the mesh's longest side; double precision where it is more."""


@dataclass(frozen=True)
class _Property:
    """One property of an element: a single value or a list."""

    name: str
    dtype: np.dtype
    """Type of the value, or of the items of a list, in the body."""
    count: np.dtype | None
    """Type of the length of a list in the body; None for a single value."""
    white: float
    """Value of full intensity where it is a colour: the largest of the declared type if that is an integer, else 1."""


@dataclass(frozen=True)
class _Element:
    """One table of the file, such as `vertex` or `face`."""

    name: str
    length: int
    """Number of rows."""
    properties: tuple[_Property, ...]
    """Columns in file order."""


@dataclass(frozen=True, eq=False)
class _Column:
    """The values of one property."""

    values: np.ndarray
    """One for each row; of lists all items, one list after another."""
    white: float
    counts: Int[np.ndarray, " N"] | None = None
    """Items of the list of each row; None for single values."""


SPLAT = {"f_dc_0", "scale_0", "rot_0", "opacity"}
"""Properties of the vertices of Gaussian splats (Kerbl et al. 2023)."""
_Columns = dict[str, dict[str, _Column]]
"""Element -> property -> its values."""


def read_ply(path: Path) -> Mesh:
    """Read a PLY file: vertices in the file's order, polygons as triangle fans; without faces it is a point cloud.

    Read are normals (nx ny nz), texture coordinates per vertex (s t, u v, texture_u texture_v) or per face corner
    (texcoord), colours per vertex (red green blue, alpha, taken as sRGB-encoded), and the image of a `comment
    TextureFile`. All else (confidence, other elements) is left out. Triangle strips are not supported.

    Raises:
        InputError: the header or body is damaged or truncated, or there is no x, y, z.
    """
    data = path.read_bytes()
    elements, comments, body = _read_header(data, path)
    columns = _read_body(elements, body, path)
    vertices = _vectors(columns, ("x", "y", "z"))
    if vertices is None:
        raise InputError(f"{path}: expected an element 'vertex' with x, y, z, found none; export it again")
    polygons = _polygon_column(columns, path)
    sizes = polygons.counts if polygons is not None and polygons.counts is not None else np.zeros(0, int)
    CORNERS.check(int(sizes.max(initial=0)), path)
    corners = polygons.values.astype(np.int64) if polygons is not None else np.zeros(0, np.int64)
    triangles, _ = fan_corners(sizes)
    faces = corners[triangles]
    if not len(faces) and columns["vertex"].keys() >= SPLAT:
        raise InputError(f"{path}: expected a mesh, found a Gaussian splat, no mesh; make a mesh of it and give that")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        worst = faces.max() if faces.max() >= len(vertices) else faces.min()
        raise damaged(path, f"face indices in 0..{len(vertices) - 1}", worst)
    normals = _vectors(columns, ("nx", "ny", "nz"))
    normals = unit_vectors(finite_or_zero(normals)) if normals is not None else None
    return Mesh(
        vertices,
        faces,
        name=path.stem,
        corner_uv=_read_uv(columns, faces, triangles, sizes),
        corner_normals=normals[faces] if normals is not None and len(faces) else None,
        vertex_colors=_read_colors(columns["vertex"]),
        parts=_read_texture(comments, path, len(faces)),
        source=PolygonSource(".ply", sizes),
    )


def write_ply(mesh: Mesh, path: Path) -> None:
    """Write any mesh as a new binary PLY file: positions, normals, colours, polygons and corner texture coordinates.

    Normals are written where all corners of a vertex share one, colours as sRGB-encoded bytes, the image of the only
    material as `comment TextureFile`, beside the file. Other parts and materials are not written.
    """
    sizes, normals = polygon_sizes(mesh), smooth_normals(mesh)
    count = "uchar" if 2 * sizes.max(initial=0) < 256 else "int"  # type of list lengths; texcoord has two per corner
    with np.errstate(over="ignore"):
        error = np.abs(mesh.vertices.astype(np.float32) - mesh.vertices).max(initial=0.0)
    single = error <= ROUNDING * np.ptp(mesh.vertices, axis=0).max(initial=0.0)
    kind, dtype = ("float", "<f4") if single else ("double", "<f8")
    columns = {"xyz": (mesh.vertices, dtype, [f"property {kind} {axis}" for axis in "xyz"])}
    if normals is not None:
        columns["normal"] = (normals, "<f4", [f"property float n{axis}" for axis in "xyz"])
    if mesh.vertex_colors is not None:
        colors = np.round(255 * srgb_rgba(mesh.vertex_colors))
        columns["rgba"] = (colors, "u1", [f"property uchar {name}" for name in _COLOR_NAMES])
    fields = [(name, dtype, (values.shape[1],)) for name, (values, dtype, _) in columns.items()]
    rows = np.zeros(len(mesh.vertices), np.dtype(fields))
    for name, (values, _, _) in columns.items():
        rows[name] = values
    header = ["ply", "format binary_little_endian 1.0"]
    materials = {part.material for part in mesh.parts}
    material = materials.pop() if len(materials) == 1 else None
    if material is not None and material.texture is not None and mesh.corner_uv is not None:
        header.append(f"comment TextureFile {write_image(material.texture, path.parent, material.name)}")
    header += [f"element vertex {len(rows)}", *itertools.chain(*(lines for _, _, lines in columns.values()))]
    if len(sizes):
        header += [f"element face {len(sizes)}", f"property list {count} int vertex_indices"]
        header += [f"property list {count} float texcoord"] if mesh.corner_uv is not None else []
    with whole_file(path) as temporary:
        text = encoded("\n".join([*header, "end_header", ""]))
        temporary.write_bytes(text + rows.tobytes() + _polygon_bytes(mesh, sizes, count))


def _polygon_bytes(mesh: Mesh, sizes: Int[np.ndarray, " P"], count: str) -> bytes:
    """Encode the face element: vertex indices of each polygon, and its texture coordinates if the mesh has any.

    Rows differ in length with the number of corners. All polygons of one size are encoded together as a structured
    array, and their rows are then placed at the offsets of the polygons.
    """
    corners, count_type = polygon_corners(sizes), "u1" if count == "uchar" else "<i4"
    first = np.cumsum(sizes) - sizes
    rows_of_size, widths = {}, np.zeros(len(sizes), np.int64)
    for size in np.unique(sizes).tolist():
        fields = [("count", count_type), ("corners", "<i4", (size,)), ("twice", count_type), ("uv", "<f4", (2 * size,))]
        rows = np.zeros((sizes == size).sum(), np.dtype(fields if mesh.corner_uv is not None else fields[:2]))
        index = corners[first[sizes == size, None] + np.arange(size)]
        rows["count"], rows["corners"] = size, mesh.faces.reshape(-1)[index]
        if mesh.corner_uv is not None:
            rows["twice"], rows["uv"] = 2 * size, mesh.corner_uv.reshape(-1, 2)[index].reshape(len(rows), -1)
        rows_of_size[size], widths[sizes == size] = rows, rows.dtype.itemsize
    if len(rows_of_size) == 1:
        return next(iter(rows_of_size.values())).tobytes()
    offsets, body = np.cumsum(widths) - widths, np.zeros(widths.sum(), np.uint8)
    for size, rows in rows_of_size.items():
        width = rows.dtype.itemsize
        body[offsets[sizes == size, None] + np.arange(width)] = rows.view(np.uint8).reshape(-1, width)
    return body.tobytes()


def _vectors(columns: _Columns, names: tuple[str, ...]) -> Float[np.ndarray, "V C"] | None:
    """Return properties of the vertex element as vectors; None where one of them is missing or a list."""
    vertex = columns.get("vertex", {})
    if not all(name in vertex and vertex[name].counts is None for name in names):
        return None
    return np.stack([vertex[name].values.astype(np.float64) for name in names], axis=1)


def _polygon_column(columns: _Columns, path: Path) -> _Column | None:
    """Return the column with the vertex indices of the faces; None for a point cloud."""
    if "tristrips" in columns:
        raise InputError(f"{path}: expected polygons, found triangle strips; export it again with plain faces")
    face = columns.get("face", {})
    for name in ("vertex_indices", "vertex_index"):
        if name in face and face[name].counts is not None:
            return face[name]
    if any(len(column.values if column.counts is None else column.counts) for column in face.values()):
        raise InputError(f"{path}: expected faces with a list vertex_indices, found {', '.join(face)}; export it again")
    return None


def _read_uv(columns: _Columns, faces, triangles, sizes) -> Float[np.ndarray, "F 3 2"] | None:
    """Read texture coordinates per face corner, else per vertex; None where the file has neither."""
    texcoord = columns.get("face", {}).get("texcoord")
    if texcoord is not None and texcoord.counts is not None and len(sizes) and (texcoord.counts == 2 * sizes).all():
        return finite_or_zero(texcoord.values.astype(np.float64).reshape(-1, 2))[triangles]
    of_vertices = (_vectors(columns, names) for names in _UV_NAMES) if len(faces) else ()
    return next((finite_or_zero(uv)[faces] for uv in of_vertices if uv is not None), None)


def _read_colors(vertex: dict[str, _Column]) -> Float[np.ndarray, "V 4"] | None:
    """Read linear RGBA of the vertices; integers are scaled by the largest value of their type, floats are 0..1."""
    names = [name for name in _COLOR_NAMES if name in vertex and vertex[name].counts is None]
    if names[:3] != list(_COLOR_NAMES[:3]):
        return None
    values = [vertex[name].values / vertex[name].white for name in names]
    return linear_rgba(np.stack(values, axis=1).astype(np.float64))


def _read_texture(comments: list[str], path: Path, faces: int) -> tuple[Part, ...]:
    """Read the image of `comment TextureFile`, if there is one, as one part with a material."""
    names = [comment.split(None, 1)[1] for comment in comments if comment.startswith("TextureFile ")]
    found = find_beside(path.parent, names)
    if found is None or not faces:
        return ()
    material = Material(Path(found).stem, (1.0, 1.0, 1.0, 1.0), read_image(path.parent / found))
    return (Part(path.stem, 0, faces, material),)


def _read_header(data: bytes, path: Path) -> tuple[list[_Element], list[str], np.ndarray]:
    """Parse the header; return the elements, the comments, and the bytes of the body."""
    end = re.search(rb"([\r\n])end_header[ \t]*", data)
    if not data.startswith(b"ply") or end is None:
        raise InputError(
            f"{path}: expected a PLY header from 'ply' to 'end_header', found none; export it again as PLY"
        )
    texts = [decoded(line) for line in data[: end.start()].splitlines()]
    lines = [text.split() for text in texts]
    try:
        encoding = next(words[1] for words in lines if words[:1] == ["format"])
        order = _BYTE_ORDERS[encoding]
        elements = _read_elements(lines, order)
    except (StopIteration, LookupError, ValueError) as error:
        raise InputError(
            f"{path}: expected a PLY header with a known format, elements and property types, "
            f"found {str(error) or 'no format'}; export it again as binary PLY"
        ) from error
    ELEMENTS.check(sum(1 + len(element.properties) for element in elements), path)
    comments = [text.strip().removeprefix("comment").strip() for text in texts if text.split()[:1] == ["comment"]]
    # The header ends with one line end, which is CR LF only where the other lines end so too: after a bare CR, an LF is
    # the first byte of the body.
    is_pair = end[1] == b"\n" and data[end.end() :][:2] == b"\r\n"
    size = end.end() + (2 if is_pair else 1)
    if order != "ascii":
        return elements, comments, np.frombuffer(data, np.uint8, offset=min(size, len(data)))
    try:
        numbers = np.array(list(map(float, data[size:].split())), np.float64)
    except ValueError as error:
        raise InputError(f"{path}: expected numbers after the header, found {error!r:.80}; export it again") from error
    return elements, comments, numbers.view(np.uint8)


def _read_elements(lines: list[list[str]], order: str) -> list[_Element]:
    """Parse the `element` and `property` lines of a header; `order` is the byte order as NumPy writes it, or ascii."""

    def stored(name: str) -> np.dtype:
        kind = _TYPES[name]
        return np.dtype(np.float64 if order == "ascii" else order + kind)

    elements: list[_Element] = []
    for words in lines:
        if words[:1] == ["element"]:
            if int(words[2]) < 0:
                raise ValueError(f"an element of {words[2]} rows")
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"]:
            count, kind, name = words[2:5] if words[1] == "list" else (None, *words[1:3])
            declared = np.dtype(_TYPES[kind])
            white = 1.0 if declared.kind == "f" else float(np.iinfo(declared).max)
            new = _Property(name, stored(kind), None if count is None else stored(count), white)
            last = elements.pop()
            elements.append(_Element(last.name, last.length, (*last.properties, new)))
    return elements


def _read_body(elements: list[_Element], body: np.ndarray, path: Path) -> _Columns:
    columns: _Columns = {}
    start = 0
    for element in elements:
        # Tested before anything is allocated: the header of a damaged file may declare any number of rows.
        fewest = element.length * sum((p.dtype if p.count is None else p.count).itemsize for p in element.properties)
        found = None
        if start + fewest <= len(body):
            found = _read_uniform(element, body, start) if element.length and element.properties else None
            found = found or _read_rows(element, body, start)
        if found is None:
            raise damaged(path, f"{element.length} rows of element '{element.name}'", "the file cut short")
        values, start = found
        columns[element.name] = {p.name: column for p, column in zip(element.properties, values, strict=True)}
    return columns


def _read_uniform(element: _Element, body: np.ndarray, start: int) -> tuple[list[_Column], int] | None:
    """Read an element whose lists have the same length in every row; None where they do not.

    All rows then have the layout of the first, so that no Python loop is needed. Returns the columns, and the place
    after the element.
    """
    first = _read_rows(_Element(element.name, 1, element.properties), body, start)
    if first is None:
        return None
    sizes, fields = [len(column.values) for column in first[0]], []
    for k, (p, size) in enumerate(zip(element.properties, sizes, strict=True)):
        fields += [(f"count {k}", p.count)] if p.count is not None else []
        fields.append((f"values {k}", p.dtype, (size,)))
    layout = np.dtype(fields)
    stop = start + layout.itemsize * element.length
    if stop > len(body):
        return None
    rows, columns = body[start:stop].view(layout), []
    for k, (p, size) in enumerate(zip(element.properties, sizes, strict=True)):
        counts = None if p.count is None else np.full(element.length, size)
        if counts is not None and (rows[f"count {k}"] != counts).any():
            return None
        columns.append(_Column(np.ascontiguousarray(rows[f"values {k}"]).reshape(-1), p.white, counts))
    return columns, stop


def _read_rows(element: _Element, body: np.ndarray, start: int) -> tuple[list[_Column], int] | None:
    """Read an element row by row; returns its columns and the place after it, None where the body ends too early."""
    values: list[list[np.ndarray]] = [[np.zeros(0, p.dtype)] for p in element.properties]
    counts: list[list[int]] = [[] for _ in element.properties]
    for _ in range(element.length if element.properties else 0):
        for k, p in enumerate(element.properties):
            count = 1
            if p.count is not None:
                length = body[start : start + p.count.itemsize]
                start += p.count.itemsize
                # The length is a number of the file: a negative or absurd one means damage.
                if start > len(body) or not 0 <= (found := length.view(p.count)[0]) <= len(body):
                    return None
                count = int(found)
                counts[k].append(count)
            stop = start + count * p.dtype.itemsize
            if stop > len(body):
                return None
            values[k].append(body[start:stop].view(p.dtype))
            start = stop
    columns = [
        _Column(np.concatenate(values[k]), p.white, np.array(counts[k], int) if p.count is not None else None)
        for k, p in enumerate(element.properties)
    ]
    return columns, start
