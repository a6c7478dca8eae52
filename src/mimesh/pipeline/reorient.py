"""Which way a mesh stands, where its shape misled the detector: as the model that has to read it knows it best."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from ..core.mesh import Mesh
from ..core.normalization import AXES, ORIENTATIONS, Frame, parse_axis
from ..methods.mime.confidence import Doubt
from ..methods.mime.drive import Mime
from .report import strange

MUCH = 0.15
"""By so much (nats) skinning weights must be less undecided for other axes to be taken."""


def known(method: Mime, mesh: Mesh, frame: Frame, axes: tuple[str | None, str | None], doubt: Doubt) -> Frame:
    """The Frame that was found, or a better one if the model hardly knows the mesh in it and the user gave no axes.

    All Frames that the user's axes leave are tried; the hips then say where up and front are in the best of them.
    """
    if not frame.detected or not strange(doubt):
        return frame
    up, front = parse_axis(axes[0], "--up"), parse_axis(axes[1], "--front")
    left = [names for names in ORIENTATIONS if up in (None, names[0]) and front in (None, names[1])]
    tried = []
    for names in left:
        fitted = Frame.fit(mesh, *names)
        undecided, hips = method.glance(dataclasses.replace(mesh, vertices=fitted.apply(mesh.vertices)))
        tried.append((undecided, fitted, hips))
    least, best, hips = min(tried, key=lambda each: each[0])
    names = tuple(_nearest_axis(best.rotation.T @ hips[:, k]) for k in (1, 2))
    chosen = Frame.fit(mesh, *names) if names in left else best
    now = next(undecided for undecided, fitted, _ in tried if (fitted.up, fitted.front) == (frame.up, frame.front))
    if least > now - MUCH or (chosen.up, chosen.front) == (frame.up, frame.front):
        return frame
    return dataclasses.replace(chosen, detected=True, margin=0.0)


def _nearest_axis(direction: Float[np.ndarray, " 3"]) -> str:
    k = int(np.abs(direction).argmax())
    return AXES[k if direction[k] > 0 else k + 3]
