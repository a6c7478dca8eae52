"""Kill commands of mimesh at random moments, and check that nothing is lost: no input, no output, no training.

    python scripts/measure_kills.py [-o benchmarks/kills.json] [--kills 300] [--seed 0] [--commands convert ...]

Each kill begins with a command in a process group of its own; in half of them the outputs of an earlier run exist.
Processes are forks of this one, which has imported the package: a start writes nothing, and would take most of the
time. The first process gets SIGKILL, or in three of ten cases SIGTERM or SIGINT: at a random moment of its run
(`time`), up to 2 ms after a name in its output folder appeared, went or changed (`file`), or just before an operation
on a file there (`operation`, as Python reports them: PEP 578). Half of the SIGKILLs go to the whole group, the others
to the first process alone. Then these must hold, and what does not is listed under `violations`:

* Inputs are unchanged. Every output is the old one or the new one, whole, and there is nothing else but temporary
  files. No process is left.
* The outputs of one result are all old or all new. SIGKILL can come between two renames (`mixed`): then the next run
  that writes to the folder must finish them.
* The next run leaves no temporary file, in the output folder and in the temporary one. For batch, train and evaluate it
  is the same command, train with --resume, which must give what an undisturbed run gives, weights to the last bit; for
  the others it writes another file to each folder that has outputs.

New outputs are compared with those of an undisturbed run, without times and dates. Figures of commands that are given
with -o replace those that the file has. Inputs are the shipped body with 300
vertices and six frames of a shipped motion.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import getpass
import hashlib
import io
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mimesh import cli, pipeline  # noqa: F401 (imported once for all forks)
from mimesh.bodies import load_body
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import save_clip, save_mesh
from mimesh.io.atomic import PREFIX, _remove_left_over, whole_file
from mimesh.motions import load_motion, motion_clip
from mimesh.player.thinning import simplify_clip

MOTION, FRAMES = "walk", 6
MOMENTS = ("time", "file", "operation")
SHARE_KILL = 0.7
"""Share of SIGKILL; the rest is SIGTERM and SIGINT, half each."""
AFTER_FILE = 2e-3
"""Longest time (seconds) between a change of the folder and the signal."""
SURVIVAL = 30.0
"""Seconds after which a process that is left counts as one: a worker of a batch may end its job."""
VARYING = ("seconds", "steps", "memory_mib", "date", "s", "seconds_per_frame")
"""Keys of reports that are other in every run."""
VERTICES = 300
"""Of the meshes."""
STAYING = (f"torchinductor_{getpass.getuser()}",)
"""What PyTorch leaves in the temporary folder, empty (docs/privacy.md)."""
OPERATIONS = ("os.rename", "os.link", "os.remove", "os.mkdir", "os.rmdir", "os.chmod")
"""Audit events that are counted, beside files opened to write."""
TINY = ("model.encoder=[8,16,16]", "model.decoder=[16,8,8]", "data.vertices=64", "batch=2", "pairs=48", "warmup=4")
TINY += ("validate_every=16", "validation_pairs=1", "precision=fp32")
"""Changes of the configuration npt-small that make a training of a few seconds."""


@dataclass(frozen=True)
class Command:
    """A command that is killed; {out} in its arguments is the output folder."""

    arguments: tuple[str, ...]
    share: int
    """Of the kills."""
    groups: tuple[tuple[str, ...], ...] = ()
    """Patterns of outputs that belong together."""
    resumable: bool = False
    """The same command goes on where it was killed."""
    resume: tuple[str, ...] = ()
    """Arguments that replace all after the second where {out}/`made` exists."""
    made: str = ""
    beside: tuple[str, ...] = ()
    """Patterns of files that an unfinished run may leave."""
    again: bool = True
    """Outputs of an earlier run may be there."""


COMMANDS = {
    "transfer": Command(
        ("transfer", "hero.obj", "drivings/pose.obj", "-m", "copy", "-o", "{out}/moved.obj"), 70, (("*",),)
    ),
    "animate": Command(("animate", "hero.obj", "walk.npz", "-m", "copy", "-o", "{out}/moved.glb"), 40, (("*",),)),
    "convert": Command(("convert", "pose.glb", "{out}/pose.obj"), 80, (("*",),)),
    "convert, frames": Command(("convert", "walk.npz", "{out}/frames", "--frames-as", "ply"), 40, (("*",),)),
    "convert, USD": Command(("convert", "walk.usdc", "{out}/walk.glb"), 30, (("*",),)),
    "batch": Command(
        (
            "batch",
            "identities",
            "drivings",
            "--transfer",
            "-m",
            "copy",
            "-o",
            "{out}/{identity}-{driving}.obj",
            "-w",
            "2",
        ),
        14,
        resumable=True,
    ),
    "train": Command(
        ("train", "npt", "-o", "{out}", *(word for change in TINY for word in ("--set", change))),
        8,
        resumable=True,
        resume=("--resume", "{out}"),
        made="last.safetensors",
        beside=("log.jsonl", "events.out.*"),
        again=False,
    ),
    "evaluate": Command(
        ("evaluate", "human-npt", "--pairs", "2", "-m", "copy,identity", "-o", "{out}/report.json"),
        8,
        resumable=True,
        beside=("report.json.partial",),
    ),
}


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--kills", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+", default=list(COMMANDS), choices=list(COMMANDS))
    parser.add_argument("--moments", nargs="+", default=MOMENTS, choices=MOMENTS)
    args = parser.parse_args()
    report = {"machine": machine(), "libraries": libraries(), "seed": args.seed, "kills": 0, "violations": 0}
    measured: dict[str, Any] = {}
    if args.output and args.output.exists():
        measured = json.loads(args.output.read_text())["commands"]
    shares = {name: COMMANDS[name].share for name in args.commands}
    with tempfile.TemporaryDirectory() as root:
        for name, share in shares.items():
            rng = random.Random(f"{args.seed} {name}")
            count = max(1, round(args.kills * share / sum(shares.values())))
            killings = Killings(COMMANDS[name], Path(root, name.replace(", ", "-")), rng)
            measured[name] = killings.run(name, count, args.moments) | {"commit": commit()}
            report["kills"] = sum(figures["kills"] for figures in measured.values())
            report["violations"] = sum(len(figures["violations"]) for figures in measured.values())
            report["commands"] = {name: measured[name] for name in COMMANDS if name in measured}
            if args.output:
                with whole_file(args.output) as temporary:
                    temporary.write_text(json.dumps(report, indent=2) + "\n")
    print(json.dumps(report, indent=2))


def write_inputs(folder: Path, old: bool) -> None:
    """Write meshes and a clip; the `old` ones have the same names and other contents."""
    body = load_body()
    moving = motion_clip(body, None, load_motion(MOTION))
    first = 60 if old else 0
    frames = np.concatenate([body.vertices[None], moving.vertices[first : first + FRAMES]])
    simple = simplify_clip(Clip(body.mesh(), frames), VERTICES)
    rest, clip, faces = simple.vertices[0] * (1 - 0.1 * old), simple.vertices[1:], simple.mesh.faces
    image = io.BytesIO()
    Image.new("RGB", (4, 4), (200, 150, 120 + old)).save(image, "PNG")
    half = len(faces) // 2
    red, skin = Material("red", (1.0, 0.0, 0.0, 1.0)), Material("skin", (1.0, 1.0, 1.0, 1.0), image.getvalue())
    parts = (Part("lower", 0, half, red), Part("upper", half, len(faces), skin))
    pose = Mesh(clip[-1], faces, "pose", parts=parts, corner_uv=np.zeros((len(faces), 3, 2)))
    save_mesh(pose, folder / "pose.glb")
    save_mesh(Mesh(clip[-1], faces, "pose"), folder / "drivings" / "pose.obj")
    for suffix in (".npz", ".usdc"):
        save_clip(Clip(Mesh(clip[0], faces, "walk"), clip, 30.0), folder / f"walk{suffix}")
    for name, scale in (("hero", 1.0), ("identities/a", 1.1), ("identities/b", 1.2)):
        save_mesh(Mesh(scale * rest, faces, name), folder / f"{name}.obj")


class Operations:
    """Counts operations on files of some folders, as an audit hook; before number `at` the process gets a signal."""

    def __init__(self, folders: list[str], at: int, signal: int) -> None:
        self.folders, self.at, self.signal, self.count = tuple(folders), at, signal, 0

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = arguments
            paths = (path,) if (flags or 0) & (os.O_WRONLY | os.O_RDWR) else ()
        else:
            paths = arguments if event in OPERATIONS else ()
        if any(isinstance(path, (str, Path)) and str(path).startswith(self.folders) for path in paths):
            self.count += 1
            if self.count == self.at:
                os.kill(os.getpid(), self.signal)


class Fork:
    """A fork of this process that does some work, in a process group of its own."""

    def __init__(self, work: Callable[[], None], folder: Path, temporary: Path, errors: Path) -> None:
        self.path = errors
        self.code: int | None = None
        """Exit code, negative for a signal; None while it runs."""
        self.number = os.fork()
        if self.number:
            return
        code = 1
        try:
            os.setsid()
            os.chdir(folder)
            for target, path in ((1, os.devnull), (2, errors)):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), target)
            os.environ["TMPDIR"] = tempfile.tempdir = str(temporary)
            _remove_left_over.cache_clear()
            work()
            code = 0
        except SystemExit as error:
            code = int(error.code or 0)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)

    def running(self) -> bool:
        """Return whether it still runs."""
        if self.code is None:
            number, status = os.waitpid(self.number, os.WNOHANG)
            self.code = os.waitstatus_to_exitcode(status) if number else None
        return self.code is None

    def wait(self, seconds: float = float("inf")) -> None:
        """Wait for its end, or so long."""
        until = time.monotonic() + seconds
        while self.running() and (left := until - time.monotonic()) > 0:
            time.sleep(min(left, 5e-4))

    def errors(self) -> str:
        """Return what it has written on stderr."""
        return self.path.read_text(errors="replace")


@dataclass
class Killings:
    """Kills of one command, in a folder of their own."""

    command: Command
    root: Path
    rng: random.Random
    operations: int = 0
    changes: int = 0
    """Of the output folder's names, in an undisturbed run."""
    left: list[int] = field(default_factory=list)
    """Operations before which the command has not been killed yet."""
    seconds: float = 0.0
    """Of an undisturbed run."""
    old: dict[str, str] = field(default_factory=dict)
    new: dict[str, str] = field(default_factory=dict)
    """Digests of outputs by their names, of the earlier run and of an undisturbed one."""

    def run(self, name: str, kills: int, moments: Sequence[str]) -> dict[str, Any]:
        """Measure undisturbed runs, then kill; return figures."""
        self.prepare()
        begin, outcomes, violations, missed, k = time.perf_counter(), Counter(), [], 0, 0
        done: Counter[str] = Counter()
        while done.total() < kills and missed < kills:
            moment = moments[k % len(moments)]
            outcome, found = self.kill(moment)
            k += 1
            violations += [f"{moment}: {text}" for text in found]
            if outcome == "ended before":
                missed += 1
                continue
            done[moment] += 1
            outcomes[outcome] += 1
            print(f"{name}: {done.total()}/{kills} {moment}: {outcome} {found or ''}", file=sys.stderr, flush=True)
        return {
            "kills": done.total(),
            "at": dict(done),
            "undisturbed_s": round(self.seconds, 2),
            "operations": self.operations,
            "seconds": round(time.perf_counter() - begin, 1),
            "outcomes": dict(outcomes),
            "ended_before": missed,
            "violations": violations,
        }

    def prepare(self) -> None:
        """Write inputs, and take the outputs of undisturbed runs."""
        for kind in ("old", "new"):
            write_inputs(self.root / kind, kind == "old")
        self.inputs = digests(self.root / "new")
        if self.command.again:
            self.finish("old")
            shutil.copytree(self.out, self.root / "earlier")
            self.old = digests(self.out)
        before = self.new
        for _ in range(2):
            self.clear(False)
            begin = time.perf_counter()
            process = self.start(self.arguments())
            self.changes = sum(1 for _ in changes(process, self.out))
            self.seconds = time.perf_counter() - begin
            assert process.code == 0, process.errors()
            self.operations = int(process.errors().split()[-1])
            before, self.new = self.new, digests(self.out, self.command.beside)
        assert before == self.new, [name for name in self.new if before.get(name) != self.new[name]]

    @property
    def out(self) -> Path:
        """The output folder."""
        return self.root / "out"

    @property
    def temporary(self) -> Path:
        """The folder for temporary files."""
        return self.root / "temporary"

    def clear(self, again: bool) -> None:
        """Empty the folders, and put the outputs of the earlier run there if wanted."""
        for folder in (self.out, self.temporary):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        if again:
            shutil.copytree(self.root / "earlier", self.out, dirs_exist_ok=True)

    def arguments(self) -> list[str]:
        """Return the arguments of the command, or of what goes on with it."""
        resumed = self.command.resume and (self.out / self.command.made).exists()
        words = (*self.command.arguments[:2], *self.command.resume) if resumed else self.command.arguments
        return [word.replace("{out}", str(self.out)) for word in words]

    def start(self, arguments: list[str], at: int = 0, sent: int = 0, inputs: str = "new") -> Fork:
        """Start a command; before operation `at` on files of its folders it gets a signal."""
        operations = Operations([str(self.out), str(self.temporary)], at, sent)

        def work() -> None:
            sys.addaudithook(operations)
            try:
                cli.main(arguments)
            finally:
                print(operations.count, file=sys.stderr, flush=True)

        return self.fork(work, inputs)

    def fork(self, work: Callable[[], None], inputs: str = "new") -> Fork:
        """Fork a process that does some work in a folder of inputs."""
        return Fork(work, self.root / inputs, self.temporary, self.root / "errors")

    def finish(self, inputs: str = "new") -> str:
        """Run the command to its end; return what it wrote on stderr if it failed."""
        if inputs == "old":
            self.clear(False)
        process = self.start(self.arguments(), inputs=inputs)
        process.wait()
        return process.errors() if process.code else ""

    def kill(self, moment: str) -> tuple[str, list[str]]:
        """Start the command, send a signal, and check; return the outcome and what does not hold."""
        again = self.command.again and self.rng.random() < 0.5
        self.clear(again)
        sent = signal.SIGKILL
        if self.rng.random() > SHARE_KILL:
            sent = self.rng.choice([signal.SIGTERM, signal.SIGINT])
        at = self.next_operation() if moment == "operation" else None
        process = self.start(self.arguments(), at or 0, sent)
        if moment == "time":
            process.wait(self.rng.uniform(0, self.seconds))
        elif moment == "file":
            wanted = self.rng.randint(1, max(1, self.changes))
            for _ in zip(range(wanted), changes(process, self.out), strict=False):
                pass
            process.wait(self.rng.uniform(0, AFTER_FILE))
        if at is None:
            if not process.running():
                return "ended before", []
            whole_group = sent == signal.SIGINT or self.rng.random() < 0.5
            with contextlib.suppress(ProcessLookupError):
                (os.killpg if whole_group else os.kill)(process.number, sent)
        process.wait()
        if process.code == 0:
            return "ended before", []
        found = [f"process {number} is left after {sent.name}" for number in survivors(self.root)]
        outcome, more = self.check(sent, self.old if again else {})
        return f"{sent.name}, {outcome}", found + more

    def next_operation(self) -> int:
        """Return the number of an operation: each once, in random order, before any comes again."""
        self.left = self.left or self.rng.sample(range(1, self.operations + 1), self.operations)
        return self.left.pop()

    def check(self, sent: signal.Signals, old: dict[str, str]) -> tuple[str, list[str]]:
        """Check the folders after a kill and after the next run; return the outcome and what does not hold."""
        found = [] if digests(self.root / "new") == self.inputs else ["an input has changed"]
        state = digests(self.out, self.command.beside)
        for name in sorted({*state, *self.new, *old}):
            allowed = (old.get(name), self.new.get(name))
            partial = self.command.resumable and self.partial(name, state.get(name))
            if state.get(name) not in allowed and not partial:
                found.append(f"{name} is {'gone' if name not in state else 'neither old nor new'} after {sent.name}")
        mixed = self.mixed(state, old)
        if mixed and sent != signal.SIGKILL:
            found.append(f"outputs are mixed after {sent.name}")
        if not summaries_agree(self.out):
            found.append(f"batch.csv and batch.json differ after {sent.name}")
        found += self.next_run(mixed, old)
        changed = [name for name in self.new if state.get(name) != old.get(name)]
        outcome = "mixed" if mixed else "as before" if not changed else "new" if state == self.new else "some new"
        return outcome, found

    def mixed(self, state: dict[str, str], old: dict[str, str]) -> bool:
        """Return whether outputs that belong together are neither all old nor all new."""
        for patterns in self.command.groups:
            names = {n for n in (*state, *self.new, *old) if any(Path(n).match(pattern) for pattern in patterns)}
            if not any(all(state.get(n) == whole.get(n) for n in names) for whole in (old, self.new)):
                return True
        return False

    def partial(self, name: str, digest: str | None) -> bool:
        """Return whether an output of a resumable command may be between old and new: a checkpoint, a summary."""
        if digest is None:  # batch removes the record of a job before it does it again
            return name.endswith(".job.json")
        if name.endswith(".safetensors"):
            return True  # `digests` has read it whole
        return name.startswith("batch.")

    def next_run(self, mixed: bool, old: dict[str, str]) -> list[str]:
        """Run what comes next; return what does not hold after it."""
        found = []
        if self.command.resumable:
            if errors := self.finish():
                return [f"the next run failed: {errors.splitlines()[-1]}"]
            state = digests(self.out, self.command.beside)
            found += [f"{n} differs after the next run" for n in self.new if state.get(n) != self.new[n]]
            found += [f"{n} is left after the next run" for n in state if n not in self.new]
        else:
            self.write_other_file()
            if mixed and self.mixed(digests(self.out), old):
                found.append("outputs are still mixed after the next run")
        left = [path for folder in (self.out, self.temporary) for path in folder.rglob("*") if path.name not in STAYING]
        found += [f"{path.name} is left" for path in left if PREFIX in path.name or path.is_relative_to(self.temporary)]
        lines = (self.out / "log.jsonl").read_text().splitlines() if (self.out / "log.jsonl").exists() else []
        for line in lines:
            json.loads(line)
        return found

    def write_other_file(self) -> None:
        """Write a file to every folder of outputs in another process, and delete it: what any command does there."""
        inner = [path for path in self.out.rglob("*") if path.is_dir() and PREFIX not in str(path)]
        others = [folder / "other" for folder in (self.out, *inner)]

        def work() -> None:
            for other in others:
                with whole_file(other) as temporary:
                    temporary.touch()

        self.fork(work).wait()
        for other in others:
            other.unlink()


def summaries_agree(folder: Path) -> bool:
    """Return whether the table and the facts of a batch tell the same states, or there are none."""
    table, facts = folder / "batch.csv", folder / "batch.json"
    if not (table.exists() or facts.exists()):
        return True
    if not (table.exists() and facts.exists()):
        return False
    with table.open(encoding="utf-8") as file:
        states = [row["state"] for row in csv.DictReader(file)]
    return states == [row["state"] for row in json.loads(facts.read_text(encoding="utf-8"))["each"]]


def changes(process: Fork, folder: Path) -> Iterator[None]:
    """Yield when names in a folder change, until the process ends."""
    before = set(os.listdir(folder))
    while process.running():
        now = set(os.listdir(folder))
        if now != before:
            before = now
            yield
        time.sleep(5e-5)


def survivors(root: Path) -> list[int]:
    """Return the processes with a temporary folder below `root`, after a while in which they may end (Linux)."""
    until = time.monotonic() + SURVIVAL
    while found := [number for number in map(int, filter(str.isdigit, os.listdir("/proc"))) if belongs(number, root)]:
        if time.monotonic() > until:
            break
        time.sleep(0.02)
    return found


def belongs(number: int, root: Path) -> bool:
    """Return whether the temporary folder of a process lies below `root`."""
    try:
        return f"TMPDIR={root}/".encode() in Path(f"/proc/{number}/environ").read_bytes()
    except OSError:
        return False


def digests(folder: Path, beside: tuple[str, ...] = ()) -> dict[str, str]:
    """Return digests of the contents of all files of a folder, but temporary ones and those that are `beside`."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    names = {str(path.relative_to(folder)): path for path in paths}
    return {
        name: hashlib.blake2b(content(path), digest_size=16).hexdigest()
        for name, path in names.items()
        if PREFIX not in name and not any(path.match(pattern) for pattern in beside)
    }


def content(path: Path) -> bytes:
    """Return the contents of a file without times and dates; of a checkpoint, all tensors and the step."""
    if path.suffix == ".json":
        return json.dumps(lasting(json.loads(path.read_text()))).encode()
    if path.name == "batch.csv":
        rows = list(csv.DictReader(path.open()))
        return json.dumps([{k: v for k, v in row.items() if k not in ("seconds", "state")} for row in rows]).encode()
    if path.suffix == ".safetensors":
        from mimesh.learn.checkpoint import load

        checkpoint = load(path)
        tensors = b"".join(
            key.encode() + checkpoint.tensors[key].numpy().tobytes() for key in sorted(checkpoint.tensors)
        )
        return tensors + json.dumps([checkpoint.step, checkpoint.best, checkpoint.metrics]).encode()
    return path.read_bytes()


def lasting(value: Any) -> Any:
    """Return a value of JSON without what differs from run to run; jobs done before count as done."""
    if isinstance(value, dict):
        kept = {k: lasting(v) for k, v in value.items() if k not in (*VARYING, "counts", "workers")}
        return kept | ({"state": "done"} if value.get("state") == "done before" else {})
    return [lasting(entry) for entry in value] if isinstance(value, list) else value


if __name__ == "__main__":
    main()
