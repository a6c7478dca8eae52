"""Poses in which people touch themselves: hands together, arms against the body, crossed legs.

A place on one limb is brought to a place elsewhere, surface to surface, by the joints between: least squares within the
limits of the joints, from a pose that is kept as far as it can be.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core import geometry
from ..core.rig import descendants
from .body_model import RiggedBody
from .sampling import JOINT_LIMITS, limits_rotvec, rotvec_to_rotmat

ARM, LEG = ("Shoulder", "Arm", "ForeArm", "Hand"), ("UpLeg", "Leg")
"""Bones that move to make a contact."""
TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "Head")
DISTANCE, FACING, KEEPING = 0.01, 0.5, 1.0
"""Scales of the residuals: metres between the places, sum of their normals, radians from the pose before."""
TRIES = 12
"""Pairs of places that are tried, until one is met without cutting through."""
MET, DEEP = 0.01, 0.02
"""Metres: places so near have met, vertices so far below the surface of another limb have cut through it."""
CORNERS = np.arange(6).reshape(2, 3)
"""Of the two triangles that are brought together."""
STEP = 1e-4
"""Radians, of the numerical derivative."""
BANK = Path(str(resources.files("mimesh.bodies"))) / "contacts.npz"
"""People who touch themselves, for training; `scripts/build_contacts.py` made it."""


@dataclass(frozen=True)
class Contact:
    """What touches what, and the joints that bring them together."""

    one: tuple[str, ...]
    """The place lies where one of these joints holds the skin most."""
    other: tuple[str, ...]
    moving: tuple[str, ...]


def _sides(names: tuple[str, ...], side: str) -> tuple[str, ...]:
    return tuple(side + name for name in names)


CONTACTS: dict[str, tuple[Contact, ...]] = {
    "hands": (
        Contact(
            _sides(("Hand", "FingerBase"), "Left"),
            _sides(("Hand", "FingerBase"), "Right"),
            _sides(ARM, "Left") + _sides(ARM, "Right"),
        ),
    ),
    "arms": tuple(
        Contact(
            _sides(("Hand", "FingerBase", "ForeArm"), side),
            (*TRUNK, "LeftUpLeg", "RightUpLeg", f"{across}Arm"),
            _sides(ARM, side),
        )
        for side, across in (("Left", "Right"), ("Right", "Left"))
    ),
    "legs": (
        Contact(
            _sides(("Leg", "Foot"), "Left"),
            _sides(("UpLeg", "Leg", "Foot"), "Right"),
            _sides(LEG, "Left") + _sides(LEG, "Right"),
        ),
    ),
}
"""By kind; one of them is drawn."""


def touching(
    body: RiggedBody,
    shape: Float[np.ndarray, " K"],
    rotvec: Float[np.ndarray, "J 3"],
    kind: str,
    rng: np.random.Generator,
) -> Float[np.ndarray, "J 3"]:
    """A person's pose with a contact of a kind of CONTACTS put in: the best of a few that were tried.

    Args:
        rotvec: the pose before, rotation vectors in radians.
    """
    found = []
    for _ in range(TRIES):
        contact = CONTACTS[kind][rng.integers(len(CONTACTS[kind]))]
        faces = np.stack([body.faces[rng.choice(_held(body, names))] for names in (contact.one, contact.other)])
        pose, apart = _brought(body, shape, rotvec, contact.moving, faces)
        cut = _cut_through(body, body.posed(shape, rotvec_to_rotmat(pose)), contact.moving)
        found.append((max(apart, MET) + max(cut, DEEP), pose))
        if apart < MET and cut < DEEP:
            break
    return min(found, key=lambda each: each[0])[1]


def contact_bank() -> tuple[Float[np.ndarray, "N K"], Float[np.ndarray, "N J 3"]]:
    """Shape coefficients of people, and rotation vectors of poses in which each of them touches him- or herself."""
    with np.load(BANK) as data:
        return data["shapes"].astype(np.float64), data["rotvecs"].astype(np.float64)


def _held(body: RiggedBody, names: tuple[str, ...]) -> Int[np.ndarray, " N"]:
    """Faces whose corners are mostly held by one of these joints."""
    most = np.isin(body.weights.argmax(axis=1), [body.joint(name) for name in names])
    return np.flatnonzero(most[body.faces].all(axis=1))


def _brought(
    body: RiggedBody,
    shape: Float[np.ndarray, " K"],
    rotvec: Float[np.ndarray, "J 3"],
    moving: tuple[str, ...],
    faces: Int[np.ndarray, "2 3"],
) -> tuple[Float[np.ndarray, "J 3"], float]:
    """The pose that brings two faces together, outside to outside, and how far apart (metres) they stay."""
    from scipy.optimize import least_squares

    corners = faces.ravel()
    small = dataclasses.replace(
        body, vertices=body.vertices[corners], components=body.components[:, corners], weights=body.weights[corners]
    )
    index = [body.joint(name) for name in moving]
    low, high = limits_rotvec(body, JOINT_LIMITS)[:, index].reshape(2, -1)
    low, high = low - 1e-3, high + 1e-3  # some are zero wide
    start = np.clip(rotvec[index].ravel(), low, high)

    def gaps(many):
        poses = np.repeat(rotvec[None], len(many), axis=0)
        poses[:, index] = many.reshape(len(many), -1, 3)
        points = small.posed(shape, rotvec_to_rotmat(poses))
        one, other = np.moveaxis(points.reshape(-1, 2, 3, 3).mean(axis=2), 1, 0)
        return one - other, geometry.face_normals(points, CORNERS).sum(axis=1), many - start

    def residuals(many):
        scaled = (gap / scale for gap, scale in zip(gaps(many), (DISTANCE, FACING, KEEPING), strict=True))
        return np.concatenate(list(scaled), axis=1)

    def slopes(x):
        both = residuals(np.concatenate([x[None], x + STEP * np.eye(len(x))]))
        return (both[1:] - both[0]).T / STEP

    def residual(x):
        return residuals(x[None])[0]

    limits = {"bounds": (low, high), "max_nfev": 30, "xtol": 1e-4, "ftol": 1e-4}
    solved = least_squares(residual, start, slopes, **limits)  # pyright: ignore[reportArgumentType] (its stub)
    pose = rotvec.copy()
    pose[index] = solved.x.reshape(-1, 3)
    return pose, float(np.linalg.norm(gaps(solved.x[None])[0]))


def _cut_through(body: RiggedBody, vertices: Float[np.ndarray, "V 3"], moving: tuple[str, ...]) -> float:
    """How deep (metres) moved limbs are below the surface of something else, but for a hundredth of all vertices.

    That is the depth which a twentieth of an arm exceeds: skin that is pressed is not told from skin that cuts through.
    """
    from scipy.spatial import KDTree

    most, normals = body.weights.argmax(axis=1), geometry.vertex_normals(vertices, body.faces)
    depth = np.zeros(len(vertices))
    for side in ("Left", "Right"):
        ours = [body.joint(name) for name in moving if name.startswith(side)]
        ends = descendants(ours, body.parents)
        limb = np.flatnonzero(np.isin(most, ends))
        # What the limb hangs from always touches it.
        above = [body.parents[j] for j in ours]
        rest = np.flatnonzero(~np.isin(most, [*ends, *above, *(body.parents[j] for j in above)]))
        if len(limb):
            nearest = rest[KDTree(vertices[rest]).query(vertices[limb])[1]]
            depth[limb] = ((vertices[nearest] - vertices[limb]) * normals[nearest]).sum(axis=1)
    moved = np.sort(depth)[::-1]
    return float(moved[len(moved) // 100])
