"""Hand-written OBJ files with unusual statements, and helpers that the format tests share."""

from __future__ import annotations

import numpy as np

# Quads, an n-gon, triangles, two materials, groups, objects, a UV seam, hard edges, negative indices, vertex colours,
# a fourth coordinate, lines, points, smoothing groups, a continued line, tabs, indents, comments, unknown statements.
# The normals are those of their (flat) faces.
NASTY_OBJ = rb"""# Exported by hand # twice \
mtllib looks.mtl
mtllib my looks.mtl

o House
v 0 0 0 1.0 0.5 0.25
v 1.000000 0 0 0 0 0
v	1 1 0	0.1 0.2 0.3   # corner
v 0 1 0
  v 0.0 0.0 1.0 1.0
v 1 0 1e0
v 1 1 \
  1
v 0 1 1
v 0 2.25 0.5
vt 0 0
vt 1 0 0
vt 1 1
vt 0 1
vt 0.5 0.5
vn 0 0 -2
vn 0 0 1
vn 0 -1.0 0 # down
g walls front
usemtl Brick
s off
f 1/1/1 4/4/1 3/3/1 2/2/1
f	5/1/2  6/2/2	7/3/2 8/4/2 # back
s 1
usemtl Plaster
f -9/1/-1 -8/2/-1 -4/3/-1 -5/4/-1
vp 0.1 0.2
f 1//4 5//4 8//4 9//4 4//4
vn -1 0 0.0
o Lid
f 3 7 6 2
f 4/3 9/5 8/1 \
  7/2 3/4
f 4/3 9/5 8
l 1 2 3 -1
p 9
custom statement v 1 2 3
usemtl
f 1 2 9
# v 9 9 9"""

CUBE_SHARED_NORMALS = b"""o cube
v 0 0 0
v 0 0 1
v 0 1 0
v 0 1 1
v 1 0 0
v 1 0 1
v 1 1 0
v 1 1 1
vn -1 0 0
vn 1 0 0
vn 0 -1 0
vn 0 1 0
vn 0 0 -1
vn 0 0 1
f 1//1 2//1 4//1 3//1
f 5//2 7//2 8//2 6//2
f 1//3 5//3 6//3 2//3
f 3//4 4//4 8//4 7//4
f 1//5 3//5 7//5 5//5
f 2//6 6//6 8//6 4//6
"""

# Two sheets of two triangles that share one vn within each sheet, in blocks, the second with negative indices.
SHEETS_SHARED_NORMALS = b"""v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vn 0 0 1
f 1//1 2//1 3//1
f 1//1 3//1 4//1
v 3 0 0
v 4 0 0
v 4 0 1
v 3 0 1
vn 0 -1 0
f -4//-1 -3//-1 -2//-1
f 5//2 7//2 8//-1 # 5//2
"""


def naive_obj(data: bytes) -> tuple[list, list, dict]:
    """Parse an OBJ file line by line; return vertices, polygons, and the unit normal of each (polygon, vertex)."""
    vertices, normals, polygons, index_of = [], [], [], {}
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").replace(b"\r\n", b"\n").split(b"\n"):
        words = line.split(b"#")[0].split()
        if words[:1] == [b"v"]:
            vertices.append([float(word) for word in words[1:4]])
        if words[:1] == [b"vn"]:
            normals.append(np.array([float(word) for word in words[1:4]]))
        if words[:1] == [b"f"]:
            polygons.append([])
            for word in words[1:]:
                v, _, n = (int(index or 0) for index in (word + b"//").split(b"/")[:3])
                v = v + len(vertices) if v < 0 else v - 1
                n = n + len(normals) if n < 0 else n - 1
                index_of[len(polygons) - 1, v] = n
                polygons[-1].append(v)
    file_normals = {key: normals[n] / np.linalg.norm(normals[n]) for key, n in index_of.items() if n >= 0}
    return vertices, polygons, file_normals


def fan_triangles(polygon: list[int]) -> list[tuple[int, int, int]]:
    """Triangulate a polygon of vertex indices as a fan around its first corner."""
    return [(polygon[0], polygon[i], polygon[i + 1]) for i in range(1, len(polygon) - 1)]


def triangles_of(polygons: list) -> tuple[list, list]:
    """Triangulate polygons as fans; return the triangles and the polygon of each."""
    pairs = [(triangle, i) for i, polygon in enumerate(polygons) for triangle in fan_triangles(polygon)]
    return [triangle for triangle, _ in pairs], [i for _, i in pairs]


def bend(vertices: np.ndarray) -> np.ndarray:
    """Deform points smoothly and nowhere rigidly."""
    x, y, z = vertices.T
    return np.stack([x + 0.3 * np.sin(2 * y), 1.2 * y + 0.1 * x * z, z - 0.25 * x * y + 0.1], axis=1)


def rotation(angle: float = 0.7) -> np.ndarray:
    """Return a rotation matrix (angle in radians) whose axis is not a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return about_z @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def triangle_soup(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the corner positions of the triangles as sorted rows, equal for all vertex orders of a mesh."""
    rows = np.round(np.asarray(vertices)[np.asarray(faces)].reshape(-1, 9), 5) + 0.0
    return rows[np.lexsort(rows.T)]
