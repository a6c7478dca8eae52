"""Convert recorded parameters of a body model (AMASS archives, pickles of poses) to clips of the recorded surface.

The user has the body model as a file. Vertices are those of the model, with the recorded shape: nothing is retargeted.
Soft tissue (`dmpls`) and offsets of clothes are not added.

Files of models do not name their joints. Their order is that of the published models: 22 of the body, then the two
hands (SMPL), the fingers (SMPL+H), or jaw, eyes and fingers (SMPL-X). Models of other numbers of joints, as of animals,
have no rig.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..bodies.sampling import rotvec_to_rotmat
from ..bodies.skinned_character import SkinnedCharacter
from ..bodies.smpl_model import SmplModel
from ..core.budgets import check_clip_size
from ..core.errors import InputError, option
from ..core.frame_buffer import Progress, spread_exactly, store_frames
from ..core.mesh import Clip, Mesh
from ..core.npz_archive import archive_names
from ..core.person_motion import PersonMotion
from ..core.pickled_arrays import array_of, read_pickle
from ..core.rig import homogeneous
from .amass import (
    DEFAULT_RATE,
    FACE,
    FINGERS,
    JOINTS,
    BodyRecording,
    is_amass,
    load_recording,
    poses_of,
    shape_of,
    upright,
)
from .humanoid_rig import HumanoidRig, humanoid_rig
from .motion import Motion, resample

HANDS = 30
"""Finger joints of SMPL+H and SMPL-X: the last joints of both."""
HAND_MODELS = (52, 55)
"""Numbers of joints of SMPL+H and SMPL-X."""
HUMAN_MODELS = (len(JOINTS), 24, *HAND_MODELS)
"""Numbers of joints of body models whose first 22 joints are those of an archive; SMPL's other two are hands."""


def recorded_clip(
    path: str | Path,
    model: SmplModel,
    fps: float | None = None,
    progress: Progress | None = None,
    count: int | None = None,
    betas: Float[np.ndarray, " K"] | None = None,
) -> tuple[Clip, tuple[str, ...]]:
    """Load recorded parameters as a clip of the body model, at the file's frame rate or resampled at `fps`.

    An AMASS archive is turned to y up; frames of a pickle (`pose`, `betas`, `trans`) keep its axes. Metres if the model
    is in metres. The clip's mesh is its first frame.

    Args:
        count: number of frames, evenly spread from the first to the last, of which alone vertices are computed; 1 is
            the first one, None all.
        betas: shape coefficients of another person, who then moves like the recorded one; None: those of the file.

    Returns:
        The clip, and notes on what the model or the file lacks.

    Raises:
        InputError: the file has no poses, or its arrays are damaged or do not fit together.
    """
    path = Path(path)
    is_archive = path.suffix.lower() == ".npz" and is_amass(archive_names(path))
    if not is_archive and path.suffix.lower() != ".pkl":
        raise InputError(
            f"{path}: expected an AMASS archive (.npz with poses) or a .pkl of poses with "
            f"{option('body_model', ...)}, found "
            f"'{path.suffix}'{' without poses' * (path.suffix.lower() == '.npz')}; leave the option out"
        )
    recording = load_recording(path) if is_archive else _read_pickle(path)
    if betas is not None:
        recording = dataclasses.replace(recording, betas=betas, gender="")
    rotvec, pose_notes = fitted_pose(recording.rotvec, len(model.parents))
    shape = recording.betas[: len(model.components)]
    motion = Motion(
        path.stem, tuple(map(str, range(len(model.parents)))), rotvec_to_rotmat(rotvec), recording.trans, recording.fps
    )
    motion = motion if fps is None or len(motion) == 1 else resample(motion, fps, str(path))
    # The parameters are in the world of the file, so its axes are changed after posing.
    axes = upright(motion.rotmat[:, 0], motion.root) if is_archive else np.eye(3)
    if count is not None:
        chosen = spread_exactly(len(motion), count, path.name)
        rate = motion.fps * (count - 1) / (len(motion) - 1) if count > 1 else motion.fps
        motion = dataclasses.replace(motion, rotmat=motion.rotmat[chosen], root=motion.root[chosen], fps=rate)
    frames = (vertices @ axes.T for vertices in model.frames(shape, motion.rotmat, motion.root))
    check_clip_size(len(motion), len(model.vertices), path)
    vertices = store_frames(frames, len(motion), len(model.vertices), np.float32, progress)
    mesh = Mesh(np.asarray(vertices[0], np.float64), model.faces, path.stem, up="+y" if is_archive else None)
    headings = (axes @ motion.rotmat[:, 0])[:, :, 2] if is_archive else None
    used, notes = len(shape), (*recording.notes, *pose_notes)
    if not len(recording.betas):
        notes += ("no betas: the model's mean shape is taken",)
    elif used < len(recording.betas):
        notes += (f"the first {used} of {len(recording.betas)} betas are taken: {model.name} has no more",)
    if recording.gender:
        notes += (f"recorded with the {recording.gender} model: its betas fit that model alone",)
    # Axes of pickles are not known, so neither is where their joints face.
    skeleton = RecordedJoints(model, shape, motion.rotmat, motion.root, axes) if is_archive else None
    return Clip(mesh, vertices, motion.fps, headings, skeleton), tuple(f"{path.name}: {note}" for note in notes)


def fitted_pose(rotvec: Float[np.ndarray, "T J 3"], joints: int) -> tuple[Float[np.ndarray, "T K 3"], tuple[str, ...]]:
    """Fit poses to a model with another number of joints; joints that the poses lack stay at rest.

    Body models of people share their first 22 joints; SMPL+H and SMPL-X share the fingers, their last 30. Of other
    models the first joints are taken.

    Returns:
        The poses, and a note unless the numbers are equal.
    """
    found = rotvec.shape[1]
    if found == joints:
        return rotvec, ()
    fitted = np.zeros((len(rotvec), joints, 3))
    human = found in HUMAN_MODELS and joints in HUMAN_MODELS
    shared = len(JOINTS) if human else min(found, joints)
    fitted[:, :shared] = rotvec[:, :shared]
    fingers = human and found in HAND_MODELS and joints in HAND_MODELS
    if fingers:
        fitted[:, -HANDS:] = rotvec[:, -HANDS:]
    taken = f"the first {shared}" + " and the fingers" * fingers
    return fitted, (f"poses of {found} joints on a model of {joints}: {taken} are taken, others stay at rest",)


def _read_pickle(path: Path) -> BodyRecording:
    """Read a pickle of `pose`, `betas` and `trans`, of one frame or several, as MG-dataset's registrations are."""
    entries = read_pickle(path.read_bytes(), path)
    missing = [name for name in ("pose", "betas", "trans") if not isinstance(entries, dict) or name not in entries]
    if missing:
        raise InputError(
            f"{path}: expected the arrays pose, betas and trans, found no {missing[0]}; check that the file is a "
            f"registration, and give a body model itself without {option('body_model')}"
        )
    rotvec = poses_of(array_of(entries["pose"], "pose", path), "pose", path)
    trans = poses_of(array_of(entries["trans"], "trans", path), "trans", path)
    if trans.shape != (len(rotvec), 1, 3):
        raise InputError(
            f"{path}: expected three numbers of 'trans' for each of {len(rotvec)} poses, found {trans.size}; "
            "save them again"
        )
    return BodyRecording(
        rotvec, trans[:, 0], shape_of(array_of(entries["betas"], "betas", path), path), DEFAULT_RATE, ""
    )


_HANDS = ("left_hand", "right_hand")
NAMES = {len(names): names for names in ((*JOINTS, *more) for more in (_HANDS, FINGERS, (*FACE, *FINGERS)))}
"""Number of joints of a model of people -> their names, in order."""


MEAN = np.zeros(0)
"""Coefficients of the mean shape."""


def smpl_rig(model: SmplModel, shape: Float[np.ndarray, " K"] = MEAN) -> HumanoidRig:
    """Make the rig of a body model of a shape, in the model's axes: y up, facing +z.

    `animate` takes it as `rig` of an identity with the model's vertices.

    Raises:
        InputError: a model whose joints are not those of a person (NAMES), or have no weights.
    """
    vertices, joints = model.shaped(shape)
    count = len(joints)
    if count not in NAMES:
        known = ", ".join(map(str, NAMES))
        raise InputError(
            f"{model.name}: expected a body model of people ({known} joints), found {count} joints; give no rig"
        )
    influences = np.tile(np.arange(count), (len(vertices), 1))
    points = np.repeat(vertices[:, None], count, axis=1)
    mesh = Mesh(vertices, model.faces, model.name)
    character = SkinnedCharacter(mesh, NAMES[count], model.parents, _rest(joints), influences, model.weights, points)
    return humanoid_rig(character, np.eye(3), {}, lambda: np.zeros((0, count, 4, 4)), model.name)[0]


@dataclass(frozen=True, eq=False)
class RecordedJoints:
    """The joints of a body model in the frames of a recording (`Clip.skeleton`)."""

    model: SmplModel
    shape: Float[np.ndarray, " K"]
    rotmat: Float[np.ndarray, "T J 3 3"]
    """Rotation of each joint in its parent's frame; of the root in the world of the file."""
    root: Float[np.ndarray, "T 3"]
    """Translation of the body in the world of the file."""
    axes: Float[np.ndarray, "3 3"]
    """Rotation from the axes of the file to those of the clip: y up."""

    @property
    def has_joints(self) -> bool:
        """Whether the model is one of people, whose joints are known."""
        return len(self.model.parents) in NAMES

    def cut(self, frames: slice) -> RecordedJoints:
        """Select frames of the clip."""
        return replace(self, rotmat=self.rotmat[frames], root=self.root[frames])

    def person(self) -> PersonMotion:
        """Compute the joints of the person."""
        rig = smpl_rig(self.model, self.shape)
        joints = self.model.shaped(self.shape)[1]
        rotation, translation = self.model.skinning_transforms(joints, self.rotmat, self.root)
        positions = (rotation @ joints[..., None])[..., 0] + translation
        world = homogeneous(self.axes @ rotation, positions @ self.axes.T)
        place = {name: j for j, name in enumerate(NAMES[len(joints)])}
        chosen = [place[rig.character.joint_names[rig.joints[name]]] for name in rig.person]
        return rig.motion(world[:, chosen], _rest(joints)[chosen])


def _rest(joints: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 4 4"]:
    return homogeneous(np.tile(np.eye(3), (len(joints), 1, 1)), joints)
