"""A clip as morph targets: the mesh is frame 0, and target k - 1 takes it to frame k at time k / fps.

One target for each frame after the first, its weight 1 at its own key and 0 at all others, linear in between: at a key
exactly one target is active, between two keys two, and what is shown there is the straight line between both frames.
Clients may limit how many targets act at once (glTF promises eight), which never touches this layout. Frame 0 is the
mesh itself, so that a client that ignores morph targets shows the beginning of the clip.

Long clips may have a few blend shapes instead (`blend_shapes`), all active at once, whose weights at rest show frame 0.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from ...core.frame_buffer import Progress, each_frame
from ...core.geometry import normal_turner, unit_vectors
from ...core.mesh import Clip, Mesh
from .blend_shapes import BlendShapes
from .draft import ARRAY_BUFFER, Draft, Spool
from .primitives import PrimitiveGroup


def add_morph_animation(
    draft: Draft,
    written: list[PrimitiveGroup],
    mesh: Mesh,
    clip: Clip,
    progress: Progress | None = None,
    blend: BlendShapes | None = None,
) -> None:
    """Add the frames of `clip` to a document that shows its frame 0 or, with `blend`, the base of that.

    `mesh` is the clip's, with corner normals. What goes into the file waits on disk: memory does not grow with the
    number of frames.
    """
    if blend is None:
        first = np.asarray(clip.vertices[0], np.float64)
        deltas = _frame_deltas(written, mesh, clip, first, progress)
        attributes = _one_target_per_frame(itertools.islice(deltas, 1, None), written)
        weights, kind = np.eye(len(clip), dtype=np.float32)[:, 1:], "frame"
    else:
        deltas = _frame_deltas(written, mesh, clip, blend.base, progress)
        attributes = _blend_targets(deltas, written, blend.frame_coefficients())
        weights, kind = blend.weights, "shape"
    for one, spools in zip(written, attributes, strict=True):
        targets = _add_targets(draft, spools)
        for primitive in one.primitives:
            primitive["targets"] = [dict(target) for target in targets]
    nodes = list(dict.fromkeys(one.node for one in written))
    names = [f"{kind} {number}" for number in range(1, weights.shape[1] + 1)]
    for node in nodes:
        _complete_targets(draft, draft.gltf["meshes"][draft.gltf["nodes"][node]["mesh"]], names, weights[0].tolist())
    draft.gltf["animations"] = [_morph_animation(draft, nodes, clip, weights)]


def _frame_deltas(
    written: list[PrimitiveGroup], mesh: Mesh, clip: Clip, base: Float[np.ndarray, "V 3"], progress: Progress | None
) -> Iterator[list[dict[str, Float[np.ndarray, "N 3"]]]]:
    """What each frame adds to the float32 attributes of the base, for each placed group."""
    turned = None
    if any(one.has_normals for one in written):
        assert mesh.corner_normals is not None
        turned = normal_turner(mesh.corner_normals, mesh.faces, mesh.vertices)

    def shown(vertices: Float[np.ndarray, "V 3"]) -> list[dict[str, Float[np.ndarray, "N 3"]]]:
        normals = turned(vertices).reshape(-1, 3) if turned else None
        return [_local_attributes(one, vertices, normals) for one in written]

    start = [{name: values.astype(np.float32) for name, values in group.items()} for group in shown(base)]
    for vertices in each_frame(clip.vertices, progress):
        yield [
            {name: values - before[name] for name, values in group.items()}
            for group, before in zip(shown(vertices), start, strict=True)
        ]


def _one_target_per_frame(
    deltas: Iterable[list[dict[str, Float[np.ndarray, "N 3"]]]], written: list[PrimitiveGroup]
) -> list[dict[str, Spool]]:
    """For each group and attribute, one target a frame."""
    spools: list[dict[str, Spool]] = [{} for _ in written]
    for groups in deltas:
        for group, spool in zip(groups, spools, strict=True):
            for name, values in group.items():
                spool.setdefault(name, Spool()).append(values)
    return spools


def _blend_targets(
    deltas: Iterable[list[dict[str, Float[np.ndarray, "N 3"]]]],
    written: list[PrimitiveGroup],
    frame_coefficients: Float[np.ndarray, "K T"],
) -> list[dict[str, Spool]]:
    """For each group and attribute, targets that are mixed from all frames."""
    sums: list[dict[str, np.ndarray]] = [{} for _ in written]
    for groups, share in zip(deltas, frame_coefficients.T, strict=True):
        for group, total in zip(groups, sums, strict=True):
            for name, values in group.items():
                mixed = total.setdefault(name, np.zeros((len(share), *values.shape)))
                for shape, part in zip(mixed, share, strict=True):
                    shape += part * values
    spools: list[dict[str, Spool]] = [{} for _ in written]
    for total, spool in zip(sums, spools, strict=True):
        for name, shapes in total.items():
            spool[name] = Spool()
            for shape in shapes:
                spool[name].append(shape)
    return spools


def _local_attributes(
    one: PrimitiveGroup, vertices: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "C 3"] | None
) -> dict[str, Float[np.ndarray, "N 3"]]:
    """Positions and normals of a group's elements in the frame of its node; without a face the normal is constant."""
    linear, origin = one.T_world_local[:3, :3], one.T_world_local[:3, 3]
    local = {"POSITION": (vertices[one.vertex_of] - origin) @ np.linalg.inv(linear).T}
    if one.has_normals and normals is not None:
        local["NORMAL"] = np.where(one.corner_of[:, None] >= 0, unit_vectors(normals[one.corner_of] @ linear), 0.0)
    return local


def _add_targets(draft: Draft, deltas: dict[str, Spool]) -> list[dict[str, int]]:
    """One view for all frames of an attribute, one accessor for each frame."""
    targets: list[dict[str, int]] = [{} for _ in next(iter(deltas.values())).bounds]
    for name, frames in deltas.items():
        view = draft.add_view(frames, target=ARRAY_BUFFER, byteStride=12)
        size = frames.nbytes // max(len(frames.bounds), 1)
        for number, bounds in enumerate(frames.bounds):
            accessor: dict[str, Any] = {"bufferView": view, "byteOffset": number * size, "componentType": 5126}
            accessor |= {"count": size // 12, "type": "VEC3"} | (bounds if name == "POSITION" else {})
            targets[number][name] = draft.add_accessor(accessor)
    return targets


def _complete_targets(draft: Draft, mesh: dict[str, Any], names: list[str], weights: list[float]) -> None:
    """Weights and names for the targets, and targets that do nothing for the lines and points of the mesh.

    glTF wants one number of targets for all primitives of a mesh. An accessor without a view is all zeros.
    """
    for primitive in mesh["primitives"]:
        if "targets" not in primitive:
            count = draft.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
            zeros = {"componentType": 5126, "count": count, "type": "VEC3", "min": [0.0] * 3, "max": [0.0] * 3}
            primitive["targets"] = [{"POSITION": draft.add_accessor(zeros)}] * len(names)
    mesh["weights"] = weights
    if isinstance(mesh.setdefault("extras", {}), dict):
        mesh["extras"]["targetNames"] = names


def _morph_animation(draft: Draft, nodes: list[int], clip: Clip, weights: Float32[np.ndarray, "T K"]) -> dict[str, Any]:
    times = draft.add_floats(np.arange(len(clip))[:, None] / clip.fps, bounds=True)
    values = draft.add_floats(weights.reshape(-1, 1))
    return {
        "name": clip.mesh.name,
        "samplers": [{"input": times, "interpolation": "LINEAR", "output": values}],
        "channels": [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in nodes],
    }
