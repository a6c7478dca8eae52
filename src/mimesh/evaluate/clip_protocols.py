"""`clips-aniformer`: AniFormer's protocol (section 4) on the shipped body; motions are seen, held out or a stress test.
`clips-ordered` is the test of its public code's kind (`ClipsOrdered`).

DFAUST, the paper's data, must not be redistributed. Here the 80 seen motions are disjoint seconds of the shipped CMU
takes, mirror images of some of them, walks and splines. `procedural` are walks and splines with other seeds, because
motions from the same generators are in the training data. `held-out` are in `test` the 30 motions of TAKES, whole
motions that nothing is trained on, read from files; in `val` later seconds of the shipped takes.

There are 16 training people. 8 new identities, each in its own rest pose, are moved in `test`, and 8 others in `val`;
every trial has a new driving person. All motions begin facing +z and have 30 frames. AniFormer takes 30 evenly spaced
frames of each of its motions; here a motion is one second.
"""

from __future__ import annotations

import dataclasses
import zlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody
from ..bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from ..io.gltf.document import open_document
from ..io.gltf.motion import read_skeleton
from ..motions import Motion, mirror, motion_clip, resample
from ..motions.bvh import load_bvh
from ..motions.clips import split_windows
from ..motions.procedural import spline_motion, walk_motion
from ..motions.retarget import retarget
from .pairs import Pair, Person, Pose, human, make_pair
from .protocols import Protocol
from .remesh import template

FRAMES = 30
FPS = 30.0
SEEN = {"seconds": 43, "mirrored": 13, "walks": 12, "splines": 12}
"""Number of seen motions of each source, 80 together; the `train` windows of the takes have 43 whole seconds."""
STRIDE = 37
"""Trial i of `seen` uses motion 37 i mod 80. 37 and 80 have no common factor, so 80 trials use every motion once, and
the first few trials cover all sources."""
STREAMS = {"seen": (0, 2), "unseen": (1, 1), "procedural": (2, 0), "held-out": (3, 3)}
"""Numbers in the seeds of driving people and of vertex orders, of each stream of trials; `held-out` of `val` is
`unseen`."""
SEED_VERSION = 1
"""Version of the seeds: later versions of the protocol have other kinds, and the people and motions of version 1."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ClipPair(Pair):
    """A trial of a clip protocol, in metres; the fields of `Pair` are those of its first frame.

    All frames have the same vertex order: that of the identity (V) or that of the driving mesh (U).
    """

    clip: Clip
    """The driving clip; its mesh is `driving`."""
    truth_frames: Float[np.ndarray, "T V 3"]
    """The true result in all frames."""
    aligned_frames: Float[np.ndarray, "T V 3"] | None
    """The driving person with true correspondence in all frames; None where there is no correspondence."""
    template: Int[np.ndarray, "N 2"] | None
    """Identity and driving vertex of each vertex of LIMP's template (`remesh.template`); None for other bodies."""
    place: Int[np.ndarray, " V"] | None = None
    """Vertex of both meshes for each vertex of the body; None where they have the body's order, or two orders."""

    def reordered(self, order: Int[np.ndarray, " V"], driving_order: Int[np.ndarray, " U"]) -> ClipPair:
        """Reorder the vertices in all frames."""
        first = super().reordered(order, driving_order)
        template = self.template
        if template is not None:
            # Vertex numbers follow by the inverse orders.
            columns = zip((order, driving_order), template.T, strict=True)
            template = np.stack([np.argsort(new_order)[vertices] for new_order, vertices in columns], axis=1)
        rank = np.argsort(order)
        return dataclasses.replace(
            first,
            clip=Clip(first.driving, self.clip.vertices[:, driving_order], self.clip.fps),
            truth_frames=self.truth_frames[:, order],
            aligned_frames=None if self.aligned_frames is None else self.aligned_frames[:, order],
            template=template,
            place=(rank if self.place is None else rank[self.place]) if np.array_equal(order, driving_order) else None,
        )

    def frame(self, t: int) -> Pair:
        """Return frame t as a pair of meshes."""
        mesh = dataclasses.replace(self.driving, vertices=self.clip.vertices[t])
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(Pair)}
        aligned = None if self.aligned_frames is None else self.aligned_frames[t]
        return Pair(**{**fields, "driving": mesh, "truth": self.truth_frames[t], "aligned": aligned})


@dataclass(frozen=True)
class ClipsAniformer(Protocol):
    """`clips-aniformer`: see the module."""

    data: Path | None = None
    """Folder of the held-out motions of `test`."""
    people: int = 16
    """Number of training people."""
    targets: int = 8
    """Number of identities of each split (AniFormer calls them targets)."""

    @property
    def validation_kinds(self) -> tuple[str, ...]:
        """Kinds that checkpoints are chosen by; `unseen` of `val` are seconds of the takes after those of training."""
        return ("seen", "unseen", "procedural")

    def seed(self, split: str) -> int:
        """Return the seed of a stream of samples; see SEED_VERSION."""
        return zlib.crc32(f"{self.name}/{SEED_VERSION}/{split}".encode())

    def rng(self, split: str, kind: str, i: int) -> np.random.Generator:
        """Return the random generator of the vertex orders of trial i."""
        return np.random.default_rng([self.seed(split), STREAMS[_stream(split, kind)][1], i])

    def count(self, kind: str, requested: int = 0, split: str = "test") -> int:
        """Return the number of trials to measure, at most as many as there are: 24, 30 (val: 20), 20 for 0."""
        stream = _stream(split, kind)
        available = {"seen": sum(SEEN.values()), "held-out": len(ORDER)}.get(stream, UNSEEN)
        return min(requested or (available if stream == "held-out" else self.pairs), available)

    def check(self, split: str) -> None:
        """Raise InputError for `train`, which has no trials, and if files are missing that the split needs."""
        self._check_name(split)
        if split == "test":
            find_takes(self.data)

    def _check_name(self, split: str) -> None:
        if split not in ("val", "test"):
            raise InputError(f"{split}: expected val or test of {self.name}, found a split without trials; choose one")

    def train_people(self, body: RiggedBody) -> Float[np.ndarray, "P K"]:
        """Return the shape coefficients of the 16 training people."""
        return np.stack([sample_shape(body, self.seed("train"), i, self.spread) for i in range(self.people)])

    def train_motions(self, body: RiggedBody) -> Float[np.ndarray, "N T J 3 3"]:
        """Return the joint rotations of the 80 seen motions."""
        return np.stack([motion.rotmat for motion in self.seen(body)])

    def seen(self, body: RiggedBody) -> tuple[Motion, ...]:
        """Return the 80 seen motions."""
        return _seen_motions(body, self.seed("train/motions"))

    def motion(self, split: str, kind: str, i: int) -> Motion:
        """Return the motion of trial i."""
        if kind == "seen":
            seen = self.seen(human())
            return seen[STRIDE * i % len(seen)]
        if kind == "procedural":
            make = spline_motion if i % 2 else walk_motion
            return _begin_at_origin(make(human(), self.seed(f"{split}/motions"), i, seconds=FRAMES / FPS, fps=FPS))
        if _stream(split, kind) == "unseen":
            assert split == "val", "`unseen` of `test` is of clips-ordered"
            return _later_seconds()[i % len(_later_seconds())]
        assert self.data is not None, "`check` comes first"
        return _held_out_second(self.data, ORDER[i % len(ORDER)])

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> ClipPair:
        """Generate trial i in the body's vertex order; everything is drawn from seeds and nothing from `rng`."""
        self._check_name(split)
        motion = self.motion(split, kind, i)
        number = 1000 * STREAMS[_stream(split, kind)][0] + i
        shape = sample_shape(human(), self.seed(f"{split}/actors"), number, self.spread)
        # Driving people are numbered after the identities: files are named by person.
        driving = Person(human(), shape, str(self.targets + number))
        identity, rest = self.target(split, i)
        return make_clip_pair(identity, driving, rest, motion)

    def target(self, split: str, i: int) -> tuple[Person, Pose]:
        """Return the identity of trial i of a split, and the pose that it rests in."""
        i %= self.targets
        identity = Person(human(), sample_shape(human(), self.seed(split), i, self.spread), str(i))
        return identity, Pose(rotvec_to_rotmat(sample_pose(human(), self.seed(split), i)), str(i))


def make_clip_pair(identity: Person, driving: Person, rest: Pose, motion: Motion) -> ClipPair:
    """Make a trial from two people, the identity's pose and the driving's motion, in the body's vertex order."""
    first = make_pair(identity, driving, rest, Pose(motion.rotmat[0], motion.name))
    clip, truth = (motion_clip(person.body, person.shape, motion) for person in (driving, identity))
    fields = {field.name: getattr(first, field.name) for field in dataclasses.fields(Pair)}
    # The clip also has the motion's root path, which a pair of poses has not.
    fields |= {"driving": dataclasses.replace(first.driving, vertices=clip.vertices[0])}
    fields |= {"truth": truth.vertices[0], "aligned": clip.vertices[0]}
    # Seconds of one take (take@start) are not independent.
    fields |= {"groups": (identity.label, motion.name.partition("@")[0])}
    return ClipPair(
        **fields,
        clip=dataclasses.replace(clip, mesh=fields["driving"]),
        truth_frames=truth.vertices,
        aligned_frames=clip.vertices,
        template=template().corners[:, :2] if identity.body is human() else None,
    )


def on_template(trial: ClipPair) -> ClipPair:
    """Restrict a trial to the vertices of LIMP's template, in the template's order; extra inputs are dropped."""
    assert trial.template is not None
    assert trial.aligned_frames is not None
    identity_vertices, driving_vertices = trial.template.T
    faces, vertices = template().faces, trial.clip.vertices[:, driving_vertices]
    identity = Mesh(trial.identity.vertices[identity_vertices], faces, name=trial.identity.name)
    driving = Mesh(vertices[0].astype(np.float64), faces, name=trial.driving.name)
    truth, aligned = trial.truth_frames[:, identity_vertices], trial.aligned_frames[:, identity_vertices]
    dropped = {field.name: None for field in dataclasses.fields(Pair) if field.default is None}
    return dataclasses.replace(
        trial,
        **dropped,
        identity=identity,
        driving=driving,
        clip=Clip(driving, vertices, trial.clip.fps),
        truth=truth[0],
        truth_frames=truth,
        aligned_frames=aligned,
        template=np.repeat(np.arange(len(identity_vertices))[:, None], 2, axis=1),
    )


def clips_aniformer(data: Path | None = None) -> ClipsAniformer:
    """Return the protocol; `data` is the folder of the files of `held-out`, which may lie in subfolders."""
    return ClipsAniformer("clips-aniformer", 3, ("seen", "held-out", "procedural"), pairs=24, spread=1.1, data=data)


CLIPS_ANIFORMER = clips_aniformer()


@cache
def _seen_motions(body: RiggedBody, seed: int) -> tuple[Motion, ...]:
    """Make the 80 seen motions: seconds of the takes, mirror images of some of them, walks and splines."""
    seconds = [second for take in split_windows("train") for second in split_into_seconds(take)]
    mirrored = np.linspace(0, len(seconds) - 1, SEEN["mirrored"]).round().astype(int)
    length = {"seconds": FRAMES / FPS, "fps": FPS}
    return (
        *seconds,
        *(mirror(seconds[k]) for k in mirrored),
        *(_begin_at_origin(walk_motion(body, seed, k, **length)) for k in range(SEEN["walks"])),
        *(_begin_at_origin(spline_motion(body, seed, k, **length)) for k in range(SEEN["splines"])),
    )


@cache
def _later_seconds() -> tuple[Motion, ...]:
    """Return the seconds of the takes that directly follow those of training, and their mirror images."""
    seconds = [second for take in split_windows("val") for second in split_into_seconds(take)]
    return (*seconds, *map(mirror, seconds))


def _stream(split: str, kind: str) -> str:
    """Return the stream of a kind: nothing is held out for `val`, whose motions are later seconds of the takes."""
    return "unseen" if (split, kind) == ("val", "held-out") else kind


@cache
def _held_out_second(folder: Path, number: int) -> Motion:
    """Read the middle second of a motion of TAKES."""
    return _middle_second(load_take(folder, number))


def _middle_second(motion: Motion) -> Motion:
    """Cut out the middle second of a motion; a motion shorter than a second is slowed down to one second."""
    if motion.seconds < FRAMES / FPS:
        motion = resample(motion, motion.fps * (FRAMES - 1) / (len(motion) - 1))
        return _begin_at_origin(dataclasses.replace(motion, fps=FPS))
    motion = resample(motion, FPS)
    return _cut(motion, (len(motion) - FRAMES) // 2, motion.name)


def split_into_seconds(take: Motion, step: int = FRAMES) -> list[Motion]:
    """Cut a take into windows of 30 frames that begin every `step` frames; a shorter remainder is dropped."""
    starts = range(0, len(take) - FRAMES + 1, step)
    return [_cut(take, start, f"{take.name}+{start / FPS:g}") for start in starts]


def _cut(motion: Motion, start: int, name: str) -> Motion:
    """Cut the 30 frames from `start` on out of a motion."""
    frames = slice(start, start + FRAMES)
    rotmat, root = motion.rotmat[frames], motion.root[frames]
    return _begin_at_origin(dataclasses.replace(motion, name=name, rotmat=rotmat, root=root))


def _begin_at_origin(motion: Motion) -> Motion:
    """Move and turn a motion so that its first frame is at x = z = 0 and faces +z, as driving clips are normalized.

    The heading is that of the hips' front, projected to the ground, so it is also defined for people who lie.
    """
    front = motion.rotmat[0, 0, :, 2]
    turn = rotvec_to_rotmat(np.array([0.0, -np.arctan2(front[0], front[2]), 0.0]))
    rotmat = motion.rotmat.copy()
    rotmat[:, 0] = turn @ rotmat[:, 0]
    return dataclasses.replace(motion, rotmat=rotmat, root=(motion.root - motion.root[0] * [1.0, 0.0, 1.0]) @ turn.T)


UNSEEN = 20
"""Unseen motions of `test`, as many as the paper's."""
UNSEEN_STRIDE = 7
"""Trial i of `unseen` uses motion 7 i mod 20 of `test`, so that the first few trials cover both takes."""


@dataclass(frozen=True)
class ClipsOrdered(ClipsAniformer):
    """`clips-ordered`: what AniFormer's public code trains for: one vertex order, training people drive.

    The public code never shuffles the sequences that it trains on, so driving vertex i is identity vertex i unless it
    shuffles the identity (which then no longer matches the truth). Its test is not published; the paper's test clips
    are those of its training, and 20 others of the same people. `clips-aniformer` has neither: its meshes are shuffled
    apart, as NPT's are, and its driving people are new. The two protocols share the 16 training people, the 80 motions,
    the targets and their poses.

    * `seen`: the 80 motions of the training; a training person drives a new target. With `unseen`, the paper's columns.
    * `unseen`: 20 other seconds of the takes that the motions are from. In `test` they are the last ones of the takes,
      in `val` those between these and the training's (`motions.clips.SPLITS`), so that nothing is chosen by what is
      tested.
    * `held-out`: whole motions of other makers, as in `clips-aniformer`; only where their files are given.

    Both meshes of a trial get the same random order: no method profits from how the body is numbered.
    """

    @property
    def validation_kinds(self) -> tuple[str, ...]:
        """Kinds of `val` that need no files."""
        return ("seen", "unseen")

    def seed(self, split: str) -> int:
        """Return the seed of a stream of samples of `clips-aniformer`, whose people and motions these are."""
        return CLIPS_ANIFORMER.seed(split)

    def check(self, split: str) -> None:
        """Raise InputError for `train`, which has no trials, and if files of `held-out` are missing."""
        self._check_name(split)
        if split == "test" and "held-out" in self.kinds:
            find_takes(self.data)

    def motion(self, split: str, kind: str, i: int) -> Motion:
        """Return the motion of trial i."""
        if (split, kind) == ("test", "unseen"):
            return _last_seconds()[UNSEEN_STRIDE * i % UNSEEN]
        return super().motion(split, kind, i)

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> ClipPair:
        """Generate trial i in the body's vertex order; everything is drawn from seeds and nothing from `rng`."""
        self._check_name(split)
        # Each time that a target comes round again, the driving people are one further on.
        number = (i + i // self.targets) % self.people
        shape = sample_shape(human(), self.seed("train"), number, self.spread)
        identity, rest = self.target(split, i)
        return make_clip_pair(
            identity, Person(human(), shape, str(self.targets + number)), rest, self.motion(split, kind, i)
        )

    def pair(self, split: str, kind: str, i: int) -> ClipPair:
        """Generate trial i as methods get it: one random vertex order for both meshes and all frames."""
        rng = self.rng(split, kind, i)
        trial = self.unshuffled_pair(split, kind, i, rng)
        order = rng.permutation(len(trial.identity.vertices))
        return trial.reordered(order, order)


def clips_ordered(data: Path | None = None) -> ClipsOrdered:
    """Return the protocol; with a folder of the files (see `clips_aniformer`) it has the kind `held-out`, too."""
    kinds = ("seen", "unseen", *(("held-out",) if data is not None else ()))
    fields = {field.name: getattr(CLIPS_ANIFORMER, field.name) for field in dataclasses.fields(ClipsAniformer)}
    return ClipsOrdered(**{**fields, "name": "clips-ordered", "version": 1, "kinds": kinds, "data": data})


CLIPS_ORDERED = clips_ordered()


@cache
def _last_seconds() -> tuple[Motion, ...]:
    """Return 20 of the seconds that begin every half second of the takes' last parts, and of their mirror images."""
    seconds = [second for take in split_windows("test") for second in split_into_seconds(take, FRAMES // 2)]
    both = [*seconds, *map(mirror, seconds)]
    return tuple(both[k] for k in np.linspace(0, len(both) - 1, UNSEEN).round().astype(int))


# Whole motions that no training may use, read from a folder: 10 seconds of a boxing capture and 20 animated clips.
# The capture is of the Debian package assimp-testmodels: one take of 31 s by a person and with a skeleton that no other
# data here have. Its origin is not documented, so it is read and not shipped. The clips are by an animator, not
# captured: KayKit Character Animations by Kay Lousberg (CC0). Both were chosen by their names and length before any
# method was measured on them.
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


def _folder_with(folder: Path, file: str) -> Path | None:
    """Find the first folder that has a file: `folder`, its subfolders, then theirs; None if there is none."""
    # Two levels cover a folder of unpacked packages; more would take long in a home folder.
    places = (folder, *sorted(folder.glob("*/")), *sorted(folder.glob("*/*/")))
    return next((place for place in places if (place / file).is_file()), None)


def find_takes(folder: Path | None) -> dict[str, Path]:
    """Find the files of the held-out motions in a folder or its subfolders, two levels deep, by name.

    Raises:
        InputError: no folder, or a file is missing.
    """
    if folder is None:
        raise InputError(f"held-out motions: expected a folder, found none; give it with --data: {PACKAGES}")
    found = {name: _folder_with(folder, name) for name in (BOXING_FILE, *ANIMATED)}
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
