"""Measure live sessions: time of a frame, memory over many frames, and what the frames given beforehand are good for.

    python scripts/measure_live.py [-o benchmarks/live.json] [--frames 10000] [--pairs 6]

`latency` and `memory` are of one stream: both meshes have 13,000 vertices, frames are float32, and linear algebra has
one thread. `prepared_with` has the mean vertex error against the known truth
in percent of the identity's height, both centred, by the number of frames that a session was prepared with; that of
`animate` for the same clip, with planted feet and without; and the mean speed of soles on the ground in heights a
second. Pairs are two random people with two seconds of a captured motion, and two random animals with a gait.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import mimesh
from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.core.mesh import Clip, Mesh
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io.atomic import whole_file
from mimesh.motions import Motion, load_motion, motion_clip, motion_names, resample, window
from mimesh.motions.gaits import GAITS, gait_motion
from mimesh.motions.procedural import walk_motion
from mimesh.pipeline.live import LiveSession

VERTICES = 13_000
RATE = 60.0
WARM_UP = 100
"""Frames before the measured ones."""
SHARES = (50, 90, 99, 100)
"""Percentiles; the last is the slowest frame."""
PREPARED = (1, 2, 4, 16)
"""Numbers of frames, evenly spread over the clip."""
PAIRS_MOST = 12
"""Pairs over which the shipped motions are spread."""
SEED = 0


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--frames", type=int, default=10_000, help="length of the stream")
    parser.add_argument("--pairs", type=int, default=6, help="people, and as many animals; 0 leaves this part out")
    args = parser.parse_args()
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), "seed": SEED}
    report |= {"vertices": VERTICES, "frames": args.frames, "prepared_frames": 16}
    report |= stream(args.frames)
    if args.pairs:
        report["pairs"] = args.pairs
        report["prepared_with"] = {
            body: means([errors(body, k) for k in range(args.pairs)]) for body in ("human", "quadruped")
        }
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def stream(frames: int) -> dict:
    """Pose a stream of frames; return milliseconds of a frame by percentile, and memory."""
    body = load_body()
    clip = motion_clip(body, sample_shape(body, SEED, 0), walk_motion(body, SEED, 0, seconds=4.0, fps=RATE))
    vertices, faces = dense(clip.vertices, body.faces)
    driving = Clip(Mesh(vertices[0].astype(np.float64), faces, name="walk"), vertices.astype(np.float32), RATE)
    identity = Mesh(*dense(body.mesh().vertices, body.faces), name="body")
    spread = np.linspace(0, len(driving) - 1, 16).round().astype(int)
    known = Clip(driving.mesh, driving.vertices[spread], RATE)
    started = time.perf_counter()
    session = mimesh.prepare(identity, known)
    prepared = time.perf_counter() - started
    pose_all(session, driving, WARM_UP)
    gc.collect()
    before = resident()
    times = pose_all(session, driving, frames)
    gc.collect()
    after = resident()
    return {
        "prepare_s": round(prepared, 2),
        "latency_ms": percentiles(times),
        "over_5_ms": int((times > 5.0).sum()),
        "memory_mib": {"start": before, "end": after},
    }


def dense(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Divide as many triangles into three as are needed for VERTICES vertices; works on frames, too."""
    split = faces[: VERTICES - vertices.shape[-2]]
    middle = vertices.shape[-2] + np.arange(len(split))
    a, b, c = split.T
    parts = np.stack([a, b, middle, b, c, middle, c, a, middle], axis=1).reshape(-1, 3)
    dense_vertices = np.concatenate([vertices, vertices[..., split, :].mean(axis=-2)], axis=-2)
    return dense_vertices, np.concatenate([parts, faces[len(split) :]])


def pose_all(session: LiveSession, driving: Clip, frames: int) -> np.ndarray:
    """Pose the frames of a clip over and over; return milliseconds of each."""
    times = np.empty(frames)
    for k in range(frames):
        vertices = driving.vertices[k % len(driving)]
        started = time.perf_counter()
        session.pose(vertices)
        times[k] = 1e3 * (time.perf_counter() - started)
    return times


def percentiles(times: np.ndarray) -> dict[str, float]:
    """Return the percentiles of SHARES, the last as the maximum."""
    values = np.percentile(times, SHARES)
    return {"max" if share == 100 else f"p{share}": round(float(v), 3) for share, v in zip(SHARES, values, strict=True)}


def resident() -> float:
    """Return the memory of this process in MiB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return round(pages * 4096 / 2**20, 1)


def human_motion(k: int) -> Motion:
    """Return two seconds of a shipped captured motion."""
    names = motion_names()
    motion = load_motion(names[k * len(names) // PAIRS_MOST % len(names)])
    return resample(window(motion, 0, 2.0), RATE)


def animal_motion(k: int) -> Motion:
    """Return two seconds of a gait."""
    return gait_motion(load_body("quadruped"), list(GAITS)[k % len(GAITS)], SEED, k, fps=RATE)


def errors(name: str, k: int) -> dict[str, float | None]:
    """Move one body of a pair by the other; return errors in percent of its height, and the speeds of its soles."""
    body, motion = load_body(name), (human_motion if name == "human" else animal_motion)(k)
    shapes = [sample_shape(body, SEED, 2 * k + role) for role in (0, 1)]
    truth, driving = (motion_clip(body, shape, motion) for shape in shapes)
    identity = body.mesh(body.shaped(shapes[0])[0])
    height = np.ptp(identity.vertices[:, 1])

    def error(frames: Iterable[np.ndarray]) -> float:
        each = [
            np.linalg.norm(centred(a) - centred(b), axis=1).mean() for a, b in zip(frames, truth.vertices, strict=True)
        ]
        return 100 * float(np.mean(each)) / height

    found: dict[str, float | None] = {}
    for count in PREPARED:
        spread = np.linspace(0, len(driving) - 1, count).round().astype(int)
        session = mimesh.prepare(
            identity, Clip(driving.mesh, driving.vertices[spread], RATE), hints=mimesh.Hints(body=name)
        )
        found[str(count)] = error(session.pose(vertices) for vertices in driving.vertices)
    whole, free = (
        mimesh.animate(identity, driving, hints=mimesh.Hints(body=name), motion=mimesh.MotionOptions(ground=ground))
        for ground in (True, False)
    )
    found |= {"animate": error(whole.clip.vertices), "animate_unplanted": error(free.clip.vertices)}
    for key, result in (("skate_animate", whole), ("skate_live", free)):
        found[key] = result.report.get("foot_skate")
    return found | {"skate_driving": whole.report.get("foot_skate_driving")}


def centred(vertices: np.ndarray) -> np.ndarray:
    """Move vertices so that their centroid is at the origin."""
    return vertices - vertices.mean(axis=0)


def means(of_pairs: list[dict[str, float | None]]) -> dict[str, float]:
    """Return the mean of each figure over the pairs that have it."""
    known = {key: [value for pair in of_pairs if (value := pair[key]) is not None] for key in of_pairs[0]}
    return {key: round(float(np.mean(values)), 3) for key, values in known.items() if values}


if __name__ == "__main__":
    main()
