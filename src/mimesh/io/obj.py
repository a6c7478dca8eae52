"""Wavefront OBJ: read a mesh, keep the file, and write new files. `obj_source.py` gives the kept file back, moved."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.geometry import unit_vectors, vertex_normals
from ..core.mesh import Material, Mesh, Part
from . import mtl
from .atomic import whole_file
from .beside import is_there
from .colors import linear_rgba, srgb_rgba
from .obj_source import ObjSource
from .polygons import fan_corners, polygon_sizes, polygons_of
from .text import decoded, line_number, read_numbers, without_comments

_KEYWORDS = (b"v", b"vt", b"vn", b"f", b"o", b"g", b"usemtl", b"mtllib")
_COMPLETE = (b"/0/0", b"/0", b"")  # what a corner such as 7, 7/8 or 7/8/9 lacks of three indices


def read_obj(path: Path) -> Mesh:
    """Read an OBJ file: vertices in the file's order and count, polygons as triangle fans, looks if the .mtl is there.

    Parts are runs of faces under one `o` or `g` and one `usemtl`. Six numbers after `v` are a point and its colour,
    sRGB-encoded, in 0..1 or, if any is above 1, in 0..255. The rest of the file (n-gons, lines, points, smoothing,
    comments, unknown statements) is kept in `source`. Where only some corners have a texture coordinate the others get
    (0, 0); where only some have a normal the others get their vertex's; where only some vertices have a colour the
    others are white.

    Raises:
        InputError: a number or an index that cannot be read or is out of range; the line is named.
    """
    source = _read_source(path)
    triangles, polygon = fan_corners(source.sizes)
    faces, uv_index, normal_index = (source.corners[triangles, k] for k in range(3))
    return Mesh(
        source.vertices,
        faces,
        name=path.stem,
        corner_uv=_corner_uv(source, uv_index, path),
        corner_normals=_corner_normals(source, faces, normal_index),
        vertex_colors=_vertex_colors(source, path),
        parts=_read_parts(source, polygon, path),
        source=source,
    )


def read_obj_points(path: Path, like: ObjSource) -> Float[np.ndarray, "V 3"] | None:
    """Only the vertices of an OBJ file whose face lines are those of `like`; None where they differ."""
    lines = path.read_bytes().splitlines(keepends=True)
    index = [i for i, line in enumerate(lines) if line[:2] in (b"v ", b"v\t")]
    faces = [line for line in lines if line[:2] in (b"f ", b"f\t")]
    # Equal text is equal topology unless indices are relative; an indented or continued line fails this test too.
    same = faces == [like.lines[i] for i in like.face_lines] and not any(b"-" in line for line in faces)
    if not same or len(index) != len(like.vertices):
        return None
    return read_numbers(lines, index, 1, 3, path)


def write_obj(mesh: Mesh, path: Path) -> None:
    """Write any mesh as a new OBJ file of polygons, with `<name>.mtl` and its images beside it if it has materials."""
    lines = [f"o {mtl.safe_name(mesh.name)}"]
    called = mtl.material_names(mesh)
    if any(part.material for part in mesh.parts):
        library = mtl.write_library(mesh, path.with_suffix(".mtl"))
        lines.insert(0, f"mtllib {library.name}")
    points = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.astype(np.float64).tolist()]
    if mesh.vertex_colors is not None:
        colors = srgb_rgba(mesh.vertex_colors)[:, :3].tolist()  # an OBJ has no alpha
        points = [f"{point} {r:.6g} {g:.6g} {b:.6g}" for point, (r, g, b) in zip(points, colors, strict=True)]
    lines += points
    uv, uv_index = _distinct(mesh.corner_uv)
    normals, normal_index = _distinct(mesh.corner_normals)
    lines += [f"vt {u!r} {v!r}" for u, v in uv.tolist()]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in normals.tolist()]
    polygons = polygons_of(mesh, _corner_words(mesh.faces, uv_index, normal_index))
    starts = np.cumsum(polygon_sizes(mesh) - 2) - (polygon_sizes(mesh) - 2)  # each polygon's first triangle
    grouped = False
    for part in mesh.parts or (Part("", 0, len(mesh.faces)),):
        grouped = grouped or bool(part.name)  # from then on a part without a name has to say so
        lines += [f"g {mtl.safe_name(part.name or mtl.DEFAULT)}"] if grouped else []
        lines += [f"usemtl {called[part.material] if part.material else mtl.DEFAULT}"] if called else []
        first, last = np.searchsorted(starts, [part.start, part.stop]).tolist()
        lines += ["f " + " ".join(polygon) for polygon in polygons[first:last]]
    with whole_file(path) as temporary:
        temporary.write_bytes("\n".join([*lines, ""]).encode())


def _read_source(path: Path) -> ObjSource:
    lines = _logical_lines(path.read_bytes())
    found = _find_keywords(lines)
    sizes, raw = _read_corners(lines, found[b"f"], path)
    corner_lines = np.repeat(np.array(found[b"f"], int), sizes)
    definitions = [np.array(found[word], int) for word in (b"v", b"vt", b"vn")]
    corners = [_absolute(raw[:, k], definitions[k], corner_lines, lines, path) for k in range(3)]
    if len(raw) and corners[0].min() < 0:
        bad = int(corner_lines[corners[0].argmin()])
        raise InputError(
            f"{path}: expected vertex indices from 1, found 0 in line {line_number(lines, bad)}; export again"
        )
    materials, companions = mtl.read_libraries(path.parent, _library_names(lines, found[b"mtllib"], path.parent))
    return ObjSource(
        path=path,
        lines=lines,
        vertex_lines=definitions[0],
        normal_lines=definitions[2],
        uv_lines=definitions[1],
        face_lines=np.array(found[b"f"], int),
        state_lines=sorted(found[b"o"] + found[b"g"] + found[b"usemtl"]),
        vertices=read_numbers(lines, found[b"v"], 1, 3, path),
        normals=unit_vectors(read_numbers(lines, found[b"vn"], 1, 3, path)),
        sizes=sizes,
        corners=np.stack(corners, axis=1),
        relative_normals=raw[:, 2] < 0,
        materials=materials,
        companions=companions,
    )


def _find_keywords(lines: Sequence[bytes]) -> dict[bytes, list[int]]:
    """Which lines begin with each of the keywords that are read."""
    starts: defaultdict[bytes, list[int]] = defaultdict(list)
    for number, line in enumerate(lines):
        starts[line[:2]].append(number)  # for most lines this is the keyword already, and twice as fast as splitting
    found: dict[bytes, list[int]] = {word: [] for word in _KEYWORDS}
    for start, numbers in starts.items():
        if start in (b"v ", b"f "):
            found[start[:1]] += numbers
            continue
        for number in numbers:
            words = lines[number].split(None, 1)
            # A file may begin with a byte order mark, and a line may be continued right behind its keyword.
            word = words[0].removeprefix(b"\xef\xbb\xbf").removesuffix(b"\\") if words else b""
            if word in found:
                found[word].append(number)
    return {word: sorted(numbers) for word, numbers in found.items()}


def _logical_lines(data: bytes) -> list[bytes]:
    """Lines with their ends; a line that ends in a backslash is joined with the next (a comment is not)."""
    lines = data.splitlines(keepends=True)
    if b"\\\n" not in data and b"\\\r" not in data:
        return lines
    joined: list[bytes] = []
    continued = False
    for line in lines:
        if continued:
            joined[-1] += line
        else:
            joined.append(line)
        continued = line.rstrip(b"\r\n").endswith(b"\\") and b"#" not in joined[-1]
    return joined


def _read_corners(
    lines: Sequence[bytes], index: Sequence[int], path: Path
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, "C 3"]]:
    """Corner count of each face line and the three raw indices of every corner, 0 where there is none."""
    words = [line.split()[1:] for line in without_comments([lines[i] for i in index])]
    sizes = np.array([len(row) for row in words], int)
    try:
        return sizes, _parse_corners(list(chain.from_iterable(words)))
    except (ValueError, IndexError):
        pass  # found again below, to say where
    for i, row in zip(index, words, strict=True):
        try:
            _parse_corners(row)
        except (ValueError, IndexError) as error:
            found = b" ".join(row).decode("utf-8", "replace")[:60]
            raise InputError(
                f"{path}: expected face corners such as 1, 1/2 or 1/2/3 in line {line_number(lines, i)}, "
                f"found {found!r}; the file is damaged, export it again"
            ) from error
    raise AssertionError("corners that fail together fail alone")


def _parse_corners(words: Sequence[bytes]) -> Int[np.ndarray, "C 3"]:
    text = b" ".join([word + _COMPLETE[word.count(b"/")] for word in words]) + b" "
    text = text.replace(b"//", b"/0/").replace(b"/ ", b"/0 ").replace(b"/", b" ")
    return np.array(list(map(int, text.split())), np.int64).reshape(len(words), 3)


def _absolute(raw: Int[np.ndarray, " C"], definitions, corner_lines, lines, path: Path) -> Int[np.ndarray, " C"]:
    """Indices from 0, -1 where there is none; negative ones count back from the face's line."""
    relative = np.searchsorted(definitions, corner_lines) + raw
    index = np.where(raw < 0, relative, raw - 1)
    bad = np.flatnonzero((index >= len(definitions)) | ((raw < 0) & (index < 0)))
    if bad.size:
        where = line_number(lines, int(corner_lines[bad[0]]))
        raise InputError(
            f"{path}: expected indices in 1..{len(definitions)}, found {raw[bad[0]]} in line {where}; "
            "the file is damaged or cut short, export it again"
        )
    return index


def _corner_uv(source: ObjSource, index: Int[np.ndarray, "F 3"], path: Path) -> Float[np.ndarray, "F 3 2"] | None:
    if not (index >= 0).any():
        return None
    uv = read_numbers(source.lines, source.uv_lines.tolist(), 1, 2, path)
    return np.where(index[..., None] >= 0, uv[index], 0.0)


def _corner_normals(source: ObjSource, faces, index: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3 3"] | None:
    if not (index >= 0).any():
        return None
    if (index >= 0).all():
        return source.normals[index]
    return np.where(index[..., None] >= 0, source.normals[index], vertex_normals(source.vertices, faces)[faces])


def _vertex_colors(source: ObjSource, path: Path) -> Float[np.ndarray, "V 4"] | None:
    rows = without_comments([source.lines[i] for i in source.vertex_lines.tolist()])
    colored = np.flatnonzero(np.array([len(row.split()) for row in rows], int) == 7)
    if not len(colored):
        return None
    values = np.ones((len(rows), 3))
    given = read_numbers(source.lines, source.vertex_lines[colored].tolist(), 4, 3, path)
    values[colored] = given / 255 if given.max() > 1 else given
    return linear_rgba(values)


def _read_parts(source: ObjSource, polygon: Int[np.ndarray, " F"], path: Path) -> tuple[Part, ...]:
    """Runs of triangles under one name and material; none where the file has a single unnamed run."""
    runs: list[tuple[int, str, str]] = [(0, "", "")]
    for number, first_face in zip(
        source.state_lines, np.searchsorted(source.face_lines, source.state_lines).tolist(), strict=True
    ):
        keyword, *rest = decoded(source.lines[number].strip()).split(None, 1)
        _, name, material = runs[-1]
        value = rest[0] if rest else ""
        run = (first_face, name, value) if keyword == "usemtl" else (first_face, value, material)
        if run[1:] != runs[-1][1:]:
            runs = [*runs[:-1], run] if runs[-1][0] == first_face else [*runs, run]
    starts = np.searchsorted(polygon, [run[0] for run in runs]).tolist()
    stops = [*starts[1:], len(polygon)]
    parts = [
        Part(name, start, stop, source.materials.get(material, Material(material)) if material else None)
        for (_, name, material), start, stop in zip(runs, starts, stops, strict=True)
        if start < stop
    ]
    return () if parts == [Part("", 0, len(polygon))] else tuple(parts)


def _library_names(lines: Sequence[bytes], index: Sequence[int], folder: Path) -> list[str]:
    """Names after `mtllib`: one name with spaces if such a file exists, else one per word."""
    names: list[str] = []
    for number in index:
        rest = decoded(lines[number].strip()).split(None, 1)[1:]
        for name in (text.replace("\\", "/") for text in rest):
            names += [name] if is_there(folder / name) else name.split()
    return names


def _distinct(values) -> tuple[np.ndarray, np.ndarray | None]:
    """The distinct rows of corner values and each corner's row; nothing where there are none."""
    if values is None:
        return np.zeros((0, 3)), None
    flat, index = np.unique(values.reshape(-1, values.shape[-1]).astype(np.float64), axis=0, return_inverse=True)
    return flat, index.reshape(values.shape[:2])


def _corner_words(faces, uv_index, normal_index) -> np.ndarray:
    def words(index) -> list[str]:
        return [""] * faces.size if index is None else [str(i) for i in (index.ravel() + 1).tolist()]

    ending = {(True, True): "{}", (False, True): "{}/{}", (True, False): "{}//{}", (False, False): "{}/{}/{}"}
    pattern = ending[uv_index is None, normal_index is None]
    columns = [words(index) for index in (faces, uv_index, normal_index) if index is not None]
    return np.array([pattern.format(*row) for row in zip(*columns, strict=True)], object)
