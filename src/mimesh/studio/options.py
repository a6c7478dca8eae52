"""The options of the page, and which of them apply to a model."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from ..core.errors import InputError
from ..methods.base import BodyMethod, Method, SkinnedMethod
from ..methods.find import takes_rigs
from ..pipeline.body_choice import BODIES
from ..pipeline.prepared import ROOTS, MotionOptions
from ..pipeline.rigs import RIGS


@dataclass(frozen=True)
class Options:
    """Model and motion options; `pipeline.animate` documents them."""

    model: str = "mime"
    root: str = "scale"
    ground: bool = True
    smooth: float = 0.0
    refine: bool | None = None
    body: str = "auto"
    rig: str = "own"

    def changed(self, changes: dict[str, Any], models: tuple[str, ...]) -> Options:
        """Return the options with some values changed.

        Raises:
            InputError: an unknown option, or a value that is not possible.
        """
        values: dict[str, Any] = dataclasses.asdict(self) | changes
        unknown = changes.keys() - {field.name for field in dataclasses.fields(self)}
        if unknown:
            raise InputError(f"{min(unknown)}: expected the name of an option, found this; leave it out")
        _check_choice(values, "model", models)
        _check_choice(values, "root", ROOTS)
        _check_choice(values, "ground", (True, False))
        _check_choice(values, "refine", (None, True, False))
        _check_choice(values, "body", BODIES)
        _check_choice(values, "rig", RIGS)
        smooth = values["smooth"]
        if isinstance(smooth, bool) or not isinstance(smooth, int | float) or not 0 <= smooth <= 10:
            raise InputError(f"smooth: expected seconds, 0 to 10, found {smooth!r}; try 0.05")
        values["smooth"] = float(smooth)
        return Options(**values)

    @property
    def motion_changes(self) -> tuple[bool, bool]:
        """Whether root motion and smoothing are other than the driving's: animations are then not copied."""
        return self.root != "scale", self.smooth > 0

    def motion(self, method: Method) -> MotionOptions:
        """Return the motion options for a method: those that it has.

        Only methods with joints have root, ground, smooth and the rigs of files, only those of several bodies a body.
        """
        rig = self.rig if takes_rigs(self.model) else "mimesh"
        body = self.body if isinstance(method, BodyMethod) and len(method.bodies) > 1 else "auto"
        if not isinstance(method, SkinnedMethod):
            return MotionOptions(rig=rig, body=body)
        return MotionOptions(self.root, self.ground, self.smooth, rig=rig, body=body)


def parse_rate(value: Any) -> float | None:
    """Parse a frame rate of the page in frames per second; None for the file's own.

    Raises:
        InputError: not a positive number.
    """
    if value in (None, ""):
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise InputError(f"frame rate: expected a positive number, found {value!r}; leave it empty for the file's own")
    return float(value)


def _check_choice(values: dict[str, Any], name: str, choices: tuple) -> None:
    """Raise InputError unless a value is one of the choices; 1 is not True."""
    found = values[name]
    if not any(found is choice or (isinstance(found, str) and found == choice) for choice in choices):
        raise InputError(
            f"{name}: expected one of {', '.join(map(str, choices))}, found {str(found)[:60]!r}; choose one"
        )
