"""Named test sets, shipped as seeds: who poses, who is moved, and the truth. `train`, `val` and `test` are disjoint.

`human-npt` is the paper's: 16 training people x 400 Table 6 poses; 14 new people; 72 pairs whose driving pose was in
the training and 72 whose pose was not. Both meshes of a pair are new people; the identity stands in a training pose.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from ..mesh import Mesh, permute_vertices

Split = Literal["train", "val", "test"]


@dataclass(frozen=True)
class Pair:
    """One trial in metres. Identity and truth share vertex order; `aligned` is the driving mesh in that order too."""

    identity: Mesh
    driving: Mesh
    truth: Float[np.ndarray, "V 3"]
    aligned: Float[np.ndarray, "V 3"]
    """The driving vertices with true correspondence: what the row `copy` is made of, given to no method."""
    height: float
    """The identity person's height at rest in metres."""


@dataclass(frozen=True)
class PoseTransferProtocol:
    """People and poses of a pose-transfer test by name, version and seeds."""

    name: str
    version: int
    people: int
    poses: int
    new_people: int
    pairs: int
    spread: float
    """Standard deviation of the shape coefficients."""

    def seed(self, split: str) -> int:
        """Seed of one stream of samples: a hash of the protocol's name, version and the stream's name."""
        return zlib.crc32(f"{self.name}/{self.version}/{split}".encode())

    def train_people(self, body: RiggedBody) -> Float[np.ndarray, "P K"]:
        """Shape coefficients of the training people."""
        return np.stack([sample_shape(body, self.seed("train"), i, self.spread) for i in range(self.people)])

    def train_poses(self, body: RiggedBody) -> Float[np.ndarray, "N J 3"]:
        """Rotation vectors of the training poses, shared by all people."""
        return np.stack([sample_pose(body, self.seed("train"), i) for i in range(self.poses)])

    def trials(
        self, body: RiggedBody, split: Split, poses: Literal["seen", "unseen"], count: int = 0
    ) -> Iterator[Pair]:
        """The pairs of a split, the first `count` of them if given; vertices are shuffled anew for every mesh."""
        people = np.stack([sample_shape(body, self.seed(split), i, self.spread) for i in range(self.new_people)])
        for i in range(count or self.pairs):
            rng = np.random.default_rng(np.random.SeedSequence([self.seed(split), poses == "seen", i]))
            mover, actor = rng.choice(self.new_people, 2, replace=False)
            stand, played = rng.choice(self.poses, 2, replace=False)
            rest = sample_pose(body, self.seed("train"), int(stand))
            if poses == "seen":
                pose = sample_pose(body, self.seed("train"), int(played))
            else:
                pose = sample_pose(body, self.seed(split), 10_000 + i)
            yield self._pair(body, people[mover], people[actor], rest, pose, rng)

    def _pair(self, body, mover, actor, rest, pose, rng) -> Pair:
        identity, truth, driving = (
            body.posed(shape, rotvec_to_rotmat(rotation))
            for shape, rotation in ((mover, rest), (mover, pose), (actor, pose))
        )
        order, driving_order = (rng.permutation(len(truth)) for _ in range(2))
        height = float(np.ptp(body.shaped(mover)[0][:, 1]))
        return Pair(
            permute_vertices(body.mesh(identity), order),
            permute_vertices(body.mesh(driving), driving_order),
            truth[order],
            driving[order],
            height,
        )


HUMAN_NPT = PoseTransferProtocol("human-npt", 1, people=16, poses=400, new_people=14, pairs=72, spread=1.1)
