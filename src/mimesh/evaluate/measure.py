"""Run one method on one pair or clip of a test set, and measure how far its result is from the truth.

Rows of the papers' tables need inputs besides the two meshes (a true correspondence, control points, a third mesh, the
true size). This module passes these inputs on and names them in every report.
"""

from __future__ import annotations

import dataclasses
import json
import time
import zlib
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.geometry import edges
from ..core.mesh import Clip, Mesh, check_size
from ..core.normalization import Normalization, bbox_centre
from ..core.options import Hints, ModelOptions, MotionOptions
from ..methods.base import Method
from ..methods.find import find_model, weights_path
from ..methods.npt import PaperNetwork
from ..mime.model import Mime
from ..pipeline import ClipResult, Result, animate, transfer
from .characters import CharacterPair
from .clip_protocols import ClipPair
from .limb_metrics import LimbedCharacter, limb_metrics
from .metrics import (
    acceleration_ratio,
    box_radius,
    chamfer,
    edge_score,
    flipped,
    foot_skate,
    jitter,
    largest_step_mm,
    largest_stretch,
    mean_error_mm,
    path_error_mm,
    pmd,
    pmd_public,
)
from .pairs import Pair

EXTRA_INPUTS = {
    "identity": "nothing: the identity is not moved",
    "truth": "the true result; of characters with two skeletons an estimate, to show what can be measured",
    "copy": "true dense correspondence, true size",
    "deformation-transfer-dense": "third mesh, true dense correspondence",
    "deformation-transfer-13": "third mesh, 13 control points",
    "deformation-transfer-5": "third mesh, 5 control points",
}
"""Inputs of a method besides the two meshes and their axes, for reports; for networks see `extra_inputs`."""
TRAINED_ON = {
    "table6": "16 people x 400 poses",
    "wide": "random people and poses",
    "clips80": "16 people x 80 motions",
    "clips": "random people and motions",
    "meshes": "registered meshes",
}
"""Description of each kind of training data (`data.kind` of a configuration), for reports."""
AXES = Hints(up="+y", front="+z", driving_up="+y", driving_front="+z")
"""Facing of both meshes, passed to every method: axis detection is not part of what is measured."""
FOLLOWED = MotionOptions(ground=False, contacts=False)
"""Truths have the driving's rotations: their soles slide, and their hands are in the body or off it. So methods are
measured without planted feet and contacts, which have figures of their own (benchmarks/contacts.json)."""
Runtime = Callable[[Mime | Method, Path], Method]
"""Returns a method whose network is run by another library; takes the method and the path of its weights."""
STATIC_FRAMES = 5
"""Number of frames of the static clip that `still_mm` is measured on."""


class NotApplicableError(InputError):
    """A method cannot be applied to a pair, because an input that it needs does not exist there."""


def extra_inputs(method: str) -> str:
    """Describe the inputs of a method besides the two meshes and their axes, for reports."""
    if method in EXTRA_INPUTS:
        return EXTRA_INPUTS[method]
    network = find_model(method)
    shipped = "our quadruped" if getattr(network, "body", "human") == "quadruped" else "our body"
    card, body = card_of(method), shipped
    if "imported" in card:
        body = "its authors' meshes"
    elif card and card["config"]["data"]["kind"] == "meshes":
        body = "own meshes"
    body += ", true correspondence" * (getattr(network, "pairing", "random") == "order")
    if needs_true_size(network):
        return f"trained on {body}, true size"
    return f"trained on {body}, which it fits" if getattr(network, "fits_body", False) else f"trained on {body}"


def card_of(method: str) -> dict[str, Any]:
    """Read the card next to a network's weights; empty without one, or if it is that of other weights."""
    weights = weights_path(method)
    path = weights.with_suffix(".json")
    card = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return card if card.get("crc32") in (None, weights_checksum(weights)) else {}


def weights_checksum(path: Path) -> int:
    """Return the checksum by which a card knows its weights, which are read once while the file does not change."""
    facts = path.stat()
    return _checksum(path, facts.st_mtime_ns, facts.st_size)


@lru_cache(maxsize=64)
def _checksum(path: Path, *_: int) -> int:
    return zlib.crc32(path.read_bytes())


def training_facts(method: str) -> dict[str, Any]:
    """Describe a training for reports, from the card next to the weights: `trained`, `pairs_seen` and `pflop`.

    `before` in a card lists the earlier stages of a training in several stages; time and pairs are their sums.
    """
    if method in EXTRA_INPUTS:
        return {"trained": "none"}
    card = card_of(method)
    if not card:
        return {"trained": "unknown"}
    if "imported" in card:
        return {"trained": f"by its authors, {card['imported']['file']}"}
    settings = card["config"]["data"]
    data = TRAINED_ON[settings["kind"]]
    if settings.get("body") == "quadruped":
        data = data.replace("people", "animals")
    mixed = [name for name, key in (("people", "mix_people"), ("limbs", "recombine")) if settings.get(key)]
    data += f" with mixed {' and '.join(mixed)}" if mixed else ""
    if "meshes" in card:
        data += f", {card['meshes']['people']} people x {card['meshes']['poses']} poses"
    if "characters" in card:
        data += f" and {sum(card['characters']['makers'].values())} characters of other makers"
    stages = [card, *card.get("before", [])]
    minutes = f"{sum(stage['seconds_trained'] for stage in stages) / 60:.0f} min, {card['hardware']}"
    pairs = sum(stage["pairs"] for stage in stages)
    vertices = vertices_of_meshes(card)
    facts = {"trained": f"{minutes}; {pairs:,} pairs of {vertices}; {data}", "pairs_seen": pairs}
    return facts | ({"pflop": card["pflop"]} if "pflop" in card else {})


def vertices_of_meshes(card: dict[str, Any]) -> str:
    """Say from a card how many vertices the meshes of a training had, and since when."""
    whole = card["meshes"]["vertices"] if "meshes" in card else 6890
    count = f"{card['config']['data']['vertices'] or whole:,}"
    changes = [change for change in card.get("changes", []) if "data.vertices" in change and "was" in change]
    if not changes:
        return f"{count} vertices"
    first, last = changes[0]["was"]["data.vertices"] or 6890, card["pairs"] - changes[-1]["after_pairs"]
    return f"{first:,} vertices, the last {last:,} of {count}"


class Output(NamedTuple):
    """What a method gives for a pair or a clip, and where it is compared with the truth."""

    vertices: Float[np.ndarray, "*T V 3"]
    """Vertices of the result in the unit of the pair (metres), of all frames for a clip with their path."""
    origin: Float[np.ndarray, "*T 3"] | None = None
    """Where the method puts the centre of the truth's box: the origin of a network that was trained on centred truths,
    so that an offset of its shapes is an error, as in the papers. None: the centre of the result's own box. Those
    results stand in the world, and their position is no part of the task."""
    confidence: Mapping[str, Any] = MappingProxyType({})
    """`uncertainty` of the result (the larger of the two meshes'), and whether the user is `warned`; empty if a method
    gives no confidence."""

    @classmethod
    def of(cls, result: Result | ClipResult) -> Output:
        """Take vertices and confidence from a result of the library."""
        vertices = result.vertices if isinstance(result, Result) else np.asarray(result.clip.vertices, np.float64)
        values = [result.report[mesh].get("uncertainty") for mesh in ("identity", "driving")]
        known = [value for value in values if value is not None]
        # Up and front are given, so that every note is one of low confidence.
        return cls(vertices, confidence={"uncertainty": max(known), "warned": bool(result.notes)} if known else {})

    def beside(self, truth: Float[np.ndarray, "*T V 3"]) -> Float[np.ndarray, "*T V 3"]:
        """Move the result to where it is compared with the truth, frame by frame."""
        origin = bbox_centre(self.vertices) if self.origin is None else self.origin
        return self.vertices + (bbox_centre(truth) - origin)[..., None, :]


def run_on(
    trial: Pair, method: str | Method, ensemble: int = 1, refine: bool = False, runtime: Runtime | None = None
) -> Output:
    """Run a method on a pair or a clip. Networks that take the true size are not refined.

    The baseline `copy` is scaled once for a whole clip: its mean radius over the frames becomes that of the truth.

    Args:
        method: a name (of EXTRA_INPUTS or of `methods.MODELS`), the path of an `.onnx` file, or a Method object.
        ensemble: see `find_model`.
        refine: see `transfer`.
        runtime: what runs the network instead of onnxruntime.
    """
    clip = trial.clip if isinstance(trial, ClipPair) else None
    truth, aligned = trial.truth, trial.aligned
    if isinstance(trial, ClipPair):
        truth, aligned = trial.truth_frames, trial.aligned_frames
    if method == "identity":
        return Output(np.broadcast_to(trial.identity.vertices, truth.shape))
    if method == "truth":
        return Output(truth)
    if method == "copy":
        aligned = required_input(aligned, "copy")
        return Output(aligned * (box_radius(truth).mean() / box_radius(aligned).mean()))
    if isinstance(method, str) and method.startswith("deformation-transfer"):
        driving, inputs = deformation_transfer_inputs(trial, method)
        if clip is None:
            return Output.of(transfer(trial.identity, driving, "deformation-transfer", hints=AXES, options=inputs))
        frames = aligned if method.endswith("-dense") else clip.vertices
        clip = Clip(driving, required_input(frames, method), clip.fps)
        return Output.of(animate(trial.identity, clip, "deformation-transfer", hints=AXES, options=inputs))
    network = open_network(method, ensemble, runtime) if isinstance(method, str) else method
    # Networks of the papers, whose own results are compared, as in their training; refined ones need a size.
    if isinstance(network, PaperNetwork) and (needs_true_size(network) or not refine):
        if clip is not None:
            return Output(*placed_shapes(network, trial.identity, clip, truth))
        vertices, origin = placed_shapes(network, trial.identity, Clip.still(trial.driving), truth[None])
        return Output(vertices[0], origin[0])
    # Networks that would look at the meshes for a note only are told what these are.
    body = None if isinstance(network, Mime) else getattr(network, "body", None)
    hints = AXES if body is None else dataclasses.replace(AXES, body=body)
    options = ModelOptions(refine=refine)
    if clip is None:
        result = transfer(trial.identity, trial.driving, network, hints=hints, options=options, motion=FOLLOWED)
    else:
        result = animate(trial.identity, clip, network, hints=hints, options=options, motion=FOLLOWED)
    return Output.of(result)


def open_network(name: str, ensemble: int, runtime: Runtime | None) -> Mime | Method:
    """Open a network by its name or path."""
    network = find_model(name, ensemble=ensemble)
    return network if runtime is None else runtime(network, weights_path(name))


def deformation_transfer_inputs(pair: Pair, method: str) -> tuple[Mesh, ModelOptions]:
    """Return the driving mesh for a deformation transfer of EXTRA_INPUTS, and its reference mesh and markers.

    Raises:
        NotApplicableError: the pair has no correspondence or no triangles.
    """
    if method == "deformation-transfer-dense":
        driving, reference = (
            Mesh(required_input(points, method), pair.identity.faces)
            for points in (pair.aligned, pair.aligned_reference)
        )
        return driving, ModelOptions(reference=reference)
    if len(pair.driving.faces) == 0:
        raise NotApplicableError(f"{method}: expected triangles to take gradients of, found points")
    reference = dataclasses.replace(pair.driving, vertices=required_input(pair.reference, method))
    # The first 5 landmarks are the paper's 5 control points; markers that the driving mesh lacks are left out.
    markers = required_input(pair.markers, method)[: 5 if method.endswith("-5") else 13]
    return pair.driving, ModelOptions(reference=reference, markers=markers[markers[:, 1] >= 0])


def needs_true_size(method: Mime | Method) -> bool:
    """Return whether a network's unit is the radius of the truth, as in the papers' tables: no user has that number."""
    return getattr(method, "target_scale", "identity") == "truth"


def placed_shapes(
    network: PaperNetwork, identity: Mesh, clip: Clip, truth: Float[np.ndarray, "T V 3"]
) -> tuple[Float[np.ndarray, "T V 3"], Float[np.ndarray, "T 3"]]:
    """Run a network of the papers on a clip; give its shapes in metres on the driving's path, and their origins.

    The unit is that of the training: the radius of each frame's truth, or the identity's. The path has that of frame 0.
    """
    identity_norm = Normalization.fit(identity, "+y", "+z")
    driving_norm = Normalization.fit(clip.mesh, "+y", "+z")
    identity, driving = (
        dataclasses.replace(mesh, vertices=norm.apply(mesh.vertices))
        for mesh, norm in ((identity, identity_norm), (clip.mesh, driving_norm))
    )
    network = network.with_sizes((identity.name, identity_norm.radius), (driving.name, driving_norm.radius))
    frames = driving_norm.apply(np.asarray(clip.vertices, np.float64))
    shapes = np.stack(list(network.shapes(identity, Clip.still(driving))(check_size(frames, driving.name))))
    sizes = box_radius(truth) if needs_true_size(network) else np.full(len(truth), identity_norm.radius)
    origin = bbox_centre(frames) * sizes[0]
    return shapes * sizes[:, None, None] + origin[:, None], origin


def measure(trial: Pair, method: str | Method, **options: Any) -> dict[str, Any]:
    """Measure a method on a pair or a clip and return its metrics, its confidence, and the seconds that a frame took.

    Of two characters, their limbs are compared, too, and vertices only if their truth is known. Metrics of shape of a
    clip are means over the frames (`stretch`: the maximum). Without a result: {"why": reason} if the method cannot be
    applied, {"failed": reason} if it refuses the pair or a coordinate is not finite.
    """
    trial = in_supported_order(trial, method)
    started = time.perf_counter()
    try:
        result = run_on(trial, method, **options)
    except NotApplicableError as error:
        return {"why": str(error)}
    except InputError as error:
        return {"failed": str(error)}
    facts = {**result.confidence, "seconds": time.perf_counter() - started}
    moved, metrics = result.vertices, dict[str, Any]()
    if not np.isfinite(moved).all():
        return {"failed": "the result has coordinates that are not finite"}
    if isinstance(trial, ClipPair):
        truth, fps = trial.truth_frames, trial.clip.fps
        frames = [shape_metrics(*both, trial) for both in zip(result.beside(truth), truth, strict=True)]
        copies, first = (STATIC_FRAMES, 1, 1), {}
        for name in ("truth_frames", "aligned_frames"):
            frames_of = getattr(trial, name)
            first[name] = None if frames_of is None else np.tile(frames_of[:1], copies)
        clip = dataclasses.replace(trial.clip, vertices=np.tile(trial.clip.vertices[:1], copies))
        still = run_on(dataclasses.replace(trial, clip=clip, **first), method, **options).vertices
        return {
            **{name: float(np.mean([frame[name] for frame in frames])) for name in frames[0]},
            "stretch": max(frame["stretch"] for frame in frames),
            "path_mm": path_error_mm(moved, truth, trial.height),
            "jitter": jitter(moved, truth, trial.height, fps),
            "liveliness": acceleration_ratio(moved, truth),
            "still_mm": largest_step_mm(still, trial.height),
            "skate_cm_s": foot_skate(moved, truth, trial.height, fps),
            **facts,
            "seconds": facts["seconds"] / len(moved),
        }
    if trial.truth_known:
        metrics = shape_metrics(result.beside(trial.truth), trial.truth, trial)
    if isinstance(trial, CharacterPair):
        characters = (trial.identity_character, trial.driving_character)
        identity, driving = (LimbedCharacter(character.rig, character.limbs) for character in characters)
        metrics |= limb_metrics(identity, driving, moved, trial.driving.vertices)
    return metrics | facts


def shape_metrics(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], pair: Pair) -> dict[str, float]:
    """Return all metrics of one mesh against its truth, beside which it lies (`Output.beside`)."""
    faces, pairs = pair.identity.faces, edges(pair.identity.faces)
    return {
        "pmd_e4": 1e4 * pmd(result, truth),
        "pmd_public_e4": 1e4 * pmd_public(result, truth, pair.metres),
        "chamfer_e4": 1e4 * chamfer(result, truth) / float(box_radius(truth)) ** 2,
        "mm": mean_error_mm(result, truth, pair.height),
        "edge_score": edge_score(result, truth, pairs),
        "stretch": largest_stretch(result, truth, pairs),
        "flipped": flipped(result, truth, faces),
    }


def required_input(array: Any, method: str) -> Any:
    """Return an extra input of a method; raise NotApplicableError if the test set does not have it."""
    if array is None:
        raise NotApplicableError(f"{method}: expected a correspondence, found none in this test set")
    return array


def in_supported_order(trial: Pair, method: str | Method) -> Pair:
    """Return a clip in the body's vertex order for networks with weights for each vertex, else the trial as it is."""
    if not isinstance(trial, ClipPair) or trial.place is None or not isinstance(method, str) or method in EXTRA_INPUTS:
        return trial
    return trial.reordered(trial.place, trial.place) if getattr(find_model(method), "vertices", 0) else trial
