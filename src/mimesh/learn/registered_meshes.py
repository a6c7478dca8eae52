"""Reads a folder of registered meshes or clips to train on: one topology, vertices in correspondence."""

from __future__ import annotations

import dataclasses
import hashlib
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.frame_buffer import PAGED, Progress, counted, each_frame, release_pages, spread_exactly
from ..core.mesh import Mesh
from ..core.normalization import Normalization, bbox_centre, parse_axis, radius
from ..io import load_clip, load_points
from ..io.formats import ANIMATED
from ..motions.on_body import is_motion_file
from .body_sampler import DataConfig
from .character_folder import DAMAGED
from .mesh_layouts import Entry, MeshLayout, find_layout, natural
from .mesh_triples import MeshTable, Split, held_out

VOTES = 25
"""Meshes, evenly spread over the folder, whose detected axes are compared: the most frequent ones are those of all."""
SINGLE = (".obj", ".off", ".ply", ".stl")
"""Formats of one mesh a file."""
NAMED = 4
"""Files refused that are named at most; others are counted."""
ANY = DataConfig("meshes")
"""All frames; names and axes are found, a tenth is held out."""


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
        config: DataConfig = ANY,
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
        people, poses = _numbered(entry.person for entry in used), _numbered(entry.pose for entry in used)
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

        Raises:
            InputError: most cannot be used, or the temporary folder is full.
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
        if self.mesh is not None and path.is_file() and path.suffix.lower() in SINGLE:
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
    table: MeshTable, frames: int, people: list[str], poses: list[str], config: DataConfig
) -> tuple[dict[str, list[str]], Split]:
    """Hold out what the configuration says; by default a tenth of both, or nothing where no pair would be left.

    Raises:
        InputError: what is to be held out is not there, or leaves a part without pairs.
    """
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
    """Choose the people, or poses, to hold out: see `DataConfig.hold_out_people`.

    Raises:
        InputError: all would be, or a name is not among them.
    """
    key = f"data.hold_out_{what}={asked}"
    if asked in ("", "none") or asked.isdecimal():
        count = int(asked) if asked.isdecimal() else 0 if asked else held_out(len(names))
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


def _numbered(names: Iterable[str]) -> dict[str, int]:
    """Number names in the order that they are to be held out from the end of."""
    return {name: number for number, name in enumerate(sorted(set(names), key=natural))}


def _table(
    lengths: dict[Entry, int], people: dict[str, int], poses: dict[str, int], spread: int = 0
) -> tuple[MeshTable, list[str]]:
    """Make the table of all clips; where those of a motion have several lengths, their first frames are used.

    Args:
        lengths: frames that each file has.
        spread: of which so many, evenly spread, were kept; 0 for all.

    Raises:
        InputError: several lengths where frames are spread over them, or of recordings.
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
