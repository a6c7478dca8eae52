"""Named test sets, generated from seeds: pairs of an identity and a driving mesh, with the true result.

`human-npt` is the protocol of the NPT paper (section 4.1): 16 training people x 400 poses of Table 6, 14 new people,
and 72 test pairs each with a driving pose of the training (`seen`) and with a new one (`unseen`). Both meshes of a pair
are new people; the identity is in a training pose. All other protocols have new people and new poses in every split.
`train`, `val` and `test` are disjoint, except for the driving people of `clips-ordered`, who are those of the training.
A pair takes milliseconds and is generated on demand; only meshings are cached.
"""

from __future__ import annotations

import dataclasses
import zlib
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal, get_args

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody, load_body
from ..bodies.contacts import CONTACTS, touching
from ..bodies.quadruped import LIMITS, USUAL, lowered_head, postures
from ..bodies.sampling import JOINT_LIMITS, lowered_arms, rotvec_to_rotmat, sample_pose, sample_shape
from ..motions import pose_bank
from ..motions.gaits import quadruped_poses
from . import remesh
from .pairs import Pair, Person, Pose, human, make_pair, remesh_driving

Split = Literal["train", "val", "test"]
SPLITS: tuple[str, ...] = get_args(Split)


@dataclass(frozen=True)
class Protocol:
    """A test set: pair `i` of a split and kind is a pure function of the name, the version and `i`."""

    body: ClassVar[str] = "human"
    """Shipped body whose joints its meshes have."""
    name: str
    version: int
    kinds: tuple[str, ...]
    """Kinds of pairs; each is a column of the protocol's table."""
    pairs: int
    """Number of pairs of each kind."""
    spread: float
    """Standard deviation of the shape coefficients."""

    def seed(self, split: str) -> int:
        """Return the seed of a stream of samples: a checksum of the protocol's name, version and the stream's name."""
        return zlib.crc32(f"{self.name}/{self.version}/{split}".encode())

    def rng(self, split: str, kind: str, i: int) -> np.random.Generator:
        """Return the random generator of pair `i`.

        Kinds are numbered from the last one, so that a kind added in front leaves the pairs of all others as they are.
        """
        return np.random.default_rng([self.seed(split), len(self.kinds) - 1 - self.kinds.index(kind), i])

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        """Generate pair `i` with its vertices in the order of the body. Each protocol defines this method."""
        raise NotImplementedError

    def pair(self, split: str, kind: str, i: int) -> Pair:
        """Generate pair `i` with the vertices of both meshes shuffled, as methods get it."""
        rng = self.rng(split, kind, i)
        return self.unshuffled_pair(split, kind, i, rng).shuffled(rng)

    def count(self, kind: str, requested: int = 0, split: str = "test") -> int:
        """Return the number of pairs of a kind to measure: the requested number, or the protocol's own for 0."""
        assert kind in self.kinds
        return requested or self.pairs

    def check(self, split: str) -> None:
        """Raise InputError if this split cannot be generated on this machine. The base class has no such split."""

    def left_out(self, split: str) -> dict[str, int]:
        """Count the files of a split that cannot be used, by reason; empty for protocols that read none."""
        return {}


@dataclass(frozen=True)
class HumanNpt(Protocol):
    """NPT, section 4.1: people in poses of Table 6, either training poses (`seen`) or new ones (`unseen`)."""

    people: int = 16
    """Number of training people."""
    poses: int = 400
    """Number of training poses."""
    new_people: int = 14
    """Number of people of each of `val` and `test`."""

    def train_people(self, body: RiggedBody) -> Float[np.ndarray, "P K"]:
        """Return the shape coefficients of the training people."""
        return np.stack([sample_shape(body, self.seed("train"), i, self.spread) for i in range(self.people)])

    def train_poses(self, body: RiggedBody) -> Float[np.ndarray, "N J 3"]:
        """Return the rotation vectors (radians) of the training poses, which all training people share."""
        return np.stack([sample_pose(body, self.seed("train"), i) for i in range(self.poses)])

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        identity, driving = rng.choice(self.new_people, 2, replace=False)
        rest_pose, seen_pose = rng.choice(self.poses, 2, replace=False)
        # 10,000 lies beyond the numbers of the training poses, so `unseen` never repeats one of them.
        unseen_pose = self.pose(split, 10_000 + i)
        return make_pair(
            self.person(split, int(identity)),
            self.person(split, int(driving)),
            self.pose("train", int(rest_pose)),
            self.pose("train", int(seen_pose)) if kind == "seen" else unseen_pose,
        )

    def person(self, split: str, i: int) -> Person:
        """Return person `i`: one of the 14 new people of `val` or `test`, or of the 16 people of `train`."""
        return Person(human(), sample_shape(human(), self.seed(split), i, self.spread), str(i))

    def pose(self, split: str, i: int) -> Pose:
        """Return pose `i`, drawn from the ranges of Table 6 of the NPT paper's supplement."""
        return Pose(rotvec_to_rotmat(sample_pose(human(), self.seed(split), i)), str(i))


@dataclass(frozen=True)
class Wide(Protocol):
    """Everyday use: identities at rest or in a pose of Table 6, driving people in poses of all kinds."""

    heading: float = 45.0
    """Largest angle (degrees) by which driving people are turned about the vertical, to either side."""

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        people = self.sample_people(human(), human(), split, kind, i)
        return make_pair(
            *people, self.sample_rest_pose(split, kind, i, rng), self.sample_driving_pose(split, kind, i, rng)
        )

    def sample_people(
        self, identity_body: RiggedBody, driving_body: RiggedBody, split: str, kind: str, i: int
    ) -> tuple[Person, Person]:
        """Draw the identity person and the driving person; every pair has two new people."""
        seed = self.seed(f"{split}/{kind}")
        return tuple(
            Person(body, sample_shape(human(), seed, 2 * i + k, self.spread), str(2 * i + k))
            for k, body in enumerate((identity_body, driving_body))
        )  # pyright: ignore[reportReturnType] (two bodies, two people)

    def sample_rest_pose(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pose:
        """Draw a pose that characters are modelled in: arms between the T-pose and straight down, or a Table 6 pose."""
        rotvec = rng.random() * lowered_arms(human())
        if rng.random() < 0.5:
            rotvec = sample_pose(human(), self.seed(f"{split}/{kind}"), 10_000 + i)
        return Pose(rotvec_to_rotmat(rotvec), f"{kind}{10_000 + i}")

    def sample_driving_pose(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pose:
        """Draw a driving pose with a heading.

        By kind: within the joint limits (`limits`), of Table 6 (`table6`), or a frame of the split's motions (others),
        which in `val` and `test` are later seconds of the takes that are trained on.
        """
        seed = self.seed(f"{split}/{kind}")
        if kind == "limits":
            rotvec = sample_pose(human(), seed, i, JOINT_LIMITS)
        elif kind == "table6":
            rotvec = sample_pose(human(), seed, i)
        else:
            bank = split_pose_bank(split)
            rotvec = bank[rng.integers(len(bank))].astype(np.float64)
        return Pose(with_heading(rotvec, self.heading, rng), f"{kind}{i}")


def with_heading(
    rotvec: Float[np.ndarray, "J 3"], largest: float, rng: np.random.Generator
) -> Float[np.ndarray, "J 3 3"]:
    """Return the rotations of a pose, turned about the vertical by up to `largest` degrees to either side."""
    rotmat = rotvec_to_rotmat(rotvec)
    turn = np.radians(largest) * rng.uniform(-1, 1)
    rotmat[0] = rotvec_to_rotmat(np.array([0.0, turn, 0.0])) @ rotmat[0]
    return rotmat


@dataclass(frozen=True)
class Touching(Wide):
    """People whose limbs touch themselves: points near the contact are close to two limbs but belong to one of them.

    Of every three pairs, both people of the first touch themselves, only the identity of the second, and only the
    driving person of the third.
    """

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        people = self.sample_people(human(), human(), split, kind, i)
        seed = self.seed(f"{split}/{kind}")
        poses = []
        for k, person in enumerate(people):  # k = 0: identity, k = 1: driving
            pose = rng.random() * lowered_arms(human())
            if k == 1:
                pose = pose + sample_pose(human(), seed, i)
            if i % 3 != 2 - k:
                pose = touching(human(), person.shape, pose, kind, rng)
            poses.append(Pose(rotvec_to_rotmat(pose), f"{kind}{2 * i + k}"))
        return make_pair(*people, *poses)


@dataclass(frozen=True)
class Corrupted(HumanNpt):
    """Pairs in poses of Table 6 whose driving mesh is changed afterwards.

    All kinds have the same people and poses, so only the change of the driving mesh differs.
    """

    def clean_pair(self, split: str, i: int) -> Pair:
        """Generate pair `i` with the driving mesh unchanged."""
        rng = np.random.default_rng([self.seed(split), len(self.kinds), i])
        return super().unshuffled_pair(split, "unseen", i, rng)


@dataclass(frozen=True)
class CrossTopology(Corrupted):
    """Pairs whose driving mesh has other vertices and triangles than the identity."""

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        pair = self.clean_pair(split, i)
        if kind == "points":
            return remesh_driving(pair, remesh.points(human(), 4096, rng))
        return remesh_driving(pair, MESHINGS[kind]())


@dataclass(frozen=True)
class Noise(Corrupted):
    """Pairs whose driving mesh is noisy or incomplete.

    `noise-2`: uniform noise of up to 2 % of the mesh's radius on each coordinate of each driving vertex, and so on.
    """

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        pair = self.clean_pair(split, i)
        if kind.startswith("noise-"):
            vertices = pair.driving.vertices
            radius = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max()
            amplitude = int(kind.removeprefix("noise-")) / 100 * radius
            vertices = vertices + amplitude * rng.uniform(-1, 1, vertices.shape)
            driving = dataclasses.replace(pair.driving, vertices=vertices)
            return dataclasses.replace(pair, driving=driving, aligned=vertices)
        if kind == "holes":
            return remesh_driving(pair, remesh.holes(human(), rng))
        if kind == "cropped":
            return remesh_driving(pair, remesh.cropped(human(), rng))
        return remesh_driving(pair, remesh.half(human(), pair.driving.vertices, rng))


MESHINGS = {"decimated": remesh.decimated, "retriangulated": remesh.retriangulated, "subdivided": remesh.subdivided}
"""Kinds of `cross-topology` that are surfaces, and the functions that make these meshings of the body."""
HUMAN_NPT = HumanNpt("human-npt", 1, ("seen", "unseen"), pairs=72, spread=1.1)
HUMAN_WIDE = Wide("human-wide", 1, ("limits", "clips"), pairs=36, spread=1.3)
CROSS_TOPOLOGY = CrossTopology("cross-topology", 1, (*MESHINGS, "points"), pairs=18, spread=1.1)
NOISE = Noise(
    "noise", 1, (*(f"noise-{percent}" for percent in range(6)), "holes", "cropped", "half"), pairs=18, spread=1.1
)
CONTACT = Touching("contact", 1, tuple(CONTACTS), pairs=18, spread=1.1)
_ALL = (HUMAN_NPT, HUMAN_WIDE, CROSS_TOPOLOGY, NOISE, CONTACT)
PROTOCOLS: dict[str, Protocol] = {protocol.name: protocol for protocol in _ALL}
"""Protocols that need no files; `run.find_protocol` also gives those that read a folder."""


@cache
def split_pose_bank(split: Literal["train", "val", "test"]) -> np.ndarray:
    """Return the poses (N, J, 3), rotation vectors in radians, of every third frame of a split's shipped motions."""
    return pose_bank(split)


@cache
def quadruped() -> RiggedBody:
    """Return the shipped quadruped, read once."""
    return load_body("quadruped")


@cache
def split_poses(split: Literal["train", "val", "test"]) -> np.ndarray:
    """Return the frames of the split's gaits and postures."""
    return quadruped_poses(quadruped(), split)


@dataclass(frozen=True)
class Quadruped(Protocol):
    """Identities standing or with a lowered head, or in an everyday pose; driving animals in poses of the kind."""

    body: ClassVar[str] = "quadruped"
    heading: float = 45.0
    """Largest angle (degrees) by which driving animals are turned about the vertical, to either side."""

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        body, seed = quadruped(), self.seed(f"{split}/{kind}")
        identity, driving = (
            Person(body, sample_shape(body, seed, 2 * i + k, self.spread), str(2 * i + k)) for k in range(2)
        )
        rest = lowered_head(body, rng.random(3))
        if rng.random() < 0.5:
            rest = sample_pose(body, seed, 10_000 + i, USUAL)
        if kind == "gaits":
            assert split in ("train", "val", "test")
            frames = split_poses(split)
            pose = frames[rng.integers(len(frames))].astype(np.float64)
        else:
            pose = sample_pose(body, seed, i, LIMITS if kind == "limits" else USUAL)
        stands = postures(body)
        rest, pose = (
            angles if limited else angles + rng.random() * stands[rng.integers(len(stands))]
            for angles, limited in ((rest, False), (pose, kind == "limits"))
        )
        turned = Pose(with_heading(pose, self.heading, rng), f"{kind}{i}")
        return make_pair(identity, driving, Pose(rotvec_to_rotmat(rest), f"{kind}{10_000 + i}"), turned)


QUADRUPED = Quadruped("quadruped", 1, ("gaits", "usual", "limits"), 72, 1.0)
