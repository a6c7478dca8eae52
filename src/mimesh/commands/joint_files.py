"""Files of corrected joints that `mimesh transfer` and `mimesh animate` read and write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .terminal import refuse_inputs

if TYPE_CHECKING:
    from ..core.joint_corrections import JointCorrections
    from ..pipeline.result import ClipResult, Result

MOST_NAMED = 6
"""Corrected joints up to which their names are printed."""


@dataclass(frozen=True)
class JointFiles:
    """Corrected joints of both inputs."""

    identity: JointCorrections | None
    driving: JointCorrections | None
    beside: tuple[str, ...] = ()
    """Paths of those found beside the inputs."""

    @classmethod
    def found(
        cls,
        identity: Path,
        driving: Path,
        joints: Path | None,
        driving_joints: Path | None,
        no_joints: bool,
        model: str,
    ) -> JointFiles:
        """Read the files that were given, else those beside the inputs; only models with joints use the latter."""
        from ..io.joint_file import load_corrections, side_file
        from ..methods.base import CorrectableMethod
        from ..methods.find import find_method

        corrections, found = [], []
        for mesh, given in ((identity, joints), (driving, driving_joints)):
            beside = side_file(mesh)
            usable = not no_joints and beside.is_file() and isinstance(find_method(model), CorrectableMethod)
            path = given or (beside if usable else None)
            found += [str(beside)] if usable and given is None else []
            corrections.append(None if path is None else load_corrections(path))
        return cls(corrections[0], corrections[1], tuple(found))

    def described(self) -> tuple[str, ...]:
        """Return a line for each of the files that was used."""
        lines = []
        for corrections in filter(None, (self.identity, self.driving)):
            names, count = ", ".join(corrections.positions), len(corrections.positions)
            what = f"{count} joints" if count > MOST_NAMED else names or "none"
            beside = " (--no-joints ignores it)" if corrections.source in self.beside else ""
            lines.append(f"{what} as in {corrections.source}{beside}")
        return tuple(lines)


def check_joint_outputs(paths: tuple[Path | None, Path | None], model: str, *others: Path) -> None:
    """Check that a model has joints to write, and that they are written to .json files that are no inputs."""
    from ..core.errors import InputError
    from ..methods.base import SkinnedMethod
    from ..methods.find import find_method

    for path, option in zip(paths, ("--save-joints", "--save-driving-joints"), strict=True):
        if path is None:
            continue
        if not isinstance(find_method(model), SkinnedMethod):
            raise InputError(f"{option}: expected a model with joints (mime), found {model}; choose it with -m")
        refuse_inputs(path, *others)
        if path.suffix.lower() != ".json":
            raise InputError(f"{path}: expected a .json file for the joints, found '{path.suffix}'; rename it")


def save_joint_files(
    result: Result | ClipResult,
    identity: Path,
    driving: Path,
    save_joints: Path | None,
    save_driving_joints: Path | None,
    frame: int = 0,
) -> None:
    """Write the joints that were found to the files that were asked for; `frame` is the first driving frame taken."""
    from ..core.joint_corrections import JointCorrections
    from ..io.joint_file import save_corrections

    clip = result.driving_clip
    outputs = (
        (save_joints, identity, result.joints, result.mesh, 0),
        (save_driving_joints, driving, result.driving_joints, None if clip is None else clip.mesh, frame),
    )
    for path, file, joints, mesh, t in outputs:
        if path is not None and joints is not None and mesh is not None:
            save_corrections(JointCorrections(joints, t, file.name, len(mesh.vertices)), path)
