"""Normalization of a mesh: y up, +z front, bounding box centred at the origin, largest distance from it 1; invertible.

The rotation is one of the 24 axis rotations. So a mesh that was translated, scaled or turned by one of them has the
same normalised points; any other heading stays in the mesh, unless `without_heading` takes it out: then the points are
the same for every angle at which the mesh stands in its file. The horizontal principal axes of a surface turn with it,
so the front is sought at eight angles from them, 45 degrees apart, by the detector of the orientation. They are axes of
the surface, not of its vertices: other triangles of the same surface have the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from .errors import InputError, option
from .geometry import face_areas, face_centroids, turned
from .mesh import Mesh, drawn_points

AXES = ("+x", "+y", "+z", "-x", "-y", "-z")
"""Names of the axes of a file."""
UNSURE = 0.9
"""Margin (difference of probabilities) below which a detected facing gets a note.

Chosen on people of the shipped body and on characters of the split `val`, see docs/log/mime.md.
"""
FLAT = 0.01
"""Depth of a flat side, over the longest side of the bounding box."""
BASE_AREA, BASE_LEAD = 0.085, 0.25
"""Smallest share of the surface that lies in the side of a base, and largest share of the opposite side over it. Of 316
people, animals and figures of boxes of 12 makers the largest share is 0.081, the back of a sheep of cubes; bases half
as wide as a person is tall have 0.09 to 0.36."""
CONTRARY = 0.95
"""Margin from which a detected up that is not the file's gets a note."""
GRID = 11
"""Cells along each side of the occupancy grid, the input of the network that detects up and front."""
OCCUPANCY_BLOCK = 2**16
"""Points that are added to the grid at a time; their arrays stay in the processor's cache."""
REACH = 2.2
"""Half of the grid's side, in root-mean-square distances from the centroid; points outside are moved to its border."""


@dataclass(frozen=True, eq=False)
class Normalization:
    """A similarity transform: normalised = (rotation @ file - centre) / radius."""

    rotation: Float[np.ndarray, "3 3"]
    """File axes to y up and +z front: one of the 24 axis rotations, followed by a turn by -`heading` about y."""
    centre: Float[np.ndarray, " 3"]
    """Middle of the bounding box, after the rotation."""
    radius: float
    """Largest distance from the centre, in the file's unit."""
    up: str
    front: str
    detected: bool
    """Whether up or front (or both) were detected from the shape."""
    margin: float
    """Probability of the chosen facing minus that of the runner-up; 1 where both axes were known."""
    up_from: Literal["given", "file", "shape"] = "shape"
    """Whether up was given, is that of the file (`Mesh.up`), or was detected from the shape."""
    shape_up: str | None = None
    """Up as the shape has it, where that clearly contradicts the file; None elsewhere."""
    heading: float = 0.0
    """Angle of the mesh's front from `front` (radians about `up`, counterclockwise seen from above), taken out."""

    @classmethod
    def fit(cls, mesh: Mesh, up: str | None = None, front: str | None = None) -> Normalization:
        """Compute the normalization of a mesh from its axes ("+y", "-z", "x"); unknown ones are detected.

        Without `up` it is that of the file, if the file defines one and `front` is on another axis: a given axis wins.
        The detector was trained on people. For other shapes it returns some axes, consistently for all axis rotations
        of a file, and usually a small margin. Shapes with a rotational symmetry have no facing.

        Raises:
            InputError: an axis is not one of +x +y +z -x -y -z, or up and front lie on one axis.
        """
        up, front, of_file = (
            parse_axis(up, option("up")),
            parse_axis(front, option("front")),
            parse_axis(mesh.up, "Mesh.up"),
        )
        up_from = "shape" if up is None else "given"
        if up is None and of_file is not None and (front is None or front[1] != of_file[1]):
            up, up_from = of_file, "file"
        if up and front and up[1] == front[1]:
            raise InputError(
                f"{option('up', up)} {option('front', front)}: expected two different axes, found one; change one of "
                "them"
            )
        stands_on = flat_side(mesh)[0] if up is None else None
        standing = None if stands_on is None else opposite(stands_on)
        candidates = [
            r
            for r, axes in enumerate(ORIENTATIONS)
            if (up or standing) in (None, axes[0]) and (front in (None, axes[1]))
        ]
        if not candidates:  # the base is a wall in front of or behind the figure
            candidates = [r for r, axes in enumerate(ORIENTATIONS) if front == axes[1]]
        detected, shape_up = up is None or len(candidates) > 1, None
        chosen, margin = candidates[0], 1.0
        if detected or up_from == "file":
            scores = orientation_scores(mesh_occupancy(mesh), detector())
            likeliest, lead = _best_orientation(scores, list(range(len(ORIENTATIONS))))
            if up_from == "file" and lead >= CONTRARY and ORIENTATIONS[likeliest][0] != up:
                shape_up = ORIENTATIONS[likeliest][0]
            if detected:
                chosen, margin = _best_orientation(scores, candidates)
        up, front = ORIENTATIONS[chosen]
        rotated = rotate_axes(np.asarray(drawn_points(mesh, mesh.vertices), np.float64), ROTATIONS[chosen])
        centre = bbox_centre(rotated)
        size = radius(rotated - centre)
        return cls(ROTATIONS[chosen], centre, size, up, front, detected, margin, up_from, shape_up)

    def apply(self, vertices: Float[np.ndarray, "*T V 3"]) -> Float[np.ndarray, "*T V 3"]:
        """Transform file coordinates to normalised ones (float64)."""
        upright = rotate_axes(vertices.astype(np.float64), self.axes)
        return ((turned(upright, -self.heading) if self.heading else upright) - self.centre) / self.radius

    def undo(self, vertices: Float[np.ndarray, "*T V 3"]) -> Float[np.ndarray, "*T V 3"]:
        """Transform normalised coordinates to file coordinates (float64): the inverse of `apply` up to rounding."""
        upright = vertices.astype(np.float64) * self.radius + self.centre
        return rotate_axes(turned(upright, self.heading) if self.heading else upright, self.axes.T)

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """The axis rotation alone, without the heading."""
        return (turned(self.rotation.T, self.heading).T if self.heading else self.rotation).round()

    @property
    def unsure(self) -> bool:
        """Whether the facing was detected with so small a margin that the user should check it."""
        return self.detected and self.margin < UNSURE


def axis_name(direction: Float[np.ndarray, " 3"]) -> str:
    """Return the name of the coordinate axis nearest to a direction, such as "-z"."""
    k = int(np.abs(direction).argmax())
    return AXES[k if direction[k] > 0 else k + 3]


def parse_axis(axis: str | None, option: str) -> str | None:
    """Parse an axis name: "y", "Y" and "+y" give "+y", None gives None. Errors name `option`.

    Raises:
        InputError: not an axis.
    """
    if axis is None:
        return None
    name = axis.strip().lower()
    name = name if name.startswith(("+", "-")) else f"+{name}"
    if name not in AXES:
        raise InputError(f"{option}: expected one of {' '.join(AXES)}, found {axis!r}; give an axis of the file")
    return name


def bbox_centre(vertices: Float[np.ndarray, "*T V 3"]) -> Float[np.ndarray, "*T 3"]:
    """Compute the centre of the axis-aligned bounding box; exactly the same for any order of the vertices."""
    return (vertices.min(axis=-2) + vertices.max(axis=-2)) / 2


def radius(centred: Float[np.ndarray, "V 3"]) -> float:
    """Compute the largest distance from the origin; exactly the same for any order of the vertices."""
    x, y, z = centred[:, 0], centred[:, 1], centred[:, 2]
    return float(np.sqrt((x * x + y * y + z * z).max()))


def occupancy(points: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, " N"]) -> Float[np.ndarray, " C"]:
    """Compute the features of the detector: the square root of the fraction of the surface in each of GRID^3 cells.

    Weights are distributed trilinearly over the grid, which is centred at the centroid and scaled by the
    root-mean-square distance. All 24 rotations map the grid onto itself, so the features of a rotated mesh are the
    rotated features (`TURNED_CELLS`).
    """
    weights = weights / weights.sum()
    # Centroid and root-mean-square distance do not depend on the orientation.
    centred = points - weights @ points
    scale = np.sqrt(weights @ (centred * centred).sum(axis=1))
    total = np.zeros(GRID**3)
    for start in range(0, len(points), OCCUPANCY_BLOCK):
        block = slice(start, start + OCCUPANCY_BLOCK)
        cell = (np.clip(centred[block].T / (REACH * scale), -1, 1) + 1) / 2 * (GRID - 1)
        low = np.minimum(cell.astype(np.int64), GRID - 2)
        steps = np.array([GRID * GRID, GRID, 1])
        first, shares = steps @ low, np.stack([1 - (cell - low), cell - low])  # shares: low or high, axis, point
        # Each point contributes to the 8 cells around it.
        for corner in np.ndindex(2, 2, 2):
            x, y, z = (shares[high, axis] for axis, high in enumerate(corner))
            total += np.bincount(first + steps @ corner, x * y * z * weights[block], minlength=GRID**3)
    return np.sqrt(total)


def mesh_occupancy(mesh: Mesh) -> Float[np.ndarray, " C"]:
    """Compute the detector's features of a mesh, even by area, or of the points of a cloud."""
    points, weights = mesh.vertices, np.ones(len(mesh.vertices))
    if len(mesh.faces) > 1:  # the centroid of a single face has no extent
        points, weights = face_centroids(mesh.vertices, mesh.faces), face_areas(mesh.vertices, mesh.faces)
    return occupancy(points.astype(np.float64), weights.astype(np.float64))


def orientation_scores(features: Float[np.ndarray, "*B C"], model: dict[str, np.ndarray]) -> Float[np.ndarray, "*B 24"]:
    """Score each of the 24 rotations: one two-layer network, applied to the features rotated by each of them."""
    rotated = features[..., TURNED_CELLS]
    hidden = np.maximum(rotated @ model["hidden"] + model["bias"], 0.0)
    return hidden @ model["out"]


def opposite(axis: str) -> str:
    """Return the name of the opposite of an axis such as "-z"."""
    return {"+": "-", "-": "+"}[axis[0]] + axis[1]


def flat_side(mesh: Mesh) -> tuple[str | None, Int[np.ndarray, " B"]]:
    """Find the side of a mesh that is a flat base: a pedestal, a floor; None where there is none.

    The detector of orientations takes what is wide for shoulders and would turn a figure on a base upside down.

    Returns:
        The axis to that side, and the faces of the base that lie in it.
    """
    none = None, np.zeros(0, np.int64)
    if not len(mesh.faces):
        return none
    drawn = drawn_points(mesh, mesh.vertices)
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    depth = FLAT * float((high - low).max())
    lying = {
        axis: np.flatnonzero((np.abs(mesh.vertices[:, k] - end) <= depth)[mesh.faces].all(axis=1))
        for ends, sign in ((low, "-"), (high, "+"))
        for k, end in enumerate(ends)
        for axis in (sign + "xyz"[k],)
    }
    total = face_areas(mesh.vertices, mesh.faces).sum()
    area = {axis: float(face_areas(mesh.vertices, mesh.faces[faces]).sum() / total) for axis, faces in lying.items()}
    base = max(area, key=lambda axis: area[axis] - area[opposite(axis)])
    if area[base] < BASE_AREA or area[opposite(base)] > BASE_LEAD * area[base]:
        return none
    return base, lying[base]


def clear_up(mesh: Mesh) -> str | None:
    """Detect the axis away from the ground from the shape alone, whatever the front is; None where it is not clear.

    Clear is a base on the opposite side, or a probability of CONTRARY or more.
    """
    base = flat_side(mesh)[0]
    if base is not None:
        return opposite(base)
    totals = _up_probabilities(mesh)
    likeliest = max(AXES, key=lambda up: totals[up])
    return likeliest if totals[likeliest] >= CONTRARY else None


def _up_probabilities(mesh: Mesh) -> dict[str, float]:
    """Return the probability of each axis away from the ground, whatever the front is."""
    scores = orientation_scores(mesh_occupancy(mesh), detector())
    probability = np.exp(scores - scores.max())
    ups = [up for up, _ in ORIENTATIONS]
    return {up: float(probability[[up == other for other in ups]].sum() / probability.sum()) for up in AXES}


def _best_orientation(scores: Float[np.ndarray, " 24"], candidates: list[int]) -> tuple[int, float]:
    """Select the candidate (index of ROTATIONS) of highest score, and compute its margin."""
    # Rounded, so that the rounding of a sum cannot decide between the equal facings of a symmetric shape.
    scores = np.round(scores[candidates], 6)
    probability = np.exp(scores - scores.max())
    first, second = np.sort(probability / probability.sum())[::-1][:2]
    return candidates[int(scores.argmax())], float(first - second)


@cache
def detector() -> dict[str, np.ndarray]:
    """Load the weights of the shipped detector."""
    with np.load(str(resources.files("mimesh.core") / "frame_orientation.npz")) as data:
        return {name: data[name].astype(np.float64) for name in data.files}


def rotate_axes(
    vertices: Float[np.ndarray, "*T V 3"], rotation: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "*T V 3"]:
    """Apply an axis rotation by permuting coordinates and signs, which is exact."""
    source, signs = np.abs(rotation).argmax(axis=1), rotation.sum(axis=1)
    rotated = np.empty(vertices.shape, np.result_type(vertices, signs))
    for k in range(3):  # three times as fast as rows of three
        rotated[..., k] = vertices[..., source[k]] * signs[k] + 0.0  # no negative zeros: `weld` would separate them
    return rotated


def _axis_rotations() -> tuple[tuple[tuple[str, str], ...], Float[np.ndarray, "24 3 3"]]:
    """List the 24 (up, front) pairs, and the rotation of each to (+y, +z)."""
    vector: dict[str, np.ndarray] = dict(zip(AXES, np.concatenate([np.eye(3), -np.eye(3)]), strict=True))
    pairs = tuple((up, front) for up in AXES for front in AXES if up[1] != front[1])
    rows = [(np.cross(vector[up], vector[front]), vector[up], vector[front]) for up, front in pairs]
    return pairs, np.array(rows) + 0.0  # + 0.0: no negative zeros


def _turned_cells() -> Int[np.ndarray, "24 C"]:
    """Compute, for each rotation, the cell of the grid that each cell of the rotated grid is taken from."""
    cells = np.stack(np.meshgrid(*[np.arange(GRID)] * 3, indexing="ij"), -1).reshape(-1, 3) - (GRID - 1) / 2
    origin = np.stack([rotate_axes(cells, rotation.T) for rotation in ROTATIONS]) + (GRID - 1) / 2
    return origin.round().astype(np.int64) @ (GRID * GRID, GRID, 1)


ORIENTATIONS, ROTATIONS = _axis_rotations()
"""The 24 (up, front) pairs and the rotation of each to (+y, +z)."""
TURNED_CELLS = _turned_cells()
"""Rotated features are `features[TURNED_CELLS[r]]` for rotation r."""


ROUND = 1e-5
"""Relative difference of the two horizontal moments below which a mesh has no principal axes and keeps its heading."""
DIGITS = 12
"""Decimals of the principal angle (radians) that are kept: the last bits depend on the order of the vertices."""
WITHIN = np.radians(60)
"""Largest angle between a given front and the heading that is taken out."""
LEVEL = 0.5
"""Smallest horizontal part of a front that has a heading."""
FRONT_DIGITS = 1
"""Decimals of the angle of a predicted front (radians) that are kept."""
QUARTERS = ("+z", "+x", "-z", "-x")
"""Axes at 0, 1, 2 and 3 right angles from z towards x."""


def turn(angle: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation about y by an angle (radians) from z towards x."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def without_heading(mesh: Mesh, norm: Normalization, front_known: bool, person: bool = True) -> Normalization:
    """Return a normalization that takes the heading out as well.

    Args:
        mesh: the mesh that `norm` was fitted to.
        norm: its normalization by an axis rotation.
        front_known: whether its front was given: a person's is then sought within WITHIN of it. Else it is detected
            again from the turned mesh, and the axis of the file that is nearest to it becomes the front.
        person: whether the mesh is a person, which the detector knows. The body of an animal lies along its front: of
            the principal axes the one that is nearest to the front is taken.
    """
    upright = _at(mesh, rotate_axes(np.asarray(mesh.vertices, np.float64), norm.rotation))
    principal = principal_heading(upright)
    if principal is None:
        return norm
    headings = principal + np.arange(8) * np.pi / 4
    headings = (headings + np.pi) % (2 * np.pi) - np.pi
    if not person:
        return _turned(upright, norm, norm.rotation, min(headings[::2], key=abs))
    scores = np.empty(8)
    fronts = [ORIENTATIONS.index(("+y", axis)) for axis in QUARTERS]
    for k in range(2):
        aligned = _at(upright, turned(upright.vertices, -principal - k * np.pi / 4))
        scores[k::2] = orientation_scores(mesh_occupancy(aligned), detector())[fronts]
    # Rounded, so that the rounding of a sum cannot decide between the equal fronts of a symmetric shape.
    scores = np.round(scores, 6)
    if front_known:
        best = int(np.where(np.abs(headings) <= WITHIN, scores, -np.inf).argmax())
        return _turned(upright, norm, norm.rotation, headings[best])
    best = int(scores.argmax())
    # Margin over the fronts at right angles to the best one, as for a mesh that stands along the axes.
    probability = np.exp(scores[best % 2 :: 2] - scores[best])
    margin = float((1 - np.sort(probability)[-2]) / probability.sum())
    if norm.up_from == "shape":
        totals = _up_probabilities(mesh)
        margin = min(margin, totals[norm.up] - max(total for axis, total in totals.items() if axis != norm.up))
    return _at_nearest_front(mesh, replace(norm, margin=margin), headings[best])


def turned_to_front(
    mesh: Mesh, norm: Normalization, front: Float[np.ndarray, " 3"], front_known: bool
) -> Normalization:
    """Return a normalization in which a predicted front faces +z.

    Args:
        mesh: the mesh that `norm` was fitted to.
        norm: its normalization without the heading.
        front: the front that a model has predicted from the normalised mesh, a unit vector. One that points up or down
            has no heading, and changes nothing.
        front_known: whether the front of `norm` was given: a prediction that contradicts it is turned around. Else it
            may be another axis then, which results face.
    """
    if np.hypot(front[0], front[2]) < LEVEL:
        return norm
    # Rounded: inputs that differ in their last bits give predictions that differ by some thousandths.
    heading = norm.heading + np.round(np.arctan2(front[0], front[2]), FRONT_DIGITS)
    heading = (heading + np.pi) % (2 * np.pi) - np.pi
    if front_known and abs(heading) > np.pi / 2:
        heading -= np.sign(heading) * np.pi
    if not front_known and abs(heading) > WITHIN:
        return _at_nearest_front(mesh, norm, heading)
    upright = _at(mesh, rotate_axes(np.asarray(mesh.vertices, np.float64), norm.axes))
    return _turned(upright, norm, norm.axes, heading)


def _at_nearest_front(mesh: Mesh, norm: Normalization, heading: float) -> Normalization:
    """Return a normalization by a heading whose front is the axis of the file that is nearest to it."""
    quarter = int(np.round(heading / (np.pi / 2)))
    rotation = ROTATIONS[ORIENTATIONS.index(("+y", QUARTERS[quarter % 4]))] @ norm.axes
    upright = _at(mesh, rotate_axes(np.asarray(mesh.vertices, np.float64), rotation))
    front = axis_name(rotation.T @ np.array([0.0, 0.0, 1.0]))
    return _turned(upright, replace(norm, front=front), rotation, heading - quarter * np.pi / 2)


def principal_heading(upright: Mesh) -> float | None:
    """Return the angle of the longer horizontal principal axis of a surface, radians from z towards x, 0 to pi.

    None where both are of one length. Of a point cloud, the axes of its points.
    """
    corners, areas = np.arange(len(upright.vertices))[None], np.ones(len(upright.vertices))
    if len(upright.faces) > 1:
        corners, areas = upright.faces.T, face_areas(upright.vertices, upright.faces)
    areas = areas / areas.sum()
    # Second moments of a triangle: those of its three corners and of three times its centroid, over 12.
    count = len(corners)
    planes = []
    for k in (0, 2):
        plane = upright.vertices[:, k][corners]  # rows of one corner each: three times as fast as rows of three
        plane = plane - areas @ plane.mean(axis=0)
        planes.append(np.concatenate([plane, plane.sum(axis=0, keepdims=True)]))
    x, z = planes
    xx, zz, xz = (areas @ product.sum(axis=0) / (count * (count + 1)) for product in (x * x, z * z, x * z))
    if np.hypot(zz - xx, 2 * xz) <= ROUND * (xx + zz):
        return None
    return float(np.round(np.arctan2(2 * xz, zz - xx) / 2, DIGITS) % np.pi)


def _at(mesh: Mesh, vertices: Float[np.ndarray, "V 3"]) -> Mesh:
    """Replace the points of a mesh without its normals, which nothing here reads: turning them costs more than all."""
    return replace(mesh, vertices=vertices, corner_normals=None)


def _turned(upright: Mesh, norm: Normalization, rotation: Float[np.ndarray, "3 3"], heading: float) -> Normalization:
    """Return a normalization that applies an axis rotation, then takes out a heading, then centres and scales."""
    vertices = turned(drawn_points(upright, upright.vertices), -heading)
    centre = bbox_centre(vertices)
    return replace(
        norm,
        rotation=turn(-heading) @ rotation,
        centre=centre,
        radius=radius(vertices - centre),
        heading=float(heading),
    )
