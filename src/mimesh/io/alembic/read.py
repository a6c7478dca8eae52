"""Read all visible meshes of an Alembic archive as one mesh or stream of frames in world coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ...core.budgets import check_clip_size
from ...core.errors import InputError
from ...core.mesh import Material, Mesh, Part
from ..guarded import ClipStream
from ..polygons import fan_corners, joined_corners, with_face_normals
from ..timing import DEFAULT_FPS, frame_count, sample_rate, usual_rate
from .archive import open_archive
from .polygon_mesh import PolygonMesh, keeps_topology, read_polygons
from .scene import MeshObject, find_meshes
from .write import AlembicSource


def read_mesh(path: Path) -> Mesh:
    """Read the first frame of all visible meshes of an Alembic archive as one mesh, joined in hierarchy order.

    Coordinates are the world's, in the file's unit. Face sets become parts with a material of the same name, since most
    programs write one face set per material. Of a subdivision surface the control mesh is read. Cameras, curves, points
    and materials are not read.

    Raises:
        InputError: alembic3d is missing; the archive is stored as HDF5, damaged, or without visible meshes.
    """
    abc_meshes, others = _open_meshes(path)
    return _join(abc_meshes, _start_time(abc_meshes), others, path)


def read_clip(path: Path, fps: float | None = None) -> ClipStream:
    """Read the visible meshes of an Alembic archive as a clip of frames that are computed one by one.

    Frame 0 is at the first sample. Without `fps`, the frames are the archive's samples where these are evenly spaced.
    Otherwise frames are sampled at `fps`: points are interpolated linearly between two samples, transforms by
    `scene.MeshObject.world`.

    Raises:
        InputError: as `read_mesh`; from the frames, too, where the topology changes over time.
    """
    abc_meshes, others = _open_meshes(path)
    mesh = _join(abc_meshes, _start_time(abc_meshes), others, path)
    times, rate = frame_times(abc_meshes, fps)
    check_clip_size(len(times), len(mesh.vertices), path)
    return ClipStream(mesh, _frames(abc_meshes, _vertex_counts(abc_meshes), times, path), len(times), rate)


def frame_times(abc_meshes: list[MeshObject], fps: float | None) -> tuple[Float[np.ndarray, " T"], float]:
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
    abc_meshes, others = find_meshes(open_archive(path), path)
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
    if len(before) != len(after) or not all(keeps_topology(abc_mesh, sample_time) for sample_time in sample_times):
        return None
    points = before if weight == 0.0 else (1 - weight) * before + weight * after
    T_world_local = abc_mesh.world(time)
    return points @ T_world_local[:3, :3].T + T_world_local[:3, 3]


def _join(abc_meshes: list[MeshObject], start: float, others: dict[str, int], path: Path) -> Mesh:
    """Join meshes to one Mesh at time `start`, with polygons sorted by mesh and face set so that each is one part."""
    counts = _vertex_counts(abc_meshes)
    surfaces = [
        read_polygons(abc_mesh, count, abc_mesh.world(start), path)
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
