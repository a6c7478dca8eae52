"""Measure how well a method recognised a mesh: figures for the report, and notes for the user where they are bad.

Predictions for a mesh that is not a whole person differ between samples of its points, its skinning weights are spread
over many joints, and a body fitted to it leaves parts of itself or of the surface unmatched.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from ..bodies.anatomy import QUADRUPED, anatomy_of_joints
from ..core.errors import option
from ..core.geometry import angles_between
from ..core.rig import descendants

# Thresholds, tuned on meshes of whole people and of other things (docs/log/mime.md).
MAX_SPREAD = 15.0
"""Largest spread (degrees) of the predictions for a whole person."""
MAX_ENTROPY = 0.81
"""Largest mean entropy (nats) of a whole person's skinning weights."""
MIN_SHARE = {"head": 0.03, "left arm": 0.025, "right arm": 0.025, "left leg": 0.08, "right leg": 0.08}
"""Smallest share of a whole person's surface for each limb; for arms and legs of the surface without the head. Stubby
legs of figures that are read rightly have 0.09 to 0.11."""
MIN_SYMMETRY = 0.45
"""Smallest share of a whole limb, in those of its counterpart on the other side."""
MAX_UNMATCHED_LIMB, MAX_UNMATCHED_SURFACE = 0.025, 0.006
"""A limb was not found if more than the first share of it is far from the surface, and more than the second share of
the surface is far from the body. Holes in a mesh exceed only the first, clothes and hair only the second.
"""
FOLDED = 150.0
"""Flexion (degrees) of an elbow or knee from which on the lower limb would be inside the upper one. Limbs that are cut
off in the middle are often taken for folded ones: 6 % of bad results have one, no good one does (docs/log/mime.md)."""
MISSING_LIMB = 0.4
"""A limb is missing if more than this share of it is far from the surface, whatever the rest. One-sided scans: 0.3."""

EXPECTED_ERROR = {"constant": -7.17, "spread": 0.45, "entropy": 1.64, "fit_distance": 1.38}
"""Logarithm of the mean error of a result (heights of the identity) whose worse mesh this is: constant, and
coefficients of `Confidence.features`. Entropy and distance count as in OTHER_KIND. Fitted by
`research/fit_confidence.py` (docs/log/mime.md, "Warnings that can be trusted")."""
MAX_ERROR = 0.042
"""Largest expected error of a mesh without a note. Of 101 good results one has a note, of 41 bad ones 36 have."""
ANIMAL_ERROR = {
    "constant": -9.5464,
    "spread": 0.4036,
    "entropy": 0.2241,
    "fit_distance": 0.695,
    "fit_angle": 1.3674,
    "incomplete": 1.5916,
}
"""The same for animals: of what a mesh adds to the error of a result (docs/log/mime.md, "Confidence, fitted again")."""
OTHER_KIND = {"constant": -8.3, "entropy": 3.64, "fit_distance": 3.07}
"""Logarithm of the odds that a mesh shows something else than the body that was fitted to it, where both are as likely
beforehand: constant, and coefficients of `Confidence.features`. Fitted by `research/measure_wrong_kind.py`, which also
compares other figures. The spread of the predictions is not among them: those of figures of blocks face both ways."""
MAX_OTHER_KIND = 1.1
"""Largest of these of a person or an animal. Of 46 meshes of people of the pool's split val one is above it: a figure
of blocks that is misread."""
PERSON_DISTANCE, DISTANCE_WEIGHT = 0.022, 10.0
"""Mean distance of the surface from the fitted person (metres of the body) from which on a mesh is the less accepted,
and the weight of its logarithm. Clothes reach 0.036 and noise 0.030, at an `other_kind` below -1.8; people who sit and
are misread 0.025 to 0.07 (docs/log/mime.md, 2026-11-28). Animals of blocks have up to 0.068."""
PERSON_SPREAD, SPREAD_WEIGHT = 20.0, 10.0
"""Spread (degrees) of the predictions for a person above MAX_OTHER_KIND from which on a mesh is the less accepted, and
the weight of its logarithm. Of such people at the joint limits the largest is 19.7, of a fist 36, of a snowman 26, of
people who are misread 22 to 35. Below MAX_OTHER_KIND figures of blocks, which face both ways, have up to 139."""
STRAIGHT, STRAIGHT_ENTROPY, STRAIGHT_OTHER_KIND, STRAIGHT_MISFIT = 80.0, 1.1, -0.3, 3.0
"""Flexion (degrees) up to which the limbs of a person are straight, and most certain to be found: the largest entropy
(nats) of its weights and `other_kind` together, and what is added to the misfit of a mesh with more of both, or with
more than MAX_OTHER_KIND. At rest such people have an entropy of 0.89 at most; figures of blocks 1.09 in a stride,
1.43 at the joint limits; a person of 600 faces with 1 cm of noise 1.32, but an `other_kind` of -0.5
(docs/log/mime.md)."""
LEAST_ENCLOSED, OUTSIDE_WEIGHT = 0.9, 25.0
"""Share of a person's inner joints that the surface encloses, from which down on a mesh is the less accepted, and the
weight of what lacks. Of people at rest and in clips 0.94 is the least, of creatures that were moved as people 0.12 to 1
(docs/log/mime.md, "Joints outside of the surface")."""
OTHER_KIND_ERROR = 0.15
"""Smallest expected error (heights of the identity) of a mesh above that, whose true error is not defined."""
DOUBTFUL_ERROR = 0.08
"""Expected error (heights of the identity) from which on a note says that the mesh may be something else."""
MOST_LACKING = 3
"""Limbs without a surface from which on a note says so, too: a chair taken for an animal lacks a head and two legs."""


def if_it_is(alone: bool) -> str:
    """Return advice for meshes that do not look like the body that was looked for, or for one that has no driving."""
    advice = (
        f"if it is a person or a four-legged animal, say which with {option('body', ...)}, and how it stands with "
        f"{option('up', ...)} and {option('front', ...)}"
    )
    if alone:
        return advice
    return (
        f"{advice} (of the driving: {option('driving_up')}, {option('driving_front')}); "
        f"other things need rigs in both files, or {option('body', 'other')}"
    )


SMALLEST_SHARE = 1e-3
"""Share of the surface that a limb has at least in ratios: keeps them finite."""


@dataclass(frozen=True)
class Standards:
    """What predictions for a whole body of one kind are like."""

    kind: str
    """What it is called, with its article."""
    max_entropy: float
    """As MAX_ENTROPY."""
    min_share: dict[str, float]
    """As MIN_SHARE."""
    expected_error: dict[str, float]
    """As EXPECTED_ERROR."""
    max_error: float
    """As MAX_ERROR."""
    doubtful_error: float
    """As DOUBTFUL_ERROR."""
    folded: float = FOLDED
    """As FOLDED."""
    distance: float = np.inf
    """As PERSON_DISTANCE."""
    spread: float = np.inf
    """As PERSON_SPREAD."""
    straight: float = -np.inf
    """As STRAIGHT."""

    @classmethod
    def of(cls, joints: tuple[str, ...]) -> Standards:
        """Find those of the body that has some joints."""
        return QUADRUPED_STANDARDS if anatomy_of_joints(joints) is QUADRUPED else HUMAN_STANDARDS


HUMAN_STANDARDS = Standards(
    kind="a person",
    max_entropy=MAX_ENTROPY,
    min_share=MIN_SHARE,
    expected_error=EXPECTED_ERROR,
    max_error=MAX_ERROR,
    doubtful_error=DOUBTFUL_ERROR,
    distance=PERSON_DISTANCE,
    spread=PERSON_SPREAD,
    straight=STRAIGHT,
)
QUADRUPED_STANDARDS = Standards(
    kind="a four-legged animal",
    max_entropy=MAX_ENTROPY,
    min_share={"head": 0.04, **dict.fromkeys([limb for limb in QUADRUPED.regions if limb != "head"], 0.012)},
    expected_error=ANIMAL_ERROR,
    max_error=0.025,  # of 63 meshes of other makers the least of those whose limbs are found wrongly and look whole
    doubtful_error=0.04,
    folded=172.0,  # animals that lie fold their legs by up to 164
)


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
    surface_distance: float = 0.0
    """Mean distance of the surface from the fitted body (metres of the body)."""
    fit_distance: float | None = None
    """Mismatch of the shapes of fitted body and surface (metres of the body); None without a fit."""
    enclosed: float = 1.0
    """Share of the body's inner joints that the surface encloses; 1 without a fit, and of an open surface."""
    fit_angle: float = 0.0
    """Mean angle (degrees) between the fitted joint rotations and the predicted ones."""
    flexion: float = 0.0
    """Flexion (degrees) of the elbow or knee that is bent most; 0 is straight."""
    standards: Standards = HUMAN_STANDARDS
    """What the figures of the body that was looked for are compared with."""

    @classmethod
    def of(
        cls,
        prediction_spread: float,
        weights: Float[np.ndarray, "N J"],
        joints: tuple[str, ...],
        parents: tuple[int, ...],
    ) -> Confidence:
        """Compute entropy and limb shares from skinning weights of points that are spread evenly over the surface."""
        entropy = -(weights * np.log(np.maximum(weights, 1e-12))).sum(axis=1).mean()
        share = weights.mean(axis=0)
        limbs = {limb: float(share[of_limb].sum()) for limb, of_limb in limb_joints(joints, parents).items()}
        return cls(prediction_spread, float(entropy), limbs, standards=Standards.of(joints))

    def features(self) -> dict[str, float]:
        """Compute the figures that the expected error depends on, most of them as logarithms."""
        return {
            "spread": float(np.log1p(self.prediction_spread)),
            "entropy": self.weight_entropy,
            "fit_distance": float(np.log1p(1e3 * (self.fit_distance or 0.0))),
            "fit_angle": float(np.log1p(self.fit_angle)),
            "incomplete": float(np.log1p(max(self._incompleteness(limb) for limb in self.standards.min_share))),
        }

    @property
    def recognised(self) -> bool:
        """Whether the predictions are those of a body of the kind that was looked for."""
        return not (self.prediction_spread > MAX_SPREAD or self.weight_entropy > self.standards.max_entropy)

    @property
    def whole(self) -> bool:
        """Whether the mesh is recognised, and the fitted body looks like it."""
        return self.recognised and not self.is_other_kind

    @property
    def lacks_leg(self) -> bool:
        """Whether a leg was not found, so that there are no soles to be planted."""
        return any("leg" in limb for limb in self._incomplete())

    @property
    def fitted(self) -> bool:
        """Whether a body was fitted to the mesh."""
        return self.fit_distance is not None

    @property
    def other_kind(self) -> float:
        """Logarithm of the odds that the mesh is of another kind than the body that was looked for; needs a fit."""
        features = self.features()
        return OTHER_KIND["constant"] + sum(OTHER_KIND[name] * features[name] for name in ("entropy", "fit_distance"))

    @property
    def misfit(self) -> float:
        """Measure by which a mesh is refused: `other_kind`, and more where the surface is away from the fitted body.

        People who sit are read upside down or folded by predictions that agree; the body then covers less of them.
        What hardly looks like a person, and is predicted otherwise each time, is refused, too, and so is what hardly
        looks like one though its limbs are straight: hands, cats that sit, aeroplanes. So is what has joints outside.
        """
        away = max(self.surface_distance / self.standards.distance, 1.0)
        apart = max(self.prediction_spread / self.standards.spread, 1.0) if self.is_other_kind else 1.0
        uncertain = self.weight_entropy > STRAIGHT_ENTROPY and self.other_kind > STRAIGHT_OTHER_KIND
        unlike = self.is_other_kind or uncertain
        odd = STRAIGHT_MISFIT if unlike and self.flexion <= self.standards.straight else 0.0
        odd += OUTSIDE_WEIGHT * max(LEAST_ENCLOSED - self.enclosed, 0.0)
        return self.other_kind + DISTANCE_WEIGHT * float(np.log(away)) + SPREAD_WEIGHT * float(np.log(apart)) + odd

    @property
    def is_other_kind(self) -> bool:
        """Whether the mesh does not look like a body of the kind that was looked for."""
        return self.fitted and self.other_kind > MAX_OTHER_KIND

    @property
    def expected_error(self) -> float:
        """Predict the mean error of a result whose worse mesh this is, in heights of the identity; needs a fit."""
        figures = {"constant": 1.0} | self.features()
        error = float(np.exp(sum(value * figures[name] for name, value in self.standards.expected_error.items())))
        return max(error, OTHER_KIND_ERROR) if self.is_other_kind else error

    @property
    def limb_fault(self) -> float:
        """The larger ratio of what is missing of a limb, and of how far one is folded, to their thresholds.

        A limb that the mesh lacks is predicted somewhere, and all predictions of it may agree.
        """
        missing = max(self._incompleteness(limb) for limb in self.standards.min_share)
        return max(missing, self.flexion / self.standards.folded)

    @property
    def uncertainty(self) -> float:
        """The larger ratio of expected error and faulty limb to their thresholds; above 1 there is a note.

        Without a fit it is the largest ratio of the other figures to theirs.
        """
        if self.fitted:
            return max(self.expected_error / self.standards.max_error, self.limb_fault)
        entropy = self.weight_entropy / self.standards.max_entropy
        return max(self.prediction_spread / MAX_SPREAD, entropy, self.limb_fault)

    def facts(self) -> dict[str, Any]:
        """Return the figures for the report (docs/conventions.md)."""
        limbs, unmatched = (
            {limb: round(share, 3) for limb, share in d.items()} for d in (self.limbs, self.unmatched_body)
        )
        facts: dict[str, Any] = {
            "uncertainty": round(self.uncertainty, 3),
            "prediction_spread": round(self.prediction_spread, 2),
            "weight_entropy": round(self.weight_entropy, 3),
            "limbs": limbs,
        }
        if self.fit_distance is None:
            return facts
        # A confidence of 0.5 is the threshold of the note.
        facts |= {
            "confidence": round(1 / (1 + self.uncertainty**2), 3),
            "expected_error": round(self.expected_error, 4),
            "other_kind": round(self.other_kind, 2),
            "fit_distance": round(self.fit_distance, 5),
            "fit_angle": round(self.fit_angle, 2),
            "flexion": round(self.flexion, 1),
            "enclosed": round(self.enclosed, 3),
        }
        return facts | {"unmatched_body": unmatched, "unmatched_surface": round(self.unmatched_surface, 4)}

    def notes(self, name: str, alone: bool = False) -> tuple[str, ...]:
        """Return a note for the user if limbs of the mesh `name` were not found with certainty, with reasons.

        Args:
            alone: there is no other mesh.
        """
        if self.uncertainty <= 1:
            return ()
        incomplete = self._incomplete()
        unmatched, reasons = self._without_surface(), []
        if self.prediction_spread > MAX_SPREAD:
            reasons.append(f"predictions for it differ by {self.prediction_spread:.0f} degrees")
        if self.weight_entropy > self.standards.max_entropy:
            reasons.append("much of its surface belongs to no limb in particular")
        if incomplete:
            reasons.append(f"{_listed('no whole', incomplete)} was found")
        if unmatched and not incomplete:
            reasons.append(f"there is no surface where {_listed('the', unmatched)} should be")
        if self.flexion > self.standards.folded:
            reasons.append(f"an elbow or a knee is folded by {self.flexion:.0f} degrees")
        reasons = "; ".join(reasons or ["predictions and surface do not fit together"])
        if self.is_other_kind:
            unlike = f"{name} does not look like {self.standards.kind}, as far as can be told"
            return (f"{unlike}: {reasons}; {if_it_is(alone)}",)
        large = self.fitted and self.expected_error > self.standards.max_error
        error = f" (about {self.expected_error:.0%} of the height)" if large else ""
        feet = ", and feet are not planted" if self.lacks_leg else ""
        doubtful = large and self.expected_error > self.standards.doubtful_error
        lacking = len(self._without_surface()) >= MOST_LACKING
        advice = f". It may not be {self.standards.kind}: {if_it_is(alone)}" if doubtful or lacking else ""
        note = (
            f"{name}: limbs were not found with certainty: {reasons}; check the result for errors{error}{feet}{advice}"
        )
        return (note,)

    def _without_surface(self) -> list[str]:
        """List the limbs of the fitted body that are far from the surface, if parts of the surface are far from it."""
        uncovered = self.unmatched_surface > MAX_UNMATCHED_SURFACE
        return [limb for limb, share in self.unmatched_body.items() if share > MAX_UNMATCHED_LIMB and uncovered]

    def _incomplete(self) -> list[str]:
        return [limb for limb in self.standards.min_share if self._incompleteness(limb) > 1]

    def _incompleteness(self, limb: str) -> float:
        """Return how much of a limb is missing: above 1, its share of the surface is too small, or too much of it is
        far from the surface.
        """
        side, _, kind = limb.partition(" ")
        # Heads of chibis are most of the surface: arms and legs are compared with the rest of it.
        rest = 1.0 if limb == "head" else max(1 - self.limbs.get("head", 0.0), SMALLEST_SHARE)
        counterpart = self.limbs.get(f"{'right' if side == 'left' else 'left'} {kind}", 0.0)
        least = max(self.standards.min_share[limb], MIN_SYMMETRY * counterpart / rest)
        share = max(self.limbs.get(limb, 1.0) / rest, SMALLEST_SHARE)
        return max(least / share, self.unmatched_body.get(limb, 0.0) / MISSING_LIMB)


def limb_joints(names: tuple[str, ...], parents: tuple[int, ...]) -> dict[str, list[int]]:
    """List the joints of head and limbs that a skeleton has, by their indices."""
    regions = anatomy_of_joints(names).regions
    tops = {limb: names.index(top) for limb, top in regions.items() if top in names}
    return {limb: list(descendants([top], parents)) for limb, top in tops.items()}


def largest_flexion(joints: Float[np.ndarray, "J 3"], names: tuple[str, ...]) -> float:
    """Return the largest angle (degrees) between upper and lower bone of an arm or leg; 0 if there are none."""
    hinges = anatomy_of_joints(names).hinges
    chains = [[names.index(name) for name in chain] for chain in hinges if set(chain) <= set(names)]
    if not chains:
        return 0.0
    upper, lower = np.diff(joints[np.array(chains)], axis=1).swapaxes(0, 1)
    length = np.linalg.norm(upper, axis=1) * np.linalg.norm(lower, axis=1)
    cosine = (upper * lower).sum(axis=1) / np.maximum(length, 1e-12)
    return float(np.degrees(np.arccos(cosine.clip(-1, 1))).max())


def mean_angle(first: Float[np.ndarray, "J 3 3"], second: Float[np.ndarray, "J 3 3"]) -> float:
    """Return the mean angle (degrees) between corresponding rotations."""
    return float(angles_between(first, second).mean())


def _listed(article: str, limbs: list[str]) -> str:
    *others, last = (f"{article} {limb}" for limb in limbs)
    return f"{', '.join(others)} and {last}" if others else last
