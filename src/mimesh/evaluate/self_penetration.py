"""Self-penetration of a posed character: the share of its surface that lies inside another limb.

Game meshes are open and made of several parts, so there is no inside in the strict sense. A sample of the surface
counts as inside a limb if the nearest sample of that limb faces away from it (along its normal, not sideways) and is
between two depths. Limbs next to each other are not compared, and what is inside at rest never counts: coats over legs,
necks in collars.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies.character_limbs import SIDES
from ..core.geometry import face_areas, face_vectors, unit_vectors
from ..core.surface_points import at_barycentric

SAMPLES = 4000
"""Samples of a surface: about 2 cm apart on a person of 1.7 m; one sample is 0.025 % of the surface."""
MIN_DEPTH = 0.01
"""Leg lengths: smallest depth under the surface that counts, more than the error of planes through samples."""
MAX_DEPTH = 1.5
"""Largest distance from the surface that counts, in mean radii of the limb: larger ones are gaps of open meshes."""
MAX_SLOPE = 0.5
"""Largest sideways distance from the nearest sample, in depths under it (27 degrees), beyond the distance of samples:
next to the rim of an opening the nearest sample is beside a point, not above it."""
PLASTIC = (0.7548776662466927, 0.5698402909980532)
"""Steps of the R2 sequence (Roberts 2018), which fills a square evenly: 1/p and 1/p², p the plastic number."""
NEXT_TO = {frozenset(("Trunk", "Head"))} | {
    frozenset(pair)
    for side in SIDES
    for pair in (
        ("Trunk", f"{side}Arm"),
        ("Trunk", f"{side}UpLeg"),
        (f"{side}Arm", f"{side}ForeArm"),
        (f"{side}UpLeg", f"{side}Leg"),
    )
}
"""Pairs of limbs that touch in every pose. An arm or leg of one joint is next to the trunk as a whole."""


@dataclass(frozen=True, eq=False)
class LimbSamples:
    """Samples of a character's surface, uniform by area at rest, and the limb of each."""

    faces: Int[np.ndarray, "N 3"]
    """Vertex indices of the triangle that contains each sample."""
    barycentric: Float[np.ndarray, "N 3"]
    """Weights of the corners, rows sum to 1."""
    limb: Int[np.ndarray, " N"]
    """Index of each sample's limb in `names`, one more than the last without a limb."""
    names: tuple[str, ...]
    max_depth: tuple[float, ...]
    """Largest distance from the surface of each limb that counts, in the unit of the file; 0 leaves the limb out."""
    min_depth: float
    """Smallest depth that counts, in the unit of the file."""
    spacing: float
    """Typical distance of samples from each other, in the unit of the file."""

    def inside(self, vertices: Float[np.ndarray, "V 3"]) -> Bool[np.ndarray, " N"]:
        """Tell which samples are inside a limb that theirs is not next to."""
        from scipy.spatial import KDTree

        points = at_barycentric(vertices, self.faces, np.arange(len(self.faces)), self.barycentric)
        normals = unit_vectors(face_vectors(vertices, self.faces))
        inside = np.zeros(len(points), bool)
        for k, name in enumerate(self.names):
            own = np.flatnonzero(self.limb == k)
            if not len(own):
                continue
            apart = [i for i, other in enumerate(self.names) if i != k and frozenset((name, other)) not in NEXT_TO]
            # Only samples in the bounding box of the limb can be inside it.
            low, high = points[own].min(axis=0), points[own].max(axis=0)
            within = ((points > low) & (points < high)).all(axis=1)
            others = np.flatnonzero(within & np.isin(self.limb, apart))
            distance, nearest = KDTree(points[own]).query(points[others])
            depth = ((points[own[nearest]] - points[others]) * normals[own[nearest]]).sum(axis=1)
            sideways = np.sqrt(np.maximum(distance**2 - depth**2, 0.0))
            below = (depth > self.min_depth) & (sideways < MAX_SLOPE * depth + self.spacing)
            inside[others[below & (distance < self.max_depth[k])]] = True
        return inside


def sample_limbs(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    weights: Float[np.ndarray, "V L"],
    radii: dict[str, float],
    leg: float,
) -> LimbSamples:
    """Place SAMPLES samples on a character at rest, in the order of its faces; there is nothing random about it.

    Args:
        weights: skinning weight of each limb at each vertex, in the order of `radii`.
        radii: mean radius of each limb; 0 for one that cannot be measured.
        leg: length of a leg, for MIN_DEPTH.
    """
    total = np.cumsum(face_areas(vertices, faces))
    chosen = np.searchsorted(total, (np.arange(SAMPLES) + 0.5) / SAMPLES * total[-1]).clip(max=len(total) - 1)
    u, v = np.modf(np.arange(SAMPLES)[:, None] * PLASTIC)[0].T
    flip = u + v > 1  # outside the triangle: reflect to the other half of the parallelogram
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    barycentric = np.stack([1 - u - v, u, v], axis=1)
    # A last column for samples that no limb carries.
    weight = np.pad(at_barycentric(weights, faces, chosen, barycentric), ((0, 0), (0, 1)), constant_values=1e-6)
    limb = weight.argmax(axis=1)
    spacing = float(np.sqrt(total[-1] / SAMPLES))
    max_depth = tuple(MAX_DEPTH * radius for radius in radii.values())
    return LimbSamples(faces[chosen], barycentric, limb, tuple(radii), max_depth, MIN_DEPTH * leg, spacing)
