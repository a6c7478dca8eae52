"""Options of commands: those of `core.options`, one for each field, and those that most commands that write have."""

from __future__ import annotations

import builtins
import dataclasses
import functools
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import typer

from ..core.options import RecordedRange, declared
from .terminal import lift_limits

T = TypeVar("T")


class Without:
    """Annotation of a parameter that is a class of options: the fields that a command does not have."""

    def __init__(self, *names: str) -> None:
        self.names = names


def with_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command that has an option for each field of the classes of options among its parameters."""
    hints, parameters, groups = get_type_hints(function, include_extras=True), [], {}
    for parameter in inspect.signature(function).parameters.values():
        kind, *extras = get_args(hints[parameter.name]) or (hints[parameter.name],)
        if not isinstance(kind, type) or not dataclasses.is_dataclass(kind):
            parameters.append(parameter.replace(annotation=hints[parameter.name], kind=parameter.KEYWORD_ONLY))
            continue
        left_out = {name for extra in extras if isinstance(extra, Without) for name in extra.names}
        fields = [field for field in dataclasses.fields(kind) if field.name not in left_out]
        groups[parameter.name] = kind, [_flag(field) for field in fields]
        parameters += [
            inspect.Parameter(
                _flag(field), parameter.KEYWORD_ONLY, default=field.default, annotation=_option(kind, field)
            )
            for field in fields
        ]

    @functools.wraps(function)
    def command(**values: Any) -> Any:
        for name, (kind, flags) in groups.items():
            values[name] = options_of(kind, {flag: values.pop(flag) for flag in flags})
        return function(**values)

    command.__signature__ = inspect.Signature(parameters)  # type: ignore
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def options_of(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return the options of a class among a command's parsed values; those that it does not have are the defaults.

    Args:
        values: parameter of the command -> value.
    """
    flags = {_flag(field): field.name for field in dataclasses.fields(kind)}  # type: ignore
    return kind(**{name: values[flag] for flag, name in flags.items() if flag in values})


def _flag(field: dataclasses.Field) -> str:
    """Return the name of the option of a field, without dashes before it and with underscores."""
    names = field.metadata.get("name") or (field.name,)
    first = names if isinstance(names, str) else names[0]
    return first.split("/")[0].lstrip("-").replace("-", "_")


def _option(kind: type, field: dataclasses.Field) -> Any:
    """Return the annotation that Typer makes an option of."""
    more = dict(field.metadata)
    names, values = more.pop("name", ()), more.pop("values")
    module = next(base.__module__ for base in kind.__mro__ if field.name in vars(base).get("__annotations__", {}))
    value_kind = more.pop("kind", None) or eval(str(field.type), vars(builtins) | vars(sys.modules[module]))  # ours
    if values:
        more["autocompletion"] = lambda incomplete: [value for value in values if value.startswith(incomplete)]
    return Annotated[value_kind, typer.Option(*([names] if isinstance(names, str) else names), **more)]


@dataclass(frozen=True)
class OutputOptions:
    """Where a command writes, what it shows, and what it prints."""

    output: str | None = declared(
        None,
        "Where to write; its suffix is the format. A folder (there, or ending in /) gets the usual name in it.",
        name=("--output", "-o"),
        metavar="PATH",
    )
    preview: bool = declared(
        True, "Write a picture beside the output, and a page that plays it.", name="--preview/--no-preview"
    )
    open: bool = declared(False, "Open the page in the browser.", name="--open")
    no_clobber: bool = declared(False, "Stop before the work if an output exists.", name=("--no-clobber", "-n"))
    no_limits: bool = declared(
        False,
        "Read files of any size; without it, see docs/formats.md, Limits.",
        name="--no-limits",
        callback=lift_limits,
    )
    json: bool = declared(False, "Print one JSON object, and nothing else, on stdout.", name="--json")
    quiet: bool = declared(False, "Print nothing but errors.", name=("--quiet", "-q"))

    @property
    def silent(self) -> bool:
        """Whether nothing is printed during the work."""
        return self.quiet or self.json


@dataclass(frozen=True)
class ClipOptions(RecordedRange):
    """Which clip of a file is read, and which of its frames."""

    animation: list[str] | None = declared(
        None, "Animation of a GLB: its name or number; animate takes several, or all.", metavar="NAME"
    )


@dataclass(frozen=True)
class JointOptions:
    """Files of joints that are read and written."""

    no_joints: bool = declared(False, "Ignore the .joints.json beside the inputs.", name="--no-joints")
    save_joints: Path | None = declared(None, "Write the joints found, to be edited (mime).", metavar="FILE")
    save_driving_joints: Path | None = declared(
        None, "Write those found on DRIVING's first frame (mime).", metavar="FILE"
    )


@dataclass(frozen=True)
class ShapeOptions:
    """What is written instead of joints."""

    morphs: bool = declared(False, "Write a morph target for each frame, not joints (.glb, .gltf).", name="--morphs")
