"""Motion: joint rotations over time, operations on them, and clips of a body in motion.

Rotations are local (in the parent's frame) and about the world's axes at rest, as in `RiggedBody`. `root` (metres) is
the displacement of the root joint from rest for the mean shape; y is up, so y = 0 is the hip height of the T-pose.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import chain

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.anatomy import anatomy_of_joints
from ..bodies.joint_names import other_side
from ..bodies.sampling import rotvec_to_rotmat
from ..core.animated_rig import frames_around
from ..core.arguments import check_rate
from ..core.budgets import FRAMES, LARGEST_PRINTED
from ..core.errors import InputError
from ..core.frame_buffer import store_frames
from ..core.geometry import MIRROR, mirrored_rotations, slerp
from ..core.mesh import Clip, check_cut

_SIDE_BONES = {"UpLeg": "Leg", "Leg": "Foot", "Arm": "ForeArm", "ForeArm": "Hand"}
BONES = {f"{side}{bone}": f"{side}{tail}" for side in ("Left", "Right") for bone, tail in _SIDE_BONES.items()}
"""Limb joints and the joint at the other end of their bone. Directions of these bones are kept exactly."""
LEG = ("LeftUpLeg", "LeftLeg", "LeftFoot")
"""Joints of the leg whose length scales the root's path from one body to another."""
_CHUNK = 64
"""Frames posed at once, which bounds the memory for a long clip."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint rotations and root path at a constant frame rate; see the module for frames and units."""

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
    """Select the frames with start <= t < stop (seconds).

    Raises:
        InputError: the window extends outside the motion, or contains no frame.
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


def cut_motion(motion: Motion, frames: slice) -> Motion:
    """Select frames by their numbers; the frame rate is divided by the step, as in `core.mesh.cut_clip`."""
    check_cut(motion.name, len(motion), frames)
    rate = motion.fps / (frames.step or 1)
    return dataclasses.replace(motion, rotmat=motion.rotmat[frames], root=motion.root[frames], fps=rate)


def mirror(motion: Motion) -> Motion:
    """Reflect a motion at the plane x = 0, which exchanges left and right."""
    index = {name: j for j, name in enumerate(motion.joint_names)}
    swap = [index.get(other_side(name), j) for name, j in index.items()]
    rotmat = mirrored_rotations(motion.rotmat[:, swap])
    return dataclasses.replace(motion, name=f"{motion.name}-mirrored", rotmat=rotmat, root=motion.root * MIRROR)


def resample(motion: Motion, fps: float, source: str | None = None) -> Motion:
    """Sample a motion at another frame rate: rotations by slerp, the root linearly, without a low-pass filter.

    Args:
        source: the file that errors name; by default the motion's name.

    Raises:
        InputError: `fps` is not positive, or there would be too many frames.
    """
    source = source or motion.name
    check_rate(fps, source, "give for example 30")
    FRAMES.check(int(min(len(motion) / motion.fps * fps, LARGEST_PRINTED)), source)
    before, after, fraction = frames_around(len(motion), motion.fps, fps)
    rotmat = slerp(motion.rotmat[before], motion.rotmat[after], fraction[:, None])
    root = motion.root[before] * (1 - fraction[:, None]) + motion.root[after] * fraction[:, None]
    return dataclasses.replace(motion, rotmat=rotmat, root=root, fps=float(fps))


def rotmat_to_rotvec(rotmat: Float[np.ndarray, "*B 3 3"]) -> Float[np.ndarray, "*B 3"]:
    """Convert rotation matrices to rotation vectors (radians, length at most pi)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotmat.reshape(-1, 3, 3)).as_rotvec().reshape(rotmat.shape[:-1])


def turned_to_front(rotmat: Float[np.ndarray, "N J 3 3"]) -> Float[np.ndarray, "N J 3 3"]:
    """Turn poses about the vertical so that the front of the hips, projected to the ground, is +z; tilts are kept."""
    # The third column of the root's rotation is where its front (+z at rest) points.
    front = rotmat[:, 0, :, 2]
    turn = np.zeros((len(rotmat), 3))
    turn[:, 1] = -np.arctan2(front[:, 0], front[:, 2])
    turned = rotmat.copy()
    turned[:, 0] = rotvec_to_rotmat(turn) @ rotmat[:, 0]
    return turned


def leg_length(joints: Float[np.ndarray, "J 3"], joint_names: tuple[str, ...]) -> float:
    """Measure the length of the left leg, hip to knee to ankle, at rest (of animals of the foreleg)."""
    hip, knee, ankle = (joints[joint_names.index(n)] for n in anatomy_of_joints(joint_names).legs[0])
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def joint_tracks(
    body: RiggedBody, motion: Motion, shape: Float[np.ndarray, " K"] | None = None
) -> tuple[Float[np.ndarray, "T J 3 3"], Float[np.ndarray, "T J 3"]]:
    """Compute world rotation and position (metres) of every joint in every frame, without the surface.

    `shape` are the shape coefficients of the person; None is the mean.
    """
    joints, root = _joints_and_path(body, motion, shape)
    rotation, translation = body.skinning_transforms(joints, motion.rotmat, root)
    return rotation, translation + (rotation @ joints[..., None])[..., 0]


def lowest(
    body: RiggedBody, rotmat: Float[np.ndarray, "T J 3 3"], root: Float[np.ndarray, "T 3"]
) -> Float[np.ndarray, " T"]:
    """Compute the height (metres) of the lowest vertex of the mean shape in every frame."""
    # A height is linear in the second rows of the joints' maps: one matrix product instead of posing, 10 times faster.
    points = np.concatenate([body.vertices, np.ones((len(body.vertices), 1))], axis=1)
    weighted = (body.weights[:, :, None] * points[:, None]).reshape(len(points), -1)
    rotation, translation = body.skinning_transforms(body.joints, rotmat, root)
    rows = np.concatenate([rotation[..., 1, :], translation[..., 1, None]], axis=-1).reshape(len(rotmat), -1)
    return np.concatenate([(rows[t : t + _CHUNK] @ weighted.T).min(axis=1) for t in range(0, len(rows), _CHUNK)])


def motion_clip(body: RiggedBody, shape: Float[np.ndarray, " K"] | None, motion: Motion) -> Clip:
    """Make a clip (metres) of a body with the given shape (None: the mean) in motion.

    The root's path is scaled by the ratio of the person's leg length to the mean shape's. Foot contacts are not
    enforced, and intersections of limbs with the body are not resolved. The frames of long clips are stored on disk
    (`core.frame_buffer`).
    """
    shape = np.zeros(0) if shape is None else shape
    _, root = _joints_and_path(body, motion, shape)
    chunks = (slice(t, t + _CHUNK) for t in range(0, len(motion), _CHUNK))
    frames = chain.from_iterable(body.posed(shape, motion.rotmat[chunk], root[chunk]) for chunk in chunks)
    vertices = store_frames(frames, len(motion), len(body.vertices))
    rest = dataclasses.replace(body.mesh(body.shaped(shape)[0]), name=motion.name)
    return Clip(rest, vertices, motion.fps)


def _joints_and_path(body, motion, shape):
    """Compute the joints of the person at rest, and the root's path scaled to the person's legs."""
    if motion.joint_names != body.joint_names:
        raise InputError(
            f"{motion.name}: expected a motion of the {len(body.joint_names)} joints of {body.name}, "
            f"found {len(motion.joint_names)} others; retarget it first"
        )
    joints = body.shaped(np.zeros(0) if shape is None else shape)[1]
    scale = leg_length(joints, body.joint_names) / leg_length(body.joints, body.joint_names)
    return joints, motion.root * scale
