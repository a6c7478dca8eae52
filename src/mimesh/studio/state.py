"""A session as the page shows it: one JSON object for the side panel, one packed scene for the stage."""

from __future__ import annotations

import json
import threading
from typing import Any

from ..bodies.animals import ANIMALS
from ..bodies.characters import CHARACTERS
from ..bodies.engine_names import SCHEMES
from ..core.mesh import Clip, Mesh
from ..core.normalization import AXES, UNSURE
from ..core.options import Layout, MotionOptions, values_of
from ..methods.find import MODELS, REDUCED_MODELS
from ..motions.animal_clips import ANIMAL_MOTIONS
from ..motions.clips import SEGMENTS
from ..pipeline.result import ClipResult
from ..view.pack import Panel, pack_scene
from . import operations
from .exports import NEEDED, Export, formats
from .items import Item, preparation_inputs
from .session import Session

STUDIO_MODELS = tuple(name for name in MODELS if name != "deformation-transfer")
"""Models that need nothing but the two meshes."""
SCENE_BUDGET = 256 * 2**20
"""Size of a scene in bytes: large, since it is sent within one machine."""
SHOWN_RATE = 30.0
"""Frames a second that the stage shows, about, of clips with more: results and exports have all."""


def describe(session: Session) -> dict[str, Any]:
    """Describe everything that the side panel shows, as JSON values."""
    driving = session.driving
    frames = len(driving.content) if driving and isinstance(driving.content, Clip) else 0
    return {
        "version": session.version,
        "identities": [_describe_item(session, item) for item in list(session.identities.values())],
        "driving": None if driving is None else _describe_item(session, driving),
        "options": vars(session.options),
        "models": [
            {"name": name, "joints": has_joints(name, session.skinned_models), "bodies": name == "mime"}
            for name in session.models
        ],
        "roots": values_of(MotionOptions, "root"),
        "axes": AXES,
        "motions": tuple(SEGMENTS),
        "animal_motions": tuple(ANIMAL_MOTIONS),
        "characters": tuple(CHARACTERS),
        "animals": tuple(ANIMALS),
        "formats": {what: formats(what, frames != 1) for what in NEEDED},
        "moving": frames != 1,
        "bone_names": {name: scheme.program for name, scheme in SCHEMES.items()},
        "rests": values_of(Layout, "rest"),
        "exports": [_describe_export(session, export) for export in list(session.exports.values())],
        "limit": session.uploads.limit,
        "scene": scene_key(session),
    }


def has_joints(model: str, skinned_models: tuple[str, ...]) -> bool:
    """Whether a model has joints, and with them the options root, ground, smooth and skinned exports."""
    return model == "mime" or model in REDUCED_MODELS or model in skinned_models


def scene_key(session: Session) -> str:
    """Return a key that changes when the stage has to show another scene."""
    parts = [f"{item.number}.{item.read}.{item.up}.{item.front}" for item in _shown_items(session)]
    results = [item.outcome.result_version for item in _shown_items(session) if item.outcome is not None]
    return " ".join(map(str, (*parts, *results)))


def scene(session: Session) -> dict[str, Any]:
    """Pack what the stage shows, with its key and the number of the item in each panel.

    One mesh is shown with the driving clip and its result. Of several meshes, only the results are shown; until the
    first result is finished, a mesh is shown in its place.
    """
    key, driving = scene_key(session), session.driving
    identities = [item for item in list(session.identities.values()) if item.content is not None]
    panels = [(item, _panel(session, item, "identity")) for item in identities]
    if driving is not None and driving.content is not None:
        first = panels if len(panels) == 1 else []
        results = [(item, _result_panel(session, item)) for item in identities]
        panels = [*first, (driving, _panel(session, driving, "driving")), *results]
    fastest = max((panel.clip.fps for _, panel in panels if panel.frames > 1), default=SHOWN_RATE)
    step = max(1, int(fastest / SHOWN_RATE + 0.01))  # 59.94 is 60
    shown = [panel.with_every(step) for _, panel in panels]
    packed = pack_scene(shown, budget=SCENE_BUDGET) if panels else None
    return {"key": key, "numbers": [item.number for item, _ in panels], "scene": packed}


class KeptScene:
    """What the stage of a session shows, encoded, until it shows another scene: pages that are reloaded wait once."""

    def __init__(self, session: Session) -> None:
        self._session, self._lock = session, threading.Lock()
        self._key, self._content = "", b""

    def encoded(self) -> bytes:
        """Return `scene` as JSON; pages that ask at the same time wait for the same."""
        with self._lock:
            if not self._content or self._key != scene_key(self._session):
                self._content = b""
                packed = scene(self._session)
                self._content, self._key = json.dumps(packed, separators=(",", ":")).encode(), packed["key"]
            return self._content


def _shown_items(session: Session) -> list[Item]:
    items = [session.driving, *session.identities.values()]
    return [item for item in items if item is not None and item.content is not None]


def used_facing(session: Session, item: Item) -> dict[str, Any]:
    """Return the axes with which an item was moved or drove, as `Item.facing` has them; those detected before that.

    The detection knows people only: a model that finds animals takes other axes for these.
    """
    role = "driving" if item is session.driving else "identity"
    for moved in list(session.identities.values()) if role == "driving" else [item]:
        if moved.outcome is not None and moved.outcome.current and moved.outcome.result is not None:
            axes = moved.outcome.result.report[role]
            return {**item.facing, **axes, "unsure": axes["detected"] and axes["margin"] < UNSURE}
    return item.facing


def _panel(session: Session, item: Item, role: str) -> Panel:
    assert item.content is not None
    clip, facing = item.content, used_facing(session, item)
    return Panel(role, Clip.still(clip) if isinstance(clip, Mesh) else clip, item.name, facing["up"], facing["front"])


def _result_panel(session: Session, item: Item) -> Panel:
    """Return the panel of the current or else of the previous result; without any, the mesh itself."""
    result = item.outcome.result if item.outcome else None
    if result is None:
        return _panel(session, item, "result")
    axes = result.report["identity"]
    return Panel("result", result.clip, item.name, axes["up"], axes["front"])


def _describe_item(session: Session, item: Item) -> dict[str, Any]:
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
        "notes": [] if content is None else item.notes,
        "parts": item.parts,
        "part": item.part,
        "up": item.up,
        "front": item.front,
        "facing": used_facing(session, item),
        "joints": _describe_corrections(session, item),
        "outcome": _describe_outcome(session, item),
    }


def _describe_corrections(session: Session, item: Item) -> dict[str, Any]:
    """Describe the corrected joints of an item, with a key that changes when its joints have to be fetched again."""
    corrections, driving = item.corrections, session.driving
    joints = {} if corrections is None else corrections.positions
    inputs = () if driving is None else preparation_inputs(item, driving, session.options)
    return {
        "corrected": {name: [float(x) for x in position] for name, position in joints.items()},
        "error": item.corrections_error,
        "key": f"{hash(inputs):x}",
    }


def _describe_outcome(session: Session, item: Item) -> dict[str, Any] | None:
    outcome = item.outcome
    if outcome is None:
        return None
    state = "failed" if outcome.error else "done" if outcome.current else "stopped" if outcome.stopped else "moving"
    result = outcome.result if outcome.current else None
    folder = session.uploads.folder
    return {
        "state": state,
        "version": outcome.version,
        "done": outcome.progress,
        "error": outcome.error,
        "notes": [] if result is None else [operations.for_page(note, folder) for note in result.notes],
        "seconds": 0.0 if result is None else sum(result.seconds.values()),
        "model": "" if result is None else result.model,
        **({"body": "", "confidence": None} if result is None else _what_was_moved(result)),
        "joints": result is not None and (result.skeleton is not None or result.own is not None),
    }


def _what_was_moved(result: ClipResult) -> dict[str, Any]:
    """Tell what both meshes were taken for, and how sure the match of joints or marks is, where there was one."""
    report = result.report
    match = report.get("match") or report.get("reference")
    body = "copied" if report.get("copied") else "other" if match else report.get("body", "")
    return {"body": body, "confidence": None if match is None else match.get("confidence")}


def _describe_export(session: Session, export: Export) -> dict[str, Any]:
    return {
        "number": export.number,
        "suffix": export.order.suffix,
        "name": export.path.name if export.path else "",
        "bytes": export.path.stat().st_size if export.path and export.path.exists() else 0,
        "state": "failed" if export.error else "ready" if export.path else "writing",
        "done": export.progress,
        "error": export.error,
        "notes": [operations.for_page(note, session.uploads.folder) for note in export.notes],
    }
