"""Write jobs as arguments of `mimesh animate` and `mimesh transfer`, check these arguments, and run them."""

from __future__ import annotations

from contextvars import copy_context
from functools import cache
from typing import Any

import typer

from ..commands import move
from ..core.errors import InputError, did_you_mean
from .table import BatchJob

SWITCH_VALUES = {
    "yes": True,
    "true": True,
    "1": True,
    "on": True,
    "no": False,
    "false": False,
    "0": False,
    "off": False,
}
NOT_FOR_JOBS = ("output", "open", "json", "quiet", "help")
"""Options that a batch gives each job itself."""
PREVIEW = "preview"
"""Option that is off by default in a batch, which has a sheet of all results."""


@cache
def _commands() -> dict[str, Any]:
    """Return the commands by name, as the library behind Typer has them."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command("animate")(move.animate)
    app.command("transfer")(move.transfer)
    group: Any = typer.main.get_command(app)
    return dict(group.commands)


@cache
def _options(command: str) -> dict[str, Any]:
    """Return the options of a command: name without dashes -> parameter."""
    return {
        flag.lstrip("-"): parameter
        for parameter in _commands()[command].params
        for flag in (*parameter.opts, *parameter.secondary_opts)
        if flag.startswith("--") and flag.lstrip("-") not in NOT_FOR_JOBS
    }


def arguments(job: BatchJob) -> list[str]:
    """Return the arguments of the command that does a job.

    Raises:
        InputError: the command has no such option, or a switch is neither on nor off.
    """
    words = [f"--output={job.output}", "--quiet"]
    known, options = _options(job.command), dict(job.options)
    for given, value in {PREVIEW: "no", **options}.items():
        name = given.replace("_", "-")  # as arguments of Python are written
        parameter = known.get(name)
        if parameter is None:
            raise InputError(
                f"{job.where}: expected an option of mimesh {job.command}, found {given}"
                f"{did_you_mean(name, known)}; mimesh {job.command} --help lists them"
            )
        words += _flag(job, name, value, parameter) if parameter.is_flag else [f"--{name}={value}"]
    return [*words, "--", job.identity, job.driving]


def _flag(job: BatchJob, name: str, value: str, parameter: Any) -> list[str]:
    """Return the switch that says yes or no."""
    on = SWITCH_VALUES.get(value.lower())
    if on is None:
        raise InputError(f"{job.where}: expected yes or no for {name}, found {value!r}; write one of them")
    flags = parameter.opts if on else parameter.secondary_opts
    return [flags[0]] if flags else []


def parsed(job: BatchJob) -> dict[str, Any]:
    """Parse the arguments of a job: parameter -> value.

    Raises:
        InputError: an option does not exist, or a value is not of its kind.
    """
    words = arguments(job)
    try:
        # What an option sets, such as --no-limits, does not outlast the parsing.
        return dict(copy_context().run(_commands()[job.command].make_context, job.command, words).params)
    except Exception as error:
        # Typer's versions define their usage errors in different modules; all of them have `format_message`.
        if (format_message := getattr(error, "format_message", None)) is not None:
            message = " ".join(format_message().split()).rstrip(".")
            raise InputError(f"{job.where}: {message}; see mimesh {job.command} --help") from error
        raise


@cache
def model_of(command: str, options: tuple[tuple[str, str], ...]) -> str:
    """Return the name of the model that jobs with these options use."""
    return str(parsed(BatchJob("options", command, "identity", "driving", "output", options))["model"])


def run_command(job: BatchJob) -> dict[str, Any]:
    """Run the command of a job and return the facts that it prints with --json.

    Raises:
        InputError: as the command.
    """
    command = _commands()[job.command]

    def run() -> dict[str, Any]:
        with command.make_context(job.command, arguments(job)) as context:
            return command.invoke(context)

    return copy_context().run(run)  # what an option sets, such as --no-limits, ends with the job
