"""Reads a folder of motions of any maker as poses to train on: .glb, .gltf, .vrm and .fbx animations, .bvh, AMASS.

Each clip is retargeted to the shipped body (`motions.retarget`), so limbs keep their directions and the root its tilt,
as in crawls and rolls; headings are turned to +z. Mirror images are added. The captures whose later seconds are tested
on are left out by name (`SHIPPED_CAPTURES`); measure on nothing else that is in the folder.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...bodies import RiggedBody, load_body
from ...bodies.character_limbs import SIDES
from ...core.errors import InputError
from ...core.frame_buffer import Progress, counted
from ...evaluate.character_folder import DAMAGED, licence_of, pack_of
from ...io.formats import JOINTED
from ...io.gltf.animation import animation_names
from ...io.gltf.character import NOT_STATED
from ...io.gltf.document import open_document
from ...io.gltf.motion import read_skeleton
from ...io.gltf.vrm import read_origin
from ...motions import Motion, mirror, resample
from ...motions.motion import rotmat_to_rotvec, turned_to_front
from ...motions.on_body import is_motion_file, motion_of_file
from ...motions.retarget import retarget_skeleton

FPS = 15.0
"""Frames a second of which poses are taken."""
LEAST_TURN = np.radians(10)
"""A pose is taken if a joint has turned by so much (radians) since the last one taken: clips rest for seconds."""
LARGEST_TURNS = {
    ("Spine1", "Head"): 100,
    ("Hips", "Spine1"): 110,
    **{(f"{side}Leg", f"{side}Foot"): 90 for side in SIDES},
    **{("Hips", f"{side}UpLeg"): 150 for side in SIDES},
}
"""Largest angle (degrees) of a joint to one above it. Poses beyond are left out: skeletons that fall apart, heads that
come off. Other clips and captures reach 88, 73, 82 and 126."""
SHIPPED_CAPTURES = ("01_01.", "01_03.")
"""Beginnings of the names of the CMU captures of the shipped takes, whose later seconds are `val` and `test`."""
HELD_OUT = "held out for evaluation"
IMPOSSIBLE = "no pose that a person can take"


@dataclass(frozen=True, eq=False)
class TrainingClips:
    """Poses of the clips of a folder."""

    poses: Float[np.ndarray, "P J 3"]
    """Rotation vectors of the shipped body's joints."""
    facts: dict[str, Any]
    """For cards: `makers`, the number of clips of each "maker: folder (licence)", `poses`, and their `sha256`."""
    refused: dict[str, str]
    """Reason why a clip or a file cannot be used, by name."""

    def described(self) -> str:
        """Say in words whose the clips are and how many cannot be used."""
        used = ", ".join(f"{count} clips of {maker}" for maker, count in self.facts["makers"].items())
        refused = "; ".join(f"{count} refused: {reason}" for reason, count in Counter(self.refused.values()).items())
        return f"{used}: {len(self.poses)} poses{'; ' if refused else ''}{refused}"

    @classmethod
    def read(cls, folder: str | Path, body: RiggedBody, progress: Progress | None = None) -> TrainingClips:
        """Read the clips of a folder and its sub-folders.

        Raises:
            InputError: no clip that can be used.
        """
        folder = Path(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file() and _is_motion(path))
        poses, makers, refused = [], Counter[str](), dict[str, str]()
        for path in counted(paths, len(paths), progress):
            try:
                maker, stated = read_origin(open_document(path)) if path.suffix.lower() in JOINTED else ("", "")
                stated = stated or licence_of(path, folder) or NOT_STATED
                maker = f"{maker or NOT_STATED}: {pack_of(path, folder)} ({stated})"
                for name, motion in _motions(path, body):
                    if isinstance(motion, InputError):
                        refused[f"{path.relative_to(folder)}, {name}"] = _plain(motion, path, name)
                    elif len(taken := distinct_poses(motion)):
                        poses += [taken, distinct_poses(mirror(motion))]
                        makers[maker] += 1
                    else:
                        refused[f"{path.relative_to(folder)}, {name}"] = IMPOSSIBLE
            except DAMAGED as error:
                refused[str(path.relative_to(folder))] = _plain(error, path, "")
        if not poses:
            reason = f"; {next(iter(refused.values()))}" if refused else ""
            raise InputError(
                f"{folder}: expected clips of people (.glb, .gltf, .vrm, .fbx, .bvh or AMASS .npz), found none "
                f"that can be used{reason}; give a folder that has some"
            )
        taken = rotmat_to_rotvec(turned_to_front(np.concatenate(poses)))
        digest = hashlib.sha256(taken.round(4).tobytes()).hexdigest()
        return cls(taken, {"makers": dict(makers), "poses": len(taken), "sha256": digest}, refused)


def distinct_poses(motion: Motion) -> Float[np.ndarray, "P J 3 3"]:
    """Select poses of a motion that a person can take and that differ from the one before by LEAST_TURN in a joint."""
    poses = resample(motion, FPS).rotmat if motion.fps > FPS else motion.rotmat
    poses = poses[possible(poses, motion.joint_names)]
    taken: Bool[np.ndarray, " T"] = np.zeros(len(poses), bool)
    last = None
    for t, pose in enumerate(poses):
        # The trace of A^T B is 1 + 2 cos(angle) for rotations A and B.
        if last is None or ((np.einsum("jab,jab->j", last, pose) - 1) / 2).min() < np.cos(LEAST_TURN):
            taken[t], last = True, pose
    return poses[taken]


def possible(poses: Float[np.ndarray, "T B 3 3"], names: tuple[str, ...]) -> Bool[np.ndarray, " T"]:
    """Select the poses of the shipped body whose joints stay within LARGEST_TURNS."""
    parents = load_body().parents
    within = np.ones(len(poses), bool)
    for (upper, lower), largest in LARGEST_TURNS.items():
        relative, joint, stop = np.tile(np.eye(3), (len(poses), 1, 1)), names.index(lower), names.index(upper)
        while joint != stop:
            relative, joint = poses[:, joint] @ relative, parents[joint]
        within &= (np.trace(relative, axis1=1, axis2=2) - 1) / 2 > np.cos(np.radians(largest))
    return within


def _motions(path: Path, body: RiggedBody) -> Iterator[tuple[str, Motion | InputError]]:
    """Iterate over the names and motions of a file, with an error in place of a motion that cannot be used."""
    if path.name.startswith(SHIPPED_CAPTURES):
        yield path.name, InputError(HELD_OUT)
    elif path.suffix.lower() not in JOINTED:
        yield path.name, motion_of_file(path)
    else:
        document = open_document(path)
        for name in animation_names(document):
            try:
                yield name, retarget_skeleton(read_skeleton(document, FPS, name), body, name, grounded=False)
            except InputError as error:
                yield name, error


def _is_motion(path: Path) -> bool:
    try:
        return path.suffix.lower() in JOINTED or is_motion_file(path)
    except DAMAGED:
        return False


def _plain(error: BaseException, path: Path, name: str) -> str:
    """Say what is wrong without naming the file or the clip, so that equal reasons are counted together."""
    text = str(error) if isinstance(error, InputError) else f"expected a sound file, found {error!r:.80}"
    return text.removeprefix(f"{path}: ").removeprefix(f"{name}: ")
