"""Draw pairs from registered meshes: a truth, its person in another pose, and another person in its pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

HELD_OUT = 10
"""One in so many people, and poses, is held out for validation: the last ones by name, rounded up."""
LEAST = 3
"""People, and poses, from which on some are held out: the training needs two of each."""


@dataclass(frozen=True, eq=False)
class MeshTable:
    """Who is in which pose: one row for each of K meshes or clips, whose frames follow each other in one array."""

    person: Int[np.ndarray, " K"]
    pose: Int[np.ndarray, " K"]
    """Of clips: the motion."""
    first: Int[np.ndarray, " K"]
    """Number of its first frame."""
    length: Int[np.ndarray, " K"]
    """Number of its frames; 1 for a mesh. All clips of a motion have one length."""


@dataclass(frozen=True)
class Frames:
    """The frames of B pairs. Driving and truth are windows of the same frames of two people's clips."""

    identity: Int[Tensor, " B"]
    driving: Int[Tensor, "B T"]
    truth: Int[Tensor, "B T"]


@dataclass(frozen=True)
class Choices:
    """Rows of the table that may stand beside each of R truths: those of its group, without itself."""

    rows: Int[Tensor, " N"]
    """All that may be chosen, group by group."""
    start: Int[Tensor, " R"]
    """Where the group of each truth begins."""
    count: Int[Tensor, " R"]
    """How many there are beside the truth."""
    own: Int[Tensor, " R"]
    """Where the truth itself stands, which is left out; the number of rows where it is not among them."""

    @classmethod
    def of(
        cls, group: Int[np.ndarray, " K"], allowed: Bool[np.ndarray, " K"], truths: Int[np.ndarray, " R"]
    ) -> Choices:
        """List the allowed rows beside each truth."""
        rows = np.flatnonzero(allowed)
        rows = rows[np.argsort(group[rows], kind="stable")]
        start, stop = (np.searchsorted(group[rows], group[truths], side) for side in ("left", "right"))
        place = np.full(len(group), len(rows))
        place[rows] = np.arange(len(rows))
        count = stop - start - allowed[truths]
        return cls(*(torch.from_numpy(array) for array in (rows, start, count, place[truths])))

    def to(self, device: torch.device) -> Choices:
        """Copy to a device."""
        return Choices(*(tensor.to(device) for tensor in (self.rows, self.start, self.count, self.own)))

    def pick(self, truth: Int[Tensor, " B"], share: Float[Tensor, " B"]) -> Int[Tensor, " B"]:
        """Pick for some truths a row, at a share from 0 to 1 of what there is; the truth itself if there is nothing."""
        place = self.start[truth] + (share * self.count[truth]).long()
        place = place + (place >= self.own[truth])
        place = torch.where(self.count[truth] > 0, place, self.own[truth])
        return self.rows[place.clamp_max(len(self.rows) - 1)]


@dataclass(frozen=True, eq=False)
class Triples:
    """All pairs of one kind: every window of the truths is drawn equally often."""

    table: tuple[Int[Tensor, " K"], Int[Tensor, " K"]]
    """First frame and length of every row."""
    truths: Int[Tensor, " R"]
    ends: Int[Tensor, " R"]
    """Number of windows of the truths up to each."""
    identities: Choices
    drivings: Choices
    frames: int
    """Frames of a window."""
    counts: tuple[int, int, int]
    """Number of meshes or clips that may be identity, driving and truth."""

    @classmethod
    def of(
        cls,
        table: MeshTable,
        frames: int,
        truths: Bool[np.ndarray, " K"],
        identities: Bool[np.ndarray, " K"],
        drivings: Bool[np.ndarray, " K"],
    ) -> Triples | None:
        """List the pairs among the rows that may be truth, identity and driving; None where there is none.

        A truth needs a driving mesh of another person, and is its own identity where its person has no other pose.
        """
        rows = np.flatnonzero(truths & (table.length >= frames))
        beside = Choices.of(table.person, identities, rows), Choices.of(table.pose, drivings, rows)
        usable = ((beside[0].count.numpy() > 0) | identities[rows]) & (beside[1].count.numpy() > 0)
        rows = rows[usable]
        if not len(rows):
            return None
        of_person = identities & np.isin(table.person, table.person[rows])
        of_pose = drivings & np.isin(table.pose, table.pose[rows])
        return cls(
            (torch.from_numpy(table.first), torch.from_numpy(table.length)),
            torch.from_numpy(rows),
            torch.from_numpy(np.cumsum(table.length[rows] - frames + 1)),
            Choices.of(table.person, identities, rows),
            Choices.of(table.pose, drivings, rows),
            frames,
            (int(of_person.sum()), int(of_pose.sum()), len(rows)),
        )

    def to(self, device: torch.device) -> Triples:
        """Copy to a device."""
        tensors = (self.truths.to(device), self.ends.to(device), self.identities.to(device), self.drivings.to(device))
        return Triples((self.table[0].to(device), self.table[1].to(device)), *tensors, self.frames, self.counts)

    def draw(self, size: int, rng: torch.Generator) -> Frames:
        """Draw pairs: a window of a truth, then an identity in another pose and a driving person."""
        first, length = self.table
        window = torch.randint(int(self.ends[-1]), (size,), generator=rng, device=rng.device)
        share = torch.rand(3, size, generator=rng, device=rng.device)
        truth = torch.searchsorted(self.ends, window, right=True)
        row = self.truths[truth]
        start = (window - self.ends[truth] + length[row] - self.frames + 1)[:, None]
        frames = start + torch.arange(self.frames, device=rng.device)
        identity, driving = self.identities.pick(truth, share[0]), self.drivings.pick(truth, share[1])
        still = first[identity] + (share[2] * length[identity]).long()
        return Frames(still, first[driving, None] + frames, first[row, None] + frames)


@dataclass(frozen=True, eq=False)
class Split:
    """The pairs of a folder: those of the training, and those that networks are validated on, if any are held out."""

    training: Triples
    seen: Triples | None
    """New people in poses of the training; None where no people are held out."""
    unseen: Triples | None
    """New people, or all where none are held out, in new poses, from identities in poses of the training; None where no
    poses are held out."""

    @classmethod
    def of(
        cls, table: MeshTable, frames: int, new: Bool[np.ndarray, " K"], new_pose: Bool[np.ndarray, " K"]
    ) -> Split | None:
        """Split the pairs of a table into those with new people and new poses, and others; None if a part has none."""
        known = ~new & ~new_pose
        training = Triples.of(table, frames, known, known, known)
        # With one new person alone the driving meshes are of people of the training.
        driving = new if len(np.unique(table.person[new])) > 1 else ~new
        truths = new if new.any() else ~new
        seen, unseen = (
            Triples.of(table, frames, truths & pose, truths & ~new_pose, driving) if asked.any() else None
            for pose, asked in ((~new_pose, new), (new_pose, new_pose))
        )
        if training is None or (new.any() and seen is None) or (new_pose.any() and unseen is None):
            return None
        return cls(training, seen, unseen)


def held_out(count: int) -> int:
    """Give the number of people, or of poses, that are held out of so many."""
    return math.ceil(count / HELD_OUT) if count >= LEAST else 0
