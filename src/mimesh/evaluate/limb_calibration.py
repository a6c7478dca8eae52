"""Limbs of a rigged character: their axes at rest from the surface, and their rigid motions from moved vertices.

A limb is sampled where its surface is cut by planes across it (cross-sections). The axis of an arm or a leg at rest is
the line through the centroids of the cross-sections, so it does not depend on where a maker placed the joints inside
the limb; the joints only say between which heights the limb is cut. Trunk and head are no rods (bellies, hair, snouts),
so their axis is vertical at rest: characters stand upright in their files. The motion is the rigid one that moves the
points of the cross-sections best (weighted Kabsch). `retarget`, in contrast, aligns directions from joint to joint.

Frame: y up, the character faces +z, its left side is +x, as in `bodies.skinned_character`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies.character_limbs import SIDES, Limb
from ..bodies.skinned_character import SkinnedCharacter
from ..core.geometry import rigid_motion, unit_vectors
from ..core.surface_points import interpolate
from .self_penetration import LimbSamples, sample_limbs

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

    @property
    def radius(self) -> float:
        """Mean distance of the points from the axis: half the limb's thickness."""
        return float(self.weight @ _radial(self.rest, self.start, self.end))

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
        names, parents = list(self.limbs), self.character.parents
        limb_of_joint = {limb.joint: names.index(name) for name, limb in reversed(self.limbs.items())}
        column = np.full(len(parents) + 1, len(names))  # the last joint is the world
        for j, parent in enumerate(parents):
            above = column[parent] if parent >= 0 else names.index("Trunk") if "Trunk" in names else len(names)
            column[j] = limb_of_joint.get(j, above)
        weights = np.zeros((len(self.rest), len(names) + 1))
        np.add.at(weights, (np.arange(len(weights))[:, None], column[self.character.joint_of]), self.character.weights)
        return weights[:, :-1]

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

    @cached_property
    def samples(self) -> LimbSamples:
        """Samples of the surface, for self-penetration."""
        radii = {name: self.cuts[name].radius if name in self.cuts else 0.0 for name in self.limbs}
        mesh = self.character.mesh
        return sample_limbs(mesh.vertices, mesh.faces, self.weights, radii, self.leg or 0.0)

    @cached_property
    def inside_at_rest(self) -> Bool[np.ndarray, " N"]:
        """Tell which samples are inside another limb at rest."""
        return self.samples.inside(self.rest)

    @property
    def left_out(self) -> list[str]:
        """Names of limbs that have too little surface to be measured."""
        return [name for name in self.limbs if name not in self.sections]

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
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    weights: Float[np.ndarray, " V"],
    limb: Limb,
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
    distance = _radial(points, limb.start, limb.end)
    near = distance <= MAX_RADIUS * _lower_quartile(distance, lengths * share)
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
    """Tell whether points of cross-sections define a rigid motion (MIN_CUTS, MIN_WIDTH)."""
    centred = points - weight @ points
    deviation = np.linalg.svd(np.sqrt(weight)[:, None] * centred, compute_uv=False)
    return (
        len(np.unique(cut[weight > 0])) >= MIN_CUTS and len(deviation) > 1 and deviation[1] > MIN_WIDTH * deviation[0]
    )


def _radial(points, start, end):
    """Compute the distance of points from a line through two points."""
    offset, axis = points - start, unit_vectors(end - start)
    return np.linalg.norm(offset - (offset @ axis)[:, None] * axis, axis=1)


def _lower_quartile(values, weight):
    """Compute the weighted lower quartile of values."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return values[order][np.searchsorted(total, total[-1] / 4)]


def calibration_report(character: SkinnedCharacter, limbs: dict[str, Limb]) -> dict[str, float]:
    """Report how plausible the axes of limbs at rest are, all in degrees; limbs that cannot be measured are left out.

    Keys: `joint <limb>` is the angle between the surface axis and the line of joints; `mirror <limb>` the angle between
    the left axis and the mirrored right one (`LeftArm` without its side); `down <leg>` and `up <Trunk, Head>` the angle
    to the vertical; `below <arm>` the angle below the horizontal (0 in a T-pose, about 45 in an A-pose, 90 hanging
    down); `front <arm>` that to the front of the frontal plane. A maker's T- or A-pose must show in the last rows.
    """
    measured = LimbedCharacter(character, limbs).cuts
    axes = {name: sections.axis for name, sections in measured.items()}
    report = {
        f"joint {name}": float(angle_deg(axis, limbs[name].end - limbs[name].start)) for name, axis in axes.items()
    }
    for name, axis in axes.items():
        right = axes.get(name.replace("Left", "Right"))
        if name.startswith("Left") and right is not None:
            report[f"mirror {name.removeprefix('Left')}"] = float(angle_deg(axis, right * [-1, 1, 1]))
        if name.endswith("Leg"):
            report[f"down {name}"] = float(angle_deg(axis, -UP))
        elif name.endswith("Arm"):
            report[f"below {name}"], report[f"front {name}"] = np.degrees(np.arcsin([-axis[1], axis[2]])).tolist()
        else:
            report[f"up {name}"] = float(angle_deg(axis, UP))
    return report


def angle_deg(
    first: Float[np.ndarray, "*N 3"], second: Float[np.ndarray, "*N 3"]
) -> Float[np.ndarray, "*N"] | np.float64:
    """Compute the angle between vectors in degrees; exact for small angles too, unlike the arc cosine."""
    first, second = unit_vectors(first), unit_vectors(second)
    difference, total = (np.linalg.norm(v, axis=-1) for v in (first - second, first + second))
    return np.degrees(2 * np.arctan2(difference, total))
