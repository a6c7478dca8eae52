"""mimesh: give a mesh the pose or motion of another.

The names below are loaded when first used, so that `import mimesh` and `mimesh --help` cost nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from . import old_names

if TYPE_CHECKING:
    from .core.budgets import no_limits
    from .core.errors import InputError
    from .core.mesh import Clip, Mesh
    from .io import load_clip, load_mesh, save_clip, save_mesh
    from .jobs.run import batch
    from .pipeline import animate, prepare, transfer
    from .pipeline.live import LiveSession
    from .pipeline.result import ClipResult, Result
    from .pipeline.skinned import save_skinned

__version__ = "0.1.0"
__all__ = [
    "Clip",
    "ClipResult",
    "InputError",
    "LiveSession",
    "Mesh",
    "Result",
    "animate",
    "batch",
    "load_clip",
    "load_mesh",
    "no_limits",
    "prepare",
    "save_clip",
    "save_mesh",
    "save_skinned",
    "transfer",
]

_MODULES = {
    "core.budgets": ("no_limits",),
    "core.errors": ("InputError",),
    "core.mesh": ("Clip", "Mesh"),
    "jobs.run": ("batch",),
    "io": ("load_clip", "load_mesh", "save_clip", "save_mesh"),
    "pipeline": ("animate", "prepare", "transfer"),
    "pipeline.live": ("LiveSession",),
    "pipeline.result": ("ClipResult", "Result"),
    "pipeline.skinned": ("save_skinned",),
}
old_names.install()


def __getattr__(name: str) -> object:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f".{module}", __name__), name)
    raise AttributeError(f"module 'mimesh' has no attribute {name!r}")
