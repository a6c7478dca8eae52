"""Training configurations: one YAML file each in `configs/`, checked against dataclasses."""

from __future__ import annotations

import dataclasses
import json
import types
import typing
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import yaml

from ..core.errors import InputError
from ..evaluate.clip_protocols import FRAMES
from .aniformer import AniFormerConfig
from .batches import DataConfig
from .limp import LIMPConfig, LIMPLossConfig
from .mime import MimeConfig
from .mime_loss import MimeLossConfig
from .npt import NPTConfig

MODELS = {"npt": NPTConfig, "aniformer": AniFormerConfig, "limp": LIMPConfig, "mime": MimeConfig}
"""What `network` of a configuration may be, and the switches of each."""


@dataclass(frozen=True)
class ClipLossConfig:
    """AniFormer's constraints beside the reconstruction (Eq. 6)."""

    motion: Literal["paper", "velocity", "off"] = "paper"
    motion_weight: float = 1e-3
    appearance: Literal["paper", "ratio", "off"] = "paper"
    appearance_weight: float = 1e-2


@dataclass(frozen=True)
class TrainConfig:
    """Everything a training depends on besides the code; the defaults are NPT's paper."""

    network: Literal["npt", "aniformer", "limp", "mime"] = "npt"
    model: NPTConfig | AniFormerConfig | LIMPConfig | MimeConfig = field(default_factory=NPTConfig)
    data: DataConfig = field(default_factory=DataConfig)
    batch: int = 8
    """Pairs a step; AniFormer's pairs are windows of T frames."""
    pairs: int = 800_000
    """Length of the training: 200 epochs of 4,000 pairs."""
    minutes: float = 0.0
    """Length in CPU-minutes of steps instead (minutes with a GPU; 0: `pairs` counts), for trainings that are compared
    at equal time. Resuming continues the schedule by the time spent; how many pairs fit into it is the machine's."""
    optimizer: Literal["adam", "muon"] = "adam"
    """`muon` for the matrices between features (Adam for the rest); the papers use Adam."""
    learning_rate: float = 5e-5
    warmup: int = 0
    """Pairs over which the learning rate rises from zero."""
    decay: float = 0.0
    """Share of the training, at its end, over which the learning rate falls linearly to zero."""
    milestones: tuple[float, ...] = ()
    """Shares of the training after each of which the learning rate is a tenth."""
    beta2: float = 0.999
    clip: float = 0.0
    """Largest norm of the gradient of the loss divided by V; 0 does not clip."""
    ema: float = 0.0
    """Decay of the running average of the weights that is validated and kept; 0 keeps the weights themselves."""
    edge: Literal["paper", "ratio", "off"] = "paper"
    edge_weight: float = 5e-4
    """This and `edge` are NPT's."""
    losses: ClipLossConfig = field(default_factory=ClipLossConfig)
    """AniFormer's."""
    metrics: LIMPLossConfig = field(default_factory=LIMPLossConfig)
    """LIMP's."""
    structure: MimeLossConfig = field(default_factory=MimeLossConfig)
    """mime's."""
    precision: Literal["fp32", "bf16"] = "fp32"
    compile: bool = False
    """Fuse element-wise work with torch.compile (needs a C++ compiler on a CPU)."""
    validate_every: int = 20_000
    """Pairs between validations on the `val` split."""
    validation_pairs: int = 24
    """Pairs of each kind in a validation, at most 72."""
    seed: int = 0


def load_config(name_or_path: str, model: str = "npt", changes: Sequence[str] = ()) -> TrainConfig:
    """A shipped configuration by name (`paper`, `small`, ...) or a YAML file by path, with "key=value" changes.

    Raises:
        InputError: no such configuration, or a key or value that does not belong.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = Path(str(resources.files("mimesh.learn") / "configs" / f"{model}-{name_or_path}.yaml"))
    if not path.exists():
        shipped = sorted(p.stem.removeprefix(f"{model}-") for p in path.parent.glob(f"{model}-*.yaml"))
        raise InputError(
            f"{name_or_path}: expected a configuration ({', '.join(shipped)}) or a YAML file, found neither"
        )
    values = yaml.safe_load(path.read_text()) or {}
    for change in changes:
        _change(values, change)
    return config_from(values, str(path))


def _change(values: dict[str, Any], change: str) -> None:
    """Put "model.blocks=conv" into nested dictionaries; numbers, lists, true and false as in JSON, else a word."""
    key, equals, value = change.partition("=")
    if not (key and equals and value):
        raise InputError(f"--set {change}: expected KEY=VALUE, found something else; for example model.blocks=conv")
    *groups, last = key.split(".")
    for group in groups:
        values = values.setdefault(group, {})
        if not isinstance(values, dict):
            raise InputError(f"--set {change}: expected {group} to hold keys, found a value; check the key")
    try:
        values[last] = json.loads(value)
    except json.JSONDecodeError:
        values[last] = value


def config_from(values: dict[str, Any], where: str) -> TrainConfig:
    """Build the dataclass tree from nested dictionaries, refusing what does not fit."""
    if not isinstance(values, dict):
        raise InputError(f"{where}: expected keys and values, found {values!r}")
    network = values.get("network", "npt")
    if network not in MODELS:
        raise InputError(f"{where}, network: expected {' or '.join(MODELS)}, found {network!r}")
    config = _build(TrainConfig, {"model": {}, **values}, where, {"model": MODELS[network]})
    if isinstance(config.model, AniFormerConfig):
        _check_windows(config, config.model, where)
    if isinstance(config.model, LIMPConfig):
        _check_template(config, config.model, where)
    if isinstance(config.model, MimeConfig):
        _check_points(config, config.model, where)
    return config


def _check_windows(config: TrainConfig, model: AniFormerConfig, where: str) -> None:
    """Raise InputError for windows that cannot be cut, attended to or held to the losses."""
    if config.data.kind not in ("clips", "clips80"):
        raise InputError(
            f"{where}: expected data.kind clips or clips80 with aniformer, found {config.data.kind}; set it"
        )
    if not 1 <= model.frames <= FRAMES:
        raise InputError(f"{where}, frames: expected 1 to {FRAMES}, found {model.frames}")
    undivided = [width for width in model.layers if model.heads < 1 or width % model.heads]
    if undivided and model.attention != "off":
        raise InputError(f"{where}: expected heads that divide every layer, found {model.heads} for {undivided[0]}")
    held, least = 1 if model.head == "regression" else model.frames, {"off": 1, "velocity": 2, "paper": 3}
    if held < least[config.losses.motion]:
        raise InputError(
            f"{where}: expected results of {least[config.losses.motion]} frames or more for losses.motion "
            f"{config.losses.motion}, found {held}; set losses.motion to off"
        )


def _check_template(config: TrainConfig, model: LIMPConfig, where: str) -> None:
    """Raise InputError for meshes that are not the template's, or whose lengths cannot be compared."""
    if config.data.vertices != model.vertices:
        raise InputError(
            f"{where}: expected data.vertices as model.vertices, the template's {model.vertices}, "
            f"found {config.data.vertices}; set one of them"
        )
    if config.data.target_scale != "identity":
        raise InputError(f"{where}: expected data.target_scale identity with limp, which keeps lengths, found truth")


def _check_points(config: TrainConfig, model: MimeConfig, where: str) -> None:
    """Raise InputError for data that mime cannot be trained on, or a width that does not divide."""
    if config.data.kind not in ("table6", "wide"):
        raise InputError(f"{where}: expected data.kind table6 or wide with mime, found {config.data.kind}; set it")
    if config.data.target_scale != "identity":
        raise InputError(f"{where}: expected data.target_scale identity with mime, which keeps lengths, found truth")
    if model.heads < 1 or model.width % model.heads:
        raise InputError(f"{where}: expected heads that divide width {model.width}, found {model.heads}")


def _build(kind: type, values: Any, where: str, known: dict[str, type] | None = None) -> Any:
    if not isinstance(values, dict):
        raise InputError(f"{where}: expected keys and values, found {values!r}")
    hints = typing.get_type_hints(kind) | (known or {})
    unknown = sorted(set(values) - set(hints))
    if unknown:
        raise InputError(f"{where}: expected the keys {', '.join(hints)}, found {', '.join(unknown)}; remove it")
    return kind(**{k: _value(hints[k], v, f"{where}, {k}") for k, v in values.items()})


def _value(hint: Any, value: Any, where: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), value, where)
    origin = typing.get_origin(hint)
    if origin is Literal:
        fits = value in typing.get_args(hint)
    elif origin is tuple:
        value, fits = tuple(value), ... in typing.get_args(hint) or len(value) == len(typing.get_args(hint))
    elif hint is float:
        fits = isinstance(value, (int, float)) and not isinstance(value, bool)
        value = float(value) if fits else value
    else:
        fits = isinstance(value, hint) and (hint is bool or not isinstance(value, bool))
    if not fits:
        wanted = typing.get_args(hint) if origin is Literal else getattr(hint, "__name__", hint)
        if isinstance(hint, types.GenericAlias):
            wanted = hint
        raise InputError(f"{where}: expected {wanted}, found {value!r}")
    return value
