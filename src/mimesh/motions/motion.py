"""Motion: joint rotations over time, and what can be done to them without a body; `motion_clip` puts one on a body.

Rotations are local (in the parent's frame) about the world's axes at rest, as `RiggedBody` has them. `root` (metres)
is added to where the root joint rests, for a body of the mean shape; y up, so y = 0 is the hip height of the T-pose.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import chain

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..core.errors import InputError
from ..core.frame_buffer import Progress, store_frames
from ..core.mesh import Clip

LEG = ("LeftUpLeg", "LeftLeg", "LeftFoot")
"""Joints whose bone lengths measure how far a body's steps carry it."""
_CHUNK = 64
"""Frames posed at once; bounds the memory of a long clip."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A body's motion at a constant frame rate; see the module for frames and units."""

    name: str
    joint_names: tuple[str, ...]
    rotmat: Float[np.ndarray, "T J 3 3"]
    root: Float[np.ndarray, "T 3"]
    fps: float = 30.0

    def __len__(self) -> int:
        return len(self.rotmat)

    @property
    def seconds(self) -> float:
        """Length of the motion: T frames last T / fps seconds."""
        return len(self.rotmat) / self.fps


def window(motion: Motion, start: float, stop: float, name: str | None = None) -> Motion:
    """The frames from `start` up to but without `stop` (seconds).

    Raises:
        InputError: the window reaches outside the motion, or holds no frame.
    """
    first, last = round(start * motion.fps), round(stop * motion.fps)
    if not 0 <= first < last <= len(motion):
        raise InputError(
            f"{motion.name}: expected a window within 0..{motion.seconds:.2f} s, found {start:g}..{stop:g} s; "
            "choose another"
        )
    return dataclasses.replace(
        motion, name=name or motion.name, rotmat=motion.rotmat[first:last], root=motion.root[first:last]
    )


def mirror(motion: Motion) -> Motion:
    """The same motion with left and right exchanged: reflected at the plane x = 0."""
    flip = np.array([-1.0, 1.0, 1.0])
    swap = [motion.joint_names.index(other_side(n, motion.joint_names)) for n in motion.joint_names]
    rotmat = motion.rotmat[:, swap] * flip[:, None] * flip
    return dataclasses.replace(motion, name=f"{motion.name}-mirrored", rotmat=rotmat, root=motion.root * flip)


def other_side(name: str, names: tuple[str, ...]) -> str:
    """The joint on the other side of the body, or the joint itself where there is none (Left/Right, or L/R)."""
    for one, two in (("Left", "Right"), ("Right", "Left"), ("L", "R"), ("R", "L")):
        if name.startswith(one) and two + name[len(one) :] in names:
            return two + name[len(one) :]
    return name


def resample(motion: Motion, fps: float) -> Motion:
    """The motion at another frame rate: rotations by slerp, the root linearly; nothing is smoothed beforehand.

    Raises:
        InputError: `fps` is not positive.
    """
    if not fps > 0:
        raise InputError(f"{motion.name}: expected a positive frame rate, found {fps:g}; give for example 30")
    last = len(motion) - 1
    # The tolerance keeps the last frame when 1/fps came from a rounded "Frame Time: .0083333".
    count = int(np.floor(last / motion.fps * fps + 1e-3)) + 1
    at = np.minimum(np.arange(count) * (motion.fps / fps), last)
    before = np.minimum(np.floor(at).astype(int), max(last - 1, 0))
    after, part = np.minimum(before + 1, last), at - before
    rotmat = slerp(motion.rotmat[before], motion.rotmat[after], part[:, None])
    root = motion.root[before] * (1 - part[:, None]) + motion.root[after] * part[:, None]
    return dataclasses.replace(motion, rotmat=rotmat, root=root, fps=float(fps))


def slerp(
    start: Float[np.ndarray, "*B J 3 3"], stop: Float[np.ndarray, "*B J 3 3"], part: Float[np.ndarray, "*B 1"]
) -> Float[np.ndarray, "*B J 3 3"]:
    """Rotations `part` (0..1) of the shortest way from `start` to `stop`."""
    from scipy.spatial.transform import Rotation

    way = Rotation.from_matrix((np.swapaxes(start, -1, -2) @ stop).reshape(-1, 3, 3)).as_rotvec()
    share = np.broadcast_to(part, start.shape[:-2]).reshape(-1, 1)
    return start @ Rotation.from_rotvec(way * share).as_matrix().reshape(start.shape)


def rotmat_to_rotvec(rotmat: Float[np.ndarray, "*B 3 3"]) -> Float[np.ndarray, "*B 3"]:
    """Rotation vectors (radians, length at most pi) of rotation matrices."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotmat.reshape(-1, 3, 3)).as_rotvec().reshape(rotmat.shape[:-1])


def leg_length(joints: Float[np.ndarray, "J 3"], joint_names: tuple[str, ...]) -> float:
    """Length from hip over knee to ankle at rest, in the unit of `joints`."""
    hip, knee, ankle = (joints[joint_names.index(n)] for n in LEG)
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def joint_tracks(
    body: RiggedBody, motion: Motion, shape: Float[np.ndarray, " K"] | None = None
) -> tuple[Float[np.ndarray, "T J 3 3"], Float[np.ndarray, "T J 3"]]:
    """World rotation and position (metres) of every joint in every frame: forward kinematics without the surface."""
    joints, root = _fitted(body, motion, shape)
    rotation, translation = body.skinning_transforms(joints, motion.rotmat, root)
    return rotation, translation + (rotation @ joints[..., None])[..., 0]


def lowest(
    body: RiggedBody, rotmat: Float[np.ndarray, "T J 3 3"], root: Float[np.ndarray, "T 3"]
) -> Float[np.ndarray, " T"]:
    """Height (metres) of the lowest vertex of the mean body in every frame."""
    chunks = _posed_chunks(body, np.zeros(0), rotmat, root)
    return np.concatenate([vertices[..., 1].min(axis=1) for vertices in chunks])


def motion_clip(
    body: RiggedBody,
    shape: Float[np.ndarray, " K"] | None,
    motion: Motion,
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
) -> Clip:
    """The body with the given shape (None: the mean) in motion: a Clip in metres.

    The root's path is scaled by the person's leg length over the mean body's. Feet are not pinned to the floor, and
    limbs that meet the body of a stout person are not pushed out. Long clips lie on disk (`paging.stored`).

    Raises:
        InputError: the motion is for another skeleton.
    """
    shape = np.zeros(0) if shape is None else shape
    _, root = _fitted(body, motion, shape)
    frames = chain.from_iterable(_posed_chunks(body, shape, motion.rotmat, root))
    vertices = store_frames(frames, len(motion), len(body.vertices), dtype, progress)
    rest = dataclasses.replace(body.mesh(body.shaped(shape)[0]), name=motion.name)
    return Clip(rest, vertices, motion.fps)


def _posed_chunks(body, shape, rotmat, root):
    """Vertices of one person in every frame, some frames at a time."""
    for t in range(0, len(rotmat), _CHUNK):
        yield body.posed(shape, rotmat[t : t + _CHUNK], root[t : t + _CHUNK])


def _fitted(body, motion, shape):
    """Rest joints of the person, and the root's path scaled to the person's legs."""
    if motion.joint_names != body.joint_names:
        raise InputError(
            f"{motion.name}: expected a motion of the {len(body.joint_names)} joints of {body.name}, "
            f"found {len(motion.joint_names)} others; retarget it first"
        )
    joints = body.shaped(np.zeros(0) if shape is None else shape)[1]
    scale = leg_length(joints, body.joint_names) / leg_length(body.joints, body.joint_names)
    return joints, motion.root * scale
