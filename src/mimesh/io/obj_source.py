"""Keep the text of an OBJ file, and write it again with other points and normals and all else as it was."""

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

        Lines of unchanged vertices and normals keep their text. Where corners that share a `vn` statement now differ,
        further `vn` statements are added, and only then the normal indices of those faces change.
        """
        if mesh.vertices.shape != self.vertices.shape:
            raise ValueError(f"the file has vertices {self.vertices.shape}, the mesh {mesh.vertices.shape}")
        lines = list(self.lines)
        replace_rows(lines, self.vertex_lines, mesh.vertices, self.vertices, skip=1)
        if mesh.corner_normals is not None and len(self.normals):
            self._write_normals(lines, mesh.corner_normals)
        path.write_bytes(b"".join(lines))

    def _write_normals(self, lines: list[bytes], corner_normals: Float[np.ndarray, "F 3 3"]) -> None:
        """Set each `vn` statement to the normal of the first corner that uses it, and split those that now differ."""
        used = np.flatnonzero(self.corners[:, 2] >= 0)
        index = self.corners[used, 2]
        triangles, _ = fan_corners(self.sizes)
        before = np.zeros((len(self.corners), 3))
        before[used] = self.normals[index]
        wanted = scatter_corners(corner_normals, triangles, before)[used]
        new = self.normals.copy()
        new[index[::-1]] = wanted[::-1]  # of repeated indices NumPy keeps the last: reversed, that is the first corner
        rounded = np.where(_differ(new, self.normals), np.round(new, 6), self.normals)
        replace_rows(lines, self.normal_lines, rounded, self.normals, skip=1)
        split = np.flatnonzero(_differ(wanted, new[index])[:, 0])
        if split.size:
            self._split_normals(lines, used, split, wanted)

    def _split_normals(self, lines: list[bytes], used, split, wanted) -> None:
        """Add a `vn` statement for each further direction of a shared one, and renumber the normal indices of faces.

        A new statement is appended to the last `vn` line of the block of `vn` lines (no face between them) that
        contains the shared one. So it comes before the faces that use it, and all later `vn` indices grow.

        Args:
            used: corners that have a normal.
            split: those entries of `used` whose normal differs from the one now written for them.
            wanted: normal of each corner in `used`.
        """
        index = self.corners[used, 2]
        # One new statement for each pair of old index and new direction, to the six digits that are written.
        key = np.concatenate([index[split, None], np.round(wanted[split] * 1e6)], axis=1)
        _, first, extra = np.unique(key, axis=0, return_index=True, return_inverse=True)
        # Final numbering: old statements then new ones, sorted stably by block, is the order in the written file.
        block = np.searchsorted(self.face_lines, self.normal_lines)
        blocks = np.concatenate([block, block[index[split[first]]]])
        order = np.argsort(blocks, kind="stable")
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        target = rank[index]
        target[split] = rank[len(block) + extra.reshape(-1)]

        last_of_block = {int(b): int(line) for b, line in zip(block, self.normal_lines, strict=True)}
        for k in split[first].tolist():
            i = last_of_block[int(block[index[k]])]
            text = lines[i].rstrip(b"\r\n")
            end = lines[i][len(text) :] or b"\n"
            x, y, z = wanted[k].tolist()
            lines[i] = text + end + b"vn %.6g %.6g %.6g" % (x, y, z) + end
        changed = (target != index) | self.relative_normals[used]  # relative indices count the new statements too
        self._write_normal_indices(lines, used, target, np.unique(self._face_of_corner()[used[changed]]))

    def _write_normal_indices(self, lines: list[bytes], used, target, faces) -> None:
        """Replace the normal indices in the lines of `faces`; all other characters stay.

        `target` is the new index, from 0, of each corner in `used`.
        """
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


def _differ(a: Float[np.ndarray, "N 3"], b: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N 1"]:
    """Return whether unit vectors differ by more than the six decimal places that are written."""
    return np.any(np.abs(a - b) > 1e-6, axis=1)[:, None]
