"""What the studio's worker runs: read, prepare, pose and animate, with the same functions as `pipeline.animate`."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from ..bodies import load_body
from ..bodies.animals import ANIMALS, animal
from ..bodies.characters import character
from ..core.errors import InputError
from ..core.frame_buffer import LazyFrames, Progress
from ..core.joint_corrections import JointCorrections
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..core.options import Hints
from ..io import load_clip, load_mesh
from ..io.beside import confined
from ..io.gltf.animation import animation_names
from ..io.gltf.own_rig import GltfJoints
from ..io.joint_file import describe_corrections, load_corrections, side_file
from ..methods.find import find_mime, find_model
from ..mime.model import Mime
from ..motions.animal_clips import ANIMAL_MOTIONS, animal_clip
from ..pipeline.capturing import CapturedClip, capture
from ..pipeline.known import Corrections, Known, correctable_joints, driving_axes, shown_bones
from ..pipeline.look import OTHER
from ..pipeline.parts import PartRoute, named_parts
from ..pipeline.report import facing
from ..pipeline.result import ClipResult, Timer
from ..pipeline.rigging import RiggedMesh, rig
from ..pipeline.route import Route, find_route
from ..tools.demo import driving_clip
from ..tools.driving import animations_note
from .items import Item, Options


def read_mesh(path: Path, folder: Path | None) -> Mesh:
    """Read a mesh; files that an uploaded mesh refers to are read from its upload's folder only."""
    with _within(folder):
        return load_mesh(path)


def read_clip(path: Path, folder: Path | None, name: str, fps: float | None, animation: str | None) -> Clip:
    """Read a driving clip, as `read_mesh`; a mesh is a clip of one frame, and a folder gets the name `name`."""
    with _within(folder):
        clip = load_clip(path, fps=fps, animation=animation)
    return dataclasses.replace(clip, mesh=dataclasses.replace(clip.mesh, name=name)) if path.is_dir() else clip


def demo_mesh(name: str) -> Mesh:
    """Return a shipped character or animal, whose up axis is known."""
    return dataclasses.replace(animal(name), up="+y") if name in ANIMALS else character(name)


def demo_clip(motion: str) -> Clip:
    """Return the shipped person in a shipped motion, or a shipped animal in one of ANIMAL_MOTIONS."""
    if motion not in ANIMAL_MOTIONS:
        return driving_clip(load_body(), motion)
    clip = animal_clip(motion)
    return dataclasses.replace(clip, mesh=dataclasses.replace(clip.mesh, up="+y"))


def detect_facing(content: Mesh | Clip, axes: tuple[str | None, str | None]) -> dict[str, Any]:
    """Detect the axes of a mesh, or of a clip's first frame (see `report.facing`), and whether they are uncertain."""
    if isinstance(content, Clip):
        axes = driving_axes(content, *axes)
        content = dataclasses.replace(content.mesh, vertices=content.vertices[0].astype(np.float64))
    normalization = Normalization.fit(content, *axes)
    return {**facing(normalization), "unsure": normalization.unsure}


def animations(content: Mesh | Clip) -> tuple[str, ...]:
    """Return the names of the animations in a glTF file; none for other files."""
    if isinstance(content, Clip) and isinstance(content.skeleton, GltfJoints):
        return animation_names(content.skeleton.document)
    mesh = content.mesh if isinstance(content, Clip) else content
    return tuple(getattr(mesh.source, "animations", ()))


def notes(content: Mesh | Clip, item: Item) -> tuple[str, ...]:
    """Return notes on what was taken of a file, as `mimesh animate` has them."""
    if isinstance(content, Mesh) or item.path is None or item.animation is not None:
        return ()
    return animations_note(content, Path(item.name))


def parts(content: Mesh | Clip) -> tuple[str, ...]:
    """Return the names of the parts of a mesh, or of the mesh of a clip; none if it is one part."""
    mesh = content.mesh if isinstance(content, Clip) else content
    return tuple(named_parts(mesh)) if len(mesh.parts) > 1 else ()


def prepare_inputs(identity: Item, driving: Item, options: Options) -> Route | PartRoute:
    """Choose the way to move an identity by a driving clip, which have been read, without refinement."""
    assert isinstance(identity.content, Mesh)
    assert isinstance(driving.content, Clip)
    model = find_model(options.model)
    rig, body = options.kind(model)
    corrections = Corrections()
    if body != OTHER and isinstance(model, Mime):
        corrections = Corrections.read(identity.corrections, driving.corrections, driving.content)
    parts = identity.part, driving.part
    known = Known((*identity.axes, *driving.axes), rig, body, corrections, parts)
    return find_route(identity.content, driving.content, model, known, options.motion(model))


def compute_result(route: Route | PartRoute, clip: Clip, options: Options, progress: Progress) -> ClipResult:
    """Compute the whole clip, as `pipeline.animate` does, or the one pose, as `pipeline.transfer` does."""
    seconds, model = Timer(), find_model(options.model)
    dtype = np.float64 if len(clip) == 1 else np.float32
    moved = route.play(seconds, options.motion(model), lambda done, total: progress(done, 2 * total), dtype)
    # The page shows all frames: they are made here, where they can be stopped.
    frames = LazyFrames.stored(moved.frames.every(1, lambda done, total: progress(total + done, 2 * total)))
    shown = dataclasses.replace(moved, frames=frames)
    return shown.clip_result(route.identity, clip, model.name, seconds, moved.notes)


def rig_mesh(item: Item, options: Options) -> RiggedMesh:
    """Find the rig of a mesh, as `mimesh.rig` does."""
    if not isinstance(item.content, Mesh):
        raise _unread(item)
    return rig(item.content, options.model, hints=_hints(item, options))


def capture_driving(item: Item, options: Options, progress: Progress) -> CapturedClip:
    """Read the joints of the driving clip, as `mimesh.capture` does."""
    if not isinstance(item.content, Clip):
        raise _unread(item)
    hints = _hints(item, options)
    return capture(item.content, options.model, hints=hints, smooth=options.smooth, progress=progress)


def _hints(item: Item, options: Options) -> Hints:
    kind, body = options.kind(find_mime(options.model))
    return Hints(up=item.up, front=item.front, rig=kind, body=body, joints=item.corrections, part=item.part)


def _unread(item: Item) -> InputError:
    return InputError(f"{item.name}: expected a file that has been read, found none; wait for it, or see its message")


def _within(folder: Path | None) -> AbstractContextManager[None]:
    """Confine file references to a folder, None for no limit."""
    return contextlib.nullcontext() if folder is None else confined(folder)


def for_page(text: str, folder: Path) -> str:
    """Name files in a message as they were given, without the temporary folder."""
    return re.sub(rf"{re.escape(str(folder))}[/\\](uploads|exports)[/\\]\d+[/\\]?(files[/\\])?", "", text)


def read_side_file(path: Path | None) -> JointCorrections | None:
    """Read the corrections beside a mesh or clip; None if there are none."""
    if path is None or not side_file(path).is_file():
        return None
    corrections = load_corrections(side_file(path))
    return corrections if corrections.positions else None


def check_corrections(item: Item, corrections: JointCorrections) -> None:
    """Check corrections of a mesh, or of the driving clip in their frame."""
    if item.content is None:
        raise _unread(item)
    vertices = item.content.vertices
    if isinstance(item.content, Clip):
        if corrections.frame >= len(item.content):
            raise InputError(
                f"{corrections.source}: expected a frame of {item.name}, which has {len(item.content)} counted from "
                f"0, found {corrections.frame}; correct the joints again"
            )
        vertices = vertices[corrections.frame]
    # Whether a person or an animal is moved is known later: the method checks the names again.
    corrections.check(np.asarray(vertices, np.float64), correctable_joints(), item.name)


def parse_positions(item: Item, positions: Any) -> JointCorrections | None:
    """Make corrections from the positions that the page sends, in the frame of the earlier ones; None from none."""
    if not isinstance(positions, Mapping):
        raise InputError("joints: expected an object of positions, found something else; reload the page")
    frame = 0 if item.corrections is None else item.corrections.frame
    corrections = JointCorrections.of(positions, "joints", frame=frame)
    check_corrections(item, corrections)
    return corrections if corrections.positions else None


def describe_joints(route: Route | PartRoute, identity: Item, driving: Item) -> dict[str, Any]:
    """Return the joints found on both meshes as JSON values; empty if the model has none."""
    frame = 0 if driving.corrections is None else driving.corrections.frame
    found = route.joints(frame)
    if found is None:
        return {}
    shown = shown_bones(found.body)
    return {
        "parents": shown,
        "meshes": {
            str(item.number): {
                "frame": 0 if item is identity else frame,
                "joints": {name: [float(x) for x in joints[name]] for name in shown if name in joints},
            }
            for item, joints in ((identity, found.identity), (driving, found.driving))
        },
    }


def describe_file(item: Item) -> dict[str, Any]:
    """Return the contents of the side file with the corrections of an item."""
    corrections = item.corrections or JointCorrections()
    mesh = item.content.mesh if isinstance(item.content, Clip) else item.content
    if not isinstance(mesh, Mesh):
        return describe_corrections(JointCorrections(corrections.positions, corrections.frame, item.name))
    return describe_corrections(
        JointCorrections.found_on(mesh.vertices, corrections.positions, corrections.frame, item.name)
    )
