"""Metrics of a result without true vertices: how well it follows a driving mesh with another skeleton.

Both characters are rigged, but poses are read from vertices alone, in the same way for the result and the driving mesh.
What two skeletons have in common is compared: directions of limbs, ends of limbs, and feet on the ground. All figures
ignore translation. Each character is measured in its own lengths at rest, so files may
have any unit, but a result that is larger or smaller than its identity is an error, except for directions. A figure is
None where the limbs that it needs cannot be measured.

A limb is sampled where its surface is cut by planes across it (cross-sections). The axis of an arm or a leg at rest is
the line through the centroids of the cross-sections, so it does not depend on where a maker placed the joints inside
the limb; the joints only say between which heights the limb is cut. Trunk and head are no rods (bellies, hair, snouts),
so their axis is vertical at rest: characters stand upright in their files. The motion is the rigid one that moves the
points of the cross-sections best (weighted Kabsch). `retarget`, in contrast, aligns directions from joint to joint.

Frame of all meshes: y up, the character faces +z, its left side is +x.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES, Limb
from ..bodies.skinned_character import SkinnedCharacter
from ..core.geometry import rigid_motion, unit_vectors
from ..core.surface_points import interpolate

CHAINS = {
    f"{side}{upper}": f"{side}{lower}" for upper, lower in (("Arm", "ForeArm"), ("UpLeg", "Leg")) for side in SIDES
}
"""Upper limbs and the limb at their end; a character with one joint for both has the upper one only."""
UP = np.array([0.0, 1.0, 0.0])
UPRIGHT = ("Trunk", "Head")
"""Limbs with a vertical axis at rest."""
CUTS = np.linspace(0.1, 0.9, 9)
"""Heights of the cross-sections, as fractions of the way between the limb's joints.

Chosen on 146 train and val characters of the pool (97 of one maker, 49 of another). Of .1-.9, .2-.8, .25-.75 and
.3-.8 the first has the smallest angles between left and right for most limbs. Thighs and upper arms of the larger pack
are nearer to the line of joints with .3-.8.
"""
MIN_WEIGHT = 0.2
"""Smallest mean weight of the limb in a triangle that is cut: coarse meshes have triangles that span a limb."""
MOTION_POWER = 4
"""Power of the limb's skinning weight at a point, for its motion: cloth between two limbs follows neither. The axis
at rest takes the weight itself, because rings with a gap have their centroids off the middle. Of 1, 2 and 4 on a few
characters, for a figure in a robe; others hardly change."""
SHARE_POWER = 4
"""Power of the limb's mean skinning weight in a cross-section, for the axis at rest.

Of 0, 2, 4, 8 and 16 on characters of four train and val packs: with 4 the 90th percentile of the angle to the mean of
101 characters with one skeleton falls from 5.8 to 4.4 degrees for thighs and from 6.8 to 5.2 for upper arms. In another
pack of 49 that of thighs rises from 5.5 to 7.2, and larger powers turn the shins of figures with short legs.
"""
MAX_RADIUS = 3.0
"""Points farther from the line of joints than this multiple of the lower quartile are left out: swords, shields."""
MIN_CUTS, MIN_WIDTH = 3, 1e-3
"""A limb is left out with fewer cross-sections, or if its points are on a line: the ratio of the second largest to the
largest standard deviation is smaller than this."""
FOOT_HEIGHT = 0.1
"""Leg lengths above the lowest point of a leg at rest: vertices below, and those below the ankle, are the foot."""


@dataclass(frozen=True, eq=False)
class Sections:
    """Points of the cross-sections of a limb, with its axis at rest."""

    corners: Int[np.ndarray, "N 3"]
    """Vertex indices of the triangle that contains each point."""
    barycentric: Float[np.ndarray, "N 3"]
    """Weights of the corners, rows sum to 1."""
    weight: Float[np.ndarray, " N"]
    """Length of the cut through the triangle times a power of the limb's skinning weight there, sums to 1."""
    rest: Float[np.ndarray, "N 3"]
    """The points at rest."""
    start: Float[np.ndarray, " 3"]
    """End of the axis at the height of the limb's first joint."""
    end: Float[np.ndarray, " 3"]

    @property
    def length(self) -> float:
        """Length of the axis, in the unit of the file."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def axis(self) -> Float[np.ndarray, " 3"]:
        """Unit direction of the axis at rest."""
        return unit_vectors(self.end - self.start)

    def motion(self, vertices: Float[np.ndarray, "V 3"]) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
        """Compute the rigid motion x -> rotation x + translation from rest to given vertices (weighted Kabsch).

        The rotation about the axis (twist) is part of it. A limb without extent in `vertices` keeps its direction.
        """
        moved = interpolate(vertices, self.corners, self.barycentric)
        return rigid_motion(self.rest, moved, self.weight)


@dataclass(frozen=True, eq=False)
class LimbedCharacter:
    """A rigged character with named limbs, and what measuring needs of it at rest."""

    character: SkinnedCharacter
    limbs: dict[str, Limb]

    @property
    def rest(self) -> Float[np.ndarray, "V 3"]:
        """Vertices at rest."""
        return self.character.mesh.vertices

    @cached_property
    def weights(self) -> Float[np.ndarray, "V L"]:
        """Skinning weight of each limb of `limbs` at each vertex, rows sum to at most 1.

        The limb of a joint is that of the nearest limb joint at or above it. Joints above all limbs, such as a root
        that carries hips and legs, belong to the trunk.
        """
        names, rig = list(self.limbs), self.character
        limb_of_joint = {limb.joint: names.index(name) for name, limb in reversed(self.limbs.items())}
        columns = rig.nearest_columns(limb_of_joint, names.index("Trunk") if "Trunk" in names else len(names))
        columns[-1] = len(names)  # the world belongs to no limb
        return rig.summed_weights(columns, len(names) + 1)[:, :-1]

    @cached_property
    def cuts(self) -> dict[str, Sections]:
        """Cross-sections of each limb that can be measured, with the axis of its surface."""
        limbs = enumerate(self.limbs.items())
        mesh = self.character.mesh
        cuts = {name: cut_limb(mesh.vertices, mesh.faces, self.weights[:, k], limb) for k, (name, limb) in limbs}
        return {name: sections for name, sections in cuts.items() if sections is not None}

    @cached_property
    def sections(self) -> dict[str, Sections]:
        """Cross-sections of each limb that can be measured, with the axis to be compared (see UPRIGHT)."""
        return {name: upright(sections) if name in UPRIGHT else sections for name, sections in self.cuts.items()}

    def chain_length(self, upper: str) -> float | None:
        """Measure a whole arm or leg at rest along its axes (unit of the file); None if a part is left out."""
        parts = [name for name in (upper, CHAINS[upper]) if name in self.limbs]
        if not parts or any(name not in self.sections for name in parts):
            return None
        return sum(self.sections[name].length for name in parts)

    @cached_property
    def leg(self) -> float | None:
        """Mean length of the legs at rest, in the unit of the file; None if neither can be measured."""
        lengths = [length for side in SIDES if (length := self.chain_length(f"{side}UpLeg")) is not None]
        return float(np.mean(lengths)) if lengths else None

    @cached_property
    def feet(self) -> dict[str, Int[np.ndarray, " N"]]:
        """Vertices of each foot: of the lowest limb of its leg those that are lowest at rest (FOOT_HEIGHT)."""
        feet, names, leg = {}, list(self.limbs), self.leg
        for side in SIDES:
            name = next((name for name in (f"{side}Leg", f"{side}UpLeg") if name in names), None)
            if name is None or leg is None:
                continue
            own = np.flatnonzero(self.weights[:, names.index(name)] > 0.5)
            if len(own):
                height = self.rest[own, 1]
                top = max(self.limbs[name].end[1], height.min() + FOOT_HEIGHT * leg)
                feet[side] = own[height <= top]
        return feet


def cut_limb(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], weights: Float[np.ndarray, " V"], limb: Limb
) -> Sections | None:
    """Cut a limb at rest by planes across the line of its joints (CUTS); None if it has too little surface.

    Args:
        weights: skinning weight of the limb at each vertex.
    """
    line = limb.end - limb.start
    if not line.any():
        return None
    height = (vertices - limb.start) @ line / (line @ line)
    faces = faces[weights[faces].mean(axis=1) > MIN_WEIGHT]
    # A plane that crosses a triangle separates one corner from the other two.
    above = height[faces][:, None] > CUTS[:, None]  # (F, cuts, 3)
    count = above.sum(axis=2)
    face, cut = np.nonzero((count == 1) | (count == 2))
    single = np.argmax(above[face, cut] == (count[face, cut] == 1)[:, None], axis=1)
    corners = np.stack([faces[face, (single + k) % 3] for k in range(3)], axis=1)
    # The cut runs between points of the two edges at the separated corner; `fraction` is each one's way along its edge.
    own, other = height[corners[:, :1]], height[corners[:, 1:]]
    fraction = (CUTS[cut][:, None] - own) / (other - own)
    edge = vertices[corners[:, 1:]] - vertices[corners[:, :1]]
    lengths = np.linalg.norm(fraction[:, :1] * edge[:, 0] - fraction[:, 1:] * edge[:, 1], axis=1)
    barycentric = np.concatenate([1 - fraction.mean(axis=1, keepdims=True), fraction / 2], axis=1)
    points = interpolate(vertices, corners, barycentric)
    share = (weights[corners] * barycentric).sum(axis=1)
    if not (lengths * share).any():
        return None
    offset, axis = points - limb.start, unit_vectors(line)
    distance = np.linalg.norm(offset - (offset @ axis)[:, None] * axis, axis=1)
    order, weight = np.argsort(distance), np.cumsum((lengths * share)[np.argsort(distance)])
    lower_quartile = distance[order][np.searchsorted(weight, weight[-1] / 4)]
    near = distance <= MAX_RADIUS * lower_quartile
    corners, barycentric, points, cut = corners[near], barycentric[near], points[near], cut[near]
    lengths, share = lengths[near], share[near]
    weight = lengths * share**MOTION_POWER
    weight = weight / max(weight.sum(), np.finfo(float).tiny)
    if not _measurable(points, weight, cut):
        return None
    start, end = _axis(points, lengths, share, cut)
    return Sections(corners, barycentric, weight, points, start, end)


def upright(sections: Sections) -> Sections:
    """Make the axis vertical, through its middle; its length is the difference of the ends' heights."""
    middle, half = (sections.start + sections.end) / 2, np.array([0.0, (sections.end - sections.start)[1] / 2, 0.0])
    return dataclasses.replace(sections, start=middle - half, end=middle + half)


def _axis(points, lengths, share, cut):
    """Fit a line to the centroids of cross-sections by least squares; its ends at the heights of the joints.

    Cross-sections that are shared with another limb are rings with a gap, whose centroid is off the middle; they count
    less (SHARE_POWER).
    """
    weight = lengths * share
    total, length = np.bincount(cut, weight, len(CUTS)), np.bincount(cut, lengths, len(CUTS))
    filled = total > 0
    centroids = np.stack([np.bincount(cut, weight * points[:, k], len(CUTS)) for k in range(3)], axis=1)
    centroids, height = centroids[filled] / total[filled, None], CUTS[filled]
    reliability = (total[filled] / length[filled]) ** SHARE_POWER
    reliability /= reliability.sum()
    middle, mean_height = reliability @ centroids, reliability @ height
    offset = reliability * (height - mean_height)
    slope = offset @ centroids / (offset @ height)
    return middle - slope * mean_height, middle + slope * (1 - mean_height)


def _measurable(points, weight, cut):
    centred = points - weight @ points
    deviation = np.linalg.svd(np.sqrt(weight)[:, None] * centred, compute_uv=False)
    return (
        len(np.unique(cut[weight > 0])) >= MIN_CUTS and len(deviation) > 1 and deviation[1] > MIN_WIDTH * deviation[0]
    )


def angle_deg(
    first: Float[np.ndarray, "*N 3"], second: Float[np.ndarray, "*N 3"]
) -> Float[np.ndarray, "*N"] | np.float64:
    """Compute the angle between vectors in degrees; exact for small angles too, unlike the arc cosine."""
    first, second = unit_vectors(first), unit_vectors(second)
    difference, total = (np.linalg.norm(v, axis=-1) for v in (first - second, first + second))
    return np.degrees(2 * np.arctan2(difference, total))


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

    @cached_property
    def soles(self) -> dict[str, float]:
        """Height of each foot's lowest vertex above the lowest of the mesh, in leg lengths."""
        leg, lowest = self.limbed.leg, self.vertices[:, 1].min()
        if leg is None:
            return {}
        return {side: float(self.vertices[foot, 1].min() - lowest) / leg for side, foot in self.limbed.feet.items()}


def limb_metrics(
    identity: LimbedCharacter,
    driving: LimbedCharacter,
    result: Float[np.ndarray, "V 3"],
    driving_vertices: Float[np.ndarray, "U 3"],
) -> dict[str, float | None]:
    """Compute all figures of a result (in the identity's vertex order) against a posed driving mesh.

    `limb_deg`: mean of `limb_angles`, which follow as `limb_deg <limb>`. `end_effector`: see `end_effector_error`,
    `sole_height` and `touching`: see `sole_errors`. Limbs with too little surface to be measured are left out.
    """
    posed, target = PosedLimbs(identity, result), PosedLimbs(driving, driving_vertices)
    angles = limb_angles(posed, target)
    sole_height, touching = sole_errors(posed, target)
    return {
        "limb_deg": _mean(list(angles.values())),
        **{f"limb_deg {name}": angle for name, angle in angles.items()},
        "end_effector": end_effector_error(posed, target),
        "sole_height": sole_height,
        "touching": touching,
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
    return float(np.mean(values)) if values else None
