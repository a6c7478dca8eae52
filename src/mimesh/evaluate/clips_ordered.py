"""`clips-ordered`: a test of the kind that AniFormer's public code trains for: one vertex order, training people drive.

The public code never shuffles the sequences that it trains on, so driving vertex i is identity vertex i unless it
shuffles the identity (which then no longer matches the truth). Its test is not published; the paper's test clips are
those of its training, and 20 others of the same people. `clips-aniformer` has neither: its meshes are shuffled apart,
as NPT's are, and its driving people are new. The two protocols share the 16 training people, the 80 motions, the
targets and their poses.

* `seen`: the 80 motions of the training; a training person drives a new target. With `unseen`, the paper's columns.
* `unseen`: 20 other seconds of the takes that the motions are from. In `test` they are the last ones of the takes, in
  `val` those between these and the training's (`motions.clips.SPLITS`), so that nothing is chosen by what is tested.
* `held-out`: whole motions of other makers, as in `clips-aniformer`; only where their files are given.

Both meshes of a trial get the same random order: no method profits from how the body is numbered.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ..bodies.sampling import sample_shape
from ..motions import Motion, mirror
from ..motions.clips import split_windows
from ..motions.deepmimic import deepmimic_folder
from .clip_protocols import (
    CLIPS_ANIFORMER,
    FRAMES,
    ClipPair,
    ClipsAniformer,
    make_clip_pair,
    reorder_clip_vertices,
    split_into_seconds,
)
from .held_out_takes import find_takes
from .pairs import Person, human

UNSEEN = 20
"""Unseen motions of `test`, as many as the paper's."""
UNSEEN_STRIDE = 7
"""Trial i of `unseen` uses motion 7 i mod 20 of `test`, so that the first few trials cover both takes."""


@dataclass(frozen=True)
class ClipsOrdered(ClipsAniformer):
    """The protocol of this module."""

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
        if "held-out" in self.kinds:
            find = find_takes if split == "test" else deepmimic_folder
            find(self.data)

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
        return reorder_clip_vertices(trial, order, order)


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
