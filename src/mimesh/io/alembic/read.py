"""Alembic in: all visible meshes of an archive, joined to one in world coordinates, at rest or frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.frame_buffer import Progress, store_frames
from ...core.mesh import Clip, Material, Mesh, Part
from ..polygons import fan_corners, joined_corners, with_face_normals
from ..timing import DEFAULT_FPS, frame_count, sample_rate, usual_rate
from .archive import open_archive, reading
from .scene import Shape, find_shapes
from .surface import Surface, keeps_topology, read_surface
from .write import AlembicSource


def read_alembic(path: Path) -> Mesh:
    """Read the first frame of all visible meshes of an Alembic archive, joined in the order of its hierarchy.

    World coordinates, in the file's unit. Face sets become parts, with a material of their name: that is what most
    programs put into them. Of a subdivision surface the cage is read. Cameras, curves, points and materials are not.

    Raises:
        InputError: no alembic3d, an archive in HDF5, a damaged one, or one without visible meshes.
    """
    with reading(path):
        shapes, others = _shapes(path)
        return _join(shapes, _start(shapes), others, path)


def read_alembic_clip(path: Path, fps: float | None = None, progress: Progress | None = None) -> Clip:
    """Read the visible meshes of an Alembic archive frame by frame; frame 0 is at its first sample.

    Without `fps` the frames are the samples where these are evenly spaced; else, and where another `fps` is given,
    points lie on the straight line between two samples, and transforms turn evenly from one to the next.

    Raises:
        InputError: as `read_alembic`, or a frame of another topology.
    """
    with reading(path):
        shapes, others = _shapes(path)
        start = _start(shapes)
        mesh = _join(shapes, start, others, path)
        times, rate = frame_times(shapes, fps)
        frames = _frames(shapes, _counts(shapes), times, path)
        return Clip(mesh, store_frames(frames, len(times), len(mesh.vertices), progress=progress), rate)


def frame_times(shapes: list[Shape], fps: float | None) -> tuple[Float[np.ndarray, " T"], float]:
    """The times of the frames in seconds, and how many there are in a second."""
    moving = [track.times for shape in shapes for track in (shape.points, *shape.transforms) if len(track.times) > 1]
    if not moving:
        return np.array([_start(shapes)]), fps or DEFAULT_FPS
    times = np.unique(np.concatenate(moving))
    times = times[np.append(True, np.diff(times) > 1e-6)]  # one time, computed in two ways
    rate = sample_rate(times)
    if rate is not None and (fps is None or np.isclose(fps, rate)):
        return times, rate
    fps = fps or usual_rate(times - times[0]) or DEFAULT_FPS
    return times[0] + np.arange(frame_count(times[-1] - times[0], fps)) / fps, fps


def _shapes(path: Path) -> tuple[list[Shape], dict[str, int]]:
    shapes, others = find_shapes(open_archive(path), path)
    if not shapes:
        found = _listed(others) or "nothing"
        raise InputError(f"{path}: expected an archive with visible meshes, found {found}; export it with its geometry")
    return shapes, others


def _start(shapes: list[Shape]) -> float:
    """When the clip begins: at the first of the samples that move, else at the first of all."""
    tracks = [track for shape in shapes for track in (shape.points, *shape.transforms)]
    moving = [track.times[0] for track in tracks if len(track.times) > 1]
    return float(min(moving or [track.times[0] for track in tracks]))


def _counts(shapes: list[Shape]) -> list[int]:
    """Vertices of each mesh in its first sample."""
    return [len(shape.points.around(shape.points.times[0].item())[0]) for shape in shapes]


def _frames(
    shapes: list[Shape], counts: list[int], times: Float[np.ndarray, " T"], path: Path
) -> Iterator[Float[np.ndarray, "V 3"]]:
    for frame, time in enumerate(times.tolist()):
        every = [_points(shape, time) for shape in shapes]
        for shape, points, count in zip(shapes, every, counts, strict=True):
            if points is None or len(points) != count:
                raise InputError(
                    f"{path}: expected one topology in all frames, found another in frame {frame} of {shape.name!r}; "
                    "export it without remeshing"
                )
        yield np.concatenate([points for points in every if points is not None])


def _points(shape: Shape, time: float) -> Float[np.ndarray, "V 3"] | None:
    """The vertices of a mesh in the world; None where its topology is not that of its first sample."""
    before, after, part = shape.points.around(time)
    if len(before) != len(after) or not all(keeps_topology(shape, shape.points.times[i]) for i in shape.points.kept):
        return None
    points = before if part == 0.0 else (1 - part) * before + part * after
    T_world_local = shape.world(time)
    return points @ T_world_local[:3, :3].T + T_world_local[:3, 3]


def _join(shapes: list[Shape], start: float, others: dict[str, int], path: Path) -> Mesh:
    """One mesh, whose polygons are sorted by mesh and face set so that each of these is one part."""
    counts = _counts(shapes)
    surfaces = [
        read_surface(shape, count, shape.world(start), path) for shape, count in zip(shapes, counts, strict=True)
    ]
    looks, label = _labels(shapes, surfaces)
    sizes = np.concatenate([surface.sizes for surface in surfaces])
    by_label = np.argsort(label, kind="stable")
    sorted_corners = np.argsort(np.repeat(np.argsort(by_label), sizes), kind="stable")
    sizes = sizes[by_label]
    firsts = np.cumsum([0, *counts])
    corners = np.concatenate([surface.corners + first for surface, first in zip(surfaces, firsts, strict=False)])
    triangles, polygon = fan_corners(sizes)
    triangles = sorted_corners[triangles]
    vertices, faces = next(_frames(shapes, counts, np.array([start]), path)), corners[triangles]
    corner_counts = [len(surface.corners) for surface in surfaces]
    uv = joined_corners([surface.uv for surface in surfaces], corner_counts)
    normals = joined_corners([surface.normals for surface in surfaces], corner_counts)
    name = shapes[0].name if len(shapes) == 1 else path.stem
    return Mesh(
        vertices,
        faces,
        name=path.stem,
        corner_uv=uv[triangles] if uv is not None else None,
        corner_normals=with_face_normals(normals[triangles], vertices, faces) if normals is not None else None,
        parts=_parts(looks, label[by_label][polygon]) if len(shapes) > 1 or surfaces[0].face_sets else (),
        source=AlembicSource(sizes, _notes(shapes, surfaces, others), name),
    )


def _labels(
    shapes: list[Shape], surfaces: list[Surface]
) -> tuple[list[tuple[str, Material | None]], Int[np.ndarray, " P"]]:
    """Each face set, and each mesh outside of its own, in the order of their first polygons; and which one has each."""
    looks: list[tuple[str, Material | None]] = []
    labels = []
    for shape, surface in zip(shapes, surfaces, strict=True):
        labels.append(surface.face_set + 1 + len(looks))
        looks += [(shape.name, None), *((name, Material(name)) for name in surface.face_sets)]
    used, first, label = np.unique(np.concatenate(labels), return_index=True, return_inverse=True)
    order = np.argsort(first)
    return [looks[i] for i in used[order]], np.argsort(order)[label.reshape(-1)]


def _parts(looks: list[tuple[str, Material | None]], label: Int[np.ndarray, " F"]) -> tuple[Part, ...]:
    stops = np.searchsorted(label, np.arange(len(looks)), side="right").tolist()
    spans = zip(looks, [0, *stops], stops, strict=False)
    return tuple(Part(name, start, stop, material) for (name, material), start, stop in spans if start < stop)


def _notes(shapes: list[Shape], surfaces: list[Surface], others: dict[str, int]) -> tuple[str, ...]:
    """What a new archive does not have, or has in another way, one line each."""
    notes = [note for surface in surfaces for note in surface.notes]
    if len(shapes) > 1:
        notes.insert(0, f"joined {len(shapes)} meshes of the archive to one, in world coordinates")
    if others:
        notes.append(f"dropped {_listed(others)} of the archive")
    return tuple(notes)


def _listed(others: dict[str, int]) -> str:
    return ", ".join(f"{count} x {name}" if count > 1 else f"a {name}" for name, count in others.items())
