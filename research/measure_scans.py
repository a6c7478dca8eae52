"""Measure captures of scans, each of its own triangles, beside those of the same frames of one mesh.

    python research/measure_scans.py POOL CLIPS [-o benchmarks/scans.json] [--characters 4] [--frames 40]

POOL is a pool of rigged characters; realistic ones of its split val follow each motion capture (.bvh) of the folder
CLIPS on their own rigs, 25 frames a second. As scans their frames are decimated to 25 to 60 % of the triangles, other
ones in each, with noise of 0.2 % of the height. Directions of upper and lower arms and legs are compared with those of
the rig.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import fast_simplification
import numpy as np
from jaxtyping import Float
from retargets import choose_characters, write_pool

import mimesh
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.character_pool import read_pool
from mimesh.commands.terminal import progress
from mimesh.core.geometry import turned
from mimesh.core.skinning import place_joints
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io import load_driving
from mimesh.io.atomic import whole_file
from mimesh.pipeline.capturing import CapturedClip

FPS, SEED = 25.0, 0
KEPT, NOISE = (0.25, 0.6), 0.002
"""Shares of the triangles that are kept, and standard deviation of the noise over the height."""
LIMBS = {"UpLeg": "Leg", "Leg": "Foot", "Arm": "ForeArm", "ForeArm": "Hand"}


def main() -> None:
    """Measure all clips and write the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path)
    parser.add_argument("clips", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/scans.json"))
    parser.add_argument("--characters", type=int, default=4)
    parser.add_argument("--frames", type=int, default=40)
    args = parser.parse_args()
    pool = tuple(c for c in read_pool(args.pool, "val").characters if c.meta.kind == "realistic")
    clips, rows = sorted(args.clips.glob("*.bvh")), []
    with tempfile.TemporaryDirectory() as folder, progress("clips", quiet=False) as advance:
        paths = write_pool(list(choose_characters(pool, args.characters)), Path(folder))
        pairs = [(name, path, clip) for name, path in paths.items() for clip in clips]
        for done, (name, path, clip) in enumerate(pairs):
            rows.append(
                {"identity": name, "clip": clip.name, **measure(path, clip, args.frames, Path(folder) / clip.stem)}
            )
            if advance is not None:
                advance(done + 1, len(pairs))
    report: dict[str, Any] = {"commit": commit(), "machine": machine(), "libraries": libraries(), "seed": SEED}
    figures = [key for key in rows[0] if isinstance(rows[0][key], float)]
    report["mean"] = {key: round(float(np.mean([row[key] for row in rows])), 3) for key in figures}
    with whole_file(args.output) as target:
        target.write_text(json.dumps(report | {"clips": rows}, indent=1) + "\n")
    print(json.dumps(report["mean"], indent=1))


def measure(character: Path, clip: Path, count: int, folder: Path) -> dict[str, Any]:
    """Capture the middle of a clip on a character, from one mesh and from scans."""
    total = len(load_driving(clip, fps=FPS))
    start = max(0, (total - count) // 2)
    motion = mimesh.MotionOptions(ground=False, contacts=False)
    frames = mimesh.FrameRange(start, start + count, fps=FPS)
    moved = mimesh.animate(character, clip, motion=motion, frames=frames)
    assert moved.skeleton is not None
    joints, names = moved.skeleton.joint_positions(), moved.skeleton.person
    assert names is not None
    truth = directions(joints, dict(names))
    vertices, rng = np.asarray(moved.clip.vertices), np.random.default_rng(SEED)
    height, faces = np.ptp(vertices[0, :, 1]), moved.clip.mesh.faces.astype(np.int32)
    folder.mkdir(exist_ok=True)
    for t, points in enumerate(vertices):
        points, triangles = fast_simplification.simplify(points, faces, 1 - rng.uniform(*KEPT))[:2]
        noisy = points + rng.normal(0, NOISE * height, points.shape)
        mimesh.save_mesh(mimesh.Mesh(noisy, triangles.astype(np.int64)), folder / f"{t:04d}.ply")
    plain = mimesh.Mesh(vertices[0].astype(float), moved.clip.mesh.faces)
    figures: dict[str, Any] = {"frames": len(vertices)}
    for label, source in (("tracked", mimesh.Clip(plain, vertices, FPS)), ("scans", folder)):
        begin = time.process_time()
        found = mimesh.capture(source, frames=mimesh.FrameRange(fps=FPS))
        figures[f"{label} processor seconds a frame"] = round((time.process_time() - begin) / len(vertices), 4)
        figures |= {f"{label} {key}": value for key, value in compared(found, truth, joints, height).items()}
    for path in folder.iterdir():
        path.unlink()
    return figures


def compared(
    found: CapturedClip, truth: Float[np.ndarray, "T 8 3"], joints: Float[np.ndarray, "T J 3"], height: float
) -> dict[str, float]:
    """Compare captured joints with those of a rig: degrees, and accelerations over the rig's."""
    bones = np.array([found.rest[j] - found.rest[parent] for j, parent in enumerate(found.parents) if parent >= 0])
    positions = place_joints(found.root, bones, found.rotation, found.parents)
    limbs = directions(positions, {name: j for j, name in enumerate(found.names)})
    # What is captured faces +z in its first frame, or as near to it as a turn by right angles takes it.
    quarters = [turned(limbs, quarter * np.pi / 2) for quarter in range(4)]
    angles = [np.degrees(np.arccos((of * truth).sum(axis=-1).clip(-1, 1))) for of in quarters]
    angle = min(angles, key=np.mean)
    speeding = [np.linalg.norm(np.diff(of, 2, axis=0), axis=-1).mean() for of in (limbs, truth)]
    return {
        "degrees": round(float(angle.mean()), 2),
        "degrees, median": round(float(np.median(angle)), 2),
        "degrees, 95 %": round(float(np.percentile(angle, 95)), 2),
        "acceleration": round(float(speeding[0] / speeding[1]), 3),
    }


def directions(joints: Float[np.ndarray, "T J 3"], index: dict[str, int]) -> Float[np.ndarray, "T 8 3"]:
    """Return the directions of upper and lower arms and legs."""
    ends = [(index[side + start], index[side + end]) for side in SIDES for start, end in LIMBS.items()]
    bones = np.stack([joints[:, end] - joints[:, start] for start, end in ends], axis=1)
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


if __name__ == "__main__":
    main()
