"""A folder of registered meshes or clips to train on: one topology, vertices in correspondence.

The names of the files say who is in which pose. Pairs are drawn from them (a truth, its person in another pose, and
another person in its pose), some people and poses are held out, and batches and validation pairs are made of the rest.
"""

from __future__ import annotations

import hashlib
import math
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, ClassVar, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from ...core.errors import InputError
from ...core.frame_buffer import Progress, counted, each_frame
from ...core.mesh import Clip, Mesh, permute_vertices
from ...core.normalization import Normalization, bbox_centre, parse_axis, radius
from ...evaluate.clip_protocols import ClipPair
from ...evaluate.pairs import Pair
from ...evaluate.protocols import Protocol
from ...io import load_clip, load_points
from ...io.formats import ANIMATED, CACHE, CLIP_READERS, FORMATS, MESH_READERS, MOTIONS
from ...motions.on_body import is_motion_file
from .bodies import copied_to, numbers_of_step, on_device, uniform
from .endless import ReflectOptions, random_index
from .people import PairBatch, VertexSampler

MESH_SUFFIXES = (MESH_READERS.keys() | CLIP_READERS.keys()) - MOTIONS
"""Of files that may hold a mesh or a clip."""
LAYOUTS = ("id{person:d}_{pose}", "tr_reg_{person:2}{pose:1}", "{person}/{pose}")
"""Patterns that are tried in this order: the public data of NPT and `mimesh generate`, FAUST, a folder a person."""
FIELD = re.compile(r"\{(person|pose|motion)(?::(d|[1-9]))?\}")
"""A field of a pattern: any characters of a name, with `:d` digits only, with a number so many characters."""
HELD_OUT = 10
"""One in so many people, and poses, is held out for validation: the last ones by name, rounded up."""
LEAST = 3
"""People and poses from which on some are held out: the training needs two of each."""


@dataclass(frozen=True)
class MeshOptions(ReflectOptions):
    """How a folder is read, and what of it is held out; the kind `meshes`."""

    pattern: str = ""
    """How the files are named, such as "{person}-{pose}.ply"; empty: found (`LAYOUTS`)."""
    up: str = ""
    """Axis of the files away from the ground; empty: +y."""
    front: str = ""
    """Axis of the files that people face; empty: +z."""
    held_out_people: int | None = None
    """People that networks are validated on instead of trained, the last ones by name; None: a tenth."""
    held_out_poses: int | None = None
    """The same of poses, or motions."""


@dataclass(frozen=True, eq=False)
class RegisteredMeshes:
    """The meshes or clips of a folder, every frame centred on its bounding box, with y up and +z front."""

    points: Float[np.ndarray, "N V 3"]
    """All frames in the unit sphere, float32; a file of the temporary folder mapped to memory."""
    radius: Float[np.ndarray, " N"]
    """By which each frame was divided, in the unit of the files."""
    faces: Int[np.ndarray, "F 3"]
    pairs: dict[str, Triples]
    """Those of the `training`, and of what is held out: `seen`, new people in poses of the training, and `unseen`, new
    people, or all where none are held out, in new poses, from identities in poses of the training."""
    facts: dict[str, Any]
    """For cards: `layout` of the folder, numbers of `people`, `poses`, `meshes` and `frames`, the topology, the axes,
    what is `held_out`, and `sha256` of all names and points."""
    ignored: int
    """Number of files that the layout does not match."""
    part: ClassVar[str] = "meshes"
    """Where checkpoints and cards have the facts."""

    def described(self) -> str:
        """Say in one line what the folder holds, what is held out, and what is ignored."""
        facts = self.facts
        what, poses = ("clips", "motions") if facts["frames"] > facts["meshes"] else ("meshes", "poses")
        frames = f" ({facts['frames']:,} frames)" if what == "clips" else ""
        held = [f"{what} {', '.join(names)}" for what, names in facts["held_out"].items() if names]
        parts = [
            f"{facts['layout']}: {facts['meshes']:,} {what}{frames} of {facts['people']} people in {facts['poses']} "
            f"{poses}, {facts['vertices']:,} vertices, {self.points.nbytes / 2**20:,.0f} MiB; up {facts['up']}, front "
            f"{facts['front']}",
            f"held out for validation: {' and '.join(held)}" if held else "validated on `val` of the shipped body",
            *[f"{self.ignored} other files ignored"] * bool(self.ignored),
        ]
        return "; ".join(parts)

    def continues(self, facts: dict[str, Any]) -> bool:
        """Tell whether a training with some facts may go on with these meshes: they are the same."""
        return not facts or facts == self.facts

    @classmethod
    def read(
        cls, folder: str | Path, config: MeshOptions, frames: int = 1, progress: Progress | None = None
    ) -> RegisteredMeshes:
        """Read the meshes or clips of a folder.

        Args:
            config: names and axes of the files, people and poses held out.
            frames: consecutive frames of a driving clip that a network takes.

        Raises:
            InputError: no meshes in a known layout, a file that cannot be used, several topologies, or no pair of two
                people in one pose in the training or among what is to be held out.
        """
        folder = Path(folder)
        axes = parse_axis(config.up or "+y", "data.up"), parse_axis(config.front or "+z", "data.front")
        pattern, entries, ignored = find_layout(folder, config.pattern)
        # In their natural order, whose end is held out.
        people, poses = (sorted({names[k] for names in entries}, key=natural) for k in range(2))
        table = MeshTable(np.full((len(people), len(poses)), -1), np.zeros(len(poses), np.int64))
        with tempfile.TemporaryFile(prefix="mimesh-") as file:
            store = FrameStore(file, *axes)
            for (person, pose), path in counted(entries.items(), len(entries), progress):
                column = poses.index(pose)
                table.first[people.index(person), column] = len(store.radius)
                count = store.add(path, folder)
                if table.length[column] not in (0, count):
                    raise InputError(
                        f"{path}: expected the {table.length[column]} frames that others have in {pose}, found "
                        f"{count}: frame t must be the same pose of all people. Recordings, as those of DFAUST, have "
                        "no truth of another person; make it from AMASS's archives of the same takes: python scripts/"
                        "generate_on_body_model.py clips-aniformer SMPLH.npz --split train --data TAKES -o clips"
                    )
                table.length[column] = count
            file.flush()
            assert store.mesh is not None
            shape = (len(store.radius), *store.mesh.vertices.shape)
            points = np.memmap(file, np.float32, "r+", shape=shape)  # the file may be deleted then
        if table.pairs(frames, 0, 0) is None:
            what = f"{len(entries)} meshes of {len(people)} people in {len(poses)} poses"
            if table.length.max() < frames:
                raise InputError(
                    f"{folder}: expected clips of {frames} frames or more, found at most {table.length.max()} "
                    f"({what}); train npt on meshes, or give folders of frames"
                )
            raise InputError(
                f"{folder}: expected two people in one pose, found none ({pattern}: {what}); name the files by person "
                "and pose, or give their names with --pattern"
            )
        held_out, pairs = hold_out(table, frames, config)
        facts = {
            **{"layout": pattern, "people": len(people), "poses": len(poses), "meshes": len(entries)},
            **{"frames": len(points), "vertices": points.shape[1], "triangles": len(store.mesh.faces)},
            **{"up": axes[0], "front": axes[1]},
            "held_out": {
                what: names[len(names) - count :]
                for (what, names), count in zip({"people": people, "poses": poses}.items(), held_out, strict=True)
            },
            "sha256": store.digest.hexdigest(),
        }
        return cls(points, np.array(store.radius), store.mesh.faces, pairs, facts, ignored)


class FrameStore:
    """Writes the frames of meshes of one topology to a file: each turned to y up and +z front, centred, in the unit
    sphere, float32."""

    def __init__(self, file: IO[bytes], up: str | None, front: str | None) -> None:
        self.file, self.axes = file, (up, front)
        self.radius: list[float] = []
        self.digest = hashlib.sha256()
        self.mesh: Mesh | None = None
        """The first mesh, whose topology all others must have."""
        self.path, self.rotation = Path(), np.eye(3)

    def add(self, path: Path, folder: Path) -> int:
        """Add a mesh or a clip, and give the number of its frames."""
        frames = self._read(path)
        self.digest.update(f"{path.relative_to(folder).as_posix()} {len(frames)}\n".encode())
        for points in each_frame(frames):
            centred = (points - bbox_centre(points)) @ self.rotation.T
            if not centred.any():
                raise InputError(f"{path}: expected a mesh with some size, found all vertices at one point")
            self.radius.append(radius(centred))
            self.digest.update(points.astype(np.float32).tobytes())
            try:
                self.file.write((centred / self.radius[-1]).astype(np.float32).tobytes())
            except OSError as error:
                raise InputError(
                    f"{tempfile.gettempdir()}: expected room for the meshes, found '{error.strerror}' after "
                    f"{len(self.radius):,} frames; free some, or set TMPDIR to another folder"
                ) from error
        return len(frames)

    def _read(self, path: Path) -> Float[np.ndarray, "T V 3"]:
        """Read the frames of a mesh, a clip or a folder, and check that they are of the topology."""
        if self.mesh is not None and path.is_file() and FORMATS[path.suffix.lower()].one_mesh:
            return load_points(path, self.mesh, self.path)[None]
        clip = load_clip(path)
        mesh = clip.mesh
        if (path.suffix.lower() in ANIMATED and mesh.source is None) or (path.is_file() and is_motion_file(path)):
            raise InputError(f"{path}: expected a mesh or clip, found joints that move; export the mesh")
        if not len(mesh.faces):
            raise InputError(f"{path}: expected a mesh with triangles, found points alone; export the faces too")
        if self.mesh is None:
            self.mesh, self.path, self.rotation = mesh, path, Normalization.fit(mesh, *self.axes).rotation
        elif mesh.vertices.shape != self.mesh.vertices.shape or not np.array_equal(mesh.faces, self.mesh.faces):
            raise InputError(
                f"{path}: expected the topology of {self.path.name} ({len(self.mesh.vertices)} vertices), found "
                f"{len(mesh.vertices)} vertices or other triangles; register it to the same template"
            )
        return clip.vertices


def hold_out(table: MeshTable, frames: int, config: MeshOptions) -> tuple[tuple[int, int], dict[str, Triples]]:
    """Hold out what the configuration says; by default a tenth of both, or nothing where no pair would be left.

    Raises:
        InputError: no pair in the training, or among what is held out.
    """
    asked, counts = (config.held_out_people, config.held_out_poses), table.first.shape
    usual = [math.ceil(count / HELD_OUT) if min(counts) >= LEAST else 0 for count in counts]
    people, poses = (count if given is None else given for given, count in zip(asked, usual, strict=True))
    for held_out in ((people, poses), (0, 0)) if asked == (None, None) else ((people, poses),):
        if (pairs := table.pairs(frames, *held_out)) is not None:
            return held_out, pairs
    raise InputError(
        f"data.held_out_people={people}, data.held_out_poses={poses}: expected pairs in the training and among what is "
        f"held out of {counts[0]} people and {counts[1]} poses, found a part without; hold out others"
    )


class MeshLayout(NamedTuple):
    """What a pattern finds in a folder."""

    pattern: str
    entries: dict[tuple[str, str], Path]
    """Person and pose -> a file, or a folder of frames; in their natural order: 2 before 10."""
    ignored: int
    """Number of files that the pattern does not match."""


def find_layout(folder: Path, pattern: str = "") -> MeshLayout:
    """Find the meshes or clips of a folder by a pattern, or by the first of LAYOUTS that matches any."""
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of registered meshes, found none; check the path")
    found = list(_candidates(folder))
    for tried in (pattern,) if pattern else LAYOUTS:
        expression, entries = compiled(tried), dict[tuple[str, str], Path]()
        named = {path: expression.fullmatch(_plain(path, folder, tried)) for path in found}
        for path, match in named.items():
            if match and (other := entries.setdefault((match["person"], match["pose"]), path)) != path:
                raise InputError(
                    f"{path}: expected one file of person {match['person']} in pose {match['pose']}, found "
                    f"{other.name} too; move one of them away, or give the names with --pattern"
                )
        if entries:
            order = sorted(entries, key=lambda names: [natural(name) for name in names])
            inside = set(entries.values())
            others = [path for path in found if not named[path] and path.is_file() and path.parent not in inside]
            return MeshLayout(tried, {names: entries[names] for names in order}, len(others))
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


def _candidates(folder: Path) -> Iterator[Path]:
    """Walk through files that may be meshes or clips, and folders of some; a point cache's mesh is part of the clip."""
    for path in sorted(folder.rglob("*")):
        if any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue
        if path.is_dir():
            if any(file.suffix.lower() in MESH_SUFFIXES for file in path.iterdir()):
                yield path
        elif path.suffix.lower() == CACHE or (
            path.suffix.lower() in MESH_SUFFIXES and not path.with_suffix(CACHE).exists()
        ):
            yield path


def _plain(path: Path, folder: Path, pattern: str) -> str:
    """Write a path relative to the folder as a pattern does: without its suffix where the pattern has none."""
    named = path.is_dir() or Path(pattern).suffix.lower() in MESH_SUFFIXES
    relative = path.relative_to(folder)
    return (relative if named else relative.with_suffix("")).as_posix()


@dataclass(frozen=True, eq=False)
class MeshTable:
    """Who is in which pose: P people in B poses, or motions, whose frames follow each other in one array."""

    first: Int[np.ndarray, "P B"]
    """Number of the first frame; -1 where a person has no such pose."""
    length: Int[np.ndarray, " B"]
    """Frames of each motion; 1 for a pose."""

    def pairs(self, frames: int, people: int, poses: int) -> dict[str, Triples] | None:
        """Hold out the last people and poses (`RegisteredMeshes.pairs`); None if a kind of pairs would be empty."""
        count = self.first.shape
        new, new_pose = np.arange(count[0])[:, None] >= count[0] - people, np.arange(count[1]) >= count[1] - poses
        tested = new if people else ~new
        # With one new person alone the driving meshes are of people of the training.
        driving = new if people > 1 else ~new
        found = {"training": Triples.of(self, frames, *[~new & ~new_pose] * 3)}
        for kind, pose, held in (("seen", ~new_pose, people), ("unseen", new_pose, poses)):
            if held:
                found[kind] = Triples.of(self, frames, tested & pose, tested & ~new_pose, driving & True)
        pairs = {kind: triples for kind, triples in found.items() if triples is not None}
        return pairs if len(pairs) == len(found) else None


@dataclass(frozen=True, eq=False)
class Triples:
    """All pairs of one kind: every truth is drawn equally often."""

    first: Int[Tensor, "P B"]
    length: Int[Tensor, " B"]
    truths: Int[Tensor, "R 2"]
    """Person and pose of each."""
    identities: Bool[Tensor, "P B"]
    drivings: Bool[Tensor, "P B"]
    frames: int
    """Frames of a window."""

    @classmethod
    def of(
        cls,
        table: MeshTable,
        frames: int,
        truths: Bool[np.ndarray, "P #B"],
        identities: Bool[np.ndarray, "P #B"],
        drivings: Bool[np.ndarray, "P #B"],
    ) -> Triples | None:
        """List the pairs among what may be truth, identity and driving; None where there is none.

        A truth needs a driving mesh of another person, and is its own identity where its person has no other pose.
        """
        truths, identities, drivings = (allowed & (table.first >= 0) for allowed in (truths, identities, drivings))
        usable = truths & (table.length >= frames) & (drivings.sum(0) > drivings) & identities.any(1, keepdims=True)
        if not usable.any():
            return None
        tensor = torch.from_numpy
        chosen = (tensor(np.argwhere(usable)), tensor(identities), tensor(drivings))
        return cls(tensor(table.first), tensor(table.length), *chosen, frames)

    def draw(self, size: int, rng: torch.Generator) -> tuple[Int[Tensor, " B"], Int[Tensor, "B T"], Int[Tensor, "B T"]]:
        """Draw frames of identities, and windows of driving meshes and truths, which are of the same frames.

        A truth is drawn first, then an identity in another pose and a driving person.
        """
        person, pose = self.truths[random_index(len(self.truths), (size,), rng)].T
        start = (uniform(rng, size) * (self.length[pose] - self.frames + 1)).long()
        window = start[:, None] + torch.arange(self.frames, device=rng.device)
        own = pick_other(self.identities[person], pose, rng)
        other = pick_other(self.drivings[:, pose].T, person, rng)
        still = self.first[person, own] + (uniform(rng, size) * self.length[own]).long()
        return still, self.first[other, pose, None] + window, self.first[person, pose, None] + window


def pick_other(allowed: Bool[Tensor, "B N"], but: Int[Tensor, " B"], rng: torch.Generator) -> Int[Tensor, " B"]:
    """Pick a random allowed column of each row but one; that one where there is no other."""
    keys = torch.where(allowed, uniform(rng, *allowed.shape), -1.0)
    return keys.scatter(1, but[:, None], -0.5).argmax(1)


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
        self.triples = copied_to(device, meshes.pairs["training"])

    def batch(self, size: int, step: int) -> WindowBatch:
        rng = numbers_of_step(self.seed, step, self.device)
        of_identity, of_driving, of_truth = self.triples.draw(size, rng)
        index, driving_index, edges, share = self._sample_vertices(size, rng)
        identity = self.points[of_identity[:, None], index]
        driving = self.points[of_driving[..., None], driving_index[:, None]]
        truth = self.points[of_truth[..., None], index[:, None]]
        unit = self.radius[of_truth] / self.radius[of_identity, None]
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
        triples = {kind: found for kind, found in meshes.pairs.items() if kind != "training"}
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
        drawn = self.triples[kind].draw(1, torch.Generator().manual_seed(int(rng.integers(2**31))))
        (still,), (window,), (of_truth,) = drawn
        identity, driving = self._mesh(int(still), order), self._mesh(int(window[0]), other)
        truth, clip = self._points(of_truth, order), self._points(window, other)
        height = float(np.ptp(identity.vertices[:, 1]))
        if self.triples[kind].frames == 1:
            return Pair(identity, driving, truth[0], height)
        return ClipPair(
            identity, driving, truth[0], height, clip=Clip(driving, clip), truth_frames=truth,
            aligned_frames=self._points(window, order),
        )  # fmt: skip

    def _points(self, frames: Int[Tensor, " T"], order: Int[np.ndarray, " V"]) -> Float[np.ndarray, "T V 3"]:
        radius = self.meshes.radius[frames.numpy()]
        return self.meshes.points[frames.numpy()][:, order].astype(np.float64) * radius[:, None, None]

    def _mesh(self, frame: int, order: Int[np.ndarray, " V"]) -> Mesh:
        points = self.meshes.points[frame].astype(np.float64) * self.meshes.radius[frame]
        return permute_vertices(Mesh(points, self.meshes.faces), order)
