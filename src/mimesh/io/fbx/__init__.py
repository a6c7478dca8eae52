"""Read FBX files (.fbx) as glTF with ufbx (the extra `fbx`) and write them with Blender, both in child processes.

to_glb                    runs in the child: writes a .glb of an FBX file
write (blender_export)    has Blender export a .glb as FBX

The parent reads and writes .glb files like any other, so that all code for glTF works on FBX.
"""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path

from ...core.errors import NotInstalledError
from ..child_process import child_result


@contextlib.contextmanager
def fbx_as_glb(path: Path) -> Iterator[Path]:
    """Convert an FBX file to a temporary .glb, y up and in metres, which is deleted at the end of the block.

    Raises:
        InputError: ufbx is not installed, or the file is damaged or no FBX file.
    """
    need_reader(path)
    with child_result("mimesh.io.fbx.to_glb:write_glb", path, path) as glb:
        yield glb


def need_reader(path: Path) -> None:
    """Raise NotInstalledError where ufbx is not installed."""
    if importlib.util.find_spec("ufbx") is None:
        raise NotInstalledError(f"{path}: expected ufbx to read FBX, found it not installed; pip install 'mimesh[fbx]'")
