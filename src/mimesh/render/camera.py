"""Cameras: named views, fitted so that a mesh or a whole clip fills the picture and nothing jumps between frames."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.frame_buffer import each_frame

VIEWS = {
    "three-quarter": (-32.0, 12.0),
    "front": (0.0, 7.0),
    "side": (-90.0, 7.0),
    "left": (90.0, 7.0),
    "right": (-90.0, 7.0),
    "back": (180.0, 7.0),
    "back-three-quarter": (148.0, 12.0),
    "top": (0.0, 90.0),
}
"""Azimuth about the up axis and elevation above the floor, in degrees; azimuth 0 looks at the front.

Negative azimuths stand at the subject's right, so that it faces the right edge of the picture, the way one reads.
"""

FIELD_OF_VIEW = 26.0
"""Degrees from top to bottom: a portrait lens, which keeps proportions honest and still shows depth."""
MARGIN = 0.08
"""Share of the picture that stays free at each edge."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Where the picture is taken from; the floor and the subject's size are kept here so that a clip shares them."""

    rotmat_camera_world: Float[np.ndarray, "3 3"]
    """Rows are the picture's right, its up, and the direction towards the viewer, in world coordinates."""
    eye: Float[np.ndarray, 3]
    """World position; with an orthographic camera, a point in front of everything."""
    half_height: float
    """Half the picture's height: tangent of half the field of view, or world units when orthographic."""
    up: Float[np.ndarray, 3]
    """Unit vector away from the floor."""
    floor: float
    """Height of the floor along `up`."""
    centre: Float[np.ndarray, 3]
    """Middle of the fitted points' bounding box."""
    radius: float
    """Half the diagonal of that box."""
    perspective: bool = True

    def project(self, points: Float[np.ndarray, "N 3"], size: tuple[int, int]) -> Float[np.ndarray, "N 3"]:
        """Pixel x (to the right), pixel y (down), and a rank that is smaller nearer and linear across the picture.

        The rank is -1 / distance in perspective and the distance otherwise. Points behind a perspective eye get NaN.
        """
        width, height = size
        x, y, z = ((points - self.eye) @ self.rotmat_camera_world.T).T
        distance = np.where(z < 0, -z, np.nan) if self.perspective else -z
        scale = height / (2 * self.half_height) / (distance if self.perspective else 1.0)
        rank = -1.0 / distance if self.perspective else distance
        return np.stack([width / 2 + x * scale, height / 2 - y * scale, rank], axis=1)


def fit(
    points: Float[np.ndarray, "*T V 3"],
    size: tuple[int, int] = (512, 512),
    view: str | tuple[float, float] = "three-quarter",
    *,
    perspective: bool = True,
    margin: float = MARGIN,
    up: str = "y",
    front: str | None = None,
) -> Camera:
    """The camera that shows all points (a mesh, or every frame of a clip) as large as the picture allows.

    Args:
        points: any leading axes; the floor is put under the lowest of them.
        size: width and height in pixels; only their ratio matters.
        view: a name in `VIEWS`, or azimuth and elevation in degrees.
        perspective: a portrait lens, or else parallel rays.
        margin: share of the picture left free at each edge.
        up: axis that points away from the floor: x, y, z, -x, -y or -z.
        front: axis that faces azimuth 0; +z, or -y when z is up.

    Raises:
        InputError: an unknown view or axis, or front along up.
    """
    world = axes(up, front)
    rotmat = _turn(*_angles(view)) @ world
    flat = np.asarray(points, np.float64).reshape(-1, 3)
    low, high = flat.min(axis=0), flat.max(axis=0)
    centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-12)
    # Measured from the centre, so that a mesh far from the origin gets the same picture to the last bits.
    local = (flat - centre) @ rotmat.T
    place = _fit_perspective if perspective else _fit_parallel
    offset, half_height = place(local, _frame(size, margin), _slope(), radius)
    return Camera(
        rotmat_camera_world=rotmat,
        eye=centre + offset @ rotmat,
        half_height=half_height,
        up=world[1],
        floor=float(((flat - centre) @ world[1]).min() + centre @ world[1]),
        centre=centre,
        radius=radius,
        perspective=perspective,
    )


def orbit(
    points: Float[np.ndarray, "*T V 3"],
    size: tuple[int, int] = (512, 512),
    count: int = 48,
    view: str | tuple[float, float] = "three-quarter",
    *,
    up: str = "y",
    front: str | None = None,
) -> list[Camera]:
    """Cameras evenly around the subject, all at one distance that keeps it in the picture from everywhere."""
    camera = fit(points, size, view, up=up, front=front)
    flat = np.asarray(points, np.float64).reshape(-1, 3) - camera.centre
    swept = np.concatenate([flat @ _about(camera.up, angle).T for angle in range(0, 360, 20)])
    wide = fit(swept + camera.centre, size, view, up=up, front=front)
    return [turned(wide, 360.0 * k / count) for k in range(count)]


def extremes(
    frames: Float[np.ndarray, "T V 3"],
    size: tuple[int, int] = (512, 512),
    view: str | tuple[float, float] = "three-quarter",
    travel: Float[np.ndarray, "T 3"] | None = None,
    *,
    up: str = "y",
    front: str | None = None,
) -> Float[np.ndarray, "P 3"]:
    """The few points of a clip that decide how `fit` sees all of them with a lens; frames are read one by one.

    Args:
        travel: what is taken away from each frame's points first.
    """
    world = axes(up, front)
    rotmat = _turn(*_angles(view)) @ world
    reach = _slope() * _frame(size, MARGIN)
    cones = [[1, 0, reach[0]], [-1, 0, reach[0]], [0, 1, reach[1]], [0, -1, reach[1]], [0, 0, 1]]
    directions = np.concatenate([np.array(cones) @ rotmat, -world[1:2], np.eye(3), -np.eye(3)])
    best, found = np.full(len(directions), -np.inf), np.zeros((len(directions), 3))
    for t, points in enumerate(each_frame(frames)):
        moved_points = points if travel is None else points - travel[t]
        value = directions @ moved_points.T
        farthest = value.argmax(axis=1)
        value = value[np.arange(len(value)), farthest]
        better = value > best
        best[better], found[better] = value[better], moved_points[farthest[better]]
    return found


def follow(
    points: Float[np.ndarray, "T V 3"],
    size: tuple[int, int] = (512, 512),
    view: str | tuple[float, float] = "three-quarter",
    *,
    up: str = "y",
    front: str | None = None,
) -> list[Camera]:
    """One camera per frame at one distance and height, moved along the floor with the subject's middle."""
    vertical = axes(up, front)[1]
    middle = np.stack([frame.mean(axis=0) for frame in each_frame(points)])
    travel = middle - middle[0]
    travel -= (travel @ vertical)[:, None] * vertical
    camera = fit(extremes(points, size, view, travel, up=up, front=front), size, view, up=up, front=front)
    return [moved(camera, step) for step in travel]


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera carried around the vertical through the subject's middle; positive is counter-clockwise from above."""
    turn = _about(camera.up, degrees)
    return dataclasses.replace(
        camera,
        rotmat_camera_world=camera.rotmat_camera_world @ turn.T,
        eye=camera.centre + turn @ (camera.eye - camera.centre),
    )


def moved(camera: Camera, offset: Float[np.ndarray, " 3"]) -> Camera:
    """The camera and its floor, moved."""
    floor = camera.floor + float(offset @ camera.up)
    return dataclasses.replace(camera, eye=camera.eye + offset, centre=camera.centre + offset, floor=floor)


def _about(axis, degrees) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix about a unit axis."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _slope() -> float:
    return float(np.tan(np.radians(FIELD_OF_VIEW / 2)))


def _frame(size: tuple[int, int], margin: float) -> Float[np.ndarray, " 2"]:
    """Half the width and height that are to be filled, over half the picture's height."""
    return np.array([size[0] / size[1], 1.0]) * (1 - 2 * margin)


def _fit_perspective(local, frame, slope, radius):
    """Solve |x - ex| <= slope_x (ez - z) and the same for y over all points: four maxima decide it exactly."""
    reach = slope * frame
    z = local[:, 2]
    offset = np.zeros(3)
    depths = []
    for k in range(2):
        plus = (local[:, k] + reach[k] * z).max()
        minus = (-local[:, k] + reach[k] * z).max()
        offset[k] = (plus - minus) / 2
        depths.append((plus + minus) / (2 * reach[k]))
    # A flat or single-point subject seen edge-on must not end up at the eye.
    offset[2] = max(*depths, float(z.max()) + 0.05 * radius)
    return offset, slope


def _fit_parallel(local, frame, slope, radius):
    low, high = local.min(axis=0), local.max(axis=0)
    half = float(((high - low)[:2] / 2 / frame).max())
    offset = (low + high) / 2
    offset[2] = high[2] + radius
    return offset, max(half, 1e-3 * radius)


def _angles(view: str | tuple[float, float]) -> tuple[float, float]:
    if not isinstance(view, str):
        return view
    if view not in VIEWS:
        raise InputError(f"view: expected one of {', '.join(VIEWS)}, found {view}; name one of them")
    return VIEWS[view]


def _turn(azimuth: float, elevation: float) -> Float[np.ndarray, "3 3"]:
    """Rows right, up, back of a camera at these angles, in coordinates where y is up and z is the front."""
    a, e = np.radians([azimuth, elevation])
    right = [np.cos(a), 0.0, -np.sin(a)]
    back = [np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)]
    return np.stack([right, np.cross(back, right), back])


def axes(up: str, front: str | None) -> Float[np.ndarray, "3 3"]:
    """Rows right, up, front of the subject's own frame, in world coordinates."""
    front = front or ("-y" if up.strip("+") == "z" else "y" if up == "-z" else "z")
    vertical, forward = _axis("up", up), _axis("front", front)
    if abs(vertical @ forward) > 0.5:
        raise InputError(f"front: expected an axis across up ({up}), found {front}; choose another")
    return np.stack([np.cross(vertical, forward), vertical, forward])


def _axis(what: str, name: str) -> Float[np.ndarray, 3]:
    letter = name.lstrip("+-")
    if letter not in ("x", "y", "z") or len(name) > 2:
        raise InputError(f"{what}: expected x, y, z, -x, -y or -z, found {name}; name one of them")
    axis = np.zeros(3)
    axis["xyz".index(letter)] = -1.0 if name.startswith("-") else 1.0
    return axis
