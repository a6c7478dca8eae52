"""Options of commands: those of `core.options`, one for each field, and those that most commands that write have."""

from __future__ import annotations

import builtins
import dataclasses
import functools
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import typer
from typer.core import TyperCommand

from ..core.options import RecordedRange, declared
from ..core.printable import say
from ..core.threads import LINEAR_ALGEBRA
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
    """Return the options of a class among a command's parsed values; those that it does not have are the defaults."""
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


LOGGER = "mimesh"
"""Name of the logger whose lines --verbose prints."""
NETWORKS = "MIMESH_THREADS"
"""Environment variable of the threads of a network (`methods.onnx_runtime`)."""
ALL_CORES = ("train",)
"""Commands that use all cores by default: their matrix products are large."""


class Command(TyperCommand):
    """A command with the options of this module."""

    def __init__(self, *args: Any, params: list | None = None, **options: Any) -> None:
        super().__init__(*args, params=[*(params or ()), *_common_options()], **options)


def _common_options() -> list[Any]:
    """Make the options anew: each belongs to one command."""
    # From a command of Typer's own making: its option class has other arguments in almost every release.
    app = typer.Typer(add_completion=False)
    app.command()(_options)
    return typer.main.get_command(app).params


def _verbose(context: Any, _parameter: Any, wanted: bool) -> None:
    """Print lines of the log, until the command ends."""
    if not wanted:
        return
    import logging

    class Lines(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            say(f"{record.levelname.lower()}: {record.getMessage()}", error=True)

    logger, lines = logging.getLogger(LOGGER), Lines()
    before = logger.level
    logger.addHandler(lines)
    logger.setLevel(logging.INFO)
    context.call_on_close(lambda: (logger.removeHandler(lines), logger.setLevel(before)))


def _threads(context: Any, _parameter: Any, count: int | None) -> None:
    from ..core.errors import InputError

    if count is not None and count < 1:
        raise InputError(f"--threads: expected 1 or more, found {count}; give a positive number")
    if "numpy" in sys.modules:  # a program runs the command: its libraries are loaded, and its settings stay
        if count is not None:
            _limit_loaded(count, context.call_on_close)
        return
    chosen = any(os.environ.get(name) for name in LINEAR_ALGEBRA)
    if count is None and (chosen or context.command.name in ALL_CORES):
        return
    os.environ.update(dict.fromkeys(LINEAR_ALGEBRA, str(count or 1)))
    if count is not None:
        os.environ[NETWORKS] = str(count)


def _limit_loaded(count: int, at_end: Callable[[Callable[[], object]], object]) -> None:
    """Set the threads of libraries that are loaded already, until the command ends."""
    from threadpoolctl import threadpool_limits

    limits, before = threadpool_limits(count, user_api="blas"), os.environ.copy()
    set_here = {name: str(count) for name in (*LINEAR_ALGEBRA, NETWORKS)}
    os.environ.update(set_here)

    def restore() -> None:
        limits.restore_original_limits()
        for name in set_here:
            if name in before:
                os.environ[name] = before[name]
            else:
                del os.environ[name]

    at_end(restore)


def _options(
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            "-v",
            expose_value=False,
            callback=_verbose,
            help="Tell the times of the steps, and what was chosen and why, on stderr.",
        ),
    ] = False,
    threads: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            expose_value=False,
            callback=_threads,
            help="Threads of networks (2) and linear algebra (1; in training one a core).",
        ),
    ] = None,
) -> None:
    """Declare the options of this module; `_common_options` takes them from here."""
