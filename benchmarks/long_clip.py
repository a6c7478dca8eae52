"""Measure the memory of `mimesh convert` for long clips: it must not grow with the number of frames.

    python benchmarks/long_clip.py [-o FILE] [--frames 2000] [--formats .glb .npz ...]

The clip is a waving sheet of 20,000 vertices, with all frames and with a tenth of them. Every format is written from a
NumPy archive and read back into one, each time by a separate process. Measured are its peak resident memory, and the
peak of anonymous memory: the part that is not mapped from a file, which the system cannot reclaim. Files are temporary.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mimesh.core.frame_buffer import store_frames
from mimesh.core.mesh import Clip, Mesh
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import save_clip
from mimesh.io.atomic import whole_file
from mimesh.io.formats import CLIP_WRITERS

SIDES = (200, 100)
"""Vertices along the sides of the sheet."""
FOLDER = "folder of .ply"
DEFAULT = (*sorted(CLIP_WRITERS), FOLDER)


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--formats", nargs="+", default=DEFAULT, choices=DEFAULT)
    args = parser.parse_args()
    figures: dict[str, dict] = {name: {} for name in args.formats}
    for frames in (args.frames // 10, args.frames):
        for name in args.formats:
            figures[name][str(frames)] = measure(name, frames)
            print(f"{name:16}{frames:6} frames  {figures[name][str(frames)]}", flush=True)
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), "vertices": SIDES[0] * SIDES[1]}
    report |= {"frames": args.frames, "formats": figures}
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def measure(name: str, frames: int) -> dict[str, float]:
    """Return memory (MiB) and seconds of writing and of reading a format, and the size of the file (MiB)."""
    with tempfile.TemporaryDirectory() as folder:
        source, read_back = Path(folder) / "start.npz", Path(folder) / "back.npz"
        written = Path(folder) / ("written" if name == FOLDER else f"written{name}")
        save_clip(waves(frames), source)
        extra = ["--frames-as", "ply"] if name == FOLDER else []
        write = convert(source, written, *extra)
        read = convert(written, read_back)
        size = sum(path.stat().st_size for path in Path(folder).rglob("written*") if path.is_file())
        size += sum(path.stat().st_size for path in written.glob("*")) if written.is_dir() else 0
    figures = {f"write_{name}": value for name, value in write.items()}
    figures |= {f"read_{name}": value for name, value in read.items()}
    return {**figures, "size_mib": round(size / 2**20, 1)}


def convert(source: Path, target: Path, *extra: str) -> dict[str, float]:
    """Run `mimesh convert` and return its peak resident and anonymous memory (MiB) and its seconds."""
    begin, peak_anonymous = time.perf_counter(), 0.0
    command = [sys.executable, "-m", "mimesh", "convert", str(source), str(target), "--quiet", *extra]
    child = os.posix_spawn(sys.executable, command, os.environ)
    while True:
        peak_anonymous = max(peak_anonymous, anonymous_memory(child))
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            break
        time.sleep(0.01)
    if status:
        raise SystemExit(f"mimesh convert {source.name} {target.name} failed")
    seconds = round(time.perf_counter() - begin, 2)
    return {"mib": round(usage.ru_maxrss / 1024, 1), "own_mib": round(peak_anonymous, 1), "s": seconds}


def anonymous_memory(process: int) -> float:
    """Return the anonymous memory (MiB) of a running process (Linux)."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("RssAnon")), 0.0)


def waves(frames: int) -> Clip:
    """Make a clip of a sheet with a wave that travels over it."""
    x, z = (side.ravel() / 100 for side in np.meshgrid(*map(np.arange, SIDES), indexing="ij"))
    cells = np.arange(len(x)).reshape(SIDES)
    corners = [cells[:-1, :-1], cells[:-1, 1:], cells[1:, 1:], cells[1:, :-1]]
    quads = np.stack([corner.ravel() for corner in corners], axis=1)
    faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    moved = (np.stack([x, 0.1 * np.sin(9 * x + 5 * z + t / 5), z], axis=1) for t in range(frames))
    vertices = store_frames(moved, frames, len(x), np.float32)
    return Clip(Mesh(vertices[0].astype(np.float64), faces, name="waves"), vertices)


if __name__ == "__main__":
    main()
