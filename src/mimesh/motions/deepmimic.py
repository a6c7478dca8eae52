"""Read DeepMimic motion files (JSON, 44 numbers per frame) and retarget them; pybullet contains 20 human clips.

A frame has its duration (s), the root's position (m) and quaternion, then one quaternion or hinge angle (radians) per
joint. Quaternions are w x y z; axes are x front, y up, z right; at rest all limbs point straight down. The authors do
not document whose motions they are, so the clips are read where a user has installed them, not shipped and not used for
training.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.sampling import rotvec_to_rotmat
from ..core.errors import InputError
from ..core.geometry import slerp
from .bvh import Bvh
from .motion import Motion, leg_length, rotmat_to_rotvec
from .retarget import retarget

NUMBERS = 44
"""Length of a frame of the humanoid; frames of the package's four-legged robot have 20 numbers."""
_HUMANOID = (
    "backflip cartwheel crawl dance_a dance_b getup_facedown getup_faceup jump kick punch roll run spin spinkick"
)
_WALKER = "0walk_forward turn_left0 turn_left1 turn_right0 turn_right1"
CLIPS = {
    **{name: f"humanoid3d_{name}.txt" for name in (*_HUMANOID.split(), "walk")},
    **{name.lstrip("0"): f"walker/{name}.txt" for name in _WALKER.split()},
}
"""Files of the 20 human clips of pybullet_data 3.2.7, by name."""
SOLE = 0.05
"""Height of the ankle above the sole (m), from the foot's box in the character file that comes with the clips."""
INSTALL = "pip install 'mimesh[motions]', or unpack the wheel of pip download pybullet==3.2.7 --no-deps"


class _Joint(NamedTuple):
    """A joint of the skeleton, named as in the shipped body, and the numbers of a frame that define its rotation."""

    name: str
    parent: str
    offset: tuple[float, float, float]
    """Position in the parent's frame at rest (m)."""
    numbers: slice | None
    """A quaternion or a hinge angle; None for a joint that is not rotated."""
    fraction: float = 1.0
    """Fraction of that rotation which the joint gets; the rest belongs to other joints."""


def _side(side: str, z: float, hip: int, shoulder: int) -> tuple[_Joint, ...]:
    """List the joints of a leg and an arm; z is +1 for the right side, `hip` and `shoulder` index their quaternions."""
    return (
        _Joint(f"{side}UpLeg", "Hips", (0.0, 0.0, 0.084887 * z), slice(hip, hip + 4)),
        _Joint(f"{side}Leg", f"{side}UpLeg", (0.0, -0.421546, 0.0), slice(hip + 4, hip + 5)),
        _Joint(f"{side}Foot", f"{side}Leg", (0.0, -0.40987, 0.0), slice(hip + 5, hip + 9)),
        _Joint(f"{side}Arm", "Spine1", (-0.02405, 0.2435, 0.18311 * z), slice(shoulder, shoulder + 4)),
        _Joint(f"{side}ForeArm", f"{side}Arm", (0.0, -0.274788, 0.0), slice(shoulder + 4, shoulder + 5)),
        _Joint(f"{side}Hand", f"{side}ForeArm", (0.0, -0.258947, 0.0), None),
    )


# DeepMimic has one joint for the trunk and one for the neck. Three joints of ours share each of these rotations.
_JOINTS = (
    _Joint("Hips", "", (0.0, 0.0, 0.0), slice(4, 8)),
    _Joint("LowerBack", "Hips", (0.0, 0.236151, 0.0), slice(8, 12), 1 / 3),
    _Joint("Spine", "LowerBack", (0.0, 0.0, 0.0), slice(8, 12), 1 / 3),
    _Joint("Spine1", "Spine", (0.0, 0.0, 0.0), slice(8, 12), 1 / 3),
    _Joint("Neck", "Spine1", (0.0, 0.223894, 0.0), slice(12, 16), 1 / 3),
    _Joint("Neck1", "Neck", (0.0, 0.0, 0.0), slice(12, 16), 1 / 3),
    _Joint("Head", "Neck1", (0.0, 0.0, 0.0), slice(12, 16), 1 / 3),
    *_side("Right", 1.0, 16, 25),
    *_side("Left", -1.0, 30, 39),
)


def folder_with(folder: Path, files: Iterable[str]) -> Path | None:
    """Find the first folder that has all files: `folder`, its subfolders, then theirs; None if there is none."""
    # Two levels cover a folder of unpacked packages; more would take long in a home folder.
    places = (folder, *sorted(folder.glob("*/")), *sorted(folder.glob("*/*/")))
    return next((place for place in places if all((place / file).is_file() for file in files)), None)


def deepmimic_folder(folder: Path | None = None) -> Path:
    """Find the folder with the 20 clips: `folder`, a subfolder of it, or that of an installed pybullet.

    Raises:
        InputError: a clip is missing there, or no folder is given and pybullet is not installed.
    """
    if folder is None:
        found = importlib.util.find_spec("pybullet_data")  # finds it without importing it
        if found is None or not found.submodule_search_locations:
            raise InputError(f"DeepMimic clips: expected a folder or an installed pybullet, found neither; {INSTALL}")
        folder = Path(found.submodule_search_locations[0]) / "data" / "motions"
    folder = folder_with(folder, CLIPS.values()) or folder
    missing = [file for file in CLIPS.values() if not (folder / file).is_file()]
    if missing:
        raise InputError(
            f"{folder}: expected the {len(CLIPS)} human clips of pybullet_data/data/motions, found no {missing[0]}"
            f"{f' and {len(missing) - 1} others' if missing[1:] else ''}; {INSTALL}"
        )
    return folder


def load_deepmimic(path: str | Path, body: RiggedBody, name: str | None = None) -> Motion:
    """Load a DeepMimic file and retarget it to `body`, at the file's frame rate; see `retarget`.

    The floor is that of the file: the hips' height above it is kept, in leg lengths. A person who lies on the floor may
    sink into it a little, because bodies differ in thickness.

    Raises:
        InputError: as `read_deepmimic`.
    """
    source = read_deepmimic(path)
    motion = retarget(source, body, name)
    scale = leg_length(body.joints, body.joint_names) / leg_length(source.rest(), source.joint_names)
    # Height of the hips above the soles of a straight leg.
    legs = -source.rest()[source.joint_names.index("LeftFoot"), 1] + SOLE
    root = motion.root.copy()
    root[:, 1] = (source.root[:, 1] - legs) * scale
    return dataclasses.replace(motion, root=root)


def read_deepmimic(path: str | Path) -> Bvh:
    """Read a DeepMimic file as a skeleton with the shipped body's joint names, in the file's axes (metres).

    Raises:
        InputError: the file does not exist or is not a DeepMimic file, or its frames are not a human's, are not finite,
            have no duration or contain quaternions that are no rotations.
    """
    path = Path(path)
    rows = _read_rows(path)
    names = tuple(joint.name for joint in _JOINTS)
    parents = tuple(names.index(joint.parent) if joint.parent else -1 for joint in _JOINTS)
    offsets = np.array([joint.offset for joint in _JOINTS])
    rotmat = np.stack([_local_rotations(joint, rows, path) for joint in _JOINTS], axis=1)
    rotmat, root, fps = _at_constant_rate(rows[:-1, 0], rotmat, rows[:, 1:4])
    return Bvh(path.stem, names, parents, offsets, {}, rotmat, root, fps)


def _read_rows(path: Path) -> Float[np.ndarray, "T 44"]:
    """Read and check the frames of a file."""
    if not path.is_file():
        raise InputError(f"{path}: expected a DeepMimic motion file, found none; check the name")
    try:
        data = json.loads(path.read_bytes())
        rows = data["Frames"]
        counts = {len(row) for row in rows}
        values = np.array(rows, float) if len(counts) == 1 else np.zeros(0)
    except (ValueError, KeyError, TypeError):
        raise InputError(
            f'{path}: expected DeepMimic JSON with "Frames", lists of {NUMBERS} numbers, found something else; '
            "copy the file again"
        ) from None
    if counts != {NUMBERS} or len(rows) < 2:
        sizes = " or ".join(map(str, sorted(counts))) or "no"
        raise InputError(
            f"{path}: expected two frames or more of {NUMBERS} numbers, a person's, found {len(rows)} frames of "
            f"{sizes}; choose another clip"
        )
    if not np.isfinite(values).all():
        bad = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise InputError(f"{path}: expected finite numbers, found NaN or infinity in frame {bad}; copy the file again")
    if not (values[:-1, 0] > 0).all():  # the duration of the last frame is 0 in some files
        bad = int(np.flatnonzero(values[:-1, 0] <= 0)[0])
        raise InputError(
            f"{path}: expected frames that last, found {values[bad, 0]:g} s for frame {bad}; delete that frame"
        )
    return values


def _local_rotations(joint: _Joint, rows: Float[np.ndarray, "T 44"], path: Path) -> Float[np.ndarray, "T 3 3"]:
    """Compute the local rotations of a joint, in the file's axes."""
    from scipy.spatial.transform import Rotation

    if joint.numbers is None:
        return np.tile(np.eye(3), (len(rows), 1, 1))
    numbers = rows[:, joint.numbers]
    if numbers.shape[1] == 1:
        return rotvec_to_rotmat(numbers * [0.0, 0.0, 1.0])
    length = np.linalg.norm(numbers, axis=1)
    if np.abs(length - 1).max() > 0.5:  # some quaternions of the package are 12 % off, because they were interpolated
        worst = int(np.abs(length - 1).argmax())
        raise InputError(
            f"{path}: expected quaternions of about unit length, found {length[worst]:.3g} in frame {worst} "
            f"({joint.name}); copy the file again"
        )
    rotmat = Rotation.from_quat(numbers[:, [1, 2, 3, 0]]).as_matrix()
    return rotmat if joint.fraction == 1.0 else rotvec_to_rotmat(joint.fraction * rotmat_to_rotvec(rotmat))


def _at_constant_rate(
    seconds: Float[np.ndarray, " N"], rotmat: Float[np.ndarray, "T J 3 3"], root: Float[np.ndarray, "T 3"]
) -> tuple[Float[np.ndarray, "S J 3 3"], Float[np.ndarray, "S 3"], float]:
    """Resample frames of given durations at a constant rate, that of the median duration; rotations by slerp."""
    duration = float(np.median(seconds))
    if np.abs(seconds - duration).max() < 0.01 * duration:
        return rotmat, root, 1.0 / duration
    # Start time of every frame, and the frame before each output time.
    times = np.concatenate([[0.0], np.cumsum(seconds)])
    at = np.arange(int(np.floor(times[-1] / duration + 1e-3)) + 1) * duration
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(seconds) - 1)
    fraction = ((at - times[before]) / seconds[before])[:, None]
    return (
        slerp(rotmat[before], rotmat[before + 1], fraction),
        root[before] + fraction * (root[before + 1] - root[before]),
        1.0 / duration,
    )
