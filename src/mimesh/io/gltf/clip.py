"""Writes a clip as morph targets: the mesh is frame 0, and target k - 1 takes it to frame k at time k / fps.

One target for each frame after the first: its weight is 1 at its own key and 0 at all others, linear in between. At a
key one target is active, between two keys two, and the positions in between are linear between both frames. Clients may
limit the active targets (glTF 2.0, 3.7.2.2 Morph Targets, recommends support of eight attributes), which two never
reach. A client without morph targets shows frame 0.

Long clips may have a few blend shapes with weights over time instead: principal components of the differences from
frame 0. Of all ways to show T frames with K shapes and an exact frame 0, this has the least squared error. All are
active at once, and their default weights show frame 0. Weights lie in 0..1, because clients (Blender) clamp them to
that range; the shapes are therefore added to a base that is not itself a frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from ...core.errors import InputError, option
from ...core.frame_buffer import Progress, each_frame, release_pages
from ...core.geometry import normal_turner, unit_vectors
from ...core.mesh import Clip, Mesh
from .check import ARRAY_BUFFER
from .draft import Draft, Spool
from .edit import PrimitiveGroup

Deltas = dict[str, Float[np.ndarray, "N 3"]]
"""What a morph target adds to the attributes of one primitive group, by attribute name."""
BLOCK_BYTES = 32 * 2**20
"""Bytes of float64 differences, over all frames, that are in memory at once."""
MIN_RELATIVE_POWER = 1e-14
"""Eigenvalues below this fraction of the largest are rounding errors, and their components are dropped."""


@dataclass(frozen=True, eq=False)
class BlendShapes:
    """A base mesh and the weights of K shapes in every frame; the shapes follow from `frame_coefficients`."""

    base: Float[np.ndarray, "V 3"]
    """Positions without any shape."""
    weights: Float32[np.ndarray, "T K"]
    """Weights of the shapes in every frame, 0..1."""
    max_error: float
    """Largest distance of a vertex from its position in the clip, over all frames, in the mesh's unit."""

    def frame_coefficients(self) -> Float[np.ndarray, "K T"]:
        """Return the coefficients that mix the frames into shapes: shape k is the sum over t of [k, t] * frame t.

        Rows sum to 0, so they may be applied to differences from any base, and to any quantity that is linear in the
        vertices, such as positions in a node's frame.
        """
        weights = self.weights.astype(np.float64)
        coefficients = np.linalg.pinv(weights - weights[0])
        coefficients[:, 0] -= coefficients.sum(axis=1)
        return coefficients


def add_morph_animation(
    draft: Draft,
    groups: list[PrimitiveGroup],
    mesh: Mesh,
    clip: Clip,
    progress: Progress | None = None,
    blend: BlendShapes | None = None,
) -> None:
    """Add morph targets and an animation of their weights to a document that shows frame 0 of `clip`.

    Args:
        groups: the primitives of the document that show vertices of the mesh.
        mesh: the clip's, with corner normals.
        blend: shapes to write instead of one target a frame; the document then shows the base of these.

    Targets of all frames wait in a temporary file: memory does not grow with the number of frames.
    """
    if blend is None:
        # Target k - 1 has weight 1 at key k and 0 at all others; frame 0 has no target.
        first = np.asarray(clip.vertices[0], np.float64)
        deltas = _frame_deltas(groups, mesh, clip, first, progress)
        attributes = _one_target_per_frame(itertools.islice(deltas, 1, None), groups)
        count, kind = len(clip) - 1, "frame"
        weights = (np.eye(1, count, t - 1)[0] for t in range(len(clip)))
    else:
        deltas = _frame_deltas(groups, mesh, clip, blend.base, progress)
        attributes = _blend_targets(deltas, groups, blend.frame_coefficients())
        count, kind = blend.weights.shape[1], "shape"
        weights = iter(blend.weights)
    for group, spools in zip(groups, attributes, strict=True):
        targets = _add_targets(draft, spools)
        for primitive in group.primitives:
            primitive["targets"] = [dict(target) for target in targets]
    # A node appears once, although several groups may be primitives of its mesh.
    nodes = list(dict.fromkeys(group.node for group in groups))
    names = [f"{kind} {number}" for number in range(1, count + 1)]
    first = next(weights)
    for node in nodes:
        _complete_targets(draft, draft.gltf["meshes"][draft.gltf["nodes"][node]["mesh"]], names, first.tolist())
    weights = itertools.chain([first], weights)
    draft.gltf["animations"] = [_morph_animation(draft, nodes, clip, weights)]


def _frame_deltas(
    groups: list[PrimitiveGroup], mesh: Mesh, clip: Clip, base: Float[np.ndarray, "V 3"], progress: Progress | None
) -> Iterator[list[Deltas]]:
    """Yield for each frame the differences of its attributes from those of `base`, one entry a group.

    Attributes of the base are rounded to float32 first, as the file has them, so that rounding errors do not add up.
    """
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


def _blend_targets(
    frames: Iterable[list[Deltas]], groups: list[PrimitiveGroup], frame_coefficients: Float[np.ndarray, "K T"]
) -> list[dict[str, Spool]]:
    """Mix the deltas of all frames into K morph targets; returns a spool for each group and attribute."""
    sums: list[dict[str, np.ndarray]] = [{} for _ in groups]
    for frame, coefficients in zip(frames, frame_coefficients.T, strict=True):
        for deltas, totals in zip(frame, sums, strict=True):
            for name, values in deltas.items():
                shapes = totals.setdefault(name, np.zeros((len(coefficients), *values.shape)))
                for shape, coefficient in zip(shapes, coefficients, strict=True):
                    shape += coefficient * values
    spools: list[dict[str, Spool]] = [{} for _ in groups]
    for totals, spool in zip(sums, spools, strict=True):
        for name, shapes in totals.items():
            spool[name] = Spool()
            for shape in shapes:
                spool[name].append(shape)
    return spools


def _local_attributes(
    group: PrimitiveGroup, vertices: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "C 3"] | None
) -> Deltas:
    """Return positions and normals of a group's elements in the frame of its node, from world ones of the Mesh.

    Elements that no face uses get a zero normal, so that their delta is zero.
    """
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


def _complete_targets(draft: Draft, mesh: dict[str, Any], names: list[str], weights: list[float]) -> None:
    """Set the default weights and names of a mesh's targets, and add zero targets to its lines and points.

    All primitives of a mesh must have the same number of targets (glTF 2.0, 3.7.2.2). An accessor without a buffer view
    is all zeros (3.6.2.3 Sparse Accessors). Names in `extras.targetNames` are a convention of most tools.
    """
    for primitive in mesh["primitives"]:
        if "targets" not in primitive:
            count = draft.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
            zeros = {"componentType": 5126, "count": count, "type": "VEC3", "min": [0.0] * 3, "max": [0.0] * 3}
            primitive["targets"] = [{"POSITION": draft.add_accessor(zeros)}] * len(names)
    mesh["weights"] = weights
    if isinstance(mesh.setdefault("extras", {}), dict):
        mesh["extras"]["targetNames"] = names


def _morph_animation(
    draft: Draft, nodes: list[int], clip: Clip, weights: Iterable[Float[np.ndarray, " K"]]
) -> dict[str, Any]:
    """Return an animation of the morph weights with one key a frame; its channels share one sampler."""
    times = draft.add_floats(np.arange(len(clip))[:, None] / clip.fps, bounds=True)
    # The weights of all targets at one key lie next to each other (3.11 Animations). With one target a frame they are
    # as many as the square of the frames, 400 MB for 10,000, so they wait on disk, too.
    spool = Spool()
    for of_key in weights:
        spool.append(of_key[:, None])
    view = draft.add_view(spool)
    accessor = {"bufferView": view, "componentType": 5126, "count": spool.nbytes // 4, "type": "SCALAR"}
    values = draft.add_accessor(accessor)
    return {
        "name": clip.mesh.name,
        "samplers": [{"input": times, "interpolation": "LINEAR", "output": values}],
        "channels": [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in nodes],
    }


def fit_blend_shapes(clip: Clip, count: int, progress: Progress | None = None) -> BlendShapes:
    """Fit `count` shapes to a clip, or fewer where fewer are exact.

    With D (T, 3 V) the differences of all frames from frame 0, the best K shapes are the first right singular vectors
    of D. They are found from the eigenvectors of D D^T, which is only (T, T), so that D is read block by block.

    Raises:
        InputError: `count` is below 1, or the clip does not move.
    """
    if count < 1:
        raise InputError(f"{option('blendshapes')}: expected 1 or more, found {count}; try 30")
    frames = len(clip)
    gram = np.zeros((frames, frames))
    blocks = _vertex_blocks(clip)
    for done, block in enumerate(blocks):
        differences = _differences(clip, block)
        gram += differences @ differences.T
        _report_progress(progress, done, 2 * len(blocks))
    signed = _component_weights(gram, min(count, frames - 1))
    if not signed.size:
        raise InputError(
            f"{clip.mesh.name}: expected a clip that moves for {option('blendshapes')}, found none; leave it out"
        )
    # Shift and scale the weights to 0..1. The shift is made up for by the base: frame 0 plus `to_base` @ differences.
    low, extent = signed.min(axis=0), np.ptp(signed, axis=0)
    to_base, weights = low @ np.linalg.pinv(signed), ((signed - low) / extent).astype(np.float32)
    base = clip.vertices[0].astype(np.float64)
    coefficients = BlendShapes(base, weights, 0.0).frame_coefficients()
    max_error = 0.0
    # Second pass: the base, and the error that remains with the shapes rounded to float32 as in the file.
    for done, block in enumerate(blocks, len(blocks)):
        differences = _differences(clip, block)
        offset = to_base @ differences
        base[block] += offset.reshape(-1, 3)
        shapes = (coefficients @ differences).astype(np.float32)
        residual = (differences - offset - weights @ shapes).reshape(frames, -1, 3)
        max_error = max(max_error, float(np.linalg.norm(residual, axis=-1).max()))
        _report_progress(progress, done, 2 * len(blocks))
    return BlendShapes(base, weights, max_error)


def _component_weights(gram: Float[np.ndarray, "T T"], count: int) -> Float[np.ndarray, "T K"]:
    """Return the weights of the largest principal components in all frames, the largest first; those of frame 0 are 0.

    Row 0 of the Gram matrix is zero, and so is row 0 of every eigenvector of a positive eigenvalue.
    """
    from scipy.linalg import eigh

    if count < 1:
        return np.zeros((len(gram), 0))
    power, direction = eigh(gram, subset_by_index=[len(gram) - count, len(gram) - 1])
    kept = np.flatnonzero(power > MIN_RELATIVE_POWER * max(power[-1], np.finfo(float).tiny))[::-1]
    return direction[:, kept] * np.sqrt(power[kept])


def _vertex_blocks(clip: Clip) -> list[slice]:
    """Split the vertices into slices whose differences over all frames fit into BLOCK_BYTES."""
    step = max(BLOCK_BYTES // (24 * len(clip)), 1)
    return [slice(start, start + step) for start in range(0, clip.vertices.shape[1], step)]


def _differences(clip: Clip, block: slice) -> Float[np.ndarray, "T C"]:
    """Return the differences of every frame from frame 0 for some vertices, flattened to C = 3 * vertices."""
    points = clip.vertices[:, block].astype(np.float64)
    release_pages(clip.vertices)
    return (points - points[0]).reshape(len(points), -1)


def _report_progress(progress: Progress | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done + 1, total)
