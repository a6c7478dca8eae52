"""`clips-aniformer`: AniFormer's test (section 4) on our body: 100 motions of 30 frames, 80 seen and 20 unseen.

DFAUST may not be shipped. Seen are disjoint seconds of the shipped CMU takes, mirror images of some, walks and splines.
Unseen are the 20 clips of DeepMimic, which nobody here trains on and which are read from a folder or from an installed
pybullet. Walks and splines of other seeds are a kind of their own, `procedural`, since their makers were seen.

16 people train; 8 new targets, each in a pose of its own, are moved in `test`, 8 others in `val`. A driving person is
somebody else in every trial. `val` knows nothing of the DeepMimic clips: its unseen motions are other seconds of the
takes. All motions begin facing +z. AniFormer takes 30 frames evenly from each of its motions; ours are one second long.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody
from ..bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from ..motions import Motion, load_deepmimic, mirror, motion_clip, resample, spline_motion, walk_motion
from ..motions.clips import split_windows
from ..motions.deepmimic import CLIPS, deepmimic_folder
from .pairs import Pair, Person, Pose, human, random_orders, reordered, stage
from .protocols import Protocol
from .remesh import template

FRAMES = 30
FPS = 30.0
SEEN = {"seconds": 43, "mirrored": 13, "walks": 12, "splines": 12}
"""What the 80 seen motions are; `train` of the takes has 43 whole seconds."""
STRIDE = 37
"""Trial i of the seen ones takes motion 37 i mod 80, so that the first few are spread over all sorts of motion."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ClipPair(Pair):
    """A trial in motion, metres; what `Pair` holds is its first frame.

    All frames have one order of vertices: that of the identity (V) or that of the driving (U).
    """

    clip: Clip
    """The driving person; its mesh is `driving`."""
    truth_frames: Float[np.ndarray, "T V 3"]
    aligned_frames: Float[np.ndarray, "T V 3"]
    """The driving person with true correspondence."""
    template: Int[np.ndarray, "N 2"]
    """Identity and driving vertex of each vertex of LIMP's template."""

    def frame(self, t: int) -> Pair:
        """Frame t as a pair of meshes."""
        mesh = dataclasses.replace(self.driving, vertices=self.clip.vertices[t])
        known = {field.name: getattr(self, field.name) for field in dataclasses.fields(Pair)}
        return Pair(**{**known, "driving": mesh, "truth": self.truth_frames[t], "aligned": self.aligned_frames[t]})


@dataclass(frozen=True)
class ClipsAniformer(Protocol):
    """See the module; `data` is the folder of the DeepMimic clips, None for that of an installed pybullet."""

    data: Path | None = None
    people: int = 16
    targets: int = 8

    def count(self, kind: str, asked: int = 0) -> int:
        """24 of the seen motions, all 20 unseen, 20 procedural ones; no more than there are of a kind."""
        return min(
            asked or self.pairs, {"seen": sum(SEEN.values()), "unseen": len(CLIPS), "procedural": len(CLIPS)}[kind]
        )

    def check(self, split: str) -> None:
        """Raise InputError for `train`, and for `test` where the DeepMimic clips are not there."""
        self._check_name(split)
        if split == "test":
            deepmimic_folder(self.data)

    def _check_name(self, split: str) -> None:
        if split not in ("val", "test"):
            raise InputError(f"{split}: expected val or test of {self.name}, found a split without trials; choose one")

    def train_people(self, body: RiggedBody) -> Float[np.ndarray, "P K"]:
        """Shape coefficients of the 16 training people."""
        return np.stack([sample_shape(body, self.seed("train"), i, self.spread) for i in range(self.people)])

    def train_motions(self, body: RiggedBody) -> Float[np.ndarray, "N T J 3 3"]:
        """Joint rotations of the 80 seen motions."""
        return np.stack([motion.rotmat for motion in self.seen(body)])

    def train_paths(self, body: RiggedBody) -> Float[np.ndarray, "N T 3"]:
        """Root paths of the 80 seen motions (metres, for the body's mean shape)."""
        return np.stack([motion.root for motion in self.seen(body)])

    def seen(self, body: RiggedBody) -> tuple[Motion, ...]:
        """The 80 seen motions."""
        return _seen(body, self.seed("train/motions"))

    def motion(self, split: str, kind: str, i: int) -> Motion:
        """The motion of trial i."""
        if kind == "seen":
            seen = self.seen(human())
            return seen[STRIDE * i % len(seen)]
        if kind == "procedural":
            make = spline_motion if i % 2 else walk_motion
            return _placed(make(human(), self.seed(f"{split}/motions"), i, seconds=FRAMES / FPS, fps=FPS))
        if split == "val":
            return _later()[i % len(_later())]
        return _deepmimic(deepmimic_folder(self.data), tuple(CLIPS)[i % len(CLIPS)])

    def whole(self, split: str, kind: str, i: int, rng: np.random.Generator) -> ClipPair:
        """Trial i with its vertices in the order of the body; all is drawn by seeds, nothing from `rng`."""
        self._check_name(split)
        motion, target = self.motion(split, kind, i), i % self.targets
        mover = Person(human(), sample_shape(human(), self.seed(split), target, self.spread), str(target))
        number = 1000 * self.kinds.index(kind) + i
        shape = sample_shape(human(), self.seed(f"{split}/actors"), number, self.spread)
        stand = Pose(rotvec_to_rotmat(sample_pose(human(), self.seed(split), target)), str(target))
        still = stage(mover, Person(human(), shape, str(number)), stand, Pose(motion.rotmat[0], motion.name))
        clip, truth = (motion_clip(human(), person, motion) for person in (shape, mover.shape))
        known = {field.name: getattr(still, field.name) for field in dataclasses.fields(Pair)}
        known |= {"driving": dataclasses.replace(still.driving, vertices=clip.vertices[0])}
        known |= {"truth": truth.vertices[0], "aligned": clip.vertices[0]}
        return ClipPair(
            **known,
            clip=dataclasses.replace(clip, mesh=known["driving"]),
            truth_frames=truth.vertices,
            aligned_frames=clip.vertices,
            template=template().corners[:, :2],
        )

    def pair(self, split: str, kind: str, i: int) -> ClipPair:
        """Trial i as methods get it: shuffled, all frames alike."""
        rng = self.rng(split, kind, i)
        whole = self.whole(split, kind, i, rng)
        orders = order, driving_order = random_orders(whole, rng)
        first = reordered(whole, order, driving_order)
        return dataclasses.replace(
            first,
            clip=Clip(first.driving, whole.clip.vertices[:, driving_order], whole.clip.fps),
            truth_frames=whole.truth_frames[:, order],
            aligned_frames=whole.aligned_frames[:, order],
            template=np.stack([np.argsort(o)[t] for o, t in zip(orders, whole.template.T, strict=True)], axis=1),
        )  # pyright: ignore[reportReturnType] (replace keeps the class)


def on_template(trial: ClipPair) -> ClipPair:
    """The same trial on the vertices that LIMP knows, in their order."""
    mine, theirs = trial.template.T
    faces, vertices = template().faces, trial.clip.vertices[:, theirs]
    identity = Mesh(trial.identity.vertices[mine], faces, name=trial.identity.name)
    driving = Mesh(vertices[0].astype(np.float64), faces, name=trial.driving.name)
    truth, aligned = trial.truth_frames[:, mine], trial.aligned_frames[:, mine]
    known = {field.name: None for field in dataclasses.fields(Pair) if field.default is None}
    return dataclasses.replace(
        trial,
        **known,
        identity=identity,
        driving=driving,
        clip=Clip(driving, vertices, trial.clip.fps),
        truth=truth[0],
        truth_frames=truth,
        aligned_frames=aligned,
        template=np.repeat(np.arange(len(mine))[:, None], 2, axis=1),
    )


def clips_aniformer(data: Path | None = None) -> ClipsAniformer:
    """The protocol, with the folder of the DeepMimic clips if it is not that of an installed pybullet.

    Raises:
        InputError: the folder lacks one of them.
    """
    data = data and deepmimic_folder(data)
    return ClipsAniformer("clips-aniformer", 1, ("seen", "unseen", "procedural"), pairs=24, spread=1.1, data=data)


CLIPS_ANIFORMER = clips_aniformer()


@cache
def _seen(body: RiggedBody, seed: int) -> tuple[Motion, ...]:
    """Seconds of the takes, mirror images of some of them, walks and splines."""
    seconds = [second for take in split_windows("train") for second in _seconds(take)]
    chosen = np.linspace(0, len(seconds) - 1, SEEN["mirrored"]).round().astype(int)
    made = {"seconds": FRAMES / FPS, "fps": FPS}
    return (
        *seconds,
        *(mirror(seconds[k]) for k in chosen),
        *(_placed(walk_motion(body, seed, k, **made)) for k in range(SEEN["walks"])),
        *(_placed(spline_motion(body, seed, k, **made)) for k in range(SEEN["splines"])),
    )


@cache
def _later() -> tuple[Motion, ...]:
    """Seconds of the takes that nobody trains on, and their mirror images: the unseen motions of `val`."""
    seconds = [second for take in split_windows("val") for second in _seconds(take)]
    return (*seconds, *map(mirror, seconds))


@cache
def _deepmimic(folder: Path, name: str) -> Motion:
    """The middle second of a DeepMimic clip; a clip shorter than a second is played slower, to last one."""
    motion = load_deepmimic(folder / CLIPS[name], human(), name)
    if motion.seconds < FRAMES / FPS:
        motion = resample(motion, motion.fps * (FRAMES - 1) / (len(motion) - 1))
        return _placed(dataclasses.replace(motion, fps=FPS))
    motion = resample(motion, FPS)
    return _cut(motion, (len(motion) - FRAMES) // 2, name)


def _seconds(take: Motion) -> list[Motion]:
    """Disjoint windows of 30 frames, one after the other."""
    starts = range(0, len(take) - FRAMES + 1, FRAMES)
    return [_cut(take, start, f"{take.name}+{start / FPS:g}") for start in starts]


def _cut(motion: Motion, start: int, name: str) -> Motion:
    frames = slice(start, start + FRAMES)
    rotmat, root = motion.rotmat[frames], motion.root[frames]
    return _placed(dataclasses.replace(motion, name=name, rotmat=rotmat, root=root))


def _placed(motion: Motion) -> Motion:
    """The same motion from x = z = 0 on, facing +z in its first frame, to which the frame of a driving clip is fitted.

    The heading is that of the hips' front along the ground, for those who lie too.
    """
    front = motion.rotmat[0, 0, :, 2]
    back = rotvec_to_rotmat(np.array([0.0, -np.arctan2(front[0], front[2]), 0.0]))
    rotmat = motion.rotmat.copy()
    rotmat[:, 0] = back @ rotmat[:, 0]
    return dataclasses.replace(motion, rotmat=rotmat, root=(motion.root - motion.root[0] * [1.0, 0.0, 1.0]) @ back.T)
