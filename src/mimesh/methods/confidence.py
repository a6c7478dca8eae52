"""How well a method recognised an input: figures for the report, and notes for the user where they are bad.

A mesh that is not a whole person is predicted differently from every sample of its points, its skinning weights are
spread over many joints, and a body fitted to it leaves parts of itself or of the surface unmatched.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.rig import Rig, descendants

LIMBS = {
    "head": "Neck",
    "left arm": "LeftArm",
    "right arm": "RightArm",
    "left leg": "LeftUpLeg",
    "right leg": "RightUpLeg",
}
"""Limb -> its first joint."""

# Thresholds, tuned on meshes of whole people and of things that are none (docs/LOG.md).
MAX_SPREAD = 15.0
"""Degrees: predictions of a whole person differ by less."""
MAX_ENTROPY = 0.81
"""Nats: skinning weights of a whole person have less."""
MIN_SHARE = {"head": 0.03, "left arm": 0.025, "right arm": 0.025, "left leg": 0.12, "right leg": 0.12}
"""Smallest share of the surface that each limb of a person has."""
MIN_SYMMETRY = 0.45
"""A limb with less than this part of the surface of its counterpart on the other side is not whole."""
MAX_UNMATCHED_LIMB, MAX_UNMATCHED_SURFACE = 0.025, 0.006
"""A limb was not found if more than the first share of it is far from the surface while more than the second share of
the surface is far from the body. Only the first holds where a mesh has holes, only the second under clothes and hair.
"""
MISSING_LIMB = 0.4
"""A limb is missing if more than this share of it is far from the surface; in one-sided scans it is 0.3."""


@dataclass(frozen=True)
class Confidence:
    """How consistent the predictions for one mesh are, and how well the fitted body covers it."""

    prediction_spread: float
    """Mean angle (degrees) of the joints' rotations from the consensus; the median over the predictions."""
    weight_entropy: float
    """Mean entropy (nats) of the skinning weights over the surface: 0 where every point has one joint."""
    limbs: dict[str, float]
    """Share of the surface that each limb has; empty where the points are not spread evenly (point clouds)."""
    unmatched_body: dict[str, float] = field(default_factory=dict)
    """Share of each limb of the fitted body that is far from the surface; empty without a fit."""
    unmatched_surface: float = 0.0
    """Share of the surface that is far from the fitted body."""

    @classmethod
    def of(
        cls,
        prediction_spread: float,
        weights: Float[np.ndarray, "N J"],
        joints: tuple[str, ...],
        parents: tuple[int, ...],
    ) -> Confidence:
        """From skinning weights of points that are spread evenly over the surface."""
        entropy = -(weights * np.log(np.maximum(weights, 1e-12))).sum(axis=1).mean()
        share = weights.mean(axis=0)
        tops = {limb: joints.index(top) for limb, top in LIMBS.items() if top in joints}
        limbs = {limb: float(share[descendants([top], parents)].sum()) for limb, top in tops.items()}
        return cls(prediction_spread, float(entropy), limbs)

    @property
    def recognised(self) -> bool:
        """Whether the predictions are those of a person."""
        return not (self.prediction_spread > MAX_SPREAD or self.weight_entropy > MAX_ENTROPY)

    def facts(self) -> dict[str, Any]:
        """The figures as they stand in reports."""
        limbs, astray = (
            {limb: round(share, 3) for limb, share in d.items()} for d in (self.limbs, self.unmatched_body)
        )
        facts: dict[str, Any] = {
            "readings_apart": round(self.prediction_spread, 2),
            "undecided": round(self.weight_entropy, 3),
            "limbs": limbs,
        }
        return facts | ({"astray": astray, "bare": round(self.unmatched_surface, 4)} if astray else {})

    def notes(self, name: str) -> tuple[str, ...]:
        """A note for the user if the mesh `name` does not look like a whole person, and why."""
        lacking = [limb for limb in MIN_SHARE if self._lacks(limb)]
        uncovered = self.unmatched_surface > MAX_UNMATCHED_SURFACE
        lost = [limb for limb, share in self.unmatched_body.items() if share > MAX_UNMATCHED_LIMB and uncovered]
        why = []
        if self.prediction_spread > MAX_SPREAD:
            why.append(f"readings of it differ by {self.prediction_spread:.0f} degrees")
        if self.weight_entropy > MAX_ENTROPY:
            why.append("much of its surface belongs to no limb in particular")
        if lacking:
            why.append(f"{_listed('no whole', lacking)} was found")
        if lost and not lacking:
            why.append(f"there is no surface where {_listed('the', lost)} should be")
        return (f"{name} hardly looks like a whole person: {'; '.join(why)}; do not trust the result",) if why else ()

    def _lacks(self, limb: str) -> bool:
        """Whether a limb has too little of the surface, or too little of it is near the surface."""
        side, _, kind = limb.partition(" ")
        counterpart = self.limbs.get(f"{'right' if side == 'left' else 'left'} {kind}", 0.0)
        least = max(MIN_SHARE[limb], MIN_SYMMETRY * counterpart)
        return self.limbs.get(limb, 1.0) < least or self.unmatched_body.get(limb, 0.0) > MISSING_LIMB


def mean_angle(one: Rig, other: Rig) -> float:
    """Mean angle (degrees) between the joint rotations of two predictions."""
    cosine = (np.einsum("jab,jab->j", one.rotation, other.rotation) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


def _listed(article: str, limbs: list[str]) -> str:
    """Limbs as a sentence lists them: the head, the left arm and the right arm."""
    *others, last = (f"{article} {limb}" for limb in limbs)
    return f"{', '.join(others)} and {last}" if others else last
