"""Read PLY files in all three encodings (ASCII, little and big endian), and write new binary ones."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.budgets import CORNERS
from ..core.errors import InputError
from ..core.geometry import unit_vectors
from ..core.mesh import Material, Mesh, Part
from .atomic import whole_file
from .beside import is_there
from .colors import linear_rgba, srgb_rgba
from .mtl import read_image, write_image
from .ply_layout import PlyColumn, PlyHeader, gather, locate_columns, read_header, read_units
from .polygons import PolygonSource, fan_corners, polygon_corners, polygon_sizes, smooth_normals
from .text import encoded

_COLOR_NAMES = ("red", "green", "blue", "alpha")
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
"""Names of texture coordinates of vertices; PLY does not standardise them, and exporters differ."""
ROUNDING = 1e-6
"""Largest rounding of a written vertex, as a fraction of the mesh's longest side; double precision where it is more."""


def read_ply(path: Path) -> Mesh:
    """Read a PLY file: vertices in the file's order, polygons as triangle fans; without faces it is a point cloud.

    Read are normals (nx ny nz), texture coordinates per vertex (s t, u v, texture_u texture_v) or per face corner
    (texcoord), colours per vertex (red green blue, alpha, taken as sRGB-encoded), and the image of a `comment
    TextureFile`. All else (confidence, other elements) is left out. Triangle strips are not supported.

    Raises:
        InputError: the header or body is damaged or truncated, or there is no x, y, z.
    """
    data = path.read_bytes()
    header = read_header(data, path)
    units = read_units(data, header, path)
    columns = locate_columns(header, units, path)
    vertices = _read_points(columns, units, ("x", "y", "z"))
    if vertices is None:
        raise InputError(f"{path}: expected an element 'vertex' with x, y, z, found none; export it again")
    polygons = _polygon_column(columns, path)
    sizes = polygons.counts if polygons is not None and polygons.counts is not None else np.zeros(0, int)
    CORNERS.check(int(sizes.max(initial=0)), path)
    corners = gather(units, polygons).astype(np.int64) if polygons is not None else np.zeros(0, np.int64)
    triangles, _ = fan_corners(sizes)
    faces = corners[triangles]
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        worst = faces.max() if faces.max() >= len(vertices) else faces.min()
        raise InputError(
            f"{path}: expected face indices in 0..{len(vertices) - 1}, found {worst}; "
            "the file is damaged, export it again"
        )
    normals = _read_points(columns, units, ("nx", "ny", "nz"))
    normals = unit_vectors(normals) if normals is not None else None
    return Mesh(
        vertices,
        faces,
        name=path.stem,
        corner_uv=_read_uv(columns, units, faces, triangles, sizes),
        corner_normals=normals[faces] if normals is not None and len(faces) else None,
        vertex_colors=_read_colors(columns["vertex"], units),
        parts=_read_texture(header, path, len(faces)),
        source=PolygonSource(".ply", sizes),
    )


def write_ply(mesh: Mesh, path: Path) -> None:
    """Write any mesh as a new binary PLY file: positions, normals, colours, polygons and corner texture coordinates.

    Normals are written where all corners of a vertex share one, colours as sRGB-encoded bytes, the image of the only
    material as `comment TextureFile`, beside the file. Other parts and materials are not written.
    """
    sizes, normals = polygon_sizes(mesh), smooth_normals(mesh)
    count = "uchar" if 2 * sizes.max(initial=0) < 256 else "int"  # type of list lengths; texcoord has two per corner
    kind, dtype = ("float", "<f4") if _fits_single(mesh.vertices) else ("double", "<f8")
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
    header = ["ply", "format binary_little_endian 1.0", *_texture_comment(mesh, path)]
    header += [f"element vertex {len(rows)}", *itertools.chain(*(lines for _, _, lines in columns.values()))]
    if len(sizes):
        header += [f"element face {len(sizes)}", f"property list {count} int vertex_indices"]
        header += [f"property list {count} float texcoord"] if mesh.corner_uv is not None else []
    with whole_file(path) as temporary:
        text = encoded("\n".join([*header, "end_header", ""]))
        temporary.write_bytes(text + rows.tobytes() + _polygon_bytes(mesh, sizes, count))


def _fits_single(vertices: Float[np.ndarray, "V 3"]) -> bool:
    """Whether single precision moves no vertex by more than `ROUNDING` of the mesh's longest side."""
    with np.errstate(over="ignore"):
        error = np.abs(vertices.astype(np.float32) - vertices).max(initial=0.0)
    return bool(error <= ROUNDING * np.ptp(vertices, axis=0).max(initial=0.0))


def _texture_comment(mesh: Mesh, path: Path) -> list[str]:
    """Write the image of a mesh with one textured material beside its file; return the comment that names it."""
    materials = {part.material for part in mesh.parts}
    material = materials.pop() if len(materials) == 1 else None
    if material is None or material.texture is None or mesh.corner_uv is None:
        return []
    return [f"comment TextureFile {write_image(material.texture, path.parent, material.name)}"]


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


def _read_points(columns, units: np.ndarray, names: tuple[str, str, str]) -> Float[np.ndarray, "V 3"] | None:
    """Read three properties of the vertex element as vectors; None where one of them is missing or a list."""
    vertex = columns.get("vertex", {})
    if not all(name in vertex and vertex[name].counts is None for name in names):
        return None
    return np.stack([gather(units, vertex[name]).astype(np.float64) for name in names], axis=1)


def _polygon_column(columns, path: Path) -> PlyColumn | None:
    """Return the column with the vertex indices of the faces; None for a point cloud.

    Raises:
        InputError: faces are stored as triangle strips or without a list of vertex indices.
    """
    if "tristrips" in columns:
        raise InputError(f"{path}: expected polygons, found triangle strips; export it again with plain faces")
    face = columns.get("face", {})
    for name in ("vertex_indices", "vertex_index"):
        if name in face and face[name].counts is not None:
            return face[name]
    if any(len(column.starts) for column in face.values()):
        raise InputError(f"{path}: expected faces with a list vertex_indices, found {', '.join(face)}; export it again")
    return None


def _read_uv(columns, units: np.ndarray, faces, triangles, sizes) -> Float[np.ndarray, "F 3 2"] | None:
    """Read texture coordinates per face corner, else per vertex; None where the file has neither."""
    vertex, texcoord = columns["vertex"], columns.get("face", {}).get("texcoord")
    if texcoord is not None and texcoord.counts is not None and len(sizes) and (texcoord.counts == 2 * sizes).all():
        return gather(units, texcoord).astype(np.float64).reshape(-1, 2)[triangles]
    for pair in _UV_NAMES:
        if len(faces) and all(name in vertex and vertex[name].counts is None for name in pair):
            return np.stack([gather(units, vertex[name]).astype(np.float64) for name in pair], axis=1)[faces]
    return None


def _read_colors(vertex: dict[str, PlyColumn], units: np.ndarray) -> Float[np.ndarray, "V 4"] | None:
    """Read linear RGBA of the vertices; integers are scaled by the largest value of their type, floats are 0..1."""
    names = [name for name in _COLOR_NAMES if name in vertex and vertex[name].counts is None]
    if names[:3] != list(_COLOR_NAMES[:3]):
        return None
    values = [gather(units, vertex[name]) / _white_level(vertex[name].dtype) for name in names]
    return linear_rgba(np.stack(values, axis=1).astype(np.float64))


def _white_level(dtype: np.dtype) -> float:
    """Return the value of full intensity in a colour channel of this type."""
    return 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max)


def _read_texture(header: PlyHeader, path: Path, faces: int) -> tuple[Part, ...]:
    """Read the image of `comment TextureFile`, if there is one, as one part with a material."""
    names = [comment.split(None, 1)[1] for comment in header.comments if comment.startswith("TextureFile ")]
    found = [name for name in names if is_there(path.parent / name)]
    if not found or not faces:
        return ()
    material = Material(Path(found[0]).stem, (1.0, 1.0, 1.0, 1.0), read_image(path.parent / found[0]))
    return (Part(path.stem, 0, faces, material),)
