"""Options that every command has: --verbose and --threads."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ..core.printable import say

LOGGER = "mimesh"
"""Name of the logger whose lines --verbose prints."""
NETWORKS = "MIMESH_THREADS"
"""Environment variable of the threads of a network (`methods.onnx_runtime`)."""
LINEAR_ALGEBRA = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables of the threads of linear algebra, which its libraries read when they are loaded."""
ALL_CORES = ("train",)
"""Commands that use all cores by default: their matrix products are large. Elsewhere a second thread of linear algebra
waits for the first by spinning: with other programs on two cores, transfers took 2.5 times as long, and 2.5 times the
processor time (benchmarks/threads.json)."""


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

    limits, before = threadpool_limits(count, user_api="blas"), os.environ.get(NETWORKS)
    os.environ[NETWORKS] = str(count)

    def restore() -> None:
        limits.restore_original_limits()
        os.environ.pop(NETWORKS)
        if before is not None:
            os.environ[NETWORKS] = before

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
