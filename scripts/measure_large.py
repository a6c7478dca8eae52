"""Measure large inputs: processor time by steps and peak memory, by the number of vertices and of frames.

    python scripts/measure_large.py [-o benchmarks/large.json] [--cases mime animate ...]
        [--vertices 100000 300000 1000000 3000000] [--frames 100 1000 10000]

Cases: `mime` moves an identity of many vertices by the shipped body in a frame of a shipped motion; `dense` moves it by
one with as many vertices, `copy` too, with that method; `animate` moves the shipped body by a long clip, `large-clip`
an identity of a million vertices by 100 frames; `parts` moves an identity of 500 objects, `morphs` one with 200 morph
targets. Identities are the shipped body, subdivided to exactly the wanted number of vertices.

Each case runs in a process of its own. Times are those of all its processor cores, so other programs do not count;
`moved` is the whole `transfer` or `animate` between reading and writing, with the steps in it beside it. `peak_mib` is
resident memory, `own_mib` the part that is not mapped from a file, which the system cannot reclaim. Figures that are
given with -o are added to those the file has. `exponents` are the slopes of log(time) over log(size), fitted; `growth`
has the exponent of the whole time in the vertices (`mime`) and in the frames (`animate`), the one between the two
largest sizes alone, where the part that does not depend on the size counts least, and by how much `own_mib` grew: pages
of frames that wait in files count as resident as long as nothing else needs the memory.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import mimesh
from mimesh.bodies import load_body
from mimesh.core.frame_buffer import store_frames
from mimesh.core.geometry import edges
from mimesh.core.mesh import Clip, Mesh, Part
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.evaluate.remesh import split_faces
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.io.atomic import whole_file
from mimesh.motions import load_motion, motion_clip
from mimesh.tools.preview import write_preview

MOTION, FRAME = "walk", 20
"""The shipped motion, and its frame that is the driving pose."""
CASES = ("mime", "dense", "copy", "animate", "large-clip", "parts", "morphs")
POLL_SECONDS = 0.02
"""Between two looks at the memory of a running case."""
LARGE, CLIP_FRAMES, PARTS, MORPHS = 1_000_000, 100, 500, 200
LINEAR, FLAT = 1.05, 0.1
"""Largest exponents of a time that is linear, and of a memory that is flat, in the size."""
GROWTH = {"mime": ("vertices", (100_000, 300_000, 1_000_000, 3_000_000)), "animate": ("frames", (100, 1000, 10_000))}
"""Cases of `growth` with what grows, and the sizes to measure."""
STEPS = {
    "choose_body": ("mimesh.pipeline.look", "agreed"),
    "find_joints": ("mimesh.pipeline.joint_route", "_found"),
    "report": ("mimesh.pipeline.placed", "surface_report"),
}
"""Steps inside of `transfer` and `animate`: module and function."""


def main() -> None:
    """Measure, print the figures, and write them to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--cases", nargs="+", default=CASES, choices=CASES)
    parser.add_argument("--vertices", nargs="+", type=int, default=GROWTH["mime"][1])
    parser.add_argument("--frames", nargs="+", type=int, default=GROWTH["animate"][1])
    parser.add_argument("--child", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        print(json.dumps(run_case(**json.loads(args.child))))
        return
    report = json.loads(args.output.read_text()) if args.output and args.output.exists() else {"cases": {}}
    for case in args.cases:
        sizes = {"animate": args.frames, "large-clip": [LARGE], "parts": [PARTS], "morphs": [MORPHS]}
        for size in sizes.get(case, args.vertices):
            figures = measure(case, size)
            report["cases"].setdefault(case, {})[str(size)] = figures
            print(f"{case:12}{size:9}  {json.dumps(figures)}", flush=True)
            report |= {"exponents": exponents(report["cases"]), "growth": growth(report["cases"])}
            if args.output:
                with whole_file(args.output) as temporary:
                    temporary.write_text(json.dumps(report, indent=2) + "\n")
    print(json.dumps({key: report.get(key) for key in ("exponents", "growth")}, indent=2))


def measure(case: str, size: int) -> dict[str, Any]:
    """Make the inputs of a case and run it, each in a process of its own; peak memory is in MiB."""
    with tempfile.TemporaryDirectory() as folder:
        result = child({"case": case, "size": size, "folder": folder, "make": True})[0]
        result, memory = child({"case": case, "size": size, "folder": folder, "make": False})
    return {**result, **memory, "commit": commit(), "machine": machine(), "libraries": libraries()}


def child(arguments: dict[str, Any]) -> tuple[dict[str, Any], dict[str, int]]:
    """Run this script with a case; return what it prints, and its peak resident and anonymous memory (MiB)."""
    command = [sys.executable, __file__, "--child", json.dumps(arguments)]
    reading, writing = os.pipe()
    process = os.posix_spawn(sys.executable, command, os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, writing, 1)])
    os.close(writing)
    own = 0
    while True:
        done, status, usage = os.wait4(process, os.WNOHANG)
        if done:
            break
        own = max(own, anonymous_memory(process))
        time.sleep(POLL_SECONDS)
    with os.fdopen(reading) as output:  # a line, which the pipe holds until here
        printed = output.read()
    if status:
        raise SystemExit(f"{arguments['case']} of {arguments['size']} failed")
    return json.loads(printed.splitlines()[-1]), {"peak_mib": usage.ru_maxrss // 1024, "own_mib": own}


def anonymous_memory(process: int) -> int:
    """Return the anonymous memory (MiB) of a running process (Linux)."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next((int(line.split()[1]) // 1024 for line in lines if line.startswith("RssAnon")), 0)


def run_case(case: str, size: int, folder: str, make: bool) -> dict[str, Any]:
    """Make the files of a case, or run it and return its seconds by step."""
    files = make_files if make else run
    return files(case, size, Path(folder))


def make_files(case: str, size: int, folder: Path) -> dict[str, Any]:
    """Write the identity and the driving of a case."""
    body = load_body()
    clip = motion_clip(body, None, load_motion(MOTION))
    count = {"animate": 0, "large-clip": LARGE, "parts": 0, "morphs": 0}.get(case, size)
    vertices, faces = subdivided(body.vertices.astype(np.float64), body.faces, count)
    identity = Mesh(vertices, faces, name="body")
    if case == "parts":
        stops = np.linspace(0, len(faces), size + 1).astype(int)
        parts = tuple(Part(f"part{k}", a, b) for k, (a, b) in enumerate(itertools.pairwise(stops)))
        save_mesh(Mesh(vertices, faces, "body", parts=parts), folder / "identity.obj")
    elif case == "morphs":
        save_clip(frames_of(clip.mesh, clip.vertices, size), folder / "identity.glb")  # frame k is morph target k
    else:
        save_mesh(identity, folder / "identity.ply")
    if case in ("animate", "large-clip"):
        save_clip(
            frames_of(clip.mesh, clip.vertices, size if case == "animate" else CLIP_FRAMES),
            folder / "driving.npz",
        )
    else:
        driving = subdivided(np.asarray(clip.vertices[FRAME], np.float64), body.faces, count * (case != "mime"))
        save_mesh(Mesh(*driving, name=MOTION), folder / "driving.ply")
    return {}


def subdivided(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Divide triangles into four at the middles of their edges, the last ones into three, up to `count` vertices."""
    while len(vertices) < count:
        pairs = edges(faces)
        if len(vertices) + len(pairs) <= count:
            faces = split_faces(faces, pairs, len(vertices))
            vertices = np.concatenate([vertices, vertices[pairs].mean(axis=1)])
            continue
        chosen = np.zeros(len(faces), bool)
        chosen[np.linspace(0, len(faces) - 1, min(count - len(vertices), len(faces))).astype(int)] = True
        middle = len(vertices) + np.arange(chosen.sum())
        a, b, c = faces[chosen].T
        parts = np.stack([a, b, middle, b, c, middle, c, a, middle], axis=1).reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[faces[chosen]].mean(axis=1)])
        faces = np.concatenate([parts, faces[~chosen]])
    return vertices, faces


def frames_of(mesh: Mesh, frames: np.ndarray, count: int) -> Clip:
    """Play frames forwards and backwards until there are `count`."""
    order = np.abs((np.arange(count) + len(frames) - 1) % (2 * len(frames) - 2) - (len(frames) - 1))
    vertices = store_frames((frames[k] for k in order), count, frames.shape[1], np.float32)
    return Clip(Mesh(vertices[0].astype(np.float64), mesh.faces, name=MOTION), vertices, 30.0)


def run(case: str, size: int, folder: Path) -> dict[str, Any]:
    """Do what `mimesh transfer` or `animate` does; return seconds of processor time by step."""
    seconds: dict[str, float] = {}
    identity_path = next(folder.glob("identity.*"))
    moving = case in ("animate", "large-clip")
    with ExitStack() as stack:
        for name, (module, function) in STEPS.items():
            stack.enter_context(timed_function(seconds, name, module, function))
        with timed(seconds, "read"):
            identity = load_mesh(identity_path)
            driving = load_clip(folder / "driving.npz") if moving else load_mesh(folder / "driving.ply")
        with timed(seconds, "moved"):
            if isinstance(driving, Clip):
                result = mimesh.animate(identity, driving, motion=mimesh.MotionOptions(skinned=None))
                save = result.save_skinned
            else:
                result = mimesh.transfer(identity, driving, "copy" if case == "copy" else "mime")
                save = result.save
    output = folder / ("result.glb" if moving or case == "morphs" else f"result{identity_path.suffix}")
    with timed(seconds, "write"):
        save(output)
    with timed(seconds, "preview"):
        _, (page,), _ = write_preview(result, output)
    total = sum(seconds[step] for step in ("read", "moved", "write", "preview"))
    figures: dict[str, Any] = {name: round(value, 2) for name, value in seconds.items()}
    start = sum(resource.getrusage(resource.RUSAGE_SELF)[:2]) - total
    sizes = {"vertices": len(identity.vertices), "frames": size if case == "animate" else CLIP_FRAMES if moving else 1}
    return {
        **sizes,
        "seconds": {"start": round(start, 2), **figures, "all": round(total, 2)},
        "page_mib": round(page.stat().st_size / 2**20, 2),
    }


@contextmanager
def timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Add the processor time of the block to that of a step."""
    begin = time.process_time()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.process_time() - begin


@contextmanager
def timed_function(seconds: dict[str, float], name: str, module: str, function: str) -> Iterator[None]:
    """Add the processor time of all calls of a function to that of a step."""
    original: Callable = getattr(sys.modules[module], function)

    def call(*args: Any, **options: Any) -> Any:
        with timed(seconds, name):
            return original(*args, **options)

    with patch(f"{module}.{function}", call):
        yield


def exponents(cases: dict[str, dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Fit the slope of log(time) over log(size) for every step of the cases with several sizes; of memory, too."""
    fitted = {}
    for case, by_size in cases.items():
        sizes = sorted(map(int, by_size))
        if len(sizes) < 2:
            continue
        rows = [by_size[str(size)] for size in sizes]
        values = {name: [row["seconds"].get(name, 0.0) for row in rows] for name in rows[0]["seconds"]}
        values |= {name: [row.get(name, 0) for row in rows] for name in ("peak_mib", "own_mib")}
        fitted[case] = {name: slope(sizes, of_step) for name, of_step in values.items() if min(of_step) > 0}
    return fitted


def growth(cases: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return for the cases of GROWTH how time and memory grow, and what of the sizes has not been measured."""
    found = {}
    for case, (what, wanted) in GROWTH.items():
        sizes = sorted(map(int, cases.get(case, {})))
        if len(sizes) < 2:
            continue
        rows = [cases[case][str(size)] for size in sizes]
        seconds, memory = [row["seconds"]["all"] for row in rows], [row["own_mib"] for row in rows]
        exponent, last, of_memory = slope(sizes, seconds), slope(sizes[-2:], seconds[-2:]), slope(sizes, memory)
        found[case] = {
            "in": what,
            "sizes": sizes,
            "missing": [size for size in wanted if size not in sizes],
            "exponent": exponent,
            "exponent_largest": last,
            "linear": max(exponent, last) <= LINEAR,
            "memory_exponent": of_memory,
            "memory_flat": of_memory <= FLAT,
        }
    return found


def slope(sizes: Sequence[int], values: Sequence[float]) -> float:
    """Fit the slope of log(value) over log(size)."""
    return round(float(np.polyfit(np.log(sizes), np.log(values), 1)[0]), 3)


if __name__ == "__main__":
    main()
