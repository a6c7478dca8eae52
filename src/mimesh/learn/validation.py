"""What a training is judged by while it runs: the `val` split of its protocol, and fresh data like its own."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from ..bodies import RiggedBody
from ..core import geometry, surface_points
from ..core.mesh import Mesh
from ..core.normalization import bbox_centre, radius
from ..evaluate.clip_protocols import CLIPS_ANIFORMER, ClipPair, on_template
from ..evaluate.metrics import pmd_of_pair
from ..evaluate.pairs import Pair
from ..evaluate.protocols import HUMAN_NPT, Protocol
from .aniformer import AniFormer, AniFormerConfig
from .batches import PairSource, TemplateSource
from .checkpoint import Network
from .clip_batches import ClipSource
from .clip_losses import middle_of
from .config import TrainConfig
from .limp import LIMP, LIMPConfig
from .mime import POINTS, Mime, MimeConfig
from .mime_batches import MimeBatch, MimeSource
from .mime_loss import pmd

WINDOW = 3
"""Frames of each clip that networks of pairs are judged by."""
FRESH_SEED = 1_000_003
"""Added to the seed of a training: batches that it never sees."""


def make_source(config: TrainConfig, body: RiggedBody, device: torch.device, seed: int) -> PairSource | ClipSource:
    """Where a training's batches come from."""
    if isinstance(config.model, MimeConfig):
        return MimeSource(config.data, body, device, seed)
    if isinstance(config.model, AniFormerConfig):
        return ClipSource(config.data, config.model.frames, body, device, seed)
    kind = TemplateSource if isinstance(config.model, LIMPConfig) else PairSource
    return kind(config.data, body, device, seed)


def make_validation(config: TrainConfig, body: RiggedBody, device: torch.device) -> PairValidation:
    """Clips for what is trained on motions, pairs for the rest."""
    if isinstance(config.model, MimeConfig):
        return MimeValidation(config, body, device)
    clips = config.data.kind in ("clips", "clips80")
    return (ClipValidation if clips else PairValidation)(config, body, device)


class PairValidation:
    """Pairs of the `val` split of human-npt (PMD of the papers), and of fresh training-like data with another seed."""

    protocol: Protocol = HUMAN_NPT

    def __init__(self, config: TrainConfig, body: RiggedBody, device: torch.device) -> None:
        self.config, self.device = config, device
        kinds, count = self.protocol.kinds, config.validation_pairs
        self.trials = {kind: list(self.protocol.trials("val", kind, count)) for kind in kinds}
        self.fresh = make_source(config, body, device, config.seed + FRESH_SEED)

    @torch.no_grad()
    def measure(self, model: Network) -> dict[str, float]:
        """PMD x1e4 on each kind of `val` and on fresh data; `val` is the mean of the last two."""
        model.eval()
        figures = {kind: sum(self.pmd(model, t) for t in trials) / len(trials) for kind, trials in self.trials.items()}
        batches = [self.fresh.batch(32, i) for i in range(8)]
        errors = [self._fresh_error(model, batch) for batch in batches]
        figures["fresh"] = float(torch.stack(errors).mean())
        figures = {kind: 1e4 * value for kind, value in figures.items()}
        figures["val"] = (figures["unseen"] + figures["fresh"]) / 2
        model.train()
        return figures

    def _fresh_error(self, model: Network, batch) -> Tensor:
        return self._error(self._infer(model, batch.identity, batch.driving), batch.truth)

    def pmd(self, model: Network, trial: Pair) -> float:
        """Of one trial, result and truth in metres and then in the truth's unit sphere."""
        identity, own = self._sphere(trial.identity.vertices)
        driving, _ = self._sphere(trial.driving.vertices)
        result = self._infer(model, identity[None], driving[None])[0]
        return self._pmd_in_metres(result, own, trial.truth)

    def _pmd_in_metres(self, result: Float[Tensor, "V 3"], own: float, truth: Float[np.ndarray, "V 3"]) -> float:
        """The result made as large as the truths of the training were when they were divided by a radius."""
        scale = own if self.config.data.target_scale == "identity" else self._sphere(truth)[1]
        return pmd_of_pair((result.double() * scale).cpu().numpy(), truth)

    def _sphere(self, points: Float[np.ndarray, "V 3"]) -> tuple[Float[Tensor, "V 3"], float]:
        """Points centred on their bounding box in units of their radius, and that radius."""
        centred = points - bbox_centre(points)
        return torch.from_numpy(centred / radius(centred)).float().to(self.device), radius(centred)

    def _infer(self, model: Network, identity: Tensor, driving: Tensor) -> Tensor:
        with self._cast():
            return model(identity, driving)

    def _cast(self):
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.precision == "bf16")

    def _error(self, result: Tensor, truth: Tensor) -> Tensor:
        return (result - truth).square().sum(-1).mean()


class ClipValidation(PairValidation):
    """The same on windows from the middle of clips of `clips-aniformer`; frame by frame for networks of pairs."""

    protocol = CLIPS_ANIFORMER

    def pmd(self, model: Network, trial: ClipPair) -> float:  # type: ignore[override]
        """Mean over the frames of one window."""
        trial = on_template(trial) if isinstance(model, LIMP) else trial
        frames = model.config.frames if isinstance(model, AniFormer) else WINDOW
        start = (len(trial.clip) - frames) // 2
        identity, own = self._sphere(trial.identity.vertices)
        clip = trial.clip.vertices[start : start + frames].astype(np.float64)
        driving = torch.stack([self._sphere(v)[0] for v in clip])
        driving = driving[None] if isinstance(model, AniFormer) else driving
        results = self._infer(model, identity.expand(len(driving), -1, -1), driving)
        results = results[0] if isinstance(model, AniFormer) else results
        truths = trial.truth_frames[start : start + frames].astype(np.float64)
        truths = middle_of(torch.from_numpy(truths)[None], len(results))[0].numpy()
        return float(np.mean([self._pmd_in_metres(r, own, t) for r, t in zip(results, truths, strict=True)]))

    def _error(self, result: Tensor, truth: Tensor) -> Tensor:
        return super()._error(result, truth if truth.ndim == 3 else middle_of(truth, result.shape[1]))


class MimeValidation(PairValidation):
    """The same for mime, which reads points of the surface and moves all vertices."""

    def pmd(self, model: Network, trial: Pair) -> float:
        """Of one trial, result and truth in metres and then in the truth's unit sphere."""
        assert isinstance(model, Mime)
        mesh = trial.identity
        vertices, normals = mesh.vertices, geometry.vertex_normals(mesh.vertices, mesh.faces)
        with self._cast():
            own, other = (model.read(*self._points(m)) for m in (mesh, trial.driving))
            scores = model.weights(own, self._tensor(vertices), self._tensor(normals))
        result = model.moved(self._tensor(vertices), scores, own, other)[0]
        return pmd_of_pair(result.double().cpu().numpy(), trial.truth)

    def _points(self, mesh: Mesh) -> tuple[Tensor, Tensor]:
        face, share = surface_points.sample_surface(mesh.vertices, mesh.faces, POINTS, np.random.default_rng(0))
        points = surface_points.at_barycentric(mesh.vertices, mesh.faces, face, share)
        return self._tensor(points), self._tensor(geometry.face_normals(mesh.vertices, mesh.faces)[face])

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).float()[None].to(self.device)

    def _fresh_error(self, model: Network, batch: MimeBatch) -> Tensor:
        assert isinstance(model, Mime)
        with self._cast():
            own, other, scores = model(*batch.given)
        few = batch.identity.points[:, : scores.shape[1]]
        return pmd(model.moved(few, scores, own, other, batch.truth.joints[:, 0]), batch).mean()
