"""Limits the size of a page: drops frames of long clips, simplifies dense driving clips and very dense meshes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ..core.frame_buffer import each_frame, store_frames
from ..core.geometry import distinct_rows, weld
from ..core.mesh import Clip, Mesh, Part
from ..core.surface_clusters import clusters
from .encoding import Quantization, estimate_size, fit_quantization

DENSE_VERTICES = 20_000
"""A driving clip with more vertices is simplified to this number if it is too large."""
COMPARED_FRAMES = 3
"""Frames in which vertices must be equal to be compared in all others."""
MAX_STEP_RATIO = 8
"""Factor by which the frame step may grow between two estimates of the size, which are coarse."""
DECIMATED = 5
"""Largest ratio of vertices before and after decimation is about twice this; see `subset`."""


def drop_frames(
    clips: Sequence[Clip], budget: int, left_out: list[str], shown: tuple[int, int]
) -> tuple[list[Clip], list[Quantization], list[Int[np.ndarray, " V"] | None]]:
    """Keep every n-th frame of all clips, with an n for which they fit into `budget` characters, and quantize them.

    n grows in proportion to the excess, by one at least, until the estimate fits: one or two rounds as a rule. Frame
    rates are divided by n, so that durations stay. A message about it is appended to `left_out`.

    Args:
        shown: the clips have every n-th of so many frames.

    Returns:
        The clips with the vertices that move differently, their quantizations, and for each vertex of a mesh its index
        among these (None: all of them do).
    """
    longest, step = max(map(len, clips)), 1
    merged, indices = zip(*map(merge_equal_vertices, clips), strict=True)
    while True:
        thinned = [dataclasses.replace(clip, vertices=clip.vertices[::step], fps=clip.fps / step) for clip in merged]
        quantizations = [fit_quantization(clip.vertices) for clip in thinned]
        size = sum(estimate_size(clip.vertices, q) for clip, q in zip(thinned, quantizations, strict=True))
        if size <= budget or step >= longest:
            break
        step = min(longest, max(step + 1, int(step * min(size / max(budget, 1), MAX_STEP_RATIO))))
    every, frames = shown
    if step * every > 1:
        left_out.append(f"every {_ordinal(step * every)} of {frames:,} frames is shown, to keep this page small")
    return thinned, quantizations, list(indices)


def merge_equal_vertices(clip: Clip) -> tuple[Clip, Int[np.ndarray, " V"] | None]:
    """Keep one of the vertices that are at one position in every frame, as files have them at seams.

    Returns:
        The clip with fewer vertices and no faces, and for each vertex of the mesh its index among them; None where all
        are kept.
    """
    chosen = np.unique(np.linspace(0, len(clip) - 1, COMPARED_FRAMES).round().astype(int))
    first, index = distinct_rows([column for t in chosen for column in clip.vertices[t].T])
    apart = np.zeros(len(index), bool)
    for points in each_frame(clip.vertices):
        apart |= (points != points[first[index]]).any(axis=1)
    index[apart] = len(first) + np.arange(apart.sum())
    kept = np.concatenate([first, np.flatnonzero(apart)])
    if len(kept) == len(index):
        return clip, None
    order = np.argsort(kept)  # neighbours of the file stay neighbours, which compresses better
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    frames = (points[kept[order]] for points in each_frame(clip.vertices))
    dtype = clip.vertices.dtype
    vertices = store_frames(frames, len(clip), len(kept), dtype.type)
    points = Mesh(clip.mesh.vertices[kept[order]], name=clip.mesh.name)
    return dataclasses.replace(clip, mesh=points, vertices=vertices), place[index]


def simplify_clip(clip: Clip, count: int) -> Clip:
    """Reduce a clip to about `count` of its vertices, without materials; see `subset`."""
    chosen, faces = subset(np.asarray(clip.vertices[0], np.float64), clip.mesh.faces, count)
    vertices = _chosen_vertices(clip, chosen)
    mesh = Mesh(vertices[0].astype(np.float64), faces, name=clip.mesh.name)
    return dataclasses.replace(clip, mesh=mesh, vertices=vertices)


def simplify_surfaces(clips: Sequence[Clip], most: int, left_out: list[str]) -> list[Clip]:
    """Reduce every clip of more than `most` vertices to about `most`: surfaces as large as a scan's fill a page.

    Clips with the same faces (identity and result) keep the same vertices. Colours stay, textures do not: their seams
    are between vertices that are left out. A message about it is appended to `left_out`.
    """
    found: list[tuple[Mesh, Int[np.ndarray, " C"], Mesh]] = []
    simplified, messages = [], {}
    for clip in clips:
        mesh, count = clip.mesh, len(clip.mesh.vertices)
        if count <= most:
            simplified.append(clip)
            continue
        known = next((entry for entry in found if _same_faces(entry[0], mesh)), None)
        if known is None:
            chosen, faces = subset(np.asarray(clip.vertices[0], np.float64), mesh.faces, most)
            known = (mesh, chosen, _thin_mesh(mesh, chosen, faces))
            found.append(known)
        _, chosen, thin = known
        textured = any(part.material and part.material.texture for part in mesh.parts)
        without = ", without textures" if textured else ""
        messages[f"{len(chosen):,} of {count:,} vertices are shown, to keep this page small{without}"] = None
        vertices = _chosen_vertices(clip, chosen)
        thin = dataclasses.replace(thin, vertices=vertices[0].astype(np.float64), name=mesh.name)
        simplified.append(dataclasses.replace(clip, mesh=thin, vertices=vertices))
    left_out += messages
    return simplified


def subset(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int
) -> tuple[Int[np.ndarray, " C"], Int[np.ndarray, "G 3"]]:
    """Choose about `count` vertices of a surface, sorted, and faces between them; of a point cloud every n-th point.

    The surface is decimated, welded at its seams so that none opens; where no more triangles are left than that many
    positions have, it is welded alone. Decimation moves vertices, so each is replaced by the nearest vertex there was,
    whose positions are known in all frames. It takes more than linear time, so surfaces of more than DECIMATED times
    the number are reduced by clusters first.
    """
    import fast_simplification
    from scipy.spatial import KDTree

    if len(faces) == 0:
        return np.unique(np.linspace(0, len(points) - 1, count).round().astype(int)), np.zeros((0, 3), np.int64)
    kept = np.arange(len(points))
    if len(points) > 2 * DECIMATED * count:
        found = clusters(points, faces, DECIMATED * count)
        kept, faces, points = found.vertices, found.faces, points[found.vertices]
    welded, index = weld(points)
    first = np.full(len(welded), len(points))
    np.minimum.at(first, index, np.arange(len(points)))
    nearest, corners = first, index[faces]
    if len(faces) > 2 * count:
        decimated = fast_simplification.simplify(welded, corners.astype(np.int32), target_count=2 * count)
        nearest = first[np.asarray(KDTree(welded).query(np.asarray(decimated[0]))[1])]
        corners = np.asarray(decimated[1], np.int64)
    chosen, new_index = np.unique(nearest, return_inverse=True)
    corners = new_index[corners]
    distinct = (corners != np.roll(corners, 1, axis=1)).all(axis=1)  # not collapsed to an edge or a point
    return kept[chosen], corners[distinct]


def _chosen_vertices(clip: Clip, chosen: Int[np.ndarray, " C"]) -> Float[np.ndarray, "T C 3"]:
    frames = (points[chosen] for points in each_frame(clip.vertices))
    return store_frames(frames, len(clip), len(chosen), np.float32)


def _thin_mesh(mesh: Mesh, chosen: Int[np.ndarray, " C"], faces: Int[np.ndarray, "G 3"]) -> Mesh:
    """Return the mesh of chosen vertices with its colours; each new face is of the part of its first corner."""
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[chosen]
    thin = Mesh(mesh.vertices[chosen], faces, mesh.name, vertex_colors=colors, up=mesh.up)
    if not mesh.parts or len(faces) == 0:
        return thin
    part_of = np.zeros(len(mesh.vertices), np.int64)
    for number, part in enumerate(mesh.parts):
        part_of[mesh.faces[part.start : part.stop]] = number
    number = part_of[chosen][faces[:, 0]]
    stops = np.cumsum(np.bincount(number, minlength=len(mesh.parts)))
    parts = [
        Part(part.name, int(start), int(stop), part.material and dataclasses.replace(part.material, texture=None))
        for part, start, stop in zip(mesh.parts, [0, *stops], stops, strict=False)
        if stop > start
    ]
    return dataclasses.replace(thin, faces=faces[np.argsort(number, kind="stable")], parts=tuple(parts))


def _same_faces(a: Mesh, b: Mesh) -> bool:
    return len(a.vertices) == len(b.vertices) and (a.faces is b.faces or np.array_equal(a.faces, b.faces))


def _ordinal(number: int) -> str:
    """Format 2 as "2nd"."""
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
