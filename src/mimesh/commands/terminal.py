"""Shared by all commands: common options and what shells complete, printing, progress, and checks of output paths."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import typer

from ..core.printable import printable, say, shell_line

LINE_SECONDS = 10.0
"""Time between two lines that tell the progress where there is no terminal."""
SEPARATORS = tuple(filter(None, (os.sep, os.altsep)))
"""What a path of a folder may end in."""
MODELS = ("mime", "npt", "npt-maxpool", "aniformer", "copy", "deformation-transfer")
"""Names of models that -m takes."""


def lift_limits(wanted: bool) -> bool:
    """Lift the budgets of files until the command ends: `__main__.run` gives each command a context of its own."""
    if wanted:
        from ..core.budgets import lift_limits as lift

        lift()
    return wanted


def complete_model(incomplete: str) -> list[str]:
    """Complete the value of -m: a name, or the path of an .onnx file."""
    folder = Path(incomplete) if incomplete.endswith("/") else Path(incomplete).parent
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        entries = []
    # As the user writes it: "./net.onnx" and "net.onnx" are the same path.
    before = incomplete[: incomplete.rfind("/") + 1]
    paths = [
        before + entry.name + "/" * entry.is_dir() for entry in entries if entry.is_dir() or entry.suffix == ".onnx"
    ]
    hidden = incomplete[len(before) :].startswith(".")
    shown = [path for path in paths if hidden or not path[len(before) :].startswith(".")]
    return [word for word in (*MODELS, *shown) if word.startswith(incomplete)]


Model = Annotated[
    str,
    typer.Option(
        "--model",
        "-m",
        metavar="MODEL",
        help="A name that `mimesh models` prints, or the path of an .onnx file.",
        autocompletion=complete_model,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, and nothing else, on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Seed = Annotated[int, typer.Option(help="Seed of everything random.", min=0)]
NoLimits = Annotated[
    bool,
    typer.Option(
        "--no-limits", callback=lift_limits, help="Read files of any size; without it, see docs/formats.md, Limits."
    ),
]


def open_page(page: str | Path) -> None:
    """Open a page in the browser, or print its path if there is no browser."""
    import webbrowser

    if not webbrowser.open(Path(page).resolve().as_uri()):
        say(f"warning: no browser was found; open {page} in one", error=True)


class Stop(Exception):
    """Raised to end a command with an exit code and no further message."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object on one line of stdout; NaN and infinity, which JSON has not, become null."""
    say(json.dumps(_finite(value), allow_nan=False, default=_plain))


def say_tables(text: str) -> None:
    """Print Markdown; on a terminal its tables are drawn, in as many lines a row as the width asks for."""
    if not sys.stdout.isatty():
        say(*text.split("\n"))
        return
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Column, Table

    for is_table, group in groupby(text.split("\n"), lambda line: line.startswith("|")):
        if not is_table:
            say(*group)
            continue
        cells = ([escape(cell.strip().replace("`", "")) for cell in line.strip("|").split("|")] for line in group)
        head, _, *rows = cells
        table = Table(*(Column(name, overflow="fold") for name in head), box=box.SIMPLE, padding=0)
        for cells in rows:
            table.add_row(*cells)
        Console().print(table)


def print_next(*words: str | Path) -> None:
    """Print the command that a user may want to run next, quoted for the shell."""
    say(f"next: {shell_line('mimesh', *words)}")


@contextlib.contextmanager
def progress(what: str, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Yield a function of (done, total) that draws a bar; where stderr is no terminal a line tells of it now and then.

    With `quiet` nothing is shown, and None is yielded.
    """
    if quiet:
        yield None
        return
    if not sys.stderr.isatty():
        with progress_lines(what) as advance:
            yield advance
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    # The words may have names in them: they are a value of the template, and no markup.
    words = TextColumn("{task.description}", markup=False)
    columns = (words, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(printable(what), total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextlib.contextmanager
def progress_lines(what: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function of (done, total); a line on stderr tells the last ones every LINE_SECONDS.

    A thread writes the lines, so that they come during long steps that report nothing, too.
    """
    done_of: list[int] = []
    begin, ended = time.monotonic(), threading.Event()

    def write() -> None:
        while not ended.wait(LINE_SECONDS):
            counted = f" {done_of[0]}/{done_of[1]}" if len(done_of) == 2 else ""
            say(f"{what}{counted}, {time.monotonic() - begin:.0f} s", error=True)

    def advance(done: int, total: int) -> None:
        done_of[:] = done, total

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    try:
        yield advance
    finally:
        ended.set()
        writer.join()


def single(option: str, values: list[str] | None) -> str | None:
    """Return the value of an option that takes one; Typer would take the last of several without a word."""
    from ..core.errors import InputError

    if values and len(values) > 1:
        raise InputError(f"{option}: expected it once, found {', '.join(values)}; choose one of them")
    return values[0] if values else None


def output_beside(identity: Path, driving: Path, suffix: str) -> Path:
    """Return the default output, `<identity>-<driving><suffix>` in the identity's folder."""
    from ..core.errors import InputError
    from ..core.system import refuse_pipe
    from ..tools.driving import file_stem

    refuse_pipe(identity)
    if not identity.is_file():
        found = "a folder" if identity.is_dir() else "nothing of that name"
        raise InputError(f"{identity}: expected the file of the mesh to move, found {found}; check the path")
    return identity.with_name(f"{identity.stem}-{file_stem(driving)}{suffix}")


def output_path(given: str | None, usual: Callable[[], Path], frames: bool = False) -> Path:
    """Return the path of an output.

    Args:
        given: what the user gave, None for nothing. A folder that is there, or a text that ends in a slash, is where
            the output gets the usual name.
        usual: gives the default output.
        frames: whether a folder without the slash that holds numbered meshes is the output itself, as such.
    """
    from ..core.errors import InputError

    if given is None:
        return usual()
    if not given.strip():  # as of an unset variable: it would be the current folder
        raise InputError("--output: expected a path, found an empty text; check variables and quotes")
    path = Path(given)
    if given.endswith(SEPARATORS):
        if path.exists() and not path.is_dir():
            raise InputError(f"{given}: expected a folder for the output, found a file; leave the slash out")
        return path / usual().name
    if not path.is_dir() or (frames and any(file.stem[-1:].isdigit() for file in path.iterdir())):
        return path
    return path / usual().name


def refuse_existing(no_clobber: bool, *outputs: Path | None) -> None:
    """Check with --no-clobber that no output exists; None is no output."""
    from ..core.errors import InputError

    for path in filter(None, outputs):
        if no_clobber and (path.exists() or path.is_symlink()):
            raise InputError(
                f"{path}: expected nothing there with --no-clobber, found a {'folder' if path.is_dir() else 'file'}; "
                "name another with -o, or leave --no-clobber out"
            )


def given_path(text: str) -> Path:
    """Return the path of an argument; an empty one, as of an unset variable, would be the current folder."""
    if not text.strip():
        raise typer.BadParameter("expected a path, found an empty text; check variables and quotes")
    return Path(text)


def refuse_inputs(output: Path, *inputs: Path | None) -> None:
    """Check that an output would overwrite no input file and no file in a folder of input frames; None is no input."""
    from ..core.errors import InputError

    target = output.resolve()
    for path in filter(None, inputs):
        source = path.resolve()
        # On file systems that ignore case one file has several names: compare the files too.
        same = target == source or (target.exists() and source.exists() and target.samefile(source))
        if same:
            raise InputError(f"{output}: expected an output apart from the inputs, found {path}; give another with -o")
        if source.is_dir() and source in target.parents:
            raise InputError(
                f"{output}: expected an output apart from the inputs, found it in the folder {source}, which is one; "
                "give another with -o"
            )


def require(extra: str, *modules: str) -> None:
    """Check that the modules of an optional extra are installed."""
    from importlib.util import find_spec

    from ..core.errors import InputError

    for module in modules:
        if find_spec(module) is None:
            raise InputError(
                f"{module}: expected it for this command, found it not installed; pip install 'mimesh[{extra}]'"
            )


def _finite(value):
    """Replace floats that are not finite by None, in nested dictionaries and lists."""
    if isinstance(value, dict):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and value - value != 0:  # NaN or infinite
        return None
    return value


def _plain(value):
    """Convert NumPy numbers and paths, which json cannot write."""
    return str(value) if isinstance(value, Path) else _finite(value.item())
