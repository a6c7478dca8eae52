"""A mesh or clip on the desk, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from ..pipeline.result import ClipResult
from ..pipeline.run import Ready
from .options import Options

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
    ready: tuple[tuple, bool | None, Ready] | None = None
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
