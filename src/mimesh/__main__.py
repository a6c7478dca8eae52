"""The `mimesh` command: registers the functions of `commands/`, and turns errors into messages and exit codes.

Exit codes: 0 success; 1 a bug of mimesh; 2 wrong input or usage, with a message of one line; 3 some jobs of a batch
failed; 130 stopped. Nothing here or in `commands/` imports NumPy or anything heavier before a command runs, so that
`mimesh --help` is quick.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from contextvars import copy_context
from functools import cache
from typing import Annotated, Any

import typer

from .commands import about, learn, measure, move, show
from .commands.joints import capture, rig
from .commands.options import Command
from .commands.terminal import Stop
from .core.printable import say
from .jobs.command import batch

app = typer.Typer(
    name="mimesh",
    help="Give a mesh the pose or motion of another: no rig, no markers, no correspondence, no GPU.",
    epilog="First steps: mimesh demo, then mimesh transfer IDENTITY DRIVING. Every command has --help and --json.",
    no_args_is_help=True,
    # Rich's help costs 60 ms at every start.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
COMMANDS = (
    move.transfer,
    move.animate,
    rig,
    capture,
    batch,
    show.convert,
    show.look,
    show.render,
    show.studio,
    about.demo,
    about.models,
    about.doctor,
    measure.evaluate,
    measure.table,
    measure.generate,
    learn.train,
    learn.export,
)
STOPPED = 130
"""Exit code after Ctrl-C, as shells have it."""


for _command in COMMANDS:
    app.command(_command.__name__, cls=Command)(_command)


def _version(requested: bool) -> bool:
    if requested:
        from . import __version__

        typer.echo(f"mimesh {__version__}")
        raise typer.Exit
    return requested


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@cache
def command_line() -> Any:
    """Build the command line: 0.2 s, which programs that run several commands spend once."""
    return typer.main.get_command(app)


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit with its code."""
    signal.signal(signal.SIGTERM, _terminate)
    # File names may contain bytes that are no text: print those escaped, as stderr does.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    code = run(sys.argv[1:] if arguments is None else arguments)
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        # `mimesh look ... | head`: keep the interpreter from flushing once more at its end, which prints an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code; the message about a failure is already on stderr."""
    from .core.errors import naming_options

    try:
        # Commands return nothing, or the facts that they print.
        # What an option sets for one command, such as --no-limits, ends with it.
        with naming_options():
            returned = copy_context().run(command_line(), arguments, prog_name="mimesh", standalone_mode=False)
        code = returned if isinstance(returned, int) else 0
        return _print_error("stopped", code) if code == STOPPED else code
    except Stop as stop:
        return stop.code
    except SystemExit:
        # Typer exits this way when the reader of our output has closed the pipe: no message can reach the user.
        return 0
    except Exception as error:
        return _report_error(error)


def _terminate(*_: object) -> None:
    """Handle SIGTERM as Ctrl-C, so that temporary files are removed."""
    raise KeyboardInterrupt


def _report_error(error: Exception) -> int:
    """Print the message of an error and return the exit code."""
    if isinstance(error, typer.Abort):
        return _print_error("stopped", STOPPED)
    # Typer's versions define their usage errors in different modules; all of them have `format_message`.
    if hasattr(error, "format_message"):
        return _report_usage(error)
    from .core.errors import InputError

    if isinstance(error, InputError):
        return _print_error(" ".join(str(error).split()), 2)
    return _report_bug(error)


def _report_usage(error) -> int:
    """Print what is wrong with the usage; where arguments are missing the usage, for `mimesh` alone the help."""
    context = getattr(error, "ctx", None)
    message = error.format_message()
    if context is not None and message.strip() == context.get_help().strip():
        say(*message.rstrip().splitlines(), error=True)
        return error.exit_code
    message = " ".join(message.split()).rstrip(".")
    if not message:  # older versions of Typer have printed the help
        return error.exit_code
    if context is None:
        return _print_error(f"{message}; see mimesh --help", 2)
    if known := getattr(error, "possibilities", None):
        from .core.errors import did_you_mean

        message = f"no such option: {error.option_name}{did_you_mean(error.option_name, known)}"
    missing = _missing_arguments(error, context)
    if not missing:
        return _print_error(f"{message}; see {context.command_path} --help", 2)
    code = _print_error(f"expected {' and '.join(missing)}, found nothing; see {context.command_path} --help", 2)
    say(*context.get_usage().splitlines(), error=True)
    return code


def _missing_arguments(error, context) -> list[str]:
    """Name the arguments that are missing, as the usage does; none for other errors."""
    first = getattr(error, "param", None)
    # Typer's versions define this error in different modules, too.
    if type(error).__name__ != "MissingParameter" or first is None or first.opts[0].startswith("-"):
        return []
    rest = context.command.params[context.command.params.index(first) :]
    return [argument.make_metavar(context) for argument in rest if argument.required and argument.opts[0][:1] != "-"]


def _report_bug(error: Exception) -> int:
    """Print the last lines of the traceback, and where to report them."""
    import traceback

    last = traceback.extract_tb(error.__traceback__)[-4:]
    say(*"".join(traceback.format_list(last)).splitlines(), error=True)
    _print_error(f"{type(error).__name__}: {error}".splitlines()[0], 1)
    say("This is a bug of mimesh; please report it with the lines above and `mimesh doctor`'s.", error=True)
    return 1


def _print_error(message: str, code: int) -> int:
    say(f"mimesh: {message}", error=True)
    return code


if __name__ == "__main__":
    main()
