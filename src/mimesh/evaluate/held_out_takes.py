"""Whole motions that no training may use, read from a folder: 10 seconds of a boxing capture and 20 animated clips.

The capture is `Boxing_Toes.bvh` of the Debian package assimp-testmodels: one take of 31 s by a person and with a
skeleton that no other data here have. Its origin is not documented, so it is read and not shipped. The clips are by an
animator, not captured: KayKit Character Animations by Kay Lousberg (CC0). Both were chosen by their names and length
before any method was measured on them.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ..core.errors import InputError
from ..io.gltf.document import open_document
from ..io.gltf.motion import read_skeleton
from ..motions import Motion, load_bvh, resample, retarget
from ..motions.deepmimic import folder_with
from .pairs import human

BOXING_FILE = "Boxing_Toes.bvh"
BOXING_SECONDS = tuple(range(0, 20, 2))
"""Start (s) of each second of the capture. After 22 s the boxer is knocked out and lies, which no other second has."""
ANIMATED = {
    "Med_MovementBasic.glb": (
        *("Walking_A", "Walking_B", "Walking_C", "Running_A", "Running_B", "Jump_Full_Long", "Jump_Full_Short"),
    ),
    "Med_MovementAdvanced.glb": ("Walking_Backwards", "Running_Strafe_Left", "Running_HoldingRifle", "Sneaking"),
    "Med_CombatMelee.glb": (
        *("Melee_1H_Attack_Chop", "Melee_1H_Attack_Slice_Horizontal", "Melee_1H_Attack_Stab"),
        *("Melee_Unarmed_Attack_Punch_A", "Melee_Unarmed_Attack_Kick"),
    ),
    "Med_CombatRanged.glb": ("Ranged_Bow_Draw",),
    "Med_General.glb": ("PickUp", "Throw"),
    "Med_Simulation.glb": ("Waving",),
}
"""The 20 animated clips, by file."""
FAMILIES = (
    *("Walking_", "Skeletons_Walking", "Running_", "Jump_", "Sneaking", "Melee_1H_", "Melee_Unarmed_", "Ranged_Bow_"),
    *("PickUp", "Throw", "Waving"),
)
"""Beginnings of the names of the 20 clips and of all their variants, parts and mirror images in the 110 clips."""
SHIPPED_CAPTURES = ("01_01.", "01_03.")
"""Beginnings of the names of the CMU captures of the shipped takes, whose later seconds are `val` and `test`."""
PACKAGES = f"{BOXING_FILE} is in the Debian package assimp-testmodels, Med_*.glb are KayKit Character Animations (CC0)"
TAKES = (
    *((file, clip) for file, clips in ANIMATED.items() for clip in clips),
    *((BOXING_FILE, str(start)) for start in BOXING_SECONDS),
)
"""File, and name of the clip or start (s) of the second, of each of the 30 motions."""
ORDER = tuple(k for n in range(10) for k in (2 * n, 2 * n + 1, 20 + n))
"""Order of the trials: two animated clips, then one captured second, so that the first few trials have both."""


def is_held_out(clip: str) -> bool:
    """Tell whether training must leave out a KayKit clip: one of the 20 or a variant ("Rig_Medium|Jump_Land")."""
    return clip.rpartition("|")[2].startswith(FAMILIES)


def is_held_out_file(name: str) -> bool:
    """Tell whether training must leave out a motion file: the boxing capture, or a capture whose end is tested on."""
    return name == BOXING_FILE or name.startswith(SHIPPED_CAPTURES)


def find_takes(folder: Path | None) -> dict[str, Path]:
    """Find the files of the held-out motions in a folder or its subfolders, two levels deep, by name.

    Raises:
        InputError: no folder, or a file is missing.
    """
    if folder is None:
        raise InputError(f"held-out motions: expected a folder, found none; give it with --data: {PACKAGES}")
    found = {name: folder_with(folder, (name,)) for name in (BOXING_FILE, *ANIMATED)}
    missing = [name for name, path in found.items() if path is None]
    if missing:
        raise InputError(
            f"{folder}: expected the files of the held-out motions in it or its subfolders, found no {missing[0]}"
            f"{f' and {len(missing) - 1} others' if missing[1:] else ''}; copy them there: {PACKAGES}"
        )
    return {name: path / name for name, path in found.items() if path is not None}


@cache
def load_take(folder: Path, number: int) -> Motion:
    """Load motion `number` of TAKES, retargeted to the shipped body: a whole animated clip, or a second of the capture.

    Raises:
        InputError: as `find_takes`, or a damaged file.
    """
    file, name = TAKES[number]
    path = find_takes(folder)[file]
    if file == BOXING_FILE:
        take, start = _boxing(path), round(int(name) * 30)
        return Motion(
            f"boxing@{name}", take.joint_names, take.rotmat[start : start + 30], take.root[start : start + 30]
        )
    return retarget(read_skeleton(open_document(path), 30.0, name), human(), name)


@cache
def _boxing(path: Path) -> Motion:
    return resample(retarget(load_bvh(path), human(), "boxing"), 30.0)
