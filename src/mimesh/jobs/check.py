"""Check all jobs of a batch before the first one starts: files, options, and outputs that do not collide."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from ..bodies.engine_rig import Layout
from ..commands.clips import check_clip_output, check_suffix
from ..commands.move import check_outputs
from ..core.errors import InputError
from ..core.normalization import parse_axis
from ..io.formats import MESH_WRITERS
from ..methods.find import find_method
from ..pipeline.prepared import MotionOptions
from ..tools.preview import names_beside
from .command_lines import parsed
from .table import BatchJob

FILE_OPTIONS = ("reference", "markers", "body_model", "joints", "driving_joints")
"""Options of a job whose values are input files."""
AXIS_OPTIONS = ("up", "front", "driving_up", "driving_front")
MOST_SHOWN = 3
"""Errors that are shown of many."""


def check_jobs(jobs: Sequence[BatchJob], more_inputs: Sequence[Path], more_outputs: Sequence[Path]) -> None:
    """Check jobs, and the files that a batch reads and writes besides theirs.

    Raises:
        InputError: some jobs cannot be done; the message names up to MOST_SHOWN of them and says how many there are.
    """
    places: dict[str, list[str]] = {}
    for job in jobs:
        message = _error_of(job)
        if message is not None:
            places.setdefault(message, []).append(job.where)
    errors = [_located(*error) for error in places.items()] or _colliding(jobs, more_inputs, more_outputs)
    if errors:
        shown = "; ".join(errors[:MOST_SHOWN])
        more = f"; and {len(errors) - MOST_SHOWN} more errors" if len(errors) > MOST_SHOWN else ""
        raise InputError(f"{shown}{more} (nothing was started)")


def input_files(job: BatchJob) -> dict[str, Path]:
    """Return the inputs of a job by what they are: identity, driving and the files that its options name."""
    files = {"identity": Path(job.identity), "driving": Path(job.driving)}
    return files | {name: Path(path) for name, path in job.options if name.replace("-", "_") in FILE_OPTIONS}


def _error_of(job: BatchJob) -> str | None:
    """Return the message about a job; None without an error."""
    try:
        _check_job(job)
    except InputError as error:
        return " ".join(str(error).split()).removeprefix(f"{job.where}: ")
    return None


def _located(message: str, places: Sequence[str]) -> str:
    """Return a message with the first job that it is about, and how many others have it."""
    others = f" and {len(places) - 1} more" if len(places) > 1 else ""
    return f"{places[0]}{others}: {message}"


def _check_job(job: BatchJob) -> None:
    """Raise InputError if a file of a job does not exist, or an option cannot be used."""
    if not Path(job.identity).is_file():
        raise InputError(f"{job.identity}: expected the file of the mesh to move, found none; check the path")
    for path in input_files(job).values():
        if not path.exists():
            raise InputError(f"{path}: expected a file, found nothing of that name; check the path")
    values = parsed(job)
    given = [values[name] for name in FILE_OPTIONS if values.get(name) is not None]
    inputs = (Path(job.identity), Path(job.driving), *given)
    check_outputs(Path(job.output), values["preview"], False, *inputs, usual=_usual_suffix(job))
    _check_options(job.command, job.options)
    if job.command == "animate":
        layout = Layout(values["names"], values["root_bone"], values["rest"], values["output_fps"])
        frames = values["skinned"], values["morphs"], values["blendshapes"]
        check_clip_output(Path(job.output), 1, *frames, layout)
    else:
        check_suffix(Path(job.output), (*MESH_WRITERS, Path(job.identity).suffix.lower()))


@cache
def _check_options(command: str, options: tuple[tuple[str, str], ...]) -> None:
    """Raise InputError if options that need no file cannot be used; many jobs have the same ones."""
    values = parsed(BatchJob("options", command, "identity", "driving", "output", options))
    for name in AXIS_OPTIONS:
        parse_axis(values[name], f"--{name.replace('_', '-')}")
    method = find_method(values["model"], **{name: values[name] for name in ("ensemble", "seed", "pairing")})
    motion: dict[str, Any] = {name: values[name] for name in ("root", "ground", "smooth") if name in values}
    MotionOptions(**motion, rig=values["rig"], body=values["body"]).check(method)


def _colliding(jobs: Sequence[BatchJob], more_inputs: Sequence[Path], more_outputs: Sequence[Path]) -> list[str]:
    """List the outputs that are those of another job, lie in one, or are an input of any job."""
    read = [*more_inputs, *(path for job in jobs for path in input_files(job).values())]
    inputs = {_same(path): str(path) for path in read}
    taken: dict[str, str] = {_same(path): "the batch's own summary" for path in more_outputs}
    errors = [f"{path}: expected a summary apart from the inputs, found {inputs[key]}; move it with --summary"
              for path in more_outputs if (key := _same(path)) in inputs]  # fmt: skip
    outputs = {_same(Path(job.output)): job.where for job in jobs}
    for job in jobs:
        written = [Path(job.output)]
        if dict(job.options).get("preview", "no").lower() in ("yes", "true", "1", "on"):
            written += names_beside(written[0], usual=_usual_suffix(job))
        for path in written:
            key = _same(path)
            above = [str(parent) for parent in Path(key).parents]
            folder = next((parent for parent in above if parent in inputs or parent in outputs), None)
            other = inputs.get(key) or taken.get(key) or (folder and (inputs.get(folder) or outputs[folder]))
            if other is not None:
                errors.append(
                    f"{job.where}: expected an output of its own, found {path}, which is or lies in that of {other}; "
                    "give each job another output, apart from all inputs"
                )
            taken[key] = job.where
    return errors


def _usual_suffix(job: BatchJob) -> str:
    """Return the suffix of the default output of a command, by which files beside it are named."""
    own = Path(job.identity).suffix
    return ".glb" if job.command == "animate" or own.lower() == ".fbx" else own


def _same(path: Path) -> str:
    """Return one text for all ways to write a path."""
    return os.path.normcase(path.resolve())
