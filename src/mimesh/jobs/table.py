"""Read the jobs of a batch: rows of a table, or all pairs of two lists of files with a pattern for the outputs."""

from __future__ import annotations

import csv
import glob
import string
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.system import refuse_pipe

COMMANDS = ("animate", "transfer")
FILES = ("identity", "driving", "output")
PLACEHOLDERS = ("identity", "driving", "number")
"""Names in the pattern of outputs: the inputs' names without folder and suffix, and the number of the job from 1."""
STATES = DONE, DONE_BEFORE, FAILED, NOT_RUN = ("done", "done before", "failed", "not run")
"""Of a job, in the order of messages: done now, by an earlier batch, with an error, or stopped before its start."""
WILDCARDS = frozenset("*?[")


@dataclass(frozen=True)
class BatchJob:
    """One run of `mimesh animate` or `mimesh transfer`."""

    where: str
    """Where it comes from, for messages: "jobs.csv:3"."""
    command: str
    """One of COMMANDS."""
    identity: str
    driving: str
    output: str
    options: tuple[tuple[str, str], ...] = ()
    """Names of options without dashes, and their values; yes or no for switches."""

    @property
    def name(self) -> str:
        """Name of the pair in lists and pictures."""
        return f"{stem(self.identity)} + {stem(self.driving)}"

    def as_dict(self) -> dict[str, Any]:
        """Return the fields for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> BatchJob:
        """Make a job from what `as_dict` returned."""
        return cls(**{**fields, "options": tuple((name, value) for name, value in fields["options"])})


def stem(path: str) -> str:
    """Return the name of a file without folder and suffix, or that of a folder."""
    resolved = Path(path).resolve()
    return resolved.name if resolved.is_dir() else resolved.stem


def read_table(path: Path, options: Mapping[str, str], pattern: str | None, command: str) -> list[BatchJob]:
    """Read the jobs of a CSV file with a header, in UTF-8, with commas, semicolons or tabs between its columns.

    Raises:
        InputError: no such file, or one without the columns that are needed; see `read_rows`.
    """
    refuse_pipe(path)
    if not path.is_file():
        raise InputError(f"{path}: expected a table of jobs (CSV), found no such file; check the path")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            first = file.readline()
            file.seek(0)
            delimiter = max(",;\t", key=first.count)
            reader = csv.DictReader(file, delimiter=delimiter, restval="", strict=True)
            rows = [(f"{path}:{reader.line_num}", row) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected a CSV file in UTF-8, found '{error}'; save it as CSV UTF-8") from error
    return read_rows(rows, options, pattern, command)


def read_rows(
    rows: Iterable[tuple[str, Mapping[Any, Any]]], options: Mapping[str, str], pattern: str | None, command: str
) -> list[BatchJob]:
    """Return the jobs of rows, each with the place that messages name.

    A row has identity and driving; output, if there is no pattern; command, if it is not the usual one; and options by
    their names without dashes, which replace those for all jobs. Empty values are left out.

    Raises:
        InputError: a row lacks one of them, or has more values than columns.
    """
    jobs = []
    for number, (where, row) in enumerate(rows, 1):
        if None in row:  # what csv.DictReader makes of values beyond the last column
            raise InputError(f"{where}: expected as many values as columns, found more; quote values that have commas")
        given = {_column(name): "" if value is None else _text(value) for name, value in row.items()}
        values = {name: value for name, value in given.items() if value != ""}
        missing = next((name for name in FILES[:2] if name not in values), None)
        if missing or ("output" not in values and pattern is None):
            missing = missing or "output"
            raise InputError(f"{where}: expected a value for {missing}, found none; columns: {', '.join(given)}")
        named = values.pop("command", command)
        if named not in COMMANDS:
            raise InputError(f"{where}: expected animate or transfer as command, found {named!r}; name one of them")
        identity, driving = values.pop("identity"), values.pop("driving")
        output = values.pop("output", None) or filled(str(pattern), identity, driving, number)
        jobs.append(BatchJob(where, named, identity, driving, output, tuple({**options, **values}.items())))
    if not jobs:
        raise InputError("batch: expected at least one job, found none; add rows below the header")
    return jobs


def all_pairs(
    identities: Sequence[str], drivings: Sequence[str], options: Mapping[str, str], pattern: str, command: str
) -> list[BatchJob]:
    """Return a job for each identity with each driving."""
    rows = [
        (f"{identity} + {driving}", {"identity": identity, "driving": driving})
        for identity in identities
        for driving in drivings
    ]
    return read_rows(rows, options, pattern, command)


def find_files(text: str, suffixes: Sequence[str], what: str) -> list[str]:
    """List what a folder, a pattern with wildcards or the path of a file stands for, sorted.

    A folder stands for the files in it that have one of the suffixes; folders that a pattern finds are clips of frames.

    Raises:
        InputError: there is nothing of that kind.
    """
    if not Path(text).exists() and WILDCARDS & set(text):
        found = sorted(glob.glob(text, recursive=True))
        found = [path for path in found if Path(path).is_dir() or Path(path).suffix.lower() in suffixes]
    elif Path(text).is_dir():
        found = sorted(str(path) for path in Path(text).iterdir() if path.suffix.lower() in suffixes and path.is_file())
    else:
        found = [text] if Path(text).exists() else []
    if not found:
        raise InputError(
            f"{text}: expected {what} of a format that `mimesh convert --help` names, found none; give a file, a "
            "folder of files, or a pattern in quotes ('characters/*.glb')"
        )
    return found


def filled(pattern: str, identity: str, driving: str, number: int) -> str:
    """Return the output that a pattern gives a job.

    Raises:
        InputError: the pattern has other names in braces than PLACEHOLDERS.
    """
    try:
        names = {name for _, name, _, _ in string.Formatter().parse(pattern) if name is not None}
        if names <= set(PLACEHOLDERS):
            return pattern.format(identity=stem(identity), driving=stem(driving), number=number)
    except ValueError:
        names = {"a brace without its other half"}
    known = ", ".join(f"{{{name}}}" for name in PLACEHOLDERS)
    found = ", ".join(sorted(names - set(PLACEHOLDERS))) or "an invalid format"
    raise InputError(f"{pattern}: expected only {known} in the pattern of outputs, found {found}; rename them")


def numbered_rows(rows: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield rows of a program with what messages call them."""
    for number, row in enumerate(rows, 1):
        yield f"job {number}", row


def _column(name: str) -> str:
    """Return the name of a column as options are written: output_fps and --output-fps are output-fps."""
    return str(name).strip().lstrip("-").replace("_", "-").lower()


def _text(value: Any) -> str:
    """Return a value of a table or of a program as text."""
    return ("yes" if value else "no") if isinstance(value, bool) else str(value).strip()
