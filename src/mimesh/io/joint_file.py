"""Read and write the positions of joints that a user has picked: a small JSON file beside the mesh.

    {"format": "mimesh joints", "version": 1, "mesh": "hero.glb", "vertices": 5310, "size": 1.76, "frame": 0,
     "joints": {"LeftLeg": [0.11, 0.52, 0.02]}}

Positions are in the axes, unit and position of the mesh's file. `frame` counts from 0 in a clip, `size` is the longest
side of the mesh's bounding box. `mesh`, `vertices`, `size` and `frame` may be missing.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.joint_corrections import JointCorrections
from ..core.system import refuse_pipe
from .atomic import whole_file, writing

FORMAT, VERSION = "mimesh joints", 1
SUFFIX = ".joints.json"
MAX_BYTES = 2**20
"""Size of a file above which it is not read: 31 joints take 3 KiB."""


def side_file(mesh: Path) -> Path:
    """Return the path of the corrections that belong to a mesh, a clip or a folder of frames: hero.glb has
    hero.joints.json.
    """
    mesh = mesh if mesh.name else mesh.resolve()
    return mesh.with_name((mesh.name if mesh.is_dir() else mesh.stem) + SUFFIX)


def load_corrections(path: str | Path) -> JointCorrections:
    """Read corrections.

    Raises:
        InputError: no such file, not one of this format and version, or positions that are not three finite numbers.
    """
    path = Path(path)
    refuse_pipe(path)
    if not path.is_file():
        raise InputError(f"{path}: expected a file of joints, found none; check the path")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: expected a file of joints, found {path.stat().st_size:,} bytes; check the path")
    try:
        values = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected joints as JSON, found '{str(error)[:80]}'; correct that place") from None
    source = str(path)
    if not isinstance(values, dict) or not isinstance(values.get("joints"), dict):
        raise InputError(f'{source}: expected an object with "joints", found none; see docs/formats.md')
    if values.get("format", FORMAT) != FORMAT or values.get("version", VERSION) != VERSION:
        found = f"{values.get('format')!r} version {values.get('version')!r}"[:80]
        raise InputError(f"{source}: expected {FORMAT!r} version {VERSION}, found {found}; update mimesh")
    frame, vertices = values.get("frame", 0), values.get("vertices")
    for name, number in (("frame", frame), ("vertices", 0 if vertices is None else vertices)):
        if isinstance(number, bool) or not isinstance(number, int) or number < 0:
            raise InputError(f"{source}: expected a whole number for {name}, found {str(number)[:40]!r}; correct it")
    mesh, size = str(values.get("mesh", "")), values.get("size")
    if size is not None and (isinstance(size, bool) or not isinstance(size, (int, float)) or not 0 < size < np.inf):
        raise InputError(f"{source}: expected a positive number for size, found {str(size)[:40]!r}; correct it")
    return JointCorrections.of(values["joints"], source, frame=frame, vertices=vertices, mesh=mesh, size=size)


def describe_corrections(corrections: JointCorrections) -> dict[str, Any]:
    """Return the contents of a file with these corrections."""
    size = None if corrections.size is None else float(f"{corrections.size:.7g}")
    known = {"mesh": corrections.mesh or None, "vertices": corrections.vertices, "size": size}
    head = {"format": FORMAT, "version": VERSION} | {key: value for key, value in known.items() if value is not None}
    joints = {name: [float(f"{x:.7g}") for x in position] for name, position in corrections.positions.items()}
    return {**head, "frame": corrections.frame, "joints": joints}


def save_corrections(corrections: JointCorrections, path: str | Path) -> Path:
    """Write corrections, one joint a line."""
    values = describe_corrections(corrections)
    joints = values.pop("joints")
    rows = ",\n".join(f"    {json.dumps(name)}: {json.dumps(position)}" for name, position in joints.items())
    head = "".join(f"  {json.dumps(key)}: {json.dumps(value)},\n" for key, value in values.items())
    text = f'{{\n{head}  "joints": {{\n{rows}\n  }}\n}}\n' if joints else f'{{\n{head}  "joints": {{}}\n}}\n'
    path = Path(path)
    with writing(path), whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return path
