"""What a caller says about both meshes (`Hints`) and about the motion (`MotionOptions`)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..core.errors import InputError
from ..motions.humanoid_rig import HumanoidRig
from .corrections import NO_CORRECTIONS, Corrections
from .look import check_body

Axes = tuple[str | None, str | None, str | None, str | None]
"""Up and front of the identity, up and front of the driving; None is detected."""
NO_AXES: Axes = (None, None, None, None)
RIGS = ("own", "mimesh")
"""Choices of `--rig`: the identity's own rig, if its file has a sound one, or joints found on its surface."""
ROOTS = ("scale", "keep", "drop")


@dataclass(frozen=True, eq=False)
class Hints:
    """What is known of the two meshes; see `pipeline.animate`."""

    axes: Axes = NO_AXES
    rig: str | HumanoidRig = "own"
    """One of RIGS, or the identity's rig itself. Only models with joints use it."""
    body: str = "auto"
    """One of `look.BODIES`."""
    corrections: Corrections = NO_CORRECTIONS

    def __post_init__(self) -> None:
        """Raise InputError if a value is not allowed."""
        if not isinstance(self.rig, HumanoidRig) and self.rig not in RIGS:
            raise InputError(f"--rig: expected one of {', '.join(RIGS)}, found {self.rig!r}; choose one of them")
        check_body(self.body)

    @property
    def asked_body(self) -> str:
        """The body that the user says, or that alone has a joint of a corrected name; else "auto"."""
        return (self.corrections.body or self.body) if self.body == "auto" else self.body


@dataclass(frozen=True)
class MotionOptions:
    """How the joints move; see `pipeline.animate`."""

    root: str = "scale"
    ground: bool = True
    """Has no effect on a single pose, nor with a model without joints."""
    smooth: float = 0.0
    skinned: bool | None = False
    """Move each vertex by its INFLUENCES largest weights, as files of skinned meshes do; None: if the model has joints
    and the clip is more than a pose."""

    @property
    def changes_motion(self) -> bool:
        """Whether the result differs from the driving's motion on the same skeleton."""
        return self.root != "scale" or self.smooth > 0

    def __post_init__(self) -> None:
        """Raise InputError if a value is not allowed."""
        if self.root not in ROOTS:
            raise InputError(f"--root: expected one of {', '.join(ROOTS)}, found {self.root!r}; choose one of them")
        if not 0 <= self.smooth < np.inf:
            raise InputError(f"--smooth: expected seconds, 0 or more, found {self.smooth}; try 0.05")

    def refuse_without_joints(self, model: str) -> None:
        """Raise InputError if a value needs joints, which a model has not."""
        for field in dataclasses.fields(self):
            if field.name != "ground" and getattr(self, field.name) not in (field.default, None):
                raise InputError(
                    f"--{field.name}: expected a model with joints (mime), found {model}; choose it with -m"
                )
