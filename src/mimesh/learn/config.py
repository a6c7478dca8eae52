"""Training configurations: one YAML file each in `configs/`, checked against dataclasses."""

from __future__ import annotations

import dataclasses
import json
import types
import typing
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import yaml

from ..core.errors import InputError, did_you_mean
from ..core.system import refuse_pipe
from .models import NETWORKS, find_task
from .task import DataConfig, TrainConfig

MOST_DIFFERENCES = 4
"""Keys that an error about two configurations names; the rest is counted."""


def load_config(name_or_path: str, model: str = "npt", changes: Sequence[str] = ()) -> TrainConfig:
    """Load a shipped configuration by name (`paper`, `small`, ...) or a YAML file by path, with "key=value" changes.

    Raises:
        InputError: no such configuration, one of another model, or a key or value that does not belong.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = Path(str(resources.files("mimesh.learn") / "configs" / f"{model}-{name_or_path}.yaml"))
    if not path.exists():
        shipped = sorted(p.stem.removeprefix(f"{model}-") for p in path.parent.glob(f"{model}-*.yaml"))
        raise InputError(
            f"{name_or_path}: expected a configuration ({', '.join(shipped)}) or a YAML file, found neither"
            + did_you_mean(name_or_path, shipped)
        )
    refuse_pipe(path)
    values = {"network": model, **(yaml.safe_load(path.read_text(encoding="utf-8")) or {})}
    config = config_from(_changed(values, changes), str(path))
    if config.network != model:
        raise InputError(
            f"{path}: expected a configuration of {model}, found one of {config.network}; train {config.network}"
        )
    return config


def changed_config(config: TrainConfig, changes: Sequence[str]) -> TrainConfig:
    """Copy a configuration with "key=value" changes."""
    return config_from(_changed(dataclasses.asdict(config), changes), f"--set {', '.join(changes)}")


def _changed(values: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """Put changes such as "model.blocks=conv" into new nested dictionaries; values as in JSON, else a word."""
    for change in changes:
        key, equals, value = change.partition("=")
        if not (key and equals and value):
            raise InputError(f"--set {change}: expected KEY=VALUE, found something else; for example model.blocks=conv")
        group = values
        *above, last = key.split(".")
        for name in above:
            group = group.setdefault(name, {})
            if not isinstance(group, dict):
                raise InputError(f"--set {change}: expected {name} to hold keys, found a value; check the key")
        try:
            group[last] = json.loads(value)
        except json.JSONDecodeError:
            group[last] = value
    return values


def config_differences(here: TrainConfig, there: TrainConfig, of: Sequence[str] = ()) -> str:
    """Name the keys in which two configurations differ, with both values: "minutes 21 here, 20 there".

    Args:
        here: what was asked for.
        there: what was found.
        of: only these fields and the keys within them; all if there are none.
    """
    both = [_flat({k: v for k, v in dataclasses.asdict(c).items() if not of or k in of}) for c in (here, there)]
    keys = [key for key in dict.fromkeys((*both[0], *both[1])) if both[0].get(key) != both[1].get(key)]
    words = [f"{key} {both[0].get(key, 'none')} here, {both[1].get(key, 'none')} there" for key in keys]
    more = [f"and {len(keys) - MOST_DIFFERENCES} more"] * (len(keys) > MOST_DIFFERENCES)
    return "; ".join(words[:MOST_DIFFERENCES] + more)


def _flat(values: dict[str, Any]) -> dict[str, str]:
    flat: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            flat |= {f"{key}.{inner}": text for inner, text in _flat(value).items()}
        else:
            flat[key] = value if isinstance(value, str) else json.dumps(value).removesuffix(".0")
    return flat


def config_from(values: dict[str, Any], where: str) -> TrainConfig:
    """Build a network's configuration from nested dictionaries; messages of errors begin with `where`."""
    if not isinstance(values, dict):
        raise InputError(f"{where}: expected keys and values, found {values!r}")
    network = values.get("network", "npt")
    if network not in NETWORKS:
        raise InputError(
            f"{where}, network: expected {' or '.join(NETWORKS)}, found {network!r}"
            + did_you_mean(str(network), NETWORKS)
        )
    config = _build(find_task(network).config_type, values, where)
    config.check(where)
    return config


def recorded_config(values: dict[str, Any], where: str) -> TrainConfig:
    """Build the configuration that a checkpoint or card holds.

    Older files hold options that its model or its data no longer have, which are left out.
    """
    if (network := values.get("network", "npt")) in NETWORKS:
        values = _known(find_task(network).config_type, values)
        if "data" in values:
            values = {**values, "data": _known(options_of(network), values["data"])}
    return config_from(values, where)


def _known(kind: type, values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key in {field.name for field in dataclasses.fields(kind)}}


def options_of(network: str) -> type[DataConfig]:
    """Give the options of a model's data."""
    return typing.get_type_hints(find_task(network).config_type)["data"]


def _build(kind: type, values: Any, where: str) -> Any:
    if not isinstance(values, dict):
        raise InputError(f"{where}: expected keys and values, found {values!r}")
    hints = typing.get_type_hints(kind)
    hints = {field.name: hints[field.name] for field in dataclasses.fields(kind)}
    unknown = sorted(set(values) - set(hints))
    if unknown:
        raise InputError(
            f"{where}: expected the keys {', '.join(hints)}, found {', '.join(unknown)}"
            + (did_you_mean(unknown[0], hints) or "; remove it")
        )
    return kind(**{k: _value(hints[k], v, f"{where}, {k}") for k, v in values.items()})


def _value(hint: Any, value: Any, where: str) -> Any:
    """Check one value against its type; lists become tuples and integers floats."""
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), value, where)
    origin = typing.get_origin(hint)
    if origin is Literal:
        fits = value in typing.get_args(hint)
    elif origin is tuple:
        value, fits = tuple(value), ... in typing.get_args(hint) or len(value) == len(typing.get_args(hint))
    elif hint is float or (hint == float | None and value is not None):
        fits = isinstance(value, (int, float)) and not isinstance(value, bool)
        value = float(value) if fits else value
    else:
        fits = isinstance(value, hint) and (hint is bool or not isinstance(value, bool))
    if not fits:
        wanted = " or ".join(typing.get_args(hint)) if origin is Literal else getattr(hint, "__name__", hint)
        if isinstance(hint, types.GenericAlias):
            wanted = hint
        raise InputError(f"{where}: expected {wanted}, found {value!r}")
    return value
