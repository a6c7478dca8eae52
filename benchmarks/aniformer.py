"""Speed of AniFormer at the paper's width and of the public code's arithmetic; memory and window borders of long clips.

    python benchmarks/aniformer.py [-m MODEL] [-o FILE]

In the public code every vertex of a frame attends to every other, with one head (V x V products, 73 % of its
arithmetic). Both networks are exported and run by onnxruntime at 6,890 vertices with untrained weights, as `animate`
runs them: in windows of T = 3 frames that overlap by one. MODEL (an AniFormer: a name or an .onnx file) then animates
30 and 300 frames. Measured are the peak memory of each, and the ratio of the error of accelerations at borders of
windows to that inside of windows.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mimesh.bodies import load_body
from mimesh.core.mesh import Clip
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import save_clip, save_mesh
from mimesh.io.atomic import whole_file
from mimesh.methods.find import find_method
from mimesh.methods.npt import OVERLAP, AniFormerMethod
from mimesh.methods.onnx_runtime import import_onnxruntime
from mimesh.motions import motion_clip
from mimesh.motions.procedural import walk_motion

VERTICES = 6890
REPEATS = 3
SECONDS = 10.0
"""Length of the long clip: 300 frames at 30 frames per second."""


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-m", "--model", help="model of the long clips; without it only the arithmetic is timed")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    figures = {"speed": speed(), **(long_clips(args.model) if args.model else {})}
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), "seed": 0, **figures}
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def speed() -> dict[str, dict[str, float]]:
    """Return seconds and operations per frame of the result, for the public code's arithmetic and for ours."""
    from mimesh.learn.aniformer import AniFormerConfig

    public = AniFormerConfig(frames=1, attention="vertices", heads=1, scaled=False, keys=VERTICES)
    own_configs = {attention: AniFormerConfig(attention=attention) for attention in ("frames", "vertices", "both")}
    costs = {name: frame_cost(config) for name, config in {"public": public, **own_configs}.items()}
    for cost in costs.values():
        cost["times_faster_than_public"] = round(costs["public"]["seconds"] / cost["seconds"], 2)
    return costs


def frame_cost(config) -> dict[str, float]:
    """Return the cost per frame: the fastest of REPEATS runs of a window, divided by the frames that a window adds."""
    import torch

    from mimesh.learn.aniformer import AniFormer, AniFormerTask
    from mimesh.learn.export import to_onnx

    torch.manual_seed(0)
    model = AniFormer(config)
    session = import_onnxruntime().InferenceSession(
        to_onnx(AniFormerTask.onnx_interface(model)).SerializeToString(), providers=["CPUExecutionProvider"]
    )
    rng = np.random.default_rng(0)
    inputs = {
        "identity": rng.uniform(-1, 1, (1, VERTICES, 3)).astype(np.float32),
        "driving": rng.uniform(-1, 1, (1, config.frames, VERTICES, 3)).astype(np.float32),
    }
    new_frames = max(1, config.frames - OVERLAP)
    times = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        session.run(["result"], inputs)
        times.append(time.perf_counter() - started)
    return {
        "seconds": round(min(times) / new_frames, 3),
        "seconds_without_overlap": round(min(times) / config.frames, 3),
        "gflop": round(model.estimate_flops(VERTICES) * config.frames / new_frames / 1e9, 1),
    }


def long_clips(model: str) -> dict[str, float]:
    """Measure peak memory of the command line at 30 and 300 frames, and jitter at the borders of windows."""
    body = load_body()
    motion = walk_motion(body, 0, 0, seconds=SECONDS, fps=30.0)
    driving, truth = (motion_clip(body, shape, motion) for shape in (np.full(1, 1.5), np.zeros(1)))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        save_mesh(truth.mesh, folder / "identity.obj")
        peaks = {}
        for frames in (30, 300):
            save_clip(Clip(driving.mesh, driving.vertices[:frames], 30.0), folder / f"driving{frames}")
            axes = ["--up", "+y", "--front", "+z", "--driving-up", "+y", "--driving-front", "+z"]
            names = [str(folder / name) for name in ("identity.obj", f"driving{frames}", f"moved{frames}.npz")]
            command = ["mimesh", "animate", *names[:2], "-m", model, "-o", names[2], "-q", *axes]
            peaks[frames] = peak_mb(command)
        moved = np.load(folder / "moved300.npz")["vertices"].astype(np.float64)
    error = np.linalg.norm(np.diff(moved - truth.vertices, 2, axis=0), axis=-1).mean(axis=1)
    method = find_method(model)
    assert isinstance(method, AniFormerMethod), f"{model} has no windows"
    borders = np.arange(1, len(error) + 1) % (method.frames - OVERLAP) == 0
    return {
        "peak_mb_30_frames": round(peaks[30]),
        "peak_mb_300_frames": round(peaks[300]),
        "peak_ratio": round(peaks[300] / peaks[30], 3),
        "jitter_at_borders_over_inside": round(float(error[borders].mean() / error[~borders].mean()), 3),
    }


def peak_mb(command: list[str]) -> float:
    """Run a command in a child process and return its peak memory in MiB."""
    script = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True); "
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    done = subprocess.run([sys.executable, "-c", script, *command], check=True, capture_output=True, text=True)
    return int(done.stdout.split()[-1]) / 1024


if __name__ == "__main__":
    main()
