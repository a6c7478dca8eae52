"""Writes a clip as morph targets: the mesh is frame 0, and target k - 1 takes it to frame k at time k / fps.

One target for each frame after the first: its weight is 1 at its own key and 0 at all others, linear in between. At a
key one target is active, between two keys two, and the positions in between are linear between both frames. Clients may
limit the active targets (glTF 2.0, 3.7.2.2 Morph Targets, recommends support of eight attributes), which two never
reach. A client without morph targets shows frame 0.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.frame_buffer import Progress, each_frame
from ...core.geometry import normal_turner, unit_vectors
from ...core.mesh import Clip, Mesh
from .check import ARRAY_BUFFER
from .draft import Draft, Spool
from .edit import PrimitiveGroup

Deltas = dict[str, Float[np.ndarray, "N 3"]]
"""What a morph target adds to the attributes of one primitive group, by attribute name."""


def add_morph_animation(
    draft: Draft, groups: list[PrimitiveGroup], mesh: Mesh, clip: Clip, progress: Progress | None = None
) -> None:
    """Add morph targets and an animation of their weights to a document that shows frame 0 of `clip`.

    Args:
        groups: the primitives of the document that show vertices of the mesh.
        mesh: the clip's, with corner normals.

    Targets of all frames wait in a temporary file: memory does not grow with the number of frames.
    """
    deltas = _frame_deltas(groups, mesh, clip, np.asarray(clip.vertices[0], np.float64), progress)
    attributes = _one_target_per_frame(itertools.islice(deltas, 1, None), groups)  # frame 0 has no target
    count = len(clip) - 1
    for group, spools in zip(groups, attributes, strict=True):
        targets = _add_targets(draft, spools)
        for primitive in group.primitives:
            primitive["targets"] = [dict(target) for target in targets]
    # A node appears once, although several groups may be primitives of its mesh.
    nodes = list(dict.fromkeys(group.node for group in groups))
    names = [f"frame {number}" for number in range(1, count + 1)]
    for node in nodes:
        _complete_targets(draft, draft.gltf["meshes"][draft.gltf["nodes"][node]["mesh"]], names)
    draft.gltf["animations"] = [_morph_animation(draft, nodes, clip)]


def _frame_deltas(
    groups: list[PrimitiveGroup], mesh: Mesh, clip: Clip, base: Float[np.ndarray, "V 3"], progress: Progress | None
) -> Iterator[list[Deltas]]:
    """Yield how the attributes of each frame differ from those of `base`, rounded to float32 as the file has them."""
    normals_of = None
    if any(group.has_normals for group in groups):
        assert mesh.corner_normals is not None
        normals_of = normal_turner(mesh.corner_normals, mesh.faces, mesh.vertices)

    def attributes_of(vertices: Float[np.ndarray, "V 3"]) -> list[Deltas]:
        normals = normals_of(vertices).reshape(-1, 3) if normals_of else None
        return [_local_attributes(group, vertices, normals) for group in groups]

    base_attributes = [
        {name: values.astype(np.float32) for name, values in attributes.items()} for attributes in attributes_of(base)
    ]
    for vertices in each_frame(clip.vertices, progress):
        yield [
            {name: values - of_base[name] for name, values in attributes.items()}
            for attributes, of_base in zip(attributes_of(vertices), base_attributes, strict=True)
        ]


def _one_target_per_frame(frames: Iterable[list[Deltas]], groups: list[PrimitiveGroup]) -> list[dict[str, Spool]]:
    """Store the deltas of each frame as one morph target; returns a spool for each group and attribute."""
    spools: list[dict[str, Spool]] = [{} for _ in groups]
    for frame in frames:
        for deltas, spool in zip(frame, spools, strict=True):
            for name, values in deltas.items():
                spool.setdefault(name, Spool()).append(values)
    return spools


def _local_attributes(
    group: PrimitiveGroup, vertices: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "C 3"] | None
) -> Deltas:
    """Return positions and normals of a group's elements in their node's frame; a normal without a face is zero."""
    linear, origin = group.T_world_local[:3, :3], group.T_world_local[:3, 3]
    local = {"POSITION": (vertices[group.vertex_of] - origin) @ np.linalg.inv(linear).T}
    if group.has_normals and normals is not None:
        local["NORMAL"] = np.where(group.corner_of[:, None] >= 0, unit_vectors(normals[group.corner_of] @ linear), 0.0)
    return local


def _add_targets(draft: Draft, spools: dict[str, Spool]) -> list[dict[str, int]]:
    """Add one buffer view for each attribute and one accessor for each morph target; returns the targets' JSON."""
    targets: list[dict[str, int]] = [{} for _ in next(iter(spools.values())).bounds]
    for name, spool in spools.items():
        view = draft.add_view(spool, target=ARRAY_BUFFER, byteStride=12)
        size = spool.nbytes // max(len(spool.bounds), 1)  # bytes of one target: 12 an element
        for number, bounds in enumerate(spool.bounds):
            accessor: dict[str, Any] = {"bufferView": view, "byteOffset": number * size, "componentType": 5126}
            accessor |= {"count": size // 12, "type": "VEC3"} | (bounds if name == "POSITION" else {})
            targets[number][name] = draft.add_accessor(accessor)
    return targets


def _complete_targets(draft: Draft, mesh: dict[str, Any], names: list[str]) -> None:
    """Set the default weights (none) and names of a mesh's targets, and add zero targets to its lines and points.

    All primitives of a mesh must have the same number of targets (glTF 2.0, 3.7.2.2). An accessor without a buffer view
    is all zeros (3.6.2.3 Sparse Accessors). Names in `extras.targetNames` are a convention of most tools.
    """
    for primitive in mesh["primitives"]:
        if "targets" not in primitive:
            count = draft.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
            zeros = {"componentType": 5126, "count": count, "type": "VEC3", "min": [0.0] * 3, "max": [0.0] * 3}
            primitive["targets"] = [{"POSITION": draft.add_accessor(zeros)}] * len(names)
    mesh["weights"] = [0.0] * len(names)
    if isinstance(mesh.setdefault("extras", {}), dict):
        mesh["extras"]["targetNames"] = names


def _morph_animation(draft: Draft, nodes: list[int], clip: Clip) -> dict[str, Any]:
    """Return an animation of the morph weights with one key a frame; its channels share one sampler."""
    times = draft.add_floats(np.arange(len(clip))[:, None] / clip.fps, bounds=True)
    # The weights of all targets at one key lie next to each other (3.11 Animations). They are as many as the square of
    # the frames, 400 MB for 10,000, so they wait on disk, too.
    spool = Spool()
    for t in range(len(clip)):  # target k - 1 has weight 1 at key k and 0 at all others
        spool.append(np.eye(1, len(clip) - 1, t - 1).T)
    view = draft.add_view(spool)
    accessor = {"bufferView": view, "componentType": 5126, "count": spool.nbytes // 4, "type": "SCALAR"}
    values = draft.add_accessor(accessor)
    return {
        "name": clip.mesh.name,
        "samplers": [{"input": times, "interpolation": "LINEAR", "output": values}],
        "channels": [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in nodes],
    }
