"""What the training loop, the validation and the export ask of a model: one `Task` and one `TrainConfig` for each."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar, Generic, Literal, Protocol, TypeVar, runtime_checkable

import torch
from torch import Tensor, nn

from ...bodies import RiggedBody, load_body
from ...core.errors import InputError
from ...evaluate import protocols
from ..body_sampler import TABLE_KINDS, DataConfig
from ..character_surfaces import TrainingCharacters
from ..registered_meshes import RegisteredMeshes

ANIMAL_KINDS = {"mime": "wide", "npt": "wide", "aniformer": "clips"}
"""Networks that can be trained on the shipped quadruped, and the kind of data that has animals."""
UserData = TrainingCharacters | RegisteredMeshes
"""What the user brings to a training."""


@dataclass(frozen=True)
class TrainConfig:
    """Everything a training depends on besides the code; each model adds fields. The defaults are the papers'."""

    network: str = ""
    """Name of the model, as `tasks.find` knows it."""
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
    doublings: tuple[float, ...] = ()
    """Shares of the training after each of which meshes have twice as many vertices, and the batch twice as many parts,
    so that memory stays. Means over more vertices waver less: late, when details are learned, they are worth their
    time."""
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
    def most_parts(self) -> int:
        """Parts of a batch after the last doubling, in each process."""
        return self.accumulate << len(self.doublings)

    def check(self, where: str) -> None:
        """Raise InputError for values that do not go together; `where` begins the message."""
        if self.weight_decay and self.optimizer != "muon":
            raise InputError(f"{where}: expected weight_decay 0 with optimizer {self.optimizer}, found another")
        if self.data.characters and self.network not in ("mime", "hands", "npt"):
            raise InputError(f"{where}: expected data.characters 0 with {self.network}, found {self.data.characters}")
        kind = ANIMAL_KINDS.get(self.network)
        if self.data.body == "quadruped" and self.data.kind not in (kind, "meshes"):
            known = ", ".join(f"{network} on {of_it}" for network, of_it in ANIMAL_KINDS.items())
            raise InputError(
                f"{where}: expected data.body human with {self.network} on data.kind {self.data.kind}, found "
                f"quadruped; animals are data of {known}"
            )
        if self.data.between and self.data.kind != "clips80":
            raise InputError(f"{where}: expected data.between 0 with {self.data.kind}, found {self.data.between}")
        for name in ("recombine", "mix_people"):
            share = getattr(self.data, name)
            if share and self.data.kind not in TABLE_KINDS:
                raise InputError(f"{where}: expected data.{name} 0 with {self.data.kind}, found {share}")
        if self.data.pairing == "order" and (self.network not in ("npt", "aniformer") or self.data.characters):
            raise InputError(
                f"{where}: expected data.pairing random with {self.network}"
                f"{' and data.characters' * bool(self.data.characters)}, found order; leave it out"
            )
        if self.data.kind == "meshes" and self.network not in ("npt", "aniformer"):
            raise InputError(f"{where}: expected data.kind meshes with npt or aniformer, found it with {self.network}")
        if self.doublings and not self.data.vertices:
            raise InputError(f"{where}: expected data.vertices above 0 with doublings, found 0; set it")
        if any(not 0.0 < share < 1.0 for share in self.doublings):
            raise InputError(f"{where}: expected doublings between 0 and 1, found {list(self.doublings)}")
        if self.accumulate < 1 or self.batch % self.most_parts:
            twice = f" times {1 << len(self.doublings)} (doublings)" * bool(self.doublings)
            raise InputError(
                f"{where}: expected accumulate{twice} to divide batch, found {self.accumulate} and {self.batch}; "
                "change one"
            )
        for name in ("low_poly", "scans"):
            share = getattr(self.data, name)
            if share and (self.network != "mime" or self.data.kind != "wide"):
                raise InputError(f"{where}: expected data.{name} with mime and data.kind wide only, found {share}")
        if self.data.character_limits is not None and not (self.network == "mime" and self.data.characters):
            raise InputError(
                f"{where}: expected data.character_limits null without characters of mime, found "
                f"{self.data.character_limits}; leave it out"
            )
        for name in (
            "limits",
            "character_limits",
            "low_poly",
            "scans",
            "reflect",
            "between",
            "recombine",
            "mix_people",
        ):
            share = getattr(self.data, name)
            if share is not None and not 0.0 <= share <= 1.0:
                raise InputError(f"{where}: expected data.{name} from 0 to 1, found {share}")


@runtime_checkable
class BatchSource(Protocol):
    """Makes training batches."""

    def batch(self, size: int, step: int) -> Any:
        """Make the pairs of a step; a pure function of the source's seed and `step`."""
        ...


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
        self,
        config: Config,
        device: torch.device,
        precision: str = "fp32",
        brought: UserData | None = None,
    ) -> None:
        self.config, self.device, self.precision, self.brought = config, device, precision, brought

    @property
    def characters(self) -> TrainingCharacters | None:
        """The characters and clips that the user brought, if any."""
        return self.brought if isinstance(self.brought, TrainingCharacters) else None

    @property
    def meshes(self) -> RegisteredMeshes | None:
        """The registered meshes that the user brought, if any."""
        return self.brought if isinstance(self.brought, RegisteredMeshes) else None

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

    def with_vertices(self, vertices: int) -> Task[Config, Network]:
        """Copy the task for meshes of so many vertices."""
        config = dataclasses.replace(self.config, data=dataclasses.replace(self.config.data, vertices=vertices))
        return type(self)(config, self.device, self.precision, self.brought)

    @property
    def vertices(self) -> int:
        """Vertices of each training mesh."""
        whole = self.meshes.points.shape[1] if self.meshes else len(self.body.vertices)
        return self.config.data.vertices or whole
