"""Meshes to move and the driving clip of a studio: their files, their content once read, and their results."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.joint_corrections import JointCorrections
from ..core.mesh import Clip, Mesh
from ..pipeline.move import PreparedMove
from ..pipeline.prepared import Prepared
from ..pipeline.result import ClipResult
from .options import Options


@dataclass(eq=False)
class Item:
    """A mesh to move or the driving clip: its file, its content once read, and its result."""

    number: int
    name: str
    path: Path | None = None
    """None for characters and motions that ship with mimesh."""
    upload: int | None = None
    """Number of the upload it came with; None for files of the command line and shipped ones."""
    content: Mesh | Clip | None = None
    """None until it has been read."""
    animations: tuple[str, ...] = ()
    """Names of the animations in the file."""
    animation: str | None = None
    """Chosen animation; None for the first."""
    fps: float | None = None
    """Chosen frame rate; None for the file's own."""
    corrections: JointCorrections | None = None
    """Joints that the user has corrected."""
    corrections_error: str = ""
    """Why the corrections beside its file are not used."""
    up: str | None = None
    front: str | None = None
    error: str = ""
    facing: dict[str, Any] = field(default_factory=dict)
    """Detected or chosen axes as `report.facing` gives them, and whether they are uncertain."""
    read: int = 0
    """Number of times it has been read, so that results of an earlier reading are recognized."""
    outcome: Outcome | None = None
    preparation: Preparation | None = None
    """What was prepared last."""

    @property
    def axes(self) -> tuple[str | None, str | None]:
        return self.up, self.front


@dataclass(frozen=True, eq=False)
class Preparation:
    """What was prepared for a mesh and the driving clip, and for which inputs and options."""

    inputs: tuple
    """See `preparation_inputs`."""
    motion_changes: tuple[bool, bool]
    """See `Options`."""
    refine: bool | None
    """Option `refine`; False as it is prepared first."""
    prepared: PreparedMove

    def serves(self, inputs: tuple, motion_changes: tuple[bool, bool]) -> bool:
        """Whether it is the same with other inputs and options.

        A method that was chosen where an animation could be copied is chosen with changed motion, too. Other ways to
        move a mesh do not have all options, and refuse those that they lack.
        """
        chosen = not any(self.motion_changes) and isinstance(self.prepared, Prepared)
        return self.inputs == inputs and (self.motion_changes == motion_changes or chosen)


@dataclass(eq=False)
class Outcome:
    """State of the result of one mesh for the current driving clip and options."""

    version: int
    """Version of the session when this was begun or finished."""
    progress: float = 0.0
    """Finished share of the frames, 0 to 1."""
    error: str = ""
    stopped: bool = False
    result: ClipResult | None = None
    """The previous result until this one is finished."""
    result_version: int = 0
    """Version of the session when `result` was finished."""
    current: bool = False
    """Whether `result` is finished for the current inputs."""
    inputs: tuple = ()
    """Everything the result depends on; another value means that it must be computed again."""


def finished_result(item: Item) -> ClipResult:
    """Return the result of a mesh.

    Raises:
        InputError: it is not finished for the current inputs.
    """
    if item.outcome is None or item.outcome.result is None or not item.outcome.current:
        raise InputError(f"{item.name}: expected a finished result, found none; wait for it, or see its error message")
    return item.outcome.result


def preparation_inputs(item: Item, driving: Item, options: Options) -> tuple:
    """Return everything that preparing a mesh and the driving clip for a model depends on."""
    corrections = tuple(_corrections_key(entry) for entry in (item, driving))
    chosen = options.model, options.body, options.rig
    return (driving.number, item.read, driving.read, *chosen, *item.axes, *driving.axes, *corrections)


def _corrections_key(item: Item) -> tuple:
    """Return the values of the corrections of an item, to be compared."""
    if item.corrections is None:
        return ()
    positions = item.corrections.positions.items()
    return (item.corrections.frame, *((name, *map(float, position)) for name, position in positions))
