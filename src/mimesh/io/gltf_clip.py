"""A clip as morph targets: the mesh is frame 0, and target k - 1 takes it to frame k at time k / fps.

One target for each frame after the first, its weight 1 at its own key and 0 at all others, linear in between: at a key
exactly one target is active, between two keys two, and what is shown there is the straight line between both frames.
Clients may limit how many targets act at once (glTF promises eight), which never touches this layout. Frame 0 is the
mesh itself, so that a client that ignores morph targets shows the beginning of the clip.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from ..geometry import normal_turner
from ..mesh import Clip, Mesh
from ..paging import Progress, each_frame
from .gltf_draft import VERTEX_DATA, Draft, Spool
from .gltf_primitives import Placed
from .gltf_scene import unit


def add_frames(draft: Draft, placed: list[Placed], mesh: Mesh, clip: Clip, progress: Progress | None = None) -> None:
    """Add the frames of `clip` to a document that shows its frame 0; `mesh` is the clip's, with corner normals.

    What goes into the file waits on disk: memory does not grow with the number of frames.
    """
    deltas = _frame_deltas(placed, mesh, clip, progress)
    for one, spools in zip(placed, deltas, strict=True):
        targets = _add_targets(draft, spools)
        for primitive in one.primitives:
            primitive["targets"] = [dict(target) for target in targets]
    nodes = list(dict.fromkeys(one.node for one in placed))
    for node in nodes:
        _complete_mesh(draft, draft.gltf["meshes"][draft.gltf["nodes"][node]["mesh"]], len(clip) - 1)
    draft.gltf["animations"] = [_animation(draft, nodes, clip)]


def _frame_deltas(placed: list[Placed], mesh: Mesh, clip: Clip, progress: Progress | None) -> list[dict[str, Spool]]:
    """For each placed group, what each frame after the first adds to the float32 attributes (N, 3) of frame 0."""
    turned = None
    if any(one.has_normals for one in placed):
        assert mesh.corner_normals is not None
        turned = normal_turner(mesh.corner_normals, mesh.faces, mesh.vertices)
    base: list[dict[str, np.ndarray]] = []
    deltas: list[dict[str, Spool]] = []
    for frame, vertices in enumerate(each_frame(clip.vertices, progress)):
        normals = turned(vertices).reshape(-1, 3) if turned else None
        for number, one in enumerate(placed):
            now = _local(one, vertices, normals)
            if frame == 0:
                base.append({name: values.astype(np.float32).astype(np.float64) for name, values in now.items()})
                deltas.append({name: Spool() for name in now})
            else:
                for name, values in now.items():
                    deltas[number][name].append(values - base[number][name])
    return deltas


def _local(
    one: Placed, vertices: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "C 3"] | None
) -> dict[str, Float[np.ndarray, "N 3"]]:
    """Positions and normals of a group's elements in the frame of its node; without a face the normal is constant."""
    linear, origin = one.T_world_local[:3, :3], one.T_world_local[:3, 3]
    local = {"POSITION": (vertices[one.vertex_of] - origin) @ np.linalg.inv(linear).T}
    if one.has_normals and normals is not None:
        local["NORMAL"] = np.where(one.corner_of[:, None] >= 0, unit(normals[one.corner_of] @ linear), 0.0)
    return local


def _add_targets(draft: Draft, deltas: dict[str, Spool]) -> list[dict[str, int]]:
    """One view for all frames of an attribute, one accessor for each frame."""
    targets: list[dict[str, int]] = [{} for _ in next(iter(deltas.values())).bounds]
    for name, frames in deltas.items():
        view = draft.add_view(frames, target=VERTEX_DATA, byteStride=12)
        size = frames.nbytes // max(len(frames.bounds), 1)
        for number, bounds in enumerate(frames.bounds):
            accessor: dict[str, Any] = {"bufferView": view, "byteOffset": number * size, "componentType": 5126}
            accessor |= {"count": size // 12, "type": "VEC3"} | (bounds if name == "POSITION" else {})
            targets[number][name] = draft.add_accessor(accessor)
    return targets


def _complete_mesh(draft: Draft, mesh: dict[str, Any], frames: int) -> None:
    """Weights and names for the targets, and targets that do nothing for the lines and points of the mesh.

    glTF wants one number of targets for all primitives of a mesh. An accessor without a view is all zeros.
    """
    for primitive in mesh["primitives"]:
        if "targets" not in primitive:
            count = draft.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
            zeros = {"componentType": 5126, "count": count, "type": "VEC3", "min": [0.0] * 3, "max": [0.0] * 3}
            primitive["targets"] = [{"POSITION": draft.add_accessor(zeros)}] * frames
    mesh["weights"] = [0.0] * frames
    if isinstance(mesh.setdefault("extras", {}), dict):
        mesh["extras"]["targetNames"] = [f"frame {number}" for number in range(1, frames + 1)]


def _animation(draft: Draft, nodes: list[int], clip: Clip) -> dict[str, Any]:
    times = draft.add_floats(np.arange(len(clip))[:, None] / clip.fps, bounds=True)
    weights = draft.add_floats(np.eye(len(clip), dtype=np.float32)[:, 1:].reshape(-1, 1))
    return {
        "name": clip.mesh.name,
        "samplers": [{"input": times, "interpolation": "LINEAR", "output": weights}],
        "channels": [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in nodes],
    }
