"""`clips-aniformer`: AniFormer's protocol (section 4) on the shipped body, with vertices paired at random.
`clips-ordered` is the test of its public code's kind (`ClipsOrdered`).

DFAUST, the paper's data, must not be redistributed. Here the 80 seen motions are disjoint seconds of the shipped CMU
takes, mirror images of some of them, walks and splines. `unseen` are 20 other seconds of the takes: in `test` the last
ones, in `val` those between these and the training's (`motions.clips.SPLITS`), so that nothing is chosen by what is
tested. `procedural` are walks and splines with other seeds, because motions from the same generators are in the
training data.

There are 16 training people. 8 new identities, each in its own rest pose, are moved in `test`, and 8 others in `val`;
every trial has a new driving person. All motions begin facing +z and have 30 frames. AniFormer takes 30 evenly spaced
frames of each of its motions; here a motion is one second.
"""

from __future__ import annotations

import dataclasses
import zlib
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody
from ..bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from ..core.errors import InputError
from ..core.mesh import Clip
from ..motions import Motion, mirror, motion_clip
from ..motions.clips import split_windows
from ..motions.procedural import spline_motion, walk_motion
from .pairs import Pair, Person, Pose, human, make_pair
from .protocols import Protocol

FRAMES = 30
FPS = 30.0
SEEN = {"seconds": 43, "mirrored": 13, "walks": 12, "splines": 12}
"""Number of seen motions of each source, 80 together; the `train` windows of the takes have 43 whole seconds."""
STRIDE = 37
"""Trial i of `seen` uses motion 37 i mod 80. 37 and 80 have no common factor, so 80 trials use every motion once, and
the first few trials cover all sources."""
STREAMS = {"seen": (0, 2), "unseen": (1, 1), "procedural": (2, 0)}
"""Numbers in the seeds of driving people and of vertex orders, of each kind of trials."""
UNSEEN = 20
"""Unseen motions, as many as the paper's."""
UNSEEN_STRIDE = 7
"""Trial i of `unseen` in `test` uses motion 7 i mod 20, so that the first few trials cover both takes."""
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
    place: Int[np.ndarray, " V"] | None = None
    """Vertex of both meshes for each vertex of the body; None where they have the body's order, or two orders."""

    @classmethod
    def of(
        cls, first: Pair, clip: Clip, truth: Float[np.ndarray, "T V 3"], aligned: Float[np.ndarray, "T V 3"] | None
    ) -> ClipPair:
        """Make a trial of its first frame and all frames."""
        fields = {field.name: getattr(first, field.name) for field in dataclasses.fields(Pair)}
        return cls(**fields, clip=clip, truth_frames=truth, aligned_frames=aligned)

    def reordered(self, order: Int[np.ndarray, " V"], driving_order: Int[np.ndarray, " U"]) -> ClipPair:
        """Reorder the vertices in all frames."""
        first = super().reordered(order, driving_order)
        rank = np.argsort(order)
        return dataclasses.replace(
            first,
            clip=Clip(first.driving, self.clip.vertices[:, driving_order], self.clip.fps),
            truth_frames=self.truth_frames[:, order],
            aligned_frames=None if self.aligned_frames is None else self.aligned_frames[:, order],
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

    people: int = 16
    """Number of training people."""
    targets: int = 8
    """Number of identities of each split (AniFormer calls them targets)."""

    def seed(self, split: str) -> int:
        """Return the seed of a stream of samples; see SEED_VERSION."""
        return zlib.crc32(f"{self.name}/{SEED_VERSION}/{split}".encode())

    def rng(self, split: str, kind: str, i: int) -> np.random.Generator:
        """Return the random generator of the vertex orders of trial i."""
        return np.random.default_rng([self.seed(split), STREAMS[kind][1], i])

    def count(self, kind: str, requested: int = 0, split: str = "test") -> int:
        """Return the number of trials to measure, at most as many as there are: 24, 20, 20 for 0."""
        return min(requested or self.pairs, sum(SEEN.values()) if kind == "seen" else UNSEEN)

    def check(self, split: str) -> None:
        """Raise InputError for `train`, which has no trials."""
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
        if split == "test":
            return _last_seconds()[UNSEEN_STRIDE * i % UNSEEN]
        return _later_seconds()[i % len(_later_seconds())]

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> ClipPair:
        """Generate trial i in the body's vertex order; everything is drawn from seeds and nothing from `rng`."""
        self.check(split)
        motion = self.motion(split, kind, i)
        number = 1000 * STREAMS[kind][0] + i
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
    # The clip also has the motion's root path, which a pair of poses has not.
    first = dataclasses.replace(
        first,
        driving=dataclasses.replace(first.driving, vertices=clip.vertices[0]),
        truth=truth.vertices[0],
        aligned=clip.vertices[0],
        # Seconds of one take (take@start) are not independent.
        groups=(identity.label, motion.name.partition("@")[0]),
    )
    return ClipPair.of(first, dataclasses.replace(clip, mesh=first.driving), truth.vertices, clip.vertices)


CLIPS_ANIFORMER = ClipsAniformer("clips-aniformer", 4, ("seen", "unseen", "procedural"), pairs=24, spread=1.1)


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


@cache
def _last_seconds() -> tuple[Motion, ...]:
    """Return 20 of the seconds that begin every half second of the takes' last parts, and of their mirror images."""
    seconds = [second for take in split_windows("test") for second in split_into_seconds(take, FRAMES // 2)]
    both = [*seconds, *map(mirror, seconds)]
    return tuple(both[k] for k in np.linspace(0, len(both) - 1, UNSEEN).round().astype(int))


def split_into_seconds(take: Motion, step: int = FRAMES) -> list[Motion]:
    """Cut a take into windows of 30 frames that begin every `step` frames; a shorter remainder is dropped."""
    starts = range(0, len(take) - FRAMES + 1, step)
    return [_cut(take, start, f"{take.name}+{start / FPS:g}") for start in starts]


def _cut(motion: Motion, start: int, name: str) -> Motion:
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


@dataclass(frozen=True)
class ClipsOrdered(ClipsAniformer):
    """`clips-ordered`: what AniFormer's public code trains for: one vertex order, training people drive.

    The public code never shuffles the sequences that it trains on, so driving vertex i is identity vertex i unless it
    shuffles the identity (which then no longer matches the truth). Its test is not published; the paper's test clips
    are those of its training, and 20 others of the same people. `clips-aniformer` has neither: its meshes are shuffled
    apart, as NPT's are, and its driving people are new. The two protocols share the 16 training people, the motions,
    the targets and their poses.

    Both meshes of a trial get the same random order: no method profits from how the body is numbered.
    """

    def seed(self, split: str) -> int:
        """Return the seed of a stream of samples of `clips-aniformer`, whose people and motions these are."""
        return CLIPS_ANIFORMER.seed(split)

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> ClipPair:
        """Generate trial i in the body's vertex order; everything is drawn from seeds and nothing from `rng`."""
        self.check(split)
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


CLIPS_ORDERED = ClipsOrdered("clips-ordered", 1, ("seen", "unseen"), pairs=24, spread=1.1)
