"""Options given by their names alone, as the classes that the public functions take."""

from __future__ import annotations

import dataclasses
from typing import Any

from mimesh.core.options import FrameRange, Hints, ModelOptions, MotionOptions

CLASSES = {"hints": Hints, "options": ModelOptions, "motion": MotionOptions, "frames": FrameRange}


def grouped(known: Hints | None = None, /, **options: Any) -> dict[str, Any]:
    """Return keyword arguments of `transfer`, `animate` and others: options in their classes, all else as it is."""
    arguments = {}
    for name, kind in CLASSES.items():
        fields = {field.name for field in dataclasses.fields(kind)} & options.keys()
        given = {field: options.pop(field) for field in fields}
        if kind is Hints and known is not None:
            arguments[name] = dataclasses.replace(known, **given)
        elif given:
            arguments[name] = kind(**given)
    return arguments | options
