"""Named test sets, shipped as seeds: who poses, who is moved, and the truth. `train`, `val` and `test` are disjoint.

`human-npt` is the paper's: 16 training people x 400 Table 6 poses; 14 new people; 72 pairs whose driving pose was in
the training and 72 whose pose was not. Both meshes of a pair are new people; the identity stands in a training pose.
The others have new people and new poses in every split. Pairs are made when asked for, in milliseconds; nothing is
cached but the meshings.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.contacts import CONTACTS, touching
from ..bodies.dress import GARMENTS, dressed_body
from ..bodies.sampling import JOINT_LIMITS, lowered_arms, rotvec_to_rotmat, sample_pose, sample_shape
from ..motions import pose_bank
from . import remesh
from .pairs import Pair, Person, Pose, human, remeshed, shuffled, stage

Split = Literal["train", "val", "test"]
SPLITS: tuple[str, ...] = get_args(Split)


@dataclass(frozen=True)
class Protocol:
    """A test set: pair `i` of a split and kind is a pure function of the name, the version and `i`."""

    name: str
    version: int
    kinds: tuple[str, ...]
    """The columns of its table."""
    pairs: int
    """Of each kind."""
    spread: float
    """Standard deviation of the shape coefficients."""

    def seed(self, split: str) -> int:
        """Seed of one stream of samples: a hash of the protocol's name, version and the stream's name."""
        return zlib.crc32(f"{self.name}/{self.version}/{split}".encode())

    def rng(self, split: str, kind: str, i: int) -> np.random.Generator:
        """All that is random in one pair. Kinds count from the last, so that one put in front changes no other."""
        return np.random.default_rng([self.seed(split), len(self.kinds) - 1 - self.kinds.index(kind), i])

    def whole(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        """Pair `i` with its vertices in the order of the body: what each protocol defines."""
        raise NotImplementedError

    def pair(self, split: str, kind: str, i: int) -> Pair:
        """Pair `i` as methods get it: shuffled."""
        rng = self.rng(split, kind, i)
        return shuffled(self.whole(split, kind, i, rng), rng)

    def count(self, kind: str, asked: int = 0) -> int:
        """How many pairs of a kind are measured, if so many are asked for (0: as many as usual)."""
        assert kind in self.kinds
        return asked or self.pairs

    def check(self, split: str) -> None:
        """Raise InputError if this split cannot be made here, before any of it is."""

    def trials(self, split: str, kind: str, count: int = 0) -> Iterator[Pair]:
        """The pairs of a split and kind, the first `count` of them if given."""
        return (self.pair(split, kind, i) for i in range(self.count(kind, count)))


@dataclass(frozen=True)
class HumanNpt(Protocol):
    """NPT 4.1: Table 6 poses, seen in the training or not."""

    people: int = 16
    poses: int = 400
    new_people: int = 14

    def train_people(self, body: RiggedBody) -> Float[np.ndarray, "P K"]:
        """Shape coefficients of the training people."""
        return np.stack([sample_shape(body, self.seed("train"), i, self.spread) for i in range(self.people)])

    def train_poses(self, body: RiggedBody) -> Float[np.ndarray, "N J 3"]:
        """Rotation vectors of the training poses, shared by all people."""
        return np.stack([sample_pose(body, self.seed("train"), i) for i in range(self.poses)])

    def whole(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        mover, actor = rng.choice(self.new_people, 2, replace=False)
        stand, played = rng.choice(self.poses, 2, replace=False)
        unseen = self.pose(split, 10_000 + i)
        return stage(
            self.person(split, int(mover)),
            self.person(split, int(actor)),
            self.pose("train", int(stand)),
            self.pose("train", int(played)) if kind == "seen" else unseen,
        )

    def person(self, split: str, i: int) -> Person:
        """One of the 14 new people of `val` or `test`, or of the 16 of `train`."""
        return Person(human(), sample_shape(human(), self.seed(split), i, self.spread), str(i))

    def pose(self, split: str, i: int) -> Pose:
        """A Table 6 pose."""
        return Pose(rotvec_to_rotmat(sample_pose(human(), self.seed(split), i)), str(i))


@dataclass(frozen=True)
class Wide(Protocol):
    """Everyday use: identities at rest or in Table 6, driving people anywhere in the joint limits or in real motion."""

    heading: float = 45.0
    """Driving people look up to this many degrees to either side."""

    def whole(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        return stage(*self.people(human(), human(), split, kind, i), self.rest(split, kind, i, rng),
                     self.played(split, kind, i, rng))  # fmt: skip

    def people(self, mover: RiggedBody, actor: RiggedBody, split: str, kind: str, i: int) -> tuple[Person, Person]:
        """Two new people for every pair."""
        seed = self.seed(f"{split}/{kind}")
        return tuple(
            Person(body, sample_shape(human(), seed, 2 * i + k, self.spread), str(2 * i + k))
            for k, body in enumerate((mover, actor))
        )  # pyright: ignore[reportReturnType] (two bodies, two people)

    def rest(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pose:
        """Arms anywhere between the T and hanging, or a Table 6 pose: the poses that characters are modelled in."""
        rotvec = rng.random() * lowered_arms(human())
        if rng.random() < 0.5:
            rotvec = sample_pose(human(), self.seed(f"{split}/{kind}"), 10_000 + i)
        return Pose(rotvec_to_rotmat(rotvec), f"{kind}{10_000 + i}")

    def played(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pose:
        """A frame of a motion of this split, a pose within the joint limits, or a Table 6 pose; and a heading."""
        seed = self.seed(f"{split}/{kind}")
        if kind == "limits":
            rotvec = sample_pose(human(), seed, i, JOINT_LIMITS)
        elif kind == "table6":
            rotvec = sample_pose(human(), seed, i)
        else:
            bank = bank_of(split)
            rotvec = bank[rng.integers(len(bank))].astype(np.float64)
        rotmat = rotvec_to_rotmat(rotvec)
        turn = np.radians(self.heading) * rng.uniform(-1, 1)
        rotmat[0] = rotvec_to_rotmat(np.array([0.0, turn, 0.0])) @ rotmat[0]
        return Pose(rotmat, f"{kind}{i}")


@dataclass(frozen=True)
class Dressed(Wide):
    """People in the base mesh's own skirt, tights and hair, in Table 6 poses: who is dressed is the kind."""

    def whole(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        worn = [wearing(tuple(name for name in GARMENTS if rng.random() < 0.6) or GARMENTS[-1:]) for _ in range(2)]
        mover = human() if kind == "driving" else worn[0]
        actor = human() if kind == "identity" else worn[1]
        pose = self.played(split, "table6", i, rng)
        pair = stage(*self.people(mover, actor, split, kind, i), self.rest(split, kind, i, rng), pose)
        return pair if mover is actor else dataclasses.replace(pair, aligned_reference=None)


@dataclass(frozen=True)
class Touching(Wide):
    """Limbs that touch: a place on the surface is then near two limbs, and only one of them holds it.

    Of three pairs, in one both people touch themselves, in one the mover alone, in one the actor alone.
    """

    def whole(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        people = self.people(human(), human(), split, kind, i)
        seed = self.seed(f"{split}/{kind}")
        poses = []
        for k, person in enumerate(people):
            pose = rng.random() * lowered_arms(human())
            if k == 1:
                pose = pose + sample_pose(human(), seed, i)
            if i % 3 != 2 - k:
                pose = touching(human(), person.shape, pose, kind, rng)
            poses.append(Pose(rotvec_to_rotmat(pose), f"{kind}{2 * i + k}"))
        return stage(*people, *poses)


@dataclass(frozen=True)
class Corrupted(HumanNpt):
    """Table 6 poses, and the same people and poses in all kinds: only what is done to the driving mesh differs."""

    def clean(self, split: str, i: int) -> Pair:
        """Pair `i` before anything is done to it."""
        return super().whole(split, "unseen", i, np.random.default_rng([self.seed(split), len(self.kinds), i]))


@dataclass(frozen=True)
class CrossTopology(Corrupted):
    """The driving mesh has other vertices and triangles than the identity."""

    def whole(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        pair = self.clean(split, i)
        if kind == "points":
            return remeshed(pair, remesh.points(human(), 4096, rng))
        return remeshed(pair, MESHINGS[kind]())


@dataclass(frozen=True)
class Noise(Corrupted):
    """The driving mesh is noisy or incomplete.

    `noise-2`: each coordinate of each driving vertex moves by up to 2 % of the mesh's radius (uniform), and so on.
    """

    def whole(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        pair = self.clean(split, i)
        if kind.startswith("noise-"):
            return self.noisy(pair, int(kind.removeprefix("noise-")) / 100, rng)
        if kind == "holes":
            return remeshed(pair, remesh.holes(human(), rng))
        if kind == "cropped":
            return remeshed(pair, remesh.cropped(human(), rng))
        return remeshed(pair, remesh.half(human(), pair.driving.vertices, rng))

    def noisy(self, pair: Pair, share: float, rng: np.random.Generator) -> Pair:
        """Uniform noise on the driving's coordinates, and alike on the driving as `copy` gets it."""
        moved = with_noise(pair.driving.vertices, share, rng)
        spoilt = dataclasses.replace(pair.driving, vertices=moved)
        return dataclasses.replace(pair, driving=spoilt, aligned=moved)


def with_noise(vertices: Float[np.ndarray, "V 3"], share: float, rng: np.random.Generator) -> Float[np.ndarray, "V 3"]:
    """Points with uniform noise on their coordinates, up to a share of their radius."""
    radius = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max()
    return vertices + share * radius * rng.uniform(-1, 1, vertices.shape)


MESHINGS = {
    "decimated": remesh.decimated,
    "retriangulated": remesh.retriangulated,
    "subdivided": remesh.subdivided,
}
HUMAN_NPT = HumanNpt("human-npt", 1, ("seen", "unseen"), pairs=72, spread=1.1)
HUMAN_WIDE = Wide("human-wide", 1, ("limits", "clips"), pairs=36, spread=1.3)
CROSS_TOPOLOGY = CrossTopology("cross-topology", 1, (*MESHINGS, "points"), pairs=18, spread=1.1)
NOISE = Noise(
    "noise", 1, (*(f"noise-{percent}" for percent in range(6)), "holes", "cropped", "half"), pairs=18, spread=1.1
)
DRESSED = Dressed("dressed", 1, ("identity", "driving", "both"), pairs=18, spread=1.3)
CONTACT = Touching("contact", 1, tuple(CONTACTS), pairs=18, spread=1.1)
_ALL = (HUMAN_NPT, HUMAN_WIDE, CROSS_TOPOLOGY, NOISE, DRESSED, CONTACT)
PROTOCOLS: dict[str, Protocol] = {protocol.name: protocol for protocol in _ALL}


@cache
def wearing(garments: tuple[str, ...]) -> RiggedBody:
    """The shipped body in some garments."""
    return dressed_body(human(), garments)


@cache
def bank_of(split: Literal["train", "val", "test"]) -> np.ndarray:
    """Frames of the shipped motions of a split."""
    return pose_bank(split)
