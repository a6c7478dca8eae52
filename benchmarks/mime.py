"""mime beside the other networks and beside plain skinning, in one run: preparing, a frame, and what it is made of.

    python benchmarks/mime.py [-o FILE]

The identity is the shipped body at 6,890 vertices and, each triangle in sixteen, at 110,210; the driving has 6,890.
Plain skinning is what a frame costs at least: every vertex moved by all joints, as the shipped body poses itself.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bench import seconds

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.core.geometry import edges
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.rig import Rig
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.evaluate.remesh import split_faces
from mimesh.io.atomic import whole_file
from mimesh.methods.find import find_method
from mimesh.motions import motion_clip, walk_motion

REPEATS = 5
FRAMES = 16
OTHERS = ("npt", "npt-maxpool", "aniformer")


def main() -> None:
    """Print the figures and keep them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    body = load_body()
    clip = motion_clip(body, sample_shape(body, 0, 0), walk_motion(body, 0, 0, seconds=1.0, fps=FRAMES))
    clip = Clip(clip.mesh, clip.vertices[:FRAMES], clip.fps)
    figures = {str(len(mesh.vertices)): ours(mesh, clip) for mesh in (body.mesh(), divided(divided(body.mesh())))}
    small = figures[str(len(body.vertices))]
    small |= {f"{name}_ms_a_frame": others(name, body.mesh(), clip) for name in OTHERS}
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), "seed": 0, **figures}
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def ours(identity: Mesh, clip: Clip) -> dict[str, float]:
    """Milliseconds to prepare for a pose and for a clip, of a frame and of its parts, and over plain skinning."""
    method = find_method("mime")
    frames = [vertices.astype(np.float64) for vertices in clip.vertices]
    pose, glimpses = Clip.still(Mesh(frames[0], clip.mesh.faces)), Clip(clip.mesh, clip.vertices, clip.fps)
    found = {
        "prepare_pose_ms": milliseconds(lambda: method.prepare(identity, pose)),
        "prepare_clip_ms": milliseconds(lambda: method.prepare(identity, glimpses)),
    }
    drive = method.prepare(identity, glimpses)
    track = drive.track(iter(frames), clip.fps)
    rig = drive.rig
    moves = np.concatenate([track.rotation @ rig.rotation.mT, track.places[..., None]], axis=-1)
    found |= {
        "frame_ms": milliseconds(lambda: list(drive(iter(frames)))) / FRAMES,
        "follow_ms": milliseconds(lambda: drive.track(iter(frames), clip.fps)) / FRAMES,
        "plain_skinning_ms": milliseconds(lambda: [plain(identity.vertices, rig, move) for move in moves]) / FRAMES,
    }
    found["frame_over_plain_skinning"] = found["frame_ms"] / found["plain_skinning_ms"]
    return {name: round(value, 3) for name, value in found.items()}


def plain(vertices: np.ndarray, rig: Rig, moves: np.ndarray) -> np.ndarray:
    """Linear blend skinning as it is written down: blend a matrix (3 x 4) for every vertex, then apply it."""
    blended = (rig.weights @ moves.reshape(len(moves), 12)).reshape(-1, 3, 4)
    return np.einsum("vkl,vl->vk", blended[..., :3], vertices) + blended[..., 3]


def others(name: str, identity: Mesh, clip: Clip) -> float:
    """Milliseconds a frame of another network, as `animate` runs it."""
    drive = find_method(name).prepare(identity, Clip(clip.mesh, clip.vertices, clip.fps))
    frames = [vertices.astype(np.float64) for vertices in clip.vertices]
    return round(milliseconds(lambda: list(drive(iter(frames))), 2) / FRAMES, 1)


def divided(mesh: Mesh) -> Mesh:
    """Each triangle in four."""
    pairs = edges(mesh.faces)
    middles = mesh.vertices[pairs].mean(axis=1)
    faces = split_faces(mesh.faces, pairs, len(mesh.vertices))
    return Mesh(np.concatenate([mesh.vertices, middles]), faces, name=mesh.name)


def milliseconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median wall time of a call, after one that warms up."""
    return 1e3 * seconds(work, repeats)


if __name__ == "__main__":
    main()
