"""Read and check BVH motion capture files with any hierarchy and channel order.

Axes, unit and joint names are those of the file; `retarget_skeleton` transfers the motion to a body.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..bodies.sampling import rotvec_to_rotmat
from ..core.budgets import DEPTH, FRAMES, JOINTS, POSED_JOINTS
from ..core.errors import InputError
from ..core.printable import listed

MOTION = re.compile(r"(?:\}\s*|^[ \t]*)(?P<word>MOTION)(?!\S)", re.MULTILINE)
"""The word between hierarchy and frames, which may be part of joints' names, too."""
OFFSETS, MINUS = re.compile(r"OFFSET\s+[-+.\d][^\n}]*"), re.compile(r"(?<=[\d.])-(?=[\d.])")
"""Numbers of offsets; a minus without a blank before it, as exporters with columns of fixed width write it."""
ABSENT = 0.01
"""Lengths of a bone from the OFFSET up to which position channels are taken for 0."""
SCALED = 1e-3
"""Relative change of size from which on a joint is scaled."""
SHOWN_JOINTS = 4
"""Number of joints that a note names."""
SHORTEST, LONGEST = 1e-6, 3600.0
"""Frame times (seconds) between which a file is not damaged."""


@dataclass(frozen=True, eq=False)
class Bvh:
    """A skeleton and its motion, in the axes and unit of the file."""

    name: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root; parents come before their children."""
    offsets: Float[np.ndarray, "J 3"]
    """Position of each joint in its parent's frame. At rest all frames are parallel, so these are the bones at rest."""
    ends: dict[str, Float[np.ndarray, "3"]]
    """Offset of the End Site of each joint that has one."""
    rotmat: Float[np.ndarray, "T J 3 3"]
    """Rotation of each joint in its parent's frame."""
    root: Float[np.ndarray, "T 3"]
    """Position of the root joint."""
    fps: float
    moved: dict[int, Float[np.ndarray, "T 3"]] = field(default_factory=dict)
    """Positions in the parent's frame of other joints that are translated; they replace the offset."""
    notes: tuple[str, ...] = ()
    """What was wrong with the file and how it was read, one line each."""

    def rest(self) -> Float[np.ndarray, "J 3"]:
        """Compute joint positions at rest, with the root at the origin."""
        positions = np.zeros_like(self.offsets)
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                positions[j] = positions[parent] + self.offsets[j]
        return positions

    def world(self) -> tuple[Float[np.ndarray, "T J 3 3"], Float[np.ndarray, "T J 3"]]:
        """Compute world rotation and position of every joint in every frame (forward kinematics).

        Not `core.skinning.skinning_transforms`: bones may change their length over time (`moved`).
        """
        rotation, position = self.rotmat.copy(), np.empty(self.rotmat.shape[:-1])
        position[:, 0] = self.root
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                rotation[:, j] = rotation[:, parent] @ self.rotmat[:, j]
                bone = self.moved[j] if j in self.moved else self.offsets[j : j + 1]
                position[:, j] = position[:, parent] + (rotation[:, parent] @ bone[..., None])[..., 0]
        return rotation, position


def load_bvh(path: str | Path) -> Bvh:
    """Load a BVH file. Angles are degrees; the rotation is the product of the channels' rotations in their order.

    Position channels of joints other than the root replace the OFFSET: in some files the hips move below a resting
    root, in some every OFFSET is 0, and some have the OFFSETs of another actor. Channels that stay within ABSENT of 0
    hold nothing, and leave the OFFSET. Where a bone without an OFFSET changes its length, its mean is that at rest.

    Raises:
        InputError: not a BVH file, a damaged hierarchy, several roots, or motion rows that do not fit it.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: expected a BVH file, found none; check the name")
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    found = MOTION.search(text)
    if found is None or text.split(maxsplit=1)[0] != "HIERARCHY":
        cut = "no MOTION; the file is cut off, copy it again" if found is None and text.startswith("HIERARCHY") else ""
        raise InputError(
            f"{path}: expected a BVH file with HIERARCHY and MOTION, found {cut or 'neither; export it as BVH'}"
        )
    names, parents, offsets, ends, channels = _read_hierarchy(text[: found.start("word")], path)
    start = found.end("word")
    fps, values, notes = _read_rows(text[start:], text.count("\n", 0, start) + 1, sum(map(len, channels)), path)
    # Joints without channels are posed in every frame, too: what they take is not in proportion to the file.
    POSED_JOINTS.check(len(values) * len(names), path, len(text))
    rotmat, root, moved, offsets = _apply_channels(channels, values, offsets)
    of_column = [(name, kind) for name, kinds in zip(names, channels, strict=True) for kind, _ in kinds]
    scaled = [kind == "scale" for _, kind in of_column] & (np.abs(values - 1).max(axis=0) > SCALED)
    notes += scales_notes(path.stem, [of_column[k][0] for k in np.flatnonzero(scaled)])
    return Bvh(path.stem, tuple(names), tuple(parents), offsets, ends, rotmat, root, fps, moved, notes)


def scales_notes(name: str, joints: Iterable[str]) -> tuple[str, ...]:
    """Return a note on joints that an animation scales; none where it scales none."""
    scaled = listed([*dict.fromkeys(joints)], SHOWN_JOINTS)
    return (f"{name} scales {scaled}: joints are turned and moved, their sizes are not carried over",) * bool(scaled)


def _read_hierarchy(text: str, path: Path):
    """Parse the HIERARCHY section: names, parents, offsets, end sites and channels in file order."""
    text = OFFSETS.sub(lambda found: MINUS.sub(" -", found[0]), text)
    tokens = text.split()
    names, parents, offsets, channels, ends = [], [], [], [], {}
    stack: list[int] = []  # open joints; -1 marks an open End Site
    # A stack machine over the tokens; errors name the token index i.
    i = 1
    try:
        while i < len(tokens):
            word, i = tokens[i].upper(), i + 1
            if word in ("ROOT", "JOINT"):
                # Names may contain spaces, so they extend to the brace.
                brace = tokens.index("{", i)
                if (word == "ROOT") != (not stack) or (word == "ROOT" and names):
                    raise InputError(
                        f"{path}: expected one ROOT with all joints inside, found {word} {tokens[i]}; "
                        "export one skeleton per file"
                    )
                names.append(" ".join(tokens[i:brace]))
                parents.append(stack[-1] if stack else -1)
                DEPTH.check(len(stack), path)
                offsets.append(np.zeros(3))
                channels.append([])
                stack.append(len(names) - 1)
                i = brace + 1
            elif word == "END":
                stack.append(-1)
                i = tokens.index("{", i) + 1
            elif word == "OFFSET":
                offset = np.array([float(v) for v in tokens[i : i + 3]])
                if offset.shape != (3,) or not np.isfinite(offset).all():
                    raise ValueError
                if stack[-1] < 0:
                    ends[names[stack[-2]]] = offset
                else:
                    offsets[stack[-1]] = offset
                i += 3
            elif word == "CHANNELS":
                count = int(tokens[i])
                channels[stack[-1]] = [_channel(t, path) for t in tokens[i + 1 : i + 1 + count]]
                i += 1 + count
            elif word == "}":
                stack.pop()
            else:
                raise InputError(
                    f"{path}: expected ROOT, JOINT, OFFSET, CHANNELS or a brace, found {word[:40]!r} in line "
                    f"{_line_of_word(text, i - 1)}; the hierarchy is damaged, export it again"
                )
    except (ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: expected a whole HIERARCHY, found damage in line {_line_of_word(text, i)} "
            f"({' '.join(tokens[i - 1 : i + 3])[:60]}); export it again"
        ) from None
    JOINTS.check(len(names), path)
    if stack or not names:
        raise InputError(f"{path}: expected a whole HIERARCHY, found {len(stack)} braces open; export it again")
    return names, parents, np.array(offsets), ends, channels


def _line_of_word(text: str, number: int) -> int:
    starts = [word.start() for word in re.finditer(r"\S+", text)]
    return text.count("\n", 0, starts[min(number, len(starts) - 1)]) + 1


def _channel(word: str, path: Path) -> tuple[str, int]:
    """Parse the name of a channel: "Zrotation" is ("rotation", 2)."""
    axis, kind = word[:1].lower(), word[1:].lower()
    if axis not in "xyz" or kind not in ("rotation", "position", "scale"):
        raise InputError(f"{path}: expected channels such as Zrotation, found {word[:40]!r}; export it again")
    return kind, "xyz".index(axis)


def _read_rows(
    text: str, line: int, channels: int, path: Path
) -> tuple[float, Float[np.ndarray, "T C"], tuple[str, ...]]:
    """Parse the MOTION section, which begins in a line (from 1): frame rate, a row of values per frame, and notes."""
    notes = ()
    if MINUS.search(text):
        text = MINUS.sub(" -", text)
        notes = (f"{path.name} has numbers without a blank before a minus: they are read as two",)
    words = text.split()
    try:
        if [w.lower() for w in (words[0], *words[2:4])] != ["frames:", "frame", "time:"]:
            raise ValueError
        frames, frame_time = int(words[1]), float(words[4])
        values = np.fromiter(map(float, words[5:]), float, len(words) - 5)
    except (ValueError, IndexError) as error:
        raise InputError(
            f"{path}: expected 'Frames: N', 'Frame Time: s' and numbers after MOTION, found damage "
            f"({_row_at_fault(text, line, channels) or error}); export it again"
        ) from None
    if not SHORTEST <= frame_time <= LONGEST or frames < 1:
        raise InputError(
            f"{path}: expected frames and a frame time of {SHORTEST:g} to {LONGEST:g} s, "
            f"found {frames} and {frame_time:g}; export it again"
        )
    # A missing number would shift all later values, so a wrong count is an error. Whole rows after the last frame shift
    # nothing: some exporters count one frame too few.
    if not channels:
        raise InputError(f"{path}: expected joints with channels, found none; export the animation again")
    FRAMES.check(frames, path)
    if values.size < frames * channels or values.size % channels:
        raise InputError(
            f"{path}: expected {frames} frames of {channels} values, found {values.size} values "
            f"({_row_at_fault(text, line, channels) or f'the last frame is {values.size // channels - 1}'}); "
            "the file is cut short or its frame count is wrong, export it again"
        )
    if not np.isfinite(values).all():
        bad = int(np.flatnonzero(~np.isfinite(values))[0]) // channels
        place = _row_at_fault(text, line, channels)
        raise InputError(
            f"{path}: expected finite numbers, found NaN or infinity in frame {bad} ({place}); export it again"
        )
    rows = values.size // channels
    if rows != frames:
        notes += (f"{path.name} has {rows} rows and states {frames} frames: the first {frames} are read",)
    return _rate(words[4]), values[: frames * channels].reshape(frames, channels), notes


def _row_at_fault(text: str, line: int, channels: int) -> str:
    """Name line and frame of the first row that is not one finite number for each channel; empty if there is none."""
    frame = None
    for number, row in enumerate(text.split("\n"), line):
        if frame is not None and row.strip():
            try:
                sound = np.isfinite([float(word) for word in row.split()]).sum() == channels == len(row.split())
            except ValueError:
                sound = False
            if not sound:
                return f"line {number}, frame {frame}"
            frame += 1
        elif row.lower().lstrip().startswith("frame time"):
            frame = 0
    return ""


def _rate(frame_time: str) -> float:
    """Convert a frame time (seconds) to a rate: a whole number if its frame time rounds to the same digits."""
    seconds, whole = float(frame_time), round(1.0 / float(frame_time))
    exponent = Decimal(frame_time).as_tuple().exponent  # of the last digit that is written
    assert isinstance(exponent, int), "a finite number has an exponent"
    is_whole = whole > 0 and abs(1.0 / whole - seconds) <= 0.51 * 10.0**exponent
    return float(whole) if is_whole else 1.0 / seconds


def _apply_channels(channels, values, offsets):
    """Compute local rotations (T, J, 3, 3), the root's path (T, 3), paths of other moving joints, and bones at rest."""
    frames, offsets = len(values), offsets.copy()
    rotmat = np.tile(np.eye(3), (frames, len(channels), 1, 1))
    root, moved = np.tile(offsets[0], (frames, 1)), {}
    column = 0
    for j, kinds in enumerate(channels):
        path = np.tile(offsets[j], (frames, 1))
        for kind, axis in kinds:
            if kind == "rotation":
                turn = np.radians(values[:, column, None]) * np.eye(3)[axis]
                rotmat[:, j] = rotmat[:, j] @ rotvec_to_rotmat(turn)
            elif kind == "position":
                path[:, axis] = values[:, column]
            column += 1
        placed = [axis for kind, axis in kinds if kind == "position"]
        if j == 0:
            root = path
        elif placed and np.abs(path[:, placed]).max() > ABSENT * np.abs(offsets[j]).max():
            if np.ptp(path, axis=0).max() > 0:
                moved[j] = path
            if j not in moved or not offsets[j].any():
                offsets[j] = path.mean(axis=0)
    return rotmat, root, moved, offsets
