"""Time mime, the other networks and plain skinning in one run: preparation, a frame, and the parts of a frame.

    python benchmarks/mime.py [-o FILE]

The identity is the shipped body with 6,890 vertices, and with each triangle divided into sixteen (110,210 vertices);
the driving clip has 6,890. Plain skinning is the lower bound for a frame: linear blend skinning of every vertex by all
joints.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bench import seconds

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.core.geometry import edges
from mimesh.core.joint_tracks import JointTrack
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.rig import Rig
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.evaluate.remesh import split_faces
from mimesh.io.atomic import whole_file
from mimesh.methods.find import find_method, find_mime
from mimesh.motions import motion_clip
from mimesh.motions.procedural import walk_motion
from mimesh.rigs.retarget import Retarget

REPEATS = 5
"""Runs of each measurement, of which the median is taken."""
FRAMES = 16
OTHER_NETWORKS = ("npt", "npt-maxpool", "aniformer")


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    body = load_body()
    clip = motion_clip(body, sample_shape(body, 0, 0), walk_motion(body, 0, 0, seconds=1.0, fps=FRAMES))
    clip = Clip(clip.mesh, clip.vertices[:FRAMES], clip.fps)
    figures = {
        str(len(mesh.vertices)): mime_times(mesh, clip) for mesh in (body.mesh(), subdivide(subdivide(body.mesh())))
    }
    of_body = figures[str(len(body.vertices))]
    of_body |= {f"{name}_ms_a_frame": network_time(name, body.mesh(), clip) for name in OTHER_NETWORKS}
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), "seed": 0, **figures}
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def mime_times(identity: Mesh, clip: Clip) -> dict[str, float]:
    """Return milliseconds of the preparation for a pose and for a clip, of a frame and of its parts."""
    model = find_mime("mime")
    frames = [vertices.astype(np.float64) for vertices in clip.vertices]
    pose, keyframes = Clip.still(Mesh(frames[0], clip.mesh.faces)), Clip(clip.mesh, clip.vertices, clip.fps)
    times = {
        "prepare_pose_ms": milliseconds(lambda: (model.rig(identity), model.capture(pose))),
        "prepare_clip_ms": milliseconds(lambda: (model.rig(identity), model.capture(keyframes))),
    }
    retarget = Retarget.of(model.rig(identity), model.capture(keyframes))

    def follow() -> JointTrack:
        return retarget.motion.tracked(iter(frames), clip.fps, clip.mesh.name, retarget.driving_soles)

    track = follow()
    character = retarget.character
    rig = dataclasses.replace(character.rig, weights=character.rig.weights.take(character.group, axis=0))
    transforms = np.concatenate([track.rotation @ rig.rotation.mT, track.positions[..., None]], axis=-1)
    times |= {
        "frame_ms": milliseconds(lambda: [retarget.frame(t, frame) for t, frame in enumerate(frames)]) / FRAMES,
        "follow_ms": milliseconds(follow) / FRAMES,
        "plain_skinning_ms": milliseconds(
            lambda: [blend_skinning(identity.vertices, rig, frame) for frame in transforms]
        )
        / FRAMES,
    }
    times["frame_over_plain_skinning"] = times["frame_ms"] / times["plain_skinning_ms"]
    return {name: round(value, 3) for name, value in times.items()}


def blend_skinning(vertices: np.ndarray, rig: Rig, transforms: np.ndarray) -> np.ndarray:
    """Apply linear blend skinning by its definition: blend a matrix (3 x 4) for every vertex, then apply it."""
    blended = (rig.weights @ transforms.reshape(len(transforms), 12)).reshape(-1, 3, 4)
    return np.einsum("vkl,vl->vk", blended[..., :3], vertices) + blended[..., 3]


def network_time(name: str, identity: Mesh, clip: Clip) -> float:
    """Return milliseconds per frame of another network, as `animate` runs it."""
    drive = find_method(name).prepare(identity, Clip(clip.mesh, clip.vertices, clip.fps))
    frames = [vertices.astype(np.float64) for vertices in clip.vertices]
    return round(milliseconds(lambda: list(drive(iter(frames))), 2) / FRAMES, 1)


def subdivide(mesh: Mesh) -> Mesh:
    """Divide each triangle into four."""
    pairs = edges(mesh.faces)
    midpoints = mesh.vertices[pairs].mean(axis=1)
    faces = split_faces(mesh.faces, pairs, len(mesh.vertices))
    return Mesh(np.concatenate([mesh.vertices, midpoints]), faces, name=mesh.name)


def milliseconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median wall time of a call, after one call to warm up."""
    return 1e3 * seconds(work, repeats)


if __name__ == "__main__":
    main()
