"""What the user is told: how far edges stretched, what turned over, what jitters, which way was front."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import edges, face_vectors
from ..core.mesh import Clip, Mesh
from ..core.normalization import Frame
from ..methods.mime.confidence import Doubt

MOST_FRAMES = 32
"""A clip is judged by this many of its frames, evenly spread."""
SHORT = 1e-3
"""Edges below this part of the mean length say nothing about stretch."""
STRANGE_APART, STRANGE_UNDECIDED = 15.0, 0.81
"""Readings this far apart (degrees), or weights as undecided as this, are hardly those of a person."""
LEAST = {"head": 0.03, "left arm": 0.025, "right arm": 0.025, "left leg": 0.12, "right leg": 0.12}
"""Shares of the surface that limbs hold at least on people."""
LOPSIDED = 0.45
"""A limb that holds less than this part of what its twin holds is not whole."""
ASTRAY, LEFT_OVER = 0.025, 0.006
"""A limb of which more than this lies off the surface, where more than that of the surface is left over, was not found.
Only the first is so where there are holes, only the second where there are clothes and hair."""
MISSING = 0.4
"""A limb of which more than this lies off the surface is not there; of one that is seen from one side it is 0.3."""


def quality(identity: Mesh, vertices: Float[np.ndarray, "T V 3"]) -> dict[str, float]:
    """Worst edge stretch and share of flipped triangles over the frames of a result; empty for a point cloud."""
    if len(identity.faces) == 0:
        return {}
    pairs = edges(identity.faces)
    chosen = np.unique(np.linspace(0, len(vertices) - 1, min(MOST_FRAMES, len(vertices))).round().astype(int))
    stretches = [edge_stretch(identity.vertices, vertices[t], pairs) for t in chosen]
    flips = [flipped_share(identity.faces, identity.vertices, vertices[t]) for t in chosen]
    return {
        "edge_stretch_max": max(float(stretch.max(initial=1.0)) for stretch in stretches),
        "edge_stretch_p99": max(float(np.quantile(stretch, 0.99)) if stretch.size else 1.0 for stretch in stretches),
        "flipped_share": max(flips),
    }


def edge_stretch(
    before: Float[np.ndarray, "V 3"], after: Float[np.ndarray, "V 3"], pairs: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, " S"]:
    """How many times longer or shorter each edge became (1: unchanged); those of next to no length are left out."""
    old, new = (np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1) for points in (before, after))
    real = old > SHORT * (old.mean() if len(old) else 0.0)
    ratio = np.maximum(new[real] / old[real], 1e-6)
    return np.maximum(ratio, 1 / ratio)


def flipped_share(
    faces: Int[np.ndarray, "F 3"], before: Float[np.ndarray, "V 3"], after: Float[np.ndarray, "V 3"]
) -> float:
    """Share of triangles that came to face against the surface around them and did not before."""
    turned = _against_neighbours(faces, after) & ~_against_neighbours(faces, before)
    return float(turned.mean())


def facing(frame: Frame) -> dict[str, str | bool | float]:
    """The axes that were used for one input."""
    return {"up": frame.up, "front": frame.front, "detected": frame.detected, "margin": round(frame.margin, 3)}


def facing_note(frame: Frame, name: str, option: str) -> tuple[str, ...]:
    """A note for the user where the facing was guessed with little margin."""
    if not frame.unsure:
        return ()
    return (f"the facing of {name} is uncertain (taken: up {frame.up}, front {frame.front}); give {option}",)


def accelerations(driving: Clip, vertices: Float[np.ndarray, "T V 3"]) -> dict[str, dict[str, float]]:
    """Mean acceleration (sizes a second squared) of the result and of its driving; empty for fewer than three frames.

    A result that is much livelier than what it imitates jitters.
    """
    if len(vertices) < 3:
        return {}
    clips = {"result": vertices, "driving": driving.vertices}
    return {"acceleration": {name: acceleration(clip, driving.fps) for name, clip in clips.items()}}


def acceleration(frames: Float[np.ndarray, "T V 3"], fps: float) -> float:
    """Mean length of the second differences of vertices, in sizes of the first frame; of MOST_FRAMES places in time."""
    chosen = np.unique(np.linspace(1, len(frames) - 2, min(MOST_FRAMES, len(frames) - 2)).round().astype(int))
    second = [frames[t - 1].astype(np.float64) - 2.0 * frames[t] + frames[t + 1] for t in chosen]
    return float(np.linalg.norm(second, axis=-1).mean() * fps**2 / np.ptp(frames[0], axis=0).max())


def doubts(doubt: Doubt) -> dict[str, float | dict[str, float]]:
    """How sure the model was of one input."""
    limbs, astray = ({limb: round(share, 3) for limb, share in d.items()} for d in (doubt.limbs, doubt.astray))
    sure = {"readings_apart": round(doubt.apart, 2), "undecided": round(doubt.undecided, 3), "limbs": limbs}
    return sure | ({"astray": astray, "bare": round(doubt.bare, 4)} if astray else {})


def strange(doubt: Doubt) -> bool:
    """Whether readings of a mesh are hardly those of a person."""
    return doubt.apart > STRANGE_APART or doubt.undecided > STRANGE_UNDECIDED


def doubt_notes(doubt: Doubt, name: str) -> tuple[str, ...]:
    """Notes for the user where an input does not look like what the model knows, and why."""
    lacking = [limb for limb in LEAST if _lacks(limb, doubt)]
    lost = [limb for limb, share in doubt.astray.items() if share > ASTRAY and doubt.bare > LEFT_OVER]
    why = []
    if doubt.apart > STRANGE_APART:
        why.append(f"readings of it differ by {doubt.apart:.0f} degrees")
    if doubt.undecided > STRANGE_UNDECIDED:
        why.append("much of its surface belongs to no limb in particular")
    if lacking:
        why.append(f"{_listed('no whole', lacking)} was found")
    if lost and not lacking:
        why.append(f"there is no surface where {_listed('the', lost)} should be")
    return (f"{name} hardly looks like a whole person: {'; '.join(why)}; do not trust the result",) if why else ()


def _listed(article: str, limbs: list[str]) -> str:
    """Limbs as a sentence has them: the head, the left arm and the right arm."""
    *others, last = (f"{article} {limb}" for limb in limbs)
    return f"{', '.join(others)} and {last}" if others else last


def _lacks(limb: str, doubt: Doubt) -> bool:
    """Whether a limb holds too little of the surface, or has too little of it near."""
    least = max(LEAST[limb], LOPSIDED * _twin(limb, doubt))
    return doubt.limbs.get(limb, 1.0) < least or doubt.astray.get(limb, 0.0) > MISSING


def _twin(limb: str, doubt: Doubt) -> float:
    """Share of the surface that the same limb of the other side holds; 0 where there is none."""
    side, _, kind = limb.partition(" ")
    return doubt.limbs.get(f"{'right' if side == 'left' else 'left'} {kind}", 0.0)


def _against_neighbours(faces: Int[np.ndarray, "F 3"], vertices: Float[np.ndarray, "V 3"]) -> np.ndarray:
    vectors = face_vectors(np.asarray(vertices, np.float64), faces)
    corners, thrice = faces.ravel(), np.repeat(vectors, 3, axis=0)
    around = np.stack([np.bincount(corners, thrice[:, k], minlength=len(vertices)) for k in range(3)], axis=1)
    neighbours = around[faces].sum(axis=1) - 3 * vectors
    return (neighbours * vectors).sum(axis=1) < 0
