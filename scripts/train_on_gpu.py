"""Train the papers' networks at full width within some minutes of one GPU, and write all results as small files.

    python scripts/train_on_gpu.py OUT --minutes 8
    python scripts/train_on_gpu.py OUT --rate                        # how fast a step is, and what it consists of
    python scripts/train_on_gpu.py OUT --minutes 1 --tiny            # the same on a CPU, with tiny networks
    cat OUT/results.tar.* | tar -x                                   # joins the files of OUT

The minutes are divided among the jobs; a job that begins with another goes on from its weights before the learning
rate fell. While one trains, those before it are exported and measured (`mimesh evaluate --torch`) on the same GPU. OUT
is written anew after each of these steps, so it is complete up to where the machine is taken away.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import shutil
import subprocess
import sys
import tarfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import torch
from pack_checkpoint import save_compact
from torch._inductor.exc import InductorError

from mimesh.io.atomic import whole_file
from mimesh.learn.checkpoint import hardware
from mimesh.learn.config import load_config
from mimesh.learn.loop import FULL_RATE, TrainingRun, train
from mimesh.learn.start import begin_with
from mimesh.learn.table_rows import ROWS
from mimesh.learn.task import TrainConfig, training_operations

WARM_STEPS, TIMED_STEPS, PROFILED_STEPS = 6, 40, 3
"""Of `--rate`: steps before the clock starts, steps timed, and steps listed kernel by kernel."""
WRITING = Lock()
"""Held by who writes the parts of the results."""
TINY = ("data.vertices=64", "compile=false", "batch=4", "validation_pairs=1", "warmup=16", "precision=fp32")
"""Changes of `--tiny`, beside `TINY_MODEL`."""
TINY_MODEL = {
    "npt": ("model.encoder=[8,8,16]", "model.decoder=[16,16,16]"),
    "aniformer": ("model.encoder=[8,8,16]", "model.layers=[16,16,16,16]"),
}


@dataclass(frozen=True)
class Job:
    """A row of `learn.table_rows` to train."""

    name: str
    protocol: str
    """What it is measured on."""
    share: float
    """Of the minutes."""
    start: str = ""
    """Job whose weights it begins with."""
    changes: tuple[str, ...] = ()
    """Settings that differ from those of the row."""

    def config(self, minutes: float, tiny: bool) -> TrainConfig:
        """Load its configuration for so many minutes."""
        row = ROWS[self.name]
        small = (*TINY, *TINY_MODEL[row.network]) if tiny else ()
        return load_config("gpu", row.network, (f"minutes={minutes}", *row.changes, *self.changes, *small))


JOBS = (
    Job("aniformer-ordered", "clips-ordered", 0.30),
    Job("aniformer-ordered-mixed", "clips-ordered", 0.20, "aniformer-ordered"),
    Job("npt-full", "human-npt", 0.22),
    Job("npt-full-mixed", "human-npt", 0.10, "npt-full"),
    Job("npt-ordered", "clips-ordered", 0.10),
    Job("npt-ordered-mixed", "clips-ordered", 0.08, "npt-ordered"),
)


def main() -> None:
    """Time the jobs, or train, export and measure them one after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument("--minutes", type=float, default=8.0, help="of training, all jobs together")
    parser.add_argument("--jobs", nargs="*", default=[job.name for job in JOBS], help="some of the jobs, by name")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="changes to all configurations")
    parser.add_argument("--rate", action="store_true", help="time the steps of each job instead")
    parser.add_argument("--tiny", action="store_true", help="tiny networks, to try this script on a CPU")
    parser.add_argument("--keep", nargs="*", default=[], help="jobs whose weights before the fall are kept, too")
    parser.add_argument("--max-file-mib", type=float, default=16.0, help="size of the largest file of OUT")
    parser.add_argument("--work", type=Path, default=Path("runs/gpu"), help="folder for checkpoints")
    args = parser.parse_args()
    jobs = [job for job in JOBS if job.name in args.jobs]
    if len(jobs) < len(args.jobs):
        parser.error(f"--jobs: expected some of {', '.join(job.name for job in JOBS)}, found {' '.join(args.jobs)}")
    jobs = [dataclasses.replace(job, changes=tuple(args.set)) for job in jobs]
    results = args.work / "results"
    results.mkdir(parents=True, exist_ok=True)
    if args.rate:
        for job in jobs:
            (results / f"{job.name}-rate.json").write_text(json.dumps(measure_rate(job, results, args.tiny), indent=2))
            write_parts(results, args.out, args.max_file_mib)
        return
    total = sum(job.share for job in jobs)
    with ThreadPoolExecutor(len(jobs)) as background:
        for job in jobs:
            train_job(job, args.minutes * job.share / total, args.work, args.tiny)
            background.submit(finish, job, args, results).add_done_callback(lambda done: done.result())


def train_job(job: Job, minutes: float, work: Path, tiny: bool) -> None:
    """Train a job to the end of its minutes; one that was trained before goes on."""
    config, folder = job.config(minutes, tiny), work / job.name
    started = time.monotonic()
    for compiled in (config.compile, False):
        config = dataclasses.replace(config, compile=compiled)
        if job.start and not (folder / "last.safetensors").exists():
            begin_with(config, work / job.start / FULL_RATE, folder)
        try:
            train(config, folder)
            break
        except InductorError as error:
            print(f"{job.name}: goes on without compiling: {str(error)[:2000]}", flush=True)
    print(f"{job.name}: {time.monotonic() - started:.0f} s in all, {60 * minutes:.0f} s of them meant for steps")


def finish(job: Job, args: argparse.Namespace, results: Path) -> None:
    """Export a trained job to the results and measure it; a step that fails is reported and costs no other."""
    folder, onnx = args.work / job.name, results / f"{job.name}.onnx"
    shutil.copy(folder / "log.jsonl", results / f"{job.name}-log.jsonl")
    if job.name in args.keep:
        save_compact(folder / FULL_RATE, results / f"{job.name}-{FULL_RATE}", weights_only=True)
    pairs = ["--pairs", "1"] if args.tiny else []
    commands = (
        ["export", folder / "last.safetensors", "-o", onnx, "--bits", "8"],
        ["evaluate", job.protocol, "-m", onnx, "--torch", "-o", results / f"{job.name}-test.json", *pairs],
    )
    for command in commands:
        done = subprocess.run(
            [sys.executable, "-m", "mimesh", *map(str, command)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            reason = done.stderr[-2000:] or f"exit code {done.returncode}"
            print(f"{job.name}: mimesh {command[0]} failed: {reason}", flush=True)
            return
        with WRITING:
            write_parts(results, args.out, args.max_file_mib)
    print(f"{job.name}: exported and measured", flush=True)


def measure_rate(job: Job, results: Path, tiny: bool) -> dict[str, float | str]:
    """Time the steps of a job; write the profile of some to the results, and give the rate."""
    run = TrainingRun.start(job.config(1.0, tiny), results / "no training there")
    cuda = run.task.device.type == "cuda"
    wait = torch.cuda.synchronize if cuda else lambda: None
    for _ in range(1 if tiny else WARM_STEPS):
        run.advance()
    wait()
    steps, started = (1 if tiny else TIMED_STEPS), time.perf_counter()
    losses = [run.advance() for _ in range(steps)]
    host = time.perf_counter() - started
    wait()
    seconds = (time.perf_counter() - started) / steps
    with torch.profiler.profile() as profile:
        for _ in range(1 if tiny else PROFILED_STEPS):
            run.advance()
        wait()
    by = "self_cuda_time_total" if cuda else "self_cpu_time_total"
    (results / f"{job.name}-profile.txt").write_text(profile.key_averages().table(sort_by=by, row_limit=45))
    rate = {
        "device": hardware(),
        "step_ms": 1e3 * seconds,
        "host_ms": 1e3 * host / steps,
        "pairs_per_s": run.config.batch / seconds,
        "tflops": training_operations(run.task, run.model, run.config.batch) / seconds / 1e12,
        "peak_gib": torch.cuda.max_memory_allocated() / 2**30 if cuda else 0.0,
        "loss": float(losses[-1]),
    }
    print(job.name, json.dumps({k: v if isinstance(v, str) else float(f"{v:.4g}") for k, v in rate.items()}))
    return rate


def write_parts(results: Path, out: Path, mib: float) -> None:
    """Write a folder to `out` as the parts of one archive, none larger than so many MiB."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        archive.add(results, results.name)
    data, size = packed.getvalue(), int(mib * 2**20)
    out.mkdir(parents=True, exist_ok=True)
    for part, start in enumerate(range(0, len(data), size)):
        with whole_file(out / f"results.tar.{part:02}") as temporary:
            temporary.write_bytes(data[start : start + size])


if __name__ == "__main__":
    main()
