"""Time short commands with one and two threads: the demo's transfer, and ten frames of a long capture.

    python benchmarks/threads.py CAPTURE.bvh [-o FILE] [--runs N]

Wall-clock and processor seconds of whole commands, as a shell sees them; the median of the runs. The load average of
the machine is written beside them: on a busy machine wall-clock times say how commands share it. `first_frames` names
the frames that are taken of the capture.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mimesh.commands.options import NETWORKS
from mimesh.core.threads import LINEAR_ALGEBRA
from mimesh.evaluate.provenance import commit, machine
from mimesh.io.atomic import whole_file
from mimesh.motions.bvh import load_bvh

FRAMES = 10
"""Frames taken of the capture."""
THREADS = {"1": ("1", "1"), "2 in networks": ("2", "1"), "2": ("2", "2")}
"""Row -> threads of networks, and of linear algebra."""


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--runs", type=int, default=3)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        demo = Path(folder) / "demo"
        run(["demo", "-o", str(demo), "-q"], {})
        commands = {
            "transfer": ["transfer", str(demo / "identity.obj"), str(demo / "driving.obj")],
            "first_frames": ["animate", str(demo / "identity.obj"), str(args.capture), "--stop", str(FRAMES)],
        }
        report = {
            "commit": commit(),
            "machine": machine(),
            "seed": 0,
            "capture_frames": len(load_bvh(args.capture).rotmat),
            "frames": FRAMES,
            "runs": args.runs,
            "load_average": os.getloadavg()[0],
            **{name: measure([*command, "-q"], args.runs) for name, command in commands.items()},
        }
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def measure(command: list[str], runs: int) -> dict[str, dict[str, float]]:
    """Return median seconds of a command for each row of THREADS; the rows take turns, as the load changes."""
    found = {row: [] for row in THREADS}
    for _ in range(runs):
        for row, (networks, algebra) in THREADS.items():
            found[row].append(run(command, {NETWORKS: networks, **dict.fromkeys(LINEAR_ALGEBRA, algebra)}))
    return {
        row: {
            "wall_s": round(statistics.median(wall for wall, _ in times), 2),
            "processor_s": round(statistics.median(processor for _, processor in times), 2),
        }
        for row, times in found.items()
    }


def run(command: list[str], variables: dict[str, str]) -> tuple[float, float]:
    """Run a command that must succeed; return its wall-clock and processor seconds."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-m", "mimesh", *command], check=True, env=os.environ | variables)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
