"""Install a wheel under several Python and NumPy versions, run the demo and a transfer, and compare the results.

    python benchmarks/pythons.py dist/mimesh-0.2.0-py3-none-any.whl --python python3.11 --python python3.12 \
        --numpy 1.26 --numpy 2 -o benchmarks/pythons.json

Each combination gets a new environment with the newest releases of everything else. Only binary packages are installed,
so a combination that a library has no wheel for is reported as such. The points of the transfer are compared with those
of the first combination. To add interpreters of another system, run it there with the same -o and --points.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from mimesh.evaluate.provenance import LIBRARIES, commit, machine
from mimesh.io.atomic import whole_file

TRANSFER = """
import json, platform, sys
from importlib import metadata
import numpy as np
import mimesh
result = mimesh.transfer("demo/identity.obj", "demo/driving.obj")
result.save("pose.glb")
assert len(mimesh.load_mesh("pose.glb").faces) > 0
np.save("points.npy", result.vertices)
versions = {name: metadata.version(name) for name in sys.argv[1:]}
print(json.dumps({"python": platform.python_version(), "libc": platform.libc_ver()[1], **versions}))
"""


class Failed(Exception):
    """A step that failed; the message is the last line that it printed."""


def main() -> None:
    """Measure all combinations, print the report and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--python", action="append", required=True, help="command or path of an interpreter")
    parser.add_argument("--numpy", action="append", required=True, help="release series, such as 1.26 or 2")
    parser.add_argument("-o", "--output", type=Path, help="report; rows are added to one that exists")
    parser.add_argument("--points", type=Path, help="points of the first combination (.npy), written if there are none")
    args = parser.parse_args()
    report = {"rows": []}
    if args.output and args.output.exists():
        report = json.loads(args.output.read_text())
    source = {"commit": commit(), "machine": machine(), "wheel": args.wheel.name}
    first = np.load(args.points) if args.points and args.points.exists() else None
    for python in args.python:
        for series in args.numpy:
            row, points = measure(args.wheel.resolve(), python, series)
            if points is not None:
                first = points if first is None else first
                row["distance_mm"] = float(f"{1000 * np.linalg.norm(points - first, axis=1).max():.2g}")
            report["rows"].append(row | source)
            print(json.dumps(row))
    if args.points and first is not None:
        np.save(args.points, first)
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def measure(wheel: Path, python: str, series: str) -> tuple[dict, np.ndarray | None]:
    """Install and run one combination; return its row, and the points of the transfer (V, 3) in metres."""
    row: dict = {"python": python}
    with tempfile.TemporaryDirectory() as folder:
        binaries = Path(folder) / "venv" / "bin"
        try:
            row["python"] = last_line(python, "-c", "import platform; print(platform.python_version())")
            last_line(python, "-m", "venv", str(binaries.parent))
            options = ("--quiet", "--no-compile", "--disable-pip-version-check", "--only-binary=:all:")
            last_line(str(binaries / "python"), "-m", "pip", "install", *options, str(wheel), f"numpy=={series}.*")
            last_line(str(binaries / "mimesh"), "demo", "--quiet", "-o", "demo", folder=folder)
            row |= json.loads(last_line(str(binaries / "python"), "-c", TRANSFER, *LIBRARIES, folder=folder))
        except Failed as error:
            return row | {"numpy": series, "ok": False, "error": str(error)}, None
        return row | {"ok": True}, np.load(Path(folder) / "points.npy")


def last_line(*command: str, folder: str | None = None) -> str:
    """Run a command and return the last line of what it prints.

    Raises:
        Failed: it exits with an error, or is not there.
    """
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_"))}
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=variables)
    except OSError as error:
        raise Failed(str(error)) from error
    lines = (done.stderr if done.returncode else done.stdout).strip().splitlines() or [""]
    if done.returncode:
        raise Failed(lines[-1])
    return lines[-1]


if __name__ == "__main__":
    main()
