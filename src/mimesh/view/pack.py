"""Packs meshes and clips for the browser: a dictionary of JSON values that `web/player` shows.

Both the player's page and the studio's server send the output of `pack_scene`; `web/player/scene.js` decodes it and
documents every field. Positions have 16 bits, vertices keep their order, materials their base colours and textures. The
size is limited: frames of long clips are dropped, dense driving clips and very dense meshes simplified.
"""

from __future__ import annotations

import dataclasses
import functools
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.frame_buffer import each_frame, store_frames
from ..core.geometry import component_labels, distinct_rows, weld
from ..core.mesh import Clip, Mesh, Part, cut_clip, stored_clip
from ..core.surface_clusters import clusters
from ..io.mtl import image_type
from . import camera
from .encoding import Quantization, encode_frames, estimate_size, fit_quantization, pack_array, to_base64
from .textures import creased_normals, decode_image

ROLES = ("identity", "driving", "result", "truth", "mesh")
"""What a panel can show; `mesh` is a file on its own."""
BUDGET = 24 * 2**20
"""Default size of a page in bytes."""
FRAME_CHARACTERS = 5
"""Characters of a vertex in a frame, a first estimate of the encoded size."""
VERTEX_CHARACTERS = 100
"""Characters of the budget for each vertex of a mesh, with its triangles and positions in all panels."""
DENSE_VERTICES = 20_000
"""A driving clip with more vertices is simplified to this number if it is too large."""
COMPARED_FRAMES = 3
"""Frames in which vertices must be equal to be compared in all others."""
MAX_STEP_RATIO = 8
"""Factor by which the frame step may grow between two estimates of the size, which are coarse."""
DECIMATED = 5
"""Largest ratio of vertices before and after decimation is about twice this; see `subset`."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel of the player: a clip, or a mesh as `Clip.still`."""

    role: str
    """One of ROLES. A result is compared with the identity and the truth if they have as many vertices."""
    clip: Clip
    name: str = ""
    """Caption of the panel; the name of the mesh by default."""
    up: str = "y"
    """Axis of the clip that points up: x, y, z, -x, -y or -z."""
    front: str | None = None
    """Axis of the clip that points to the front; see `camera.fit`."""
    every: int = 1
    """Of the whole clip `clip` has every n-th frame."""
    whole: int | None = None
    """Frames of the whole clip; None: `clip` has all."""

    @property
    def frames(self) -> int:
        """How many frames there are, shown or not."""
        return len(self.clip) if self.whole is None else self.whole

    def with_every(self, step: int) -> Panel:
        """Show every `step`-th frame of the whole clip; `step` is a multiple of the present one."""
        if step == self.every:
            return self
        clip = cut_clip(self.clip, 0, None, step // self.every)
        return dataclasses.replace(self, clip=clip, every=step, whole=self.frames)


@dataclass(frozen=True)
class MotionLimits:
    """What the motion of all panels may take; None: what is left of the budget."""

    frames: int | None = None
    """Largest number of frames of a clip."""
    characters: int | None = None
    """Largest size in characters of JSON, about."""
    vertices: int | None = None
    """Largest number of vertices of a mesh, about; denser ones are simplified."""
    driving_vertices: int = DENSE_VERTICES
    """Vertices to which a driving clip without materials is simplified if it takes a third of the characters."""


ANY_LENGTH = MotionLimits()


def pack_scene(
    panels: Sequence[Panel],
    *,
    title: str = "",
    model: str = "",
    notes: Sequence[str] = (),
    budget: int = BUDGET,
    motion: MotionLimits = ANY_LENGTH,
) -> dict[str, Any]:
    """Pack panels, side by side in the order given, in about `budget` characters of JSON.

    If that is too few, every n-th frame is kept, a dense driving clip is simplified, and large textures are reduced.
    Meshes with more vertices than a hundredth of the budget are simplified, too. `left_out` lists messages about that.

    Raises:
        InputError: no panel, or a role that is not one of ROLES.
    """
    if not panels:
        raise InputError("player: expected at least one mesh, found none; name a file")
    for panel in panels:
        if panel.role not in ROLES:
            raise InputError(f"player: expected a role of {', '.join(ROLES)}, found {panel.role}; choose one of them")
    left_out: list[str] = []
    whole = max(panel.frames for panel in panels)
    step = 1 if motion.frames is None else -(-whole // motion.frames)
    shown = [panel.with_every(max(step, panel.every)) for panel in panels]
    panels = [dataclasses.replace(panel, clip=stored_clip(panel.clip)) for panel in shown]
    panels = [_simplify_driving(panel, budget, motion, left_out) for panel in panels]
    most = budget // VERTEX_CHARACTERS
    most = most if motion.vertices is None else min(most, motion.vertices)
    thinned = simplify_surfaces([panel.clip for panel in panels], most, left_out)
    panels = [dataclasses.replace(panel, clip=clip) for panel, clip in zip(panels, thinned, strict=True)]
    # A third of the budget each for textures and for a dense driving clip; frames share what is left.
    textures, surfaces, surface_indices = TextureStore(), [], []
    for panel in panels:
        surface_indices.append(_surface_index(panel, surface_indices, panels, surfaces, textures))
    images = textures.pack(budget // 3, left_out)
    frame_budget = budget - sum(_json_size(value) for value in (*surfaces, *images))
    frame_budget = frame_budget if motion.characters is None else min(frame_budget, motion.characters)
    moving = drop_frames(
        [panel.clip for panel in panels], frame_budget, left_out, (max(panel.every for panel in panels), whole)
    )
    packed_panels = [
        _pack_panel(*fields) for fields in zip(panels, *moving, _placements(panels), surface_indices, strict=True)
    ]
    return {
        "format": "mimesh-scene",
        "version": 1,
        "title": title,
        "model": model,
        "notes": list(notes),
        "left_out": left_out,
        "panels": packed_panels,
        "surfaces": surfaces,
        "images": images,
        "download": None,
    }


def _pack_panel(
    panel: Panel,
    clip: Clip,
    quantization: Quantization,
    index: Int[np.ndarray, " V"] | None,
    placement: dict[str, Any],
    surface: int,
) -> dict[str, Any]:
    """Pack one panel; `clip` has the frames and vertices that are left, `index` one of these for each of the mesh."""
    return {
        "role": panel.role,
        "name": panel.name or panel.clip.mesh.name,
        "vertices": len(panel.clip.mesh.vertices),
        "triangles": len(panel.clip.mesh.faces),
        "frames": len(clip),
        "fps": clip.fps,
        "surface": surface,
        **placement,
        "centre": [float(x) for x in quantization.centre.ravel()],
        "low": [float(x) for x in quantization.low],
        "unit": quantization.step,
        "index": None if index is None else pack_array(index),
        "stream": encode_frames(clip.vertices, quantization),
    }


def _simplify_driving(panel: Panel, budget: int, motion: MotionLimits, left_out: list[str]) -> Panel:
    """Simplify a dense driving clip that would take more than a third of the budget; other panels are not changed.

    The limits of the motion apply to clips without materials only, because a simplified clip has none.
    """
    if panel.role != "driving":
        return panel
    plain = not any(part.material for part in panel.clip.mesh.parts)
    for characters, count in (
        (motion.characters if plain else None, motion.driving_vertices),
        (budget, DENSE_VERTICES),
    ):
        whole, faces = len(panel.clip.mesh.vertices), len(panel.clip.mesh.faces)
        dense = whole > count and faces > 0
        if characters is not None and dense and len(panel.clip) * whole * FRAME_CHARACTERS > characters // 3:
            left_out.append(f"the driving mesh is shown with {count:,} of its {whole:,} vertices")
            return dataclasses.replace(panel, clip=simplify_clip(panel.clip, count))
    return panel


def _json_size(value: Any) -> int:
    """Estimate the characters of JSON of a value: those of its strings, and 8 for any other value."""
    if isinstance(value, dict):
        return sum(_json_size(entry) for entry in value.values())
    if isinstance(value, list):
        return sum(_json_size(entry) for entry in value)
    return len(value) if isinstance(value, str) else 8


def _surface_index(
    panel: Panel, indices: list[int], panels: Sequence[Panel], surfaces: list[dict[str, Any]], textures: TextureStore
) -> int:
    """Return the index of a panel's packed surface: that of an earlier panel with the same surface, or of a new one.

    Files that are compared (role `mesh`) keep their own: one may have hard edges where the other has none.
    """
    mesh = panel.clip.mesh
    for index, other in zip(indices, panels, strict=False):
        if mesh is other.clip.mesh or ("mesh" not in (panel.role, other.role) and _same_surface(mesh, other.clip.mesh)):
            return index
    surfaces.append(_pack_surface(mesh, split_vertices(mesh), textures))
    return len(surfaces) - 1


def _same_surface(a: Mesh, b: Mesh) -> bool:
    """Whether two meshes can share a surface. Values of normals are not compared: posing a mesh rotates them."""
    same_materials = a.parts == b.parts and a.vertex_colors is b.vertex_colors and a.corner_uv is b.corner_uv
    same_normals = (a.corner_normals is None) == (b.corner_normals is None)
    return same_materials and same_normals and _same_faces(a, b)


def _pack_surface(mesh: Mesh, split: SplitMesh, textures: TextureStore) -> dict[str, Any]:
    """Pack what stays the same in all frames; successive parts with one material become one group of faces."""
    groups: list[dict[str, Any]] = []
    for part in mesh.parts:
        material = None
        if part.material is not None:
            texture = part.material.texture if split.uv is not None else None
            material = {"color": [float(x) for x in part.material.base_color], "image": textures.index(texture)}
        if groups and groups[-1]["material"] == material:
            groups[-1]["stop"] = part.stop
        else:
            groups.append({"start": part.start, "stop": part.stop, "material": material})
    colors = None
    if mesh.vertex_colors is not None:
        # 16 bits: linear colours in 8 would show steps in the dark.
        colors = pack_array(np.rint(np.clip(mesh.vertex_colors, 0, 1) * 65535).astype(np.uint32))
    return {
        "corners": pack_array(split.corners),
        "origin": pack_array(split.origin),
        "smooth": pack_array(split.smooth),
        "uv": None if split.uv is None else pack_array(split.uv),
        "colors": colors,
        "groups": groups or [{"start": 0, "stop": len(mesh.faces), "material": None}],
    }


def _placements(panels: Sequence[Panel]) -> list[dict[str, Any]]:
    """Compute each panel's rotation `turn` (to y up, z front), `anchor` (on the floor) and `size` (drawn as 1).

    `size` is the mean diagonal of a frame's bounding box. Result and driving have the same poses, so they are drawn
    equally large without any fitting; the identity gets the result's size, since it is the same body in the same unit.
    """
    sizes = [_mean_diagonal(panel.clip) for panel in panels]
    roles = [panel.role for panel in panels]
    if "result" in roles:
        result_size = sizes[roles.index("result")]
        sizes = [
            result_size if role in ("identity", "truth") else size for role, size in zip(roles, sizes, strict=True)
        ]
    placements = []
    for panel, size in zip(panels, sizes, strict=True):
        axes = camera.axes(panel.up, panel.front)
        first = np.asarray(panel.clip.vertices[0], np.float64) @ axes.T
        low, high = first.min(axis=0), first.max(axis=0)
        # The middle of the first frame's box on the floor, back in the coordinates of the file.
        anchor = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]) @ axes
        placements.append(
            {"turn": [float(x) for x in axes.ravel()], "anchor": [float(x) for x in anchor], "size": size}
        )
    return placements


def _mean_diagonal(clip: Clip) -> float:
    chosen = np.unique(np.linspace(0, len(clip) - 1, 12).round().astype(int))
    frames = each_frame(clip.vertices[chosen])
    return float(np.mean([np.linalg.norm(np.ptp(points, axis=0)) for points in frames]))


SMOOTH_COSINE = 0.98
"""Cosine between the corner normals of two faces at one end of an edge, above which the edge is smooth there."""


@dataclass(frozen=True, eq=False)
class SplitMesh:
    """A mesh with split vertices: R render vertices, in the order of the mesh's vertices."""

    corners: Int[np.ndarray, "F 3"]
    """Render vertex of each face corner."""
    origin: Int[np.ndarray, " R"]
    """Vertex of the mesh of each render vertex."""
    smooth: Int[np.ndarray, " R"]
    """Smoothing group: render vertices of one group share a normal, the sum of the normals of their faces."""
    uv: Float[np.ndarray, "R 2"] | None
    """Texture coordinates; None without a texture."""


def split_vertices(mesh: Mesh) -> SplitMesh:
    """Split the vertices of a mesh; a point cloud is not changed.

    Edges are hard where the file's corner normals differ, or, without any, where `textures.creased_normals` differ.
    Custom normals of a file are not kept: the player computes normals from the geometry of every frame.
    """
    count = len(mesh.vertices)
    if len(mesh.faces) == 0:
        return SplitMesh(np.zeros((0, 3), np.int64), np.arange(count), np.arange(count), None)
    normals = creased_normals(mesh.vertices, mesh.faces) if mesh.corner_normals is None else mesh.corner_normals
    group = smoothing_groups(mesh, normals).ravel()
    textured = mesh.corner_uv is not None and any(part.material and part.material.texture for part in mesh.parts)
    uv = np.ascontiguousarray(mesh.corner_uv, np.float32).reshape(-1, 2) if textured else None
    # A render vertex is a distinct combination of vertex, smoothing group and texture coordinates.
    key = _number_pairs(mesh.faces.ravel(), group)
    if uv is not None:
        # Two float32 are compared as one uint64, much faster than rows.
        key = _number_pairs(key, np.unique(uv.view(np.uint64).ravel(), return_inverse=True)[1])
    first, corners = np.unique(key, return_index=True, return_inverse=True)[1:]
    return SplitMesh(
        corners.reshape(-1, 3),
        mesh.faces.ravel()[first].astype(np.int64),
        np.unique(group[first], return_inverse=True)[1],
        None if uv is None else uv[first],
    )


def smoothing_groups(mesh: Mesh, normals: Float[np.ndarray, "F 3 3"]) -> Int[np.ndarray, "F 3"]:
    """Number the smoothing groups of corners: corners at one position that smooth edges connect, directly or not.

    An edge is smooth at an end if the normals of its two faces there have a cosine above SMOOTH_COSINE. Positions, not
    vertex indices, are compared, so that files with split vertices are smooth, too. Groups are the connected components
    of a graph of corners: half-edges are sorted by their end positions, which puts the two of an edge side by side.
    """
    position = weld(mesh.vertices)[1][mesh.faces]
    corner = np.arange(position.size).reshape(-1, 3)
    start, stop = position.ravel(), np.roll(position, -1, axis=1).ravel()
    start_corner, stop_corner = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    swapped = start > stop
    # Corners at the end with the smaller and with the larger position index, whichever way the half-edge runs.
    low, high = np.where(swapped, stop_corner, start_corner), np.where(swapped, start_corner, stop_corner)
    order = np.lexsort((np.maximum(start, stop), np.minimum(start, stop)))
    low, high = low[order], high[order]
    flat = position.ravel()
    # Successive half-edges of the same positions share the edge; an edge of three faces gives two pairs.
    same = (flat[low[1:]] == flat[low[:-1]]) & (flat[high[1:]] == flat[high[:-1]])
    a = np.concatenate([low[:-1][same], high[:-1][same]])
    b = np.concatenate([low[1:][same], high[1:][same]])
    flat_normals = normals.reshape(-1, 3)
    similar = np.einsum("nk,nk->n", flat_normals[a], flat_normals[b]) > SMOOTH_COSINE
    return component_labels(np.stack([a, b], axis=1)[similar], position.size).reshape(-1, 3)


def _number_pairs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Number the distinct pairs (first, second) in lexicographic order; return the number of each pair."""
    return np.unique(first.astype(np.int64) * (int(second.max()) + 1) + second, return_inverse=True)[1]


JPEG_QUALITY = 86
"""Of reduced textures, 1 to 95 (Pillow)."""
SMALLEST = 256
"""Pixels of a side below which textures are not reduced."""


class TextureStore:
    """Collects the textures of the panels, each once; damaged ones are left out and counted."""

    def __init__(self) -> None:
        self._contents: list[bytes] = []
        self._damaged: list[bytes] = []

    def index(self, content: bytes | None) -> int | None:
        """Add a texture, unless it is there, and return its index; None without a texture or if it is damaged."""
        if content is None or content in self._damaged:
            return None
        if content not in self._contents:
            if not _readable(content):
                self._damaged.append(content)
                return None
            self._contents.append(content)
        return self._contents.index(content)

    def pack(self, budget: int, left_out: list[str]) -> list[dict[str, Any]]:
        """Encode all textures in about `budget` characters.

        The largest is halved until all fit or none gets smaller; a message about that is appended to `left_out`.
        """
        contents = list(self._contents)
        if self._damaged:
            left_out.append(f"textures that cannot be read are left out: {len(self._damaged)}")
        # Base64 takes 4 characters for 3 bytes.
        while 4 / 3 * sum(map(len, contents)) > budget:
            largest = max(range(len(contents)), key=lambda k: len(contents[k]))
            smaller = _halve(contents[largest])
            if len(smaller) >= len(contents[largest]):
                break
            contents[largest] = smaller
        if contents != self._contents:
            left_out.append("textures are shown smaller than they are, to keep this page small")
        return [{"type": image_type(content) or "image/jpeg", "data": to_base64(content)} for content in contents]


@functools.lru_cache(maxsize=16)  # the studio packs the same textures for every result
def _readable(content: bytes) -> bool:
    return decode_image(content) is not None


def _halve(content: bytes) -> bytes:
    """Reduce a picture to half its width and height, as JPEG; the player draws no transparency."""
    image, written = decode_image(content), io.BytesIO()
    assert image is not None
    size = [max(side // 2, min(side, SMALLEST)) for side in image.size]
    image.resize((size[0], size[1])).save(written, "JPEG", quality=JPEG_QUALITY)
    return written.getvalue()


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
