"""Files of corrected joints that commands read, and files of found joints that they write."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.options import Hints
from .options import JointOptions
from .terminal import refuse_inputs

if TYPE_CHECKING:
    from ..core.mesh import Mesh
    from ..pipeline.result import ClipResult, Result

MOST_NAMED = 6
"""Corrected joints up to which their names are printed."""


def with_joint_files(
    hints: Hints, identity: Path, driving: Path | None, joints: JointOptions, model: str
) -> tuple[Hints, tuple[str, ...]]:
    """Read the files of corrected joints that were given, else those beside the inputs if the model has joints.

    Returns:
        The hints with the corrections, and a line for each file that was used.
    """
    from ..io.joint_file import load_corrections, side_file
    from ..methods.find import moves_joints

    read, lines = {}, []
    for name, mesh in (("joints", identity), ("driving_joints", driving)):
        path, beside = getattr(hints, name), ""
        if path is None and mesh and not joints.no_joints and side_file(mesh).is_file() and moves_joints(model):
            path, beside = side_file(mesh), " (--no-joints ignores it)"
        if path is not None:
            read[name] = load_corrections(path)
            named, count = read[name].positions, len(read[name].positions)
            known = f"{count} joints" if count > MOST_NAMED else ", ".join(named) or "none"
            lines.append(f"{known} as in {read[name].source}{beside}")
    return dataclasses.replace(hints, **read), tuple(lines)


def saved_joints(joints: JointOptions) -> tuple[Path | None, Path | None]:
    """Return the files of joints that are written."""
    return joints.save_joints, joints.save_driving_joints


def check_joint_outputs(joints: JointOptions, model: str, *others: Path | None) -> None:
    """Check that a model has joints to write, and that they are written to .json files that are no inputs."""
    from ..core.errors import InputError
    from ..core.options import needs_joints
    from ..methods.find import moves_joints

    for path, name in zip(saved_joints(joints), ("save_joints", "save_driving_joints"), strict=True):
        if path is None:
            continue
        if not moves_joints(model):
            raise needs_joints(name, model)
        refuse_inputs(path, *others)
        if path.suffix.lower() != ".json":
            raise InputError(f"{path}: expected a .json file for the joints, found '{path.suffix}'; rename it")


def save_joint_files(
    result: Result | ClipResult, identity: Path, driving: Path, joints: JointOptions, frame: int = 0
) -> None:
    """Write the joints that were found to the files that were asked for; `frame` is the first driving frame taken."""
    clip = result.driving_clip
    save_found(result.joints, joints.save_joints, identity, result.identity)
    save_found(result.driving_joints, joints.save_driving_joints, driving, None if clip is None else clip.mesh, frame)


def save_found(joints: Any, path: Path | None, file: Path, mesh: Mesh | None, frame: int = 0) -> None:
    """Write the joints that were found on a mesh to a file, to be edited, if there is one."""
    from ..core.joint_corrections import JointCorrections
    from ..io.joint_file import save_corrections

    if path is not None and joints is not None and mesh is not None:
        save_corrections(JointCorrections.found_on(mesh.vertices, joints, frame, file.name), path)
