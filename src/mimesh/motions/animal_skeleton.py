"""Play the motion of a four-legged animal's skeleton, which has no mesh, on the shipped quadruped.

Joints are found as those of a rigged mesh (`animal_rig`), with points along the bones in place of a surface.
"""

from __future__ import annotations

import contextlib

import numpy as np
from jaxtyping import Float

from ..bodies.character_pool import facing_rotation
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.geometry import rotation_between
from ..core.mesh import Mesh
from ..core.rig import homogeneous, local_rotations
from .animal_rig import animal_facing, animal_rig
from .bvh import Bvh
from .motion import Motion, leg_length
from .retarget import on_floor

UPS = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Directions away from the ground that a rest pose is tried in, in this order."""
STEPS = 8
"""Points along each bone."""
NEAR_GROUND = 0.3
"""Height, in heights of the skeleton, up to which the end of a chain is a foot. Captured foxes have 0.2."""


def retarget_animal(source: Bvh) -> Motion | None:
    """Retarget the motion of an animal to the shipped quadruped, at its frame rate; None if none rests on four legs.

    The trunk is taken for level at rest. The root's path is scaled by the ratio of leg lengths and starts above the
    origin; the floor is estimated from the result, as in `retarget_skeleton`. Joints that the source lacks are not
    rotated.
    """
    for up in np.array(UPS):
        upright, figure = rotation_between(up, np.array(UPS[0])), _stick_figure(source, up)
        with contextlib.suppress(InputError):
            facing = animal_facing(figure.turned(upright), source.name)
            rig, order = animal_rig(figure, facing_rotation(facing) @ upright, source.name)
            break
    else:
        return None
    body, (rotation, position) = rig.body, source.world()
    target = np.empty((len(rotation), len(body.joint_names), 3, 3))
    for j, (joint, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        known = rig.joints.get(joint)
        target[:, j] = target[:, parent] if known is None else rig.turn @ rotation[:, order[known]] @ rig.frames[joint]
    scale = leg_length(body.joints, body.joint_names) / rig.leg
    path = on_floor(position[:, order[rig.joints["Hips"]]] @ rig.turn.T * scale, target, body)
    return Motion(source.name, body.joint_names, local_rotations(target, body.parents), path, source.fps)


def _stick_figure(source: Bvh, up: Float[np.ndarray, " 3"]) -> SkinnedCharacter:
    """Make a character of points along the bones of a skeleton at rest; each bone moves with the joint at its top.

    Chains that end near the ground reach it: rest poses of captures may stand on two of four feet.
    """
    rest, names = source.rest(), source.joint_names
    bones = [(parent, rest[j]) for j, parent in enumerate(source.parents) if parent >= 0]
    ends = [(j, rest[j] + source.ends.get(names[j], 0.0)) for j in range(len(rest)) if j not in source.parents]
    heights = np.array([tail for _, tail in (*bones, *ends)]) @ up
    low, reach = heights.min(), NEAR_GROUND * np.ptp(heights)
    bones += [*ends, *((j, end - (end @ up - low) * up) for j, end in ends if end @ up < low + reach)]
    joint = np.repeat([top for top, _ in bones], STEPS)
    share = np.tile(np.linspace(0, 1, STEPS), len(bones))[:, None]
    points = rest[joint] * (1 - share) + np.repeat([tail for _, tail in bones], STEPS, axis=0) * share
    mesh = Mesh(points, np.zeros((0, 3), int), name=source.name)
    one, frames = np.ones((len(points), 1)), homogeneous(np.tile(np.eye(3), (len(rest), 1, 1)), rest)
    return SkinnedCharacter(mesh, names, source.parents, frames, joint[:, None], one, points[:, None])
