"""`clips-aniformer`: AniFormer's protocol (section 4) on the shipped body, with 80 seen and 20 unseen motions.

DFAUST, the paper's data, must not be redistributed. Here the seen motions are disjoint seconds of the shipped CMU
takes, mirror images of some of them, walks and splines. The unseen motions are the 20 clips of DeepMimic, which no
training here uses; they are read from a folder or from an installed pybullet. Walks and splines with other seeds form a
third kind, `procedural`, because motions from the same generators are in the training data.

There are 16 training people. 8 new identities, each in its own rest pose, are moved in `test`, and 8 others in `val`;
every trial has a new driving person. `val` does not use the DeepMimic clips: its unseen motions are other seconds of
the takes. All motions begin facing +z and have 30 frames. AniFormer takes 30 evenly spaced frames of each of its
motions; here a motion is one second.
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
from .pairs import Pair, Person, Pose, human, make_pair, random_orders, reorder_vertices
from .protocols import Protocol
from .remesh import template

FRAMES = 30
FPS = 30.0
SEEN = {"seconds": 43, "mirrored": 13, "walks": 12, "splines": 12}
"""Number of seen motions of each source, 80 together; the `train` windows of the takes have 43 whole seconds."""
STRIDE = 37
"""Trial i of `seen` uses motion 37 i mod 80. 37 and 80 have no common factor, so 80 trials use every motion once, and
the first few trials cover all sources."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ClipPair(Pair):
    """A trial of a clip protocol, in metres; the fields of `Pair` are those of its first frame.

    All frames have the same vertex order: that of the identity (V) or that of the driving mesh (U).
    """

    clip: Clip
    """The driving clip; its mesh is `driving`."""
    truth_frames: Float[np.ndarray, "T V 3"]
    """The true result in all frames."""
    aligned_frames: Float[np.ndarray, "T V 3"]
    """The driving person with true correspondence in all frames."""
    template: Int[np.ndarray, "N 2"]
    """Identity and driving vertex of each vertex of LIMP's template (`remesh.template`)."""

    def frame(self, t: int) -> Pair:
        """Return frame t as a pair of meshes."""
        mesh = dataclasses.replace(self.driving, vertices=self.clip.vertices[t])
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(Pair)}
        return Pair(**{**fields, "driving": mesh, "truth": self.truth_frames[t], "aligned": self.aligned_frames[t]})


@dataclass(frozen=True)
class ClipsAniformer(Protocol):
    """The protocol of this module."""

    data: Path | None = None
    """Folder of the DeepMimic clips; None for that of an installed pybullet."""
    people: int = 16
    """Number of training people."""
    targets: int = 8
    """Number of identities of each split (AniFormer calls them targets)."""

    def count(self, kind: str, requested: int = 0) -> int:
        """Return the number of trials to measure, at most as many as the kind has: by default 24, 20 and 20."""
        available = {"seen": sum(SEEN.values()), "unseen": len(CLIPS), "procedural": len(CLIPS)}[kind]
        return min(requested or self.pairs, available)

    def check(self, split: str) -> None:
        """Raise InputError for `train`, which has no trials, and for `test` if the DeepMimic clips are missing."""
        self._check_name(split)
        if split == "test":
            deepmimic_folder(self.data)

    def _check_name(self, split: str) -> None:
        if split not in ("val", "test"):
            raise InputError(f"{split}: expected val or test of {self.name}, found a split without trials; choose one")

    def train_people(self, body: RiggedBody) -> Float[np.ndarray, "P K"]:
        """Return the shape coefficients of the 16 training people."""
        return np.stack([sample_shape(body, self.seed("train"), i, self.spread) for i in range(self.people)])

    def train_motions(self, body: RiggedBody) -> Float[np.ndarray, "N T J 3 3"]:
        """Return the joint rotations of the 80 seen motions."""
        return np.stack([motion.rotmat for motion in self.seen(body)])

    def train_paths(self, body: RiggedBody) -> Float[np.ndarray, "N T 3"]:
        """Return the root paths of the 80 seen motions (metres, for the body's mean shape)."""
        return np.stack([motion.root for motion in self.seen(body)])

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
        if split == "val":
            return _val_motions()[i % len(_val_motions())]
        return _deepmimic_second(deepmimic_folder(self.data), tuple(CLIPS)[i % len(CLIPS)])

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> ClipPair:
        """Generate trial i in the body's vertex order; everything is drawn from seeds and nothing from `rng`."""
        self._check_name(split)
        motion, target = self.motion(split, kind, i), i % self.targets
        identity = Person(human(), sample_shape(human(), self.seed(split), target, self.spread), str(target))
        number = 1000 * self.kinds.index(kind) + i
        shape = sample_shape(human(), self.seed(f"{split}/actors"), number, self.spread)
        rest = Pose(rotvec_to_rotmat(sample_pose(human(), self.seed(split), target)), str(target))
        first = make_pair(identity, Person(human(), shape, str(number)), rest, Pose(motion.rotmat[0], motion.name))
        clip, truth = (motion_clip(human(), person, motion) for person in (shape, identity.shape))
        fields = {field.name: getattr(first, field.name) for field in dataclasses.fields(Pair)}
        # The clip also has the motion's root path, which a pair of poses has not.
        fields |= {"driving": dataclasses.replace(first.driving, vertices=clip.vertices[0])}
        fields |= {"truth": truth.vertices[0], "aligned": clip.vertices[0]}
        return ClipPair(
            **fields,
            clip=dataclasses.replace(clip, mesh=fields["driving"]),
            truth_frames=truth.vertices,
            aligned_frames=clip.vertices,
            template=template().corners[:, :2],
        )

    def pair(self, split: str, kind: str, i: int) -> ClipPair:
        """Generate trial i as methods get it: vertices shuffled, with one order for all frames."""
        rng = self.rng(split, kind, i)
        unshuffled = self.unshuffled_pair(split, kind, i, rng)
        orders = order, driving_order = random_orders(unshuffled, rng)
        first = reorder_vertices(unshuffled, order, driving_order)
        columns = zip(orders, unshuffled.template.T, strict=True)
        return dataclasses.replace(
            first,
            clip=Clip(first.driving, unshuffled.clip.vertices[:, driving_order], unshuffled.clip.fps),
            truth_frames=unshuffled.truth_frames[:, order],
            aligned_frames=unshuffled.aligned_frames[:, order],
            # Vertex numbers follow by the inverse orders.
            template=np.stack([np.argsort(new_order)[vertices] for new_order, vertices in columns], axis=1),
        )  # pyright: ignore[reportReturnType] (replace keeps the class)


def on_template(trial: ClipPair) -> ClipPair:
    """Restrict a trial to the vertices of LIMP's template, in the template's order; extra inputs are dropped."""
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
    """Return the protocol; `data` is the folder of the DeepMimic clips, None for that of an installed pybullet.

    Raises:
        InputError: the folder lacks one of the 20 clips.
    """
    data = data and deepmimic_folder(data)
    return ClipsAniformer("clips-aniformer", 1, ("seen", "unseen", "procedural"), pairs=24, spread=1.1, data=data)


CLIPS_ANIFORMER = clips_aniformer()


@cache
def _seen_motions(body: RiggedBody, seed: int) -> tuple[Motion, ...]:
    """Make the 80 seen motions: seconds of the takes, mirror images of some of them, walks and splines."""
    seconds = [second for take in split_windows("train") for second in _split_into_seconds(take)]
    mirrored = np.linspace(0, len(seconds) - 1, SEEN["mirrored"]).round().astype(int)
    length = {"seconds": FRAMES / FPS, "fps": FPS}
    return (
        *seconds,
        *(mirror(seconds[k]) for k in mirrored),
        *(_begin_at_origin(walk_motion(body, seed, k, **length)) for k in range(SEEN["walks"])),
        *(_begin_at_origin(spline_motion(body, seed, k, **length)) for k in range(SEEN["splines"])),
    )


@cache
def _val_motions() -> tuple[Motion, ...]:
    """Return the unseen motions of `val`: seconds of the takes that no training uses, and their mirror images."""
    seconds = [second for take in split_windows("val") for second in _split_into_seconds(take)]
    return (*seconds, *map(mirror, seconds))


@cache
def _deepmimic_second(folder: Path, name: str) -> Motion:
    """Read the middle second of a DeepMimic clip; a clip shorter than a second is slowed down to one second."""
    motion = load_deepmimic(folder / CLIPS[name], human(), name)
    if motion.seconds < FRAMES / FPS:
        motion = resample(motion, motion.fps * (FRAMES - 1) / (len(motion) - 1))
        return _begin_at_origin(dataclasses.replace(motion, fps=FPS))
    motion = resample(motion, FPS)
    return _cut(motion, (len(motion) - FRAMES) // 2, name)


def _split_into_seconds(take: Motion) -> list[Motion]:
    """Split a take into consecutive disjoint windows of 30 frames; a shorter remainder is dropped."""
    starts = range(0, len(take) - FRAMES + 1, FRAMES)
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
