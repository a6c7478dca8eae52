"""Jobs of a batch: of a table, of all pairs of two sets of files, or of one set; all are checked before the start.

A job is one run of `mimesh animate`, `transfer`, `rig` or `capture`. Its options are the command's, which parses them.
"""

from __future__ import annotations

import csv
import glob
import os
import string
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import typer

from ..commands import move
from ..commands.joints import capture, rig
from ..commands.options import ShapeOptions, options_of
from ..commands.outputs import check_clip_output, check_suffix, usual_suffix
from ..commands.terminal import SEPARATORS, output_path, refuse_inputs
from ..core.arguments import described
from ..core.errors import InputError, NotInstalledError, did_you_mean, option
from ..core.options import Hints, Layout, ModelOptions, MotionOptions
from ..core.system import refuse_pipe
from ..io import check_readable, mesh_suffixes
from ..io.formats import ANIMATED, CLIP_READERS, JOINTED, MESH_WRITERS
from ..methods.find import find_mime, find_model
from ..mime.model import Mime
from ..pipeline.capturing import JOINT_FILES
from ..tools.driving import file_stem
from ..tools.preview import names_beside

INPUTS = {
    "animate": ("identity", "driving"),
    "transfer": ("identity", "driving"),
    "rig": ("identity",),
    "capture": ("driving",),
}
"""Command -> what it reads."""
COMMANDS = tuple(INPUTS)
TABLES = (".csv", ".tsv", ".txt")
"""Suffixes of tables of jobs, where a folder or a pattern of files could be meant, too."""
FILE_OPTIONS = ("reference", "markers", "body_model", "joints", "driving_joints")
"""Options whose values are input files."""
NOT_FOR_JOBS = ("output", "open", "json", "quiet", "help")
"""Options that a batch gives each job itself."""
SWITCHES = {**dict.fromkeys(("yes", "true", "1", "on"), True), **dict.fromkeys(("no", "false", "0", "off"), False)}
"""What the value of a switch may be."""
MOST_SHOWN = 3
"""Errors that are shown of many."""
Row = tuple[str, Mapping[Any, Any]]
"""Where a row comes from, for messages, and its values by column."""


@dataclass(frozen=True)
class BatchJob:
    """One run of a command."""

    where: str
    """Where it comes from, for messages: "jobs.csv:3"."""
    command: str
    """One of COMMANDS."""
    identity: str
    """Empty for a capture."""
    driving: str
    """Empty for a rig."""
    output: str
    options: tuple[tuple[str, str], ...] = ()
    """Names of options without dashes, and their values; yes or no for switches."""
    more: tuple[str, ...] = ()
    """Further clips, whose animations go into the same file."""

    @property
    def name(self) -> str:
        """Name of the inputs in lists and pictures."""
        return " + ".join(map(file_stem, self.files))

    @property
    def files(self) -> list[str]:
        """Paths of the inputs: identity and driving, or the one that the command takes, and further clips."""
        return [path for path in (self.identity, self.driving, *self.more) if path]

    def inputs(self) -> dict[str, Path]:
        """Return the files that it reads by what they are: identity, driving, and those that its options name."""
        files = {name: Path(getattr(self, name)) for name in INPUTS[self.command]}
        files |= {f"driving {number}": Path(path) for number, path in enumerate(self.more, 2)}
        return files | {name: Path(path) for name, path in self.options if name.replace("-", "_") in FILE_OPTIONS}

    def outputs(self) -> list[Path]:
        """Return the files that it writes: the output, joints, and its preview if one is wanted."""
        values = option_values(self.command, self.options)
        joints = (values.get("save_joints"), values.get("save_driving_joints"))
        written = [Path(path) for path in (self.output, *joints) if path is not None]
        if not values.get("preview"):
            return written
        if self.command == "rig":
            return [*written, names_beside(Path(self.output))[0]]
        usual = ".glb" if self.command == "animate" else usual_suffix(Path(self.identity))
        return [*written, *names_beside(Path(self.output), usual=usual)]


def read_jobs(
    identities: str | Path | Sequence[Mapping[str, Any]] | Sequence[str | Path],
    drivings: str | Path | Sequence[str | Path] | None,
    output: str | Path | None,
    options: Mapping[str, Any],
    command: str,
) -> list[BatchJob]:
    """Return the jobs of a table or of rows, or with `drivings` one for each pair; for the arguments see `run.batch`.

    A row has identity and driving; output, if there is no pattern; command, if it is not the usual one; and options by
    their names without dashes, which replace those for all jobs. Empty values are left out.

    Raises:
        InputError: there is no job, or a row lacks a value or has too many; files are not looked for in a table.
    """
    if command not in COMMANDS:
        raise InputError(f"batch: expected one of {', '.join(COMMANDS)}, found {command!r}; name one of them")
    if not isinstance(options, Mapping):
        raise InputError(f'options: expected a dictionary, found {described(options)}; give for example {{"stop": 10}}')
    single = len(INPUTS[command]) == 1
    if single and drivings is not None:
        raise InputError(f"batch: expected one set of files for {command}, found DRIVINGS, too; leave them out")
    is_table = isinstance(identities, (str, Path)) and Path(identities).suffix.lower() in TABLES
    if single and _listed(identities) and not is_table:
        rows = _each_file(identities, output, command)
    elif drivings is not None:
        rows = _all_pairs(identities, drivings, output, command)
    elif isinstance(identities, (str, Path)):
        rows = _table_rows(Path(identities))
    else:
        rows = _given_rows(identities)
    shared, pattern = _texts(options), None if output is None else str(output)
    jobs = [_job(number, where, row, shared, pattern, command) for number, (where, row) in enumerate(rows, 1)]
    if not jobs:
        raise InputError("batch: expected at least one job, found none; add rows below the header")
    return jobs


def _listed(paths: Any) -> list[str]:
    """Return one or several paths as a list; empty for what is no path."""
    several = list(paths) if isinstance(paths, (list, tuple)) else [paths]
    return [str(path) for path in several] if all(isinstance(path, (str, Path)) for path in several) else []


def _all_pairs(identities: Any, drivings: Any, output: str | Path | None, command: str) -> list[Row]:
    """Return a row for each identity with each driving, or with all if `output` has the name of the identity alone."""
    if not _listed(identities):
        raise InputError(
            "batch: expected paths of meshes beside those of drivings, found none; give at least one, or put the "
            "drivings into the rows of jobs"
        )
    if output is None:
        raise InputError(
            f"{option('output')}: expected a pattern for the outputs of all pairs, found none; "
            f"give one: {option('output', 'out/{identity}/{driving}.glb')}"
        )
    moving = (*CLIP_READERS, *ANIMATED) if command == "animate" else mesh_suffixes()
    meshes = _find_all(identities, mesh_suffixes(), "meshes")
    clips = _find_all(drivings, moving, "driving files")
    if command == "animate" and len(clips) > 1 and _names(str(output)) == {"identity"}:
        return [(mesh, {"identity": mesh, "driving": clips}) for mesh in meshes]
    return [(f"{mesh} + {clip}", {"identity": mesh, "driving": clip}) for mesh in meshes for clip in clips]


def _each_file(inputs: Any, output: str | Path | None, command: str) -> list[Row]:
    (name,) = INPUTS[command]
    if output is None:
        pattern = "-o 'out/{identity}.glb'" if command == "rig" else "-o 'out/{driving}.bvh'"
        raise InputError(f"--output: expected a pattern for the outputs, found none; give one: {pattern}")
    suffixes = mesh_suffixes() if command == "rig" else (*CLIP_READERS, *ANIMATED)
    return [(path, {name: path}) for path in _find_all(inputs, suffixes, "meshes" if command == "rig" else "clips")]


def _table_rows(path: Path) -> list[Row]:
    """Read a CSV file with a header, in UTF-8, with commas, semicolons or tabs between its columns."""
    refuse_pipe(path)
    if path.is_dir():
        raise InputError(f"{path}: expected a table of jobs (CSV), or a second folder: DRIVINGS; give one of them")
    if not path.is_file():
        raise InputError(f"{path}: expected a table of jobs (CSV), found no such file; check the path")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            delimiter = max(",;\t", key=file.readline().count)
            file.seek(0)
            reader = csv.DictReader(file, delimiter=delimiter, restval="", strict=True)
            return [(f"{path}:{reader.line_num}", row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected a CSV file in UTF-8, found '{error}'; save it as CSV UTF-8") from error


def _given_rows(rows: Any) -> list[Row]:
    if isinstance(rows, Mapping) or not isinstance(rows, Sequence):
        raise InputError(f"identities: expected a list of dictionaries, or a path, found {described(rows)}; give [job]")
    for row in rows:
        if not isinstance(row, Mapping):
            raise InputError(
                f"identities: expected dictionaries as jobs, found {described(row)}; give for example "
                '{"identity": "hero.glb", "driving": "walk.bvh", "output": "out.glb"}'
            )
    return [(f"job {number}", row) for number, row in enumerate(rows, 1)]


def _job(
    number: int, where: str, row: Mapping[Any, Any], options: Mapping[str, str], pattern: str | None, command: str
) -> BatchJob:
    if None in row:  # what csv.DictReader makes of values beyond the last column
        raise InputError(f"{where}: expected as many values as columns, found more; quote values that have commas")
    clips = row.get("driving")
    first, *more = map(str, clips if isinstance(clips, (list, tuple)) and clips else [clips or ""])
    values = _texts({**row, "driving": first})
    command = values.pop("command", command)
    if command not in COMMANDS:
        raise InputError(f"{where}: expected one of {', '.join(COMMANDS)}, found {command!r}; name one of them")
    for name in (*INPUTS[command], *(("output",) if pattern is None else ())):
        if name not in values:
            raise InputError(f"{where}: expected a value for {name}, found none; columns: {', '.join(map(str, row))}")
    if more and command != "animate":
        raise InputError(f"{where}: expected one driving for {command}, found {len(more) + 1}; leave the others out")
    inputs = {name: values.pop(name) for name in INPUTS[command]}
    output = values.pop("output", None) or filled(str(pattern), inputs, number)
    both = inputs.get("identity", ""), inputs.get("driving", "")
    return BatchJob(where, command, *both, output, tuple({**options, **values}.items()), tuple(more))


def _texts(values: Mapping[Any, Any]) -> dict[str, str]:
    """Return values that are not empty as texts, by the names of options: root_bone: True is root-bone: yes."""
    texts = {}
    for name, value in values.items():
        value = ("yes" if value else "no") if isinstance(value, bool) else "" if value is None else str(value).strip()
        if value:
            texts[str(name).strip().lstrip("-").replace("_", "-").lower()] = value
    return texts


def find_files(text: str, suffixes: Sequence[str], what: str) -> list[str]:
    """List what a folder, a pattern with wildcards or the path of a file stands for, sorted.

    A folder stands for the files in it that have one of the suffixes; folders that a pattern finds are clips of frames.
    """
    path = Path(text)
    if path.is_dir():
        found = [str(file) for file in path.iterdir() if file.suffix.lower() in suffixes and file.is_file()]
    elif path.exists():
        found = [text]
    else:  # a text without wildcards finds nothing
        found = glob.glob(text, recursive=True)
        found = [name for name in found if Path(name).is_dir() or Path(name).suffix.lower() in suffixes]
    if not found:
        missing = "none" if path.exists() or glob.has_magic(text) else "no such file"
        raise InputError(
            f"{text}: expected {what} of a format that `mimesh convert --help` names, found {missing}; give a file, a "
            "folder of files, or a pattern in quotes ('characters/*.glb')"
        )
    return sorted(found)


def _find_all(paths: Any, suffixes: Sequence[str], what: str) -> list[str]:
    """List what one or several paths stand for (see `find_files`), each file once."""
    return list(dict.fromkeys(file for text in _listed(paths) for file in find_files(text, suffixes, what)))


def filled(pattern: str, inputs: Mapping[str, str], number: int) -> str:
    """Return the output that a pattern gives a job.

    Args:
        pattern: with names in braces: those of the inputs, and number.
        inputs: what an input is, as in INPUTS -> its path.
    """
    values = {name: file_stem(path) for name, path in inputs.items()} | {"number": number}
    names = _names(pattern)
    if names <= values.keys():
        with suppress(ValueError):
            return pattern.format(**values)
    known = ", ".join(f"{{{name}}}" for name in values)
    found = ", ".join(sorted(names - values.keys())) or "an invalid format"
    raise InputError(f"{pattern}: expected only {known} in the pattern of outputs, found {found}; rename them")


def _names(pattern: str) -> set[str]:
    try:
        return {name for _, name, _, _ in string.Formatter().parse(pattern) if name is not None}
    except ValueError:
        return {"a brace without its other half"}


@cache
def _parsers() -> dict[str, Any]:
    """Return the commands by name, as the library behind Typer has them."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command("animate")(move.animate)
    app.command("transfer")(move.transfer)
    app.command("rig")(rig)
    app.command("capture")(capture)
    group: Any = typer.main.get_command(app)
    return dict(group.commands)


def _option_words(command: str, options: tuple[tuple[str, str], ...]) -> list[str]:
    """Return options as arguments of the command; previews are off by default, since a sheet shows all results."""
    known = {
        flag.removeprefix("--"): parameter
        for parameter in _parsers()[command].params
        for flag in (*parameter.opts, *parameter.secondary_opts)
        if flag.startswith("--") and flag.removeprefix("--") not in NOT_FOR_JOBS
    }
    words = []
    usual = {"preview": "no"} if "preview" in known else {}
    for name, value in {**usual, **dict(options)}.items():
        parameter = known.get(name)
        if parameter is None:
            raise InputError(
                f"expected an option of mimesh {command}, found {name}{did_you_mean(name, known)}; "
                f"mimesh {command} --help lists them"
            )
        if not parameter.is_flag:
            words.append(f"--{name}={value}")
        elif (on := SWITCHES.get(value.lower())) is None:
            raise InputError(f"expected yes or no for {name}, found {value!r}; write one of them")
        else:
            words += (parameter.opts if on else parameter.secondary_opts)[:1]
    return words


@cache
def option_values(command: str, options: tuple[tuple[str, str], ...]) -> dict[str, Any]:
    """Parse and check options as the command does: parameter -> value. Many jobs have the same ones."""
    words = [*_option_words(command, options), "--", *INPUTS[command]]
    try:
        # What an option sets, such as --no-limits, does not outlast the parsing.
        values = dict(copy_context().run(_parsers()[command].make_context, command, words).params)
    except Exception as error:
        # Typer's versions define their usage errors in different modules; all of them have `format_message`.
        if (format_message := getattr(error, "format_message", None)) is None:
            raise
        message = " ".join(format_message().split()).rstrip(".")
        raise InputError(f"{message}; see mimesh {command} --help") from error
    options_of(Hints, values)
    given, motion = options_of(ModelOptions, values), options_of(MotionOptions, values)
    model = find_model(values["model"], ensemble=given.ensemble, seed=given.seed, pairing=given.pairing)
    if command in ("rig", "capture"):
        find_mime(values["model"], values["seed"])
    elif not isinstance(model, Mime):
        motion.refuse_without_joints(model.name)
    return values


def run_command(job: BatchJob) -> dict[str, Any]:
    """Run the command of a job and return the facts that it prints with --json."""
    command, words = _parsers()[job.command], _option_words(job.command, job.options)

    def run() -> dict[str, Any]:
        arguments = [*words, f"--output={job.output}", "--quiet", "--", *job.files]
        with command.make_context(job.command, arguments) as context:
            return command.invoke(context)

    return copy_context().run(run)  # what an option sets, such as --no-limits, ends with the job


def check_jobs(jobs: Sequence[BatchJob], more_inputs: Sequence[Path], more_outputs: Sequence[Path]) -> None:
    """Check jobs, and the files that a batch reads and writes besides theirs. Meshes are not read."""
    option_values.cache_clear()  # a network that an option names may have been deleted since
    places: defaultdict[str, list[tuple[str, str]]] = defaultdict(list)
    not_installed = cache(_not_installed)  # pairs have the same files again and again, which may have to be opened
    for job in jobs:
        try:
            _check_job(job, not_installed)
        except InputError as error:
            message = " ".join(str(error).split())
            # What is not installed is one error, whichever file needs it.
            kind = message.rpartition(": ")[2] if isinstance(error, NotInstalledError) else message
            places[kind].append((job.where, message))
    errors = [
        f"{first}{f' and {len(others)} more' if others else ''}: {message}"
        for (first, message), *others in places.values()
    ] or _collisions(jobs, more_inputs, more_outputs)
    if errors:
        more = f"; and {len(errors) - MOST_SHOWN} more errors" if len(errors) > MOST_SHOWN else ""
        raise InputError(f"{'; '.join(errors[:MOST_SHOWN])}{more} (nothing was started)")


def _not_installed(path: Path) -> str:
    """Tell what lacks that reads a file; "" where nothing does."""
    try:
        check_readable(path)
    except NotInstalledError as error:
        return str(error)
    return ""


def _check_job(job: BatchJob, not_installed: Callable[[Path], str]) -> None:
    """Raise InputError if a file of a job does not exist, what its formats need, or an option cannot be used."""
    if job.identity and not Path(job.identity).is_file():
        raise InputError(f"{job.identity}: expected the file of the mesh, found none; check the path")
    for path in job.inputs().values():
        if not path.exists():
            raise InputError(f"{path}: expected a file, found nothing of that name; check the path")
        if message := not_installed(path):
            raise NotInstalledError(message)
    values, output = option_values(job.command, job.options), Path(job.output)
    if (
        job.output.endswith(SEPARATORS)
        or output_path(job.output, lambda: output / "x", job.command == "animate") != output
    ):
        raise InputError(f"{job.output}: expected the path of a file, found a folder; name a file in it")
    for path in job.outputs():
        refuse_inputs(path, *job.inputs().values())
    if job.command == "animate":
        shapes, layout = options_of(ShapeOptions, values), options_of(Layout, values)
        check_clip_output(output, 1 + len(job.more), values["skinned"], shapes, layout)
    elif job.command in ("rig", "capture"):
        check_suffix(output, JOINTED if job.command == "rig" else JOINT_FILES)
    else:
        check_suffix(output, (*MESH_WRITERS, Path(job.identity).suffix.lower()))


def _collisions(jobs: Sequence[BatchJob], more_inputs: Sequence[Path], more_outputs: Sequence[Path]) -> list[str]:
    """List the outputs that are those of another job, lie in one, or are an input of any job."""
    inputs = {_same(path): str(path) for path in [*more_inputs, *(x for job in jobs for x in job.inputs().values())]}
    folders = {_same(Path(job.output)): job.where for job in jobs} | inputs
    taken = {_same(path): "the batch's own summary" for path in more_outputs} | inputs
    errors = [
        f"{path}: expected a summary apart from the inputs, found {inputs[_same(path)]}; move it with "
        f"{option('summary', ...)}"
        for path in more_outputs
        if _same(path) in inputs
    ]
    for job in jobs:
        for path in job.outputs():
            key = _same(path)
            other = taken.get(key) or next((folders[x] for x in map(str, Path(key).parents) if x in folders), None)
            if other is not None:
                errors.append(
                    f"{job.where}: expected an output of its own, found {path}, which is or lies in that of {other}; "
                    "give each job another output, apart from all inputs"
                )
            taken[key] = job.where
    return errors


def _same(path: Path) -> str:
    """Return one text for all ways to write a path."""
    return os.path.normcase(path.resolve())
