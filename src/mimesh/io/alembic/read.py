"""Read all visible meshes of an Alembic archive in world coordinates, as one mesh or frame by frame.

This runs in a child process (`child_process.child_result`): the library ends the process at some damage, and raises any
kind of exception at other. From top to bottom: the two functions that the parent calls, the frames, the mesh that is
joined of all objects, the polygons of one object, the objects with their samples in time, and the check of the file.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from alembic3d import Abc, AbcGeom
from jaxtyping import Float, Int

from ...core.budgets import check_clip_size
from ...core.errors import InputError
from ...core.frame_buffer import Progress
from ...core.geometry import nearest_rotation, unit_vectors
from ...core.mesh import Material, Mesh, Part
from ..guarded import hand_over_clip, hand_over_mesh
from ..polygons import fan_corners, joined_corners, reversed_corners, with_face_normals
from ..timing import DEFAULT_FPS, LONGEST, frame_count, sample_rate, surrounding_samples, usual_rate
from .write import AlembicSource

# alembic3d ships no types.
# pyright: reportAttributeAccessIssue=false

_ON_SAMPLE = 1e-5
"""Fraction of the interval between two samples: a time nearer than this to a sample takes that sample unchanged."""


def read_mesh(source: Path, target: Path) -> None:
    """Read the first frame of all visible meshes of an archive as one mesh, joined in hierarchy order; hand it over.

    Coordinates are the world's, in the file's unit. Face sets become parts with a material of the same name, since most
    programs write one face set per material. Of a subdivision surface the control mesh is read. Cameras, curves, points
    and materials are not read.

    Raises:
        InputError: the archive is stored as HDF5, damaged, or without visible meshes.
    """
    with _reading(source):
        abc_meshes, others = _open_meshes(source)
        mesh = _join(abc_meshes, _start_time(abc_meshes), others, source)
    hand_over_mesh(target, mesh)


def read_clip(source: Path, target: Path, fps: float | None, progress: Progress) -> None:
    """Read the visible meshes of an archive as a clip, and hand over its frames one by one.

    Frame 0 is at the first sample. Without `fps`, the frames are the archive's samples where these are evenly spaced.
    Otherwise frames are sampled at `fps`: points are interpolated linearly between two samples, transforms by
    `MeshObject.world`.

    Raises:
        InputError: as `read_mesh`, or the topology changes over time.
    """
    with _reading(source):
        abc_meshes, others = _open_meshes(source)
        mesh = _join(abc_meshes, _start_time(abc_meshes), others, source)
        times, rate = _frame_times(abc_meshes, fps)
        check_clip_size(len(times), len(mesh.vertices), source)
        frames = _frames(abc_meshes, _vertex_counts(abc_meshes), times, source)
        hand_over_clip(target, mesh, frames, len(times), rate, progress)


def _frame_times(abc_meshes: list[MeshObject], fps: float | None) -> tuple[Float[np.ndarray, " T"], float]:
    """Choose the times of the clip's frames in seconds, and return them with the frame rate."""
    animated = [prop.times for abc_mesh in abc_meshes for prop in abc_mesh.properties if len(prop.times) > 1]
    if not animated:
        return np.array([_start_time(abc_meshes)]), fps or DEFAULT_FPS
    times = np.unique(np.concatenate(animated))
    # Properties with different time samplings compute the same time with different rounding: within 1 us it is one.
    times = times[np.append(True, np.diff(times) > 1e-6)]
    rate = sample_rate(times)
    if rate is not None and (fps is None or np.isclose(fps, rate)):
        return times, rate
    fps = fps or usual_rate(times - times[0]) or DEFAULT_FPS
    return times[0] + np.arange(frame_count(times[-1] - times[0], fps)) / fps, fps


def _open_meshes(path: Path) -> tuple[list[MeshObject], dict[str, int]]:
    """Open an archive and find its visible meshes; raises InputError where there are none."""
    abc_meshes, others = _find_meshes(_open_archive(path), path)
    if not abc_meshes:
        found = _listed(others) or "nothing"
        raise InputError(f"{path}: expected an archive with visible meshes, found {found}; export it with its geometry")
    return abc_meshes, others


def _start_time(abc_meshes: list[MeshObject]) -> float:
    """Return the time of frame 0 in seconds: the first sample of the animated properties, else of all properties.

    A constant property is often sampled at time 0 in a clip that starts later.
    """
    properties = [prop for abc_mesh in abc_meshes for prop in abc_mesh.properties]
    animated = [prop.times[0] for prop in properties if len(prop.times) > 1]
    return float(min(animated or [prop.times[0] for prop in properties]))


def _vertex_counts(abc_meshes: list[MeshObject]) -> list[int]:
    """Return the number of vertices of each mesh in its first sample."""
    return [len(abc_mesh.points.bracket(abc_mesh.points.times[0].item())[0]) for abc_mesh in abc_meshes]


def _frames(
    abc_meshes: list[MeshObject], counts: list[int], times: Float[np.ndarray, " T"], path: Path
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the joined world positions of all meshes at each time; raises InputError where the topology changes."""
    for frame, time in enumerate(times.tolist()):
        points_of_mesh = [_world_points(abc_mesh, time) for abc_mesh in abc_meshes]
        for abc_mesh, points, count in zip(abc_meshes, points_of_mesh, counts, strict=True):
            if points is None or len(points) != count:
                raise InputError(
                    f"{path}: expected one topology in all frames, found another in frame {frame} of "
                    f"{abc_mesh.name!r}; export it without remeshing"
                )
        yield np.concatenate([points for points in points_of_mesh if points is not None])


def _world_points(abc_mesh: MeshObject, time: float) -> Float[np.ndarray, "V 3"] | None:
    """Compute the world positions of a mesh at a time; None where its topology differs from the first sample's."""
    before, after, weight = abc_mesh.points.bracket(time)
    sample_times = [abc_mesh.points.times[i] for i in abc_mesh.points.cache]
    if len(before) != len(after) or not all(_keeps_topology(abc_mesh, sample_time) for sample_time in sample_times):
        return None
    points = before if weight == 0.0 else (1 - weight) * before + weight * after
    T_world_local = abc_mesh.world(time)
    return points @ T_world_local[:3, :3].T + T_world_local[:3, 3]


def _join(abc_meshes: list[MeshObject], start: float, others: dict[str, int], path: Path) -> Mesh:
    """Join meshes to one Mesh at time `start`, with polygons sorted by mesh and face set so that each is one part."""
    counts = _vertex_counts(abc_meshes)
    surfaces = [
        _read_polygons(abc_mesh, count, abc_mesh.world(start), path)
        for abc_mesh, count in zip(abc_meshes, counts, strict=True)
    ]
    parts, label = _label_polygons(abc_meshes, surfaces)
    sizes = np.concatenate([surface.sizes for surface in surfaces])
    # Sort polygons by part. Their corners follow: each corner sorts by the rank of its polygon, stably within it.
    by_label = np.argsort(label, kind="stable")
    sorted_corners = np.argsort(np.repeat(np.argsort(by_label), sizes), kind="stable")
    sizes = sizes[by_label]
    first_vertices = np.cumsum([0, *counts])
    corners = np.concatenate([surface.corners + k for surface, k in zip(surfaces, first_vertices, strict=False)])
    triangles, polygon = fan_corners(sizes)
    triangles = sorted_corners[triangles]
    vertices, faces = next(_frames(abc_meshes, counts, np.array([start]), path)), corners[triangles]
    corner_counts = [len(surface.corners) for surface in surfaces]
    uv = joined_corners([surface.uv for surface in surfaces], corner_counts)
    normals = joined_corners([surface.normals for surface in surfaces], corner_counts)
    name = abc_meshes[0].name if len(abc_meshes) == 1 else path.stem
    return Mesh(
        vertices,
        faces,
        name=path.stem,
        corner_uv=uv[triangles] if uv is not None else None,
        corner_normals=with_face_normals(normals[triangles], vertices, faces) if normals is not None else None,
        parts=_parts(parts, label[by_label][polygon]) if len(abc_meshes) > 1 or surfaces[0].face_sets else (),
        source=AlembicSource(sizes, _notes(abc_meshes, surfaces, others), name),
    )


def _label_polygons(
    abc_meshes: list[MeshObject], surfaces: list[PolygonMesh]
) -> tuple[list[tuple[str, Material | None]], Int[np.ndarray, " P"]]:
    """Return name and material of each part, in order of its first polygon, and the part index of each polygon.

    Each face set is a part; so are the polygons of each mesh that are in no face set.
    """
    parts: list[tuple[str, Material | None]] = []
    labels = []
    for abc_mesh, surface in zip(abc_meshes, surfaces, strict=True):
        labels.append(surface.face_set + 1 + len(parts))
        parts += [(abc_mesh.name, None), *((name, Material(name)) for name in surface.face_sets)]
    # Renumber the parts that have polygons by their first one.
    used, first, label = np.unique(np.concatenate(labels), return_index=True, return_inverse=True)
    order = np.argsort(first)
    return [parts[i] for i in used[order]], np.argsort(order)[label.reshape(-1)]


def _parts(parts: list[tuple[str, Material | None]], label: Int[np.ndarray, " F"]) -> tuple[Part, ...]:
    """Turn the sorted part index of each face into runs of faces; parts without a triangle are dropped."""
    stops = np.searchsorted(label, np.arange(len(parts)), side="right").tolist()
    runs = zip(parts, [0, *stops], stops, strict=False)
    return tuple(Part(name, start, stop, material) for (name, material), start, stop in runs if start < stop)


def _notes(abc_meshes: list[MeshObject], surfaces: list[PolygonMesh], others: dict[str, int]) -> tuple[str, ...]:
    """List what a new archive will lack or store differently, one line each."""
    notes = [note for surface in surfaces for note in surface.notes]
    if len(abc_meshes) > 1:
        notes.insert(0, f"joined {len(abc_meshes)} meshes of the archive to one, in world coordinates")
    if others:
        notes.append(f"dropped {_listed(others)} of the archive")
    return tuple(notes)


def _listed(others: dict[str, int]) -> str:
    """Join kinds of objects to a phrase such as "a camera, 2 x curves"."""
    return ", ".join(f"{count} x {name}" if count > 1 else f"a {name}" for name, count in others.items())


@dataclass(frozen=True, eq=False)
class PolygonMesh:
    """The polygons of a mesh object with the values at their corners."""

    sizes: Int[np.ndarray, " P"]
    """Corners of each polygon."""
    corners: Int[np.ndarray, " C"]
    """Vertex index of each corner, polygon after polygon."""
    uv: Float[np.ndarray, "C 2"] | None
    normals: Float[np.ndarray, "C 3"] | None
    """World coordinates, of length one or zero."""
    face_set: Int[np.ndarray, " P"]
    """Index in `face_sets` of the first one that contains the polygon, -1 where none does."""
    face_sets: tuple[str, ...]
    """Names of the face sets."""
    notes: tuple[str, ...]
    """One line for each geometry parameter that was left out."""


def _read_polygons(
    abc_mesh: MeshObject, count: int, T_world_local: Float[np.ndarray, "4 4"], path: Path
) -> PolygonMesh:
    """Read the polygons of a mesh object of `count` vertices, with normals in world coordinates.

    UVs or normals whose number fits neither corners, vertices nor polygons are left out with a note.

    Raises:
        InputError: vertex indices of polygons, or polygon indices of face sets, are out of range.
    """
    sizes, corners = _polygons(abc_mesh, abc_mesh.points.times[0])
    if (sizes < 0).any() or sizes.sum() != len(corners) or (len(corners) and not _within(corners, count)):
        raise InputError(
            f"{path}: expected polygons with corners in 0..{count - 1} in {abc_mesh.name!r}, found {len(sizes)} "
            f"polygons with {len(corners)} corners that do not fit; the file is damaged, export it again"
        )
    # Reversing each polygon makes it counter-clockwise; a mirroring transform (negative determinant) already does so.
    determinant = np.linalg.det(T_world_local[:3, :3])
    order = np.arange(len(corners)) if determinant < 0 else reversed_corners(sizes)
    notes: list[str] = []
    values: list[Float[np.ndarray, "C K"] | None] = []
    for found, width in ((abc_mesh.schema.getUVsParam(), 2), (_normals_of(abc_mesh), 3)):
        rows = None
        if found is not None and found.valid() and found.getNumSamples() > 0:
            rows = _corner_values(found, width, sizes, corners, count)
            if rows is None:
                notes.append(f"dropped '{found.getName()}' of {abc_mesh.name}: not one for each corner or vertex")
        values.append(rows[order] if rows is not None else None)
    normals = values[1]
    if normals is not None:
        # Normals transform by the cofactor matrix; its sign flips with the determinant.
        normals = unit_vectors(normals @ _cofactors(T_world_local[:3, :3]).T) * (-1.0 if determinant < 0 else 1.0)
    face_set, names = _face_sets(abc_mesh, len(sizes), path)
    return PolygonMesh(sizes, corners[order], values[0], normals, face_set, names, tuple(notes))


def _keeps_topology(abc_mesh: MeshObject, time: float) -> bool:
    """Return whether the polygons of the sample at a time equal those of the first; constant ones are not compared."""
    schema = abc_mesh.schema
    if schema.getFaceCountsProperty().isConstant() and schema.getFaceIndicesProperty().isConstant():
        return True
    both = zip(_polygons(abc_mesh, time), _polygons(abc_mesh, abc_mesh.points.times[0]), strict=True)
    return all(np.array_equal(now, first) for now, first in both)


def _polygons(abc_mesh: MeshObject, time: float) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " C"]]:
    """Read the corner count of each polygon and the vertex of each corner, in the file's winding."""
    found = (abc_mesh.schema.getFaceCountsProperty(), abc_mesh.schema.getFaceIndicesProperty())
    sizes, corners = (np.asarray(values.getValue(_at_time(time)), np.int32).astype(np.int64) for values in found)
    return sizes, corners


def _normals_of(abc_mesh: MeshObject) -> Any:
    """Return the normals parameter of a mesh; None for a subdivision surface, whose schema has none."""
    return abc_mesh.schema.getNormalsParam() if hasattr(abc_mesh.schema, "getNormalsParam") else None


def _within(index: Int[np.ndarray, " N"], count: int) -> bool:
    """Return whether all indices are in 0..count - 1."""
    return not len(index) or bool(index.min() >= 0 and index.max() < count)


def _corner_values(
    found: Any, width: int, sizes: Int[np.ndarray, " P"], corners: Int[np.ndarray, " C"], count: int
) -> Float[np.ndarray, "C K"] | None:
    """Read a geometry parameter and expand it to one value per corner, in the file's order; None where it does not fit.

    The scope follows from the number of values: per corner, vertex, polygon, or one for all. Some exporters declare a
    wrong scope, so the declared one only decides where the number of corners equals the number of vertices.
    """
    sample = found.getIndexedValue()
    rows = np.asarray(sample.getVals(), np.float32).astype(np.float64).reshape(-1, width)
    if found.isIndexed():
        index = _integers_of(sample.getIndices())
        if not _within(index, len(rows)):
            return None
        rows = rows[index]
    # Values at varying scope are per vertex for polygons.
    at_vertices = str(found.getScope()) in ("kVertexScope", "kVaryingScope")
    if len(rows) == len(corners) and not (at_vertices and len(rows) == count):
        return rows
    if len(rows) == count:
        return rows[corners]
    if len(rows) == len(sizes):
        return np.repeat(rows, sizes, axis=0)
    return np.repeat(rows, len(corners), axis=0) if len(rows) == 1 else None


def _cofactors(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Compute the cofactor matrix: determinant times inverse transpose, and defined for singular matrices too."""
    return np.cross(np.roll(matrix, -1, axis=0), np.roll(matrix, -2, axis=0))


def _face_sets(abc_mesh: MeshObject, polygons: int, path: Path) -> tuple[Int[np.ndarray, " P"], tuple[str, ...]]:
    """Read for each polygon the index of the first face set that contains it (-1: none), and the face sets' names."""
    names = tuple(abc_mesh.schema.getFaceSetNames())
    face_set = np.full(polygons, -1)
    for number, name in enumerate(names):
        schema = abc_mesh.schema.getFaceSet(name).getSchema()
        faces = np.asarray(schema.getValue().getFaces(), np.int32) if schema.getNumSamples() else np.zeros(0, np.int32)
        if not _within(faces, polygons):
            raise InputError(
                f"{path}: expected polygons in 0..{polygons - 1} in face set {name!r}, found {faces.max()}; "
                "the file is damaged, export it again"
            )
        face_set[faces[face_set[faces] < 0]] = number
    return face_set, names


@dataclass(eq=False)
class SampledProperty:
    """A property with samples in time, read on demand; the last two samples used stay in memory."""

    times: Float[np.ndarray, " K"]
    """Seconds of the samples, increasing."""
    read: Callable[[float], np.ndarray]
    """Reads the sample nearest to a time in seconds."""
    cache: dict[int, np.ndarray] = field(default_factory=dict)
    """Samples in memory, by index."""

    def bracket(self, time: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the samples before and after a time, and the time's position between them in 0..1."""
        before, after, weight = (values.item() for values in surrounding_samples(self.times, np.array([time])))
        before = after if weight > 1 - _ON_SAMPLE else before
        after = before if weight < _ON_SAMPLE else after
        self.cache = {
            i: self.cache[i] if i in self.cache else self.read(float(self.times[i]))
            for i in dict.fromkeys((before, after))
        }
        return self.cache[before], self.cache[after], 0.0 if before == after else weight


@dataclass(frozen=True, eq=False)
class MeshObject:
    """A visible mesh object of an archive."""

    name: str
    schema: Any
    """Its schema object of the library: IPolyMesh or ISubD."""
    points: SampledProperty
    """Positions in the object's local frame."""
    transforms: tuple[SampledProperty, ...]
    """Matrices of the Xform objects above it, outermost first."""

    @property
    def properties(self) -> tuple[SampledProperty, ...]:
        """All properties that can move the mesh."""
        return self.points, *self.transforms

    def world(self, time: float) -> Float[np.ndarray, "4 4"]:
        """Compute T_world_local at a time in seconds; between samples, matrices are interpolated as Blender does."""
        T_world_local = np.eye(4)
        for transform in self.transforms:
            before, after, weight = transform.bracket(time)
            T_world_local = T_world_local @ (before if weight == 0.0 else _blend_matrices(before, after, weight))
        return T_world_local


def _find_meshes(archive: Any, path: Path) -> tuple[list[MeshObject], dict[str, int]]:
    """Find the visible meshes of an archive in hierarchy order, and count its objects of every other kind.

    Visibility is inherited: an object without its own setting takes that of its parent. A mesh counts as hidden only
    where it is hidden in all samples. An Xform that does not inherit (in its first sample) starts a new chain of
    transforms.
    """
    meshes: list[MeshObject] = []
    others: Counter[str] = Counter()
    # Depth first; the children are reversed because the last one pushed is visited next.
    pending: list[tuple[Any, tuple[SampledProperty, ...], bool]] = [(archive.getTop(), (), True)]
    while pending:
        item, transforms, is_shown = pending.pop()
        header = item.getHeader()
        is_shown = _is_visible(item, is_shown)
        if AbcGeom.IXform.matches(header):
            transforms = _add_transform(item, transforms, path)
        elif AbcGeom.IPolyMesh.matches(header) or AbcGeom.ISubD.matches(header):
            mesh = _mesh_object(item, transforms, path)
            meshes += [mesh] if is_shown and len(mesh.points.times) else []
            others["hidden mesh"] += 0 if is_shown else 1
        elif item.getParent().valid() and not AbcGeom.IFaceSet.matches(header):
            others[_schema_name(item)] += 1
        pending += [(child, transforms, is_shown) for child in item.children][::-1]
    return meshes, dict(+others)


def _add_transform(item: Any, parents: tuple[SampledProperty, ...], path: Path) -> tuple[SampledProperty, ...]:
    """Return the transforms that apply below an Xform: those of its parents, if it inherits them, and its own."""
    schema = AbcGeom.IXform(item, Abc.WrapExistingFlag.kWrapExisting).getSchema()
    times = _sample_times(schema, path)
    if not len(times):
        return parents
    transform = SampledProperty(times, _matrix_reader(schema))
    return (*parents, transform) if schema.getInheritsXforms() else (transform,)


def _mesh_object(item: Any, transforms: tuple[SampledProperty, ...], path: Path) -> MeshObject:
    mesh_class = AbcGeom.IPolyMesh if AbcGeom.IPolyMesh.matches(item.getHeader()) else AbcGeom.ISubD
    schema = mesh_class(item, Abc.WrapExistingFlag.kWrapExisting).getSchema()
    parent = item.getParent()
    # Exporters write a mesh "BodyShape" below an Xform "Body", and the user's name for it is that of the Xform.
    is_only_child = AbcGeom.IXform.matches(parent.getHeader()) and parent.getNumChildren() == 1
    name = (parent if is_only_child else item).getName()
    times = _sample_times(schema.getPositionsProperty(), path)
    return MeshObject(name, schema, SampledProperty(times, _point_reader(schema)), transforms)


def _at_time(time: float) -> Any:
    """Return the library's selector of the sample nearest to a time in seconds."""
    return Abc.ISampleSelector(float(time))  # the library takes an int for seconds as well, not for a sample index


def _points_of(values: Any) -> Float[np.ndarray, "V 3"]:
    """Convert an array of 3-vectors of the library to double precision."""
    return np.asarray(values, np.float32).astype(np.float64).reshape(-1, 3)


def _integers_of(values: Any) -> Int[np.ndarray, " N"]:
    """Convert an integer array of the library; its unsigned arrays do not offer the buffer that NumPy reads."""
    return np.fromiter(values, np.int64, len(values))


def _schema_name(item: Any) -> str:
    """Return the kind of an object as a word: "camera" for the schema "AbcGeom_Camera_v1"."""
    return item.getMetaData().get("schema").removeprefix("AbcGeom_").rpartition("_v")[0].lower() or "object"


def _is_visible(item: Any, is_parent_shown: bool) -> bool:
    """Return whether an object is visible in any sample; "deferred" and no setting mean as its parent."""
    visibility = AbcGeom.GetVisibilityProperty(item)
    if not visibility.valid() or not visibility.getNumSamples():
        return is_parent_shown
    states = [sample for sample in visibility.samples]
    deferred = int(AbcGeom.ObjectVisibility.kVisibilityDeferred)
    return any(is_parent_shown if state == deferred else bool(state) for state in states)


def _sample_times(sampled: Any, path: Path) -> Float[np.ndarray, " K"]:
    """Read the times of a property's samples in seconds.

    Raises:
        InputError: times that are not finite, do not increase, or span more than `timing.LONGEST`.
    """
    sampling = sampled.getTimeSampling()
    count = sampled.getNumSamples()
    times = np.array([sampling.getSampleTime(k) for k in range(count)], np.float64)
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any() or (count and np.ptp(times) > LONGEST):
        raise InputError(
            f"{path}: expected samples one after another within {LONGEST:g} s, found times from {times.min():g} to "
            f"{times.max():g} s; export it again"
        )
    return times


def _matrix_reader(schema: Any) -> Callable[[float], np.ndarray]:
    def read(time: float) -> np.ndarray:
        matrix = schema.getValue(_at_time(time)).getMatrix()  # for row vectors (x' = x M), so it is transposed
        return np.array([[matrix[j][i] for j in range(4)] for i in range(4)], np.float64)

    return read


def _point_reader(schema: Any) -> Callable[[float], np.ndarray]:
    points = schema.getPositionsProperty()
    return lambda time: _points_of(points.getValue(_at_time(time)))


def _blend_matrices(
    before: Float[np.ndarray, "4 4"], after: Float[np.ndarray, "4 4"], weight: float
) -> Float[np.ndarray, "4 4"]:
    """Interpolate two affine matrices: rotation along the shorter arc, stretch and translation linearly.

    Polar decomposition splits each 3x3 matrix into a rotation and a stretch, A = R S. Linear interpolation of A itself
    would shrink the mesh halfway through a rotation.
    """
    from scipy.spatial.transform import Rotation

    rotations = nearest_rotation(np.stack([before[:3, :3], after[:3, :3]]))
    relative = Rotation.from_matrix(rotations[0].T @ rotations[1]).as_rotvec()
    rotation = rotations[0] @ Rotation.from_rotvec(weight * relative).as_matrix()
    stretch = (1 - weight) * rotations[0].T @ before[:3, :3] + weight * rotations[1].T @ after[:3, :3]
    result = (1 - weight) * before + weight * after
    result[:3, :3] = rotation @ stretch
    return result


def _open_archive(path: Path) -> Any:
    """Open an archive for reading.

    Raises:
        InputError: the file is no Alembic archive, is stored as HDF5, or unfinished.
    """
    with path.open("rb") as file:
        _check_header(file.read(6), path)
    return Abc.IArchive(str(path))


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn errors of the library into an InputError of one line, for a block that reads with it."""
    try:
        yield
    except RuntimeError as error:
        raise InputError(
            f"{path}: expected a sound Alembic archive, found '{' '.join(str(error).split())[:100]}'; "
            "the file is damaged, export it again"
        ) from error


def _check_header(head: bytes, path: Path) -> None:
    """Raise InputError for other kinds of files: an Ogawa file begins so, and with 255 once writing has finished."""
    if head.startswith(b"\x89HDF"):
        raise InputError(
            f"{path}: expected an Alembic archive of the kind Ogawa, found the older HDF5; "
            "convert it with 'abcconvert -toOgawa', or export it again"
        )
    if not head.startswith(b"Ogawa"):
        raise InputError(f"{path}: expected an Alembic archive, found a file that begins {head[:5]!r}; check its name")
    if head[5:] != b"\xff":
        raise InputError(f"{path}: expected a finished archive, found one whose writing was cut off; export it again")
