"""One method on one clip: the method is prepared once and moves all frames, as `mimesh animate` does it."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.geometry import edges
from ..core.mesh import Clip
from ..core.normalization import radius
from ..methods.find import find_method
from ..methods.limp import Limp
from ..pipeline import animate
from .clip_metrics import clip_pmd, foot_skate, jitter, liveliness, path_error_mm, unrest_mm
from .clip_protocols import ClipPair, on_template
from .measure import AXES, GIVEN, NotApplicableError, helped, in_true_size, knows_no_size, shape_figures

STILL = 5
"""Frames of the clip that stands still."""


def moved_clip(trial: ClipPair, method: str, ensemble: int = 1, refine: bool = False) -> Float[np.ndarray, "T V 3"]:
    """The identity's vertices in all frames, in metres; methods and their help are those of `measure.moved`.

    `copy` is the driving person in one size for the whole clip: its mean radius is that of the truth.

    Raises:
        NotApplicableError: the method cannot work on this clip.
    """
    if method == "copy":
        sizes = [np.mean([radius(v - v.mean(axis=0)) for v in c]) for c in (trial.truth_frames, trial.aligned_frames)]
        return trial.aligned_frames * (sizes[0] / sizes[1])
    if method.startswith("deformation-transfer"):
        driving, helps = helped(trial, method)
        frames = trial.aligned_frames if method.endswith("-dense") else trial.clip.vertices
        clip = Clip(driving, frames, trial.clip.fps)
        return _frames(animate(trial.identity, clip, "deformation-transfer", **AXES, **helps))
    network = find_method(method, ensemble=ensemble)
    if knows_no_size(network):
        return in_true_size(network, trial.identity, trial.clip, trial.truth_frames)
    return _frames(animate(trial.identity, trial.clip, method, **AXES, ensemble=ensemble, refine=refine))


def measure_clip(trial: ClipPair, method: str, **options: Any) -> dict[str, Any]:
    """Figures of one clip, or {"why": ...} where the method cannot work on it.

    Those of shape are means over the frames (the worst, for stretch); `seconds` are those of a frame, all included.
    LIMP knows its template alone, so it is measured on the trial's vertices that are the template's.
    """
    trial = as_known(trial, method)
    started = time.perf_counter()
    try:
        result = moved_clip(trial, method, **options)
    except NotApplicableError as error:
        return {"why": str(error)}
    seconds = (time.perf_counter() - started) / len(result)
    truth, fps = trial.truth_frames, trial.clip.fps
    faces = trial.identity.faces
    surface = (faces, edges(faces), trial.height)
    shapes = [shape_figures(a, b, *surface) for a, b in zip(result, truth, strict=True)]
    figures = {name: float(np.mean([shape[name] for shape in shapes])) for name in shapes[0]}
    return figures | {
        "pmd_e4": 1e4 * clip_pmd(result, truth),
        "stretch": max(shape["stretch"] for shape in shapes),
        "path_mm": path_error_mm(result, truth, trial.height),
        "jitter": jitter(result, truth, trial.height, fps),
        "liveliness": liveliness(result, truth),
        "still_mm": unrest_mm(moved_clip(standing_still(trial), method, **options), trial.height),
        "skate_cm_s": foot_skate(result, truth, trial.height, fps),
        "seconds": seconds,
    }


def as_known(trial: ClipPair, method: str) -> ClipPair:
    """The trial on all vertices, or on those of the template that LIMP knows."""
    return on_template(trial) if method not in GIVEN and isinstance(find_method(method), Limp) else trial


def standing_still(trial: ClipPair) -> ClipPair:
    """The same trial with its first frame in all frames, a few of them."""
    frames = {
        name: np.repeat(getattr(trial, name)[:1], STILL, axis=0) for name in ("truth_frames", "aligned_frames")
    }  # fmt: skip
    clip = dataclasses.replace(trial.clip, vertices=np.repeat(trial.clip.vertices[:1], STILL, axis=0))
    return dataclasses.replace(trial, clip=clip, **frames)


def _frames(result) -> Float[np.ndarray, "T V 3"]:
    return result.clip.vertices.astype(np.float64)
