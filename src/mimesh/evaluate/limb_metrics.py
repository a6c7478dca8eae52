"""Metrics of a result without true vertices: how well it follows a driving mesh with another skeleton.

Both characters are rigged, but poses are read from vertices alone, in the same way for the result and the driving mesh
(`limb_calibration`). What two skeletons have in common is compared: directions of limbs, ends of limbs, feet on the
ground, and self-penetration. All figures ignore translation. Each character is measured in its own lengths at rest, so
files may have any unit, but a result that is larger or smaller than its identity is an error, except for directions. A
figure is None where the limbs that it needs cannot be measured.

Both meshes are y up and face +z in one frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from ..bodies.character_limbs import SIDES
from .limb_calibration import CHAINS, LimbedCharacter, angle_deg

CONTACT_HEIGHT = 0.02
"""Leg lengths: a foot whose lowest point is lower than this is in contact with the ground (1.7 cm for a person)."""


@dataclass(frozen=True, eq=False)
class PosedLimbs:
    """A character whose pose is known as vertices, and the ends of its limbs there."""

    limbed: LimbedCharacter
    vertices: Float[np.ndarray, "V 3"]

    @cached_property
    def ends(self) -> dict[str, Float[np.ndarray, "2 3"]]:
        """Both ends of the axis of each limb, moved by the rigid motion of the limb."""
        ends = {}
        for name, sections in self.limbed.sections.items():
            rotation, translation = sections.motion(self.vertices)
            ends[name] = np.stack([sections.start, sections.end]) @ rotation.T + translation
        return ends

    def chain(self, upper: str) -> Float[np.ndarray, "2 3"] | None:
        """Select shoulder and wrist, or hip and ankle, of a whole arm or leg; None if a part cannot be measured."""
        parts = [name for name in (upper, CHAINS[upper]) if name in self.limbed.limbs]
        if upper not in parts or any(name not in self.ends for name in parts):
            return None
        return np.stack([self.ends[upper][0], self.ends[parts[-1]][1]])

    @property
    def hips(self) -> Float[np.ndarray, " 3"] | None:
        """Point between the hips; None if a thigh cannot be measured."""
        if not all(f"{side}UpLeg" in self.ends for side in SIDES):
            return None
        return np.mean([self.ends[f"{side}UpLeg"][0] for side in SIDES], axis=0)

    @cached_property
    def soles(self) -> dict[str, float]:
        """Height of each foot's lowest vertex above the lowest of the mesh, in leg lengths."""
        leg, lowest = self.limbed.leg, self.vertices[:, 1].min()
        if leg is None:
            return {}
        return {side: float(self.vertices[foot, 1].min() - lowest) / leg for side, foot in self.limbed.feet.items()}

    @cached_property
    def penetration(self) -> float:
        """Percentage of the surface, by area at rest, that is inside another limb in this pose and is not at rest."""
        return float(100 * (self.limbed.samples.inside(self.vertices) & ~self.limbed.inside_at_rest).mean())


def limb_metrics(
    identity: LimbedCharacter,
    driving: LimbedCharacter,
    result: Float[np.ndarray, "V 3"],
    driving_vertices: Float[np.ndarray, "U 3"],
) -> dict[str, float | None]:
    """Compute all figures of a result (in the identity's vertex order) against a posed driving mesh.

    `limb_deg`: mean of `limb_angles`, which follow as `limb_deg <limb>`. `end_effector`: see there, `joint_pct`: see
    `joint_error`, `sole_height` and `touching`: see `sole_errors`, `penetration`: see `added_penetration`.
    `limbs_left_out`: number of limbs of both characters with too little surface to be measured.
    """
    posed, target = PosedLimbs(identity, result), PosedLimbs(driving, driving_vertices)
    angles = limb_angles(posed, target)
    sole_height, touching = sole_errors(posed, target)
    return {
        "limb_deg": _mean(list(angles.values())),
        **{f"limb_deg {name}": angle for name, angle in angles.items()},
        "end_effector": end_effector_error(posed, target),
        "joint_pct": joint_error(posed, target),
        "sole_height": sole_height,
        "touching": touching,
        "penetration": added_penetration(posed, target),
        "limbs_left_out": float(len(identity.left_out) + len(driving.left_out)),
    }


def limb_angles(result: PosedLimbs, driving: PosedLimbs) -> dict[str, float]:
    """Compute the angle (degrees) between the world directions of each limb that both characters have.

    0 is the same direction; the rotation about the limb (twist) does not count, nor does size. An arm or leg counts as
    a whole if one of both has a single joint for it. Surfaces define rest directions of arms and legs to some degrees
    only: two shapes of the shipped body in one pose have 1.5 in the median (thighs 2.8), and clothes turn the axes of
    characters with one skeleton by 1 to 4 degrees.
    """
    lines = [common_ends(posed, result, driving) for posed in (result, driving)]
    directions = [{name: ends[1] - ends[0] for name, ends in line.items()} for line in lines]
    common = (name for name in directions[0] if name in directions[1])
    return {name: float(angle_deg(directions[0][name], directions[1][name])) for name in common}


def end_effector_error(result: PosedLimbs, driving: PosedLimbs) -> float | None:
    """Compute the mean distance of wrists relative to the shoulders, and of ankles relative to the hips.

    The mean is over the arms and legs that both characters have. Each relative position is divided by the length of the
    whole arm or leg of its own character at rest. 0 is the same relative position. Two figures with other ratios of
    upper to lower limb in exactly the same pose do not give 0: a bent elbow at 90 degrees and upper arms of 0.5 and 0.6
    of the arm give 0.14.
    """
    distances = []
    for upper in CHAINS:
        relative = []
        for posed in (result, driving):
            chain, length = posed.chain(upper), posed.limbed.chain_length(upper)
            if chain is not None and length is not None:
                relative.append((chain[1] - chain[0]) / length)
        if len(relative) == 2:
            distances.append(float(np.linalg.norm(relative[0] - relative[1])))
    return _mean(distances)


def joint_error(result: PosedLimbs, driving: PosedLimbs) -> float | None:
    """Compute the mean distance between the ends of limbs, in percent of the driving character's height at rest.

    Both figures are divided by their leg lengths at rest and centred between the hips. 0 is the same place of all ends,
    which figures of other proportions do not reach: a longer trunk alone moves shoulders, arms and head.
    """
    result_leg, driving_leg, ends = result.limbed.leg, driving.limbed.leg, []
    if result_leg is None or driving_leg is None or result.hips is None or driving.hips is None:
        return None
    for posed, leg in ((result, result_leg), (driving, driving_leg)):
        lines = common_ends(posed, result, driving)
        ends.append({name: (points - posed.hips) / leg for name, points in lines.items()})
    distances = [np.linalg.norm(ends[0][name] - ends[1][name], axis=1) for name in ends[0] if name in ends[1]]
    return float(100 * np.mean(distances) * driving_leg / np.ptp(driving.limbed.rest[:, 1]))


def sole_errors(result: PosedLimbs, driving: PosedLimbs) -> tuple[float | None, float | None]:
    """Compare how high the feet are above the ground, which is at the lowest vertex of each mesh.

    Returns the mean absolute difference of the heights of the soles in leg lengths (0: feet are equally high), and the
    share of feet that are in contact (CONTACT_HEIGHT) with both meshes or with neither (1: contacts agree, 0: none).
    """
    pairs = [(height, driving.soles[side]) for side, height in result.soles.items() if side in driving.soles]
    if not pairs:
        return None, None
    heights = np.array(pairs)
    contact = heights < CONTACT_HEIGHT
    return float(np.abs(heights[:, 0] - heights[:, 1]).mean()), float((contact[:, 0] == contact[:, 1]).mean())


def added_penetration(result: PosedLimbs, driving: PosedLimbs) -> float | None:
    """Compute how much more of the surface is inside another limb (`PosedLimbs.penetration`) than the driving mesh has.

    In percent of the surface; 0 is no more. Less than the driving mesh has is 0 too, so that it does not cancel the
    penetration of other pairs in a mean. None if one character alone has a single joint for an arm or leg: a forearm is
    tested against the trunk, an arm of one joint is next to it (`self_penetration.NEXT_TO`).
    """
    single = [
        {upper for upper, lower in CHAINS.items() if upper in posed.limbed.limbs and lower not in posed.limbed.limbs}
        for posed in (result, driving)
    ]
    return max(0.0, result.penetration - driving.penetration) if single[0] == single[1] else None


def common_ends(posed: PosedLimbs, result: PosedLimbs, driving: PosedLimbs) -> dict[str, Float[np.ndarray, "2 3"]]:
    """Select the ends of limbs to compare; an arm or leg counts as a whole if one of both has a single joint for it."""
    ends = dict(posed.ends)
    for upper, lower in CHAINS.items():
        if not all(lower in p.limbed.limbs for p in (result, driving)):
            ends.pop(lower, None)
            whole = posed.chain(upper)
            if whole is None:
                ends.pop(upper, None)
            else:
                ends[upper] = whole
    return ends


def _mean(values: list[float]) -> float | None:
    """Compute the mean, None of nothing."""
    return float(np.mean(values)) if values else None
