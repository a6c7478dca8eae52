"""Poses of the shipped body on characters of a pool, poses of such characters on the shipped body, and landmarks.

As in `cross_body.pose_on_rig`, each limb is turned from its own direction at rest to that of the shipped body, so a
pose means the same directions in the world for every character. Limbs are given by their ends, so that figures without
hands or with one joint a limb take poses too: an arm of one joint has the direction from the body's shoulder to its
wrist. Joints that a character lacks follow their parents.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody
from ..bodies.body_model import EXTREMES, LANDMARKS, NEAR, landmarks
from ..bodies.character_limbs import SIDES, TAILS
from ..bodies.character_pool import PoolCharacter
from ..core.geometry import rotation_between
from ..core.rig import local_rotations
from ..motions.animal_rig import rest_directions
from .cross_body import as_body
from .pairs import human

FRONTAL = np.array([1.0, 1.0, 0.0])
"""Mask of the frontal plane: feet get only this part of their shin's calibration; see `retarget.alignments`."""


def pose_character(character: PoolCharacter, rotmat: Float[np.ndarray, "B 3 3"]) -> Float[np.ndarray, "K 4 4"]:
    """Compute the transforms of a character's joints, from rest, that give it a pose of the shipped body."""
    body, rig, aligned = human(), character.rig, rest_alignments(character)
    rotation, translation = body.skinning_transforms(body.joints, rotmat)
    posed = np.einsum("jkl,jl->jk", rotation, body.joints) + translation
    named = {}
    for name, joint in character.joints.items():
        turned = rotation[body.joint(name)]
        if tail := body_tail(character, name):
            # A limb of one joint also turns from the direction of the body's upper arm to that of the whole arm.
            head, end = body.joint(name), body.joint(tail)
            turned = (
                rotation_between(turned @ (body.joints[end] - body.joints[head]), posed[end] - posed[head]) @ turned
            )
        named[joint] = turned @ aligned.get(name, np.eye(3)).T
    hips = named[character.joints["Hips"]]
    world = np.empty((len(rig.parents), 3, 3))
    for j, parent in enumerate(rig.parents):
        world[j] = named[j] if j in named else world[parent] if parent >= 0 else hips
    return rig.skinning_transforms(local_rotations(world[None], rig.parents)[0])


def body_pose(character: PoolCharacter, transforms: Float[np.ndarray, "K 4 4"]) -> Float[np.ndarray, "B 3 3"]:
    """Compute the local joint rotations that give the shipped body a pose of a character; see `body_poses`."""
    return body_poses(character, transforms[None])[0]


def body_poses(
    character: PoolCharacter, transforms: Float[np.ndarray, "T K 4 4"], body: RiggedBody | None = None
) -> Float[np.ndarray, "T B 3 3"]:
    """Compute the local joint rotations that give a shipped body poses of a character.

    Args:
        transforms: of each joint of the character from rest to the poses.
        body: the shipped body whose joints the character has; None: the human.
    """
    body = body or human()
    of_animal = body.name == "quadruped"
    aligned = animal_alignments(character, body) if of_animal else rest_alignments(character)
    world = np.empty((len(transforms), len(body.parents), 3, 3))
    for j, (name, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        if name in character.joints:
            world[:, j] = transforms[:, character.joints[name], :3, :3] @ aligned.get(name, np.eye(3))
        else:
            world[:, j] = world[:, parent] if parent >= 0 else np.eye(3)
    return local_rotations(world, body.parents)


def rest_alignments(character: PoolCharacter) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute the rotation of each limb joint from the shipped body's direction at rest to the character's.

    Hands get that of the forearm; feet and toes get the part of the shin's in the frontal plane.
    """
    body, aligned = human(), {}
    for side in SIDES:
        for part in TAILS:
            if tail := body_tail(character, side + part):
                limb = character.limbs[side + part]
                ours, theirs = (
                    body.joints[body.joint(tail)] - body.joints[body.joint(side + part)],
                    limb.end - limb.start,
                )
                aligned[side + part] = rotation_between(ours, theirs)
                if tail.endswith("Hand"):
                    aligned[tail] = aligned[side + part]
                if tail.endswith("Foot"):
                    foot = rotation_between(ours * FRONTAL, theirs * FRONTAL)
                    aligned[tail] = aligned[f"{side}ToeBase"] = foot
    return aligned


def animal_alignments(character: PoolCharacter, body: RiggedBody) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute the rotations of an animal's joints from the shipped quadruped's rest pose to its own."""
    positions = {name: character.rig.joints[joint] for name, joint in character.joints.items()}
    return rest_directions(positions, float(character.rig.mesh.vertices[:, 1].min()), body)


def body_tail(character: PoolCharacter, name: str) -> str | None:
    """Find the joint of the shipped body at the far end of what a character's limb stands for; None for no limb."""
    side, part = next(((side, name.removeprefix(side)) for side in SIDES if name.startswith(side)), ("", ""))
    if part not in TAILS or name not in character.limbs:
        return None
    inner = [tail for tail in TAILS[part][:-1] if side + tail in character.limbs]
    return side + (inner[0] if inner else TAILS[part][-1])


@cache
def find_character_landmarks(character: PoolCharacter) -> Int[np.ndarray, "M"]:
    """Find the vertices of a character at the landmarks of the shipped body; -1 where it has no vertex there."""
    rig, points = character.rig, place_body_joints(character)
    t_pose = pose_character(character, np.tile(np.eye(3), (len(human().parents), 1, 1)))
    wrapped = as_body(rig, t_pose, character.joints, points)
    found = np.array(list(landmarks(wrapped).values()))
    for k, name in enumerate(LANDMARKS):
        if name in EXTREMES:
            # A large low-poly fist may have no vertex near the line through the hand.
            joint, direction = EXTREMES[name]
            offset = wrapped.vertices[found[k]] - wrapped.joints[wrapped.joint(joint)]
            if np.linalg.norm(np.cross(offset, direction)) >= NEAR:
                found[k] = -1
    return found


def place_body_joints(character: PoolCharacter) -> dict[str, tuple[int, Float[np.ndarray, " 3"]]]:
    """Place the shipped body's joints on a character: the joint that carries each, and the point at rest.

    Elbows and knees of limbs of one joint are in the middle; missing hands and feet are at the ends, toes at the foot.
    """
    joints, rig = character.joints, character.rig
    points = {name: (j, rig.joints[j]) for name, j in joints.items()}
    for side in SIDES:
        for upper, lower, end in (("Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot")):
            limb = character.limbs[side + upper]
            points.setdefault(side + lower, (limb.joint, (limb.start + limb.end) / 2))
            last = character.limbs.get(side + lower, limb)
            points.setdefault(side + end, (last.joint, last.end))
        points.setdefault(f"{side}ToeBase", points[f"{side}Foot"])
    return points
