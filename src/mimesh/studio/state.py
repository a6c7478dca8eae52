"""The desk as the page sees it: one JSON object for the panel, one packed scene for the stage."""

from __future__ import annotations

import dataclasses
from typing import Any

from ..bodies.characters import CHARACTERS
from ..core.mesh import Clip, Mesh
from ..core.normalization import AXES
from ..methods.find import MODELS, WITHOUT_FIT
from ..motions.clips import SEGMENTS
from ..pipeline.run import ROOTS
from ..player.pack import Panel, pack_scene
from . import operations
from .exports import Export, formats
from .session import Item, Session

STUDIO_MODELS = tuple(name for name in MODELS if name != "deformation-transfer")
"""Models that need nothing but the two meshes."""
SCENE_BUDGET = 256 * 2**20
"""Letters of a scene: it travels within this machine."""


def described(desk: Session) -> dict[str, Any]:
    """Everything the panel shows."""
    driving = desk.driving
    frames = len(driving.content) if driving and isinstance(driving.content, Clip) else 0
    return {
        "version": desk.version,
        "identities": [_mesh(desk, item) for item in list(desk.identities.values())],
        "driving": None if driving is None else _mesh(desk, driving),
        "options": vars(desk.options),
        "models": [{"name": name, "joints": has_joints(name, desk.jointed)} for name in desk.models],
        "roots": ROOTS,
        "axes": AXES,
        "motions": tuple(SEGMENTS),
        "characters": tuple(CHARACTERS),
        "formats": formats(frames != 1),
        "moving": frames != 1,
        "exports": [_export(export) for export in list(desk.exports.values())],
        "limit": desk.workplace.limit,
        "scene": scene_key(desk),
    }


def has_joints(model: str, others: tuple[str, ...]) -> bool:
    """Whether root, ground, smooth and skinned files can be asked of a model."""
    return model == "mime" or model in WITHOUT_FIT or model in others


def scene_key(desk: Session) -> str:
    """Changes when the stage has to be drawn anew."""
    parts = [f"{item.number}.{item.read}.{item.up}.{item.front}" for item in _shown_items(desk)]
    results = [item.outcome.shown for item in _shown_items(desk) if item.outcome is not None]
    return " ".join(map(str, (*parts, *results)))


def scene(desk: Session) -> dict[str, Any]:
    """What the stage shows, and the number of the mesh in each panel: one mesh beside what it imitates and its result.

    Of several meshes only the results, which stand as their meshes do until they are there.
    """
    key, driving = scene_key(desk), desk.driving
    meshes = [item for item in list(desk.identities.values()) if item.content is not None]
    shown = [(item, _at_rest(item)) for item in meshes]
    if driving is not None and driving.content is not None:
        before = shown if len(shown) == 1 else []
        shown = [*before, (driving, _driving(driving)), *((item, _result(item)) for item in meshes)]
    packed = pack_scene([panel for _, panel in shown], budget=SCENE_BUDGET) if shown else None
    return {"key": key, "numbers": [item.number for item, _ in shown], "scene": packed}


def _shown_items(desk: Session) -> list[Item]:
    items = [desk.driving, *desk.identities.values()]
    return [item for item in items if item is not None and item.content is not None]


def _at_rest(item: Item) -> Panel:
    assert isinstance(item.content, Mesh)
    return Panel("identity", Clip.still(item.content), item.name, item.facing["up"], item.facing["front"])


def _driving(item: Item) -> Panel:
    assert isinstance(item.content, Clip)
    return Panel("driving", item.content, item.name, item.facing["up"], item.facing["front"])


def _result(item: Item) -> Panel:
    """The result of now or, until it is there, of before; before the first the mesh itself stands for it."""
    result = item.outcome.result if item.outcome else None
    if result is None:
        return dataclasses.replace(_at_rest(item), role="result")
    used = result.report["identity"]
    return Panel("result", result.clip, item.name, used["up"], used["front"])


def _mesh(desk: Session, item: Item) -> dict[str, Any]:
    content = item.content
    mesh = content.mesh if isinstance(content, Clip) else content
    clip = content if isinstance(content, Clip) else None
    return {
        "number": item.number,
        "name": item.name,
        "shipped": item.path is None,
        "read": item.read,
        "state": "failed" if item.error else "reading" if mesh is None else "ready",
        "error": item.error,
        "vertices": 0 if mesh is None else len(mesh.vertices),
        "triangles": 0 if mesh is None else len(mesh.faces),
        "frames": 0 if clip is None else len(clip),
        "fps": 0 if clip is None else clip.fps,
        "given_fps": item.fps,
        "animations": item.animations,
        "animation": item.animation,
        "up": item.up,
        "front": item.front,
        "facing": item.facing,
        "outcome": _outcome(desk, item),
    }


def _outcome(desk: Session, item: Item) -> dict[str, Any] | None:
    outcome = item.outcome
    if outcome is None:
        return None
    state = "failed" if outcome.error else "done" if outcome.current else "stopped" if outcome.stopped else "moving"
    result = outcome.result if outcome.current else None
    folder = desk.workplace.folder
    return {
        "state": state,
        "version": outcome.version,
        "done": outcome.done,
        "error": outcome.error,
        "notes": [] if result is None else [operations.for_page(note, folder) for note in result.notes],
        "seconds": 0.0 if result is None else sum(result.seconds.values()),
        "model": "" if result is None else result.model,
        "joints": result is not None and result.skeleton is not None,
    }


def _export(export: Export) -> dict[str, Any]:
    return {
        "number": export.number,
        "suffix": export.suffix,
        "name": export.path.name if export.path else "",
        "bytes": export.path.stat().st_size if export.path and export.path.exists() else 0,
        "state": "failed" if export.error else "ready" if export.path else "writing",
        "done": export.done,
        "error": export.error,
        "notes": export.notes,
    }
