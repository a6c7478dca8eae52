"""The state of a studio: meshes to move, the driving clip, options, and the results computed from them.

One session serves one page (or several that show the same). Its methods are called by requests; what takes long is done
by the worker thread. `version` grows with every change, so that pages know when to fetch the state again.
"""

from __future__ import annotations

import dataclasses
import shutil
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh
from ..core.normalization import parse_axis
from ..pipeline.parts import PartRoute
from ..pipeline.result import ClipResult
from ..pipeline.route import Route
from . import operations
from .exports import MAX_EXPORTS, Export, Order, write
from .items import Item, Options, Outcome, Preparation, parse_rate, preparation_inputs
from .jobs import Cancelled, Worker, error_line
from .uploads import UploadFolder

MOST_IDENTITIES = 32
"""Largest number of meshes to move; each is stored with its result."""

RESULTS = ("pose", "joints", "result")
"""Jobs of a mesh that need the driving."""


class Session:
    """Everything the studio's page shows and changes."""

    def __init__(
        self, uploads: UploadFolder, models: tuple[str, ...], model: str, skinned_models: tuple[str, ...]
    ) -> None:
        self.uploads, self.models, self.skinned_models = uploads, models, skinned_models
        self.options = Options(model)
        self.identities: dict[int, Item] = {}
        self.driving: Item | None = None
        self.exports: dict[int, Export] = {}
        self.version = 0
        self.worker = Worker()
        self._lock = threading.RLock()
        self._last_number = 0

    def changed(self) -> int:
        """Count a change, so that pages fetch the state; returns the new version."""
        with self._lock:
            self.version += 1
            return self.version

    def next_number(self) -> int:
        """Return a number that no item or export has had."""
        with self._lock:
            self._last_number += 1
            return self._last_number

    def add_identities(self, paths: list[Path], upload: int | None = None) -> list[int]:
        """Add meshes to move, to be read by the worker; returns their numbers."""
        check_room(len(self.identities) + len(paths))
        added = []
        for path in paths:
            item = Item(self.next_number(), path.name, path, upload)
            self.identities[item.number] = item
            added.append(item.number)
            self._read(item, partial(operations.read_mesh, path, self._folder(upload)))
        return added

    def set_driving(self, path: Path, name: str, upload: int | None = None) -> int:
        """Replace the driving clip by a file or a folder of frames, to be read by the worker; returns its number."""
        item = self._new_driving(name, path, upload)
        self._read(item, partial(operations.read_clip, path, self._folder(upload), name, None, None))
        return item.number

    def use_demo(self, what: str, name: str, motion: str) -> None:
        """Load a shipped character or animal (`what` is "identity"), a shipped motion ("driving"), or "both"."""
        if what in ("identity", "both"):
            check_room(len(self.identities) + 1)
            item = Item(self.next_number(), name)
            self.identities[item.number] = item
            self._read(item, partial(operations.demo_mesh, name))
        if what in ("driving", "both"):
            self._read(self._new_driving(motion), partial(operations.demo_clip, motion))

    def remove(self, number: int) -> None:
        """Remove a mesh or the driving clip, and its upload unless another item came with it."""
        item = self.item(number)
        self._cancel_jobs(item)
        if item is self.driving:
            self.driving = None
        self.identities.pop(number, None)
        if item.upload is not None and not self.uses(item.upload):
            self.uploads.remove_upload(item.upload)
        self.refresh()

    def item(self, number: int) -> Item:
        """Return the item of a number."""
        if self.driving is not None and self.driving.number == number:
            return self.driving
        if number not in self.identities:
            raise InputError(f"mesh {number}: expected one of this session, found none; reload the page")
        return self.identities[number]

    def uses(self, upload: int) -> bool:
        """Whether an item came with an upload."""
        return any(item.upload == upload for item in (*self.identities.values(), self.driving) if item is not None)

    def set_item(self, number: int, changes: dict[str, Any]) -> None:
        """Change axes and part of an item, or animation and frame rate of the driving, which is then read again."""
        item = self.item(number)
        unknown = changes.keys() - {"up", "front", "part", "animation", "fps"}
        if unknown:
            raise InputError(f"{min(unknown)}: expected up, front, part, animation or fps, found it; leave it out")
        axes = ((axis, changes.get(axis, getattr(item, axis))) for axis in ("up", "front"))
        up, front = (parse_axis(str(value) if value else None, axis) for axis, value in axes)
        if up and front and up[1] == front[1]:
            raise InputError(f"{item.name}: expected up and front on two axes, found {up} and {front}; change one")
        part = changes.get("part", item.part) or None
        if part not in (None, item.part, *item.parts):
            raise InputError(f"{item.name}: expected one of its parts, found {str(part)[:60]!r}; choose one of them")
        fps = parse_rate(changes.get("fps", item.fps))
        item.up, item.front, item.part = up, front, part
        if item.content is not None:
            item.facing = operations.detect_facing(item.content, item.axes)
        if item is self.driving and changes.keys() & {"animation", "fps"} and item.path is not None:
            item.animation = changes.get("animation", item.animation) or None
            item.fps = fps
            folder = self._folder(item.upload)
            self._read(item, partial(operations.read_clip, item.path, folder, item.name, item.fps, item.animation))
        self.refresh()

    def set_options(self, changes: dict[str, Any]) -> None:
        """Change options and compute the results again that depend on them."""
        self.options = self.options.changed(changes, self.models)
        self.refresh()

    def refresh(self) -> None:
        """Compute all results again whose inputs have changed."""
        self.changed()
        with self._lock:
            for item in list(self.identities.values()):
                self._start_result(item)

    def stop(self, number: int) -> None:
        """Stop computing a result; the previous one, if any, stays."""
        item = self.item(number)
        self.worker.cancel(("result", number))
        if item.outcome is not None and not item.outcome.current:
            item.outcome.stopped = True
        self.changed()

    def pose(self, number: int, frame: int) -> Future:
        """Compute a mesh in one frame with the current options, before other work; cancels earlier calls for it.

        The future gives (V, 3) positions.

        Raises:
            Cancelled: the mesh has been removed.
        """
        item = self.identities.get(number)
        if item is None:
            raise Cancelled

        def work(progress: Progress) -> Float[np.ndarray, "V 3"]:
            route, clip = self._prepare(item)
            return route.frame(min(max(frame, 0), len(clip) - 1))

        return self.worker.submit(("pose", number), work, urgent=True)

    def set_joints(self, number: int, positions: Any) -> None:
        """Replace the corrected joints of an item; results that depend on them are computed again."""
        item = self.item(number)
        item.corrections, item.corrections_error = operations.parse_positions(item, positions), ""
        self.refresh()

    def joints(self, number: int) -> Future:
        """Find the joints of a mesh and of the driving clip, before other work; cancels earlier calls for it.

        The future gives a dictionary for the page; see `operations.describe_joints`.

        Raises:
            Cancelled: one of them has been removed.
        """
        item, driving = self.identities.get(number), self.driving
        if item is None or driving is None:
            raise Cancelled

        def work(progress: Progress) -> dict[str, Any]:
            return operations.describe_joints(self._prepare(item)[0], item, driving)

        return self.worker.submit(("joints", number), work, urgent=True)

    def export(self, order: Order, numbers: Sequence[int] = ()) -> int:
        """Start to write a file, of several results or rigs one archive; returns the number of the export.

        Args:
            numbers: of the meshes whose results or rigs are written; all if empty.
        """
        items = [self.item(number) for number in numbers or self.identities]
        export = Export(self.next_number(), order, self.uploads.new_export())
        driving, options = self.driving, self.options

        def work(progress: Progress) -> Path:
            def report(done: int, total: int) -> None:
                progress(done, total)
                export.progress = done / total

            return write(export, items, driving, options, report)

        def finish(future: Future) -> None:
            error = future.exception()
            if error is None:
                export.path = future.result()
            elif not isinstance(error, Cancelled):
                export.error = self.page_error(error)
            self.changed()

        self.exports[export.number] = export
        # Numbers grow: the smallest ones are the oldest exports.
        for number in sorted(self.exports)[:-MAX_EXPORTS]:
            self.remove_export(number)
        self.worker.submit(("export", export.number), work).add_done_callback(finish)
        self.changed()
        return export.number

    def remove_export(self, number: int) -> None:
        """Stop writing an export, or delete its files."""
        export = self.exports.pop(number, None)
        if export is not None:
            self.worker.cancel(("export", number))
            shutil.rmtree(export.folder, ignore_errors=True)
        self.changed()

    def close(self) -> None:
        """Stop all work and delete the files."""
        self.worker.close()
        self.uploads.close()

    def page_error(self, error: BaseException) -> str:
        """Describe an error for the page: files by the names the user gave them, without the temporary folder."""
        return operations.for_page(error_line(error), self.uploads.folder)

    def _folder(self, upload: int | None) -> Path | None:
        return None if upload is None else self.uploads.upload(upload).folder

    def _new_driving(self, name: str, path: Path | None = None, upload: int | None = None) -> Item:
        if self.driving is not None:
            self.remove(self.driving.number)
        self.driving = Item(self.next_number(), name, path, upload)
        return self.driving

    def _read(self, item: Item, read: Callable[[], Mesh | Clip]) -> None:
        """Let the worker read an item; results that depend on it are computed afterwards."""
        # Callbacks run in the worker's thread; a newer reading cancels this one, so its callback then does nothing.
        item.content, item.error, item.outcome = None, "", None
        item.read += 1
        self._cancel_jobs(item)
        for identity in self.identities.values() if item is self.driving else ():  # their results are of what it was
            self._cancel_jobs(identity, RESULTS)

        def finish(future: Future) -> None:
            error = future.exception()
            if isinstance(error, Cancelled):
                return
            item.error = "" if error is None else self.page_error(error)
            if error is None:
                content, item.facing, item.notes = future.result()
                item.content, item.animations = content, operations.animations(content)
                item.parts = operations.parts(content)
                self._use_side_file(item)
            self.refresh()

        def work(progress: Progress) -> tuple[Mesh | Clip, dict[str, Any], tuple[str, ...]]:
            content = read()
            return content, operations.detect_facing(content, item.axes), operations.notes(content, item)

        self.worker.submit(("read", item.number), work).add_done_callback(finish)
        self.changed()

    def _use_side_file(self, item: Item) -> None:
        """Take the corrected joints beside the file of an item that has been read, unless it has some already."""
        try:
            if item.corrections is None:
                item.corrections = operations.read_side_file(item.path)
            if item.corrections is not None:
                operations.check_corrections(item, item.corrections)
        except InputError as error:
            item.corrections, item.corrections_error = None, self.page_error(error)

    def _start_result(self, item: Item) -> None:
        """Let the worker compute the result of a mesh, unless inputs are missing or it is there or under way."""
        if not isinstance(item.content, Mesh) or self.driving is None or not isinstance(self.driving.content, Clip):
            self.worker.cancel(("result", item.number))
            item.outcome = item.preparation = None
            return
        inputs = (*preparation_inputs(item, self.driving, self.options), self.options)
        if getattr(item.outcome, "inputs", None) == inputs:
            return
        # The previous result stays on the stage until the new one is finished.
        before = item.outcome or Outcome(0)
        outcome = Outcome(self.changed(), result=before.result, result_version=before.result_version, inputs=inputs)
        item.outcome = outcome
        options = self.options

        def work(progress: Progress) -> ClipResult:
            def report(done: int, total: int) -> None:
                progress(done, total)
                # In steps of a percent: each change wakes up all pages.
                if done / total - outcome.progress >= 0.01 or done == total:
                    outcome.progress = done / total
                    self.changed()

            route, clip = self._prepare(item)
            return operations.compute_result(route, clip, options, report)

        self.worker.submit(("result", item.number), work).add_done_callback(partial(self._finish_result, outcome))

    def _finish_result(self, outcome: Outcome, future: Future) -> None:
        error = future.exception()
        if isinstance(error, Cancelled):
            return
        if error is None:
            outcome.result, outcome.current, outcome.progress = future.result(), True, 1.0
        else:
            outcome.error, outcome.result = self.page_error(error), None
        outcome.version = outcome.result_version = self.changed()

    def _prepare(self, item: Item) -> tuple[Route | PartRoute, Clip]:
        """Return a mesh and the driving clip as the model prepared them, from the cache if the inputs are the same.

        Preparation (fitting, normalization) takes most of the time to the first pose and hardly depends on the motion
        options, so that sliders respond quickly. Refinement is a second step, for the same reason.
        """
        driving, mesh = self.driving, item.content
        clip = driving and driving.content
        if driving is None or not isinstance(mesh, Mesh) or not isinstance(clip, Clip):
            raise Cancelled
        inputs, options, cached = preparation_inputs(item, driving, self.options), self.options, item.preparation
        if cached is None or not cached.serves(inputs, options.motion_changes):
            route = operations.prepare_inputs(item, driving, options)
            cached = Preparation(inputs, options.motion_changes, False, route)
        if cached.refine != options.refine:
            route = cached.route.with_refinement(options.refine)
            cached = dataclasses.replace(cached, refine=options.refine, route=route)
        item.preparation = cached
        return cached.route, clip

    def _cancel_jobs(self, item: Item, kinds: Sequence[str] = ("read", *RESULTS)) -> None:
        for what in kinds:
            self.worker.cancel((what, item.number))


def check_room(count: int) -> None:
    """Check the number of meshes to move."""
    if count > MOST_IDENTITIES:
        raise InputError(f"meshes to move: expected {MOST_IDENTITIES} or fewer, found {count}; remove some")
