"""Find the joints of rigs whose names say nothing: by the joints that a method predicts for the same surface."""

from __future__ import annotations

import dataclasses
from typing import TypeGuard

from ..bodies import load_body
from ..bodies.character_limbs import FindJoints, match_joints
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..core.normalization import Normalization
from ..core.rig import Rig
from ..methods.base import Method, QuickPredictor, RigMethod
from ..methods.confidence import Confidence
from .orientation import normalised, reorient


def finds_joints(method: Method) -> TypeGuard[RigMethod]:
    """Return whether a method predicts the joints of the shipped body, which those of other rigs are compared with."""
    return isinstance(method, RigMethod) and method.joints == load_body().joint_names


def joint_finder(method: RigMethod, axes: tuple[str | None, str | None]) -> FindJoints:
    """Make the function that finds a character's joints.

    Args:
        axes: up and front of the character; None is detected.
    """

    def find(rig: SkinnedCharacter) -> dict[str, int]:
        mesh = dataclasses.replace(rig.mesh, up="+y")
        norm, body, confidence = predicted_body(method, mesh, axes)
        if not confidence.recognised:
            raise InputError(
                f"{mesh.name}: expected joints with the names of a person's, or the shape of a person, found neither; "
                "rename the joints, for example LeftUpLeg, LeftArm"
            )
        return match_joints(rig, dataclasses.replace(body, joints=norm.undo(body.joints)), mesh.name)

    return find


def predicted_body(
    method: RigMethod, mesh: Mesh, axes: tuple[str | None, str | None]
) -> tuple[Normalization, Rig, Confidence]:
    """Predict the joints of a mesh, in another orientation where the first is wrong; returns its normalisation, too."""
    norm = Normalization.fit(mesh, *axes)
    body, confidence = method.predict_rig(normalised(mesh, norm))
    other = reorient(method, mesh, norm, axes, confidence) if isinstance(method, QuickPredictor) else norm
    if other is not norm:
        norm = other
        body, confidence = method.predict_rig(normalised(mesh, norm))
    return norm, body, confidence
