"""Makes rigs and motions of bones that another program has, given as names, parents and matrices.

Blender's extension calls these functions. Axes and unit are those of the program: up may be any axis, as options say.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_pool import facing_rotation
from ..bodies.joint_names import person_joints
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.geometry import nearest_rotation
from ..core.mesh import Clip, Mesh, stored_clip
from ..core.normalization import ORIENTATIONS, ROTATIONS, axis_name
from ..core.person_motion import KnownJoints, PersonMotion
from ..core.rig import local_rotations
from ..io.gltf.character import NO_PERSON, carried_part, standing_facing
from ..io.gltf.own_rig import check_sound
from ..motions.animal_rig import animal_facing, animal_rig
from ..motions.bvh import Bvh
from ..motions.humanoid_rig import HumanoidRig, humanoid_rig
from ..motions.motion import LEG, leg_length
from ..motions.on_body import on_body
from ..motions.rest_calibration import axes_from_motion
from ..motions.retarget import axes_from_rest, rests_standing

FORWARD = {"+z": "-y", "-z": "+y"}
"""Where characters face by custom, for each up axis: in Blender the front view looks along +y. Others: +z."""


@dataclass(frozen=True, eq=False)
class Bones:
    """A skeleton at rest, in the axes and unit of the program."""

    name: str
    """In error messages."""
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for roots; parents come before their children."""
    T_world_joint: Float[np.ndarray, "J 4 4"]
    """Transform of each joint at rest."""


@dataclass(frozen=True, eq=False)
class Binding:
    """The joints and weights of the vertices of a mesh; K influences a vertex, of which some may have no weight."""

    joint_of: Int[np.ndarray, "V K"]
    """Index J is the world, which does not move."""
    weights: Float[np.ndarray, "V K"]
    """Rows sum to 1."""


def rig_of_bones(
    mesh: Mesh, bones: Bones, binding: Binding, up: str = "+y", front: str | None = None, body: str = "auto"
) -> HumanoidRig:
    """Make the rig of a person or of a four-legged animal (an `AnimalRig`), which `animate` takes as `rig`.

    Args:
        mesh: at rest.
        up: axis of the program away from the ground.
        front: axis to the front; None: found from the joints and the feet, of an animal from the head.
        body: `human` or `quadruped`; "auto": as an animal is read what is no person.

    Raises:
        InputError: the joints are not those of a person or an animal who stands, have no weights, or are scaled
            unequally.
    """
    joints = np.tile(np.eye(4), (len(bones.parents), 1, 1))
    joints[:, :3, :3] = nearest_rotation(bones.T_world_joint[:, :3, :3])
    joints[:, :3, 3] = bones.T_world_joint[:, :3, 3]
    points = np.repeat(mesh.vertices[:, None], binding.weights.shape[1], axis=1)
    rig = SkinnedCharacter(mesh, bones.joint_names, bones.parents, joints, binding.joint_of, binding.weights, points)
    check_sound(rig, bones.T_world_joint, bones.name)
    upright = ROTATIONS[ORIENTATIONS.index((up, front or FORWARD.get(up, "+z")))]
    if body == "quadruped":
        return _animal(rig, upright, front, bones.name)
    try:
        return _person(rig, upright, front, bones.name)
    except NO_PERSON:
        if body == "auto":
            with contextlib.suppress(InputError):  # of neither, the first reason says more
                return _animal(rig, upright, front, bones.name)
        raise


def _person(rig: SkinnedCharacter, upright: Float[np.ndarray, "3 3"], front: str | None, name: str) -> HumanoidRig:
    facing = "+z" if front else standing_facing(rig.turned(upright), {}, "+z", name, fallen=True)
    no_poses = np.zeros((0, len(rig.parents), 4, 4))
    return humanoid_rig(rig, facing_rotation(facing) @ upright, {}, lambda: no_poses, name)[0]


def _animal(rig: SkinnedCharacter, upright: Float[np.ndarray, "3 3"], front: str | None, name: str) -> HumanoidRig:
    facing = "+z" if front else animal_facing(carried_part(rig.turned(upright)), name)
    return animal_rig(rig, facing_rotation(facing) @ upright, name)[0]


@dataclass(frozen=True, eq=False)
class BoneJoints:
    """The bones of a driving mesh in the frames of its clip (`Clip.skeleton`)."""

    mesh: Mesh
    """At rest, with the vertices of the clip."""
    bones: Bones
    binding: Binding
    T_world_joint: Float[np.ndarray, "T J 4 4"]
    up: str = "+y"
    front: str | None = None
    body: str = "human"
    """Body whose joints are read."""

    @property
    def has_joints(self) -> bool:
        """Whether there are any: yes."""
        return True

    def cut(self, frames: slice) -> BoneJoints:
        """Select frames of the clip."""
        return replace(self, T_world_joint=self.T_world_joint[frames])

    def person(self) -> PersonMotion:
        """Read the joints of a person or an animal, as `body` says."""
        _check_finite(self.T_world_joint, self.bones.name)
        rig = rig_of_bones(self.mesh, self.bones, self.binding, self.up, self.front, self.body)
        place = {name: j for j, name in enumerate(self.bones.joint_names)}
        chosen = [place[rig.character.joint_names[rig.joints[name]]] for name in rig.person]
        return rig.motion(self.T_world_joint[:, chosen], self.bones.T_world_joint[chosen])


def clip_of_bones(
    bones: Bones, T_world_joint: Float[np.ndarray, "T J 4 4"], fps: float, front: str | None = None
) -> Clip:
    """Play the motion of a skeleton without a mesh on the shipped body: y up, in the unit of the skeleton.

    Args:
        front: axis to the person's front, in the axes of the skeleton; None: that of the rest pose, or of the hips in
            the first frame where the rest pose does not tell.

    Raises:
        InputError: the joints are not those of a person, or NaN or infinity in a frame.
    """
    _check_finite(T_world_joint, bones.name)
    rest = bones.T_world_joint
    rotation = nearest_rotation(T_world_joint[..., :3, :3] @ np.linalg.pinv(rest[:, :3, :3]))
    clip = stored_clip(on_body(_skeleton(bones, rotation, T_world_joint[..., :3, 3], fps), bones.name).clip())
    assert isinstance(clip.skeleton, KnownJoints)
    joints, motion = person_joints(bones.joint_names, bones.parents), clip.skeleton.motion
    clip, motion = _scaled(clip, motion, leg_length(rest[[joints[name] for name in LEG], :3, 3], LEG) / motion.leg)
    if front is None:
        return clip
    standing = rests_standing(rest[:, :3, 3], joints)
    axes = axes_from_rest(rest[:, :3, 3], joints) if standing else axes_from_motion(T_world_joint[..., :3, 3], joints)
    ahead = axes @ ROTATIONS[[pair[1] for pair in ORIENTATIONS].index(front)][2]
    skeleton = KnownJoints(replace(motion, front=axis_name(ahead)))
    return replace(clip, headings=np.tile(ahead, (len(clip), 1)), skeleton=skeleton)


def _skeleton(
    bones: Bones, rotation: Float[np.ndarray, "T J 3 3"], position: Float[np.ndarray, "T J 3"], fps: float
) -> Bvh:
    """Make a skeleton with one root, of world rotations since rest and positions; every joint may slide."""
    rest, parents = bones.T_world_joint[:, :3, 3], np.array(bones.parents)
    names = bones.joint_names
    if (parents < 0).sum() > 1:  # a new root, which stays where it is
        names, parents = ("world", *names), np.append(-1, parents + 1)
        rest = np.concatenate([np.zeros((1, 3)), rest])
        position = np.pad(position, ((0, 0), (1, 0), (0, 0)))
        rotation = np.concatenate([np.tile(np.eye(3), (len(rotation), 1, 1, 1)), rotation], axis=1)
    above = np.maximum(parents, 0)
    offsets = np.where(parents[:, None] >= 0, rest - rest[above], rest)
    steps = (rotation[:, above].swapaxes(-1, -2) @ (position - position[:, above])[..., None])[..., 0]
    moved = {j: steps[:, j] for j in range(1, len(parents))}
    order = tuple(parents.tolist())
    return Bvh(bones.name, names, order, offsets, {}, local_rotations(rotation, order), position[:, 0], fps, moved)


def _scaled(clip: Clip, motion: PersonMotion, scale: float) -> tuple[Clip, PersonMotion]:
    mesh = replace(clip.mesh, vertices=scale * clip.mesh.vertices)
    for frame in clip.vertices:  # may be on disk
        frame *= scale
    at_rest = None if motion.rest_vertices is None else scale * motion.rest_vertices
    rest = None if motion.rest is None else (motion.rest[0], scale * motion.rest[1])
    positions, leg = scale * motion.positions, scale * motion.leg
    motion = replace(motion, positions=positions, leg=leg, rest_vertices=at_rest, rest=rest)
    return replace(clip, mesh=mesh, skeleton=KnownJoints(motion)), motion


def _check_finite(transforms: Float[np.ndarray, "T J 4 4"], name: str) -> None:
    if not np.isfinite(transforms).all():
        raise InputError(f"{name}: expected finite joints, found NaN or infinity; repair the animation")
