"""A USD stage opened for reading: the meshes it shows, where they stand, and over which time codes they move."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pxr import Ar, Sdf, Usd, UsdGeom, UsdUtils

from ...core.errors import InputError
from ..beside import is_confined, may_be_read

# usd-core tells type checkers nothing of what is in it.
# pyright: reportAttributeAccessIssue=false

EVERYTHING = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
"""Active, defined, loaded prims, those inside instances included."""
REST = Usd.TimeCode.Default()


def open_stage(path: Path) -> Usd.Stage:
    """The stage of a file with all its payloads; the file is only read.

    Raises:
        InputError: it is confined (see `beside`) and names files outside of its folder.
    """
    if is_confined():
        _check_names(path)
    known = Sdf.Layer.Find(str(path))
    if known and not known.dirty:
        known.Reload()  # layers that somebody still holds would not show that the file was written again
    return Usd.Stage.Open(str(path))


def shown_meshes(stage: Usd.Stage, path: Path) -> list[Usd.Prim]:
    """Prims of type Mesh that have points, are visible and of purpose default or render, in stage order.

    Visibility is that of the stage's first time code. Meshes inside of point instancers are not among them: they stand
    where the instancer puts them.

    Raises:
        InputError: there are none; the prims that there are get named.
    """
    time = Usd.TimeCode(stage.GetStartTimeCode())
    shown = [prim for prim in _visible(stage, time) if prim.IsA(UsdGeom.Mesh) and _has_points(prim)]
    if not shown:
        kinds = Counter(str(prim.GetTypeName()) or "untyped prim" for prim in stage.Traverse(EVERYTHING))
        found = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(6)) or "no prims"
        lost = [str(error) for error in stage.GetCompositionErrors()]
        found += f" (and not: {lost[0].splitlines()[0][:200]})" if lost else ""
        raise InputError(
            f"{path}: expected a visible mesh of purpose default or render, found {found}; "
            "export the meshes, without instancing them by points"
        )
    return shown


def matrix(value) -> Float[np.ndarray, "4 4"]:
    """A transform of USD, which multiplies rows from the right, as one that multiplies columns from the left."""
    return np.array(value, np.float64).T


def turned_about(prim: Usd.Prim) -> Iterator[UsdGeom.Xformable]:
    """The prims whose transforms place a prim in the world, from itself up."""
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            yield UsdGeom.Xformable(prim)
            if UsdGeom.Xformable(prim).GetResetXformStack():
                return
        prim = prim.GetParent()


def stage_span(stage: Usd.Stage, samples: list[float], path: Path) -> tuple[float, float]:
    """First and last time code: as authored, or of the samples of what moves the meshes; once where nothing moves.

    Raises:
        InputError: the authored span is not finite.
    """
    if not samples:
        return 0.0, 0.0
    start, stop = min(samples), max(samples)
    if stage.HasAuthoredTimeCodeRange():
        start, stop = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not np.isfinite([start, stop]).all():
        raise InputError(f"{path}: expected finite time codes, found {start:g} to {stop:g}; export it again")
    return start, max(start, stop)


def transform_samples(prim: Usd.Prim) -> list[float]:
    """Time codes at which something was authored that places a prim in the world."""
    return [time for one in turned_about(prim) if one.TransformMightBeTimeVarying() for time in one.GetTimeSamples()]


def stands_by_default(prim: Usd.Prim) -> bool:
    """Whether points, faces and transforms of a prim have values outside of time too."""
    attributes = [op.GetAttr() for one in turned_about(prim) for op in one.GetOrderedXformOps()]
    mesh = UsdGeom.Mesh(prim)
    attributes += [mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()]
    return all(attribute.Get(REST) is not None for attribute in attributes)


def _check_names(path: Path) -> None:
    """Follow every layer, payload, clip and asset that a file names, before the first of them is opened.

    What is named outside of the folder and is not there does no harm.
    """
    waiting, seen = [str(path)], set()
    while waiting:
        layer = Sdf.Layer.FindOrOpen(waiting.pop())
        if layer is None or layer.identifier in seen:
            continue
        seen.add(layer.identifier)
        for name in filter(None, itertools.chain(*UsdUtils.ExtractExternalReferences(layer.identifier))):
            found = Ar.GetResolver().Resolve(layer.ComputeAbsolutePath(name)).GetPathString()
            file = Ar.SplitPackageRelativePathOuter(found)[0] if found else ""
            if file and not may_be_read(file):
                raise InputError(
                    f"{path}: expected the names of files that came with it, found {name[:80]!r}; give them together"
                )
            if file and _is_layer(found):
                waiting.append(found)


def _is_layer(name: str) -> bool:
    return Sdf.FileFormat.FindByExtension(name.rstrip("]")) is not None


def _visible(stage: Usd.Stage, time: Usd.TimeCode) -> Iterator[Usd.Prim]:
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot(), EVERYTHING))
    for prim in prims:
        hidden = prim.IsA(UsdGeom.Imageable) and _invisible(UsdGeom.Imageable(prim), time)
        if hidden or prim.IsA(UsdGeom.PointInstancer):
            prims.PruneChildren()
        elif prim.IsA(UsdGeom.Mesh):
            purpose = UsdGeom.Imageable(prim).ComputePurpose()
            if purpose in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render):
                yield prim


def _invisible(prim: UsdGeom.Imageable, time: Usd.TimeCode) -> bool:
    return prim.GetVisibilityAttr().Get(time) == UsdGeom.Tokens.invisible


def _has_points(prim: Usd.Prim) -> bool:
    points = UsdGeom.Mesh(prim).GetPointsAttr()
    return bool(points.Get(REST) or points.Get(Usd.TimeCode.EarliestTime()))
