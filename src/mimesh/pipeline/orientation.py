"""Normalise meshes, and correct detected axes by what a method predicts in other orientations."""

from __future__ import annotations

import dataclasses

from ..core.mesh import Mesh
from ..core.normalization import ORIENTATIONS, Normalization, axis_name, parse_axis
from ..methods.base import QuickPredictor
from ..methods.confidence import Confidence

MIN_GAIN = 0.15
"""Decrease of the skinning weights' mean entropy (nats) from which on other axes are taken (docs/log/mime.md)."""


def normalised(mesh: Mesh, norm: Normalization) -> Mesh:
    """Apply a normalisation to the vertices of a mesh."""
    return dataclasses.replace(mesh, vertices=norm.apply(mesh.vertices), up="+y")


def reorient(
    method: QuickPredictor,
    mesh: Mesh,
    norm: Normalization,
    axes: tuple[str | None, str | None],
    confidence: Confidence | None,
) -> Normalization:
    """Return a normalisation with corrected axes, or the same one if no other orientation is clearly better.

    Needed only where axes were detected and the method does not recognise the mesh.
    """
    if not norm.detected or confidence is None or confidence.recognised:
        return norm
    lowest, detected, chosen = predicted_orientation(method, mesh, norm, axes)
    # A small gain may be noise of the prediction: the detector's axes are then kept.
    return norm if lowest > detected - MIN_GAIN else chosen


def predicted_orientation(
    method: QuickPredictor, mesh: Mesh, norm: Normalization, axes: tuple[str | None, str | None]
) -> tuple[float, float, Normalization]:
    """Find the orientation in which a method's prediction is most decided.

    It predicts once for each of the 24 orientations that the axes of the user and the file allow, 4 where up is known,
    1 where both are. The one with the lowest entropy of skinning weights wins, and the axes of the hips predicted in
    it, rounded to the mesh's, are the new up and front.

    Args:
        norm: the present normalisation.
        axes: up and front as the user gave them.

    Returns the lowest entropy (nats), that in the present orientation, and the normalisation with the new axes: the
    present one if they are the same.
    """
    up, front = parse_axis(axes[0], "--up"), parse_axis(axes[1], "--front")
    up = norm.up if norm.up_from == "file" else up
    allowed = [names for names in ORIENTATIONS if up in (None, names[0]) and front in (None, names[1])]
    predictions = []
    for names in allowed:
        candidate = Normalization.fit(mesh, *names)
        entropy, hips = method.quick_predict(normalised(mesh, candidate))
        predictions.append((entropy, candidate, hips))
    lowest, best, hips = min(predictions, key=lambda prediction: prediction[0])
    # Columns 1 and 2 of the hips' rotation are their up and front; `best.rotation.T` brings them into the mesh's axes.
    names = tuple(axis_name(best.rotation.T @ hips[:, k]) for k in (1, 2))
    chosen = Normalization.fit(mesh, *names) if names in allowed else best
    present = next(entropy for entropy, n, _ in predictions if (n.up, n.front) == (norm.up, norm.front))
    if (chosen.up, chosen.front) == (norm.up, norm.front):
        return lowest, present, norm
    # A margin of 0 makes the report say that the facing is uncertain.
    uncertain = dataclasses.replace(chosen, detected=True, margin=0.0, up_from=norm.up_from, shape_up=norm.shape_up)
    return lowest, present, uncertain
