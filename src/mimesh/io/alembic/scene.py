"""Find the mesh objects of an Alembic archive, with the time samples of their points and of their transforms."""

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
from ..timing import LONGEST, surrounding_samples
from .archive import library

_ON_SAMPLE = 1e-5
"""Fraction of the interval between two samples: a time nearer than this to a sample takes that sample unchanged."""


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


def find_meshes(archive: Any, path: Path) -> tuple[list[MeshObject], dict[str, int]]:
    """Find the visible meshes of an archive in hierarchy order, and count its objects of every other kind.

    Visibility is inherited: an object without its own setting takes that of its parent. A mesh counts as hidden only
    where it is hidden in all samples. An Xform that does not inherit (in its first sample) starts a new chain of
    transforms.
    """
    geometry = library(path, "read")[1]
    meshes: list[MeshObject] = []
    others: Counter[str] = Counter()
    # Depth first; the children are reversed because the last one pushed is visited next.
    pending: list[tuple[Any, tuple[SampledProperty, ...], bool]] = [(archive.getTop(), (), True)]
    while pending:
        item, transforms, is_shown = pending.pop()
        header = item.getHeader()
        is_shown = _is_visible(geometry, item, is_shown)
        if geometry.IXform.matches(header):
            transforms = _add_transform(item, transforms, path)
        elif geometry.IPolyMesh.matches(header) or geometry.ISubD.matches(header):
            mesh = _mesh_object(item, transforms, path)
            meshes += [mesh] if is_shown and len(mesh.points.times) else []
            others["hidden mesh"] += 0 if is_shown else 1
        elif item.getParent().valid() and not geometry.IFaceSet.matches(header):
            others[_schema_name(item)] += 1
        pending += [(child, transforms, is_shown) for child in item.children][::-1]
    return meshes, dict(+others)


def _add_transform(item: Any, parents: tuple[SampledProperty, ...], path: Path) -> tuple[SampledProperty, ...]:
    """Return the transforms that apply below an Xform: those of its parents, if it inherits them, and its own."""
    abc, geometry, _, _ = library(path, "read")
    schema = geometry.IXform(item, abc.WrapExistingFlag.kWrapExisting).getSchema()
    times = _sample_times(schema, path)
    if not len(times):
        return parents
    transform = SampledProperty(times, _matrix_reader(schema))
    return (*parents, transform) if schema.getInheritsXforms() else (transform,)


def _mesh_object(item: Any, transforms: tuple[SampledProperty, ...], path: Path) -> MeshObject:
    abc, geometry, _, _ = library(path, "read")
    mesh_class = geometry.IPolyMesh if geometry.IPolyMesh.matches(item.getHeader()) else geometry.ISubD
    schema = mesh_class(item, abc.WrapExistingFlag.kWrapExisting).getSchema()
    parent = item.getParent()
    # Exporters write a mesh "BodyShape" below an Xform "Body", and the user's name for it is that of the Xform.
    is_only_child = geometry.IXform.matches(parent.getHeader()) and parent.getNumChildren() == 1
    name = (parent if is_only_child else item).getName()
    times = _sample_times(schema.getPositionsProperty(), path)
    return MeshObject(name, schema, SampledProperty(times, _point_reader(schema)), transforms)


def at_time(time: float) -> Any:
    """Return the library's selector of the sample nearest to a time in seconds."""
    from alembic3d.Abc import ISampleSelector  # pyright: ignore

    return ISampleSelector(float(time))  # the library takes an int for seconds as well, not for a sample index


def points_of(values: Any) -> Float[np.ndarray, "V 3"]:
    """Convert an array of 3-vectors of the library to double precision."""
    return np.asarray(values, np.float32).astype(np.float64).reshape(-1, 3)


def integers_of(values: Any) -> Int[np.ndarray, " N"]:
    """Convert an integer array of the library; its unsigned arrays do not offer the buffer that NumPy reads."""
    return np.fromiter(values, np.int64, len(values))


def _schema_name(item: Any) -> str:
    """Return the kind of an object as a word: "camera" for the schema "AbcGeom_Camera_v1"."""
    return item.getMetaData().get("schema").removeprefix("AbcGeom_").rpartition("_v")[0].lower() or "object"


def _is_visible(geometry: Any, item: Any, is_parent_shown: bool) -> bool:
    """Return whether an object is visible in any sample; "deferred" and no setting mean as its parent."""
    visibility = geometry.GetVisibilityProperty(item)
    if not visibility.valid() or not visibility.getNumSamples():
        return is_parent_shown
    states = [sample for sample in visibility.samples]
    deferred = int(geometry.ObjectVisibility.kVisibilityDeferred)
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
        matrix = schema.getValue(at_time(time)).getMatrix()  # for row vectors (x' = x M), so it is transposed
        return np.array([[matrix[j][i] for j in range(4)] for i in range(4)], np.float64)

    return read


def _point_reader(schema: Any) -> Callable[[float], np.ndarray]:
    points = schema.getPositionsProperty()
    return lambda time: points_of(points.getValue(at_time(time)))


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
