"""Read FBX files (.fbx) as glTF with ufbx (the extra `fbx`) and write them with Blender, both in child processes.

to_glb (elements, geometry, materials, animation)    runs in the child: writes a .glb of an FBX file
write (timeline, blender_export)                     has Blender export a .glb as FBX

The parent reads and writes .glb files like any other, so that all code for glTF works on FBX.
"""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path

from ...core.errors import InputError
from ..beside import confining_folder
from ..child_process import child_result

CONVERTER = "mimesh.io.fbx.to_glb:write_glb"


@contextlib.contextmanager
def fbx_as_glb(path: Path) -> Iterator[Path]:
    """Convert an FBX file to a temporary .glb, y up and in metres, which is deleted at the end of the block.

    Raises:
        InputError: ufbx is not installed, or the file is damaged or no FBX file.
    """
    if importlib.util.find_spec("ufbx") is None:
        raise InputError(f"{path}: expected ufbx to read FBX, found it not installed; pip install 'mimesh[fbx]'")
    folder = confining_folder()
    with child_result(CONVERTER, path, path, confined_to=None if folder is None else str(folder)) as glb:
        yield glb
