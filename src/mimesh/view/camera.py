"""Cameras: named views, fitted so that a mesh or a whole clip fills the picture without jumps between frames.

World coordinates are those of the mesh; camera coordinates have x to the right, y up and z towards the viewer.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.frame_buffer import Frames, each_frame

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

At negative azimuths the camera is at the subject's right, so that it faces the right edge of the picture.
"""

FIELD_OF_VIEW = 26.0
"""Degrees from top to bottom: narrow, as a portrait lens, so that perspective distorts proportions little."""
SLOPE = float(np.tan(np.radians(FIELD_OF_VIEW / 2)))
"""Tangent of half the field of view."""
MARGIN = 0.08
"""Share of the picture that stays empty at each edge."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Position, orientation and lens; also the floor and the subject's size, which all frames of a clip share."""

    rotmat_camera_world: Float[np.ndarray, "3 3"]
    """Rows are the picture's right, its up, and the direction towards the viewer, in world coordinates."""
    eye: Float[np.ndarray, 3]
    """World position of the camera."""
    up: Float[np.ndarray, 3]
    """Unit vector away from the floor."""
    floor: float
    """Height of the floor along `up`."""
    centre: Float[np.ndarray, 3]
    """Middle of the fitted points' bounding box."""
    radius: float
    """Half the diagonal of that box."""

    def project(self, points: Float[np.ndarray, "N 3"], size: tuple[int, int]) -> Float[np.ndarray, "N 3"]:
        """Project points to pixel x (to the right), pixel y (down) and a depth rank.

        The rank is smaller for nearer points and linear on screen: -1 / distance. Points behind the eye get NaN.
        """
        width, height = size
        # z points towards the viewer: visible points have a negative one.
        x, y, z = ((points - self.eye) @ self.rotmat_camera_world.T).T
        distance = np.where(z < 0, -z, np.nan)
        scale = height / (2 * SLOPE) / distance
        return np.stack([width / 2 + x * scale, height / 2 - y * scale, -1.0 / distance], axis=1)


def fit(
    points: Float[np.ndarray, "*T V 3"],
    size: tuple[int, int] = (512, 512),
    view: str | tuple[float, float] = "three-quarter",
    *,
    margin: float = MARGIN,
    up: str = "y",
    front: str | None = None,
) -> Camera:
    """Fit a camera that shows all points (a mesh, or every frame of a clip) as large as the picture allows.

    Args:
        points: any leading axes; the floor is at the lowest of them.
        size: width and height in pixels; only their ratio matters.
        view: a name in `VIEWS`, or azimuth and elevation in degrees.
        margin: share of the picture left empty at each edge.
        up: axis that points away from the floor: x, y, z, -x, -y or -z.
        front: axis that faces azimuth 0; +z, or -y when z is up.

    Raises:
        InputError: an unknown view or axis, or front along up.
    """
    world = axes(up, front)
    rotmat = _view_rotation(*_angles(view)) @ world  # world -> subject (right, up, front) -> camera
    flat = np.asarray(points, np.float64).reshape(-1, 3)
    low, high = flat.min(axis=0), flat.max(axis=0)
    centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-12)
    # Relative to the centre, so that a mesh far from the origin gets the same picture to the last bits.
    local = (flat - centre) @ rotmat.T
    offset = _eye(local, SLOPE * _half_extent(size, margin), radius)
    return Camera(
        rotmat_camera_world=rotmat,
        eye=centre + offset @ rotmat,
        up=world[1],
        floor=float(((flat - centre) @ world[1]).min() + centre @ world[1]),
        centre=centre,
        radius=radius,
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
    """Return cameras evenly around the subject, all at one distance that keeps it in the picture from every side."""
    camera = fit(points, size, view, up=up, front=front)
    flat = np.asarray(points, np.float64).reshape(-1, 3) - camera.centre
    # The points rotated in steps of 20 degrees stand for all sides.
    swept = np.concatenate([flat @ _axis_rotation(camera.up, angle).T for angle in range(0, 360, 20)])
    wide = fit(swept + camera.centre, size, view, up=up, front=front)
    return [rotate_camera(wide, 360.0 * k / count) for k in range(count)]


def extreme_points(
    frames: Frames,
    size: tuple[int, int] = (512, 512),
    view: str | tuple[float, float] = "three-quarter",
    offsets: Float[np.ndarray, "T 3"] | None = None,
    *,
    up: str = "y",
    front: str | None = None,
) -> Float[np.ndarray, "P 3"]:
    """Find the few points of a clip for which `fit` gives the same camera as for all of its points.

    Frames are read one by one, so that a clip on disk needs no memory.

    Args:
        offsets: subtracted from each frame's points first.
    """
    world = axes(up, front)
    rotmat = _view_rotation(*_angles(view)) @ world
    reach = SLOPE * _half_extent(size, MARGIN)
    # What `fit` looks at: the four planes of the lens (see `_eye`), the nearest point, the floor, the box.
    planes = [[1, 0, reach[0]], [-1, 0, reach[0]], [0, 1, reach[1]], [0, -1, reach[1]], [0, 0, 1]]
    directions = np.concatenate([np.array(planes) @ rotmat, -world[1:2], np.eye(3), -np.eye(3)])
    best, extremes = np.full(len(directions), -np.inf), np.zeros((len(directions), 3))
    for t, points in enumerate(each_frame(frames)):
        points = points if offsets is None else points - offsets[t]
        value = directions @ points.T
        farthest = value.argmax(axis=1)
        value = value[np.arange(len(value)), farthest]
        better = value > best
        best[better], extremes[better] = value[better], points[farthest[better]]
    return extremes


def follow(
    points: Frames,
    size: tuple[int, int] = (512, 512),
    view: str | tuple[float, float] = "three-quarter",
    *,
    up: str = "y",
    front: str | None = None,
) -> list[Camera]:
    """Return one camera per frame, at one distance and height, that follow the subject's centroid along the floor."""
    vertical = axes(up, front)[1]
    centroid = np.stack([frame.mean(axis=0) for frame in each_frame(points)])
    offsets = centroid - centroid[0]
    # The camera stays at its height, so that jumps are visible as such.
    offsets -= (offsets @ vertical)[:, None] * vertical
    camera = fit(extreme_points(points, size, view, offsets, up=up, front=front), size, view, up=up, front=front)
    heights = camera.floor + offsets @ camera.up
    return [
        dataclasses.replace(camera, eye=camera.eye + offset, centre=camera.centre + offset, floor=float(height))
        for offset, height in zip(offsets, heights, strict=True)
    ]


def rotate_camera(camera: Camera, degrees: float) -> Camera:
    """Rotate a camera about the vertical through the subject's centre; positive is counter-clockwise from above."""
    rotmat = _axis_rotation(camera.up, degrees)
    return dataclasses.replace(
        camera,
        rotmat_camera_world=camera.rotmat_camera_world @ rotmat.T,
        eye=camera.centre + rotmat @ (camera.eye - camera.centre),
    )


def _axis_rotation(axis, degrees) -> Float[np.ndarray, "3 3"]:
    """Return the rotation matrix about a unit axis (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _half_extent(size: tuple[int, int], margin: float) -> Float[np.ndarray, " 2"]:
    """Return half the width and height that the subject may fill, as multiples of half the picture's height."""
    return np.array([size[0] / size[1], 1.0]) * (1 - 2 * margin)


def _eye(local, reach, radius):
    """Solve |x - ex| <= reach_x (ez - z) and the same for y over all points, for the eye (ex, ey, ez) with least ez.

    Exact: each side of the picture is a plane through the eye, so each of the four constraints depends on the points
    through one maximum, of +-x + reach_x z or +-y + reach_y z.
    """
    z = local[:, 2]
    offset = np.zeros(3)
    depths = []
    for k in range(2):
        plus = (local[:, k] + reach[k] * z).max()
        minus = (-local[:, k] + reach[k] * z).max()
        offset[k] = (plus - minus) / 2
        # Half way between the two planes in x (or y); their distance there gives the depth at which they meet.
        depths.append((plus + minus) / (2 * reach[k]))
    # Without this, a flat subject seen edge-on, or a single point, would be at the eye itself.
    offset[2] = max(*depths, float(z.max()) + 0.05 * radius)
    return offset


def _angles(view: str | tuple[float, float]) -> tuple[float, float]:
    if not isinstance(view, str):
        return view
    if view not in VIEWS:
        raise InputError(f"view: expected one of {', '.join(VIEWS)}, found {view}; name one of them")
    return VIEWS[view]


def _view_rotation(azimuth: float, elevation: float) -> Float[np.ndarray, "3 3"]:
    """Return rows right, up, back of a camera at angles in degrees, in coordinates where y is up and z is the front."""
    a, e = np.radians([azimuth, elevation])
    right = [np.cos(a), 0.0, -np.sin(a)]
    back = [np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)]
    return np.stack([right, np.cross(back, right), back])


def axes(up: str, front: str | None) -> Float[np.ndarray, "3 3"]:
    """Return unit vectors in world coordinates as rows: right (of the picture in the front view), up, front."""
    # Defaults of the usual conventions: y up with z front (glTF, BVH), z up with -y front (Blender).
    front = front or ("-y" if up.strip("+") == "z" else "y" if up == "-z" else "z")
    vertical, forward = _axis("up", up), _axis("front", front)
    # Axes are parallel (product 1 or -1) or perpendicular (0).
    if abs(vertical @ forward) > 0.5:
        raise InputError(f"front: expected an axis across up ({up}), found {front}; choose another")
    return np.stack([np.cross(vertical, forward), vertical, forward])


def _axis(what: str, name: str) -> Float[np.ndarray, 3]:
    """Parse the name of an axis into a unit vector; `what` is the option that an error names."""
    letter = name.lstrip("+-")
    if letter not in ("x", "y", "z") or len(name) > 2:
        raise InputError(f"{what}: expected x, y, z, -x, -y or -z, found {name}; name one of them")
    axis = np.zeros(3)
    axis["xyz".index(letter)] = -1.0 if name.startswith("-") else 1.0
    return axis
