"""Validation: the `val` split of a model's protocol, and fresh data like its own, while a training runs."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from ..core.frame_buffer import Progress
from ..core.normalization import bbox_centre, radius
from ..evaluate.clip_protocols import CLIPS_ANIFORMER, CLIPS_ORDERED, ClipPair
from ..evaluate.metrics import box_radius, pmd
from ..evaluate.pairs import Pair
from ..evaluate.protocols import HUMAN_NPT, QUADRUPED, Protocol
from .data.registered import HeldOutMeshes, RegisteredMeshes
from .layers import match_frames, mean_squared_distance
from .task import Config, Network, Task

WINDOW = 3
"""Frames of each clip that networks of pairs are validated on, from its middle."""
FRESH, FRESH_BATCHES, FRESH_BATCH = "fresh", 8, 32
"""Key of the figure on fresh data; number of batches that it is measured on, pairs of each."""
FRESH_SEED = 1_000_003
"""Added to the seed of a training: batches that it never gets."""

Infer = Callable[[Float[Tensor, "V 3"], Float[Tensor, "T U 3"]], Float[Tensor, "R V 3"]]
"""A network without batches: one identity and T driving frames to R results."""


class Validation:
    """Measures a network on pairs of the protocol's `val` split and on fresh training-like data."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.trial = functools.cache(self._ordered if task.config.data.pairing == "order" else self._shuffled)
        self.fresh = task.source(task.config.seed + FRESH_SEED)

    def _shuffled(self, kind: str, index: int) -> Pair:
        return self.task.protocol.pair("val", kind, index)

    def _ordered(self, kind: str, index: int) -> Pair:
        protocol = self.task.protocol
        rng = protocol.rng("val", kind, index)
        trial = protocol.unshuffled_pair("val", kind, index, rng)
        count = len(trial.identity.vertices)
        order = np.arange(count) if self.task.of_one_order else rng.permutation(count)
        return trial.reordered(order, order)

    @torch.no_grad()
    def measure(
        self, model: nn.Module, stop: Callable[[], bool] = lambda: False, progress: Progress | None = None
    ) -> dict[str, float] | None:
        """Measure PMD x1e4 on each kind of `val` and on fresh data; `val` is the mean of `unseen` and `fresh`.

        `unseen` has `validation_pairs` pairs, `fresh` FRESH_BATCHES batches of the training's own kind.
        All are Eq. 7 as printed, on what the network gives: about its origin, over the radius of the truth.
        None if `stop` returned true before the end; it is called before every trial and batch, which take seconds.
        `progress` is called after each of them, with pairs.
        """
        protocol, count = self.task.protocol, self.task.config.validation_pairs
        counts = {kind: protocol.count(kind, count) for kind in protocol.kinds} | {FRESH: FRESH_BATCHES}
        jobs = [(kind, i) for kind, number in counts.items() for i in range(number)]
        errors: dict[str, list[float]] = {kind: [] for kind, _ in jobs}
        pairs = np.cumsum([FRESH_BATCH if kind == FRESH else 1 for kind, _ in jobs])
        model.eval()
        for (kind, i), done in zip(jobs, pairs, strict=True):
            if stop():
                break
            errors[kind].append(self._error(model, kind, i))
            if progress is not None:
                progress(int(done), int(pairs[-1]))
        model.train()
        if sum(map(len, errors.values())) < len(jobs):
            return None
        figures = {kind: 1e4 * sum(found) / len(found) for kind, found in errors.items()}
        hardest = "unseen" if "unseen" in figures else protocol.kinds[-1]
        figures["val"] = (figures[hardest] + figures[FRESH]) / 2
        return figures

    def _error(self, model: nn.Module, kind: str, index: int) -> float:
        if kind == FRESH:
            return self.task.batch_error(model, self.fresh.batch(FRESH_BATCH, index))
        return self.task.trial_error(model, self.trial(kind, index))


class PaperTask(Task[Config, Network]):
    """The task of a paper's network, which maps an identity and a driving mesh to vertices and is measured as there."""

    @property
    def meshes(self) -> RegisteredMeshes | None:
        """The registered meshes that the user brought, if any."""
        return self.user_data if isinstance(self.user_data, RegisteredMeshes) else None

    @property
    def mesh_vertices(self) -> int:
        """Vertices of the registered meshes, or of the shipped body."""
        return self.meshes.points.shape[1] if self.meshes else super().mesh_vertices

    @property
    def protocol(self) -> Protocol:
        """What is held out of registered meshes; pairs of animals; the paper's pairs, or clips where the data are."""
        if self.meshes and (held_out := HeldOutMeshes.of(self.meshes)):
            return held_out
        if self.config.data.body == "quadruped":
            return QUADRUPED
        if self.test_set == HUMAN_NPT.name and self.config.data.kind not in ("clips", "clips80"):
            return HUMAN_NPT
        return CLIPS_ORDERED if self.config.data.pairing == "order" else CLIPS_ANIFORMER

    def trial_error(self, model: Network, trial: Pair | ClipPair) -> float:
        """Compute the PMD of a pair, or the mean over frames of a clip's window, each frame of which is a pair."""

        def infer(identity: Float[Tensor, "V 3"], driving: Float[Tensor, "T U 3"]) -> Float[Tensor, "T V 3"]:
            with self.autocast():
                return model(identity.expand(len(driving), -1, -1), driving)

        where = (self.config.data.target_scale, self.device)
        return clip_error(infer, trial, *where) if isinstance(trial, ClipPair) else pair_error(infer, trial, *where)

    def batch_error(self, model: Network, batch: Any) -> float:
        """Compute the mean PMD of a batch of pairs."""
        with self.autocast():
            result = model(batch.identity, batch.driving)
        return float(mean_squared_distance(result, batch.truth, batch.truth_radius))


def pair_error(infer: Infer, trial: Pair, target_scale: str, device: torch.device) -> float:
    """Compute the PMD of one pair by a network that maps vertices to vertices.

    Args:
        target_scale: whose radius the truths of the training were divided by (`DataConfig.target_scale`).
    """
    identity, size = to_unit_sphere(trial.identity.vertices, device)
    driving, _ = to_unit_sphere(trial.driving.vertices, device)
    return _pmd(infer(identity, driving[None])[:1], size, trial.truth[None], target_scale)


def clip_error(infer: Infer, trial: ClipPair, target_scale: str, device: torch.device, frames: int = WINDOW) -> float:
    """Compute the mean PMD over the frames of one window from the middle of a clip."""
    start = (len(trial.clip) - frames) // 2
    window = slice(start, start + frames)
    identity, size = to_unit_sphere(trial.identity.vertices, device)
    driving = torch.stack([to_unit_sphere(v, device)[0] for v in trial.clip.vertices[window].astype(np.float64)])
    results = infer(identity, driving)
    truths = torch.from_numpy(trial.truth_frames[window].astype(np.float64))
    return _pmd(results, size, match_frames(truths[None], len(results))[0].numpy(), target_scale)


def to_unit_sphere(points: Float[np.ndarray, "V 3"], device: torch.device) -> tuple[Float[Tensor, "V 3"], float]:
    """Centre points on their bounding box and divide them by their radius; give that radius too."""
    centred = points - bbox_centre(points)
    return torch.from_numpy(centred / radius(centred)).float().to(device), radius(centred)


def _pmd(
    results: Float[Tensor, "T V 3"], identity_radius: float, truth: Float[np.ndarray, "T V 3"], target_scale: str
) -> float:
    """Compute the PMD of results about the origin, scaled by the radius that the training divided truths by."""
    size = identity_radius if target_scale == "identity" else box_radius(truth)[:, None, None]
    return pmd(results.double().cpu().numpy() * size, truth - bbox_centre(truth)[:, None])
