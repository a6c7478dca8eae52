"""One method on one pair: what the method is given, and how far its result is from the truth."""

from __future__ import annotations

import dataclasses
import json
import time
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..core import geometry
from ..core.errors import InputError
from ..core.geometry import edges
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization, bbox_centre, radius
from ..methods.base import Method
from ..methods.find import find_method, weights_path
from ..pipeline import animate, transfer
from .clip_protocols import ClipPair, on_template
from .metrics import (
    chamfer,
    clip_pmd,
    edge_score,
    flipped,
    foot_skate,
    in_unit_sphere_of,
    jitter,
    largest_stretch,
    liveliness,
    mean_error_mm,
    path_error_mm,
    pmd_of_pair,
    pmd_public,
    resized,
    unrest_mm,
)
from .pairs import Pair

GIVEN = {
    "copy": "true dense correspondence, true size",
    "deformation-transfer-dense": "third mesh, true dense correspondence",
    "deformation-transfer-13": "third mesh, 13 control points",
    "deformation-transfer-5": "third mesh, 5 control points",
    "skeleton": "our body model and its joint limits",
}
"""What a method is given besides the two meshes and their axes; for networks see `given`."""
TRAINED_ON = {
    "table6": "16 people x 400 poses",
    "wide": "endless people and poses",
    "clips80": "16 people x 80 motions",
    "clips": "endless people and motions",
}
"""Kinds of training data, in words."""
CLIP_FIGURES = {"path_mm": 2, "jitter": 4, "liveliness": 3, "still_mm": 4, "skate_cm_s": 3}
"""Figures that only clips have, and their decimals; the mean is over the clips that have them."""
AXES: dict[str, Any] = {"up": "+y", "front": "+z", "driving_up": "+y", "driving_front": "+z"}
RESAMPLES = 2000
"""Draws of the bootstrap behind the confidence intervals."""


class NotApplicableError(InputError):
    """A method cannot work on a pair by its nature."""


def given(method: str) -> str:
    """What a method knows besides the two meshes and their axes."""
    if method in GIVEN:
        return GIVEN[method]
    network = find_method(method)
    more = (
        ", true size" if knows_no_size(network) else ", which it fits" if getattr(network, "fits_body", False) else ""
    )
    return f"trained on our body{more}"


def trained(method: str) -> str:
    """The training behind a method, from the card beside its weights; `before` are trainings that it went on from."""
    path = weights_path(method)
    if method in GIVEN:
        return "none"
    if not path.with_suffix(".json").exists():
        return "unknown"
    card = json.loads(path.with_suffix(".json").read_text())
    count = card["config"]["data"]["vertices"] or 6890
    data = TRAINED_ON[card["config"]["data"]["kind"]]
    stages = [card, *card.get("before", [])]
    minutes = f"{sum(stage['seconds_trained'] for stage in stages) / 60:.0f} min, {card['hardware']}"
    return f"{minutes}; {sum(stage['pairs'] for stage in stages):,} pairs of {count:,} vertices; {data}"


def moved(pair: Pair, method: str | Method, ensemble: int = 1, refine: bool = False) -> Float[np.ndarray, "V 3"]:
    """The identity's vertices as a method moves them, in metres.

    By name it is one of GIVEN, of `methods.MODELS` or in an `.onnx` file; else it is one of your own.

    Axes are given to all alike: finding them is not what is measured here. Networks that were told the true size are
    not refined.

    Raises:
        NotApplicableError: the method cannot work on this pair, such as deformation transfer of a point cloud.
    """
    if not isinstance(method, str):
        return transfer(pair.identity, pair.driving, method, **AXES, refine=refine).vertices
    if method == "copy":
        return resized(needed(pair.aligned, method), pair.truth)
    if method.startswith("deformation-transfer"):
        driving, helps = helped(pair, method)
        return transfer(pair.identity, driving, "deformation-transfer", **AXES, **helps).vertices
    network = find_method(method, ensemble=ensemble)
    if knows_no_size(network):
        clip = Clip.still(pair.driving)
        return in_true_size(network, pair.identity, clip, pair.truth[None])[0]
    return transfer(pair.identity, pair.driving, method, **AXES, ensemble=ensemble, refine=refine).vertices


def helped(pair: Pair, method: str) -> tuple[Mesh, dict[str, Any]]:
    """The driving mesh, and the third mesh and the markers, that a deformation transfer of GIVEN is given.

    Raises:
        NotApplicableError: it cannot work on this pair.
    """
    if method == "deformation-transfer-dense":
        driving, third = (
            Mesh(needed(points, method), pair.identity.faces)
            for points in (pair.aligned, pair.aligned_reference)
        )  # fmt: skip
        return driving, {"reference": third}
    if len(pair.driving.faces) == 0:
        raise NotApplicableError(f"{method}: expected triangles to take gradients of, found points")
    reference = dataclasses.replace(pair.driving, vertices=needed(pair.reference, method))
    markers = needed(pair.markers, method)[: 5 if method.endswith("-5") else 13]
    return pair.driving, {"reference": reference, "markers": markers[markers[:, 1] >= 0]}


def knows_no_size(method: Method) -> bool:
    """Whether the unit of a network's results is the truth's radius, which the papers' tables give away."""
    return getattr(method, "target_scale", "identity") == "truth"


def in_true_size(
    network: Any, identity: Mesh, clip: Clip, truth: Float[np.ndarray, "T V 3"]
) -> Float[np.ndarray, "T V 3"]:
    """What such a network makes of a clip: each frame in the size of its truth, the path in that of the first frame."""
    unit = dataclasses.replace(network, target_scale="identity")
    own, theirs = Normalization.fit(identity, "+y", "+z"), Normalization.fit(clip.mesh, "+y", "+z")
    identity, driving = (
        dataclasses.replace(mesh, vertices=frame.apply(mesh.vertices))
        for mesh, frame in ((identity, own), (clip.mesh, theirs))
    )
    results = unit.prepare(identity, Clip.still(driving))(theirs.apply(vertices) for vertices in clip.vertices)
    sizes = [radius(true - bbox_centre(true)) for true in truth]
    middles_and_sizes = ((result, bbox_centre(result), size) for result, size in zip(results, sizes, strict=True))
    return np.stack([(result - middle) * size + middle * sizes[0] for result, middle, size in middles_and_sizes])


def measure(pair: Pair, method: str | Method, **options: Any) -> dict[str, Any]:
    """Figures of one pair, or {"why": ...} where the method cannot work on it."""
    started = time.perf_counter()
    try:
        result = moved(pair, method, **options)
    except NotApplicableError as error:
        return {"why": str(error)}
    seconds = time.perf_counter() - started
    faces = pair.identity.faces
    return {**shape_figures(result, pair.truth, faces, geometry.edges(faces), pair.height), "seconds": seconds}


def shape_figures(
    result: Float[np.ndarray, "V 3"],
    truth: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    edges: Int[np.ndarray, "E 2"],
    height: float,
) -> dict[str, float]:
    """All figures of one mesh against its truth."""
    sized, true = in_unit_sphere_of(truth, result, truth)
    return {
        "pmd_e4": 1e4 * pmd_of_pair(result, truth),
        "pmd_mse_e4": 1e4 * pmd_public(result, truth),
        "chamfer_e4": 1e4 * chamfer(sized, true),
        "mm": mean_error_mm(result, truth, height),
        "edge_score": edge_score(result, truth, edges),
        "stretch": largest_stretch(result, truth, edges),
        "flipped": flipped(result, truth, faces),
    }


def summary(method: str, kind: str, figures: list[dict[str, Any]]) -> dict[str, Any]:
    """One row: means, and the tail of the errors, where users live."""
    done = [f for f in figures if "why" not in f]
    row: dict[str, Any] = {"method": method, "split": kind, "pairs": len(done)}
    row |= {"given": given(method), "trained": trained(method)}
    if len(done) < len(figures):
        row["not_applicable"] = len(figures) - len(done)
        row["why"] = next(f["why"] for f in figures if "why" in f)
    if not done:
        return row
    errors = np.array([f["pmd_e4"] for f in done])
    row |= {
        "pmd_e4": round(float(errors.mean()), 4),
        "pmd_e4_ci95": round(half_interval(errors), 4),
        "pmd_e4_median": round(float(np.median(errors)), 4),
        "pmd_e4_p90": round(float(np.quantile(errors, 0.9)), 4),
        "pmd_e4_max": round(float(errors.max()), 4),
    }
    for name, digits in (("pmd_mse_e4", 4), ("chamfer_e4", 4), ("mm", 2), ("edge_score", 4), ("flipped", 5)):
        row[name] = round(float(np.mean([f[name] for f in done])), digits)
    for name, digits in CLIP_FIGURES.items():
        known = [f[name] for f in done if f.get(name) is not None]
        if known:
            row[name] = round(float(np.mean(known)), digits)
    row["stretch_max"] = round(max(f["stretch"] for f in done), 2)
    row["seconds_per_frame"] = round(float(np.median([f["seconds"] for f in done])), 4)
    return row


def needed(array: Any, method: str) -> Any:
    """Help that a method asks for; raises NotApplicableError where the test set has none."""
    if array is None:
        raise NotApplicableError(f"{method}: expected a correspondence, found none in this test set")
    return array


def half_interval(errors: Float[np.ndarray, " N"]) -> float:
    """Half of the 95 % confidence interval of the mean, by bootstrap over pairs."""
    drawn = np.random.default_rng(0).integers(len(errors), size=(RESAMPLES, len(errors)))
    low, high = np.quantile(errors[drawn].mean(axis=1), [0.025, 0.975])
    return float(high - low) / 2


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
    return on_template(trial) if method not in GIVEN and getattr(find_method(method), "template_only", False) else trial


def standing_still(trial: ClipPair) -> ClipPair:
    """The same trial with its first frame in all frames, a few of them."""
    frames = {
        name: np.repeat(getattr(trial, name)[:1], STILL, axis=0) for name in ("truth_frames", "aligned_frames")
    }  # fmt: skip
    clip = dataclasses.replace(trial.clip, vertices=np.repeat(trial.clip.vertices[:1], STILL, axis=0))
    return dataclasses.replace(trial, clip=clip, **frames)


def _frames(result) -> Float[np.ndarray, "T V 3"]:
    return result.clip.vertices.astype(np.float64)
