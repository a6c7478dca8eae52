"""Reads damaged files with every reader of this package, and checks that each is read or clearly refused.

    PYTHONPATH=src:tests/support python tests/support/reader_fuzz.py [READER ...] [--cases 1000] [--seed 0]
        [--seconds S] [--guarded] [--keep FOLDER] [--report FILE.json]
    ... reader_fuzz.py READER --only N        one case, in this process, with a traceback
    ... reader_fuzz.py --files FILE ...       files that exist, instead of damaged ones
    ... reader_fuzz.py READER --atheris [options of libFuzzer]    guided by coverage, endless; needs atheris

Cases run one after another in a worker process, which is started again after RECYCLED cases of a native library and
whenever it dies. Native libraries decode in the worker itself, of which a death is counted and the case read again in
the guarded child process that users have; with --guarded all cases are. A case fails with an exception other than
InputError, a warning, a refusal that is not one clear line, an end of the process, more than SECONDS of processor
time, more than MEMORY, or a result that is not finite or has faces out of range. Case N of a seed is always the same.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fuzz_cases import MEMORY, Outcome, run_case, run_cases, write_case
from fuzz_targets import TARGETS, Target, case_of, without_children

from mimesh.evaluate.provenance import commit, machine
from mimesh.io import load_clip

CLOCK_SECONDS = 60.0
"""Time on the clock after which a worker that says nothing is ended: the machine may have other work."""
POLL_SECONDS = 0.1
LINES = "lines"
VARIABLES = {"PXR_WORK_THREAD_LIMIT": "1", "OMP_NUM_THREADS": "1"}
"""Variables that a worker gets."""
PROGRAM = Path(__file__)
"""What a worker runs."""
RECYCLED = 2000
"""Cases of a native library after which its process is replaced, as some libraries keep what they have read."""


@contextlib.contextmanager
def working_folder() -> Iterator[Path]:
    """Make a temporary folder, in memory where the system has such a place."""
    shared = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=shared) as folder:
        yield Path(folder)


def work(target: Target, first: int, stop: int, seed: int, guarded: bool, folder: Path) -> None:
    """Run cases in a worker, and write a line of JSON about each to the file LINES of a folder."""
    decoding = without_children() if target.native and not guarded else contextlib.nullcontext()
    (folder / "files").mkdir()
    # A file, as a pipe would wake the parent for each line.
    with decoding, (folder / LINES).open("wb", buffering=0) as lines:
        _limit_memory()
        start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for number, outcome in run_cases(target, range(first, stop), seed, folder / "files"):
            grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start
            lines.write(json.dumps([number, *dataclasses.astuple(outcome), grown >> 10]).encode() + b"\n")


def _limit_memory() -> None:
    """Allow this process MEMORY more address space than it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


@dataclasses.dataclass
class Tally:
    """What came of all cases of a reader."""

    reader: str
    seed: int
    cases: int = 0
    kinds: Counter[str] = dataclasses.field(default_factory=Counter)
    refusals: Counter[str] = dataclasses.field(default_factory=Counter)
    failures: dict[str, list[int]] = dataclasses.field(default_factory=dict)
    deaths: list[tuple[int, str]] = dataclasses.field(default_factory=list)
    """Case in which a worker died or was ended, and the reason."""
    seconds: float = 0.0
    longest: tuple[float, int] = (0.0, 0)
    """Processor time of the slowest case, and its number."""
    grown_mib: int = 0
    """Largest growth of the resident memory of a worker."""

    def add(self, number: int, outcome: Outcome, grown: int) -> None:
        self.cases += 1
        self.kinds[outcome.kind] += 1
        self.longest = max(self.longest, (round(outcome.seconds, 2), number))
        self.grown_mib = max(self.grown_mib, grown)
        if outcome.kind == "failed":
            self.fail(number, outcome.text)
        elif outcome.kind != "accepted":
            self.refusals[outcome.text] += 1

    def fail(self, number: int, text: str) -> None:
        key = re.split(r": |, ", text)[0]
        self.failures.setdefault(key, []).append(number)
        if len(self.failures[key]) == 1:
            print(f"{self.reader}, case {number}: {text}", flush=True)

    def as_json(self) -> dict[str, Any]:
        """Return the figures of the report."""
        return {
            "seed": self.seed,
            "cases": self.cases,
            "accepted": self.kinds["accepted"],
            "refused": self.kinds["refused"],
            "refused_by_guard": self.kinds["contained"],
            "different_refusals": len(self.refusals),
            "failures": self.kinds["failed"],
            "worker_deaths": len(self.deaths),
            "seconds": round(self.seconds, 1),
            "longest_case_seconds": self.longest[0],
            "longest_case": self.longest[1],
            "grown_mib": self.grown_mib,
        }


def fuzz(target: Target, cases: int, seed: int, seconds: float, guarded: bool, first: int = 0) -> Tally:
    """Run cases in workers, until all are done or the time (clock) is over."""
    tally, begin, number = Tally(target.name, seed), time.monotonic(), first
    while number < cases and time.monotonic() - begin < seconds:
        stop = min(cases, number + RECYCLED) if target.native else cases
        number = _run_worker(target, number, stop, tally, begin + seconds, guarded)
    tally.seconds = time.monotonic() - begin
    return tally


def _run_worker(target: Target, first: int, stop: int, tally: Tally, until: float, guarded: bool) -> int:
    """Run one worker, and count what it says; returns the number of the next case."""
    number, reason = first, ""
    with working_folder() as folder:
        words = [target.name, "--work", str(first), str(stop), str(folder), "--seed", str(tally.seed)]
        process = subprocess.Popen(
            [sys.executable, str(PROGRAM), *words, *(["--guarded"] if guarded else [])],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **VARIABLES, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        try:
            for line in _lines(folder / LINES, process, until):
                done, kind, text, took, grown = json.loads(line)
                tally.add(done, Outcome(kind, text, took), grown)
                number = done + 1
            if number < stop and time.monotonic() < until:
                reason = f"{CLOCK_SECONDS:.0f} s" if process.poll() is None else f"its end ({process.returncode})"
        finally:
            process.kill()
            process.wait()
    if reason:
        _count_death(target, number, tally, reason, guarded)
        number += 1
    return number


def _lines(path: Path, process: subprocess.Popen[bytes], until: float) -> Iterator[bytes]:
    """Yield the lines that a process writes, until it ends, says nothing for CLOCK_SECONDS, or the time is over."""
    rest, place, heard = b"", 0, time.monotonic()
    while True:
        ended = process.poll() is not None
        content = _read_from(path, place)
        *lines, rest = (rest + content).split(b"\n")
        yield from lines
        place, heard = place + len(content), time.monotonic() if content else heard
        now = time.monotonic()
        if not content and (ended or now > until or now > heard + CLOCK_SECONDS):
            return
        if now > until:
            process.kill()
        time.sleep(0 if ended else POLL_SECONDS)


def _read_from(path: Path, place: int) -> bytes:
    if not path.exists():
        return b""
    with path.open("rb") as file:
        file.seek(place)
        return file.read()


def _count_death(target: Target, number: int, tally: Tally, reason: str, guarded: bool) -> None:
    """Count the death of a worker; that of a native library is read again with the guard, which must refuse it."""
    tally.deaths.append((number, reason))
    if not target.native or guarded:
        tally.add(number, Outcome("failed", f"the process dies: {reason}"), 0)
        return
    with working_folder() as folder:
        path = write_case(case_of(target, target.seeds(), tally.seed, number), target, folder, number)
        outcome = run_case(target.reads[number % len(target.reads)], path)
    kind = "contained" if outcome.kind == "refused" else outcome.kind
    tally.add(number, dataclasses.replace(outcome, kind=kind), 0)


def show_case(target: Target, number: int, seed: int, keep: Path | None) -> None:
    """Read one case in this process, without any check, so that an exception shows its traceback."""
    folder = keep or Path(tempfile.mkdtemp(prefix="fuzz-"))
    folder.mkdir(exist_ok=True)
    path = write_case(case_of(target, target.seeds(), seed, number), target, folder, number)
    read = target.reads[number % len(target.reads)]
    print(f"{path}, read by {read.__name__}")
    with without_children() if target.native else contextlib.nullcontext():
        print(run_case(read, path))
        try:
            print(read(path))
        except Exception:
            traceback.print_exc()


def read_files(paths: list[Path]) -> None:
    """Read files that exist, each as a clip, and print what comes of it."""
    _limit_memory()
    for path in paths:
        children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        outcome = run_case(load_clip, path)
        largest = [resource.getrusage(who).ru_maxrss >> 10 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        child = f", child {largest[1]} MiB" if resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss > children else ""
        print(f"{path.name}: {outcome.kind}, {outcome.seconds:.2f} s, {largest[0]} MiB{child}: {outcome.text}")


def save_report(path: Path, tallies: list[Tally], guarded: bool) -> None:
    """Write the figures of these readers into a report that may have others."""
    report = json.loads(path.read_text()) if path.exists() else {}
    section = report.setdefault("guarded" if guarded else "readers", {})
    for tally in tallies:
        section[tally.reader] = {**tally.as_json(), "commit": commit(), "machine": machine()}
    path.write_text(json.dumps(report, indent=1) + "\n")


def guided(target: Target, options: list[str]) -> None:
    """Run atheris, which keeps mutations that reach new code; a failure ends it, with the content in a file."""
    import gc
    from random import Random
    from types import FunctionType

    import atheris

    sound, folder = target.seeds(), Path(tempfile.mkdtemp(prefix="fuzz-"))
    contents, count = [seed.content for seed in sound], 0

    def read(data: bytes) -> None:
        nonlocal count
        count += 1
        case = dataclasses.replace(sound[0], files={**sound[0].files, sound[0].main: data})
        path = write_case(case, target, folder, count)
        outcome = run_case(target.reads[count % len(target.reads)], path)
        if outcome.kind == "failed":
            raise RuntimeError(outcome.text)

    def mutate(data: bytes, largest: int, seed: int) -> bytes:
        return target.mutation(data, Random(seed), contents)[:largest]

    corpus = Path(tempfile.mkdtemp(prefix="fuzz-corpus-"))
    for number, content in enumerate(contents):
        (corpus / str(number)).write_bytes(content)
    with without_children() if target.native else contextlib.nullcontext():
        for function in gc.get_objects():
            if isinstance(function, FunctionType) and (function.__module__ or "").startswith("mimesh."):
                atheris.instrument_func(function)
        atheris.Setup([sys.argv[0], str(corpus), "-max_len=65536", *options], read, custom_mutator=mutate)
        atheris.Fuzz()


def main() -> None:
    """Fuzz the readers that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", metavar="READER", help=", ".join(TARGETS))
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seconds", type=float, default=1e9, help="time for one reader, on the clock")
    parser.add_argument("--guarded", action="store_true", help="read native formats in the guarded child process")
    parser.add_argument("--report", type=Path, help="file of figures, written again after each reader")
    parser.add_argument("--only", type=int, help="read this case alone")
    parser.add_argument("--keep", type=Path, help="folder for the files of that case")
    parser.add_argument("--files", type=Path, nargs="+", help="read these files instead")
    parser.add_argument("--atheris", action="store_true")
    parser.add_argument("--work", nargs=3, help=argparse.SUPPRESS)
    args, options = parser.parse_known_args()
    if unknown := [name for name in args.readers if name not in TARGETS] or (options if not args.atheris else []):
        parser.error(f"unknown: {', '.join(unknown)}")
    targets = [TARGETS[name] for name in args.readers or TARGETS if TARGETS[name].installed]
    if args.files:
        read_files(args.files)
    elif args.work:
        first, stop, folder = args.work
        work(targets[0], int(first), int(stop), args.seed, args.guarded, Path(folder))
    elif args.atheris:
        guided(targets[0], options)
    elif args.only is not None:
        show_case(targets[0], args.only, args.seed, args.keep)
    else:
        _fuzz_all(targets, args)


def _fuzz_all(targets: list[Target], args: argparse.Namespace) -> None:
    failed = 0
    for target in targets:
        tally = fuzz(target, args.cases, args.seed, args.seconds, args.guarded, args.first)
        print(target.name, json.dumps(tally.as_json()), flush=True)
        for text, numbers in tally.failures.items():
            print(f"  {len(numbers)} x {text} (cases {', '.join(map(str, numbers[:5]))})", flush=True)
        if args.report:
            save_report(args.report, [tally], args.guarded)
        failed += tally.kinds["failed"]
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
