"""Read a pool of rigged characters: a folder of .npz files with an index.json, as humanoids with known limbs and clips,
or as four-legged animals.

A file has vertices, faces, skeleton, weights and a `meta` in JSON; clips are in files that characters share:
clip{n}_rotations (T, J, 4), quaternions xyzw of each joint relative to its parent, and clip{n}_translations (T, C, 3),
local translations of the joints `clip_translated`; other local translations are those at rest. Files are untrusted.
Characters are returned y up and facing +z, in the unit of their file, with each foot below its shin.
"""

from __future__ import annotations

import dataclasses
import json
import re
import zipfile
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.frame_buffer import Progress, counted
from ..core.mesh import Mesh, check_mesh
from ..core.normalization import turn as turned_about_y
from ..core.npz_archive import check_unpacked_size, open_archive, read_array
from ..core.printable import listed
from ..core.rig import homogeneous
from .animal_limbs import name_animal_joints
from .character_limbs import Limb, attach_feet, find_limbs, name_limb_joints
from .joint_names import named_fingers
from .skinned_character import SkinnedCharacter

ARRAYS = {
    "vertices": ("f", (None, 3)),
    "faces": ("iu", (None, 3)),
    "joint_names": ("U", (None,)),
    "parents": ("i", (None,)),
    "rest_matrices": ("f", (None, 4, 4)),
    "weights": ("f", (None, None)),
    "weight_joints": ("iu", (None, None)),
}
"""Arrays of a character: kinds of number as in `numpy.dtype.kind`, and shape."""
CLIP_ARRAY = re.compile(r"clip\d*_\w+")
"""Names of the arrays of clips."""
MAX_BYTES = 256 << 20
"""Largest unpacked size of a file (bytes). The largest of the known pool has 1 MB."""
RIGID = 1e-3
"""Largest deviation of a rest frame from a rotation, per entry."""
FACING = {"+z": 0.0, "-z": np.pi, "+x": -np.pi / 2, "-x": np.pi / 2, "": 0.0}
"""Rotation about y (radians) that turns a character of each facing to +z; a facing that is not known counts as +z."""
CLASSES = {"human": "humanoid", "quadruped": "quadruped", "other": "other"}
"""Shipped body -> `class` of the characters that have its joints."""
MOST_NAMED = 3
"""Files that are named with the reason why they cannot be used."""
FOOT_SAMPLES = 24
"""Number of poses of the clips, evenly spread, from which the shin of a foot is found."""


@dataclass(frozen=True)
class CharacterMeta:
    """Origin of a character."""

    file: str
    """File name without its suffix."""
    pack: str
    maker: str
    licence: str
    kind: str
    """Style: realistic, stylised, chibi, monster, ..."""
    body_class: str
    """humanoid, quadruped or other (`class` in the file)."""
    split: str
    facing: str
    """Axis that the character faces in its file, such as +z; empty if it is not known."""
    clips_from: str
    """Name of the file with its clips; empty if it has none."""


@dataclass(frozen=True, eq=False)
class CharacterClip:
    """A clip of a character: the frame of each joint relative to its parent's, in the file's order of joints."""

    rotations: Float[np.ndarray, "T J 4"]
    """Unit quaternions xyzw relative to the parent."""
    translations: Float[np.ndarray, "T J 3"]
    """Positions in the frame of the parent (for roots the world of the file), in the unit of the file."""

    def __len__(self) -> int:
        return len(self.rotations)


@dataclass(frozen=True, eq=False)
class PoolCharacter:
    """A humanoid or an animal of a pool, y up and facing +z, with its limbs and clips."""

    meta: CharacterMeta
    rig: SkinnedCharacter
    joints: dict[str, int]
    """Joint of each joint of the shipped body that the character has."""
    limbs: dict[str, Limb]
    """LeftArm, LeftForeArm, LeftUpLeg, LeftLeg, the same of the right side, Trunk and Head, as far as there are. Of
    animals none."""
    clips: dict[str, CharacterClip] = field(repr=False)
    file_parents: tuple[int, ...] = ()
    """Parents in the file's order of joints, of the clips."""
    order: Int[np.ndarray, " J"] = field(default_factory=lambda: np.zeros(0, int))
    """Index in the file of each joint of `rig`."""
    turn: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    """Rotation from the file's world to the character's."""

    @property
    def leg(self) -> float:
        """Height of the hips above the lowest vertex at rest: the unit in which figures of all sizes move."""
        return float(self.limbs["Trunk"].start[1] - self.rig.mesh.vertices[:, 1].min())

    @cached_property
    def fingers(self) -> dict[str, int]:
        """Joint of each finger joint that the character has, LeftHandThumb1 to RightHandPinky3."""
        return named_fingers(*self.rig.skeleton, self.joints)

    def clip_transforms(self, clip: str, frame: int) -> Float[np.ndarray, "K 4 4"]:
        """Compute each joint's transform from rest to a frame of a clip, for `SkinnedCharacter.skinned`."""
        return self.transforms_of_frames(clip, np.array([frame]))[0]

    def transforms_of_frames(self, clip: str, frames: Int[np.ndarray, " T"]) -> Float[np.ndarray, "T K 4 4"]:
        """Compute each joint's transform from rest to some frames of a clip; the last one is that of the world."""
        world = _world_frames(self.clips[clip], frames, self.file_parents, self.turn)[:, self.order]
        still = np.tile(np.eye(4), (len(frames), 1, 1, 1))
        return np.concatenate([world @ np.linalg.inv(self.rig.T_world_joint), still], axis=1)


@dataclass(frozen=True, eq=False)
class Pool:
    """The humanoids or animals of a split of a pool, and those that cannot be used."""

    characters: tuple[PoolCharacter, ...]
    refused: dict[str, str]
    """Reason why a file cannot be used, by the name of the file."""

    def refusals(self) -> dict[str, int]:
        """Count the files of each reason, which follows the first of their names."""
        names = defaultdict[str, list[str]](list)
        for name, reason in self.refused.items():
            names[reason].append(name)
        return {f"{listed(files, MOST_NAMED)}: {reason}": len(files) for reason, files in names.items()}


def read_pool(folder: str | Path, split: str, progress: Progress | None = None, body: str = "human") -> Pool:
    """Read the humanoids of a split, or its animals, in the order of the folder's index.json.

    A file that the index names twice, or whose own `meta` has another split, is refused: it could be in two splits.

    Args:
        body: shipped body whose joints the characters have, a key of CLASSES.

    Raises:
        InputError: no folder, or no index.json that lists characters with `file`, `class` and `split`.
    """
    folder = Path(folder)
    index = folder / "index.json"
    if not index.is_file():
        raise InputError(
            f"{folder}: expected a folder of rigged characters (.npz) with an index.json, found no index.json; "
            "give the folder that has one"
        )
    try:
        rows = json.loads(index.read_text(encoding="utf-8"))
        names = [row["file"] for row in rows if row["class"] == CLASSES[body] and row["split"] == split]
        times = Counter(row["file"] for row in rows)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            f"{index}: expected a list of characters with file, class and split, found {error!r:.80}; write it again"
        ) from error
    characters, refused, names = [], {}, list(dict.fromkeys(names))
    for name in counted(names, len(names), progress):
        path = folder / f"{_plain_name(name, index)}.npz"
        try:
            if times[name] > 1:
                raise InputError(f"{path}: expected it once in the index, found it {times[name]} times; remove rows")
            character = read_character(path, body)
            if character.meta.split != split:
                raise InputError(
                    f"{path}: expected the split {split} of the index in its meta, found "
                    f"{character.meta.split or 'none'}; write the index again"
                )
            characters.append(character)
        except InputError as error:
            refused[name] = str(error).removeprefix(f"{path}: ")
    return Pool(tuple(characters), refused)


def read_character(path: str | Path, body: str = "human") -> PoolCharacter:
    """Read a character of a pool; its clips are in the same folder.

    Args:
        body: shipped body whose joints it has, a key of CLASSES.
    """
    path = Path(path)
    arrays = read_arrays(path)
    meta = _meta(arrays.get("meta"), path, CLASSES[body])
    check_arrays(arrays, path)
    turn = facing_rotation(meta.facing)
    rig = _rig(arrays, meta, turn, path)
    file_parents = rig.parents
    clips = _clips(path.parent / _plain_name(meta.clips_from, path), arrays) if meta.clips_from else {}
    if body != "human":
        named = name_animal_joints(rig, path) if body == "quadruped" else {}
        return PoolCharacter(meta, rig, named, {}, clips, file_parents, np.arange(len(rig.parents)), turn)
    joints = name_limb_joints(rig, path)
    poses = sampled_poses(clips, rig, turn)
    rig, joints, order = attach_feet(rig, joints, poses, path)
    return PoolCharacter(meta, rig, joints, find_limbs(rig, joints, path), clips, file_parents, order, turn)


def facing_rotation(facing: str) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation about y that turns a character of a facing (a key of FACING) to +z."""
    return turned_about_y(FACING[facing]).round()


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a character or of clips from a file without unpickling; other members are not read.

    Raises:
        InputError: no file, a damaged one, or one that unpacks to more than MAX_BYTES.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a file of the pool, found none; copy the whole folder")
    with path.open("rb") as file, open_archive(file, path) as (archive, _):
        check_unpacked_size(archive, path, MAX_BYTES)
        names = {member.removesuffix(".npy") for member in archive.namelist() if member.endswith(".npy")}
        return {
            name: _read(archive, name)
            for name in sorted(names)
            if name in ARRAYS or name == "meta" or CLIP_ARRAY.fullmatch(name)
        }


read_clip_arrays = lru_cache(maxsize=32)(read_arrays)
"""Reads a file of clips, which many characters share."""


def check_arrays(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Check that arrays describe a character.

    Raises:
        InputError: an array is missing, has another shape, or values that are not finite or out of range.
    """
    for name, (kinds, shape) in ARRAYS.items():
        array = arrays.get(name)
        if array is None or array.dtype.kind not in kinds or len(array.shape) != len(shape):
            found = "none" if array is None else f"{array.dtype} {array.shape}"
            raise InputError(f"{path}: expected {name} of the pool's format, found {found}; export it again")
        if any(size not in (None, found) for size, found in zip(shape, array.shape, strict=True)):
            raise InputError(f"{path}: expected {name} of the pool's format, found {array.shape}; export it again")
    joints, rest, weights = len(arrays["parents"]), arrays["rest_matrices"].astype(float), arrays["weights"]
    lengths = {len(arrays["joint_names"]), len(rest), joints}
    if len(lengths) > 1 or arrays["weight_joints"].shape != weights.shape or len(weights) != len(arrays["vertices"]):
        raise InputError(f"{path}: expected one row a joint and one a vertex, found other counts; export it again")
    if not ((arrays["parents"] < np.arange(joints)) & (arrays["parents"] >= -1)).all():
        raise InputError(f"{path}: expected parents before their children, found another order; export it again")
    rotation = rest[:, :3, :3]
    error = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3))
    if not (error.max(initial=0) < RIGID and (np.linalg.det(rotation) > 0).all() and np.isfinite(rest).all()):
        raise InputError(f"{path}: expected rigid rest frames, found others; export it without scales")
    used = arrays["weight_joints"]
    total = weights.astype(float).sum(axis=1)
    if not (weights >= 0).all() or not (total > 0).all() or not np.isfinite(total).all():
        raise InputError(f"{path}: expected weights that sum to 1, found vertices without; bind the mesh again")
    if used.size and not (used.min() >= 0 and used.max() < joints):
        raise InputError(f"{path}: expected weights of its {joints} joints, found others; bind the mesh again")


def transferred_transforms(
    source: SkinnedCharacter, target: SkinnedCharacter, transforms: Float[np.ndarray, "K 4 4"], scale: float
) -> Float[np.ndarray, "K 4 4"]:
    """Compute a pose of `target` with the bone rotations of a pose of `source`, which has the same skeleton.

    Bone rotations are those of a joint's frame in its parent's frame. Joints keep their places in the parent's frame,
    but for what they are moved from rest in `source`, times `scale` (size of `target` over that of `source`).
    """
    posed = transforms[:-1] @ source.T_world_joint
    parents = np.array(source.parents)
    local, source_rest, target_rest = (
        local_frames(world, parents) for world in (posed, source.T_world_joint, target.T_world_joint)
    )
    frames = local.copy()
    frames[:, :3, 3] = target_rest[:, :3, 3] + scale * (local[:, :3, 3] - source_rest[:, :3, 3])
    for j, parent in enumerate(parents):  # parents come first, so theirs are in the world already
        if parent >= 0:
            frames[j] = frames[parent] @ frames[j]
    return np.concatenate([frames @ np.linalg.inv(target.T_world_joint), np.eye(4)[None]])


def _read(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    array = read_array(archive, name)
    return array.astype("=" + array.dtype.str[1:]) if array.dtype.byteorder == ">" else array


def _meta(array: np.ndarray | None, path: Path, expected: str) -> CharacterMeta:
    """Read the origin of a character of an expected class from its JSON; the name of the file is that of `path`."""
    names = [field.name for field in dataclasses.fields(CharacterMeta)]
    try:
        values: dict[str, Any] = json.loads(str(array))
        meta = CharacterMeta(
            **{
                name: str(values.get("class" if name == "body_class" else name, "")) for name in names if name != "file"
            },
            file=path.stem,
        )
    except (ValueError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: expected meta in JSON, found {error!r:.80}; export it again") from error
    if meta.body_class != expected:
        raise InputError(f"{path}: expected a {expected}, found {meta.body_class or 'no class'}; leave it out")
    if meta.facing not in FACING:
        raise InputError(f"{path}: expected a facing of {', '.join(FACING)}, found {meta.facing}; turn it y up")
    return meta


def _plain_name(name: object, path: Path) -> str:
    """Return a file name of an index or a character; it must not lead out of the folder."""
    if not isinstance(name, str) or Path(name).name != name or "\\" in name:
        raise InputError(f"{path}: expected names of files in the same folder, found {name!r:.80}; write it again")
    return name


def _rig(arrays: dict[str, np.ndarray], meta: CharacterMeta, turn: np.ndarray, path: Path) -> SkinnedCharacter:
    mesh = Mesh(arrays["vertices"].astype(np.float64) @ turn.T, arrays["faces"].astype(np.int64), name=meta.file)
    weights = arrays["weights"].astype(np.float64)
    return SkinnedCharacter(
        mesh=check_mesh(mesh, path),
        joint_names=tuple(str(name) for name in arrays["joint_names"]),
        parents=tuple(int(parent) for parent in arrays["parents"]),
        T_world_joint=homogeneous(turn, np.zeros(3)) @ arrays["rest_matrices"].astype(np.float64),
        joint_of=arrays["weight_joints"].astype(np.int64),
        weights=weights / weights.sum(axis=1, keepdims=True),
        points=np.broadcast_to(mesh.vertices[:, None], (*weights.shape, 3)),
    )


def _clips(path: Path, character: dict[str, np.ndarray]) -> dict[str, CharacterClip]:
    arrays = read_clip_arrays(path)
    count = len(character["parents"])
    rest = local_frames(character["rest_matrices"].astype(np.float64), character["parents"])[:, :3, 3]
    try:
        same = all(arrays[name].tolist() == character[name].tolist() for name in ("joint_names", "parents"))
        moved = arrays["clip_translated"].astype(np.int64)
        if moved.ndim != 1 or not ((moved >= 0) & (moved < count)).all():
            raise ValueError(f"translations of joints beyond its {count}")
        clips = {}
        for n, name in enumerate(arrays["clip_names"].tolist()):
            rotations, given = (arrays[f"clip{n}_{key}"].astype(np.float64) for key in ("rotations", "translations"))
            frames = len(rotations)
            if rotations.shape != (frames, count, 4) or given.shape != (frames, len(moved), 3):
                raise ValueError(f"clip {n} of shapes {rotations.shape} and {given.shape}")
            translations = np.tile(rest, (frames, 1, 1))
            translations[:, moved] = given
            norms = np.linalg.norm(rotations, axis=-1, keepdims=True)
            if not (norms > 0).all() or not np.isfinite(norms).all() or not np.isfinite(given).all():
                raise ValueError(f"clip {n} with values that are not finite or no rotations")
            clips[str(name)] = CharacterClip(rotations / norms, translations)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: expected clips of the pool's format, found {error!r:.80}; export it again"
        ) from error
    if not same:
        raise InputError(f"{path}: expected clips of the character's skeleton, found another; export it again")
    return {name: clip for name, clip in clips.items() if len(clip)}


def sampled_poses(
    clips: dict[str, CharacterClip], rig: SkinnedCharacter, turn: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "N J 4 4"]:
    """Compute the joints' transforms from rest in some frames of all clips, in the file's order of joints."""
    inverse = np.linalg.inv(rig.T_world_joint)
    step = max(sum(map(len, clips.values())) // FOOT_SAMPLES, 1)
    poses = [_world_frames(clip, np.arange(0, len(clip), step), rig.parents, turn) @ inverse for clip in clips.values()]
    return np.concatenate(poses) if poses else np.zeros((0, len(rig.parents), 4, 4))


def _world_frames(clip: CharacterClip, frames: Int[np.ndarray, " N"], parents, turn) -> Float[np.ndarray, "N J 4 4"]:
    """Compute the frames of all joints in the turned world, in some frames of a clip."""
    from scipy.spatial.transform import Rotation

    rotations = clip.rotations[frames]
    matrices = Rotation.from_quat(rotations.reshape(-1, 4)).as_matrix().reshape(*rotations.shape[:2], 3, 3)
    world, turned = homogeneous(matrices, clip.translations[frames]), homogeneous(turn, np.zeros(3))
    for j, parent in enumerate(parents):
        world[:, j] = (world[:, parent] if parent >= 0 else turned) @ world[:, j]
    return world


def local_frames(
    world: Float[np.ndarray, "J 4 4"], parents: tuple[int, ...] | Int[np.ndarray, " J"]
) -> Float[np.ndarray, "J 4 4"]:
    """Compute the frame of each joint in its parent's frame."""
    inverse = np.linalg.inv(world)
    return np.stack([world[j] if parent < 0 else inverse[parent] @ world[j] for j, parent in enumerate(parents)])
