"""Rigs in motion for tests of engine layouts, and the hierarchies that engines document, written down here again."""

from __future__ import annotations

from functools import cache

import numpy as np
from people import decimation
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.hands import HAND_PARENTS, hand_joints, hand_weight, load_hands
from mimesh.bodies.joint_names import finger_joints
from mimesh.core.animated_rig import AnimatedRig
from mimesh.core.mesh import Mesh
from mimesh.core.normalization import ORIENTATIONS, ROTATIONS
from mimesh.core.rig import Rig

CHAINS = {
    "mixamo": """Hips Spine Spine1 Spine2 Neck Head
        Spine2 {Side}Shoulder {Side}Arm {Side}ForeArm {Side}Hand
        Hips {Side}UpLeg {Side}Leg {Side}Foot {Side}ToeBase""",
    "unreal": """root pelvis spine_01 spine_02 spine_03 spine_04 spine_05 neck_01 neck_02 head
        spine_05 clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s}
        pelvis thigh_{s} calf_{s} foot_{s} ball_{s}""",
    "vrm": """hips spine chest upperChest neck head
        upperChest {side}Shoulder {side}UpperArm {side}LowerArm {side}Hand
        hips {side}UpperLeg {side}LowerLeg {side}Foot {side}Toes""",
    "godot": """Hips Spine Chest UpperChest Neck Head
        UpperChest {Side}Shoulder {Side}UpperArm {Side}LowerArm {Side}Hand
        Hips {Side}UpperLeg {Side}LowerLeg {Side}Foot {Side}Toes""",
    "rigify": """DEF-spine DEF-spine.001 DEF-spine.002 DEF-spine.003 DEF-spine.004 DEF-spine.005 DEF-spine.006
        DEF-spine.003 DEF-shoulder.{S} DEF-upper_arm.{S} DEF-forearm.{S} DEF-hand.{S}
        DEF-spine DEF-thigh.{S} DEF-shin.{S} DEF-foot.{S} DEF-toe.{S}""",
}
"""Chains of bones from parent to child, a line each, without fingers. Mixamo's are without their namespace."""
FINGER_CHAINS = {
    "mixamo": "{Side}Hand {Side}Hand@1 {Side}Hand@2 {Side}Hand@3",
    "unreal": """hand_{s} thumb_01_{s} thumb_02_{s} thumb_03_{s}
        hand_{s} @_metacarpal_{s} @_01_{s} @_02_{s} @_03_{s}""",
    "vrm": """{side}Hand {side}ThumbMetacarpal {side}ThumbProximal {side}ThumbDistal
        {side}Hand {side}@Proximal {side}@Intermediate {side}@Distal""",
    "godot": """{Side}Hand {Side}ThumbMetacarpal {Side}ThumbProximal {Side}ThumbDistal
        {Side}Hand {Side}@Proximal {Side}@Intermediate {Side}@Distal""",
    "rigify": """DEF-hand.{S} DEF-thumb.01.{S} DEF-thumb.02.{S} DEF-thumb.03.{S}
        DEF-hand.{S} DEF-@.01.{S} DEF-@.02.{S} DEF-@.03.{S}""",
}
"""The same of fingers; @ is each of the scheme's words for them."""
FINGER_WORDS = {
    "mixamo": "Thumb Index Middle Ring Pinky",
    "unreal": "index middle ring pinky",
    "vrm": "Index Middle Ring Little",
    "godot": "Index Middle Ring Little",
    "rigify": "f_index f_middle f_ring f_pinky",
}
NAMESPACE = {"mixamo": "mixamorig:"}
ROOTS = {"own": "Root", "mixamo": "Root", "unreal": "root", "vrm": "Root", "godot": "Root", "rigify": "root"}


def expected_parents(scheme: str, fingers: bool) -> dict[str, str]:
    """Bone -> parent in the documented hierarchy of a scheme; without the parent of the hips."""
    words, chains = FINGER_WORDS[scheme].split(), []
    for side in ("Left", "Right"):
        spelled = {"Side": side, "side": side.lower(), "S": side[0], "s": side[0].lower()}
        chains += CHAINS[scheme].format(**spelled).splitlines()
        for chain in FINGER_CHAINS[scheme].format(**spelled).splitlines() if fingers else ():
            chains += [chain.replace("@", word) for word in (words if "@" in chain else [""])]
    space = NAMESPACE.get(scheme, "")
    links = [pair for chain in chains for pair in zip(chain.split(), chain.split()[1:], strict=False)]
    return {space + child: space + parent for parent, child in links}


def moving_rig(
    seed: int, fingers: bool = False, up: str = "+y", front: str = "+z", frames: int = 5, arms: float = 0.0
) -> AnimatedRig:
    """Make the shipped body with random rest axes, random joint rotations and a random path; four weights a vertex.

    Args:
        fingers: add fifteen joints to each hand, below the base of all fingers.
        arms: degrees by which the arms of the rest pose are lowered.
    """
    rng, body = np.random.default_rng(seed), load_body()
    kept, triangles = decimation(600)
    names, parents, joints, weights = body.joint_names, body.parents, body.joints, body.weights
    if fingers:
        names, parents, joints, weights = with_fingers()
    weights = np.where(weights >= np.sort(weights, axis=1)[:, -4:-3], weights, 0.0)
    weights = weights / weights.sum(axis=1, keepdims=True)
    turns = np.zeros((len(names), 3))
    for side, sign in (("Left", -1), ("Right", 1)):
        turns[names.index(f"{side}Arm"), 2] = sign * np.radians(arms)
    at_rest, joints_at_rest = _forward(Rotation.from_rotvec(turns).as_matrix(), joints, parents, joints[0])
    offset = joints_at_rest - (at_rest @ joints[..., None])[..., 0]
    vertices = np.einsum("vj,jkl,vl->vk", weights[kept], at_rest, body.vertices[kept]) + weights[kept] @ offset
    # Axes that the network predicts are wrong by some degrees.
    axes = Rotation.from_rotvec(rng.normal(scale=0.02, size=(len(names), 3))).as_matrix() @ at_rest
    local = Rotation.from_rotvec(rng.normal(scale=0.2, size=(frames * len(names), 3))).as_matrix()
    local = local.reshape(frames, -1, 3, 3)
    root = joints[0] + rng.normal(scale=0.5, size=(frames, 3))
    world = np.empty_like(local)
    for j, parent in enumerate(parents):
        step = axes[j] if parent < 0 else axes[parent].T @ axes[j]
        world[:, j] = local[:, j] @ step if parent < 0 else world[:, parent] @ step @ local[:, j]
    of_file = ROTATIONS[ORIENTATIONS.index((up, front))].T
    mesh = Mesh(vertices @ of_file.T, triangles, name="mover")
    rig = Rig(of_file @ axes, joints_at_rest @ of_file.T, weights[kept])
    return AnimatedRig(mesh, names, parents, rig, of_file @ world, root @ of_file.T)


def posed(rig: AnimatedRig, t: int) -> np.ndarray:
    """Compute frame t by linear blend skinning, in double precision, from positions and rotations of the joints."""
    motion = rig.rotation[t] @ rig.rig.rotation.swapaxes(-1, -2)
    offset = rig.joint_positions()[t] - (motion @ rig.rig.joints[..., None])[..., 0]
    weights = rig.rig.weights
    return np.einsum("vj,jkl,vl->vk", weights, motion, rig.mesh.vertices) + weights @ offset


def _forward(local, joints, parents, root):
    """World rotations and positions of joints from local rotations."""
    rotation, position = local.copy(), joints.copy()
    position[0] = root
    for j, parent in enumerate(parents):
        if parent >= 0:
            rotation[j] = rotation[parent] @ local[j]
            position[j] = position[parent] + rotation[parent] @ (joints[j] - joints[parent])
    return rotation, position


@cache
def with_fingers():
    """Names, parents, joints and weights of the body with 61 joints, as results whose fingers move have them."""
    body, hands = load_body(), load_hands()
    names, parents, weights = list(body.joint_names), list(body.parents), [body.weights.copy()]
    for s, side in enumerate(("Left", "Right")):
        base, start, mass = names.index(f"{side}FingerBase"), len(names), hand_weight(body, side)
        weights[0][:, hand_joints(body.joint_names, side)] = 0.0
        weights[0][:, base] = mass * hands.shares[s, :, 0]
        weights.append(mass[:, None] * hands.shares[s, :, 1:])
        names += finger_joints(side)
        parents += [base if parent == 0 else start + parent - 1 for parent in HAND_PARENTS[1:]]
    return tuple(names), tuple(parents), np.concatenate([body.joints, hands.joints]), np.concatenate(weights, axis=1)
