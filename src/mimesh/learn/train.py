"""The training loop: random pairs in, best checkpoint on `val` out, resumable at any moment."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.utils.tensorboard import SummaryWriter

from ..bodies import load_body
from ..core.errors import InputError
from . import checkpoint
from .aniformer import AniFormer
from .batches import Batch, PairSource
from .clip_batches import ClipBatch
from .clip_losses import aniformer_loss
from .config import MODELS, TrainConfig, load_config
from .limp import LIMP, limp_loss
from .losses import npt_loss
from .mime_batches import MimeBatch
from .mime_loss import mime_loss
from .optimizers import make_optimizers
from .validation import PairValidation, make_source, make_validation

LOG_SECONDS = 20.0
SAVE_SECONDS = 120.0


def train_command(
    model: str,
    config: str,
    out: Path | None,
    resume: Path | None,
    max_minutes: float | None,
    changes: Sequence[str] = (),
    weights: Path | None = None,
) -> Path:
    """What `mimesh train` does; returns the folder with `last.safetensors`, `best.safetensors` and the logs.

    `changes` are "key=value" on top of the configuration, such as "seed=1" or "model.blocks=conv"; `weights` is a
    checkpoint whose network a new training begins with.
    """
    if model not in MODELS:
        raise InputError(f"{model}: expected a model that can be trained ({', '.join(MODELS)}), found another")
    if resume is not None:
        last = resume / "last.safetensors"
        if not last.exists():
            raise InputError(f"{resume}: expected last.safetensors of an earlier training in it, found none")
        if changes or weights:
            what = f"--set {changes[0]}" if changes else f"--weights {weights}"
            raise InputError(f"{what}: expected no changes with --resume, found some; leave them out")
        return train(checkpoint.load(last).config, resume, max_minutes)
    settings = load_config(config, model, changes)
    folder = out or Path("runs") / "-".join([model, Path(config).stem, *(c.partition("=")[2] for c in changes)])
    if (folder / "last.safetensors").exists():
        raise InputError(
            f"{folder}: expected a folder without a training, found one; continue it with --resume {folder}"
        )
    if weights is not None:
        begin(settings, weights, folder)
    return train(settings, folder, max_minutes)


def begin(config: TrainConfig, weights: Path, folder: Path) -> None:
    """Make a folder for a training whose network is that of a checkpoint; all else is new.

    Raises:
        InputError: the checkpoint holds another network.
    """
    model, state = checkpoint.load_model(weights)
    if state.config.model != config.model:
        raise InputError(f"{weights}: expected the network of the configuration, found another; change model.*")
    folder.mkdir(parents=True, exist_ok=True)
    run = Run.start(config, folder)
    run.model.load_state_dict(model.state_dict())
    run.ema = {name: value.detach().clone() for name, value in model.state_dict().items()} if config.ema else {}
    run.before = (*state.before, state.spent())
    run.save(folder / "last.safetensors")


def train(config: TrainConfig, folder: Path, max_minutes: float | None = None) -> Path:
    """Train to the end of the schedule or the time limit; continue if the folder holds a checkpoint."""
    folder.mkdir(parents=True, exist_ok=True)
    run = Run.start(config, folder)
    validation = make_validation(config, load_body(), run.device)
    deadline = time.monotonic() + 60 * max_minutes if max_minutes else float("inf")
    with (folder / "log.jsonl").open("a") as lines, SummaryWriter(str(folder)) as board:
        log = Log(lines, board, config, run)
        while run.share() < 1.0 and time.monotonic() < deadline:
            log.add(run.advance())
            if run.step * config.batch % config.validate_every < config.batch or run.share() >= 1.0:
                log.write("validation", run.validate(validation, folder))
            elif time.monotonic() - run.saved > SAVE_SECONDS:
                run.save(folder / "last.safetensors")
        log.flush()
        if not run.metrics:
            log.write("validation", run.validate(validation, folder))
        run.save(folder / "last.safetensors")
    return folder


@dataclass
class Run:
    """A training in motion."""

    config: TrainConfig
    model: checkpoint.Network
    step_model: nn.Module
    """The model, or its compiled form; both share weights."""
    ema: dict[str, Tensor]
    optimizers: list[torch.optim.Optimizer]
    source: PairSource
    device: torch.device
    step: int = 0
    seconds: float = 0.0
    best: float = float("inf")
    saved: float = 0.0
    metrics: dict[str, float] | None = None
    """Validation figures of the current weights; None once they have changed."""
    before: tuple[dict[str, int], ...] = ()
    """Trainings that this one went on from."""

    @classmethod
    def start(cls, config: TrainConfig, folder: Path) -> Run:
        """A fresh training, or the one whose checkpoint lies in the folder."""
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        torch.manual_seed(config.seed)
        model = checkpoint.make_model(config).to(device)
        ema = {k: v.detach().clone() for k, v in model.state_dict().items()} if config.ema else {}
        optimizers = make_optimizers(model, config, device)
        source = make_source(config, load_body(), device, config.seed)
        compiled = torch.compile(model) if config.compile else model
        run = cls(config, model, compiled, ema, optimizers, source, device, saved=time.monotonic())  # type: ignore[arg-type]
        last = folder / "last.safetensors"
        if last.exists():
            state = checkpoint.load(last)
            checkpoint.unpack(state, model, ema, optimizers)
            run.step, run.seconds, run.best, run.before = state.step, state.seconds, state.best, state.before
        return run

    def clock(self) -> float:
        """Seconds of this process on all cores; with a GPU those of the wall.

        Other processes lengthen them by little: a training between busy ones does a tenth less in its time.
        """
        return time.process_time() if self.device.type == "cpu" else time.perf_counter()

    def share(self) -> float:
        """How much of the training is done: 0 at the start, 1 at its end."""
        if self.config.minutes:
            return self.seconds / (60.0 * self.config.minutes)
        return self.step * self.config.batch / self.config.pairs

    def advance(self) -> Tensor:
        """One optimizer step; the loss stays on the device."""
        started = self.clock()
        config = self.config
        batch = self.source.batch(config.batch, self.step)
        for optimizer in self.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = config.learning_rate * schedule(config, self.step * config.batch, self.share())
            optimizer.zero_grad(set_to_none=True)
        loss = self.loss(batch)
        loss.backward()
        if config.clip:
            nn.utils.clip_grad_norm_(self.model.parameters(), config.clip)
        for optimizer in self.optimizers:
            optimizer.step()
        if self.ema:
            current = self.model.state_dict()
            for name, average in self.ema.items():
                average.lerp_(current[name], 1.0 - config.ema)
        self.step += 1
        self.metrics = None
        self.seconds += self.clock() - started
        return loss.detach()

    def loss(self, batch: Batch | ClipBatch | MimeBatch) -> Tensor:
        """NPT Eq. 4 or AniFormer Eq. 6 over V, LIMP's or mime's, in the configured width."""
        config = self.config
        if isinstance(batch, MimeBatch):
            with torch.autocast(self.device.type, torch.bfloat16, enabled=config.precision == "bf16"):
                return mime_loss(self.step_model, batch, config.structure)  # type: ignore[arg-type]
        if isinstance(self.model, LIMP):
            rng = torch.Generator(self.device).manual_seed(config.seed * 1_000_003 + self.step)
            meshes = (batch.identity, batch.truth, batch.driving)
            with torch.autocast(self.device.type, torch.bfloat16, enabled=config.precision == "bf16"):
                return limp_loss(self.model, *meshes, batch.edges[0], config.metrics, rng)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=config.precision == "bf16"):
            result = self.step_model(batch.identity, batch.driving)
        share = batch.edges_of_mesh
        if isinstance(batch, Batch):
            edge = (config.edge, config.edge_weight)
            return npt_loss(result, batch.truth, batch.identity, batch.edges, *edge, share)
        given = (batch.truth, batch.identity, batch.driving, batch.edges, batch.unit)
        return aniformer_loss(result, *given, **dataclasses.asdict(config.losses), edges_of_mesh=share)

    def validate(self, validation: PairValidation, folder: Path) -> dict[str, float]:
        """Measure on `val`; keep the checkpoint if it is the best so far."""
        current = {k: v.clone() for k, v in self.model.state_dict().items()}
        if self.ema:
            self.model.load_state_dict(self.ema)
        self.metrics = validation.measure(self.model)
        self.model.load_state_dict(current)
        if self.metrics["val"] < self.best:
            self.best = self.metrics["val"]
            self.save(folder / "best.safetensors")
        self.save(folder / "last.safetensors")
        return self.metrics

    def save(self, path: Path) -> None:
        """Write a checkpoint."""
        tensors = checkpoint.pack(self.model, self.ema, self.optimizers)
        facts = (self.config, self.step, self.seconds, self.best, self.metrics or {}, tensors, self.before)
        checkpoint.save(path, checkpoint.State(*facts))
        self.saved = time.monotonic()


class Log:
    """JSON lines, TensorBoard and a line on the terminal."""

    def __init__(self, lines, board: SummaryWriter, config: TrainConfig, run: Run) -> None:
        self.lines, self.board, self.config, self.run = lines, board, config, run
        self.losses: list[Tensor] = []
        self.time, self.mark = time.monotonic(), run.seconds
        # Forward plus backward: three times the forward arithmetic.
        count = config.data.vertices or run.source.body.vertex_count
        if isinstance(run.model, AniFormer):
            self.flops = 3 * run.model.config.frames * run.model.estimate_flops(count)
        elif isinstance(run.model, LIMP):
            self.flops = 3 * run.model.estimate_flops(count, count, count, decodings=7)
        else:
            self.flops = 3 * run.model.estimate_flops(count, count)

    def add(self, loss: Tensor) -> None:
        """Collect a loss; write a line now and then."""
        self.losses.append(loss)
        if time.monotonic() - self.time > LOG_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Write what was collected: mean loss, pairs a second, arithmetic achieved."""
        if not self.losses:
            return
        loss = torch.stack(self.losses).mean().item()
        rate = len(self.losses) * self.config.batch / (self.run.seconds - self.mark)
        figures = {"loss": loss, "pairs_per_s": rate, "tflops": rate * self.flops / 1e12}
        figures["learning_rate"] = self.run.optimizers[0].param_groups[0]["lr"]
        self.losses, self.time, self.mark = [], time.monotonic(), self.run.seconds
        self.write("training", figures)

    def write(self, kind: str, figures: dict[str, float]) -> None:
        """One line of the log."""
        pairs = self.run.step * self.config.batch
        record = {"kind": kind, "step": self.run.step, "pairs": pairs, "seconds": round(self.run.seconds, 1), **figures}
        self.lines.write(json.dumps(record) + "\n")
        self.lines.flush()
        for name, value in figures.items():
            self.board.add_scalar(f"{kind}/{name}", value, pairs)
        print(f"{kind} {pairs:,} pairs: " + ", ".join(f"{k} {v:.4g}" for k, v in figures.items()), file=sys.stderr)


def schedule(config: TrainConfig, pairs: int, share: float) -> float:
    """Share of the learning rate after so many pairs, a `share` of the training: rise, constant, steps, fall."""
    rise = min(1.0, (pairs + config.batch) / config.warmup) if config.warmup else 1.0
    fall = min(1.0, max(0.0, 1.0 - share) / config.decay) if config.decay else 1.0
    return rise * fall * 0.1 ** sum(share >= milestone for milestone in config.milestones)
