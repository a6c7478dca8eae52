"""Names of modules until version 0.1: they can still be imported, with a DeprecationWarning, until version 0.3."""

from __future__ import annotations

import importlib
import importlib.abc
import sys
import warnings
from importlib.machinery import ModuleSpec
from types import ModuleType

RENDER = ("camera", "heat", "movie", "raster", "sheet")
MOVED = {
    "mesh": "core.mesh",
    "geometry": "core.geometry",
    "frame": "core.normalization",
    "rig": "core.rig",
    "result": "pipeline.result",
    "convert": "tools.convert",
    "look": "tools.inspect",
    "preview": "tools.preview",
    "view": "render",
    **{f"view.{name}": f"render.{name}" for name in RENDER},
    "view.player": "player.page",
    "view.scene": "player.pack",
    "bodies.cast": "bodies.characters",
}
"""Old module -> new module, both below `mimesh`."""
RENAMED = {
    ("frame", "Frame"): "Normalization",
    ("rig", "Skinned"): "SkinnedMesh",
    ("rig", "Skeleton"): "AnimatedRig",
    ("look", "look"): "inspect_file",
    ("view.scene", "Shown"): "Panel",
    ("bodies.cast", "CAST"): "CHARACTERS",
}
"""(old module, old name) -> new name."""
ELSEWHERE = {
    ("mesh", "InputError"): "core.errors",
    ("geometry", "sample_surface"): "core.surface_points",
    ("geometry", "at_barycentric"): "core.surface_points",
    ("rig", "Skinned"): "core.skinning",
    ("rig", "Skeleton"): "core.animated_rig",
}
"""(old module, old name) -> module, where it is not that of MOVED."""


class OldNames(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds old modules, after every other finder has failed; see `sys.meta_path`."""

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        old = fullname.removeprefix("mimesh.")
        return ModuleSpec(fullname, self, is_package=old == "view") if fullname != old and old in MOVED else None

    def create_module(self, spec: ModuleSpec) -> None:
        """Leave the making of an empty module to the import system."""

    def exec_module(self, module: ModuleType) -> None:
        old = module.__name__.removeprefix("mimesh.")
        message = f"{module.__name__} is now mimesh.{MOVED[old]}; the old name goes with version 0.3"
        warnings.warn(message, DeprecationWarning, stacklevel=2)

        def look_up(name: str) -> object:
            home = importlib.import_module(f"mimesh.{ELSEWHERE.get((old, name), MOVED[old])}")
            return getattr(home, RENAMED.get((old, name), name))

        module.__dict__["__getattr__"] = look_up


def install() -> None:
    """Make old module names importable."""
    sys.meta_path.append(OldNames())
