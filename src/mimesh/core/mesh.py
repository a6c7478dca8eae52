"""Mesh and Clip, the data that all packages exchange, and the checks of files that were read.

Arrays are NumPy in frozen dataclasses; no function mutates an argument. Axes and unit are those of the file. After
`Normalization.apply`: y up, right-handed, +z front, faces counter-clockwise seen from outside.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from .arguments import as_faces, as_floats, as_frames, as_vertices, check_kind, check_rate
from .budgets import FACES, VERTICES, check_clip_size
from .errors import InputError, damaged, option
from .frame_buffer import Frames, PosedFrames, Progress, each_frame, store_frames
from .geometry import face_areas, first_of_each, normal_turner
from .person_motion import JointSource

UNNAMED = "mesh"
"""Name of meshes that were given none."""


@runtime_checkable
class Source(Protocol):
    """The file that a mesh was read from: what a new file of the mesh takes over from it."""

    @property
    def suffix(self) -> str:
        """Suffix of the file's format, with its dot, in lower case."""
        ...


@runtime_checkable
class RewritableSource(Source, Protocol):
    """A file that can be written again with only the points changed."""

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write the original file to `path` with the positions (and normals) of `mesh`, otherwise unchanged."""
        ...


@dataclass(frozen=True)
class Material:
    """Appearance of a surface, limited to what every format can store."""

    name: str
    base_color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    """Linear RGBA in 0..1."""
    texture: bytes | None = None
    """Content of a PNG or JPEG file; its colours are multiplied by the base colour."""


@dataclass(frozen=True)
class Part:
    """A run of consecutive faces with one name and one material: `mesh.faces[start:stop]`."""

    name: str
    start: int
    stop: int
    material: Material | None = None
    above: str = ""
    """Object that a group is in, of an OBJ file with several objects."""

    @property
    def object(self) -> str:
        """Name of the object that the part is, or is in."""
        return self.above or self.name


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, or a point cloud if it has no faces, and the file it was read from.

    `vertices` keep the order and count of the file, so a format with split vertices (GLB) holds several at one
    position; `geometry.weld` finds them. Polygons are triangulated here and kept in `source`.

    Lists, whole numbers as vertices and whole floats as faces are converted; all else must have the shapes below. The
    numbers in the arrays are checked where a mesh is used.

    Raises:
        InputError: an array of another shape or kind; the message says how to change it.

    Example:
        >>> vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # (V, 3), in any unit
        >>> faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])  # (F, 3)
        >>> mesh = mimesh.Mesh(vertices, faces, "tetrahedron")
        >>> mesh.faces.shape
        (4, 3)
        >>> mimesh.Mesh(vertices).faces.shape  # a point cloud
        (0, 3)
    """

    vertices: Float[np.ndarray, "V 3"]
    """Points in the axes and unit of the file."""
    faces: Int[np.ndarray, "F 3"] = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    """The three vertices of each triangle, counted from 0, counter-clockwise seen from outside."""
    name: str = UNNAMED
    """Name in messages, and of the mesh in files that have names."""
    corner_uv: Float[np.ndarray, "F 3 2"] | None = None
    """Texture coordinate of each face corner, origin at the lower left as in OBJ (v of glTF is 1 minus this v)."""
    corner_normals: Float[np.ndarray, "F 3 3"] | None = None
    """Unit normal of each face corner, if the file has normals; they define hard edges."""
    vertex_colors: Float[np.ndarray, "V 4"] | None = None
    """Linear RGBA of each vertex in 0..1, if the file has colours; multiplied by the base colour."""
    parts: tuple[Part, ...] = ()
    """Consecutive runs that cover all faces; empty means one unnamed part."""
    source: Source | None = None
    """The file that the mesh was read from; None for meshes of arrays, and of files that nothing is taken over from."""
    up: str | None = None
    """Axis away from the ground ("+y", "+z"), if the file defines one; None: not known."""

    def __post_init__(self) -> None:
        """Convert arrays, and raise InputError for those that cannot be used."""
        check_kind("Mesh.name", self.name, "str")
        object.__setattr__(self, "vertices", as_vertices(self.vertices))
        object.__setattr__(self, "faces", as_faces(self.faces))
        for name, shape, hint in (
            ("corner_uv", (len(self.faces), 3, 2), "those of vertices (V, 2) are uv[faces]"),
            ("corner_normals", (len(self.faces), 3, 3), "those of vertices (V, 3) are normals[faces]"),
            ("vertex_colors", (len(self.vertices), 4), "append 1 as alpha; divide bytes by 255 and make them linear"),
        ):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, as_floats(f"Mesh.{name}", value, shape, hint))

    def __repr__(self) -> str:
        """Sum up the mesh: arrays of thousands of numbers say nothing."""
        return f"Mesh({self.name!r}, {len(self.vertices)} vertices, {len(self.faces)} faces)"

    def with_vertices(self, vertices: Float[np.ndarray, "V 3"]) -> Mesh:
        """Return this mesh with other points; corner normals are turned along with the surface.

        Args:
            vertices: in the order of this mesh's.

        Raises:
            InputError: another number of vertices.

        Example:
            >>> mesh = mimesh.load_mesh("hero.glb")
            >>> twice = mesh.with_vertices(2 * mesh.vertices)
        """
        vertices = as_vertices(vertices, "vertices")
        if vertices.shape != self.vertices.shape:
            raise InputError(
                f"vertices: expected the shape {self.vertices.shape} of {self.name}, found {vertices.shape}; "
                "make another mesh for other vertices"
            )
        normals = self.corner_normals
        if normals is not None:
            normals = normal_turner(normals, self.faces, self.vertices)(vertices)
        return dataclasses.replace(self, vertices=vertices, corner_normals=normals)


@dataclass(frozen=True, eq=False)
class Clip:
    """An animated mesh: `vertices[t]` are the points of `mesh` at `t / fps` seconds.

    Raises:
        InputError: no mesh, or frames of another shape; the message says how to change them.

    Example:
        >>> mesh = mimesh.load_mesh("hero.glb")
        >>> heights = np.linspace(0.0, 0.5, 10)  # in the unit of the file
        >>> frames = mesh.vertices + heights[:, None, None] * [0.0, 1.0, 0.0]  # (T, V, 3)
        >>> clip = mimesh.Clip(mesh, frames, fps=10.0)
        >>> len(clip), clip.seconds
        (10, 1.0)
    """

    mesh: Mesh
    """Topology, appearance and source; its vertices are those of frame 0 unless the file has a rest shape."""
    vertices: Frames
    """Points of all frames, in the order, axes and unit of the mesh's."""
    fps: float = 30.0
    """Frames a second."""
    headings: Float[np.ndarray, "T 3"] | None = None
    """Facing direction of the person in every frame (y up), if joints define it; None: detected from the shape."""
    skeleton: JointSource | None = None
    """Joints of the file in the same frames, if it has any."""
    notes: tuple[str, ...] = ()
    """What was wrong with the file and how it was read, one line each."""

    def __post_init__(self) -> None:
        """Convert the frames, and raise InputError for what cannot be used."""
        check_kind("Clip.mesh", self.mesh, "Mesh")
        check_kind("Clip.fps", self.fps, "float")
        object.__setattr__(self, "fps", float(self.fps))
        if not isinstance(self.vertices, PosedFrames):
            object.__setattr__(self, "vertices", as_frames(self.vertices, self.mesh.name, len(self.mesh.vertices)))

    @classmethod
    def still(cls, mesh: Mesh) -> Clip:
        """Make a clip of one frame.

        Args:
            mesh: the frame.

        Raises:
            InputError: no mesh.

        Example:
            >>> len(mimesh.Clip.still(mimesh.load_mesh("hero.glb")))
            1
        """
        check_kind("mesh", mesh, "Mesh")
        return cls(mesh, mesh.vertices[None])

    def __repr__(self) -> str:
        """Sum up the clip: arrays of thousands of numbers say nothing."""
        return f"Clip({self.mesh.name!r}, {len(self)} frames at {self.fps:g} fps, {self.vertices.shape[1]} vertices)"

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.vertices)

    @property
    def seconds(self) -> float:
        """Length of the clip: T frames last T / fps seconds."""
        return len(self.vertices) / self.fps


LARGEST = 1e18
"""Largest coordinate that is accepted: far above any unit, and so small that squared distances fit float32."""


def check_mesh(mesh: Mesh, path: str | Path) -> Mesh:
    """Return the mesh if it is valid.

    Raises:
        InputError: no vertices, NaN, infinite or too large coordinates, texture coordinates or normals, a face index
            out of range, no extent, or more than the budgets allow (see `budgets`).
    """
    vertices, faces = mesh.vertices, mesh.faces
    VERTICES.check(len(vertices), path)
    FACES.check(len(faces), path)
    if len(vertices) == 0:
        raise InputError(f"{path}: expected a mesh, found no vertices; export it again with its geometry")
    check_numbers(mesh, path)
    largest = np.abs(vertices).max()
    if largest > LARGEST:
        raise damaged(path, f"coordinates up to {LARGEST:g}", f"{largest:g}")
    _check_corners(mesh.corner_uv, "texture coordinates", path)
    _check_corners(mesh.corner_normals, "normals", path)
    colors = mesh.vertex_colors
    if colors is not None and not (np.abs(colors) <= LARGEST).all():
        raise InputError(f"{path}: expected finite vertex colours, found NaN or infinity; delete or repair them")
    if np.ptp(vertices, axis=0).max() == 0.0:
        raise InputError(
            f"{path}: expected a mesh with some size, found all {len(vertices)} vertices at one point; "
            "check the export's scale"
        )
    if len(faces) and not (face_areas(vertices, faces) > 0).any():
        raise InputError(
            f"{path}: expected faces with area, found only zero-area ones; check the export's scale and faces"
        )
    return mesh


FAR = 1e-3
"""Rounding error of coordinates in single precision over the size of the mesh, from which on it is far from the origin:
a person of 1.8 m from 33 km on, where such numbers are 4 mm apart; at 5000 km, as in UTM coordinates, 0.5 m."""


def is_far(mesh: Mesh) -> bool:
    """Tell whether single precision rounds the coordinates of a mesh by more than FAR of its size."""
    step, size = _step_and_size(mesh)
    return step / 2 > FAR * size


def far_note(mesh: Mesh) -> tuple[str, ...]:
    """Return a note on a mesh that is too far from the origin for single precision."""
    if not is_far(mesh):
        return ()
    step, size = _step_and_size(mesh)
    return (
        f"{mesh.name} is far from the origin: coordinates in single precision, as .glb, .fbx, .stl, .usd and .pc2 have "
        f"them, are {step:.2g} apart there, and it measures {size:.3g}; move it to the origin",
    )


def check_single_precision(mesh: Mesh, path: str | Path) -> None:
    """Raise InputError where nothing of a mesh is left in single precision: numbers are further apart than its size."""
    step, size = _step_and_size(mesh)
    if step > size > 0:
        raise InputError(
            f"{path}: expected a mesh near the origin, as {Path(path).suffix} has single precision, found {mesh.name}, "
            f"which measures {size:.3g}, where such numbers are {step:.2g} apart; move it there, or write a .ply"
        )


def _step_and_size(mesh: Mesh) -> tuple[float, float]:
    """Return the distance between numbers of single precision at the largest coordinate, and the longest side."""
    vertices = mesh.vertices
    if not len(vertices):
        return 0.0, 0.0
    return float(np.spacing(np.float32(np.abs(vertices).max()))), float(np.ptp(vertices, axis=0).max())


def check_numbers(mesh: Mesh, path: str | Path) -> None:
    """Raise InputError for coordinates that are not finite, or face indices out of range; quick."""
    vertices, faces = mesh.vertices, mesh.faces
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if bad.size:
        raise InputError(
            f"{path}: expected finite coordinates, found NaN or infinity in {bad.size} of {len(vertices)} vertices "
            f"(first: vertex {bad[0]}); delete or repair them"
        )
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        worst = int(faces.max() if faces.max() >= len(vertices) else faces.min())
        raise InputError(
            f"{path}: expected face indices in 0..{len(vertices) - 1}, found {worst}; "
            + ("the file is damaged, export it again" if isinstance(path, Path) else "vertices count from 0")
        )


def _check_corners(values: Float[np.ndarray, "F 3 _"] | None, kind: str, path: str | Path) -> None:
    if values is None:
        return
    bad = np.flatnonzero(~(np.abs(values) <= LARGEST).all(axis=(1, 2)))
    if bad.size:
        raise InputError(
            f"{path}: expected {kind} that are finite and up to {LARGEST:g}, found others in {bad.size} of "
            f"{len(values)} triangles (first: triangle {bad[0]}); delete or repair them"
        )


def check_clip(clip: Clip, path: str | Path) -> Clip:
    """Return the clip if every frame is valid (see `check_mesh`); raise InputError otherwise."""
    check_timing(clip, path, f"give one with {option('fps', ...)}")
    check_clip_size(len(clip), clip.vertices.shape[1], path)
    check_frames(clip, path)
    check_mesh(dataclasses.replace(clip.mesh, vertices=np.asarray(clip.vertices[0], np.float64)), path)
    return clip


def check_frames(clip: Clip, path: str | Path) -> None:
    """Raise InputError for coordinates in any frame that are not finite, or too large."""
    advice = "export it again" if isinstance(path, Path) else "repair it"
    if isinstance(clip.vertices, PosedFrames):
        if not (np.isfinite(clip.vertices.rotation).all() and np.isfinite(clip.vertices.root).all()):
            raise InputError(f"{path}: expected finite joints, found NaN or infinity; {advice}")
        return
    for t, vertices in enumerate(each_frame(clip.vertices)):
        if not np.isfinite(vertices).all():
            raise InputError(f"{path}: expected finite coordinates, found NaN or infinity in frame {t}; {advice}")
        if np.abs(vertices).max(initial=0.0) > LARGEST:
            raise InputError(
                f"{path}: expected coordinates up to {LARGEST:g}, found larger ones in frame {t}; {advice}"
            )


def check_timing(clip: Clip, path: str | Path, advice: str) -> None:
    """Raise InputError for a clip without frames, or with an impossible frame rate and advice on that."""
    if len(clip) == 0:
        raise InputError(f"{path}: expected at least one frame, found none; export the animation again")
    check_rate(clip.fps, path, advice)


def with_printable_names(mesh: Mesh) -> Mesh:
    """Replace lone surrogates in all names of a mesh by `?`: no format can store them.

    Python decodes bytes of file names that are no text to such characters.
    """

    def text(name: str) -> str:
        return name.encode("utf-8", "replace").decode("utf-8")

    parts = tuple(
        dataclasses.replace(
            part,
            name=text(part.name),
            material=part.material and dataclasses.replace(part.material, name=text(part.material.name)),
        )
        for part in mesh.parts
    )
    # A mesh whose names are text stays the same object.
    return (
        mesh
        if (text(mesh.name), parts) == (mesh.name, mesh.parts)
        else dataclasses.replace(mesh, name=text(mesh.name), parts=parts)
    )


def check_cut(name: str, count: int, frames: slice) -> None:
    """Check that a choice of frames (--start, --stop, --step) leaves some of `count`.

    Raises:
        InputError: no frame is left, or the step is not positive.
    """
    if frames.step is not None and frames.step < 1:
        raise InputError(f"{option('step')}: expected 1 or more, found {frames.step}; give a positive number")
    if not len(range(count)[frames]):
        raise InputError(
            f"{name}: expected {option('start')} and {option('stop')} within its {count} frames, found "
            f"{frames.start or 0} to "
            f"{'the end' if frames.stop is None else frames.stop}, which leaves none; change them"
        )


def cut_clip(clip: Clip, start: int, stop: int | None, step: int) -> Clip:
    """Select every `step`-th frame in start <= t < stop; the frame rate becomes fps / step: the speed is unchanged."""
    check_cut(clip.mesh.name, len(clip), slice(start, stop, step))
    vertices = clip.vertices[start:stop:step]
    check_mesh(dataclasses.replace(clip.mesh, vertices=vertices[0].astype(np.float64)), clip.mesh.name)
    headings = None if clip.headings is None else clip.headings[start:stop:step]
    skeleton = None if clip.skeleton is None else clip.skeleton.cut(slice(start, stop, step))
    return dataclasses.replace(clip, vertices=vertices, fps=clip.fps / step, headings=headings, skeleton=skeleton)


def stored_clip(clip: Clip, progress: Progress | None = None) -> Clip:
    """Return a clip whose frames are all there, as an array: in memory, or on disk if they are many."""
    if not isinstance(clip.vertices, PosedFrames):
        return clip
    count, vertices, _ = clip.vertices.shape
    stored = store_frames(clip.vertices, count, vertices, clip.vertices.dtype, progress)
    return dataclasses.replace(clip, vertices=stored)


def merged_mesh(mesh: Mesh, group: Int[np.ndarray, " V"] | None) -> Mesh:
    """Return the surface of a mesh with one vertex for each group of vertices, which are at one position.

    Triangles, texture coordinates, normals and parts stay; None has no groups. The result has no `source`.
    """
    if group is None:
        return mesh
    first = first_of_each(group)
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[first]
    return dataclasses.replace(
        mesh, vertices=mesh.vertices[first], faces=group[mesh.faces], vertex_colors=colors, source=None
    )


def chosen_faces(mesh: Mesh, faces: Int[np.ndarray, " G"], index: Int[np.ndarray, " U"]) -> Mesh:
    """Return the surface of some faces, in their order, with the vertices `index`; without a `source`."""
    place = np.full(len(mesh.vertices), -1)
    place[index] = np.arange(len(index))
    starts = np.searchsorted(faces, [part.start for part in mesh.parts])
    stops = np.searchsorted(faces, [part.stop for part in mesh.parts])
    parts = [
        dataclasses.replace(part, start=int(start), stop=int(stop))
        for part, start, stop in zip(mesh.parts, starts, stops, strict=True)
        if stop > start
    ]
    return Mesh(
        mesh.vertices[index],
        place[mesh.faces[faces]],
        mesh.name,
        corner_uv=None if mesh.corner_uv is None else mesh.corner_uv[faces],
        corner_normals=None if mesh.corner_normals is None else mesh.corner_normals[faces],
        vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[index],
        parts=tuple(parts),
        up=mesh.up,
    )


def same_colors(mesh: Mesh, group: Int[np.ndarray, " V"] | None) -> Int[np.ndarray, " V"] | None:
    """Return groups of vertices; None where the colours of some differ within one, which would get lost."""
    colors = mesh.vertex_colors
    if group is None or colors is None or (colors == colors[first_of_each(group)][group]).all():
        return group
    return None


def same_mesh(mesh: Mesh, other: Mesh) -> bool:
    """Tell whether two meshes are shapes of one: as many vertices, and the same triangles."""
    return len(mesh.vertices) == len(other.vertices) and np.array_equal(mesh.faces, other.faces)


def drawn_points(mesh: Mesh, points: Float[np.ndarray, "*T V 3"]) -> Float[np.ndarray, "*T D 3"]:
    """Select the points of vertices that any face has; all of a point cloud.

    Files may have vertices far away that no face uses and nobody sees.
    """
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces] = True
    return points if used.all() or not used.any() else points[..., used, :]


def permute_vertices(mesh: Mesh, order: Int[np.ndarray, " V"]) -> Mesh:
    """Reorder vertices and rename face indices together: new vertex i is old vertex `order[i]`.

    Training, tests and protocols all shuffle with this function. The result has no `source`, because its vertices are
    no longer those of the file.
    """
    if sorted(order.tolist()) != list(range(len(mesh.vertices))):
        raise InputError(
            f"order: expected each of 0..{len(mesh.vertices) - 1} once, found {len(order)} entries; give a permutation"
        )
    # Invert the permutation for the face indices.
    rank = np.empty(len(order), mesh.faces.dtype)
    rank[order] = np.arange(len(order), dtype=mesh.faces.dtype)
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[order]
    return dataclasses.replace(
        mesh, vertices=mesh.vertices[order], faces=rank[mesh.faces], vertex_colors=colors, source=None
    )


def check_size(frames: Iterable[Float[np.ndarray, "U 3"]], name: str) -> Iterator[Float[np.ndarray, "U 3"]]:
    """Yield the frames of the clip `name`, checking that they have a size.

    Raises:
        InputError: all vertices of a frame are at one point.
    """
    for t, vertices in enumerate(frames):
        if not (vertices != vertices[0]).any():
            raise InputError(
                f"{name}: expected some size in frame {t} of those taken, found all vertices at one point; "
                f"repair that frame, or end the clip before it with {option('stop', ...)}"
            )
        yield vertices
