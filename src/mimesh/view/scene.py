"""Packs meshes and clips for the browser: a dictionary of plain values that `json` writes and `web/player` shows.

`pack_scene` is what the player's page and the studio's server both send; `web/player/scene.js` reads it and states every
field. Positions keep 16 bits, vertices their order, materials their base colours and textures.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ..mesh import Clip, InputError, Mesh
from ..paging import each_frame
from . import camera
from .facets import Facets, facets
from .pictures import Pictures
from .stream import Box, boxed, coded_frames, cost, packed

ROLES = ("identity", "driving", "result", "truth", "mesh")
BUDGET = 24 * 2**20
"""Bytes that a page may have by default."""
DENSE = 20_000
"""Vertices from which on a driving clip is simplified, where the clips are too large for the budget."""


@dataclass(frozen=True, eq=False)
class Shown:
    """One panel: a clip, or a mesh as `Clip.still`."""

    role: str
    """One of ROLES. A result is measured against the identity and the truth, where they have its vertices."""
    clip: Clip
    name: str = ""
    """What the panel is called; the name of the mesh by default."""
    up: str = "y"
    front: str | None = None


def pack_scene(
    shown: Sequence[Shown],
    *,
    title: str = "",
    model: str = "",
    notes: Sequence[str] = (),
    budget: int = BUDGET,
) -> dict[str, Any]:
    """The panels, side by side in the order given, in about `budget` letters of JSON.

    Where that is too few, every n-th frame is kept, a dense driving clip is simplified, and large textures are made
    smaller; `left_out` says so in words. A single pose is never cut, so that the budget can be exceeded.

    Raises:
        InputError: no panel, or a role that is none.
    """
    if not shown:
        raise InputError("player: expected at least one mesh, found none; name a file")
    for panel in shown:
        if panel.role not in ROLES:
            raise InputError(f"player: expected a role of {', '.join(ROLES)}, found {panel.role}; choose one of them")
    left_out: list[str] = []
    pictures, surfaces, owners = Pictures(), [], []
    for panel in shown:
        owners.append(_surface_of(panel.clip.mesh, owners, shown, surfaces, pictures))
    images = pictures.packed(budget // 3, left_out)
    room = budget - sum(_size(value) for value in (*surfaces, *images))
    step, boxes = _thinned(shown, room, left_out)
    places = _places(shown, boxes)
    panels = [
        _panel(panel, box, step, place, owner)
        for panel, box, place, owner in zip(shown, boxes, places, owners, strict=True)
    ]
    return {
        "format": "mimesh-scene",
        "version": 1,
        "title": title,
        "model": model,
        "notes": list(notes),
        "left_out": left_out,
        "panels": panels,
        "surfaces": surfaces,
        "images": images,
        "download": None,
    }


def _panel(panel: Shown, box: Box, step: int, place: dict[str, Any], owner: int) -> dict[str, Any]:
    clip = panel.clip
    return {
        "role": panel.role,
        "name": panel.name or clip.mesh.name,
        "vertices": len(clip.mesh.vertices),
        "triangles": len(clip.mesh.faces),
        "frames": len(clip),
        "fps": clip.fps,
        "step": step if len(clip) > 1 else 1,
        "surface": owner,
        **place,
        "centre": [float(x) for x in box.centre.ravel()],
        "low": [float(x) for x in box.low],
        "unit": box.step,
        "stream": coded_frames(clip.vertices, box, step),
    }


def _size(value: Any) -> int:
    """About how many letters of JSON a value takes: those of its long strings."""
    if isinstance(value, dict):
        return sum(_size(entry) for entry in value.values())
    if isinstance(value, list):
        return sum(_size(entry) for entry in value)
    return len(value) if isinstance(value, str) else 8


def _thinned(shown: Sequence[Shown], room: int, left_out: list[str]) -> tuple[int, list[Box]]:
    """The fewest frames to skip so that all clips fit, and where the points of the frames left are."""
    longest = max(len(panel.clip) for panel in shown)
    step = 1
    while True:
        boxes = [boxed(panel.clip.vertices, step) for panel in shown]
        need = sum(cost(panel.clip.vertices, box, step) for panel, box in zip(shown, boxes, strict=True))
        if need <= room or step >= longest:
            break
        step = min(longest, max(step + 1, int(step * min(need / max(room, 1), 8.0))))
    if step > 1:
        left_out.append(f"every {_ordinal(step)} of {longest:,} frames is shown, to keep this page small")
    return step, boxes


def _surface_of(
    mesh: Mesh, owners: list[int], shown: Sequence[Shown], surfaces: list[dict[str, Any]], pictures: Pictures
) -> int:
    """The number of the packed surface of a mesh: that of a panel before it with the same faces and looks, or a new one."""
    for owner, other in zip(owners, shown, strict=False):
        if _same_surface(mesh, other.clip.mesh):
            return owner
    surfaces.append(_surface(mesh, facets(mesh), pictures))
    return len(surfaces) - 1


def _same_surface(a: Mesh, b: Mesh) -> bool:
    same_looks = a.parts == b.parts and a.vertex_colors is b.vertex_colors and a.corner_uv is b.corner_uv
    same_normals = (a.corner_normals is None) == (b.corner_normals is None)
    same_faces = a.faces is b.faces or np.array_equal(a.faces, b.faces)
    return len(a.vertices) == len(b.vertices) and same_looks and same_normals and same_faces


def _surface(mesh: Mesh, split: Facets, pictures: Pictures) -> dict[str, Any]:
    groups: list[dict[str, Any]] = []
    for part in mesh.parts:
        looks = None
        if part.material is not None:
            texture = part.material.texture if split.uv is not None else None
            looks = {"color": [float(x) for x in part.material.base_color], "image": pictures.number(texture)}
        if groups and groups[-1]["material"] == looks:
            groups[-1]["stop"] = part.stop
        else:
            groups.append({"start": part.start, "stop": part.stop, "material": looks})
    colors = None
    if mesh.vertex_colors is not None:
        colors = packed(np.rint(np.clip(mesh.vertex_colors, 0, 1) * 65535).astype(np.uint32))
    return {
        "corners": packed(split.corners),
        "origin": packed(split.origin),
        "smooth": packed(split.smooth),
        "uv": None if split.uv is None else packed(split.uv),
        "colors": colors,
        "groups": groups or [{"start": 0, "stop": len(mesh.faces), "material": None}],
    }


def _places(shown: Sequence[Shown], boxes: Sequence[Box]) -> list[dict[str, Any]]:
    """How each panel is turned, where it stands, and how large it is; what is moved and what moves it are made alike.

    `size` is the mean diagonal of a frame's bounding box. In one pose, result and driving have about the same share of
    it; the identity has the result's size, since it is the same body in the same unit.
    """
    sizes = [_diagonal(panel.clip) for panel in shown]
    roles = [panel.role for panel in shown]
    if "result" in roles:
        own = sizes[roles.index("result")]
        sizes = [own if role in ("identity", "truth") else size for role, size in zip(roles, sizes, strict=True)]
    places = []
    for panel, box, size in zip(shown, boxes, sizes, strict=True):
        turn = camera.axes(panel.up, panel.front)
        first = np.asarray(panel.clip.vertices[0], np.float64) @ turn.T
        low, high = first.min(axis=0), first.max(axis=0)
        stand = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]) @ turn
        places.append({"turn": [float(x) for x in turn.ravel()], "anchor": [float(x) for x in stand], "size": size})
    return places


def _diagonal(clip: Clip) -> float:
    chosen = np.unique(np.linspace(0, len(clip) - 1, 12).round().astype(int))
    frames = each_frame(clip.vertices[chosen])
    return float(np.mean([np.linalg.norm(np.ptp(points, axis=0)) for points in frames]))


def _ordinal(number: int) -> str:
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"


def simplified(clip: Clip, vertices: int) -> Clip:
    """The clip with about so many vertices: one decimation, of the first frame, replayed over all of them."""
    import fast_simplification

    mesh, points = clip.mesh, np.asarray(clip.vertices[0], np.float32)
    target = 1 - vertices / len(points)
    _, _, collapses = fast_simplification.simplify(points, mesh.faces.astype(np.int64), target, return_collapses=True)
    frames: list[Float[np.ndarray, "W 3"]] = []
    faces = mesh.faces
    for frame in each_frame(clip.vertices):
        replayed, faces, _ = fast_simplification.replay_simplification(
            frame.astype(np.float32), mesh.faces.astype(np.int64), collapses
        )
        frames.append(replayed)
    kept = Mesh(frames[0].astype(np.float64), np.asarray(faces, np.int64), name=mesh.name)
    return dataclasses.replace(clip, mesh=kept, vertices=np.stack(frames))
