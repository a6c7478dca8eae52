"""A USD stage as one Mesh or Clip in world coordinates, and the account of which vertex came from which prim."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pxr import Sdf, Usd, UsdGeom

from ...core.errors import InputError
from ...core.frame_buffer import Progress, store_frames
from ...core.geometry import turn_normals, unit_vectors
from ...core.mesh import Clip, Material, Mesh, Part
from ..polygons import fan_corners, joined_corners, with_face_normals
from ..timing import LONGEST, frame_count
from .looks import (
    at_corners,
    authored_normals,
    bound_material,
    name_of,
    primvar_values,
    read_material,
    subset_labels,
    uv_name,
)
from .skin import Body, moved_by, with_skins
from .source import FaceRun, UsdSource, notes_of
from .stage import REST, open_stage, shown_meshes, stage_span, stands_by_default

# usd-core tells type checkers nothing of what is in it.
# pyright: reportAttributeAccessIssue=false

Known = dict[Sdf.Path, Material]
"""Materials that were read, so that each is read once."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One prim of the stage as a mesh of its own, in world coordinates."""

    mesh: Mesh
    sizes: Int[np.ndarray, " P"]
    """Corners of the polygons that its faces are fans of."""
    corner_of: Int[np.ndarray, "F 3"]
    """Which of the prim's corners each corner of its faces is."""
    mirrored: bool
    """Whether its transform is one that turns the winding of faces around."""


def read_mesh(path: Path) -> Mesh:
    """Read what a stage shows: all its visible, renderable Mesh prims in stage order, joined in world coordinates.

    Instances are read where they stand; those of point instancers, curves, points and subdivision are not. Axes and
    unit are the file's (z up stays z up). Skins and blend shapes are applied. The time is the default time where the
    meshes have values then, else the first time code. Polygons become fans, parts are material subsets or prims.

    Raises:
        InputError: the file is damaged, or shows no meshes.
    """
    stage = open_stage(path)
    bodies = with_skins(stage, shown_meshes(stage, path))
    return _joined(stage, bodies, path)


def read_clip(path: Path, fps: float | None = None, progress: Progress | None = None) -> Clip:
    """Read what a stage shows from its first time code to its last, one frame a time code; else as `read_mesh`.

    Where nothing moves, that is one frame. With `fps`, frame k is at k / fps seconds after the first time code; between
    samples USD interpolates.

    Raises:
        InputError: as `read_mesh`, the faces or the number of points change, or it lasts longer than an hour.
    """
    stage = open_stage(path)
    bodies = with_skins(stage, shown_meshes(stage, path))
    mesh = _joined(stage, bodies, path)
    start, stop = stage_span(stage, _samples(bodies), path)
    codes = stage.GetTimeCodesPerSecond()
    if not codes > 0 or (stop - start) / codes > LONGEST:
        raise InputError(
            f"{path}: expected at most {LONGEST:g} s, found time codes {start:g} to {stop:g} at {codes:g} a second; "
            "export a shorter range"
        )
    count, step = frame_count((stop - start) / codes, fps or codes), codes / (fps or codes)
    times = [start + k * step for k in range(count)]
    vertices = store_frames(_frames(bodies, times, path), count, len(mesh.vertices), progress=progress)
    return Clip(mesh.with_vertices(np.array(vertices[0])), vertices, fps or codes)


def _samples(bodies: list[Body]) -> list[float]:
    return [time for body in bodies for time in body.samples()]


def _frames(bodies: list[Body], times: list[float], path: Path) -> Iterator[Float[np.ndarray, "V 3"]]:
    """The points of all bodies, time by time; what does not move is computed once."""
    frames = UsdGeom.XformCache(Usd.TimeCode(times[0]))
    moves = [bool(body.samples()) for body in bodies]
    still = [body.points(frames) for body in bodies]
    topologies = [_topology(body.prim, Usd.TimeCode(times[0])) for body in bodies]
    changing = [k for k, body in enumerate(bodies) if _topology_may_change(body.prim)]
    for number, time in enumerate(times):
        frames.SetTime(Usd.TimeCode(time))
        points = [body.points(frames) if moves[k] else still[k] for k, body in enumerate(bodies)]
        for k in changing:
            if _topology(bodies[k].prim, frames.GetTime()) != topologies[k]:
                raise _changed(path, bodies[k].prim, number, "other faces")
        for body, before, now in zip(bodies, still, points, strict=True):
            if len(before) != len(now):
                raise _changed(path, body.prim, number, f"{len(now)} points after {len(before)}")
        yield np.concatenate(points)


def _changed(path: Path, prim: Usd.Prim, frame: int, found: str) -> InputError:
    return InputError(
        f"{path}: expected one topology for the whole clip, found {found} in frame {frame} of {prim.GetPath()}; "
        "export without changing topology"
    )


def _topology_may_change(prim: Usd.Prim) -> bool:
    mesh = UsdGeom.Mesh(prim)
    return any(a.ValueMightBeTimeVarying() for a in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()))


def _topology(prim: Usd.Prim, time: Usd.TimeCode):
    mesh = UsdGeom.Mesh(prim)
    return mesh.GetFaceVertexCountsAttr().Get(time), mesh.GetFaceVertexIndicesAttr().Get(time)


def _joined(stage: Usd.Stage, bodies: list[Body], path: Path) -> Mesh:
    """All bodies at rest as one Mesh with its source."""
    by_default = all(stands_by_default(body.prim) for body in bodies)
    first = stage_span(stage, _samples(bodies), path)[0]
    frames = UsdGeom.XformCache(REST if by_default else Usd.TimeCode(first))
    known: Known = {}
    pieces = [_piece(body, frames, known, path) for body in bodies]
    vertices = np.concatenate([piece.mesh.vertices for piece in pieces])
    ends = np.cumsum([0] + [len(piece.mesh.vertices) for piece in pieces]).tolist()
    face_ends = np.cumsum([0] + [len(piece.mesh.faces) for piece in pieces]).tolist()
    faces = np.concatenate([piece.mesh.faces + start for piece, start in zip(pieces, ends, strict=False)])
    runs = tuple(
        FaceRun(str(body.prim.GetPath()), ends[k], ends[k + 1], face_ends[k], piece.corner_of, piece.mirrored)
        for k, (body, piece) in enumerate(zip(bodies, pieces, strict=True))
    )
    counts = [len(piece.mesh.faces) for piece in pieces]
    normals = joined_corners([piece.mesh.corner_normals for piece in pieces], counts)
    source = UsdSource(
        path=path.resolve(),
        suffix=path.suffix.lower(),
        vertices=vertices,
        sizes=np.concatenate([piece.sizes for piece in pieces]),
        runs=runs,
        by_default=by_default,
        first=first,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        meters_per_unit=float(UsdGeom.GetStageMetersPerUnit(stage)),
        notes=notes_of(stage, bodies),
    )
    mesh = Mesh(
        vertices,
        faces,
        name=path.stem,
        corner_uv=joined_corners([piece.mesh.corner_uv for piece in pieces], counts),
        corner_normals=None if normals is None else with_face_normals(normals, vertices, faces),
        parts=tuple(
            dataclasses.replace(part, start=part.start + start, stop=part.stop + start)
            for piece, start in zip(pieces, face_ends, strict=False)
            for part in piece.mesh.parts
        ),
    )
    return dataclasses.replace(mesh, source=source)


def _piece(body: Body, frames: UsdGeom.XformCache, known: Known, path: Path) -> Piece:
    """One prim at the time of `frames`, faces sorted so that each part is one run.

    Raises:
        InputError: its faces name points that are not there, or do not add up.
    """
    prim, time = body.prim, frames.GetTime()
    counts, corners = _polygons(prim, time, path)
    vertices = body.points(frames)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
        worst = int(corners.max() if corners.max() >= len(vertices) else corners.min())
        raise InputError(
            f"{path}: expected points 0..{len(vertices) - 1} in the faces of {prim.GetPath()}, found {worst}; "
            "the file is damaged, export it again"
        )
    owners, labels = subset_labels(prim, len(counts), path)
    order = _shown_polygons(prim, counts, labels)
    mirrored = bool(np.linalg.det(body.T_world_bind(frames)[:3, :3]) < 0)
    left_handed = UsdGeom.Mesh(prim).GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    corner_of, polygon = _fans(counts, order, mirrored != left_handed)
    faces = corners[corner_of]
    polygon_of = np.repeat(np.arange(len(counts)), counts)
    uv = primvar_values(prim, uv_name(owners), 2)
    what = f"{path}: texture coordinates of {prim.GetPath()}"
    mesh = Mesh(
        vertices,
        faces,
        corner_uv=None if uv is None else at_corners(*uv, corners, polygon_of, what)[corner_of],
        corner_normals=_normals(body, frames, vertices, faces, corners, polygon_of, corner_of, path),
        parts=_parts(owners, labels[polygon], known),
    )
    return Piece(mesh, counts[order], corner_of, mirrored)


def _polygons(prim: Usd.Prim, time: Usd.TimeCode, path: Path) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " C"]]:
    """Corner counts and the flat list of corners."""
    counts, corners = (np.array(value or [], np.int64) for value in _topology(prim, time))
    if (counts < 0).any() or counts.sum() != len(corners):
        raise InputError(
            f"{path}: expected as many face vertices in {prim.GetPath()} as its faces have corners ({counts.sum()}), "
            f"found {len(corners)}; the file is damaged, export it again"
        )
    return counts, corners


def _shown_polygons(prim: Usd.Prim, counts, labels) -> Int[np.ndarray, " P"]:
    """Polygons with three corners or more that are no holes, part by part as the parts first appear."""
    keep = counts > 2
    holes = np.array(UsdGeom.Mesh(prim).GetHoleIndicesAttr().Get() or [], np.int64)
    keep[holes[(holes >= 0) & (holes < len(counts))]] = False
    kept = np.flatnonzero(keep)
    used, first, place = np.unique(labels[kept], return_index=True, return_inverse=True)
    return kept[np.argsort(first[place.reshape(-1)], kind="stable")] if len(used) else kept


def _fans(counts, order, flip: bool) -> tuple[Int[np.ndarray, "F 3"], Int[np.ndarray, " F"]]:
    """The flat corners of the triangles of some polygons, turned around if asked, and the polygon of each."""
    sizes = counts[order]
    step = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    if flip:
        step = -step % np.repeat(sizes, sizes)
    triangles, polygon = fan_corners(sizes)
    flat = np.repeat((np.cumsum(counts) - counts)[order], sizes) + step
    return flat[triangles], order[polygon]


def _normals(body: Body, frames, vertices, faces, corners, polygon_of, corner_of, path):
    """Authored normals at the corners of the faces, in the world, turned along by joints and blend shapes."""
    prim = body.prim
    given = authored_normals(prim, frames.GetTime())
    if given is None:
        return None
    local = at_corners(*given, corners, polygon_of, f"{path}: normals of {prim.GetPath()}")[corner_of]
    T_world_bind = body.T_world_bind(frames)
    normals = unit_vectors(local @ np.linalg.pinv(T_world_bind[:3, :3]))
    if body.skin is None:
        return normals
    bind = moved_by(T_world_bind, np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(frames.GetTime()), np.float64))
    return turn_normals(normals, faces, bind, vertices)


def _parts(owners: list[Usd.Prim], labels: Int[np.ndarray, " F"], known: Known) -> tuple[Part, ...]:
    """The runs of equal labels."""
    ends = [*np.flatnonzero(np.diff(labels, prepend=-1)).tolist(), len(labels)]
    return tuple(
        Part(name_of(owners[labels[start]]), start, stop, _material(owners[labels[start]], known))
        for start, stop in itertools.pairwise(ends)
    )


def _material(prim: Usd.Prim, known: Known) -> Material | None:
    bound = bound_material(prim)
    if bound is None:
        return None
    if bound.GetPath() not in known:
        known[bound.GetPath()] = read_material(bound)
    return known[bound.GetPath()]
