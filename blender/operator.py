# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators: read the scene, run mimesh, build the result, in steps between which the window responds.

From a script, `bpy.ops.mimesh.animate()` does the same without a window and returns when all is done. The settings are
in `scene.mimesh`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING

import bpy
from bpy.types import Context, Event, Operator

from . import building, joints, own_armature, reading
from .bones import OwnArmature
from .job import Job, Made, Progress, driving_name

if TYPE_CHECKING:
    from mimesh import CapturedClip, ClipResult, RiggedMesh

TICK = 0.05
"""Seconds between two checks of the job, and the longest time that a step blocks the window."""
READ_SHARE = 0.5
"""Share of the progress bar for reading the scene."""
READING, BUILDING = "mimesh: reading the scene", "mimesh: building the result"
Step = tuple[float, str]
"""Progress (0 to 1), and a description of the next step."""


def transfer(context: Context, frames: range, single_pose: bool) -> Generator[Step, None, tuple[str, ...]]:
    """Run a whole transfer with the scene's settings; yields steps and returns mimesh's notes.

    If the generator is closed half-way, the scene is not changed.
    """
    settings = context.scene.mimesh
    source = settings.identity
    identity, result = yield from _run(context, frames, settings.result == "OWN")
    yield 1.0, BUILDING
    notes = tuple(note for note in result.notes if not (single_pose and "has one frame" in note))
    if isinstance(identity, OwnArmature):
        return notes + own_armature.build(context, identity, result, frames, single_pose)
    name = f"{source.name} {'posed' if single_pose else 'animated'}"
    copy = building.Copy(source, identity, name, frames, single_pose)
    if settings.result == "ARMATURE":
        building.build_armature(context, copy, result.skeleton)
    else:
        building.build_shape_keys(context, copy, result.clip.vertices)
    return notes


def show_joints(context: Context, frame: int) -> Generator[Step, None, tuple[str, ...]]:
    """Find the joints of both objects in a frame and make empties for them; yields steps, returns no notes."""
    _check_joints(context, "joints")
    _, result = yield from _run(context, range(frame, frame + 1), own=False, with_bones=False)
    joints.show(context, result, frame)
    return ()


def rig(context: Context) -> Generator[Step, None, tuple[str, ...]]:
    """Make a copy of the identity at rest, with bones and weights; yields steps and returns mimesh's notes."""
    from mimesh import Hints

    settings = context.scene.mimesh
    _check_joints(context, "Rig")
    yield 0.0, READING
    identity, model = reading.read_identity(context, settings.identity), settings.model
    axes = {"up": settings.identity_up, "front": settings.front("identity")}
    hints, layout = Hints(**axes, body=settings.body, joints=joints.of_identity(context)), settings.layout()

    def find(progress: Progress) -> RiggedMesh:
        import mimesh

        return mimesh.rig(identity.mesh, model, hints=hints)

    rigged = yield from _finished(Job(find), "mimesh: finding joints")
    yield 1.0, BUILDING
    skeleton = rigged.laid_out(layout)
    posed = dataclasses.replace(identity, mesh=skeleton.mesh)
    copy = building.Copy(settings.identity, posed, f"{settings.identity.name} at rest", range(1), single_pose=True)
    building.build_armature(context, copy, skeleton)
    return rigged.notes


def capture(context: Context, frames: range) -> Generator[Step, None, tuple[str, ...]]:
    """Make an armature that plays the joints of the driving; yields steps and returns mimesh's notes."""
    from mimesh import Hints

    settings = context.scene.mimesh
    _check_joints(context, "Capture")
    yield 0.0, READING
    corrected, model, smooth = joints.of_driving(context, frames), settings.model, settings.smooth
    driving = yield from _read_driving(context, frames, corrected is None)
    known = driving.clip.mesh.up is not None  # bones without a mesh move mimesh's body
    axes = {} if known else {"up": settings.driving_up, "front": settings.front("driving")}
    hints = Hints(**axes, body=settings.body, joints=corrected)

    def find(progress: Progress) -> CapturedClip:
        import mimesh

        return mimesh.capture(driving.clip, model, hints=hints, smooth=smooth, progress=progress)

    captured = yield from _finished(Job(find, driving_name), "mimesh: finding joints")
    yield 1.0, BUILDING
    building.build_motion(context, settings.driving, driving, captured, frames)
    return captured.notes


def _check_joints(context: Context, what: str) -> None:
    """Check that the model finds joints, which `what` needs."""
    from mimesh import InputError

    model = context.scene.mimesh.model
    if model != "mime":
        raise InputError(f"{what}: expected the model mime, found {model}; choose it as the model")


def _run(
    context: Context, frames: range, own: bool, with_bones: bool = True
) -> Generator[Step, None, tuple[reading.Identity | OwnArmature, ClipResult]]:
    """Read the scene and run mimesh with the settings and the joints that were moved; yields steps.

    Args:
        own: move the identity's own armature.
        with_bones: use the bones of a driving armature, unless its joints were moved.
    """
    from mimesh import Hints

    settings = context.scene.mimesh
    yield 0.0, READING
    with_joints = settings.model == "mime"
    hints = settings.hints()
    if with_joints:
        hints |= {"joints": joints.of_identity(context), "driving_joints": joints.of_driving(context, frames)}
    if own:
        _check_joints(context, "Own armature")
        joints.refuse_moved(context, "identity")
        identity = reading.read_own_armature(
            context, settings.identity, settings.identity_up, settings.front("identity"), settings.body
        )
        hints["rig"] = identity.rig
    else:
        identity = reading.read_identity(context, settings.identity)
    with_bones = with_bones and with_joints and hints["driving_joints"] is None
    clip = (yield from _read_driving(context, frames, with_bones)).clip
    if clip.mesh.up is not None:  # bones without a mesh move mimesh's body, whose axes are known
        hints |= {"driving_up": None, "driving_front": None}
    options = {"model": settings.model, "hints": Hints(**hints), "motion": settings.motion()}

    def animate(progress: Progress) -> ClipResult:
        import mimesh

        return mimesh.animate(identity.mesh, clip, progress=progress, **options)

    return identity, (yield from _finished(Job(animate), "mimesh: moving the identity"))


def _finished(job: Job[Made], text: str) -> Generator[Step, None, Made]:
    """Run a job; yields steps and returns its result."""
    job.start()
    try:
        while job.running:
            yield READ_SHARE + (1 - READ_SHARE) * job.fraction, text
            job.wait(TICK)
    finally:
        job.cancel()
    return job.result()


def _read_driving(context: Context, frames: range, with_bones: bool) -> Generator[Step, None, reading.Driving]:
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
    needs = ("identity", "driving")

    @classmethod
    def poll(cls, context: Context) -> bool:
        settings = context.scene.mimesh
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave the edit or pose mode first")
            return False
        if any(getattr(settings, which) is None for which in cls.needs):
            cls.poll_message_set(f"Choose {' and '.join(cls.needs)}")
            return False
        return True

    def frames(self, context: Context) -> range:
        return context.scene.mimesh.frames(context.scene)

    def run(self, context: Context) -> Generator[Step, None, tuple[str, ...]]:
        """Do the work; yields steps and returns notes."""
        return transfer(context, self.frames(context), self.single_pose)

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
        notes = yield from self.run(context)
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

    def run(self, context: Context) -> Generator[Step, None, tuple[str, ...]]:
        return show_joints(context, context.scene.frame_current)


class MIMESH_OT_rig(_TransferOperator):
    """Make a copy of the identity at rest, with an armature and weights"""

    bl_idname = "mimesh.rig"
    bl_label = "Rig"
    needs = ("identity",)

    def run(self, context: Context) -> Generator[Step, None, tuple[str, ...]]:
        return rig(context)


class MIMESH_OT_capture(_TransferOperator):
    """Make an armature that plays the joints of the driving"""

    bl_idname = "mimesh.capture"
    bl_label = "Capture"
    needs = ("driving",)

    def run(self, context: Context) -> Generator[Step, None, tuple[str, ...]]:
        return capture(context, self.frames(context))


class MIMESH_OT_clear_joints(Operator):
    """Remove the empties of all joints, and with them the corrections"""

    bl_idname = "mimesh.clear_joints"
    bl_label = "Clear"
    bl_options = frozenset({"UNDO"})

    def execute(self, context: Context) -> set[str]:
        joints.clear(context)
        return {"FINISHED"}
