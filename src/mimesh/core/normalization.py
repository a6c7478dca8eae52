"""Frame: where a mesh stands and which way it faces, found once and undone exactly.

File axes -> y up, +z front, bounding box centred, largest distance 1. Up and front snap to the 24 axis rotations, so a
mesh that was moved, scaled or turned by one of them arrives at the same points; any other heading stays in the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from jaxtyping import Float, Int

from .errors import InputError
from .geometry import face_areas
from .mesh import Mesh

AXES = ("+x", "+y", "+z", "-x", "-y", "-z")
UNSURE = 0.5
"""Below this margin a detected facing deserves a note (chosen on synthetic people, see scripts/fit_orientation.py)."""
GRID = 11
"""Cells along each side of the coarse grid that up and front are read from."""
REACH = 2.2
"""Half the grid's side, in root-mean-square distances from the centroid; points beyond it count at its border."""


@dataclass(frozen=True, eq=False)
class Normalization:
    """A similarity transform: normalised = (rotation @ file - centre) / radius."""

    rotation: Float[np.ndarray, "3 3"]
    """One of the 24 axis rotations, file axes to y up and +z front."""
    centre: Float[np.ndarray, " 3"]
    """Middle of the bounding box, after the rotation."""
    radius: float
    """Largest distance from the centre, in the file's unit."""
    up: str
    front: str
    detected: bool
    """Whether up or front (or both) were found from the shape, not given."""
    margin: float
    """Probability of the chosen facing minus that of the runner-up; 1 where both axes were given."""

    @classmethod
    def fit(cls, mesh: Mesh, up: str | None = None, front: str | None = None) -> Normalization:
        """Fit to a mesh; axes that are not given ("+y", "-z", "x") are found from the shape, for people.

        The detector was fitted to people: for other shapes it gives some axes, the same ones however the file is
        turned, and usually a small margin. Shapes with a rotational symmetry have no facing to find.

        Raises:
            InputError: an axis is not one of +x +y +z -x -y -z, or up and front lie on one axis.
        """
        up, front = parse_axis(up, "--up"), parse_axis(front, "--front")
        if up and front and up[1] == front[1]:
            raise InputError(f"--up {up} --front {front}: expected two different axes, found one; change one of them")
        fits = [r for r, names in enumerate(ORIENTATIONS) if (up in (None, names[0])) and (front in (None, names[1]))]
        chosen, margin = (fits[0], 1.0) if len(fits) == 1 else _best(mesh, fits)
        up, front = ORIENTATIONS[chosen]
        turned = _turn(np.asarray(mesh.vertices, np.float64), ROTATIONS[chosen])
        centre = bbox_centre(turned)
        return cls(ROTATIONS[chosen], centre, radius(turned - centre), up, front, len(fits) > 1, margin)

    def apply(self, vertices: Float[np.ndarray, "*T V 3"]) -> Float[np.ndarray, "*T V 3"]:
        """File coordinates to the normalised frame (float64)."""
        return (_turn(vertices.astype(np.float64), self.rotation) - self.centre) / self.radius

    def undo(self, vertices: Float[np.ndarray, "*T V 3"]) -> Float[np.ndarray, "*T V 3"]:
        """Normalised frame to file coordinates; the inverse of `apply` up to rounding (float64)."""
        return _turn(vertices.astype(np.float64) * self.radius + self.centre, self.rotation.T)

    @property
    def unsure(self) -> bool:
        """Whether the facing was detected with so little margin that the user should look."""
        return self.detected and self.margin < UNSURE


def parse_axis(axis: str | None, option: str) -> str | None:
    """Normalise an axis name: "y", "Y" and "+y" are "+y"; None stays None.

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


def bbox_centre(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
    """Middle of the axis-aligned bounding box; the order of the vertices cannot matter to the last bit."""
    return (vertices.min(axis=0) + vertices.max(axis=0)) / 2


def radius(centred: Float[np.ndarray, "V 3"]) -> float:
    """Largest distance from the origin; the order of the vertices cannot matter to the last bit."""
    x, y, z = centred[:, 0], centred[:, 1], centred[:, 2]
    return float(np.sqrt((x * x + y * y + z * z).max()))


def occupancy(points: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, " N"]) -> Float[np.ndarray, " C"]:
    """Square root of the share of surface near each of GRID^3 cells: what the detector sees of a shape.

    Trilinear, about the centroid, in units of the root-mean-square distance. The lattice is mapped onto itself by all
    24 rotations, so the features of a turned mesh are the turned features (`TURNED_CELLS`).
    """
    weights = weights / weights.sum()
    centred = points - weights @ points
    scale = np.sqrt(weights @ (centred * centred).sum(axis=1))
    cell = (np.clip(centred / (REACH * scale), -1, 1) + 1) / 2 * (GRID - 1)
    low = np.minimum(cell.astype(np.int64), GRID - 2)
    part = cell - low
    total = np.zeros(GRID**3)
    for corner in np.ndindex(2, 2, 2):
        share = np.where(np.array(corner, bool), part, 1 - part).prod(axis=1) * weights
        total += np.bincount((low + corner) @ (GRID * GRID, GRID, 1), share, minlength=GRID**3)
    return np.sqrt(total)


def orientation_scores(features: Float[np.ndarray, "*B C"], model: dict[str, np.ndarray]) -> Float[np.ndarray, "*B 24"]:
    """Score of each of the 24 rotations: one small network, applied to the shape as each rotation would show it."""
    turned = features[..., TURNED_CELLS]
    hidden = np.maximum(turned @ model["hidden"] + model["bias"], 0.0)
    return hidden @ model["out"]


def _best(mesh: Mesh, fits: list[int]) -> tuple[int, float]:
    points, weights = mesh.vertices, np.ones(len(mesh.vertices))
    if len(mesh.faces) > 1:  # one alone has a middle, but no extent
        points, weights = mesh.vertices[mesh.faces].mean(axis=1), face_areas(mesh.vertices, mesh.faces)
    scores = orientation_scores(occupancy(points.astype(np.float64), weights.astype(np.float64)), _detector())[fits]
    # Rounded, so that the order of a sum cannot decide between the equal facings of a symmetric shape.
    scores = np.round(scores, 6)
    chance = np.exp(scores - scores.max())
    first, second = np.sort(chance / chance.sum())[::-1][:2]
    return fits[int(scores.argmax())], float(first - second)


@cache
def _detector() -> dict[str, np.ndarray]:
    with np.load(str(resources.files("mimesh.core") / "frame_orientation.npz")) as data:
        return {name: data[name].astype(np.float64) for name in data.files}


def _turn(vertices: Float[np.ndarray, "*T V 3"], rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "*T V 3"]:
    """Turn by an axis rotation: coordinates change place and sign, nothing is rounded."""
    source = np.abs(rotation).argmax(axis=1)
    return vertices[..., source] * rotation.sum(axis=1) + 0.0  # no negative zeros: they would sort and weld apart


def _axis_rotations() -> tuple[tuple[tuple[str, str], ...], Float[np.ndarray, "24 3 3"]]:
    vector: dict[str, np.ndarray] = dict(zip(AXES, np.concatenate([np.eye(3), -np.eye(3)]), strict=True))
    pairs = tuple((up, front) for up in AXES for front in AXES if up[1] != front[1])
    rows = [(np.cross(vector[up], vector[front]), vector[up], vector[front]) for up, front in pairs]
    return pairs, np.array(rows) + 0.0  # + 0.0: no negative zeros


def _turned_cells() -> Int[np.ndarray, "24 C"]:
    """For each rotation, the cell that each cell of the turned grid is taken from."""
    cells = np.stack(np.meshgrid(*[np.arange(GRID)] * 3, indexing="ij"), -1).reshape(-1, 3) - (GRID - 1) / 2
    origin = np.stack([_turn(cells, rotation.T) for rotation in ROTATIONS]) + (GRID - 1) / 2
    return origin.round().astype(np.int64) @ (GRID * GRID, GRID, 1)


ORIENTATIONS, ROTATIONS = _axis_rotations()
"""The 24 (up, front) pairs and the rotation of each."""
TURNED_CELLS = _turned_cells()
