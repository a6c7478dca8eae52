"""The joints of a body model in SMPL's layout as those of a person: its rig, and their motion in a recording.

Files do not name their joints. Their order is that of the published models: 22 of the body, then the two hands (SMPL),
the fingers (SMPL+H), or jaw, eyes and fingers (SMPL-X). Models of other numbers of joints, as of animals, have no rig.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..bodies.skinned_character import SkinnedCharacter
from ..bodies.smpl_model import SmplModel
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..core.person_motion import PersonMotion
from ..core.rig import homogeneous
from .amass import FACE, FINGERS, JOINTS
from .humanoid_rig import HumanoidRig, humanoid_rig

_HANDS = ("left_hand", "right_hand")
NAMES = {len(names): names for names in ((*JOINTS, *more) for more in (_HANDS, FINGERS, (*FACE, *FINGERS)))}
"""Number of joints of a model of people -> their names, in order."""


MEAN = np.zeros(0)
"""Coefficients of the mean shape."""


def smpl_rig(model: SmplModel, shape: Float[np.ndarray, " K"] = MEAN) -> HumanoidRig:
    """Make the rig of a body model of a shape, in the model's axes: y up, facing +z.

    `animate` takes it as `rig` of an identity with the model's vertices.

    Raises:
        InputError: a model whose joints are not those of a person (NAMES), or have no weights.
    """
    vertices, joints = model.shaped(shape)
    count = len(joints)
    if count not in NAMES:
        known = ", ".join(map(str, NAMES))
        raise InputError(
            f"{model.name}: expected a body model of people ({known} joints), found {count} joints; give no rig"
        )
    influences = np.tile(np.arange(count), (len(vertices), 1))
    points = np.repeat(vertices[:, None], count, axis=1)
    mesh = Mesh(vertices, model.faces, model.name)
    character = SkinnedCharacter(mesh, NAMES[count], model.parents, _rest(joints), influences, model.weights, points)
    return humanoid_rig(character, np.eye(3), {}, lambda: np.zeros((0, count, 4, 4)), model.name)[0]


@dataclass(frozen=True, eq=False)
class RecordedJoints:
    """The joints of a body model in the frames of a recording (`Clip.skeleton`)."""

    model: SmplModel
    shape: Float[np.ndarray, " K"]
    rotmat: Float[np.ndarray, "T J 3 3"]
    """Rotation of each joint in its parent's frame; of the root in the world of the file."""
    root: Float[np.ndarray, "T 3"]
    """Translation of the body in the world of the file."""
    axes: Float[np.ndarray, "3 3"]
    """Rotation from the axes of the file to those of the clip: y up."""

    @property
    def has_joints(self) -> bool:
        """Whether the model is one of people, whose joints are known."""
        return len(self.model.parents) in NAMES

    def cut(self, frames: slice) -> RecordedJoints:
        """Select frames of the clip."""
        return replace(self, rotmat=self.rotmat[frames], root=self.root[frames])

    def person(self) -> PersonMotion:
        """Compute the joints of the person."""
        rig = smpl_rig(self.model, self.shape)
        joints = self.model.shaped(self.shape)[1]
        rotation, translation = self.model.skinning_transforms(joints, self.rotmat, self.root)
        positions = (rotation @ joints[..., None])[..., 0] + translation
        world = homogeneous(self.axes @ rotation, positions @ self.axes.T)
        place = {name: j for j, name in enumerate(NAMES[len(joints)])}
        chosen = [place[rig.character.joint_names[rig.joints[name]]] for name in rig.person]
        return rig.motion(world[:, chosen], _rest(joints)[chosen])


def _rest(joints: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 4 4"]:
    return homogeneous(np.tile(np.eye(3), (len(joints), 1, 1)), joints)
