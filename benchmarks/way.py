"""Time the way from file to file, in seconds and in frames of `npt` at 6,890 vertices, all in one run.

Beside seconds on the clock there are those of processors, which count where other programs run, too.

    python benchmarks/way.py [-o FILE] [--repeats 7]

Measured are medians: `animate` of a character of 27,554 vertices by a BVH of 2,752 frames, with its rig and without;
`transfer` between two OBJ files of 6,890 vertices in a warm process, of which preparing, and from the shell; a frame of
`mime`. Files are read and written, previews are not made.
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
from pathlib import Path

import numpy as np
from mime import subdivide

import mimesh
from mimesh.bodies import RiggedBody, load_body
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.mesh import Clip, Mesh
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import save_bvh
from mimesh.io.atomic import whole_file
from mimesh.methods.find import find_method
from mimesh.motions.motion import cut_motion
from mimesh.motions.procedural import walk_motion

FRAMES, FPS = 2752, 120
"""Of the BVH: those of a capture of 23 seconds."""


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seconds, processor = measured(Path(folder), args.repeats)
    frames = {name: round(value / seconds["npt_frame"], 2) for name, value in seconds.items()}
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), "repeats": args.repeats}
    report |= {
        "seconds": {name: round(value, 4) for name, value in seconds.items()},
        "processor_seconds": {name: round(value, 4) for name, value in processor.items()},
        "npt_frames": frames,
    }
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def measured(folder: Path, repeats: int) -> tuple[dict[str, float], dict[str, float]]:
    """Return the median seconds of each way, on the clock and of processors."""
    body = load_body()
    meshes = [person(body, k) for k in range(2)]
    hero, files = folder / "hero.obj", [folder / f"{mesh.name}.obj" for mesh in meshes]
    mimesh.save_mesh(subdivide(body.mesh()), hero)
    rigged = mimesh.rig(hero).save(folder / "hero.glb")
    for mesh, file in zip(meshes, files, strict=True):
        mimesh.save_mesh(mesh, file)
    motion = walk_motion(body, 0, 0, seconds=FRAMES / FPS + 1, fps=FPS)
    capture = save_bvh(cut_motion(motion, slice(0, FRAMES)), body, folder / "walk.bvh")
    drive = find_method("npt").prepare(meshes[0], Clip.still(meshes[1]))
    shell = [sys.executable, "-m", "mimesh", "transfer", *map(str, files), "-o", str(folder / "shell.obj")]
    session = mimesh.prepare(meshes[0], meshes[1])
    prepared: list[float] = []

    def warm() -> None:
        result = mimesh.transfer(*files)
        prepared.append(result.seconds["prepare"])
        result.save(folder / "warm.obj")

    ways: dict[str, Callable[[], object]] = {
        "npt_frame": lambda: next(iter(drive([meshes[1].vertices]))),
        "animate_rigged": lambda: mimesh.animate(
            rigged, capture, motion=mimesh.MotionOptions(skinned=None)
        ).save_skinned(folder / "a.glb"),
        "animate_bare": lambda: mimesh.animate(hero, capture, motion=mimesh.MotionOptions(skinned=None)).save_skinned(
            folder / "b.glb"
        ),
        "transfer": warm,
        "transfer_shell": lambda: subprocess.run([*shell, "--no-preview", "--quiet"], check=True),
        "mime_frame": lambda: session.pose(meshes[1].vertices),
    }
    medians = {name: median(way, repeats) for name, way in ways.items()}
    seconds = {name: clock for name, (clock, _) in medians.items()} | {"prepare": statistics.median(prepared[1:])}
    return seconds, {name: processor for name, (_, processor) in medians.items()}


def person(body: RiggedBody, k: int) -> Mesh:
    """Make a person in a pose of Table 6."""
    vertices = body.posed(sample_shape(body, 0, k), rotvec_to_rotmat(sample_pose(body, 0, k)))
    return Mesh(np.asarray(vertices, np.float64), body.faces, name=f"person{k}")


def median(way: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Return the median times of a call on the clock and of processors, after one call to warm up."""
    way()
    clock, processor = [], []
    for _ in range(repeats):
        begin, begin_processor = time.perf_counter(), processor_time()
        way()
        clock.append(time.perf_counter() - begin)
        processor.append(processor_time() - begin_processor)
    return statistics.median(clock), statistics.median(processor)


def processor_time() -> float:
    """Return the seconds that processors have worked for this process and for its children that have ended."""
    children = os.times()
    return time.process_time() + children.children_user + children.children_system


if __name__ == "__main__":
    main()
