"""An OBJ file kept whole, and written back with nothing but its points and normals moved."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.mesh import Material, Mesh
from .polygons import fan_corners, scatter_corners
from .text import replace_rows

_CORNER_WITH_NORMAL = re.compile(rb"(-?\d+/-?\d*/)(-?\d+)")


@dataclass(frozen=True, eq=False)
class ObjSource:
    """The lines of an OBJ file and what was read from them. Satisfies `mesh.Source`."""

    path: Path
    lines: list[bytes]
    """Logical lines with their line ends; continued lines are one. Joined, they are the file."""
    vertex_lines: Int[np.ndarray, " V"]
    uv_lines: Int[np.ndarray, " U"]
    normal_lines: Int[np.ndarray, " N"]
    face_lines: Int[np.ndarray, " P"]
    state_lines: list[int]
    """Lines of `o`, `g` and `usemtl`, which hold for the faces that follow."""
    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "N 3"]
    """The `vn` lines at length one."""
    sizes: Int[np.ndarray, " P"]
    corners: Int[np.ndarray, "C 3"]
    """Vertex, texture and normal index of each polygon corner, from 0; -1 where there is none."""
    relative_normals: Bool[np.ndarray, " C"]
    """Whether the corner's normal is counted back from its line (a negative index)."""
    materials: dict[str, Material] = field(default_factory=dict)
    companions: list[str] = field(default_factory=list)
    """Material libraries and images that the file refers to and that exist, relative to its folder."""
    suffix = ".obj"

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write the file with the vertices of `mesh`, and its corner normals if the file has any.

        Lines of unmoved vertices and normals keep their text. A `vn` line shared by corners that turned apart is joined
        by new ones, and only then the normal indices of the faces concerned change.
        """
        if mesh.vertices.shape != self.vertices.shape:
            raise ValueError(f"the file has vertices {self.vertices.shape}, the mesh {mesh.vertices.shape}")
        lines = list(self.lines)
        replace_rows(lines, self.vertex_lines, mesh.vertices, self.vertices, skip=1)
        if mesh.corner_normals is not None and len(self.normals):
            self._write_normals(lines, mesh.corner_normals)
        path.write_bytes(b"".join(lines))

    def _write_normals(self, lines: list[bytes], corner_normals: Float[np.ndarray, "F 3 3"]) -> None:
        used = np.flatnonzero(self.corners[:, 2] >= 0)
        index = self.corners[used, 2]
        triangles, _ = fan_corners(self.sizes)
        before = np.zeros((len(self.corners), 3))
        before[used] = self.normals[index]
        wanted = scatter_corners(corner_normals, triangles, before)[used]
        new = self.normals.copy()
        new[index[::-1]] = wanted[::-1]  # the last one written stays: the first corner that uses each line
        rounded = np.where(_apart(new, self.normals), np.round(new, 6), self.normals)
        replace_rows(lines, self.normal_lines, rounded, self.normals, skip=1)
        split = np.flatnonzero(_apart(wanted, new[index])[:, 0])
        if split.size:
            self._split_normals(lines, used, split, wanted)

    def _split_normals(self, lines: list[bytes], used, split, wanted) -> None:
        """Add a `vn` line for each further direction of a shared one, and point the corners concerned at it.

        New lines follow the last `vn` before the next face, so nothing refers forward, and later indices move up.
        """
        index = self.corners[used, 2]
        key = np.concatenate([index[split, None], np.round(wanted[split] * 1e6)], axis=1)
        _, first, extra = np.unique(key, axis=0, return_index=True, return_inverse=True)
        block = np.searchsorted(self.face_lines, self.normal_lines)  # vn lines with no face between them
        blocks = np.concatenate([block, block[index[split[first]]]])
        order = np.argsort(blocks, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        target = place[index]
        target[split] = place[len(block) + extra.reshape(-1)]

        last_of_block = {int(b): int(line) for b, line in zip(block, self.normal_lines, strict=True)}
        for k in split[first].tolist():
            at = last_of_block[int(block[index[k]])]
            text = lines[at].rstrip(b"\r\n")
            end = lines[at][len(text) :] or b"\n"
            x, y, z = wanted[k].tolist()
            lines[at] = text + end + b"vn %.6g %.6g %.6g" % (x, y, z) + end
        changed = (target != index) | self.relative_normals[used]
        self._point_at(lines, used, target, np.unique(self._face_of_corner()[used[changed]]))

    def _point_at(self, lines: list[bytes], used, target, faces) -> None:
        """Rewrite the normal indices of some face lines; other characters stay."""
        number = np.zeros(len(self.corners), np.int64)
        number[used] = target + 1
        stops = np.cumsum(self.sizes)
        for face in faces.tolist():
            corners = number[stops[face] - self.sizes[face] : stops[face]]
            numbers = iter(corners[corners > 0].tolist())
            line = self.face_lines[face]
            lines[line] = _CORNER_WITH_NORMAL.sub(
                lambda match, numbers=numbers: match[1] + b"%d" % next(numbers),
                lines[line],
                count=int((corners > 0).sum()),
            )

    def _face_of_corner(self) -> Int[np.ndarray, " C"]:
        return np.repeat(np.arange(len(self.sizes)), self.sizes)


def _apart(a: Float[np.ndarray, "N 3"], b: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N 1"]:
    """Whether unit vectors differ by more than the digits they are written with."""
    return np.any(np.abs(a - b) > 1e-6, axis=1)[:, None]
