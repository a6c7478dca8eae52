"""Import onnxruntime without its telemetry. Nothing else in this project imports it."""

from __future__ import annotations

import os
import sys
from types import ModuleType

SWITCH = "ORT_DISABLE_TELEMETRY"
"""Environment variable that onnxruntime reads once, while it is imported; its Privacy.md describes it."""


def import_onnxruntime() -> ModuleType:
    """Import onnxruntime with its telemetry disabled and return the module.

    Official builds send events to their vendor and keep a database and a device identifier in the user's cache folder,
    from the import on. If the user has set the variable to any value, or the program has imported onnxruntime before,
    nothing is changed.
    """
    first = "onnxruntime" not in sys.modules
    if first and not os.environ.get(SWITCH):
        os.environ[SWITCH] = "1"
    import onnxruntime

    if first and os.environ[SWITCH] == "1":
        # Older builds for Windows report to the system's event log; they ignore the variable and have only this switch.
        onnxruntime.disable_telemetry_events()
    return onnxruntime
