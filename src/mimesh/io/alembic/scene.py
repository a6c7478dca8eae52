"""The meshes of an Alembic archive, where they stand and how they move: samples in time, and transforms above them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.geometry import nearest_rotation
from ..timing import LONGEST, between
from .archive import library

_ON_SAMPLE = 1e-5
"""Of the way between two samples: a time this near to one is at it."""
Pair = tuple[np.ndarray, np.ndarray, float]


@dataclass(eq=False)
class Track:
    """A property with samples in time; the last two that were asked for stay in memory."""

    times: Float[np.ndarray, " K"]
    read: Callable[[float], np.ndarray]
    kept: dict[int, np.ndarray] = field(default_factory=dict)

    def around(self, time: float) -> Pair:
        """The samples before and after a time and how far it is from one to the other, 0..1."""
        before, after, part = (values.item() for values in between(self.times, np.array([time])))
        before = after if part > 1 - _ON_SAMPLE else before
        after = before if part < _ON_SAMPLE else after
        self.kept = {
            i: self.kept[i] if i in self.kept else self.read(float(self.times[i]))
            for i in dict.fromkeys((before, after))
        }
        return self.kept[before], self.kept[after], 0.0 if before == after else part


@dataclass(frozen=True, eq=False)
class Shape:
    """A visible mesh: its schema (PolyMesh or SubD), its points, and the transforms above it, outermost first."""

    name: str
    schema: Any
    points: Track
    transforms: tuple[Track, ...]

    def world(self, time: float) -> Float[np.ndarray, "4 4"]:
        """T_world_local at a time: the mean between two samples turns and stretches evenly, as in Blender."""
        T_world_local = np.eye(4)
        for track in self.transforms:
            before, after, part = track.around(time)
            T_world_local = T_world_local @ (before if part == 0.0 else _between_matrices(before, after, part))
        return T_world_local


def find_shapes(archive: Any, path: Path) -> tuple[list[Shape], dict[str, int]]:
    """The visible meshes of an archive in the order of its hierarchy, and how many objects of each other kind it has.

    An object is hidden where it, or the nearest object above it that says so, is hidden in all samples. What does not
    inherit the transforms above it (in its first sample) begins anew.
    """
    geometry = library(path, "read")[1]
    shapes: list[Shape] = []
    others: Counter[str] = Counter()
    waiting: list[tuple[Any, tuple[Track, ...], bool]] = [(archive.getTop(), (), True)]
    while waiting:
        item, above, is_shown = waiting.pop()
        header = item.getHeader()
        is_shown = _is_visible(geometry, item, is_shown)
        if geometry.IXform.matches(header):
            above = _transforms(item, above, path)
        elif geometry.IPolyMesh.matches(header) or geometry.ISubD.matches(header):
            shape = _shape(item, above, path)
            shapes += [shape] if is_shown and len(shape.points.times) else []
            others["hidden mesh"] += 0 if is_shown else 1
        elif item.getParent().valid() and not geometry.IFaceSet.matches(header):
            others[_kind(item)] += 1
        waiting += [(child, above, is_shown) for child in item.children][::-1]
    return shapes, dict(+others)


def _transforms(item: Any, above: tuple[Track, ...], path: Path) -> tuple[Track, ...]:
    """Those of an Xform and of what it is below."""
    abc, geometry, _, _ = library(path, "read")
    schema = geometry.IXform(item, abc.WrapExistingFlag.kWrapExisting).getSchema()
    times = _times(schema, path)
    if not len(times):
        return above
    track = Track(times, _matrix_reader(schema))
    return (*above, track) if schema.getInheritsXforms() else (track,)


def _shape(item: Any, above: tuple[Track, ...], path: Path) -> Shape:
    abc, geometry, _, _ = library(path, "read")
    kind = geometry.IPolyMesh if geometry.IPolyMesh.matches(item.getHeader()) else geometry.ISubD
    schema = kind(item, abc.WrapExistingFlag.kWrapExisting).getSchema()
    parent = item.getParent()
    is_alone = geometry.IXform.matches(parent.getHeader()) and parent.getNumChildren() == 1
    name = (parent if is_alone else item).getName()  # Body above BodyShape
    times = _times(schema.getPositionsProperty(), path)
    return Shape(name, schema, Track(times, _point_reader(schema)), above)


def at_time(time: float) -> Any:
    """What chooses the sample nearest to a time. (Given a whole number, the library takes it for seconds as well.)"""
    from alembic3d.Abc import ISampleSelector  # pyright: ignore

    return ISampleSelector(float(time))


def points_of(values: Any) -> Float[np.ndarray, "V 3"]:
    """An array of the library, in double precision."""
    return np.asarray(values, np.float32).astype(np.float64).reshape(-1, 3)


def whole_numbers(values: Any) -> Int[np.ndarray, " N"]:
    """An array of whole numbers of the library, whose unsigned ones give no buffer."""
    return np.fromiter(values, np.int64, len(values))


def _kind(item: Any) -> str:
    """What an object is, in a word: "AbcGeom_Camera_v1" is a camera."""
    return item.getMetaData().get("schema").removeprefix("AbcGeom_").rpartition("_v")[0].lower() or "object"


def _is_visible(geometry: Any, item: Any, is_shown: bool) -> bool:
    found = geometry.GetVisibilityProperty(item)
    if not found.valid() or not found.getNumSamples():
        return is_shown
    states = [sample for sample in found.samples]
    deferred = int(geometry.ObjectVisibility.kVisibilityDeferred)
    return any(is_shown if state == deferred else bool(state) for state in states)


def _times(sampled: Any, path: Path) -> Float[np.ndarray, " K"]:
    """The seconds of a property's samples."""
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
        matrix = schema.getValue(at_time(time)).getMatrix()  # of rows: x' = x M
        return np.array([[matrix[j][i] for j in range(4)] for i in range(4)], np.float64)

    return read


def _point_reader(schema: Any) -> Callable[[float], np.ndarray]:
    points = schema.getPositionsProperty()
    return lambda time: points_of(points.getValue(at_time(time)))


def _between_matrices(
    before: Float[np.ndarray, "4 4"], after: Float[np.ndarray, "4 4"], part: float
) -> Float[np.ndarray, "4 4"]:
    """A matrix on the way from one to another: its rotation along the shorter arc, the rest in a straight line."""
    from scipy.spatial.transform import Rotation

    turns = nearest_rotation(np.stack([before[:3, :3], after[:3, :3]]))
    step = Rotation.from_matrix(turns[0].T @ turns[1]).as_rotvec()
    turn = turns[0] @ Rotation.from_rotvec(part * step).as_matrix()
    stretch = (1 - part) * turns[0].T @ before[:3, :3] + part * turns[1].T @ after[:3, :3]
    result = (1 - part) * before + part * after
    result[:3, :3] = turn @ stretch
    return result
