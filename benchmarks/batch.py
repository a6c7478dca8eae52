"""Measure `mimesh batch`: speed-up by workers, memory of workers, and what preparing an identity once saves.

    python benchmarks/batch.py [-o benchmarks/batch.json] [--identities 20] [--drivings 5] [--small 1000]

Identities are people of the shipped body with other shapes, 9,564 vertices each; half of the drivings are motion files
(.bvh), half are clips of meshes without joints (.npz), 60 frames each. Small jobs transfer a pose by `copy`, by one
worker: its memory is reported over time, and as the slope fitted over the last nine tenths of the jobs. Every batch is
a process of its own; files are temporary. Costs are seconds of processor time, of all processes and threads, so that
other programs on the machine change them little; `seconds` and the speed-up are wall time.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np

import mimesh
from mimesh.bodies import character, load_body
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import save_bvh, save_clip, save_mesh
from mimesh.io.atomic import whole_file
from mimesh.io.child_process import VARIABLES as LIBRARY_THREADS
from mimesh.methods.onnx_runtime import THREADS
from mimesh.mime.kept_results import keep_results
from mimesh.motions import load_motion, motion_clip

MOTIONS = ("jump", "turn")
FRAMES = 60
NAME = "heavy"
STRETCH = 0.2
"""Largest change of a dimension of an identity: all are meshes of their own."""


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--identities", type=int, default=20)
    parser.add_argument("--drivings", type=int, default=5)
    parser.add_argument("--small", type=int, default=1000)
    args = parser.parse_args()
    report: dict[str, Any] = {"commit": commit(), "machine": machine(), "libraries": libraries()}
    report |= {"load": round(os.getloadavg()[0], 1), "identities": args.identities, "drivings": args.drivings}
    with tempfile.TemporaryDirectory() as folder:
        write_inputs(Path(folder), args.identities, args.drivings)
        report["identity"] = identity_costs(Path(folder))
        report["command"] = command_seconds(Path(folder))
        report["workers"] = {str(count): large(Path(folder), count) for count in (1, 2)}
        report["small"] = small(Path(folder), args.small)
    report["speed_up"] = round(report["workers"]["1"]["seconds"] / report["workers"]["2"]["seconds"], 2)
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def write_inputs(folder: Path, identities: int, drivings: int) -> None:
    """Write the folders identities, drivings and poses."""
    mesh, body = character(NAME), load_body()
    for k in range(identities):
        stretch = 1 + STRETCH * np.random.default_rng(k).uniform(-1, 1, 3)
        save_mesh(mesh.with_vertices(mesh.vertices * stretch), folder / "identities" / f"{k:03}.glb")
    for k in range(drivings):
        motion = load_motion(MOTIONS[k // 2 % len(MOTIONS)])
        if k % 2 == 0:
            save_bvh(motion, body, folder / "drivings" / f"{k:03}.bvh")
        else:
            clip = motion_clip(body, None, motion)
            save_clip(mimesh.Clip(clip.mesh, clip.vertices[:FRAMES], clip.fps), folder / "drivings" / f"{k:03}.npz")
    save_mesh(body.mesh(), folder / "poses" / "rest.obj")


def identity_costs(folder: Path) -> dict[str, dict[str, float]]:
    """Return the cost of `animate` for one identity: first, again, with kept results; and that of a cache on disk.

    The cache holds what depends on the identity alone, joints and weights, as an archive of arrays.
    """
    identity = folder / "identities" / "000.glb"
    figures = {}
    for kind, driving in (("joints", "000.bvh"), ("mesh", "001.npz")):
        clip = folder / "drivings" / driving
        if not clip.exists():
            continue

        def seconds(clip: Path = clip) -> float:
            begin = time.process_time()
            mimesh.animate(identity, clip, motion=mimesh.MotionOptions(skinned=None))
            return round(time.process_time() - begin, 3)

        figures[kind] = {"first": seconds(), "alone": min(seconds() for _ in range(3))}
        keep_results()
        seconds()
        figures[kind]["identity_and_driving_kept"] = min(seconds() for _ in range(3))
        keep_results(False)
    return figures | {"disk": disk_cache(identity, folder)}


def command_seconds(folder: Path) -> float:
    """Return the cost of `mimesh animate` as a command of its own, with one thread."""
    inputs = [str(folder / "identities" / "000.glb"), str(folder / "drivings" / "000.bvh")]
    command = [sys.executable, "-m", "mimesh", "animate", *inputs, "-o", str(folder / "one.glb"), "--no-preview", "-q"]
    times = []
    for _ in range(3):
        begin = children_seconds()
        subprocess.run(command, check=True, env={**os.environ, **LIBRARY_THREADS, THREADS: "1"})
        times.append(children_seconds() - begin)
    return round(min(times), 3)


def children_seconds() -> float:
    """Return the processor time of all processes that this one has started, and that these have, up to their ends."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def disk_cache(identity: Path, folder: Path) -> dict[str, float]:
    """Return seconds of predicting an identity, and of reading the same from an archive; and its size (MiB)."""
    from mimesh.core.normalization import Normalization
    from mimesh.methods.find import find_mime
    from mimesh.pipeline.look import normalised

    mesh, mime = mimesh.load_mesh(identity), find_mime("mime")
    rest = normalised(mesh, Normalization.fit(mesh, None, None))
    begin = time.process_time()
    rig, _ = mime.predict_rig(rest)
    predicted = time.process_time() - begin
    archive = folder / "rig.npz"
    np.savez(archive, rotation=rig.rotation, joints=rig.joints, weights=rig.weights)
    begin = time.process_time()
    with np.load(archive, allow_pickle=False) as arrays:
        sizes = [arrays[name].nbytes for name in arrays]
    read = time.process_time() - begin
    return {"predict": round(predicted, 3), "read": round(read, 4), "mib": round(sum(sizes) / 2**20, 2)}


def large(folder: Path, workers: int) -> dict[str, Any]:
    """Return what a batch of all pairs costs with so many workers."""
    facts = run_batch(folder, "identities", "drivings", "{identity}/{driving}.glb", workers)
    steps = {name: round(mean(row["steps"][name] for row in facts["each"]), 3) for name in facts["each"][0]["steps"]}
    return figures_of(facts) | {"steps": steps}


def small(folder: Path, jobs: int) -> dict[str, Any]:
    """Return what many small jobs cost one worker, and its memory over time."""
    table = folder / "small.csv"
    rows = [f"{folder}/poses/rest.obj,{folder}/poses/rest.obj,{folder}/small/{k}.obj,copy" for k in range(jobs)]
    table.write_text("\n".join(("identity,driving,output,model", *rows)) + "\n")
    facts = run_batch(folder, str(table), None, None, 1, "--transfer", "--no-sheet")
    return figures_of(facts) | memory_over_time([row["memory_mib"] for row in facts["each"]])


def memory_over_time(memory: list[float]) -> dict[str, Any]:
    """Return the memory (MiB) of one worker in ten equal parts of its jobs, and its growth in a thousand jobs.

    The first tenth is left out of the slope: libraries and networks are loaded in it.
    """
    settled = memory[len(memory) // 10 :]
    slope = np.polyfit(np.arange(len(settled)), settled, 1)[0] if len(settled) > 1 else 0.0
    parts = [round(float(part.max()), 1) for part in np.array_split(np.array(memory), min(10, len(memory)))]
    return {"memory_mib": parts, "memory_mib_in_1000_jobs": round(1000 * float(slope), 2)}


def figures_of(facts: dict) -> dict[str, Any]:
    """Return seconds, jobs, and the memory (MiB) of the workers after the first tenth of the jobs and at the end."""
    memory = [row["memory_mib"] for row in facts["each"]]
    tenth = max(1, len(memory) // 10)
    return {
        "jobs": facts["jobs"],
        "failed": facts["counts"]["failed"],
        "seconds": facts["seconds"],
        "cpu_seconds_a_job": round(facts["cpu_seconds"] / facts["jobs"], 3),
        "output_mib": facts["output_mib"],
        "memory_mib_first": max(memory[:tenth]),
        "memory_mib_last": max(memory[-tenth:]),
    }


def run_batch(folder: Path, identities: str, drivings: str | None, pattern: str | None, workers: int, *more) -> dict:
    """Run `mimesh batch` and return its facts."""
    output = folder / f"out-{workers}"
    command = [sys.executable, "-m", "mimesh", "batch", str(folder / identities)]
    if drivings is not None:
        command += [str(folder / drivings), "-o", str(output / str(pattern))]
    command += ["--workers", str(workers), "--json", *more]
    begin = children_seconds()
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    used = children_seconds() - begin
    if not done.stdout:
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}")
    facts = json.loads(done.stdout)
    size = sum(Path(row["output"]).stat().st_size for row in facts["each"] if Path(row["output"]).exists())
    shutil.rmtree(output, ignore_errors=True)
    return {**facts, "output_mib": round(size / 2**20, 2), "cpu_seconds": used}


if __name__ == "__main__":
    main()
