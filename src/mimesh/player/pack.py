"""Packs meshes and clips for the browser: a dictionary of plain values that `json` writes and `web/player` shows.

The player's page and the studio's server both send what `pack_scene` gives; `web/player/scene.js` reads it and states
every field. Positions keep 16 bits, vertices their order, materials their base colours and textures.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.frame_buffer import each_frame
from ..core.mesh import Clip, Mesh
from ..render import camera
from .encoding import Quantization, coded_frames, packed
from .pictures import TextureStore
from .split_vertices import SplitMesh, split_vertices
from .thinning import DENSE, simplified, thinned, too_dense

ROLES = ("identity", "driving", "result", "truth", "mesh")
BUDGET = 24 * 2**20
"""Bytes that a page may have by default."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel: a clip, or a mesh as `Clip.still`."""

    role: str
    """One of ROLES. A result is measured against the identity and the truth, where they have its vertices."""
    clip: Clip
    name: str = ""
    """What the panel is called; the name of the mesh by default."""
    up: str = "y"
    front: str | None = None


def pack_scene(
    shown: Sequence[Panel],
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
    shown = [_lightened(panel, budget, left_out) for panel in shown]
    pictures, surfaces, owners = TextureStore(), [], []
    for panel in shown:
        owners.append(_surface_of(panel, owners, shown, surfaces, pictures))
    images = pictures.packed(budget // 3, left_out)
    room = budget - sum(_size(value) for value in (*surfaces, *images))
    clips, boxes = thinned([panel.clip for panel in shown], room, left_out)
    panels = [
        _panel(panel, clip, box, place, owner)
        for panel, clip, box, place, owner in zip(shown, clips, boxes, _places(shown), owners, strict=True)
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


def _panel(panel: Panel, clip: Clip, box: Quantization, place: dict[str, Any], owner: int) -> dict[str, Any]:
    """One panel; `clip` is what is left of its clip."""
    return {
        "role": panel.role,
        "name": panel.name or clip.mesh.name,
        "vertices": len(clip.mesh.vertices),
        "triangles": len(clip.mesh.faces),
        "frames": len(clip),
        "fps": clip.fps,
        "surface": owner,
        **place,
        "centre": [float(x) for x in box.centre.ravel()],
        "low": [float(x) for x in box.low],
        "unit": box.step,
        "stream": coded_frames(clip.vertices, box),
    }


def _lightened(panel: Panel, budget: int, left_out: list[str]) -> Panel:
    """A dense driving clip with fewer vertices, where it would take a share of the budget that is the result's."""
    if panel.role != "driving" or not too_dense(panel.clip, budget // 3):
        return panel
    left_out.append(f"the driving mesh is shown with {DENSE:,} of its {len(panel.clip.mesh.vertices):,} vertices")
    return dataclasses.replace(panel, clip=simplified(panel.clip, DENSE))


def _size(value: Any) -> int:
    """About how many letters of JSON a value takes: those of its long strings."""
    if isinstance(value, dict):
        return sum(_size(entry) for entry in value.values())
    if isinstance(value, list):
        return sum(_size(entry) for entry in value)
    return len(value) if isinstance(value, str) else 8


def _surface_of(
    panel: Panel, owners: list[int], shown: Sequence[Panel], surfaces: list[dict[str, Any]], pictures: TextureStore
) -> int:
    """The number of a panel's packed surface: that of a panel before it that is the same, or a new one.

    Files that are merely compared keep their own: one may have hard edges where the other has none.
    """
    mesh = panel.clip.mesh
    for owner, other in zip(owners, shown, strict=False):
        if mesh is other.clip.mesh or ("mesh" not in (panel.role, other.role) and _same_surface(mesh, other.clip.mesh)):
            return owner
    surfaces.append(_surface(mesh, split_vertices(mesh), pictures))
    return len(surfaces) - 1


def _same_surface(a: Mesh, b: Mesh) -> bool:
    """Whether one surface is enough for both: hard edges of a pose are those of the mesh that was posed."""
    same_looks = a.parts == b.parts and a.vertex_colors is b.vertex_colors and a.corner_uv is b.corner_uv
    same_normals = (a.corner_normals is None) == (b.corner_normals is None)
    same_faces = a.faces is b.faces or np.array_equal(a.faces, b.faces)
    return len(a.vertices) == len(b.vertices) and same_looks and same_normals and same_faces


def _surface(mesh: Mesh, split: SplitMesh, pictures: TextureStore) -> dict[str, Any]:
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


def _places(shown: Sequence[Panel]) -> list[dict[str, Any]]:
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
    for panel, size in zip(shown, sizes, strict=True):
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
