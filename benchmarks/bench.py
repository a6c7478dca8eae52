"""Measure speed and size of this checkout: a table, then one line of JSON; exit code 1 if a gated figure got worse.

    python benchmarks/bench.py [--skip-install] [--save]

`baseline.json` has for each figure the committed value, the better direction, the tolerance, and a limit if there is
one. Ratios, sizes and limits are gates; plain times depend on the machine and are only printed.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from mimesh.bodies import load_body
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.mesh import Clip
from mimesh.evaluate.provenance import commit, machine

ROOT = Path(__file__).parents[1]
BASELINE = Path(__file__).with_name("baseline.json")
BODIES = 32
"""Number of bodies in one batch of the generator comparison."""


def main() -> int:
    """Measure all figures, print them, and compare them with the baseline; return the exit code."""
    args = parse_args()
    figures: dict[str, float] = {**command(), **picture(), **networks(), **generator()}
    if not args.skip_install:
        figures |= install()
    baseline = json.loads(BASELINE.read_text())
    worse = print_table(figures, baseline)
    figures = {name: round(value, 4) for name, value in figures.items()}
    if args.save:
        BASELINE.write_text(json.dumps(updated(baseline, figures), indent=2) + "\n")
    print(json.dumps({"figures": figures, "worse": worse, "commit": commit(), "machine": machine()}))
    return 1 if worse else 0


def parse_args() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--skip-install", action="store_true", help="leave out the size of a fresh base install")
    parser.add_argument("--save", action="store_true", help="make these figures the new baseline")
    return parser.parse_args()


def command() -> dict[str, float]:
    """Measure the wall time of `mimesh --help`, in seconds and relative to a bare Python interpreter."""
    mimesh = Path(sys.executable).with_name("mimesh")
    help_time = seconds(lambda: subprocess.run([mimesh, "--help"], check=True, capture_output=True), 7)
    bare = seconds(lambda: subprocess.run([sys.executable, "-c", "pass"], check=True), 7)
    return {"help_s": help_time, "help_over_python": help_time / bare}


def picture() -> dict[str, float]:
    """Measure the seconds of one 512 x 512 picture of the shipped body."""
    from mimesh.view.raster import render_mesh

    mesh = load_body().mesh()
    return {"raster_s": seconds(lambda: render_mesh(mesh, (512, 512)), 5)}


def networks() -> dict[str, float]:
    """Measure milliseconds per frame of shipped networks at 6,890 vertices, without reading and writing files."""
    from mimesh.methods.find import find_model
    from mimesh.mime.model import Mime
    from mimesh.rigs.retarget import Retarget

    body = load_body()
    posed = body.mesh(body.posed(sample_shape(body, 0, 0), rotvec_to_rotmat(sample_pose(body, 0, 0))))
    figures = {}
    for name in ("mime", "npt", "npt-maxpool"):  # the other networks have the same layers as npt
        model = find_model(name)
        if isinstance(model, Mime):
            retarget = Retarget.of(model.rig(body.mesh()), model.capture(Clip.still(posed)))
            move = partial(retarget.frame, 0, posed.vertices)
        else:
            drive = model.prepare(body.mesh(), Clip.still(posed))
            move = partial(lambda d: next(d([posed.vertices])), drive)
        figures[f"{name}_ms_a_frame"] = 1e3 * seconds(lambda m=move: [m() for _ in range(4)], 3) / 4
    return figures


def generator() -> dict[str, float]:
    """Measure bodies per second of the generator of training data, and of anny's forward pass at that vertex count."""
    if find_spec("torch") is None:
        print("generator: PyTorch is not installed (pip install 'mimesh[train]'), left out")
        return {}
    import torch

    from mimesh.learn.data.bodies import TorchBody

    body = load_body()
    torch_body = TorchBody(body)
    shape = torch.from_numpy(np.stack([sample_shape(body, 0, i) for i in range(BODIES)])).float()
    poses = np.stack([sample_pose(body, 0, i, JOINT_LIMITS) for i in range(BODIES)])
    rotmat = torch.from_numpy(rotvec_to_rotmat(poses)).float()
    with torch.inference_mode():
        own_rate = BODIES / seconds(lambda: torch_body.posed(shape, rotmat), 9)
    figures = {"bodies_per_s": own_rate}
    anny_rate = anny_bodies(len(body.vertices), rotmat)
    return figures | ({"bodies_per_s_over_anny": own_rate / anny_rate, "anny_per_s": anny_rate} if anny_rate else {})


def anny_bodies(vertices: int, rotmat) -> float | None:
    """Measure bodies per second of anny's forward pass (float32) with its arrays cut to our vertex count.

    None if anny is not installed.
    """
    if find_spec("anny") is None:
        print("generator: anny is not installed (pip install 'mimesh[bodies]'), comparison left out")
        return None
    import anny  # pyright: ignore[reportMissingImports]
    import torch

    torch.set_default_dtype(torch.float32)
    model: Any = anny.Anny(rig="cmu_mb", topology="anny-noeyes-notongue", skinning_method="lbs").to(torch.float32)
    total = len(model.template_vertices)
    for name, values in list(model.named_buffers()):
        if total in values.shape:
            axis = values.shape.index(total)
            setattr(model, name, values.narrow(axis, 0, vertices).contiguous())
    poses = torch.eye(4).repeat(BODIES, len(model.bone_labels), 1, 1)
    poses[..., :3, :3] = rotmat
    rng = np.random.default_rng(0)
    people = {k: torch.from_numpy(rng.uniform(0.3, 0.8, BODIES)).float() for k in model.phenotype_labels}
    with torch.inference_mode():
        result = model(poses, people)["vertices"]
        assert result.shape == (BODIES, vertices, 3), result.shape
        return BODIES / seconds(lambda: model(poses, people), 9)


def install() -> dict[str, float]:
    """Measure the megabytes of a fresh environment with the base install, without pip and setuptools."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        python = Path(folder, "bin", "python")
        constraints = ROOT / "constraints.txt"
        subprocess.run([python, "-m", "pip", "install", "--quiet", "-c", constraints, ROOT], check=True)
        packages = next(Path(folder, "lib").glob("python*/site-packages"))
        tools = ("pip", "setuptools", "pkg_resources", "_distutils_hack", "distutils-precedence")
        installed = [entry for entry in packages.iterdir() if not entry.name.startswith(tools)]
        return {"base_install_mb": sum(size(entry) for entry in installed) / 1e6}


def size(entry: Path) -> int:
    """Return the bytes of a file or of all files in a folder."""
    if entry.is_file():
        return entry.stat().st_size
    return sum(os.lstat(Path(root, name)).st_size for root, _, names in os.walk(entry) for name in names)


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Return the median wall time of a call, after one call to warm up."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def print_table(figures: dict[str, float], baseline: dict[str, dict[str, Any]]) -> list[str]:
    """Print each figure next to its baseline; return the names of gated figures beyond their tolerance or limit."""
    worse = []
    print(f"{'figure':<26}{'now':>10}{'baseline':>10}{'limit':>8}")
    for name, value in figures.items():
        entry = baseline.get(name, {"value": None, "better": "lower", "gate": False})  # new figures only inform
        verdict = judge(value, entry)
        worse += [name] if verdict == "WORSE" else []
        base = "-" if entry["value"] is None else f"{entry['value']:.4g}"
        print(f"{name:<26}{value:>10.4g}{base:>10}{entry.get('limit', '-'):>8}  {verdict}")
    return worse


def judge(value: float, entry: dict[str, Any]) -> str:
    """Return `ok`, `WORSE` for a gated figure beyond its tolerance or limit, or `(informs)` without a gate."""
    sign = 1 if entry["better"] == "lower" else -1
    limit, base = entry.get("limit"), entry["value"]
    if limit is not None and sign * value > sign * limit:
        return "WORSE"
    if not entry["gate"] or base is None:
        return "(informs)" if limit is None else "ok"
    allowed = base * (1 + sign * entry["tolerance"])
    return "WORSE" if sign * value > sign * allowed else "ok"


def updated(baseline: dict[str, dict[str, Any]], figures: dict[str, float]) -> dict[str, dict[str, Any]]:
    """Return the baseline with the measured values."""
    return {name: {**entry, "value": figures.get(name, entry["value"])} for name, entry in baseline.items()}


if __name__ == "__main__":
    sys.exit(main())
