"""Records beside outputs: what each was made from, so that a finished job is not done again.

The record of `walk.glb` is `.walk.glb.job.json`: a fingerprint of the command, its options, the contents of all inputs
and of the model's file, and what came out. It is removed before a job starts and written after its output.
"""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from ..io.atomic import whole_file
from ..io.joint_file import side_file
from ..methods.find import weights_path
from .check import input_files
from .command_lines import model_of
from .table import BatchJob

FORMAT, VERSION = "mimesh job", 1
COMPANIONS = {".obj": (".mtl",), ".gltf": (".bin",)}
"""Suffix -> those of files beside it, with the same name, that belong to its contents."""
CHUNK = 2**20
"""Bytes that are read at once."""


def record_path(job: BatchJob) -> Path:
    """Return the path of a job's record."""
    output = Path(job.output)
    return output.with_name(f".{output.name}.job.json")


def fingerprint(job: BatchJob) -> str:
    """Return a digest of everything that the output of a job depends on, but not of where it is written."""
    facts: dict[str, Any] = {"command": job.command, "options": sorted(job.options)}
    facts["inputs"] = {name: _contents(path) for name, path in input_files(job).items()}
    facts["joints"] = [_contents(side_file(Path(path))) for path in (job.identity, job.driving)]
    facts["weights"] = _contents(weights_path(model_of(job.command, job.options)))
    return hashlib.blake2b(json.dumps(facts).encode(), digest_size=16).hexdigest()


def finished(job: BatchJob, made_from: str) -> dict[str, Any] | None:
    """Return the recorded outcome of a job whose output exists and has this fingerprint, else None."""
    try:
        record = json.loads(record_path(job).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    sound = isinstance(record, dict) and (record.get("format"), record.get("version")) == (FORMAT, VERSION)
    if not sound or record.get("made_from") != made_from or not Path(job.output).exists():
        return None
    outcome = record.get("outcome")
    return outcome if isinstance(outcome, dict) else None


def write_record(job: BatchJob, made_from: str, outcome: dict[str, Any]) -> None:
    """Write the record of a finished job."""
    record = {"format": FORMAT, "version": VERSION, "made_from": made_from, "outcome": outcome}
    with whole_file(record_path(job)) as temporary:
        temporary.write_text(json.dumps(record) + "\n", encoding="utf-8", newline="\n")


def _contents(path: Path) -> list[str]:
    """Return digests of a file and of its companions, or of all files of a folder; empty if there is none."""
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.is_file())
    else:
        files = [path, *(path.with_suffix(suffix) for suffix in COMPANIONS.get(path.suffix.lower(), ()))]
    return [_digest(file) for file in files if file.is_file()]


def _digest(path: Path) -> str:
    facts = path.stat()
    return _digest_of(path.resolve(), facts.st_mtime_ns, facts.st_size)


@lru_cache(maxsize=2**16)
def _digest_of(path: Path, modified: int, size: int) -> str:
    """Return a digest of the name and contents of a file, which is read once while it does not change."""
    digest = hashlib.blake2b(path.name.encode("utf-8", "surrogateescape"), digest_size=16)
    with path.open("rb") as file:
        while chunk := file.read(CHUNK):
            digest.update(chunk)
    return digest.hexdigest()
