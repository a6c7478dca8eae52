"""Open a USD stage for reading: its visible mesh prims, their transforms, and the range of time codes."""

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

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false

ALL_PRIMS = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
"""Traversal predicate: active, defined, loaded prims that are not abstract, including those inside instances."""
DEFAULT_TIME = Usd.TimeCode.Default()
"""The time of values that are authored without a time code."""


def open_stage(path: Path) -> Usd.Stage:
    """Open the stage of a file with all its payloads, for reading only.

    Raises:
        InputError: reading is confined to a folder (see `beside.confined`) and the file refers to files outside of it.
    """
    if is_confined():
        _check_references(path)
    # USD shares layers between stages: without a reload, one that is still open shows the file as it was before.
    open_layer = Sdf.Layer.Find(str(path))
    if open_layer and not open_layer.dirty:
        open_layer.Reload()
    return Usd.Stage.Open(str(path))


def shown_meshes(stage: Usd.Stage, path: Path) -> list[Usd.Prim]:
    """Find the Mesh prims that have points, are visible and of purpose default or render, in stage order.

    Visibility is that of the stage's first time code. Meshes below point instancers are left out: they are prototypes,
    shown only where the instancer places them.

    Raises:
        InputError: there are none; the message lists the prims that were found.
    """
    time = Usd.TimeCode(stage.GetStartTimeCode())
    shown = [prim for prim in _visible(stage, time) if prim.IsA(UsdGeom.Mesh) and _has_points(prim)]
    if not shown:
        kinds = Counter(str(prim.GetTypeName()) or "untyped prim" for prim in stage.Traverse(ALL_PRIMS))
        found = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(6)) or "no prims"
        # An unresolved reference is the usual reason for an empty stage, so the first one is quoted.
        errors = [str(error) for error in stage.GetCompositionErrors()]
        found += f" (and not: {errors[0].splitlines()[0][:200]})" if errors else ""
        raise InputError(
            f"{path}: expected a visible mesh of purpose default or render, found {found}; "
            "export the meshes, without instancing them by points"
        )
    return shown


def column_matrix(value) -> Float[np.ndarray, "4 4"]:
    """Convert a USD matrix, which multiplies row vectors (x' = x M), to one for column vectors (x' = M x)."""
    return np.array(value, np.float64).T


def transform_chain(prim: Usd.Prim) -> Iterator[UsdGeom.Xformable]:
    """Yield the prims whose transforms place a prim in the world, from the prim itself up to the root.

    It ends early at a prim that resets the transform stack: its ancestors have no effect.
    """
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            yield UsdGeom.Xformable(prim)
            if UsdGeom.Xformable(prim).GetResetXformStack():
                return
        prim = prim.GetParent()


def time_code_range(stage: Usd.Stage, sample_times: list[float], path: Path) -> tuple[float, float]:
    """Return the first and last time code of a stage: as authored, else those of the samples.

    Without samples nothing moves, and both are 0.

    Raises:
        InputError: the authored range is not finite.
    """
    if not sample_times:
        return 0.0, 0.0
    start, stop = min(sample_times), max(sample_times)
    if stage.HasAuthoredTimeCodeRange():
        start, stop = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not np.isfinite([start, stop]).all():
        raise InputError(f"{path}: expected finite time codes, found {start:g} to {stop:g}; export it again")
    return start, max(start, stop)


def transform_sample_times(prim: Usd.Prim) -> list[float]:
    """Collect the time codes of all samples of the transforms that place a prim in the world."""
    chain = transform_chain(prim)
    return [time for xform in chain if xform.TransformMightBeTimeVarying() for time in xform.GetTimeSamples()]


def has_default_values(prim: Usd.Prim) -> bool:
    """Return whether points, faces and transforms of a mesh prim all have values at the default time."""
    attributes = [op.GetAttr() for xform in transform_chain(prim) for op in xform.GetOrderedXformOps()]
    mesh = UsdGeom.Mesh(prim)
    attributes += [mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()]
    return all(attribute.Get(DEFAULT_TIME) is not None for attribute in attributes)


def _check_references(path: Path) -> None:
    """Check every layer, payload, clip and asset that a file refers to, directly or not, before any of them is opened.

    Opening a stage opens all of them, so a file of a stranger could otherwise read any file of this machine. References
    to files that do not exist are harmless and pass.

    Raises:
        InputError: a reference leads outside of the folder that reading is confined to.
    """
    pending, visited = [str(path)], set()
    while pending:
        layer = Sdf.Layer.FindOrOpen(pending.pop())
        if layer is None or layer.identifier in visited:
            continue
        visited.add(layer.identifier)
        for name in filter(None, itertools.chain(*UsdUtils.ExtractExternalReferences(layer.identifier))):
            found = Ar.GetResolver().Resolve(layer.ComputeAbsolutePath(name)).GetPathString()
            # A file inside a package resolves to "package.usdz[file]": the file to check is the package.
            file = Ar.SplitPackageRelativePathOuter(found)[0] if found else ""
            if file and not may_be_read(file):
                raise InputError(
                    f"{path}: expected the names of files that came with it, found {name[:80]!r}; give them together"
                )
            if file and _is_layer(found):
                pending.append(found)


def _is_layer(name: str) -> bool:
    """Return whether a name, also one inside a package ("a.usdz[b.usda]"), has the suffix of a layer format."""
    return Sdf.FileFormat.FindByExtension(name.rstrip("]")) is not None


def _visible(stage: Usd.Stage, time: Usd.TimeCode) -> Iterator[Usd.Prim]:
    """Yield the Mesh prims that are visible at a time and meant for rendering."""
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot(), ALL_PRIMS))
    for prim in prims:
        # An invisible prim hides all of its descendants.
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
    return bool(points.Get(DEFAULT_TIME) or points.Get(Usd.TimeCode.EarliestTime()))
