"""Convert recorded parameters of a body model (AMASS archives, pickles of poses) to clips of the recorded surface.

The user has the body model as a file. Vertices are those of the model, with the recorded shape: nothing is retargeted.
Soft tissue (`dmpls`) and offsets of clothes are not added.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..bodies.sampling import rotvec_to_rotmat
from ..bodies.smpl_model import SmplModel
from ..core.budgets import check_clip_size
from ..core.errors import InputError, option
from ..core.frame_buffer import Progress, spread_exactly, store_frames
from ..core.mesh import Clip, Mesh
from ..core.npz_archive import archive_names
from ..core.pickled_arrays import array_of, read_pickle
from .amass import DEFAULT_RATE, JOINTS, BodyRecording, is_amass, load_recording, poses_of, shape_of, upright
from .motion import Motion, resample
from .smpl_joints import RecordedJoints

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
    notes = (*recording.notes, *pose_notes, *_shape_notes(recording, len(shape), model))
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


def _shape_notes(recording: BodyRecording, used: int, model: SmplModel) -> tuple[str, ...]:
    """Return notes on coefficients that are missing or not used, and on the gender that they belong to."""
    notes = ()
    if not len(recording.betas):
        notes += ("no betas: the model's mean shape is taken",)
    elif used < len(recording.betas):
        notes += (f"the first {used} of {len(recording.betas)} betas are taken: {model.name} has no more",)
    if recording.gender:
        notes += (f"recorded with the {recording.gender} model: its betas fit that model alone",)
    return notes
