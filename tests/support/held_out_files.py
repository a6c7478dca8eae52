"""Write generated motions with the names and formats of the held-out ones: a BVH file, and glTF files of joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gltf_samples import pack_glb
from motion_files import write_bvh
from scipy.spatial.transform import Rotation

from mimesh.evaluate.clip_protocols import ANIMATED, BOXING_FILE
from mimesh.evaluate.pairs import human
from mimesh.motions import Motion
from mimesh.motions.procedural import spline_motion

SHORT = "Running_A"
"""The one clip that is shorter than a second."""


def write_takes(folder: Path) -> Path:
    """Write the files of the held-out motions; the BVH file counts one frame too few, as the real one does."""
    folder.mkdir(parents=True, exist_ok=True)
    write_bvh(folder / BOXING_FILE, human(), spline_motion(human(), 7, 0, seconds=20.1, fps=10.0))
    text = (folder / BOXING_FILE).read_text()
    (folder / BOXING_FILE).write_text(text.replace("Frames: 201", "Frames: 200"))
    for k, (file, clips) in enumerate(ANIMATED.items()):
        seconds = [0.7 if clip == SHORT else 1.5 for clip in clips]
        motions = [spline_motion(human(), 8 + k, i, seconds=s, fps=30.0) for i, s in enumerate(seconds)]
        write_glb(folder / file, dict(zip(clips, motions, strict=True)))
    return folder


def write_glb(path: Path, motions: dict[str, Motion]) -> None:
    """Write motions of the shipped body as the animations of a file of joints, named as Blender names them."""
    body, data, accessors, views = human(), b"", [], []

    def accessor(values: np.ndarray, kind: str) -> int:
        nonlocal data
        content = np.asarray(values, "<f4")
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": content.nbytes})
        bounds = {"min": [float(content.min())], "max": [float(content.max())]} if kind == "SCALAR" else {}
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": len(content), "type": kind}
                         | bounds)  # fmt: skip
        data += content.tobytes()
        return len(accessors) - 1

    nodes = []
    for j, name in enumerate(body.joint_names):
        parent = body.parents[j]
        offset = body.joints[j] - (body.joints[parent] if parent >= 0 else 0)
        children = [k for k, above in enumerate(body.parents) if above == j]
        nodes.append({"name": name, "translation": offset.tolist()} | ({"children": children} if children else {}))
    animations = []
    for name, motion in motions.items():
        times = accessor(np.arange(len(motion)) / motion.fps, "SCALAR")
        tracks = [(0, "translation", "VEC3", body.joints[0] + motion.root)]
        for j in range(len(nodes)):
            tracks.append((j, "rotation", "VEC4", Rotation.from_matrix(motion.rotmat[:, j]).as_quat()))
        samplers = [{"input": times, "output": accessor(values, kind)} for _, _, kind, values in tracks]
        channels = [{"sampler": s, "target": {"node": j, "path": p}} for s, (j, p, _, _) in enumerate(tracks)]
        animations.append({"name": f"Rig|{name}", "samplers": samplers, "channels": channels})
    gltf = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "animations": animations,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    path.write_bytes(pack_glb(gltf, data))
