"""What a studio holds: options and what its page calls them, meshes to move, the driving clip, and their results."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.arguments import check_rate
from ..core.errors import InputError
from ..core.joint_corrections import JointCorrections
from ..core.mesh import Clip, Mesh
from ..core.options import Hints, ModelOptions, MotionOptions, check_value, values_of
from ..methods.base import Method
from ..mime.model import Mime
from ..pipeline.node_route import NodeRoute
from ..pipeline.parts import PartRoute
from ..pipeline.result import ClipResult
from ..pipeline.route import Route
from ..pipeline.vertex_route import VertexRoute


@dataclass(frozen=True)
class Options:
    """Model and motion options; `pipeline.animate` documents them."""

    model: str = "mime"
    root: str = "scale"
    ground: bool = True
    contacts: bool = True
    smooth: float = 0.0
    refine: bool | None = None
    body: str = "auto"
    rig: str = "own"

    def changed(self, changes: dict[str, Any], models: tuple[str, ...]) -> Options:
        """Return the options with some values changed."""
        unknown = changes.keys() - {field.name for field in dataclasses.fields(self)}
        if unknown:
            raise InputError(f"{min(unknown)}: expected the name of an option, found this; leave it out")
        values = dataclasses.asdict(self) | changes
        for name, allowed in (("model", models), ("rig", values_of(Hints, "rig"))):
            check_value(name, str(values[name]), allowed)
        if type(values["smooth"]) is int:  # JSON's 0
            values["smooth"] = float(values["smooth"])
        Hints(body=values["body"])
        ModelOptions(refine=values["refine"])
        MotionOptions(**{name: values[name] for name in ("root", "ground", "smooth", "contacts")})
        return Options(**values)

    @property
    def motion_changes(self) -> tuple[bool, bool]:
        """Whether root motion and smoothing are other than the driving's: animations are then not copied."""
        return self.root != "scale", self.smooth > 0

    def motion(self, model: Mime | Method) -> MotionOptions:
        """Return the motion options for a model: only one with joints has any."""
        if not isinstance(model, Mime):
            return MotionOptions()
        return MotionOptions(self.root, self.ground, self.smooth, contacts=self.contacts)

    def kind(self, model: Mime | Method) -> tuple[str, str]:
        """Return rig and body for a model: one with joints has the rigs of files, one of several bodies has a body."""
        if not isinstance(model, Mime):
            return "mimesh", "auto"
        return self.rig, self.body if len(model.bodies) > 1 else "auto"


def parse_rate(value: Any) -> float | None:
    """Parse a frame rate of the page in frames per second; None for the file's own."""
    if value in (None, ""):
        return None
    advice = "leave it empty for the file's own"
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"frame rate: expected a number, found {value!r}; {advice}")
    rate = float(max(min(value, 1e9), -1e9))  # whole numbers of JSON may be too large for a float
    check_rate(rate, "frame rate", advice)
    return rate


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
    parts: tuple[str, ...] = ()
    """Names of the parts of the mesh, if it has several."""
    part: str | None = None
    """Chosen part; None: see `pipeline.parts.find_part`."""
    notes: tuple[str, ...] = ()
    """What was taken of the file of the driving clip."""
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
    route: Route | PartRoute

    def serves(self, inputs: tuple, motion_changes: tuple[bool, bool]) -> bool:
        """Whether it is the same with other inputs and options.

        A model that was chosen where an animation could be copied is chosen with changed motion, too. Other ways to
        move a mesh do not have all options, and refuse those that they lack.
        """
        route = self.route.route if isinstance(self.route, PartRoute) else self.route
        by_reference = isinstance(route, VertexRoute) and route.reference is not None
        chosen = not any(self.motion_changes) and not isinstance(route, NodeRoute) and not by_reference
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
    """Return the result of a mesh."""
    if item.outcome is None or item.outcome.result is None or not item.outcome.current:
        raise InputError(f"{item.name}: expected a finished result, found none; wait for it, or see its error message")
    return item.outcome.result


def preparation_inputs(item: Item, driving: Item, options: Options) -> tuple:
    """Return everything that preparing a mesh and the driving clip for a model depends on."""
    corrections = tuple(_corrections_key(entry) for entry in (item, driving))
    chosen = options.model, options.body, options.rig
    given = (*item.axes, item.part, *driving.axes, driving.part)
    return (driving.number, item.read, driving.read, *chosen, *given, *corrections)


def _corrections_key(item: Item) -> tuple:
    if item.corrections is None:
        return ()
    positions = item.corrections.positions.items()
    return (item.corrections.frame, *((name, *map(float, position)) for name, position in positions))


FIELDS = {
    "model": "the model",
    "names": "bone names",
    "rest": "rest pose",
    "root_bone": "root bone",
    "skinned": "bones",
    "rig": "bones",
    "body": "both meshes are",
    "smooth": "smoothing",
    "root": "root motion",
    "ground": "feet on the ground",
    "fps": "frame rate",
    "output_fps": "frame rate",
    "driving_up": "up of the driving",
    "driving_front": "front of the driving",
    "license": "licence",
    "driving_part": "part of the driving",
    "influences": "weights per vertex",
    "joints": "corrected joints",
    "driving_joints": "corrected joints of the driving",
}
"""Option -> the field of the page that it is, where that has another name."""
CHOICES = {
    "False": "off",
    "own": "of the file",
    "mimesh": "found on the surface",
    "human": "a person",
    "quadruped": "a four-legged animal",
    "deformation-transfer": "deformation-transfer, of the command mimesh animate alone",
}
"""Value of an option -> what the field of the page calls it."""


def field_name(name: str, value: object = None) -> str:
    """Name an option in a message, with a value to choose, as the page does."""
    known = FIELDS.get(name, name.replace("_", " "))
    return known if value is None or value is ... else f"“{known}: {CHOICES.get(str(value), value)}”"
