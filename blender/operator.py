# SPDX-License-Identifier: GPL-3.0-or-later
"""The two buttons: read the scene, let mimesh work, build the result; in steps between which the window lives.

From a script, `bpy.ops.mimesh.animate()` does the same without a window and comes back when all is done; what it works
on is in `scene.mimesh`.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING

import bpy
from bpy.types import Context, Event, Operator

from . import building, reading
from .job import Job, spoken

if TYPE_CHECKING:
    from mimesh import Clip

TICK = 0.05
"""Seconds between two looks at the work, and the longest that the window waits for it."""
READ = 0.5
"""Share of the progress bar for playing the scene."""
Step = tuple[float, str]
"""How far the work is (0 to 1), and what comes next."""


def move(context: Context, frames: range, still: bool) -> Generator[Step, None, tuple[str, ...]]:
    """All of it, by the scene's settings; returns mimesh's notes. Closing it half-way leaves the scene as it was."""
    settings = context.scene.mimesh
    source = settings.identity
    yield 0.0, "mimesh: reading the scene"
    identity = reading.read_identity(context, source)
    clip = yield from _read_driving(context, frames)
    job = Job(identity.mesh, clip, settings.options())
    job.start()
    try:
        while job.running:
            yield READ + (1 - READ) * job.fraction, "mimesh: moving the identity"
            job.wait(TICK)
    finally:
        job.cancel()
    result = job.result()
    yield 1.0, "mimesh: building the result"
    moved = building.Moved(source, identity, result, frames, still)
    if settings.result == "ARMATURE":
        building.build_armature(context, moved)
    else:
        building.build_shape_keys(context, moved)
    return tuple(note for note in result.notes if not (still and "has one frame" in note))


def _read_driving(context: Context, frames: range) -> Generator[Step, None, Clip]:
    sampling = reading.sample(context, context.scene.mimesh.driving, frames)
    with contextlib.closing(sampling):
        while True:
            try:
                done = next(sampling)
            except StopIteration as end:
                return end.value
            yield READ * done / len(frames), f"mimesh: reading frame {done} of {len(frames)}"


class _Moves(Operator):
    """Copy the identity and make the copy move; see the subclasses."""

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
            return {"RUNNING_MODAL"}  # the scene stays as it is while it is read and its result is on the way
        outcome: set[str] | None = {"CANCELLED"}
        try:
            outcome = self._advance(time.monotonic() + TICK, context)
        finally:
            if outcome is not None:
                self._end(context)
        return outcome or {"RUNNING_MODAL"}

    def execute(self, context: Context) -> set[str]:
        self._steps = self._work(context)
        outcome = self._advance(float("inf"), context)
        assert outcome is not None
        return outcome

    def cancel(self, context: Context) -> None:
        """Blender itself ends the operator, for instance as it quits."""
        self._end(context)

    def _advance(self, until: float, context: Context) -> set[str] | None:
        """Take steps up to that time of `time.monotonic`; how it ended, or None if it has not."""
        from mimesh import InputError

        try:
            for fraction, text in self._steps:
                self._show(context, fraction, text)
                if time.monotonic() >= until:
                    return None
        except InputError as error:
            self.report({"ERROR"}, spoken(str(error)))
            return {"CANCELLED"}
        return {"FINISHED"}

    def _work(self, context: Context) -> Iterator[Step]:
        notes = yield from move(context, self.frames(context), self.still)
        for note in notes:
            self.report({"WARNING"}, spoken(note))

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


class MIMESH_OT_animate(_Moves):
    """Make a copy of the identity move as the driving does"""

    bl_idname = "mimesh.animate"
    bl_label = "Animate"
    still = False

    def frames(self, context: Context) -> range:
        return context.scene.mimesh.frames(context.scene)


class MIMESH_OT_pose(_Moves):
    """Give a copy of the identity the pose that the driving has now"""

    bl_idname = "mimesh.pose"
    bl_label = "Pose"
    still = True

    def frames(self, context: Context) -> range:
        return range(context.scene.frame_current, context.scene.frame_current + 1)
