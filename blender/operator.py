# SPDX-License-Identifier: GPL-3.0-or-later
"""The two operators: read the scene, run mimesh, build the result, in steps between which the window responds.

From a script, `bpy.ops.mimesh.animate()` does the same without a window and returns when all is done. The settings are
in `scene.mimesh`.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING

import bpy
from bpy.types import Context, Event, Operator

from . import building, joints, own_armature, reading
from .bones import OwnArmature
from .job import Job

if TYPE_CHECKING:
    from mimesh import Clip, ClipResult

TICK = 0.05
"""Seconds between two checks of the job, and the longest time that a step blocks the window."""
READ_SHARE = 0.5
"""Share of the progress bar for reading the scene."""
Step = tuple[float, str]
"""Progress (0 to 1), and a description of the next step."""


def transfer(context: Context, frames: range, single_pose: bool) -> Generator[Step, None, tuple[str, ...]]:
    """Run a whole transfer with the scene's settings; yields steps and returns mimesh's notes.

    If the generator is closed half-way, the scene is not changed.
    """
    settings = context.scene.mimesh
    source = settings.identity
    identity, result = yield from _run(context, frames, settings.result == "OWN")
    yield 1.0, "mimesh: building the result"
    notes = tuple(note for note in result.notes if not (single_pose and "has one frame" in note))
    if isinstance(identity, OwnArmature):
        return notes + own_armature.build(context, identity, result, frames, single_pose)
    built = building.Transfer(source, identity, result, frames, single_pose)
    if settings.result == "ARMATURE":
        building.build_armature(context, built)
    else:
        building.build_shape_keys(context, built)
    return notes


def show_joints(context: Context, frame: int) -> Generator[Step, None, tuple[str, ...]]:
    """Find the joints of both objects in a frame and make empties for them; yields steps, returns no notes."""
    from mimesh import InputError

    if context.scene.mimesh.model != "mime":
        raise InputError(f"joints: expected the model mime, found {context.scene.mimesh.model}; choose it as the model")
    _, result = yield from _run(context, range(frame, frame + 1), own=False, with_bones=False)
    joints.show(context, result, frame)
    return ()


def _run(
    context: Context, frames: range, own: bool, with_bones: bool = True
) -> Generator[Step, None, tuple[reading.Identity | OwnArmature, ClipResult]]:
    """Read the scene and run mimesh with the settings and the joints that were moved; yields steps.

    Args:
        own: move the identity's own armature.
        with_bones: use the bones of a driving armature, unless its joints were moved.
    """
    from mimesh import Hints, InputError

    settings = context.scene.mimesh
    yield 0.0, "mimesh: reading the scene"
    with_joints = settings.model == "mime"
    hints = settings.hints() | (joints.corrections(context, frames) if with_joints else {})
    if own:
        if not with_joints:
            raise InputError(f"Own armature: expected the model mime, found {settings.model}; choose it as the model")
        joints.refuse_moved(context, "identity")
        identity = reading.read_own_armature(
            context, settings.identity, settings.identity_up, settings.front("identity"), settings.body
        )
        hints["rig"] = identity.rig
    else:
        identity = reading.read_identity(context, settings.identity)
    clip = yield from _read_driving(context, frames, with_bones and with_joints and "driving_joints" not in hints)
    if clip.mesh.up is not None:  # bones without a mesh move mimesh's body, whose axes are known
        hints |= {"driving_up": None, "driving_front": None}
    options = {"model": settings.model, "hints": Hints(**hints), "motion": settings.motion()}
    job = Job(identity.mesh, clip, options)
    job.start()
    try:
        while job.running:
            yield READ_SHARE + (1 - READ_SHARE) * job.fraction, "mimesh: moving the identity"
            job.wait(TICK)
    finally:
        job.cancel()
    return identity, job.result()


def _read_driving(context: Context, frames: range, with_bones: bool) -> Generator[Step, None, Clip]:
    """Read the driving object; yields a step per frame and returns the clip."""
    reader = reading.read_clip(context, context.scene.mimesh.driving, frames, with_bones)
    with contextlib.closing(reader):
        while True:
            try:
                done = next(reader)
            except StopIteration as end:
                return end.value
            yield READ_SHARE * done / len(frames), f"mimesh: reading frame {done} of {len(frames)}"


class _TransferOperator(Operator):
    """Base of the operators: the identity's armature or a copy of its mesh gets the pose or motion of the driving."""

    bl_options = frozenset({"UNDO"})

    @classmethod
    def poll(cls, context: Context) -> bool:
        settings = context.scene.mimesh
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave the edit or pose mode first")
            return False
        if settings.identity is None or settings.driving is None:
            cls.poll_message_set("Choose an identity and a driving object")
            return False
        return True

    def frames(self, context: Context) -> range:
        raise NotImplementedError

    def invoke(self, context: Context, event: Event) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        self._steps = self._work(context)
        manager = context.window_manager
        self._timer = manager.event_timer_add(TICK, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Context, event: Event) -> set[str]:
        if event.type == "ESC":
            self._end(context)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"}  # block other events, which could change the scene while it is read
        status: set[str] | None = {"CANCELLED"}
        try:
            status = self._advance(time.monotonic() + TICK, context)
        finally:
            if status is not None:
                self._end(context)
        return status or {"RUNNING_MODAL"}

    def execute(self, context: Context) -> set[str]:
        self._steps = self._work(context)
        status = self._advance(float("inf"), context)
        assert status is not None
        return status

    def cancel(self, context: Context) -> None:
        """Called when Blender itself ends the operator, for instance when it quits."""
        self._end(context)

    def _advance(self, until: float, context: Context) -> set[str] | None:
        """Run steps until a time of `time.monotonic`; return the operator's status, or None if steps are left."""
        from mimesh import InputError

        try:
            for fraction, text in self._steps:
                self._show(context, fraction, text)
                if time.monotonic() >= until:
                    return None
        except InputError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def _work(self, context: Context) -> Iterator[Step]:
        notes = yield from transfer(context, self.frames(context), self.single_pose)
        for note in notes:
            self.report({"WARNING"}, note)

    def _show(self, context: Context, fraction: float, text: str) -> None:
        if bpy.app.background or context.window is None:
            return
        progress = context.window_manager.mimesh
        progress.fraction, progress.text = fraction, text
        context.window_manager.progress_update(round(100 * fraction))
        context.workspace.status_text_set(f"{text}    Esc: cancel" if text else None)
        for area in context.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()

    def _end(self, context: Context) -> None:
        self._steps.close()
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        self._show(context, 0.0, "")


class MIMESH_OT_animate(_TransferOperator):
    """Make the identity move as the driving does: a copy of its mesh, or its own armature"""

    bl_idname = "mimesh.animate"
    bl_label = "Animate"
    single_pose = False

    def frames(self, context: Context) -> range:
        return context.scene.mimesh.frames(context.scene)


class MIMESH_OT_pose(_TransferOperator):
    """Give the identity the pose that the driving has now: a copy of its mesh, or its own armature"""

    bl_idname = "mimesh.pose"
    bl_label = "Pose"
    single_pose = True

    def frames(self, context: Context) -> range:
        return range(context.scene.frame_current, context.scene.frame_current + 1)


class MIMESH_OT_show_joints(_TransferOperator):
    """Show the joints that mime finds, as empties: move those that are wrong, then press Animate or Pose"""

    bl_idname = "mimesh.show_joints"
    bl_label = "Show joints"

    def _work(self, context: Context) -> Iterator[Step]:
        yield from show_joints(context, context.scene.frame_current)


class MIMESH_OT_clear_joints(Operator):
    """Remove the empties of all joints, and with them the corrections"""

    bl_idname = "mimesh.clear_joints"
    bl_label = "Clear"
    bl_options = frozenset({"UNDO"})

    def execute(self, context: Context) -> set[str]:
        joints.clear(context)
        return {"FINISHED"}
