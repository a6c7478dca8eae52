"""The USD file that a mesh was read from, which is written again in a child process (see `rewrite`)."""

from __future__ import annotations

import dataclasses
import glob
import itertools
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.mesh import Mesh
from ..atomic import scratch_folder
from ..child_process import Limits, child_result
from ..guarded import Values, hand_over_mesh

REWRITER = "mimesh.io.usd.child:rewrite"
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MOST_LAYERS = 1000
"""Files of the folders around a layer that are looked at."""


@dataclass(frozen=True)
class PrimRange:
    """The part of a joined Mesh that came from one prim: `vertices[start:stop]` and the faces from `first_face` on."""

    prim: str
    """Prim path."""
    start: int
    stop: int
    first_face: int
    corner_of: Int[np.ndarray, "F 3"] = field(repr=False)
    """Index of each face corner in the prim's `faceVertexIndices`; its length is the number of faces."""
    is_mirrored: bool
    """Whether the prim's world transform had a negative determinant, which reverses the winding of faces."""


@dataclass(frozen=True, eq=False)
class UsdSource:
    """The USD file that a Mesh was read from. Satisfies `mesh.Source`; the file is opened again for writing."""

    path: Path
    suffix: str
    vertices: Float[np.ndarray, "V 3"] = field(repr=False)
    """World positions as they were read."""
    sizes: Int[np.ndarray, " P"] = field(repr=False)
    """Corners of each polygon; the faces are triangle fans of them."""
    ranges: tuple[PrimRange, ...] = field(repr=False)
    """The prims that were read, in the order of their vertices."""
    at_default_time: bool
    """Whether the rest shape was read at the default time; else at `first`."""
    first: float
    """First time code."""
    up_axis: str
    """The token Y or Z."""
    meters_per_unit: float
    notes: tuple[str, ...]
    """One line for each thing of the file that a written file lacks or stores differently."""

    @property
    def details(self) -> tuple[tuple[str, str], ...]:
        """Rows of name and value for `mimesh look`: the stage's unit and up axis."""
        return (("unit", f"{self.meters_per_unit:g} m, {self.up_axis.lower()} up"),)

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write the file with the points of `mesh`, in the format of `path`'s suffix (see `rewrite.write_again`).

        Raises:
            InputError: the original file is missing, no longer has the prims that were read, or has been damaged.
        """
        if mesh.vertices.shape != self.vertices.shape or len(mesh.faces) != (self.sizes - 2).sum():
            raise ValueError(f"the file has vertices {self.vertices.shape}, the mesh {mesh.vertices.shape}")
        if not self.path.is_file():
            raise InputError(f"{self.path}: expected the file that was read, found none; put it back to write its copy")
        moved = dataclasses.replace(mesh, corner_uv=None, vertex_colors=None, parts=(), source=None)
        limits = Limits.for_size(layer_bytes(self.path) + mesh.vertices.nbytes)
        with scratch_folder() as folder:
            request = folder / "request"
            hand_over_mesh(request, moved, self.values())
            try:
                with child_result(REWRITER, self.path, self.path, limits, request=str(request), output=str(path)):
                    pass
            finally:
                # The library saves under a name of its own beside `path`: a child that was ended leaves that.
                for leftover in path.parent.glob(f"{glob.escape(path.stem)}*"):
                    if leftover != path:
                        leftover.unlink(missing_ok=True)

    def values(self) -> Values:
        """Return all fields as arrays and JSON values, for another process."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        described = [[r.prim, r.start, r.stop, r.first_face, len(r.corner_of), r.is_mirrored] for r in self.ranges]
        corners = np.concatenate([np.zeros((0, 3), np.int64), *(r.corner_of for r in self.ranges)])
        return fields | {"path": str(self.path), "ranges": described, "corner_of": corners}

    @classmethod
    def from_values(cls, values: Values) -> UsdSource:
        """Make a source of what `values` returns."""
        corners, ranges = values["corner_of"], []
        for prim, start, stop, first_face, count, is_mirrored in values["ranges"]:
            ranges.append(PrimRange(prim, start, stop, first_face, corners[:count], is_mirrored))
            corners = corners[count:]
        fields = {field.name: values[field.name] for field in dataclasses.fields(cls)}
        read = {"path": Path(values["path"]), "ranges": tuple(ranges), "notes": tuple(values["notes"])}
        return cls(**(fields | read))


def layer_bytes(path: Path) -> int:
    """Return the bytes of a layer and of those in its folder and the folders in that, which it may be composed of."""
    files = itertools.islice(itertools.chain(path.parent.glob("*"), path.parent.glob("*/*")), MOST_LAYERS)
    sizes = [file.stat().st_size for file in files if file.suffix.lower() in SUFFIXES and file.is_file()]
    return max(sum(sizes), path.stat().st_size)
