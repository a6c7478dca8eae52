"""The report of a result and of its files: their keys, and the measurements of the moved surface."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies.joint_names import finger_joints
from ..core.animated_rig import AnimatedRig
from ..core.errors import option
from ..core.frame_buffer import LazyFrames, evenly_spread
from ..core.geometry import edges
from ..core.mesh import Mesh, merged_mesh
from ..core.normalization import Normalization

MOST_FRAMES, MOST_POINTS = 32, 250_000
"""Largest number of frames, evenly spread, by which a clip is measured, and of vertices in all of them together."""
MIN_EDGE = 1e-3
"""Share of the mean edge length below which the stretch of an edge is not measured."""
TORN = 3.0
"""Factor over the median edge by which a torn edge is longer than at rest."""
MAX_TORN = 0.01
"""Largest share of torn surface of a result without a note: see docs/log/mime.md, 2026-11-28."""


class MeshReport(TypedDict):
    """What is known of one input: its axes, and of models with joints how certainly limbs were found on it.

    `limbs` and `unmatched_body` have a share for each limb ("head", "left arm"). docs/conventions.md explains all.

    Example:
        >>> identity = result.report["identity"]
        >>> identity["up"], identity["front"], identity["confidence"] > 0.5
        ('+y', '+z', True)
    """

    up: str
    """Axis away from the ground, such as "+y"."""
    front: str
    """Axis to the front, such as "+z"."""
    up_from: str
    """Where `up` is from: "given", "file", "joints", "identity" or "shape"."""
    detected: bool
    """Whether an axis was detected from the shape."""
    margin: float
    """By how much the detected axes were better than the next ones: a difference of scores, without a unit."""
    confidence: NotRequired[float]
    """From 0 to 1; below 0.5 there is a note. Absent where joints are those of a file."""
    uncertainty: NotRequired[float]
    """Ratio to the threshold of the note: above 1 there is one."""
    expected_error: NotRequired[float]
    """Expected error of the result, in heights of the identity."""
    prediction_spread: NotRequired[float]
    """Spread of the predictions, in degrees."""
    weight_entropy: NotRequired[float]
    """Mean entropy of the skinning weights, in nats."""
    other_kind: NotRequired[float]
    """Logarithm of the odds that the mesh is of another kind than `body`, without a unit."""
    fit_distance: NotRequired[float]
    """Mismatch of the shapes of fitted body and surface, in metres of the body."""
    fit_angle: NotRequired[float]
    """Mean angle between fitted and predicted joint rotations, in degrees."""
    flexion: NotRequired[float]
    """Angle of the elbow or knee that is bent most, in degrees."""
    enclosed: NotRequired[float]
    """Share of the inner joints of a person that the surface encloses; 1 of animals and open surfaces."""
    limbs: NotRequired[dict[str, float]]
    """Share of the surface that each limb has."""
    unmatched_body: NotRequired[dict[str, float]]
    """Share of each limb of the fitted body that is far from the surface."""
    unmatched_surface: NotRequired[float]
    """Share of the surface that is far from the fitted body."""


class RigReport(MeshReport):
    """What is known of a rigged mesh.

    Example:
        >>> rigged.report["fingers"]
        []
    """

    fingers: list[Literal["left", "right"]]
    """Hands that have joints of fingers."""


class CaptureReport(MeshReport):
    """What is known of a captured clip: that of its first frame, and what the joints do.

    Example:
        >>> sorted(captured.report["contacts"])
        ['LeftFoot', 'RightFoot']
    """

    height: float
    """Height of the highest joint above the lowest one in the T-pose, in the unit of the clip."""
    unit: NotRequired[float]
    """Unit of the clip in metres; absent where its file does not say."""
    contacts: NotRequired[dict[str, list[tuple[int, int]]]]
    """Joint of each foot -> when it is on the ground: number of the first frame taken that it is in, from 0, and of the
    one after the last. Absent of fewer than three frames, and where no foot was found."""


class MatchReport(TypedDict):
    """How the rigs of two creatures were matched with each other."""

    confidence: float
    """From 0 to 1."""
    covered: list[float]
    """Share of the joints of identity and of driving that have a counterpart."""
    chains: float
    """Agreement of the chains of joints, a share from 0 to 1."""
    names: float | None
    """Agreement of the names, a share from 0 to 1; None where there are too few."""
    joints: dict[str, str]
    """Joint of the identity -> joint of the driving that it follows."""


class ReferenceReport(TypedDict):
    """The frame of the driving that was taken to have the identity's pose."""

    frame: int
    """Number of the frame, from 0."""
    distance: float
    """Distance from the identity's pose, as a share of its size."""


class TransferReport(TypedDict):
    """What was measured and found: `result.report`. It is a dictionary, as the JSON of the command line has it.

    Keys of what was not measured are absent: `result.report.get("fingers")`.

    Example:
        >>> report = result.report
        >>> report["body"], report["fingers"], report["edge_stretch_p99"] < 2
        ('human', [], True)
    """

    identity: MeshReport
    """Axes of the identity, and how certain its limbs are."""
    driving: MeshReport
    """The same of the driving, in its first frame."""
    edge_stretch_max: NotRequired[float]
    """Largest factor by which an edge became longer or shorter in any frame; absent for point clouds."""
    edge_stretch_p99: NotRequired[float]
    """The same of 99 % of the edges: a factor."""
    torn_share: NotRequired[float]
    """Share of the surface whose edges became more than three times as long, in the worst frame."""
    torn_at: NotRequired[list[float]]
    """Middle of the longest torn edge in that frame, on the mesh at rest, in its unit; absent if little is torn."""
    body: NotRequired[str]
    """Shipped body that both were taken for: "human" or "quadruped"."""
    rig: NotRequired[Literal["own"]]
    """"own" where the identity moved on the bones of its own file."""
    copied: NotRequired[bool]
    """Whether values of the driving's nodes were copied, as both files have the same skeleton."""
    match: NotRequired[MatchReport]
    """How the rigs of two creatures were matched."""
    reference: NotRequired[ReferenceReport]
    """The driving's frame in the identity's pose, where another shape of one mesh was moved."""
    fingers: NotRequired[list[Literal["left", "right"]]]
    """Hands whose fingers move."""
    foot_skate: NotRequired[float | None]
    """Mean speed of soles that should stand, in identity heights a second; None where none do."""
    foot_skate_driving: NotRequired[float | None]
    """The same of the driving's, in the same unit."""
    influence_deviation: NotRequired[float]
    """With `skinned`: largest distance of a vertex from where all weights take it, as a share of the mesh's size."""


class Deviations(TypedDict):
    """How far a written file is from the frames of a result, which `SavedClip` has; keys that do not apply are absent.

    Example:
        >>> saved = moving.save_skinned("walking.glb")
        >>> sorted(saved.deviations[0])
        ['deviation_cause', 'skinned_deviation']
    """

    skinned_deviation: NotRequired[float]
    """Of joints: largest distance of a vertex from its frame, as a share of the mesh's size."""
    deviation_cause: NotRequired[str]
    """What it is due to, of joints found on the surface: few "weights", "fingers" of other clips, or another "rest"."""


class SavedClip(type(Path())):
    """The path of the file or folder that was written of one `ClipResult` or of several.

    Example:
        >>> saved = moving.save_skinned("walking.glb")
        >>> saved.name, saved.deviations[0]["skinned_deviation"] < 0.1  # share of the size
        ('walking.glb', True)
    """

    deviations: tuple[Deviations, ...] = ()
    """For each result how far the file is from its frames."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Keep them in copies, and on the way from another process."""
        return saved_clip, (str(self), *self.deviations)


def saved_clip(path: str | Path, *deviations: Deviations) -> SavedClip:
    """Return the path of a written clip with its deviations."""
    saved = SavedClip(path)
    saved.deviations = deviations
    return saved


def quality(identity: Mesh, moved: LazyFrames) -> dict[str, Any]:
    """Measure edge stretch and the share of torn surface in the worst frame of all.

    Says where the surface is torn if much of it is. Empty for a point cloud.
    """
    if len(identity.faces) == 0:
        return {}
    identity, moved = merged_mesh(identity, moved.group), moved.distinct
    pairs = edges(identity.faces)
    lengths = edge_lengths(identity.vertices, pairs)
    weights = np.square(lengths)  # as triangles by their areas: slivers weigh nothing
    stretches, torn, most_torn = [], 0.0, lengths
    # Frame by frame: the edges of a large mesh in all frames would take gigabytes.
    most = max(2, min(MOST_FRAMES, MOST_POINTS // len(identity.vertices)))
    for vertices in moved.at(evenly_spread(len(moved), most)):
        posed = edge_lengths(vertices, pairs)
        stretch = edge_stretch(lengths, posed)
        stretches.append((stretch.max(initial=1.0), np.quantile(stretch, 0.99) if stretch.size else 1.0))
        longer = torn_edges(lengths, posed)
        share = float(weights[longer].sum() / max(weights.sum(), 1e-300))
        if share > torn:
            torn, most_torn = share, np.where(longer, posed, 0.0)
    largest, p99 = np.max(stretches, axis=0)
    where = {}
    if torn > MAX_TORN:  # the middle at rest of the longest torn edge
        where = {"torn_at": identity.vertices[pairs[most_torn.argmax()]].mean(axis=0).tolist()}
    return {"edge_stretch_max": float(largest), "edge_stretch_p99": float(p99), "torn_share": torn} | where


def edge_lengths(vertices: Float[np.ndarray, "V 3"], pairs: Int[np.ndarray, "E 2"]) -> Float[np.ndarray, " E"]:
    """Return the length of each edge."""
    x, y, z = (vertices.take(pairs[:, 0], axis=0) - vertices.take(pairs[:, 1], axis=0)).T
    return np.sqrt(x * x + y * y + z * z)


def edge_stretch(old: Float[np.ndarray, " E"], new: Float[np.ndarray, " E"]) -> Float[np.ndarray, " S"]:
    """Return the factor by which each edge became longer or shorter (1: unchanged), without the shortest edges."""
    measured = old > MIN_EDGE * (old.mean() if len(old) else 0.0)
    # Twice as long and half as long are the same stretch; the bound keeps collapsed edges finite.
    ratio = np.maximum(new[measured] / old[measured], 1e-6)
    return np.maximum(ratio, 1 / ratio)


def torn_edges(old: Float[np.ndarray, " E"], new: Float[np.ndarray, " E"]) -> Bool[np.ndarray, " E"]:
    """Mark the edges that are more than TORN times as long as before, over the median edge."""
    measured = old > 0
    ratio = np.divide(new, old, out=np.zeros_like(new), where=measured)
    return ratio > TORN * (np.median(ratio[measured]) if measured.any() else 1.0)


def torn_note(
    report: Mapping[str, Any], name: str, found: bool, skeleton: AnimatedRig | None = None
) -> tuple[str, ...]:
    """Return a note for the user if much of the result `name` is torn (`quality`).

    Args:
        found: joints were found on its surface.
        skeleton: of it; its joint that is nearest is named. None: none is known.
    """
    if "torn_at" not in report:
        return ()
    share, place = report["torn_share"], report["torn_at"]
    where = f"the point {', '.join(f'{x:.3g}' for x in place)} of the mesh at rest"
    if skeleton is not None:
        nearest = np.linalg.norm(skeleton.rig.joints - place, axis=1).argmin()
        where = f"{skeleton.names[nearest]} ({where})"
    helps = f": {option('joints', ...)} corrects joints, {option('body', ...)} says what the mesh is" if found else ""
    return (
        f"{share:.0%} of the surface of {name} is torn, its edges more than {TORN:g} times as long as at rest, most "
        f"near {where}; limbs may be found wrongly, look at the result{helps}",
    )


def fingered_hands(joints: Collection[str]) -> list[Literal["left", "right"]]:
    """Return the hands whose fingers are among some joints."""
    hands: dict[str, Literal["left", "right"]] = {"Left": "left", "Right": "right"}
    return [name for side, name in hands.items() if any(joint in joints for joint in finger_joints(side))]


def facing(norm: Normalization) -> MeshReport:
    """Return the axes that were used for one input, as reports have them."""
    return {
        "up": norm.up,
        "front": norm.front,
        "up_from": norm.up_from,
        "detected": norm.detected,
        "margin": round(norm.margin, 3),
    }


def facing_note(norm: Normalization, name: str, front: str) -> tuple[str, ...]:
    """Return notes for the user if the file's up contradicts the shape, or axes were detected with a small margin.

    `front` is the option of the front.
    """
    notes = ()
    if norm.shape_up is not None:
        notes += (
            f"the file of {name} defines up {norm.up}, its shape looks like up {norm.shape_up}; "
            f"give {option(front.replace('front', 'up'), norm.shape_up)} if the file is wrong",
        )
    if not norm.unsure:
        return notes
    return notes + (
        f"the facing of {name} is uncertain (taken: up {norm.up}, front {norm.front}); "
        f"give {option(front.replace('front', 'up'), ...)} and {option(front, ...)} if it faces elsewhere",
    )
