"""Poses with self-contact: hands together, arms against the body, crossed legs.

A face of one limb is brought to a face of another part of the body by the joints between them: nonlinear least squares
within the limits of the joints, regularised towards the given pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core import geometry
from ..core.geometry import nearest_points
from ..core.rig import descendants
from .body_model import RiggedBody
from .sampling import JOINT_LIMITS, limits_rotvec, rotvec_to_rotmat

ARM, LEG = ("Shoulder", "Arm", "ForeArm", "Hand"), ("UpLeg", "Leg")
"""Joints that may turn to make a contact."""
TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "Head")
"""Joints of the trunk and head, which arms may touch."""
DISTANCE, NORMALS, POSE = 0.01, 0.5, 1.0
"""Scales of the residuals: metres between the faces, sum of their unit normals, radians from the given pose."""
TRIES = 12
"""Largest number of random pairs of faces that are tried, until one is met without an intersection."""
MET, DEEP = 0.01, 0.02
"""Metres: largest distance of faces in contact, and smallest depth under another surface that is an intersection."""
CORNERS = np.arange(6).reshape(2, 3)
"""Faces of the reduced body, which has only the vertices of the two faces."""
STEP = 1e-4
"""Step of the numerical derivative (radians)."""
BANK = Path(str(resources.files("mimesh.bodies"))) / "contacts.npz"
"""People with self-contacts, for training; made by `research/recipes/build_contacts.py`."""


@dataclass(frozen=True)
class Contact:
    """Two parts of the body that can touch, and the joints that bring them together."""

    first: tuple[str, ...]
    """Joints of one part: its faces have their largest weights on these."""
    second: tuple[str, ...]
    """Joints of the other part."""
    moving: tuple[str, ...]
    """Joints that are optimised."""


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
"""Possible contacts of each kind."""


def touching(
    body: RiggedBody,
    shape: Float[np.ndarray, " K"],
    rotvec: Float[np.ndarray, "J 3"],
    kind: str,
    rng: np.random.Generator,
) -> Float[np.ndarray, "J 3"]:
    """Change a pose to one with a random contact of the given kind (a key of CONTACTS), and return the best of TRIES.

    Args:
        shape: shape coefficients of the person.
        rotvec: the given pose, rotation vectors in radians.
    """
    candidates, strongest = [], body.weights.argmax(axis=1)
    for _ in range(TRIES):
        contact = CONTACTS[kind][rng.integers(len(CONTACTS[kind]))]
        # Faces whose corners all have their largest weight on one of the joints.
        parts = (np.isin(strongest, [body.joint(name) for name in names]) for names in (contact.first, contact.second))
        faces = np.stack([body.faces[rng.choice(np.flatnonzero(on[body.faces].all(axis=1)))] for on in parts])
        pose, distance = _solve_contact(body, shape, rotvec, contact.moving, faces)
        depth = _intersection_depth(body, body.posed(shape, rotvec_to_rotmat(pose)), contact.moving)
        candidates.append((max(distance, MET) + max(depth, DEEP), pose))
        if distance < MET and depth < DEEP:
            break
    return min(candidates, key=lambda candidate: candidate[0])[1]


def contact_bank() -> tuple[Float[np.ndarray, "N K"], Float[np.ndarray, "N J 3"]]:
    """Load the shipped people with self-contacts: shape coefficients, and rotation vectors (radians) of their poses."""
    with np.load(BANK) as data:
        return data["shapes"].astype(np.float64), data["rotvecs"].astype(np.float64)


def _solve_contact(
    body: RiggedBody,
    shape: Float[np.ndarray, " K"],
    rotvec: Float[np.ndarray, "J 3"],
    moving: tuple[str, ...],
    faces: Int[np.ndarray, "2 3"],
) -> tuple[Float[np.ndarray, "J 3"], float]:
    """Compute the pose in which two faces touch with opposite normals, and the distance (metres) that remains."""
    from scipy.optimize import least_squares

    reduced = body.part(faces.ravel())
    index = [body.joint(name) for name in moving]
    low, high = limits_rotvec(body, JOINT_LIMITS)[:, index].reshape(2, -1)
    low, high = low - 1e-3, high + 1e-3  # least_squares needs low < high, and some joints have no range
    start = np.clip(rotvec[index].ravel(), low, high)

    def differences(batch):
        """Compute offset of the faces, sum of their normals and change of pose for a batch of unknowns."""
        poses = np.repeat(rotvec[None], len(batch), axis=0)
        poses[:, index] = batch.reshape(len(batch), -1, 3)
        points = reduced.posed(shape, rotvec_to_rotmat(poses))
        first, second = np.moveaxis(points.reshape(-1, 2, 3, 3).mean(axis=2), 1, 0)
        return first - second, geometry.face_normals(points, CORNERS).sum(axis=1), batch - start

    def residuals(batch):
        scaled = (part / scale for part, scale in zip(differences(batch), (DISTANCE, NORMALS, POSE), strict=True))
        return np.concatenate(list(scaled), axis=1)

    def jacobian(x):
        """Compute forward differences of all unknowns in one batch."""
        values = residuals(np.concatenate([x[None], x + STEP * np.eye(len(x))]))
        return (values[1:] - values[0]).T / STEP

    def residual(x):
        return residuals(x[None])[0]

    limits = {"bounds": (low, high), "max_nfev": 30, "xtol": 1e-4, "ftol": 1e-4}
    solved = least_squares(residual, start, jacobian, **limits)  # pyright: ignore[reportArgumentType] (its stub)
    pose = rotvec.copy()
    pose[index] = solved.x.reshape(-1, 3)
    return pose, float(np.linalg.norm(differences(solved.x[None])[0]))


def _intersection_depth(body: RiggedBody, vertices: Float[np.ndarray, "V 3"], moving: tuple[str, ...]) -> float:
    """Measure how deep (metres) moved limbs are below other surfaces: the 99th percentile over all vertices.

    About a twentieth of an arm's vertices are deeper. Contact pressure is not distinguished from intersection.
    """
    strongest, normals = body.weights.argmax(axis=1), geometry.vertex_normals(vertices, body.faces)
    depth = np.zeros(len(vertices))
    for side in ("Left", "Right"):
        joints = [body.joint(name) for name in moving if name.startswith(side)]
        limb_joints = descendants(joints, body.parents)
        limb = np.flatnonzero(np.isin(strongest, limb_joints))
        # The parts next to the limb always touch it, so they are left out.
        above = [body.parents[j] for j in joints]
        excluded = [*limb_joints, *above, *(body.parents[j] for j in above)]
        rest = np.flatnonzero(~np.isin(strongest, excluded))
        if len(limb):
            # Depth along the normal of the nearest other vertex; positive is below the surface.
            nearest = rest[nearest_points(vertices[rest], vertices[limb])[1]]
            depth[limb] = ((vertices[nearest] - vertices[limb]) * normals[nearest]).sum(axis=1)
    deepest = np.sort(depth)[::-1]
    return float(deepest[len(deepest) // 100])
