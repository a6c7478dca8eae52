"""What is chosen on the page, and what of it a model can do."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from ..core.errors import InputError
from ..methods.base import Method, SkinnedMethod
from ..pipeline.run import ROOTS, MotionOptions


@dataclass(frozen=True)
class Options:
    """See `pipeline.animate` for what they mean."""

    model: str = "mime"
    root: str = "scale"
    ground: bool = False
    smooth: float = 0.0
    refine: bool | None = None

    def changed(self, given: dict[str, Any], models: tuple[str, ...]) -> Options:
        """With some of them as a page wants them.

        Raises:
            InputError: an option that is not known, or a value that makes no sense.
        """
        values: dict[str, Any] = dataclasses.asdict(self) | given
        unknown = given.keys() - {field.name for field in dataclasses.fields(self)}
        if unknown:
            raise InputError(f"{min(unknown)}: expected the name of an option, found this; leave it out")
        _one_of(values, "model", models)
        _one_of(values, "root", ROOTS)
        _one_of(values, "ground", (True, False))
        _one_of(values, "refine", (None, True, False))
        smooth = values["smooth"]
        if isinstance(smooth, bool) or not isinstance(smooth, int | float) or not 0 <= smooth <= 10:
            raise InputError(f"smooth: expected seconds, 0 to 10, found {smooth!r}; try 0.05")
        values["smooth"] = float(smooth)
        return Options(**values)

    def motion(self, method: Method) -> MotionOptions:
        """What is asked of a model with joints; nothing of others."""
        return (
            MotionOptions(self.root, self.ground, self.smooth) if isinstance(method, SkinnedMethod) else MotionOptions()
        )


def rate(value: Any) -> float | None:
    """A frame rate as a page gives it; None is the file's own.

    Raises:
        InputError: not a positive number.
    """
    if value in (None, ""):
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise InputError(f"frame rate: expected a positive number, found {value!r}; leave it empty for the file's own")
    return float(value)


def _one_of(values: dict[str, Any], name: str, known: tuple) -> None:
    found = values[name]
    if not any(found is one or (isinstance(found, str) and found == one) for one in known):
        raise InputError(f"{name}: expected one of {', '.join(map(str, known))}, found {str(found)[:60]!r}; choose one")
