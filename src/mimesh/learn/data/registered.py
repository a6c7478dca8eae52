"""A folder of registered meshes or clips to train on: one topology, vertices in correspondence.

The names of the files say who is in which pose. Pairs are drawn from them (a truth, its person in another pose, and
another person in its pose), some people and poses are held out, and batches and validation pairs are made of the rest.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ...core.errors import InputError
from ...core.frame_buffer import PAGED, Progress, counted, each_frame, release_pages, spread_exactly
from ...core.mesh import Clip, Mesh, permute_vertices
from ...core.normalization import Normalization, bbox_centre, parse_axis, radius
from ...evaluate.clip_protocols import ClipPair
from ...evaluate.pairs import Pair
from ...evaluate.protocols import Protocol
from ...io import list_animations, load_clip, load_points
from ...io.formats import ANIMATED, CACHES, CLIP_READERS, COLLECTIONS, FORMATS, MESH_READERS, MOTIONS
from ...motions.on_body import is_motion_file
from .bodies import copied_to, numbers_of_step, on_device, uniform
from .clips import DAMAGED
from .endless import ReflectOptions
from .people import PairBatch, VertexSampler

VOTES = 25
"""Meshes, evenly spread over the folder, whose detected axes are compared: the most frequent ones are those of all."""
NAMED = 4
"""Files refused that are named at most; others are counted."""
MESH_SUFFIXES = (MESH_READERS.keys() | CLIP_READERS.keys()) - MOTIONS
"""Of files that may hold a mesh or a clip."""
LAYOUTS = ("id{person:d}_{pose}", "tr_reg_{person:2}{pose:1}", "{person}/{pose}", "{person:d}_{pose}")
"""Patterns that are tried in this order: the public data of NPT and `mimesh generate`, FAUST, a folder a person, and
names of clips as in DFAUST's files (.hdf5)."""
FIELD = re.compile(r"\{(person|pose|motion)(?::(d|[1-9]))?\}")
"""A field of a pattern: any characters of a name, with `:d` digits only, with a number so many characters."""
HELD_OUT = 10
"""One in so many people, and poses, is held out for validation: the last ones by name, rounded up."""
LEAST = 3
"""People, and poses, from which on some are held out: the training needs two of each."""


@dataclass(frozen=True)
class MeshOptions(ReflectOptions):
    """How a folder is read, and what of it is held out; the kind `meshes`."""

    pattern: str = ""
    """How the files are named, such as "{person}-{pose}.ply"; empty: found (`LAYOUTS`)."""
    up: str = ""
    """Axis of the files away from the ground, such as "+z"; empty: that of the files, or detected."""
    front: str = ""
    """Axis of the files that people face; empty: detected, the same for all meshes."""
    hold_out_people: str = ""
    """People that networks are validated on instead of trained: a number (the last ones by name), names with
    commas between (one name ends with a comma), or none; empty: a tenth."""
    hold_out_poses: str = ""
    """The same of poses, or motions."""
    frames: int = 0
    """So many evenly spread frames of each clip, AniFormer's 30 for example; 0: all."""


@dataclass(frozen=True, eq=False)
class RegisteredMeshes:
    """The meshes or clips of a folder, every frame centred on its bounding box, with y up and +z front."""

    points: Float[np.ndarray, "N V 3"]
    """All frames in the unit sphere, float32; a file of the temporary folder mapped to memory."""
    radius: Float[np.ndarray, " N"]
    """By which each frame was divided, in the unit of the files."""
    faces: Int[np.ndarray, "F 3"]
    split: Split
    facts: dict[str, Any]
    """For cards: `layout` of the folder, numbers of `people`, `poses`, `meshes` and `frames`, the topology, the axes,
    what is `held_out`, and `sha256` of all names and points."""
    notes: tuple[str, ...]
    """What is left out."""
    part: ClassVar[str] = "meshes"
    """Where checkpoints and cards have the facts."""

    def described(self) -> str:
        """Say in one line what the folder holds, what is used for what, and what is left out."""
        facts, (identities, drivings, truths) = self.facts, self.split.training.counts
        what = "clips" if facts["frames"] > facts["meshes"] else "meshes"
        frames = f" ({facts['frames']:,} frames)" if what == "clips" else ""
        parts = [
            f"{facts['layout']}: {facts['meshes']:,} {what}{frames} of {facts['people']} people in {facts['poses']} "
            f"{'motions' if what == 'clips' else 'poses'}, {facts['vertices']:,} vertices, "
            f"{self.points.nbytes / 2**20:,.0f} MiB; up {facts['up']}, front {facts['front']}",
            f"{identities:,} can be identity, {drivings:,} driving, {truths:,} truth",
            described_split(facts["held_out"], self.split),
        ]
        return "; ".join([*parts, *self.notes])

    def continues(self, facts: dict[str, Any]) -> bool:
        """Tell whether a training with some facts may go on with these meshes: they are the same."""
        return not facts or facts == self.facts

    @classmethod
    def read(
        cls,
        folder: str | Path,
        config: MeshOptions,
        frames: int = 1,
        progress: Progress | None = None,
    ) -> RegisteredMeshes:
        """Read the meshes or clips of a folder, or of a file of several clips.

        Args:
            config: names and axes of the files, frames of each clip that are taken, people and poses held out.
            frames: consecutive frames of a driving clip that a network takes.

        Raises:
            InputError: no meshes in a known layout, several topologies, no pair of two people in one pose, or nothing
                of what is to be held out.
        """
        folder = Path(folder)
        axes = parse_axis(config.up or None, "data.up"), parse_axis(config.front or None, "data.front")
        layout = find_layout(folder, config.pattern)
        with tempfile.TemporaryFile(prefix="mimesh-") as file:
            store = FrameStore(file, config.frames)
            used, refused = store.add_all(layout.entries, folder, progress)
            points = store.mapped()
        assert store.mesh is not None
        people, poses = (  # numbered by their natural order, whose end is held out
            {name: number for number, name in enumerate(sorted(names, key=natural))}
            for names in ({entry.person for entry in used}, {entry.pose for entry in used})
        )
        table, notes = _table(used, people, poses, config.frames)
        nothing = np.zeros(len(used), bool)
        if Split.of(table, frames, nothing, nothing) is None:
            raise InputError(_no_pair(folder, layout, people, poses, table, frames))
        held_out, split = _split(table, frames, [*people], [*poses], config)
        up, front = _turn_to_front(points, store.mesh, *axes)
        facts = {
            "layout": layout.pattern,
            **{"people": len(people), "poses": len(poses), "meshes": len(used), "frames": len(points)},
            **{"vertices": points.shape[1], "triangles": len(store.mesh.faces), "up": up, "front": front},
            **{"held_out": held_out, "sha256": store.digest.hexdigest()},
        }
        notes += _refusals(refused)
        if any(entry.clip for entry in used):
            notes.append("frame t of a motion is taken to be the same pose of all people in it")
        notes += [f"{layout.ignored} other files ignored"] if layout.ignored else []
        return cls(points, np.array(store.radius), store.mesh.faces, split, facts, tuple(notes))


class FrameStore:
    """Writes the frames of meshes of one topology to a file: each centred, in the unit sphere, float32."""

    def __init__(self, file: IO[bytes], spread: int = 0) -> None:
        self.file, self.spread = file, spread
        self.radius: list[float] = []
        self.digest = hashlib.sha256()
        self.mesh: Mesh | None = None
        """The first mesh, whose topology all others must have."""
        self.path = Path()

    def add_all(
        self, entries: Sequence[Entry], folder: Path, progress: Progress | None = None
    ) -> tuple[dict[Entry, int], dict[str, str]]:
        """Add all meshes and clips, and give the frames that each file has, and by name why others are refused.

        Of clips `spread` frames are kept, evenly spread; all for 0.
        """
        used, refused = {}, {}
        for entry in counted(entries, len(entries), progress):
            name = entry.path.relative_to(folder if folder.is_dir() else folder.parent).as_posix()
            name += f"/{entry.clip}" if entry.clip else ""
            try:
                frames = self._read(entry.path, entry.clip)
                kept = frames
                if self.spread and len(frames) > 1:
                    kept = frames[spread_exactly(len(frames), self.spread, name)]
            except DAMAGED as error:
                plain = str(error) if isinstance(error, InputError) else f"expected a sound file, found {error!r:.80}"
                refused[name] = plain.removeprefix(f"{entry.path}: ")
                continue
            self._keep(kept, name)
            used[entry] = len(frames)
        if len(refused) > len(used):
            name, reason = next(iter(refused.items()))
            raise InputError(
                f"{folder}: expected meshes of one topology, found {len(refused)} of {len(entries)} that cannot be "
                f"used, such as {name}: {reason}"
            )
        return used, refused

    def mapped(self) -> Float[np.ndarray, "N V 3"]:
        """Map the file, which may be deleted then, to memory."""
        assert self.mesh is not None
        self.file.flush()
        return np.memmap(self.file, np.float32, "r+", shape=(len(self.radius), *self.mesh.vertices.shape))

    def _read(self, path: Path, name: str | None) -> Float[np.ndarray, "T V 3"]:
        """Read the frames of a mesh, a clip (of a name) or a folder, and check that they are of the topology."""
        if self.mesh is not None and path.is_file() and FORMATS[path.suffix.lower()].one_mesh:
            frames = load_points(path, self.mesh, self.path)[None]
        else:
            clip = load_clip(path, animation=name)
            self._check(clip.mesh, path)
            frames = clip.vertices
        if not all(np.ptp(points, axis=0).max() > 0.0 for points in frames):
            raise InputError(
                f"{path}: expected a mesh with some size, found all vertices at one point; export it again"
            )
        return frames

    def _check(self, mesh: Mesh, path: Path) -> None:
        suffix = path.suffix.lower()
        if (suffix in ANIMATED and mesh.source is None) or (path.is_file() and is_motion_file(path)):
            raise InputError(f"{path}: expected a mesh or clip, found joints that move; export the mesh")
        if not len(mesh.faces):
            raise InputError(f"{path}: expected a mesh with triangles, found points alone; export the faces too")
        if self.mesh is None:
            self.mesh, self.path = mesh, path
        elif mesh.vertices.shape != self.mesh.vertices.shape or not np.array_equal(mesh.faces, self.mesh.faces):
            raise InputError(
                f"{path}: expected the topology of {self.path.name} ({len(self.mesh.vertices)} vertices), found "
                f"{len(mesh.vertices)} vertices or other triangles; register it to the same template"
            )

    def _keep(self, frames: Float[np.ndarray, "T V 3"], name: str) -> None:
        self.digest.update(f"{name} {len(frames)}\n".encode())
        for points in each_frame(frames):
            centred = points - bbox_centre(points)
            self.radius.append(radius(centred))
            self.digest.update(points.astype(np.float32).tobytes())
            try:
                self.file.write((centred / self.radius[-1]).astype(np.float32).tobytes())
            except OSError as error:
                raise InputError(
                    f"{tempfile.gettempdir()}: expected room for the meshes, found '{error.strerror}' after "
                    f"{len(self.radius):,} frames; free some, or set TMPDIR to another folder"
                ) from error


def described_split(names: dict[str, list[str]], split: Split) -> str:
    """Say which people and poses are held out, and what networks are validated on."""
    if not (split.seen or split.unseen):
        return "validated on `val` of the shipped body: nothing is held out, or too few people or poses for that"
    poses = names["poses"]
    listed = ", ".join(poses) if len(poses) <= NAMED else f"{poses[0]} to {poses[-1]} ({len(poses)})"
    parts = [f"people {', '.join(names['people'])}"] * bool(names["people"]) + [f"poses {listed}"] * bool(poses)
    return f"held out for validation: {' and '.join(parts)}"


def _split(
    table: MeshTable, frames: int, people: list[str], poses: list[str], config: MeshOptions
) -> tuple[dict[str, list[str]], Split]:
    """Hold out what the configuration says; by default a tenth of both, or nothing where no pair would be left."""
    asked = {"people": config.hold_out_people, "poses": config.hold_out_poses}
    names = {what: _chosen(every, asked[what], what) for what, every in (("people", people), ("poses", poses))}
    if not any(asked.values()) and not all(names.values()):
        names = {"people": [], "poses": []}
    columns = ((table.person, people, names["people"]), (table.pose, poses, names["poses"]))
    split = Split.of(table, frames, *(np.isin(column, list(map(every.index, some))) for column, every, some in columns))
    if split is not None:
        return names, split
    if any(asked.values()):
        raise InputError(
            f"data.hold_out_people={asked['people']}, data.hold_out_poses={asked['poses']}: expected pairs in the "
            f"training and among what is held out ({len(names['people'])} of {len(people)} people, "
            f"{len(names['poses'])} of {len(poses)} poses), found a part without; hold out others"
        )
    return _split(
        table, frames, people, poses, dataclasses.replace(config, hold_out_people="none", hold_out_poses="none")
    )


def _chosen(names: list[str], asked: str, what: str) -> list[str]:
    """Choose the people, or poses, to hold out: see `MeshOptions.hold_out_people`."""
    key = f"data.hold_out_{what}={asked}"
    if asked in ("", "none") or asked.isdecimal():
        usual = math.ceil(len(names) / HELD_OUT) if len(names) >= LEAST else 0
        count = int(asked) if asked.isdecimal() else 0 if asked else usual
        if count >= len(names):
            raise InputError(
                f"{key}: expected fewer than the {len(names)} {what} there are, found {count}; one that has this name "
                f"is {key},"
            )
        return names[len(names) - count :]
    chosen = [name.strip() for name in asked.split(",") if name.strip()]
    if unknown := [name for name in chosen if name not in names]:
        some = ", ".join(names[:NAMED]) + " ..." * (len(names) > NAMED)
        raise InputError(f"{key}: expected a number, none, or names of {what} ({some}), found {unknown[0]}")
    return [name for name in names if name in chosen]


def _table(
    lengths: dict[Entry, int], people: dict[str, int], poses: dict[str, int], spread: int = 0
) -> tuple[MeshTable, list[str]]:
    """Make the table of all clips; where those of a motion have several lengths, their first frames are used.

    Args:
        lengths: frames that each file has.
        spread: of which so many, evenly spread, were kept; 0 for all.
    """
    length = np.array([*lengths.values()], np.int64)
    pose = np.array([poses[entry.pose] for entry in lengths], np.int64)
    common = np.full(len(poses), np.iinfo(np.int64).max)
    np.minimum.at(common, pose, length)
    other = [name for name, number in poses.items() if (length[pose == number] > common[number]).any()]
    if other and (spread or any(entry.clip for entry in lengths)):
        raise InputError(_several_lengths(other[0], lengths))
    if spread:
        length, common = (np.where(array > 1, spread, array) for array in (length, common))
    notes = [f"clips of {', '.join(other[:NAMED])}{' and others' if len(other) > NAMED else ''} have several lengths: "
             "the first frames, as many as the shortest has, are used"] if other else []  # fmt: skip
    person = np.array([people[entry.person] for entry in lengths], np.int64)
    return MeshTable(person, pose, np.cumsum(length) - length, common[pose]), notes


def _turn_to_front(
    points: Float[np.ndarray, "N V 3"], mesh: Mesh, up: str | None, front: str | None
) -> tuple[str, str]:
    """Turn all frames, in place, to y up and +z front as most of some frames have it; return the axes of the files."""
    some = np.unique(np.linspace(0, len(points) - 1, VOTES).round().astype(int))
    found = [Normalization.fit(Mesh(points[t].astype(np.float64), mesh.faces, up=mesh.up), up, front) for t in some]
    axes = Counter((one.up, one.front) for one in found).most_common(1)[0][0]
    rotation = next(one.rotation for one in found if (one.up, one.front) == axes).astype(np.float32)
    turned = not np.array_equal(rotation, np.eye(3))
    for start in range(0, len(points), PAGED) if turned else ():
        points[start : start + PAGED] = points[start : start + PAGED] @ rotation.T
        release_pages(points)
    return axes


def _several_lengths(motion: str, lengths: dict[Entry, int]) -> str:
    """Say that clips of one motion are not the same motion, and how to get such."""
    found = [f"{entry.person} has {length} frames" for entry, length in lengths.items() if entry.pose == motion]
    return (
        f"{motion}: expected clips in which frame t is the same pose of all people, found other lengths "
        f"({', '.join(found[:NAMED])}). Recordings, as those of DFAUST, have no truth of another person in a motion. "
        "Make it from AMASS's archives of the same takes: mimesh generate clips-aniformer --split train --body-model "
        "SMPLH.npz --data TAKES -o clips"
    )


def _refusals(refused: dict[str, str]) -> list[str]:
    notes = [f"refused {name}: {reason}" for name, reason in list(refused.items())[:NAMED]]
    return notes + ([f"{len(refused) - NAMED} others refused"] if len(refused) > NAMED else [])


def _no_pair(
    folder: Path, layout: MeshLayout, people: dict[str, int], poses: dict[str, int], table: MeshTable, frames: int
) -> str:
    """Say why a folder has no pair."""
    what = f"{len(table.person)} meshes of {len(people)} people in {len(poses)} poses"
    if frames > 1 and table.length.max() < frames:
        return (
            f"{folder}: expected clips of {frames} frames or more, found at most {table.length.max()} ({what}); "
            "train npt on meshes, or give folders of frames"
        )
    remedy = "name the files by person and pose, or give their names with --pattern"
    if any(entry.clip for entry in layout.entries):
        remedy = "recordings of one person a motion have no truth of another; AMASS's of the same takes give one, by " \
        "mimesh generate clips-aniformer --split train --body-model SMPLH.npz --data TAKES -o clips"  # fmt: skip
    return f"{folder}: expected two people in one pose, found none ({layout.pattern}: {what}); {remedy}"


@dataclass(frozen=True)
class Entry:
    """A mesh or clip: a file, a folder of frames, or a clip of a file that has several."""

    person: str
    pose: str
    path: Path
    clip: str | None = None
    """Name of the clip in a file of several."""


@dataclass(frozen=True)
class MeshLayout:
    """What a pattern finds in a folder."""

    pattern: str
    entries: tuple[Entry, ...]
    """In the natural order of people and poses: 2 before 10."""
    ignored: int
    """Number of files that the pattern does not match."""


def find_layout(folder: Path, pattern: str = "") -> MeshLayout:
    """Find the meshes or clips of a folder by a pattern, or by the first of LAYOUTS that matches any."""
    if not folder.is_dir() and folder.suffix.lower() not in COLLECTIONS:
        raise InputError(f"{folder}: expected a folder of registered meshes, found none; check the path")
    found = list(_candidates(folder))
    for tried in (pattern,) if pattern else LAYOUTS:
        expression = compiled(tried)
        named = {(path, clip): expression.fullmatch(clip or _plain(path, folder, tried)) for path, clip in found}
        entries = [Entry(match["person"], match["pose"], *key) for key, match in named.items() if match]
        if entries:
            _refuse_twins(entries)
            entries.sort(key=lambda entry: (natural(entry.person), natural(entry.pose)))
            inside = {entry.path for entry in entries if entry.path.is_dir()}
            others = [key for key in found if not named[key] and key[0].is_file() and key[0].parent not in inside]
            return MeshLayout(tried, tuple(entries), len(others))
    tried = pattern or ", ".join(FIELD.sub(r"{\1}", layout) for layout in LAYOUTS)
    raise InputError(
        f"{folder}: expected meshes or clips named by person and pose ({tried}), found {len(found)} files, none named "
        "so; give their names with --pattern, such as '{person}-{pose}.ply'"
    )


def compiled(pattern: str) -> re.Pattern[str]:
    """Compile a pattern such as "{person}/{pose}.ply" to a regular expression."""
    fields = [match[1].replace("motion", "pose") for match in FIELD.finditer(pattern)]
    literal = FIELD.split(pattern)[:: FIELD.groups + 1]
    if sorted(fields) != ["person", "pose"] or any("{" in part or "}" in part for part in literal):
        raise InputError(
            f"--pattern {pattern}: expected one {{person}} and one {{pose}} (or {{motion}}), found "
            f"{' and '.join(fields) or 'none'}; for example '{{person}}-{{pose}}.ply'"
        )
    expression = re.escape(literal[0])
    for match, name, part in zip(FIELD.finditer(pattern), fields, literal[1:], strict=True):
        kind = match[2]
        text = "[^/]+?" if kind is None else r"\d+" if kind == "d" else f"[^/]{{{kind}}}"
        expression += f"(?P<{name}>{text}){re.escape(part)}"
    return re.compile(expression)


def natural(name: str) -> list[tuple[int, int | str]]:
    """Give a key that sorts names by the numbers in them: walk2 before walk10."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", name) if part]


def _candidates(folder: Path) -> Iterator[tuple[Path, str | None]]:
    """Walk through the files that may be meshes or clips, the folders that hold some, and clips of files of several.

    The mesh of a point cache, which has its name, is a part of that clip.
    """
    for path in sorted(folder.rglob("*")) if folder.is_dir() else [folder]:
        if folder.is_dir() and any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue
        if path.is_dir():
            if any(file.suffix.lower() in MESH_SUFFIXES for file in path.iterdir()):
                yield path, None
        elif path.suffix.lower() in COLLECTIONS:
            yield from ((path, name) for name in list_animations(path))
        elif path.suffix.lower() in CACHES or (
            path.suffix.lower() in MESH_SUFFIXES and not any(path.with_suffix(end).exists() for end in CACHES)
        ):
            yield path, None


def _plain(path: Path, folder: Path, pattern: str) -> str:
    """Write a path relative to the folder as a pattern does: without its suffix where the pattern has none."""
    named = path.is_dir() or Path(pattern).suffix.lower() in MESH_SUFFIXES
    relative = path.relative_to(folder)
    return (relative if named else relative.with_suffix("")).as_posix()


def _refuse_twins(entries: list[Entry]) -> None:
    seen: dict[tuple[str, str], Path] = {}
    for entry in entries:
        other = seen.setdefault((entry.person, entry.pose), entry.path)
        if other != entry.path:
            raise InputError(
                f"{entry.path}: expected one file of person {entry.person} in pose {entry.pose}, found {other.name} "
                "too; move one of them away, or give the names with --pattern"
            )


@dataclass(frozen=True, eq=False)
class MeshTable:
    """Who is in which pose: one row for each of K meshes or clips, whose frames follow each other in one array."""

    person: Int[np.ndarray, " K"]
    pose: Int[np.ndarray, " K"]
    """Of clips: the motion."""
    first: Int[np.ndarray, " K"]
    """Number of its first frame."""
    length: Int[np.ndarray, " K"]
    """Number of its frames; 1 for a mesh. All clips of a motion have one length."""


@dataclass(frozen=True)
class Frames:
    """The frames of B pairs. Driving and truth are windows of the same frames of two people's clips."""

    identity: Int[Tensor, " B"]
    driving: Int[Tensor, "B T"]
    truth: Int[Tensor, "B T"]


@dataclass(frozen=True)
class Choices:
    """Rows of the table that may stand beside each of R truths: those of its group, without itself."""

    rows: Int[Tensor, " N"]
    """All that may be chosen, group by group."""
    start: Int[Tensor, " R"]
    """Where the group of each truth begins."""
    count: Int[Tensor, " R"]
    """How many there are beside the truth."""
    own: Int[Tensor, " R"]
    """Where the truth itself stands, which is left out; the number of rows where it is not among them."""

    @classmethod
    def of(
        cls, group: Int[np.ndarray, " K"], allowed: Bool[np.ndarray, " K"], truths: Int[np.ndarray, " R"]
    ) -> Choices:
        """List the allowed rows beside each truth."""
        rows = np.flatnonzero(allowed)
        rows = rows[np.argsort(group[rows], kind="stable")]
        start, stop = (np.searchsorted(group[rows], group[truths], side) for side in ("left", "right"))
        place = np.full(len(group), len(rows))
        place[rows] = np.arange(len(rows))
        count = stop - start - allowed[truths]
        return cls(*(torch.from_numpy(array) for array in (rows, start, count, place[truths])))

    def pick(self, truth: Int[Tensor, " B"], share: Float[Tensor, " B"]) -> Int[Tensor, " B"]:
        """Pick for some truths a row, at a share from 0 to 1 of what there is; the truth itself if there is nothing."""
        place = self.start[truth] + (share * self.count[truth]).long()
        place = place + (place >= self.own[truth])
        place = torch.where(self.count[truth] > 0, place, self.own[truth])
        return self.rows[place.clamp_max(len(self.rows) - 1)]


@dataclass(frozen=True, eq=False)
class Triples:
    """All pairs of one kind: every window of the truths is drawn equally often."""

    table: tuple[Int[Tensor, " K"], Int[Tensor, " K"]]
    """First frame and length of every row."""
    truths: Int[Tensor, " R"]
    ends: Int[Tensor, " R"]
    """Number of windows of the truths up to each."""
    identities: Choices
    drivings: Choices
    frames: int
    """Frames of a window."""
    counts: tuple[int, int, int]
    """Number of meshes or clips that may be identity, driving and truth."""

    @classmethod
    def of(
        cls,
        table: MeshTable,
        frames: int,
        truths: Bool[np.ndarray, " K"],
        identities: Bool[np.ndarray, " K"],
        drivings: Bool[np.ndarray, " K"],
    ) -> Triples | None:
        """List the pairs among the rows that may be truth, identity and driving; None where there is none.

        A truth needs a driving mesh of another person, and is its own identity where its person has no other pose.
        """
        rows = np.flatnonzero(truths & (table.length >= frames))
        beside = Choices.of(table.person, identities, rows), Choices.of(table.pose, drivings, rows)
        usable = ((beside[0].count.numpy() > 0) | identities[rows]) & (beside[1].count.numpy() > 0)
        rows = rows[usable]
        if not len(rows):
            return None
        of_person = identities & np.isin(table.person, table.person[rows])
        of_pose = drivings & np.isin(table.pose, table.pose[rows])
        return cls(
            (torch.from_numpy(table.first), torch.from_numpy(table.length)),
            torch.from_numpy(rows),
            torch.from_numpy(np.cumsum(table.length[rows] - frames + 1)),
            Choices.of(table.person, identities, rows),
            Choices.of(table.pose, drivings, rows),
            frames,
            (int(of_person.sum()), int(of_pose.sum()), len(rows)),
        )

    def draw(self, size: int, rng: torch.Generator) -> Frames:
        """Draw pairs: a window of a truth, then an identity in another pose and a driving person."""
        first, length = self.table
        window = torch.randint(int(self.ends[-1]), (size,), generator=rng, device=rng.device)
        share = uniform(rng, 3, size)
        truth = torch.searchsorted(self.ends, window, right=True)
        row = self.truths[truth]
        start = (window - self.ends[truth] + length[row] - self.frames + 1)[:, None]
        frames = start + torch.arange(self.frames, device=rng.device)
        identity, driving = self.identities.pick(truth, share[0]), self.drivings.pick(truth, share[1])
        still = first[identity] + (share[2] * length[identity]).long()
        return Frames(still, first[driving, None] + frames, first[row, None] + frames)


@dataclass(frozen=True, eq=False)
class Split:
    """The pairs of a folder: those of the training, and those that networks are validated on, if any are held out."""

    training: Triples
    seen: Triples | None
    """New people in poses of the training; None where no people are held out."""
    unseen: Triples | None
    """New people, or all where none are held out, in new poses, from identities in poses of the training; None where no
    poses are held out."""

    @classmethod
    def of(
        cls, table: MeshTable, frames: int, new: Bool[np.ndarray, " K"], new_pose: Bool[np.ndarray, " K"]
    ) -> Split | None:
        """Split the pairs of a table into those with new people and new poses, and others; None if a part has none."""
        known = ~new & ~new_pose
        training = Triples.of(table, frames, known, known, known)
        # With one new person alone the driving meshes are of people of the training.
        driving = new if len(np.unique(table.person[new])) > 1 else ~new
        truths = new if new.any() else ~new
        seen, unseen = (
            Triples.of(table, frames, truths & pose, truths & ~new_pose, driving) if asked.any() else None
            for pose, asked in ((~new_pose, new), (new_pose, new_pose))
        )
        if training is None or (new.any() and seen is None) or (new_pose.any() and unseen is None):
            return None
        return cls(training, seen, unseen)


@dataclass(frozen=True)
class WindowBatch:
    """Normalised windows of B pairs. Vertex i of `truth` is vertex i of `identity`; `driving` has another order.

    With `pairing: order` it has the same one. T is 1 for meshes.
    """

    identity: Float[Tensor, "B V 3"]
    driving: Float[Tensor, "B T V 3"]
    truth: Float[Tensor, "B T V 3"]
    unit: Float[Tensor, "B T"]
    """Radii by which the frames of `truth` were divided, over that of `identity`."""
    truth_radius: Float[Tensor, "B T"]
    """Radii of the whole frames of `truth` in its unit: 1 where they were divided by their own."""
    index: Int[Tensor, "B V"]
    """Number of each vertex of `identity` in the mesh that it is drawn from."""
    edges: Int[Tensor, "B E 2"]
    edges_of_mesh: float
    """Edges a vertex of the whole mesh over edges a vertex given here."""


class MeshWindowSource(VertexSampler):
    """Makes batches of windows of registered clips, which lie on the device; of meshes they have one frame."""

    def __init__(self, config: MeshOptions, meshes: RegisteredMeshes, device: torch.device, seed: int) -> None:
        super().__init__(meshes.points[0], meshes.faces, config, device, seed)
        self.keep_unit = config.target_scale == "identity"
        self.points = torch.from_numpy(meshes.points).to(device)
        self.radius = on_device(meshes.radius, device)
        self.triples = copied_to(device, meshes.split.training)

    def batch(self, size: int, step: int) -> WindowBatch:
        rng = numbers_of_step(self.seed, step, self.device)
        frames = self.triples.draw(size, rng)
        index, driving_index, edges, share = self._sample_vertices(size, rng)
        identity = self.points[frames.identity[:, None], index]
        driving = self.points[frames.driving[..., None], driving_index[:, None]]
        truth = self.points[frames.truth[..., None], index[:, None]]
        unit = self.radius[frames.truth] / self.radius[frames.identity, None]
        own = torch.ones_like(unit)
        if self.keep_unit:
            truth, unit, own = truth * unit[..., None, None], own, unit
        self._reflect(rng, identity, driving, truth)
        return WindowBatch(identity, driving, truth, unit, own, index, edges, share)


class MeshPairSource:
    """Makes batches of pairs of registered meshes."""

    def __init__(self, config: MeshOptions, meshes: RegisteredMeshes, device: torch.device, seed: int) -> None:
        self.windows = MeshWindowSource(config, meshes, device, seed)

    def batch(self, size: int, step: int) -> PairBatch:
        drawn = self.windows.batch(size, step)
        truth, own = drawn.truth[:, 0], drawn.truth_radius[:, 0]
        return PairBatch(drawn.identity, drawn.driving[:, 0], truth, own, drawn.edges, drawn.edges_of_mesh)


@dataclass(frozen=True, eq=False)
class HeldOutMeshes(Protocol):
    """Pairs of what a folder holds out: new people in poses of the training (`seen`), and new poses (`unseen`)."""

    meshes: RegisteredMeshes
    triples: dict[str, Triples]
    """By kind."""

    @classmethod
    def of(cls, meshes: RegisteredMeshes) -> HeldOutMeshes | None:
        """Make the protocol of a folder; None where nothing is held out."""
        kinds = {"seen": meshes.split.seen, "unseen": meshes.split.unseen}
        triples = {kind: found for kind, found in kinds.items() if found}
        return cls("meshes", 1, tuple(triples), 72, 0.0, meshes, triples) if triples else None

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        """Draw pair `i`, in the order of the files."""
        return self._pair(kind, rng, *(np.arange(self.meshes.points.shape[1]) for _ in range(2)))

    def pair(self, split: str, kind: str, i: int) -> Pair:
        """Draw pair `i` with the vertices of both meshes shuffled, the same way in all frames of a clip."""
        rng = self.rng(split, kind, i)
        return self._pair(kind, rng, *(rng.permutation(self.meshes.points.shape[1]) for _ in range(2)))

    def _pair(
        self, kind: str, rng: np.random.Generator, order: Int[np.ndarray, " V"], other: Int[np.ndarray, " V"]
    ) -> Pair:
        """Make a pair of meshes, or of clips where the training takes windows; lengths are in the files' unit."""
        frames = self.triples[kind].draw(1, torch.Generator().manual_seed(int(rng.integers(2**31))))
        identity = self._mesh(int(frames.identity[0]), order)
        truth = self._points(frames.truth[0], order)
        clip = self._points(frames.driving[0], other)
        driving = self._mesh(int(frames.driving[0, 0]), other)
        height = float(np.ptp(identity.vertices[:, 1]))
        if self.triples[kind].frames == 1:
            return Pair(identity, driving, truth[0], height)
        return ClipPair(
            identity, driving, truth[0], height, clip=Clip(driving, clip), truth_frames=truth,
            aligned_frames=self._points(frames.driving[0], order),
        )  # fmt: skip

    def _points(self, frames: Int[Tensor, " T"], order: Int[np.ndarray, " V"]) -> Float[np.ndarray, "T V 3"]:
        radius = self.meshes.radius[frames.numpy()]
        return self.meshes.points[frames.numpy()][:, order].astype(np.float64) * radius[:, None, None]

    def _mesh(self, frame: int, order: Int[np.ndarray, " V"]) -> Mesh:
        points = self.meshes.points[frame].astype(np.float64) * self.meshes.radius[frame]
        return permute_vertices(Mesh(points, self.meshes.faces), order)
