"""What the loop, the validation and the export ask of a model: a configuration, its data options, and a task."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar, Generic, Literal, TypeVar

import torch
from torch import Tensor, nn

from ..bodies import RiggedBody, load_body
from ..core.errors import InputError
from ..evaluate import protocols

STEPS_AHEAD = 8
"""Batches that a GPU makes at once. It computes one faster than its hundreds of small operations can be started."""


def share_option(default: float | None = 0.0) -> Any:
    """Declare an option of the data that is a share from 0 to 1, and may change where a training is resumed."""
    return field(default=default, metadata={"share": True})


@dataclass(frozen=True)
class DataConfig:
    """What training meshes are made of: what all models have; each adds the options of the data that it takes."""

    kind: str = ""
    """Each model names its own."""
    vertices: int = 0
    """Vertices of each mesh: 0 for all, else a random subset (ends of random edges for identity and truth)."""
    target_scale: Literal["truth", "identity"] = "truth"
    """Whose radius the truth is divided by. The papers normalise every mesh; users do not know the truth's radius."""
    pairing: Literal["random", "order"] = "random"
    """Which driving vertex an identity vertex is paired with: a random one (NPT shuffles every mesh), or its own
    (AniFormer's public code never shuffles the sequences that it trains on)."""
    body: Literal["human", "quadruped"] = "human"
    """Shipped body of the people, or the animals, that are drawn; of registered meshes, what they are."""
    words: ClassVar[dict[tuple[str, str], str]] = {}
    """Kind and body -> description for the card, where a model makes something of its own of them (`export.DATA`)."""

    def check(self, where: str) -> None:
        """Raise InputError for values that do not go together; `where` begins the message."""
        for key in self.shares():
            value = getattr(self, key)
            if value is not None and not 0.0 <= value <= 1.0:
                raise InputError(f"{where}: expected data.{key} from 0 to 1, found {value}")

    def shares(self) -> list[str]:
        """List the options that are shares."""
        return [option.name for option in dataclasses.fields(self) if option.metadata.get("share")]


@dataclass(frozen=True)
class TrainConfig:
    """Everything a training depends on besides the code; each model adds fields. The defaults are the papers'."""

    network: str = ""
    """Name of the model, one of NETWORKS."""
    model: Any = None
    """Options of the network."""
    data: DataConfig = field(default_factory=DataConfig)
    batch: int = 8
    """Pairs a step; AniFormer's pairs are windows of T frames."""
    accumulate: int = 1
    """Parts that a batch is computed in, one after another, before a step: a part alone must fit into memory."""
    pairs: int = 800_000
    """Length of the training: 200 epochs of 4,000 pairs in NPT 4.1."""
    minutes: float = 0.0
    """Length in CPU minutes of steps instead (in minutes with a GPU); 0: `pairs` counts. For trainings that are
    compared at equal time. Resuming continues the schedule by the time spent."""
    optimizer: Literal["adam", "muon"] = "adam"
    """`muon` for the matrices between features (Adam for the rest); the papers use Adam."""
    learning_rate: float = 5e-5
    warmup: int = 0
    """Pairs over which the learning rate rises linearly from zero."""
    decay: float = 0.0
    """Share of the training, at its end, over which the learning rate falls linearly to zero."""
    milestones: tuple[float, ...] = ()
    """Shares of the training after each of which the learning rate is divided by ten."""
    weight_decay: float = 0.0
    """Decoupled weight decay of Muon's matrices: each step multiplies them by 1 - learning rate x this."""
    beta2: float = 0.999
    """Of Adam."""
    clip: float = 0.0
    """Largest norm of the gradient; 0 does not clip."""
    ema: float = 0.0
    """Decay of the exponential moving average of the weights, which is validated and exported; 0: the weights are."""
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    """Of matrix products (weights stay float32). `auto` takes the faster one on the device, by a short measurement."""
    compile: bool = False
    """Fuse element-wise work with torch.compile (needs a C++ compiler on a CPU)."""
    validate_every: int = 20_000
    """Pairs between validations on the `val` split."""
    validation_pairs: int = 24
    """Pairs of each kind in a validation, at most 72."""
    seed: int = 0

    @property
    def window(self) -> int:
        """Frames of a driving mesh or clip that the network takes at once."""
        return 1

    def check(self, where: str) -> None:
        """Raise InputError for values that do not go together; `where` begins the message."""
        self.data.check(where)
        for name, (least, most) in RANGES.items():
            if not least <= getattr(self, name) <= most:
                allowed = f"{least:g} or more" if most == math.inf else f"{least:g} to {most:g}"
                raise InputError(f"{where}: expected {name} of {allowed}, found {getattr(self, name):g}; change it")
        if self.weight_decay and self.optimizer != "muon":
            raise InputError(f"{where}: expected weight_decay 0 with optimizer {self.optimizer}, found another")
        if self.accumulate < 1 or self.batch % self.accumulate:
            raise InputError(
                f"{where}: expected accumulate to divide batch, found {self.accumulate} and {self.batch}; change one"
            )


RANGES = {
    **dict.fromkeys(("batch", "pairs", "validate_every", "validation_pairs"), (1, math.inf)),
    **dict.fromkeys(("minutes", "learning_rate", "warmup", "weight_decay", "clip"), (0, math.inf)),
    **dict.fromkeys(("decay", "beta2", "ema"), (0, 1)),
}
"""Option of a training -> its least and its largest value."""
UserData = Any
"""What the user brings to a training: `characters.TrainingCharacters` or `registered.RegisteredMeshes`."""
BatchSource = Any
"""Makes training batches: `batch(size, step)` is a pure function of its seed and the step."""


@dataclass(frozen=True)
class OnnxInterface:
    """What the ONNX exporter needs to know of a network."""

    module: nn.Module
    """Its forward function is the graph."""
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    example: tuple[Tensor, ...]
    dynamic: tuple[dict, ...]
    """Of each input: the axes that may have any length."""


@cache
def shipped_body(name: str = "human") -> RiggedBody:
    """Load a shipped body once: batches of training and of validation, and what is computed from it, share it."""
    return load_body(name)


Config = TypeVar("Config", bound=TrainConfig)
Network = TypeVar("Network", bound=nn.Module)


class Task(ABC, Generic[Config, Network]):
    """One kind of network and how it is trained, validated and exported."""

    config_type: ClassVar[type[TrainConfig]]
    test_set: ClassVar[str]
    """Protocol whose test figures belong on the model card."""

    def __init__(
        self, config: Config, device: torch.device, precision: str = "fp32", user_data: UserData | None = None
    ) -> None:
        self.config, self.device, self.precision, self.user_data = config, device, precision, user_data

    @property
    def body(self) -> RiggedBody:
        """The body model that training people are made of."""
        return shipped_body(self.config.data.body)

    @property
    def protocol(self) -> protocols.Protocol:
        """The evaluation protocol whose `val` split the training is validated on."""
        return protocols.HUMAN_NPT

    def autocast(self) -> AbstractContextManager[Any]:
        """Run matrix products in bfloat16 if that is the precision."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.precision == "bf16")

    @abstractmethod
    def make_model(self) -> Network:
        """Build the network with fresh weights, on the CPU."""

    @abstractmethod
    def source(self, seed: int) -> BatchSource:
        """Build the generator of training batches."""

    @abstractmethod
    def loss(self, model: Network, batch: Any, step: int) -> Tensor:
        """Compute the training loss of a batch, a scalar."""

    @abstractmethod
    def trial_error(self, model: Network, trial: Any) -> float:
        """Compute the PMD of one pair of the protocol (Eq. 7 of the papers, `evaluate.metrics.pmd`)."""

    @abstractmethod
    def batch_error(self, model: Network, batch: Any) -> float:
        """Compute the mean PMD of a training-like batch, in the same unit."""

    @abstractmethod
    def flops_per_pair(self, model: Network) -> float:
        """Count the floating-point operations of one training pair's forward pass."""

    @staticmethod
    @abstractmethod
    def onnx_interface(model: Any) -> OnnxInterface:
        """Describe the inputs and outputs of the exported network."""

    @staticmethod
    @abstractmethod
    def onnx_facts(model: Any) -> dict[str, Any]:
        """Give what the exported file must say about the network, beside its configuration."""

    @property
    def vertices(self) -> int:
        """Vertices of each training mesh."""
        return self.config.data.vertices or self.mesh_vertices

    @property
    def mesh_vertices(self) -> int:
        """Vertices of the whole meshes that training meshes are drawn from."""
        return len(self.body.vertices)

    @property
    def of_one_order(self) -> bool:
        """Whether the network has weights for each vertex, so that meshes keep the order of their file."""
        return False


@dataclass
class BatchesAhead:
    """Makes the batches of several steps at once, for a device that waits for the start of small operations."""

    source: BatchSource
    group: int = -1
    together: Any = None

    def batch(self, size: int, step: int) -> Any:
        """Give the pairs of a step: every `STEPS_AHEAD`th of those of its group, so that all have their share of each
        kind. A pure function of the source's seed and `step`.
        """
        if self.group != step // STEPS_AHEAD:
            self.group = step // STEPS_AHEAD
            self.together = self.source.batch(size * STEPS_AHEAD, self.group)
        parts = {field.name: getattr(self.together, field.name) for field in dataclasses.fields(self.together)}
        own = slice(step % STEPS_AHEAD, None, STEPS_AHEAD)
        return dataclasses.replace(
            self.together, **{key: part[own] for key, part in parts.items() if isinstance(part, Tensor)}
        )


def batches_of(task: Task, seed: int) -> BatchSource:
    """Build the generator of a training's batches on its device."""
    source = task.source(seed)
    if task.device.type == "cpu":
        return source
    one = source.batch(1, 0)
    flat = all(isinstance(getattr(one, field.name), (Tensor, float)) for field in dataclasses.fields(one))
    return BatchesAhead(source) if flat else source


def training_operations(task: Task, model: nn.Module, pairs: int) -> float:
    """Count floating-point operations of training on so many pairs: three times the forward pass.

    The optimizer's are not counted.
    """
    return 3.0 * pairs * task.flops_per_pair(model)
