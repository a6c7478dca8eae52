"""What lies on the desk of a studio: meshes to move, a clip to imitate, options, and what came of them.

One desk serves one page (or several showing the same). Methods are called by requests; what takes long is done by the
worker. `version` grows with every change, so that pages know when to look again.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..bodies.characters import character
from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh
from ..core.normalization import parse_axis
from ..pipeline.result import ClipResult
from ..pipeline.run import Prepared
from . import operations
from .exports import KEPT, Export, write
from .jobs import Cancelled, Worker, words
from .options import Options, rate
from .uploads import UploadFolder


class Session:
    """The state of a session."""

    def __init__(self, workplace: UploadFolder, models: tuple[str, ...], model: str, jointed: tuple[str, ...]) -> None:
        self.workplace, self.models, self.jointed = workplace, models, jointed
        self.options = Options(model)
        self.identities: dict[int, Item] = {}
        self.driving: Item | None = None
        self.exports: dict[int, Export] = {}
        self.version = 0
        self.worker = Worker()
        self._lock = threading.RLock()
        self._last = 0

    def changed(self) -> int:
        """Have pages look again."""
        with self._lock:
            self.version += 1
            return self.version

    def next_number(self) -> int:
        with self._lock:
            self._last += 1
            return self._last

    def add_identities(self, paths: list[Path], upload: int | None = None) -> list[int]:
        """Read meshes to move; each becomes an item at once.

        Raises:
            InputError: more than can lie there.
        """
        check_room(len(self.identities) + len(paths))
        added = []
        for path in paths:
            item = Item(self.next_number(), path.name, path, upload)
            self.identities[item.number] = item
            added.append(item.number)
            self._read(item, partial(operations.read_mesh, path, self._folder(upload)))
        return added

    def set_driving(self, path: Path, name: str, upload: int | None = None) -> int:
        """Read what to imitate, a file or a folder of frames, in place of what was there."""
        item = self._new_driving(name, path, upload)
        self._read(item, partial(operations.read_clip, path, self._folder(upload), name, None, None))
        return item.number

    def use_demo(self, what: str, name: str, motion: str) -> None:
        """Lay a character of the shipped cast on the desk ("identity"), a shipped motion ("driving"), or "both"."""
        if what in ("identity", "both"):
            check_room(len(self.identities) + 1)
            item = Item(self.next_number(), name)
            self.identities[item.number] = item
            self._read(item, partial(character, name))
        if what in ("driving", "both"):
            self._read(self._new_driving(motion), partial(operations.demo_clip, motion))

    def remove(self, number: int) -> None:
        """Take a mesh or the driving off the desk, with its files if nothing else on the desk came with them."""
        item = self.item(number)
        self._drop(item)
        if item is self.driving:
            self.driving = None
        self.identities.pop(number, None)
        if item.upload is not None and not self.uses(item.upload):
            self.workplace.remove_upload(item.upload)
        self.refresh()

    def item(self, number: int) -> Item:
        """Raises InputError where nothing has that number."""
        if self.driving is not None and self.driving.number == number:
            return self.driving
        if number not in self.identities:
            raise InputError(f"mesh {number}: expected one on the desk, found none; reload the page")
        return self.identities[number]

    def uses(self, upload: int) -> bool:
        """Whether something on the desk came with an upload."""
        return any(item.upload == upload for item in (*self.identities.values(), self.driving) if item is not None)

    def set_item(self, number: int, given: dict[str, Any]) -> None:
        """Change axes of a mesh, or the animation and frame rate of the driving (which is then read again)."""
        item = self.item(number)
        unknown = given.keys() - {"up", "front", "animation", "fps"}
        if unknown:
            raise InputError(f"{min(unknown)}: expected up, front, animation or fps, found it; leave it out")
        up, front = (parse_axis(given.get(axis, getattr(item, axis)) or None, axis) for axis in ("up", "front"))
        if up and front and up[1] == front[1]:
            raise InputError(f"{item.name}: expected up and front on two axes, found {up} and {front}; change one")
        item.up, item.front = up, front
        if item.content is not None:
            item.facing = operations.stands(item.content, item.axes)
        if item is self.driving and given.keys() & {"animation", "fps"} and item.path is not None:
            item.animation = given.get("animation", item.animation) or None
            item.fps = rate(given.get("fps", item.fps))
            self._read(
                item,
                partial(
                    operations.read_clip, item.path, self._folder(item.upload), item.name, item.fps, item.animation
                ),
            )
        self.refresh()

    def set_options(self, given: dict[str, Any]) -> None:
        """Change options; results follow."""
        self.options = self.options.changed(given, self.models)
        self.refresh()

    def refresh(self) -> None:
        """Make all results anew that are not those of now."""
        self.changed()
        with self._lock:
            for item in list(self.identities.values()):
                self._make(item)

    def stop(self, number: int) -> None:
        """End the making of a result; that of before stays, if there is one."""
        item = self.item(number)
        self.worker.drop(("result", number))
        if item.outcome is not None and not item.outcome.current:
            item.outcome.stopped = True
        self.changed()

    def pose(self, number: int, frame: int) -> Future:
        """A mesh in one frame with the options of now, soon; older wishes for it are dropped.

        The future gives (V, 3) positions.
        """
        item = self.item(number)

        def work(progress: Progress) -> Float[np.ndarray, "V 3"]:
            ready = self._prepared(item)
            return operations.pose_frame(ready, min(max(frame, 0), len(ready.clip) - 1))

        return self.worker.put(("pose", number), work, urgent=True)

    def export(self, suffix: str, numbers: list[int], skinned: bool, blendshapes: int | None) -> int:
        """Write results in a format, to be fetched; several go into one archive."""
        items = [self.item(number) for number in numbers or self.identities]
        export = Export(self.next_number(), suffix, skinned, blendshapes, self.workplace.new_export())
        name = Path(self.driving.name).stem if self.driving else ""

        def work(progress: Progress) -> Path:
            def told(done: int, total: int) -> None:
                progress(done, total)
                export.done = done / total

            return write(export, [(item.name, name, finished(item)) for item in items], told)

        def done(future: Future) -> None:
            error = future.exception()
            if error is None:
                export.path = future.result()
            elif not isinstance(error, Cancelled):
                export.error = self.said(error)
            self.changed()

        self.exports[export.number] = export
        for number in sorted(self.exports)[:-KEPT]:
            self.remove_export(number)
        self.worker.put(("export", export.number), work).add_done_callback(done)
        self.changed()
        return export.number

    def remove_export(self, number: int) -> None:
        """Stop the writing of an export, or take what was written away."""
        export = self.exports.pop(number, None)
        if export is not None:
            self.worker.drop(("export", number))
            shutil.rmtree(export.folder, ignore_errors=True)
        self.changed()

    def close(self) -> None:
        """End all work and take the files away."""
        self.worker.close()
        self.workplace.close()

    def _folder(self, upload: int | None) -> Path | None:
        return None if upload is None else self.workplace.upload(upload).folder

    def _new_driving(self, name: str, path: Path | None = None, upload: int | None = None) -> Item:
        if self.driving is not None:
            self.remove(self.driving.number)
        self.driving = Item(self.next_number(), name, path, upload)
        return self.driving

    def _read(self, item: Item, read: Callable[[], Mesh | Clip]) -> None:
        """Have an item read; its results follow."""
        item.content, item.error, item.outcome = None, "", None
        item.read += 1
        self._drop(item)

        def done(future: Future) -> None:
            error = future.exception()
            if isinstance(error, Cancelled):
                return
            item.error = "" if error is None else self.said(error)
            if error is None:
                content, item.facing = future.result()
                item.content, item.animations = content, operations.animations(content)
            self.refresh()

        def work(progress: Progress) -> tuple[Mesh | Clip, dict[str, Any]]:
            content = read()
            return content, operations.stands(content, item.axes)

        self.worker.put(("read", item.number), work).add_done_callback(done)
        self.changed()

    def _make(self, item: Item) -> None:
        """Have the result of a mesh made, if it can be and is not there."""
        if not isinstance(item.content, Mesh) or self.driving is None or not isinstance(self.driving.content, Clip):
            self.worker.drop(("result", item.number))
            item.outcome = item.ready = None
            return
        wanted = (*wants(item, self.driving, self.options), self.options)
        if getattr(item.outcome, "wanted", None) == wanted:
            return
        before = item.outcome or Outcome(0)
        outcome = Outcome(self.changed(), result=before.result, shown=before.shown, wanted=wanted)
        item.outcome = outcome
        options = self.options

        def work(progress: Progress) -> ClipResult:
            def told(done: int, total: int) -> None:
                progress(done, total)
                self._tell(outcome, done / total)

            return operations.result(self._prepared(item), options, told)

        self.worker.put(("result", item.number), work).add_done_callback(partial(self._made, outcome))

    def _made(self, outcome: Outcome, future: Future) -> None:
        error = future.exception()
        if isinstance(error, Cancelled):
            return
        if error is None:
            outcome.result, outcome.current, outcome.done = future.result(), True, 1.0
        else:
            outcome.error, outcome.result = self.said(error), None
        outcome.version = outcome.shown = self.changed()

    def _tell(self, outcome: Outcome, done: float) -> None:
        if done - outcome.done >= 0.01 or done == 1.0:
            outcome.done = done
            self.changed()

    def _prepared(self, item: Item) -> Prepared:
        """The mesh and the driving, read by the model; once for all options that do not matter to it."""
        driving, mesh = self.driving, item.content
        if driving is None or not isinstance(mesh, Mesh) or not isinstance(driving.content, Clip):
            raise Cancelled
        wanted, options, kept = wants(item, driving, self.options), self.options, item.ready
        if kept is None or kept[0] != wanted:
            axes = (*item.axes, *driving.axes)
            kept = (wanted, False, operations.prepared(mesh, driving.content, options.model, axes))
        if kept[1] != options.refine:
            kept = (wanted, options.refine, kept[2].refined(options.refine))
        item.ready = kept
        return kept[2]

    def _drop(self, item: Item) -> None:
        for what in ("read", "pose", "result"):
            self.worker.drop((what, item.number))

    def said(self, error: BaseException) -> str:
        """An error in words that fit the page: files by the names they were given."""
        return operations.for_page(words(error), self.workplace.folder)


MOST_IDENTITIES = 32
"""Each is kept with its result."""


@dataclass(eq=False)
class Item:
    """A mesh to move or what to imitate, as far as it has been read, and what became of it."""

    number: int
    name: str
    path: Path | None = None
    """None for what is shipped."""
    upload: int | None = None
    content: Mesh | Clip | None = None
    animations: tuple[str, ...] = ()
    animation: str | None = None
    fps: float | None = None
    up: str | None = None
    front: str | None = None
    error: str = ""
    facing: dict[str, Any] = field(default_factory=dict)
    """How it stands, as `report.facing` says it, and whether that is unsure."""
    read: int = 0
    """Grows with every reading, so that what was made from an older one is known."""
    outcome: Outcome | None = None
    ready: tuple[tuple, bool | None, Prepared] | None = None
    """What was prepared last, and for what."""

    @property
    def axes(self) -> tuple[str | None, str | None]:
        return self.up, self.front


@dataclass(eq=False)
class Outcome:
    """What came of one mesh to move with the driving and the options of now."""

    version: int
    done: float = 0.0
    error: str = ""
    stopped: bool = False
    result: ClipResult | None = None
    """Until this one is done, that of before."""
    shown: int = 0
    """Version of the desk when the result came."""
    current: bool = False
    """Whether the result is that of now."""
    wanted: tuple = ()
    """What it is made of."""


def check_room(count: int) -> None:
    """Raises InputError where so many meshes to move cannot lie on one desk."""
    if count > MOST_IDENTITIES:
        raise InputError(f"meshes to move: expected {MOST_IDENTITIES} or fewer, found {count}; remove some")


def finished(item: Item) -> ClipResult:
    """Raises InputError where the result of now is not there."""
    if item.outcome is None or item.outcome.result is None or not item.outcome.current:
        raise InputError(f"{item.name}: expected a finished result, found none; wait for it, or see what is said of it")
    return item.outcome.result


def wants(item: Item, driving: Item, options: Options) -> tuple:
    """What a result is prepared for."""
    return (driving.number, item.read, driving.read, options.model, *item.axes, *driving.axes)
