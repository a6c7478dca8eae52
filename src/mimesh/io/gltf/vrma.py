"""Reads and writes VRM animations (.vrma): the glTF extension VRMC_vrm_animation 1.0.

A file has a node for each humanoid bone, in the T-pose where nothing moves it. Animations rotate the nodes and move the
hips. Expressions and the direction of the gaze are nodes of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...bodies.hands import body_with_fingers, hand_joints
from ...bodies.joint_names import ancestors, finger_joints
from ...core.animated_rig import local_rotations
from ...core.geometry import continuous_quaternions, nearest_rotation
from ...core.person_motion import PersonMotion
from ...core.rig import Rig
from ...motions.bone_motion import BoneMotion, bone_joints, t_pose_frames
from ...motions.humanoid_rig import SIDES
from ...motions.retarget import axes_from_rest
from .animation import AnimationChannel, add_animation
from .bake import sample_nodes
from .document import Document
from .draft import Draft
from .keys import KEY_LIMIT, choose_keys, rotation_tolerances
from .scene import local_matrices, world_matrices
from .vrm import vrm_bones

EXTENSION = "VRMC_vrm_animation"


def with_hands(
    played: PersonMotion, document: Document, channels: list[AnimationChannel], times: Float[np.ndarray, " T"]
) -> PersonMotion:
    """Add the fingers of a VRM animation, and the roll of its hands, to the joints of the body that plays it.

    Finger joints stand where the fingers of that body do. They have no weights: the surface shows none of them.
    """
    nodes_of = vrm_bones(document)
    joints = bone_joints(nodes_of)
    nodes = [nodes_of[name] for name in joints]
    rest = world_matrices(document, local_matrices(document))[nodes]
    world = np.concatenate([matrices[:, nodes] for _, matrices in sample_nodes(document, channels, times)])
    return with_posed_hands(played, joints, rest, world)


def with_posed_hands(
    played: PersonMotion,
    joints: tuple[str, ...],
    rest: Float[np.ndarray, "J 4 4"],
    world: Float[np.ndarray, "T J 4 4"],
) -> PersonMotion:
    """As `with_hands`, from the transforms of joints at rest and in every frame, in any axes."""
    axes = axes_from_rest(rest[:, :3, 3], {name: k for k, name in enumerate(joints)})
    frames = t_pose_frames(joints, rest[:, :3, 3] @ axes.T)
    moved = axes @ nearest_rotation(world[..., :3, :3] @ np.linalg.pinv(rest[:, :3, :3])) @ axes.T
    rotation_of = dict(zip(joints, (moved @ frames).swapaxes(0, 1), strict=True))
    for side in SIDES:
        if any(name in joints for name in finger_joints(side)):
            played = _with_hand(played, side, rotation_of)
    return played


def write_vrma(motions: Sequence[BoneMotion], path: Path) -> None:
    """Write motions of one skeleton as a VRM animation in GLB format, with an animation for each.

    Rotations have the keys that interpolation needs; the hips have a key in every frame, from which readers know the
    frame rate.
    """
    first = motions[0]
    parents = first.parents
    nodes: list[dict[str, Any]] = []
    for k, (bone, parent) in enumerate(zip(first.bones, parents, strict=True)):
        step = first.rest[k] - (first.rest[parent] if parent >= 0 else 0.0)
        children = [j for j, above in enumerate(parents) if above == k]
        nodes.append({"name": bone, "translation": step.tolist()} | ({"children": children} if children else {}))
    bones = {bone: {"node": k} for k, bone in enumerate(first.bones)}
    draft = Draft(
        {
            "asset": {"version": "2.0", "generator": "mimesh"},
            "extensionsUsed": [EXTENSION],
            "extensions": {EXTENSION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes,
        }
    )
    draft.gltf["animations"] = [_animation(draft, motion) for motion in motions]
    draft.save(path)


def _with_hand(played: PersonMotion, side: str, rotation_of: dict[str, Float[np.ndarray, "T 3 3"]]) -> PersonMotion:
    """Replace the rotation of a hand and its finger stubs by that of the hand and its fingers."""
    body = body_with_fingers()
    names = list(played.joints)
    hand = names.index(f"{side}Hand")
    of_hand = hand_joints(played.joints, side)
    kept = [j for j in range(len(names)) if j == hand or j not in of_hand]
    fingers = [name for name in finger_joints(side) if name in rotation_of]
    rotation, positions = played.rotation.copy(), played.positions
    rotation[:, hand] = rotation_of[f"{side}Hand"]
    # Fingers are placed from the hand outwards by the bones of the body.
    place = {f"{side}Hand": positions[:, hand]}
    turn = {f"{side}Hand": rotation[:, hand]} | {name: rotation_of[name] for name in fingers}
    for name in fingers:
        chain = ancestors(body.parents, body.joint(name))[1:]
        above = next(body.joint_names[j] for j in chain if body.joint_names[j] in place)
        bone = body.joints[body.joint(name)] - body.joints[body.joint(above)]
        place[name] = place[above] + turn[above] @ bone
    weights = played.weights
    if weights is not None:
        weights = weights.copy()
        weights[:, hand] = weights[:, of_hand].sum(axis=1)
        weights = np.pad(weights[:, kept], ((0, 0), (0, len(fingers))))
    return replace(
        played,
        joints=(*(names[j] for j in kept), *fingers),
        rotation=np.concatenate([rotation[:, kept], *(turn[name][:, None] for name in fingers)], axis=1),
        positions=np.concatenate([positions[:, kept], *(place[name][:, None] for name in fingers)], axis=1),
        weights=weights,
    )


def _animation(draft: Draft, motion: BoneMotion) -> dict[str, Any]:
    """Add an animation of all bones: their rotations, and the translation of the hips."""
    from scipy.spatial.transform import Rotation

    local = local_rotations(motion.rotation, motion.parents)
    quaternions = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_quat().reshape(*local.shape[:2], 4)
    quaternions = continuous_quaternions(quaternions)
    is_key = choose_keys(quaternions.swapaxes(0, 1), _tolerances(motion), rotations=True)
    times = np.arange(len(motion.hips)) / motion.fps
    channels = [AnimationChannel(0, "translation", times, motion.hips)]
    for node, keys in enumerate(is_key):
        channels.append(AnimationChannel(node, "rotation", times[keys], quaternions[keys, node]))
    return add_animation(draft, motion.name, channels)


def _tolerances(motion: BoneMotion) -> Float[np.ndarray, " J"]:
    """Compute the error of each bone's rotation (radians) with which no joint moves farther than KEY_LIMIT heights."""
    count = len(motion.joints)
    rig = Rig(np.tile(np.eye(3), (count, 1, 1)), motion.rest, np.eye(count))
    return rotation_tolerances(motion.rest, rig, motion.parents, KEY_LIMIT * float(np.ptp(motion.rest[:, 1])))
