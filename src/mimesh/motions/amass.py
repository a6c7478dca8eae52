"""Read AMASS-style archives (.npz): rotation vectors (radians) of joints and the path of the pelvis (metres).

Arrays: `poses` (T, 66 or more), or `root_orient` (T, 3) with `pose_body` (T, 63); `trans` (T, 3); the frame rate as
`mocap_framerate`, `mocap_frame_rate` or `fps`, a number or text. Without `trans` a person stays in place, with the
lower foot at one height; without a rate it is 30 frames a second. Both give notes.

`load_amass` reads a skeleton: the first 22 joints, in the order of `JOINTS`, and the fingers of SMPL+H and SMPL-X; face
and `betas` are not read. The body model is not part of the file, so the rest skeleton is assumed: a T-pose with
straight legs and arms along the axes and flat hands, y up, facing +z, 1.7 m tall. Directions of limbs are therefore a
few degrees off those of the recorded body.

`load_recording` reads all joints and the shape, which give the recorded surface with a body model (`smpl_clip`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..bodies.sampling import rotvec_to_rotmat
from ..core.budgets import FRAMES, POSED_JOINTS
from ..core.errors import InputError, option
from ..core.npz_archive import POINTS, open_archive, rate_of, read_array
from .bvh import Bvh

HEIGHT = 1.7
"""Height of the assumed body (metres)."""
JOINTS = {
    "pelvis": ("", (0.0, 0.0, 0.0)),
    "left_hip": ("pelvis", (0.05, -0.05, 0.0)),
    "right_hip": ("pelvis", (-0.05, -0.05, 0.0)),
    "spine1": ("pelvis", (0.0, 0.07, 0.0)),
    "left_knee": ("left_hip", (0.0, -0.245, 0.0)),
    "right_knee": ("right_hip", (0.0, -0.245, 0.0)),
    "spine2": ("spine1", (0.0, 0.08, 0.0)),
    "left_ankle": ("left_knee", (0.0, -0.246, 0.0)),
    "right_ankle": ("right_knee", (0.0, -0.246, 0.0)),
    "spine3": ("spine2", (0.0, 0.04, 0.0)),
    "left_foot": ("left_ankle", (0.0, -0.03, 0.08)),
    "right_foot": ("right_ankle", (0.0, -0.03, 0.08)),
    "neck": ("spine3", (0.0, 0.13, 0.0)),
    "left_collar": ("spine3", (0.05, 0.07, 0.0)),
    "right_collar": ("spine3", (-0.05, 0.07, 0.0)),
    "head": ("neck", (0.0, 0.05, 0.0)),
    "left_shoulder": ("left_collar", (0.06, 0.0, 0.0)),
    "right_shoulder": ("right_collar", (-0.06, 0.0, 0.0)),
    "left_elbow": ("left_shoulder", (0.186, 0.0, 0.0)),
    "right_elbow": ("right_shoulder", (-0.186, 0.0, 0.0)),
    "left_wrist": ("left_elbow", (0.146, 0.0, 0.0)),
    "right_wrist": ("right_elbow", (-0.146, 0.0, 0.0)),
}
"""The first joints of a frame, in order: parent, and offset from the parent at rest in body heights.

Lengths of limbs as fractions of the height are those of Drillis and Contini (1966); the trunk is schematic.
"""
FACE = ("jaw", "left_eye", "right_eye")
"""Joints between those of the body and the fingers in SMPL-X."""
_KNUCKLES = {
    "index": ((0.055, 0.0, 0.014), (0.019, 0.0, 0.0)),
    "middle": ((0.057, 0.0, 0.002), (0.019, 0.0, 0.0)),
    "pinky": ((0.045, 0.0, -0.024), (0.011, 0.0, 0.0)),
    "ring": ((0.052, 0.0, -0.011), (0.017, 0.0, 0.0)),
    "thumb": ((0.014, 0.0, 0.014), (0.013, 0.0, 0.013)),
}
FINGERS = {
    f"{side}_{finger}{k}": (
        f"{side}_{finger}{k - 1}" if k > 1 else f"{side}_wrist",
        tuple(np.array([1.0 if side == "left" else -1.0, 1.0, 1.0]) * (first if k == 1 else bone)),
    )
    for side in ("left", "right")
    for finger, (first, bone) in _KNUCKLES.items()
    for k in (1, 2, 3)
}
"""The last 30 joints of SMPL+H and SMPL-X, as JOINTS: flat hands with palms down, the thumbs at 45 degrees."""
WITH_FINGERS = (len(JOINTS) + len(FINGERS), len(JOINTS) + len(FACE) + len(FINGERS))
"""Numbers of joints of SMPL+H and SMPL-X."""
RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
"""Names of the array with the frame rate."""
BODY_ALONE = 69
"""Numbers of SMPL's body without its root: one joint less than the usual 72, so each would be read as the next one."""
LOW = 0.3
"""Height of the pelvis (metres) below which it stays while a person lies."""
DEFAULT_RATE = 30.0
"""Frames per second of a file without a frame rate."""
MOTION = ("poses", "root_orient", "pose_body", "trans", *RATES)
"""Names of the arrays of a motion."""
PARTS = {"pose_jaw": 3, "pose_eye": 6, "pose_hand": 90}
"""Further parts of a pose where it is stored in parts: name and width, in the order of the joints."""


@dataclass(frozen=True, eq=False)
class BodyRecording:
    """Joint rotations, path and shape of a person as a body model's parameters, in the axes of the file."""

    rotvec: Float[np.ndarray, "T J 3"]
    """Rotation vector (radians) of each joint in its parent's frame; of the root in the world."""
    trans: Float[np.ndarray, "T 3"]
    """Translation of the body (metres)."""
    betas: Float[np.ndarray, " K"]
    """Shape coefficients; none if the file has none."""
    fps: float
    gender: str
    """Gender of the model that the coefficients belong to; empty if the file does not say."""
    notes: tuple[str, ...] = ()
    """What the file lacks, and what is taken instead."""


def is_amass(names: Collection[str]) -> bool:
    """Tell from the names of its arrays whether an archive is a motion: it has poses and no points."""
    return any(name in names for name in ("poses", "pose_body")) and not any(name in names for name in POINTS)


def load_amass(path: str | Path) -> Bvh:
    """Load an archive's motion as a skeleton of 22 joints, or 52 with fingers, y up (metres).

    `retarget_skeleton` transfers it to a body.

    AMASS has z up; if the pelvis is upright along y most of the time, the file is taken to have y up, or down
    (`upright`).
    """
    path = Path(path)
    arrays = _read_arrays(path, MOTION)
    rotvec, trans = _joints_and_path(arrays, path)
    skeleton = JOINTS
    if rotvec.shape[1] in WITH_FINGERS:
        skeleton = {**JOINTS, **FINGERS}
        rotvec = np.delete(rotvec, slice(len(JOINTS), rotvec.shape[1] - len(FINGERS)), axis=1)
    rotmat = rotvec_to_rotmat(rotvec[:, : len(skeleton)])
    # Only the root is rotated to y up; the other rotations are relative to it.
    axes = upright(rotmat[:, 0], trans)
    rotmat[:, 0] = axes @ rotmat[:, 0]
    notes = _lacking(arrays)
    if axes[1, 1] < 0:
        notes += ("y points down, as in the axes of a camera: the person is turned upright",)
    notes = tuple(f"{path.name}: {note}" for note in notes)
    return _assumed_body(path.stem, skeleton, rotmat, trans @ axes.T, _rate(arrays, path), notes)


def _assumed_body(name: str, joints: dict[str, tuple], rotmat, root, rate: float, notes=()) -> Bvh:
    names = tuple(joints)
    parents = tuple(names.index(parent) if parent else -1 for parent, _ in joints.values())
    offsets = HEIGHT * np.array([offset for _, offset in joints.values()])
    return Bvh(name, names, parents, offsets, {}, rotmat, root, rate, notes=notes)


def load_recording(path: str | Path) -> BodyRecording:
    """Load all that an archive has for a body model, in the axes of the file."""
    path = Path(path)
    arrays = _read_arrays(path, (*MOTION, *PARTS, "betas", "gender"))
    rotvec, trans = _joints_and_path(arrays, path)
    shape, rate = shape_of(arrays.get("betas"), path), _rate(arrays, path)
    return BodyRecording(rotvec, trans, shape, rate, _gender(arrays), _lacking(arrays))


def parse_betas(text: str) -> Float[np.ndarray, " K"]:
    """Read shape coefficients: "1.5,-0.3", or the name of an archive (.npz) that has them, such as another take.

    Raises:
        InputError: neither.
    """
    if text.lower().endswith(".npz") and Path(text).is_file():
        found = shape_of(_read_arrays(Path(text), ("betas",)).get("betas"), Path(text))
        if not len(found):
            raise InputError(f"{text}: expected the array betas, found none; name another file, or give numbers")
        return found
    try:
        found = np.array([float(number) for number in text.split(",")])
    except ValueError:
        found = np.array([np.nan])
    if not np.isfinite(found).all():
        raise InputError(
            f"--betas {text}: expected numbers with commas between, or an .npz with betas, found neither; for example "
            "1.5,-0.3"
        )
    return found


def recording_facts(path: str | Path) -> tuple[tuple[str, str], ...]:
    """Read what an archive says beside its motion, names and values: gender, number of betas, frame rate."""
    path = Path(path)
    arrays = _read_arrays(path, RATES)
    for name in ("betas", "gender"):
        # Facts alone: a motion is used without them, so they may be what is not read (pickled).
        with contextlib.suppress(InputError):
            arrays |= _read_arrays(path, (name,))
    betas = np.atleast_1d(arrays.get("betas", np.zeros(0))).shape[-1]
    of_file = any(name in arrays for name in RATES)
    rate = _rate(arrays, path)
    return (
        ("gender", _gender(arrays) or "not in the file"),
        ("betas", str(betas) if betas else "not in the file"),
        ("frame rate", f"{rate:g} per second" if of_file else f"not in the file, {rate:g} per second taken"),
    )


def _gender(arrays: dict[str, np.ndarray]) -> str:
    values = arrays.get("gender", np.zeros(0)).reshape(-1)[:1].tolist()
    texts = [value.decode(errors="replace") if isinstance(value, bytes) else str(value) for value in values]
    return "".join(filter(str.isprintable, "".join(texts)))[:20]


def shape_of(betas: np.ndarray | None, path: Path) -> Float[np.ndarray, " K"]:
    """Check shape coefficients, which some files repeat for every frame; None is no coefficients.

    Raises:
        InputError: they are no finite numbers, or change from frame to frame.
    """
    if betas is None:
        return np.zeros(0)
    rows = _rows(np.atleast_2d(betas), "betas", 1, path)
    if not (rows == rows[0]).all():
        raise InputError(f"{path}: expected one person in 'betas', found {len(rows)} rows that differ; split the file")
    return rows[0]


def poses_of(values: np.ndarray, name: str, path: Path) -> Float[np.ndarray, "T J 3"]:
    """Check rotation vectors of one or more frames, and give each joint a row of its own.

    Raises:
        InputError: they are no finite numbers, three for each joint.
    """
    rows = _rows(np.atleast_2d(values), name, 3, path)
    if rows.shape[1] % 3:
        raise InputError(
            f"{path}: expected three numbers for each joint in '{name}', found {rows.shape[1]} in all; save it again"
        )
    return rows.reshape(len(rows), -1, 3)


_BODY = ("pose_body", 3 * (len(JOINTS) - 1))
"""Name and width of the array of all joints but the root."""


def _read_arrays(path: Path, used: Collection[str]) -> dict[str, np.ndarray]:
    with path.open("rb") as file, open_archive(file, path) as (archive, names):
        return {name: read_array(archive, name) for name in used if name in names}


def _joints_and_path(
    arrays: dict[str, np.ndarray], path: Path
) -> tuple[Float[np.ndarray, "T J 3"], Float[np.ndarray, "T 3"]]:
    """Check rotations and path, and join the parts of a pose that are stored apart."""
    if "poses" in arrays and np.prod(arrays["poses"].shape[1:]) == BODY_ALONE:
        if "root_orient" not in arrays:
            raise InputError(
                f"{path}: expected 'poses' of the root and 21 joints or more, found {BODY_ALONE} numbers, SMPL's body "
                "without its root; save the root's rotation before them, or as 'root_orient'"
            )
        arrays = {**arrays, "pose_body": arrays["poses"]}
        del arrays["poses"]
    if "poses" in arrays:
        rotvec = _rows(arrays["poses"], "poses", 3 * len(JOINTS), path)
    else:
        for name in ("root_orient", "pose_body"):
            if name not in arrays:
                found = ", ".join(arrays) or "none of them"
                raise InputError(
                    f"{path}: expected poses, or root_orient and pose_body, found {found}; save '{name}' as well"
                )
        root, body = (_rows(arrays[name], name, n, path) for name, n in (("root_orient", 3), _BODY))
        parts = {"root_orient": root[:, :3], "pose_body": body[:, : _BODY[1]]}
        # Hands follow the body in SMPL+H; jaw and eyes come between them in SMPL-X.
        parts |= {name: _rows(arrays[name], name, n, path)[:, :n] for name, n in PARTS.items() if name in arrays}
        _check_lengths(path, {name: len(rows) for name, rows in parts.items()})
        rotvec = np.concatenate(list(parts.values()), axis=1)
    if "trans" not in arrays:
        # A path up and down alone, on which the lower foot stays at one height, in the axes of the file.
        rotmat = rotvec_to_rotmat(rotvec[:, : 3 * len(JOINTS)].reshape(len(rotvec), -1, 3))
        axes = upright(rotmat[:, 0])
        rotmat[:, 0] = axes @ rotmat[:, 0]
        posed = _assumed_body("", JOINTS, rotmat, np.zeros((len(rotmat), 3)), DEFAULT_RATE)
        names = posed.joint_names
        feet = [names.index(f"{side}_{part}") for side in ("left", "right") for part in ("ankle", "foot")]
        raised = posed.world()[1][:, feet, 1] - posed.rest()[feet, 1]
        return poses_of(rotvec, "poses", path), (np.array([0.0, 1.0, 0.0]) * -raised.min(axis=1, keepdims=True) @ axes)
    trans = _rows(arrays["trans"], "trans", 3, path)[:, :3]
    _check_lengths(path, {"trans": len(trans), "poses": len(rotvec)})
    return poses_of(rotvec, "poses", path), trans


def _check_lengths(path: Path, rows: dict[str, int]) -> None:
    (first, count), *others = rows.items()
    for name, other in others:
        if other != count:
            raise InputError(
                f"{path}: expected as many rows in '{first}' as in '{name}', found {count} and {other}; save them again"
            )


def _lacking(arrays: dict[str, np.ndarray]) -> tuple[str, ...]:
    notes = ()
    if "trans" not in arrays:
        notes += ("no 'trans': the person stays in place, with the lower foot on the ground",)
    if not any(name in arrays for name in RATES):
        notes += (f"no frame rate: {DEFAULT_RATE:g} per second are taken, {option('fps', ...)} gives another",)
    return notes


def _rows(values: np.ndarray, name: str, width: int, path: Path) -> Float[np.ndarray, "T C"]:
    """Check that an array has one row of at least `width` finite numbers per frame, and return it as (T, C)."""
    flat = values.reshape(len(values), -1) if values.ndim > 1 and len(values) else values
    if flat.ndim != 2 or len(flat) == 0 or flat.shape[1] < width or flat.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: expected '{name}' to be numbers of shape (T, {width}) or wider, found {values.dtype} "
            f"{values.shape}; save it in that shape"
        )
    FRAMES.check(len(flat), path)
    POSED_JOINTS.check(len(flat) * (flat.shape[1] // 3), path, path.stat().st_size)
    if not np.isfinite(flat).all():
        bad = int(np.flatnonzero(~np.isfinite(flat).all(axis=1))[0])
        raise InputError(
            f"{path}: expected finite numbers, found NaN or infinity in frame {bad} of '{name}'; repair that frame"
        )
    return flat.astype(np.float64)


def _rate(arrays: dict[str, np.ndarray], path: Path) -> float:
    found = next((arrays[name] for name in RATES if name in arrays), np.array(DEFAULT_RATE))
    rate = rate_of(found, RATES[0], path)
    if not 0 < rate < np.inf:
        raise InputError(f"{path}: expected a positive frame rate, found {rate!r}; save one as {RATES[0]}")
    return rate


def upright(
    pelvis: Float[np.ndarray, "T 3 3"], trans: Float[np.ndarray, "T 3"] | None = None
) -> Float[np.ndarray, "3 3"]:
    """Compute the axis rotation of a recording's world to y up.

    From z up, unless the pelvis is upright along y; or upside down, as in the axes of a camera (x right, y down, z
    ahead). Who lies along y has the pelvis close over z = 0 in all frames, and not at the height of who stands over
    y = 0.
    """
    pelvis_up = pelvis[:, :, 1].mean(axis=0)
    lies = trans is not None and _within(trans[:, 2], 0.0, LOW) and not _within(trans[:, 1], LOW, HEIGHT)
    if abs(pelvis_up[1]) > max(abs(pelvis_up[2]), 0.5) and not lies:
        return np.diag([1.0, 1.0, 1.0] if pelvis_up[1] > 0 else [1.0, -1.0, -1.0])
    return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def _within(values: Float[np.ndarray, " T"], low: float, high: float) -> bool:
    return bool(low < values.min() and values.max() < high)
