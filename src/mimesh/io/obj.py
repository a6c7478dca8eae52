"""Read Wavefront OBJ files, write new ones, and write a file again with other points and all else as it was."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.budgets import CORNERS
from ..core.errors import InputError, damaged
from ..core.geometry import finite_or_zero, unit_vectors, vertex_normals
from ..core.mesh import Material, Mesh, Part
from ..core.printable import plain
from . import mtl
from .atomic import whole_file
from .beside import is_there
from .colors import linear_rgba, srgb_rgba
from .polygons import fan_corners, polygon_sizes, polygons_of
from .text import decoded, encoded, equal_rows, line_number, read_numbers, replace_rows, without_comments

UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_KEYWORDS = (b"v", b"vt", b"vn", b"f", b"o", b"g", b"usemtl", b"mtllib")
"""Statements that are read; all others are only kept in the source."""
_MISSING_INDICES = (b"/0/0", b"/0", b"")
"""What completes a corner with 0, 1 or 2 slashes (7, 7/8, 7/8/9) to three indices; 0 stands for none."""
_CORNER_WITH_NORMAL = re.compile(rb"(-?\d+/-?\d*/)(-?\d+)")
"""A face corner with a normal index, 7/8/9 or 7//9; the second group is that index."""


@dataclass(frozen=True, eq=False)
class ObjSource:
    """The lines of an OBJ file and the values read from them. Satisfies `mesh.Source`."""

    path: Path
    lines: list[bytes]
    """Logical lines with their line ends: continued lines are joined to one. Concatenated, they are the file."""
    vertex_lines: Int[np.ndarray, " V"]
    """Index in `lines` of each `v` statement."""
    uv_lines: Int[np.ndarray, " U"]
    """Index in `lines` of each `vt` statement."""
    normal_lines: Int[np.ndarray, " N"]
    """Index in `lines` of each `vn` statement."""
    face_lines: Int[np.ndarray, " P"]
    """Index in `lines` of each `f` statement."""
    state_lines: list[int]
    """Indices of `o`, `g` and `usemtl` statements, which apply to the faces after them."""
    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "N 3"]
    """Values of the `vn` statements, normalised."""
    sizes: Int[np.ndarray, " P"]
    """Corners of each polygon; the faces are triangle fans of them."""
    corners: Int[np.ndarray, "C 3"]
    """Vertex, texture and normal index of each polygon corner, from 0; -1 where there is none."""
    relative_normals: Bool[np.ndarray, " C"]
    """Whether the normal index of the corner is negative in the file, so counts back from the face."""
    materials: dict[str, Material] = field(default_factory=dict)
    """Materials of the libraries that were found, by name."""
    companions: list[str] = field(default_factory=list)
    """Material libraries and images that the file refers to and that exist, relative to its folder."""
    missing_images: list[str] = field(default_factory=list)
    """Names of images that the libraries refer to and that do not exist."""
    suffix = ".obj"

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write the file with the vertices of `mesh`, and its corner normals if the file has any.

        Lines of unchanged vertices keep their text, and so do all normals if none has changed.
        """
        if mesh.vertices.shape != self.vertices.shape:
            raise ValueError(f"the file has vertices {self.vertices.shape}, the mesh {mesh.vertices.shape}")
        lines = list(self.lines)
        replace_rows(lines, self.vertex_lines, mesh.vertices, self.vertices)
        if mesh.corner_normals is not None and len(self.normals):
            self._write_normals(lines, mesh.corner_normals)
        path.write_bytes(b"".join(lines))

    def _write_normals(self, lines: list[bytes], corner_normals: Float[np.ndarray, "F 3 3"]) -> None:
        """Write all `vn` statements anew in the place of the first, one for each direction of each old one.

        Faces get new normal indices where these differ; all their other characters stay.
        """
        used = np.flatnonzero(self.corners[:, 2] >= 0)
        old = self.corners[used, 2]
        triangles, _ = fan_corners(self.sizes)
        before = np.zeros((len(self.corners), 3))
        before[used] = self.normals[old]
        wanted = before.copy()
        wanted[triangles.ravel()] = corner_normals.reshape(-1, 3)  # corners that no triangle has stay
        wanted = wanted[used]
        if not (np.abs(wanted - before[used]) > 1e-6).any():
            return
        key = np.concatenate([old[:, None], np.round(wanted, 6)], axis=1)
        rows, new = np.unique(key, axis=0, return_inverse=True)
        first = self.normal_lines[0]
        end = lines[first][len(lines[first].rstrip(b"\r\n")) :] or b"\n"
        for line in self.normal_lines.tolist():
            lines[line] = b""
        lines[first] = b"".join(b"vn %.6g %.6g %.6g" % (x, y, z) + end for _, x, y, z in rows.tolist())
        number = np.zeros(len(self.corners), np.int64)
        number[used] = new.reshape(-1) + 1
        changed = (number[used] != old + 1) | self.relative_normals[used]
        stops = np.cumsum(self.sizes)
        for face in np.unique(np.repeat(np.arange(len(self.sizes)), self.sizes)[used[changed]]).tolist():
            corners = number[stops[face] - self.sizes[face] : stops[face]]
            numbers = iter(corners[corners > 0].tolist())
            line = self.face_lines[face]
            lines[line] = _CORNER_WITH_NORMAL.sub(
                lambda match, numbers=numbers: match[1] + b"%d" % next(numbers),
                lines[line],
                count=int((corners > 0).sum()),
            )


def read_obj(path: Path) -> Mesh:
    """Read an OBJ file: vertices in the file's order, polygons as triangle fans, materials of the .mtl files found.

    A part is a run of faces under one `o` or `g` and one `usemtl`. Six numbers after `v` are a point and its colour,
    sRGB-encoded, in 0..1 or, if any is above 1, in 0..255. The rest of the file (n-gons, lines, points, smoothing
    groups, comments, unknown statements) is kept in `source`. Missing values are filled in where others have them:
    texture coordinates with (0, 0), normals with those of the vertex, colours with white; a missing v is 0.

    Raises:
        InputError: a number or an index cannot be read or is out of range; the message has its line.
    """
    source = _read_source(path)
    triangles, polygon = fan_corners(source.sizes)
    faces, uv_index, normal_index = (source.corners[triangles, k] for k in range(3))
    corner_uv = corner_normals = None
    if (uv_index >= 0).any():
        uv = finite_or_zero(read_numbers(source.lines, source.uv_lines.tolist(), 1, 2, path, least=1))
        corner_uv = np.where(uv_index[..., None] >= 0, uv[uv_index], 0.0)
    if (normal_index >= 0).any():
        corner_normals = source.normals[normal_index]
        if (normal_index < 0).any():
            of_vertices = vertex_normals(source.vertices, faces)[faces]
            corner_normals = np.where(normal_index[..., None] >= 0, corner_normals, of_vertices)
    return Mesh(
        source.vertices,
        faces,
        name=path.stem,
        corner_uv=corner_uv,
        corner_normals=corner_normals,
        vertex_colors=_vertex_colors(source, path),
        parts=_read_parts(source, polygon, path),
        source=source,
    )


def read_obj_points(path: Path, like: ObjSource) -> Float[np.ndarray, "V 3"] | None:
    """Read only the vertices of an OBJ file whose face lines equal those of `like`; None where they differ.

    This is the fast path for the later frames of a clip: faces are compared as text and not parsed.
    """
    lines = _read_text(path).splitlines(keepends=True)
    vertex_lines = [i for i, line in enumerate(lines) if line[:2] in (b"v ", b"v\t")]
    faces = [line for line in lines if line[:2] in (b"f ", b"f\t")]
    # Equal text is equal topology unless indices are relative; an indented or continued face fails this test too.
    is_same = faces == [like.lines[i] for i in like.face_lines] and not any(b"-" in line for line in faces)
    continued = any(lines[i].rstrip().endswith(b"\\") for i in vertex_lines)
    if continued or not is_same or len(vertex_lines) != len(like.vertices):
        return None
    return read_numbers(lines, vertex_lines, 1, 3, path)


def write_obj(mesh: Mesh, path: Path) -> None:
    """Write any mesh as a new OBJ file of polygons, with `<name>.mtl` and its images beside it if it has materials."""
    lines = [f"o {mtl.safe_name(mesh.name)}"]
    material_names = mtl.material_names(mesh)
    if any(part.material for part in mesh.parts):
        library = mtl.write_library(mesh, path.with_name(f"{plain(path.stem)}.mtl"))
        lines.insert(0, f"mtllib {library.name}")
    points = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.astype(np.float64).tolist()]
    if mesh.vertex_colors is not None:
        colors = srgb_rgba(mesh.vertex_colors)[:, :3].tolist()  # an OBJ has no alpha
        points = [f"{point} {r:.6g} {g:.6g} {b:.6g}" for point, (r, g, b) in zip(points, colors, strict=True)]
    lines += points
    uv, uv_index = _unique_rows(mesh.corner_uv)
    normals, normal_index = _unique_rows(mesh.corner_normals)
    lines += [f"vt {u!r} {v!r}" for u, v in uv.tolist()]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in normals.tolist()]
    polygons = polygons_of(mesh, _corner_words(mesh.faces, uv_index, normal_index))
    starts = np.cumsum(polygon_sizes(mesh) - 2) - (polygon_sizes(mesh) - 2)  # each polygon's first triangle
    has_group = False
    for part in mesh.parts or (Part("", 0, len(mesh.faces)),):
        # `g` and `usemtl` apply until the next one: after a named part, an unnamed one needs a group of its own.
        has_group = has_group or bool(part.name)
        lines += [f"g {mtl.safe_name(part.name or mtl.DEFAULT)}"] if has_group else []
        material = material_names[part.material] if part.material else mtl.DEFAULT
        lines += [f"usemtl {material}"] if material_names else []
        first, last = np.searchsorted(starts, [part.start, part.stop]).tolist()
        lines += ["f " + " ".join(polygon) for polygon in polygons[first:last]]
    with whole_file(path) as temporary:
        temporary.write_bytes(encoded("\n".join([*lines, ""])))


def _read_source(path: Path) -> ObjSource:
    """Read the lines of an OBJ file and parse its vertices, normals, face corners and material libraries."""
    lines = _logical_lines(_read_text(path))
    line_index = _find_keywords(lines)
    sizes, raw = _read_corners(lines, line_index[b"f"], path)
    corner_lines = np.repeat(np.array(line_index[b"f"], int), sizes)
    definitions = [np.array(line_index[word], int) for word in (b"v", b"vt", b"vn")]
    for k in (1, 2):
        # Some exporters write indices of texture coordinates or normals that they leave out.
        raw[:, k] = raw[:, k] if len(definitions[k]) else 0
    corners = [_absolute_indices(raw[:, k], definitions[k], corner_lines, lines, path) for k in range(3)]
    if len(raw) and corners[0].min() < 0:
        bad = int(corner_lines[corners[0].argmin()])
        raise InputError(
            f"{path}: expected vertex indices from 1, found 0 in line {line_number(lines, bad)}; export again"
        )
    libraries = library_names(lines, line_index[b"mtllib"], path.parent)
    materials, companions, missing = mtl.read_libraries(path.parent, libraries)
    return ObjSource(
        path=path,
        lines=lines,
        vertex_lines=definitions[0],
        normal_lines=definitions[2],
        uv_lines=definitions[1],
        face_lines=np.array(line_index[b"f"], int),
        state_lines=sorted(line_index[b"o"] + line_index[b"g"] + line_index[b"usemtl"]),
        vertices=read_numbers(lines, line_index[b"v"], 1, 3, path),
        normals=unit_vectors(finite_or_zero(read_numbers(lines, line_index[b"vn"], 1, 3, path))),
        sizes=sizes,
        corners=np.stack(corners, axis=1),
        relative_normals=raw[:, 2] < 0,
        materials=materials,
        companions=companions,
        missing_images=missing,
    )


def _read_text(path: Path) -> bytes:
    """Read a file; UTF-16 with a byte order mark, as some shells write it, becomes UTF-8."""
    data = path.read_bytes()
    try:
        return data.decode("utf-16").encode("utf-8") if data.startswith(UTF16_MARKS) else data
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: expected text in UTF-8 or UTF-16, found damage at byte {error.start}; export it again"
        ) from error


def _find_keywords(lines: Sequence[bytes]) -> dict[bytes, list[int]]:
    """Return for each keyword the indices of the lines that begin with it, in file order."""
    # The first two bytes decide most lines without splitting them, which takes a fifth of the time.
    starts = np.array([line[:2] for line in lines], "S2")
    points, faces = starts == b"v ", starts == b"f "
    line_index: dict[bytes, list[int]] = {word: [] for word in _KEYWORDS}
    line_index |= {b"v": np.flatnonzero(points).tolist(), b"f": np.flatnonzero(faces).tolist()}
    for number in np.flatnonzero(~(points | faces)).tolist():
        words = lines[number].split(None, 1)
        # A file may begin with a byte order mark, and a line may be continued right after its keyword.
        word = words[0].removeprefix(b"\xef\xbb\xbf").removesuffix(b"\\") if words else b""
        if word in line_index:
            line_index[word].append(number)
    return {word: sorted(numbers) for word, numbers in line_index.items()}


def _logical_lines(data: bytes) -> list[bytes]:
    """Split a file into lines with their ends; one that ends in a backslash is joined with the next, but no comment."""
    lines = data.splitlines(keepends=True)
    if b"\\\n" not in data and b"\\\r" not in data:
        return lines
    joined: list[bytes] = []
    pieces: list[bytes] = []  # of the logical line so far; joined once, since bytes are copied with every addition
    for line in lines:
        pieces.append(line)
        if b"#" in line or not line.rstrip(b"\r\n").endswith(b"\\"):
            joined.append(b"".join(pieces))
            pieces = []
    return [*joined, b"".join(pieces)] if pieces else joined


def _read_corners(
    lines: Sequence[bytes], index: Sequence[int], path: Path
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, "C 3"]]:
    """Read the corner count of each face line, and the three indices of every corner as written, 0 for none."""
    kept = without_comments([lines[i] for i in index])
    triangles = equal_rows(kept, 3)
    if triangles is not None:
        try:
            return np.full(len(kept), 3), _parse_corners(triangles)
        except (ValueError, IndexError, OverflowError):
            pass  # below
    words = [line.split()[1:] for line in kept]
    sizes = np.array([len(row) for row in words], int)
    CORNERS.check(int(sizes.max(initial=0)), path)
    try:
        return sizes, _parse_corners(list(chain.from_iterable(words)))
    except (ValueError, IndexError, OverflowError):
        pass  # the loop below finds the line for the message
    for i, row in zip(index, words, strict=True):
        try:
            _parse_corners(row)
        except (ValueError, IndexError, OverflowError) as error:
            found = b" ".join(row).decode("utf-8", "replace")[:60]
            expected = f"face corners such as 1, 1/2 or 1/2/3 in line {line_number(lines, i)}"
            raise damaged(path, expected, repr(found)) from error
    raise AssertionError("corners that fail together fail alone")


def _parse_corners(words: Sequence[bytes]) -> Int[np.ndarray, "C 3"]:
    """Parse corners such as 7, 7/8, 7//9 or 7/8/9, all at once: completed to three indices, then split as integers."""
    text = b" ".join(words)
    if b"/" not in text:
        corners = np.zeros((len(words), 3), np.int64)
        corners[:, 0] = list(map(int, words))
        return corners
    text = b" ".join([word + _MISSING_INDICES[word.count(b"/")] for word in words]) + b" "
    text = text.replace(b"//", b"/0/").replace(b"/ ", b"/0 ").replace(b"/", b" ")  # empty indices become 0
    return np.array(list(map(int, text.split())), np.int64).reshape(len(words), 3)


def _absolute_indices(
    raw: Int[np.ndarray, " C"], definitions, corner_lines, lines, path: Path
) -> Int[np.ndarray, " C"]:
    """Convert indices as written to indices from 0, with -1 for a missing one.

    A negative index counts back from the last definition before the face's line; `definitions` are the lines of `v`,
    `vt` or `vn`, `corner_lines` the line of each corner's face.
    """
    index, back = raw - 1, raw < 0
    # The number of definitions before the face's line, found by the line numbers of both.
    index[back] = np.searchsorted(definitions, corner_lines[back]) + raw[back]
    bad = np.flatnonzero((index >= len(definitions)) | ((raw < 0) & (index < 0)))
    if bad.size:
        where = line_number(lines, int(corner_lines[bad[0]]))
        raise damaged(path, f"indices in 1..{len(definitions)}", f"{raw[bad[0]]} in line {where}")
    return index


def _vertex_colors(source: ObjSource, path: Path) -> Float[np.ndarray, "V 4"] | None:
    """Read linear RGBA of vertices with six numbers after `v`; white for the others, None where no vertex has six."""
    rows = without_comments([source.lines[i] for i in source.vertex_lines.tolist()])
    if equal_rows(rows, 3) is not None:
        return None
    colored = np.flatnonzero(np.array([len(row.split()) for row in rows], int) == 7)
    if not len(colored):
        return None
    rgb = np.ones((len(rows), 3))
    file_rgb = read_numbers(source.lines, source.vertex_lines[colored].tolist(), 4, 3, path)
    rgb[colored] = file_rgb / 255 if file_rgb.max() > 1 else file_rgb
    return linear_rgba(rgb)


def _read_parts(source: ObjSource, polygon: Int[np.ndarray, " F"], path: Path) -> tuple[Part, ...]:
    """Return the runs of triangles under one group and material; none where the file has a single unnamed run."""
    runs: list[tuple[int, str, str, str]] = [(0, "", "", "")]  # first polygon, name, material, object
    for number, first_face in zip(
        source.state_lines, np.searchsorted(source.face_lines, source.state_lines).tolist(), strict=True
    ):
        keyword, *arguments = decoded(source.lines[number].strip()).split(None, 1)
        _, name, material, above = runs[-1]
        value = arguments[0] if arguments else ""
        if keyword == "usemtl":
            material = value
        else:
            name, above = value, value if keyword == "o" else above
        run = first_face, name, material, above
        if run[1:] != runs[-1][1:]:
            # Two statements without a face between them begin one run.
            runs = [*runs[:-1], run] if runs[-1][0] == first_face else [*runs, run]
    starts = np.searchsorted(polygon, [run[0] for run in runs]).tolist()
    stops = [*starts[1:], len(polygon)]
    spans = [(run[1:], start, stop) for run, start, stop in zip(runs, starts, stops, strict=True) if start < stop]
    several = len({above for (*_, above), _, _ in spans}) > 1
    parts = []
    for (name, material, above), start, stop in spans:
        look = source.materials.get(material, Material(material)) if material else None
        parts.append(Part(name, start, stop, look, above if several else ""))
    return () if parts == [Part("", 0, len(polygon))] else tuple(parts)


def library_names(lines: Sequence[bytes], index: Sequence[int], folder: Path) -> list[str]:
    """Return the file names after `mtllib`: one name with spaces if such a file exists, else one per word."""
    names: list[str] = []
    for number in index:
        arguments = decoded(lines[number].strip()).split(None, 1)[1:]
        for name in (text.replace("\\", "/") for text in arguments):
            names += [name] if is_there(folder / name) else name.split()
    return names


def _unique_rows(values) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the distinct rows of corner values (F, 3, C) and each corner's row index; no rows and None for None."""
    if values is None:
        return np.zeros((0, 3)), None
    flat, index = np.unique(values.reshape(-1, values.shape[-1]).astype(np.float64), axis=0, return_inverse=True)
    return flat, index.reshape(values.shape[:2])


def _corner_words(faces, uv_index, normal_index) -> np.ndarray:
    """Format each face corner as OBJ text such as 7, 7/8, 7//9 or 7/8/9."""

    def words(index) -> list[str]:
        return [""] * faces.size if index is None else [str(i) for i in (index.ravel() + 1).tolist()]

    patterns = {(True, True): "{}", (False, True): "{}/{}", (True, False): "{}//{}", (False, False): "{}/{}/{}"}
    pattern = patterns[uv_index is None, normal_index is None]
    columns = [words(index) for index in (faces, uv_index, normal_index) if index is not None]
    return np.array([pattern.format(*row) for row in zip(*columns, strict=True)], object)
