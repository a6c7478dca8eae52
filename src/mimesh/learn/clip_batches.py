"""Training windows of T frames, made on the device as `batches.py` makes pairs: who moves is new, how is shared.

Every frame of driving and truth is centred on its own bounding box; driving frames are in their own unit sphere. The
place of a result is not learned: it follows from the driving's path afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from ..bodies import RiggedBody
from ..motions.clips import split_windows
from ..motions.motion import mirror, rotmat_to_rotvec
from .batches import TABLES, DataConfig, PairSource
from .bodies import rotvec_to_rotmat

FASTEST = 3
"""`clips`: captured windows are played at up to this many times their speed."""
CAPTURED = 0.5
"""`clips`: share of windows from captures; the others go straight from one pose of the joint limits towards another."""
REACH = 0.15
"""`clips`: the most of that way that one frame goes; none at all is a still clip."""


@dataclass(frozen=True)
class ClipBatch:
    """Normalised windows. Vertex i of `truth` is vertex i of `identity`; `driving` is shuffled alike in all frames."""

    identity: Float[Tensor, "B V 3"]
    driving: Float[Tensor, "B T V 3"]
    truth: Float[Tensor, "B T V 3"]
    unit: Float[Tensor, "B T"]
    """Radii by which the frames of `truth` were divided, over that of `identity`."""
    edges: Int[Tensor, "B E 2"]
    edges_of_mesh: float


class ClipSource(PairSource):
    """Makes batches of windows of one length."""

    def __init__(self, config: DataConfig, frames: int, body: RiggedBody, device: torch.device, seed: int) -> None:
        self.frames = frames
        super().__init__(config, body, device, seed)

    def _load(self, body: RiggedBody) -> None:
        super()._load(body)
        if self.config.kind in TABLES:
            return
        takes = [m for take in split_windows("train") for m in (take, mirror(take))]
        self.captured = self._tensor(np.concatenate([rotmat_to_rotvec(m.rotmat) for m in takes]))
        ends = np.cumsum([len(m) for m in takes])
        reach = FASTEST * (self.frames - 1)
        starts = [np.arange(end - len(m), end - reach) for end, m in zip(ends, takes, strict=True)]
        self.starts = torch.from_numpy(np.concatenate(starts)).to(self.device)

    def batch(self, size: int, step: int) -> ClipBatch:  # type: ignore[override]
        """The windows of training step `step`."""
        rng = torch.Generator(self.device).manual_seed(self.seed * 1_000_003 + step)
        make = self._from_motions if self.config.kind in TABLES else self._endless_windows
        (identity_shape, driving_shape), identity_pose, poses = make(size, rng)
        index, driving_index, edges, share = self._vertices(size, rng)
        identity, radius = self._mesh(identity_shape, identity_pose, index)
        scale = radius if self.config.target_scale == "identity" else None
        driving, _ = self._window(driving_shape, poses, driving_index)
        truth, radii = self._window(identity_shape, poses, index, scale)
        return ClipBatch(identity, driving, truth, radii / radius[:, :, 0], edges, share)

    def _from_motions(self, size: int, rng: torch.Generator):
        """Two of the 16 people, one of the 80 motions, a window of its 30 frames, a Table 6 pose for the identity."""
        who = self._below(len(self.people), (2, size), rng)
        which = self._below(len(self.motions), (size, 1), rng)
        first = self._below(self.motions.shape[1] - self.frames + 1, (size, 1), rng)
        window = self.motions[which, first + torch.arange(self.frames, device=self.device)]
        return self.people[who], self.stands[self._below(len(self.stands), (size,), rng)], window

    def _endless_windows(self, size: int, rng: torch.Generator):
        """Fresh people as `wide` has them; windows of captures at some speed, or a way between two poses; a heading."""
        shapes, poses, _ = self._endless(size, rng)
        at = torch.arange(self.frames, device=self.device)
        first = self.starts[self._below(len(self.starts), (size, 1), rng)]
        speed = 1 + self._below(FASTEST, (size, 1), rng)
        captured = rotvec_to_rotmat(self.captured[first + speed * at])
        start, stop = (self._within(self.limits, size, rng)[:, None] for _ in range(2))
        step = REACH * torch.rand(size, 1, 1, 1, generator=rng, device=self.device)
        straight = rotvec_to_rotmat(start + step * at[:, None, None] * (stop - start))
        turn = self._headings(size, np.deg2rad(self.config.heading), rng)[:, None]
        chosen = torch.rand(size, generator=rng, device=self.device) < CAPTURED
        window = torch.where(chosen[:, None, None, None, None], captured, straight)
        window[:, :, 0] = turn @ window[:, :, 0]
        return shapes, poses[0], window

    def _window(self, shape, rotmat, index, radius=None) -> tuple[Float[Tensor, "B T V 3"], Float[Tensor, "B T"]]:
        """Chosen vertices of every frame, each frame centred and divided by `radius`, or by its own; those radii."""
        frames = rotmat.shape[1]
        many = [x.repeat_interleave(frames, dim=0) for x in (shape, index)]
        scale = None if radius is None else radius.repeat_interleave(frames, dim=0)
        points, radii = self._mesh(many[0], rotmat.flatten(0, 1), many[1], scale)
        return points.unflatten(0, (-1, frames)), radii.view(-1, frames)
