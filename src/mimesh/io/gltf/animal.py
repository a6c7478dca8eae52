"""Reads a rigged four-legged animal of a glTF file in a rest pose in which it stands."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...bodies.animal_limbs import LEGS, name_animal_joints, named_tail
from ...bodies.character_limbs import SIDES
from ...bodies.character_pool import FACING, CharacterMeta, PoolCharacter, facing_rotation
from ...bodies.skinned_character import SkinnedCharacter
from ...core.errors import InputError
from ...core.mesh import Mesh, check_mesh
from .character import NOT_STATED, StandingCharacter, carried_part, moving_nodes, read_clips, rig_at_rest
from .document import Document, open_document
from .motion import bind_poses, is_motion
from .origin import read_origin
from .read import RestScene, read_rest
from .skin import skin_joints

LEG_WORDS = {"front": re.compile("front|fore"), "hind": re.compile("back|hind|rear")}
"""Words in the names of the joints of forelegs and of hind legs."""


def read_rigged_animal(
    path: str | Path, pack: str = "", licence: str = "", left_out: Callable[[str], bool] = lambda name: False
) -> PoolCharacter:
    """Read an animal, turned to face +z, with all of its clips but those that `left_out` names.

    Args:
        licence: of files that do not state one.

    Raises:
        InputError: a damaged file, no mesh, or no four legs on one skeleton.
    """
    path = Path(path)
    document = open_document(path)
    if is_motion(document):
        raise InputError(f"{path}: expected a rigged mesh, found animations without a mesh")
    mesh, scene = read_rest(document)
    standing = read_standing_animal(check_mesh(mesh, path), document, scene)
    turn = facing_rotation(standing.facing)
    rig, nodes = carried_part(standing.rig).turned(turn), standing.nodes
    clips = read_clips(document, standing.scene.T_world_node[nodes], nodes, rig.parents, left_out)
    maker, stated = read_origin(document)
    origin = (path.stem, pack, maker, stated or licence or NOT_STATED, "", "quadruped", "train", standing.facing)
    meta = CharacterMeta(*origin, str(path) * bool(clips))
    joints, order = name_animal_joints(rig, path), np.arange(len(rig.parents))
    return PoolCharacter(meta, rig, joints, {}, clips, rig.parents, order, turn)


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

    Names of legs are believed first (leg-front-left), and a tail that has this name is behind.

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
        tops = {pair: [joints[side + parts[0]] for side in SIDES] for pair, parts in LEGS.items()}
        names = [(pair, turned.joint_names[joint].lower()) for pair in LEGS for joint in tops[pair]]
        said = sum(bool(LEG_WORDS[pair].search(name)) for pair, name in names)
        center = turned.joints[[*tops["front"], *tops["hind"]], 2].mean()
        head = [joints["Head"]] if "Head" in joints else []
        scores[facing] = said, _ahead(turned, head, center) - _ahead(turned, named_tail(turned), center)
    if not scores:
        raise reasons[0]
    return max(scores, key=lambda facing: scores[facing])  # the first, +z, where they are equal


def _ahead(rig: SkinnedCharacter, joints: list[int], center: float) -> float:
    """Compute how far in front of the legs' center joints are, times the share of the vertices that they move."""
    share = rig.joint_weights()[:, joints].mean(axis=0)
    return float(share @ (rig.joints[joints, 2] - center))
