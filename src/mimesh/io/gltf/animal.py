"""Reads the rig of a four-legged animal of a glTF file in a rest pose in which it stands."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...bodies.animal_limbs import LEGS, name_animal_joints
from ...bodies.character_limbs import SIDES
from ...bodies.character_pool import FACING, facing_rotation
from ...bodies.skinned_character import SkinnedCharacter
from ...core.errors import InputError
from ...core.mesh import Mesh
from .character import StandingCharacter, carried_part, moving_nodes, rig_at_rest
from .document import Document
from .motion import bind_poses
from .read import RestScene
from .skin import skin_joints


def read_standing_animal(mesh: Mesh, document: Document, scene: RestScene) -> StandingCharacter:
    """Read the rig of a scene in its bind pose, or in the pose of the file's nodes where it stands in none.

    Raises:
        InputError: there are no four legs on one skeleton.
    """
    joint_nodes = skin_joints(document, scene) or moving_nodes(document)
    for T_world_node in bind_poses(document):
        bound = dataclasses.replace(scene, T_world_node=T_world_node)
        try:
            return _standing(mesh, document, bound, joint_nodes)
        except InputError:
            continue  # the bind pose may have another orientation
    return _standing(mesh, document, scene, joint_nodes)


def _standing(mesh: Mesh, document: Document, scene: RestScene, joint_nodes: set[int]) -> StandingCharacter:
    rig, nodes = rig_at_rest(mesh, document, scene, joint_nodes)
    return StandingCharacter(rig, nodes, animal_facing(carried_part(rig), document.path), {}, scene)


def animal_facing(rig: SkinnedCharacter, path: object) -> str:
    """Find where an animal faces: where the largest part that sticks out from its legs, the head, is in front.

    Raises:
        InputError: there are no four legs on one skeleton, whatever it faces.
    """
    scores, reasons = {}, []
    for facing in filter(None, FACING):
        turned = rig.turned(facing_rotation(facing))
        try:
            joints = name_animal_joints(turned, path)
        except InputError as error:
            reasons.append(error)
            continue
        tops = [joints[side + parts[0]] for side in SIDES for parts in LEGS.values()]
        ahead = 0.0
        if "Head" in joints:
            share = turned.summed_weights((np.arange(len(turned.parents) + 1) == joints["Head"]).astype(int), 2)[
                :, 1
            ].mean()
            ahead = share * (turned.joints[joints["Head"], 2] - turned.joints[tops, 2].mean())
        scores[facing] = ahead
    if not scores:
        raise reasons[0]
    return max(scores, key=lambda facing: scores[facing])  # the first, +z, where they are equal
