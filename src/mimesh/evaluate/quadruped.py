"""`quadruped`: new animals of the shipped quadruped in gaits, everyday poses and poses within the joint limits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal

import numpy as np

from ..bodies import RiggedBody, load_body
from ..bodies.quadruped import LIMITS, USUAL, lowered_head, postures
from ..bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from ..motions.gaits import quadruped_poses
from .pairs import Pair, Person, Pose, make_pair
from .protocols import Protocol


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
        rotmat = rotvec_to_rotmat(pose)
        turn = np.radians(self.heading) * rng.uniform(-1, 1)
        rotmat[0] = rotvec_to_rotmat(np.array([0.0, turn, 0.0])) @ rotmat[0]
        still = Pose(rotvec_to_rotmat(rest), f"{kind}{10_000 + i}")
        return make_pair(identity, driving, still, Pose(rotmat, f"{kind}{i}"))


QUADRUPED = Quadruped("quadruped", 1, ("gaits", "usual", "limits"), 72, 1.0)
