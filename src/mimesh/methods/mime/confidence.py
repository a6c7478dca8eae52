"""How sure the readings of a mesh are: what is not a person is read differently every time, and held by nobody."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.rig import Rig, hanging

LIMBS = {
    "head": "Neck",
    "left arm": "LeftArm",
    "right arm": "RightArm",
    "left leg": "LeftUpLeg",
    "right leg": "RightUpLeg",
}
"""Each begins at a joint."""


@dataclass(frozen=True)
class Doubt:
    """Of the readings of one mesh."""

    apart: float
    """Mean angle (degrees) of joints' rotations from what the readings agree on; the median of the readings."""
    undecided: float
    """Mean entropy (nats) of the skinning weights over the surface: 0 where every point knows its joint."""
    limbs: dict[str, float]
    """Share of the surface that the joints of each limb hold; empty where points need not be spread evenly."""
    astray: dict[str, float] = field(default_factory=dict)
    """Share of each limb of the body that no surface is near, after the fit; empty without one."""
    bare: float = 0.0
    """Share of the surface that no part of the body is near, after the fit."""

    @classmethod
    def of(
        cls,
        apart: float,
        weights: Float[np.ndarray, "N J"],
        joints: tuple[str, ...],
        parents: tuple[int, ...],
    ) -> Doubt:
        """From skinning weights of points that are spread evenly over the surface."""
        undecided = -(weights * np.log(np.maximum(weights, 1e-12))).sum(axis=1).mean()
        held = weights.mean(axis=0)
        tops = {limb: joints.index(top) for limb, top in LIMBS.items() if top in joints}
        limbs = {limb: float(held[hanging([top], parents)].sum()) for limb, top in tops.items()}
        return cls(apart, float(undecided), limbs)


def turns_apart(one: Rig, other: Rig) -> float:
    """Mean angle (degrees) between the rotations of two readings."""
    cosine = (np.einsum("jab,jab->j", one.rotation, other.rotation) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())
