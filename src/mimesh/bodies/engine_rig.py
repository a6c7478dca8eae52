"""Give a rig the bone names, hierarchy, root bone and rest pose that a game engine or another program expects.

The motion of every vertex stays. Joints of ours that a scheme does not have turn by up to 20 degrees (Neck1), so their
weights cannot be given to their parents. They stay as extra bones: the bones below them are attached to the nearest
named bone above, with the product of the rotations, and get a path of their own in its frame. So a program that
ignores extra bones still finds every named bone in its place.

Makers do not agree where the joints of a person are. Those that a scheme is known to have elsewhere than the shipped
body (engine_joints.json) lie there at rest, in the frame of our joint, and their paths follow: no vertex moves.
"""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.animated_rig import AnimatedRig
from ..core.errors import InputError, option
from ..core.geometry import rotation_between
from ..core.normalization import ORIENTATIONS, ROTATIONS
from ..core.options import Layout
from ..core.rig import Rig, descendants
from ..core.skinning import blend_matrices, place_joints, skin_points
from .engine_names import REQUIRED, SCHEMES, Scheme
from .joint_names import FINGERS, ancestors, without_side

A_ANGLE = 50.0
"""Degrees by which the arms of the A-pose are below the horizontal. Epic's documentation gives no angle; tutorials turn
the mannequin's upper arms up by 50 degrees for a T-pose."""
LEG_TOLERANCE = 15.0
"""Degrees from the vertical within which thighs and shins stay as they are: Godot's importer leaves bones alone that
deviate no more from its reference pose (`fix_silhouette/threshold`)."""
SPANS = {"Hips": ("Hips", "Neck"), "Head": ("Hips", "Neck"), "ToeBase": ("Foot", "ToeBase")}
"""Joints without their side that schemes have elsewhere, and the joints whose distance is the unit of how far."""
LEAST_DETERMINANT = 0.25
"""Least determinant of a vertex's blended rotations from which on they are inverted. Two equal weights have it where
their joints differ by 120 degrees."""


def engine_rig(
    skeleton: AnimatedRig,
    names: str = "own",
    root_bone: bool = False,
    rest: str = "file",
    *,
    up: str = "+y",
    front: str = "+z",
    leg_tolerance: float = LEG_TOLERANCE,
) -> AnimatedRig:
    """Rename and rearrange the joints of a rig as a scheme of SCHEMES has them.

    With another scheme than ours, another rest pose or a root bone, all bones have the axes of the character at rest:
    its left side, up and front. Some joints are where the scheme has them.

    Args:
        root_bone: add a bone on the ground that carries the displacement over it; the hips keep the rest.
        rest: the pose that the mesh is bound in. With T and A, vertices are where the rig's own skinning takes them
            back to the file's exactly; other poses deviate where joints with different turns share a vertex.
        up: axis of the file, such as "+y".
        front: axis of the file.
        leg_tolerance: degrees from the vertical up to which thighs and shins stay as they are.

    Raises:
        InputError: no such scheme or rest pose, or the rig lacks joints that every scheme has.
    """
    scheme = SCHEMES[Layout(names, root_bone, rest).names]
    _check_joints(skeleton, names, rest)
    if not scheme.bones and not root_bone and rest == "file":
        return skeleton
    axes = ROTATIONS[ORIENTATIONS.index((up, front))].T
    bound = _bind(skeleton, rest, axes, _steps(skeleton, names), leg_tolerance)
    bound = _arrange(bound, scheme) if scheme.bones else bound
    return _with_root(bound, scheme.root, axes[:, 1], root_bone) if root_bone or scheme.has_root else bound


def t_posed(skeleton: AnimatedRig, up: str, front: str) -> AnimatedRig:
    """Return the rig of a person's file with one frame, the T-pose of its own joints, legs vertical; the hips stay.

    Joints that are known to be no person's turn with the joint above them.
    """
    axes = ROTATIONS[ORIENTATIONS.index((up, front))].T
    known = {j: name for name, j in (skeleton.person or {}).items()}
    names = tuple(known.get(j, f"joint {j}") for j in range(len(skeleton.names)))
    turn = _rest_turns(replace(skeleton, names=names), "T", axes, 0.0)
    for j, parent in enumerate(skeleton.parents):
        if j not in known and parent >= 0:
            turn[j] = turn[parent]
    return replace(skeleton, rotation=(turn @ skeleton.rig.rotation)[None], root=skeleton.rig.joints[:1])


def _check_joints(skeleton: AnimatedRig, names: str, rest: str) -> None:
    """Check that a rig has the joints that a scheme or a rest pose needs."""
    missing = [joint for joint in REQUIRED if joint not in skeleton.names]
    if missing and (SCHEMES[names].bones or rest != "file"):
        asked = option("names", names) if SCHEMES[names].bones else option("rest", rest)
        raise InputError(
            f"{asked}: expected joints for a whole person, found none for {', '.join(missing)}; leave the option out"
        )


def _steps(skeleton: AnimatedRig, names: str) -> Float[np.ndarray, "J 3"]:
    """Compute the step from each joint of ours to that of a scheme, in the axes of our joint.

    Sources: research/recipes/build_engine_joints.py. Joints whose span is not there stay.
    """
    table = json.loads((resources.files("mimesh.bodies") / "engine_joints.json").read_text())
    joints = dict(zip(skeleton.names, skeleton.rig.joints, strict=True))
    steps = np.zeros((len(joints), 3))
    for j, joint in enumerate(joints):
        name = without_side(joint)
        if name in table.get(names, {}):
            start, end = (joints.get(joint.removesuffix(name) + of, joints[joint]) for of in SPANS[name])
            steps[j] = np.linalg.norm(end - start) * np.array(table[names][name])
            steps[j, 0] *= -1 if joint.startswith("Right") else 1
    return steps


def _bind(
    skeleton: AnimatedRig,
    rest: str,
    axes: Float[np.ndarray, "3 3"],
    steps: Float[np.ndarray, "J 3"],
    leg_tolerance: float,
) -> AnimatedRig:
    """Bind a rig in a rest pose, its joints `steps` further, all with the given axes (columns: left, up, front)."""
    old, positions = skeleton.rig, skeleton.joint_positions()
    turn = _rest_turns(skeleton, rest, axes, leg_tolerance)  # of each joint, from the file's pose to the rest pose
    above = list(skeleton.parents[1:])
    joints = place_joints(old.joints[0], old.joints[1:] - old.joints[above], turn, skeleton.parents)
    mesh = skeleton.mesh
    if rest != "file":
        vertices = _rest_vertices(skeleton.points, old, turn, joints)
        # The soles stay on their ground when legs are straightened.
        rise = axes[:, 1] * ((skeleton.points @ axes[:, 1]).min() - (vertices @ axes[:, 1]).min())
        joints, mesh = joints + rise, mesh.with_vertices(skeleton.on_mesh(vertices + rise))
    motion = skeleton.rotation @ old.rotation.swapaxes(-1, -2)  # of each joint, from the file's pose to each frame
    joints = joints + (turn @ old.rotation @ steps[..., None])[..., 0]
    positions = positions + (skeleton.rotation @ steps[..., None])[..., 0]
    rig = Rig(np.tile(axes, (len(joints), 1, 1)), joints, old.weights)
    rotation = motion @ turn.swapaxes(-1, -2) @ axes
    return replace(skeleton, mesh=mesh, rig=rig, rotation=rotation, root=positions[:, 0], positions=positions)


def _rest_turns(
    skeleton: AnimatedRig, rest: str, axes: Float[np.ndarray, "3 3"], leg_tolerance: float
) -> Float[np.ndarray, "J 3 3"]:
    """Compute the rotation of every joint, in the world, from the file's pose to a rest pose.

    Arms, hands and legs get their directions; trunk and head stay, fingers of the A-pose stay with their hand.
    """
    turn = np.tile(np.eye(3), (len(skeleton.names), 1, 1))
    if rest == "file":
        return turn
    index = {name: j for j, name in enumerate(skeleton.names)}
    for side, left in (("Left", 1.0), ("Right", -1.0)):
        limb = {name.removeprefix(side): j for name, j in index.items() if name.startswith(side)}
        below = np.radians(A_ANGLE if rest == "A" else 0.0)
        _turn_arm(turn, skeleton, limb, axes, axes @ [left * np.cos(below), -np.sin(below), 0.0])
        if rest == "T":
            _turn_fingers(turn, skeleton, limb, axes, left)
        _turn_leg(turn, skeleton, limb, axes, leg_tolerance)
    return turn


def _turn_arm(
    turn: Float[np.ndarray, "J 3 3"],
    skeleton: AnimatedRig,
    limb: dict[str, int],
    axes: Float[np.ndarray, "3 3"],
    direction: Float[np.ndarray, " 3"],
) -> None:
    """Set the turns of a straight arm in some direction, palm down, and of all joints of its hand.

    A joint's axes correspond to those of the shipped body, which is in the T-pose with its palms down: they say how
    far the bone is twisted.
    """
    rig = skeleton.rig
    finger = next((name for name in ("HandMiddle1", "HandIndex1", "HandFinger1") if name in limb), None)
    for joint, end in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("Hand", finger)):
        j = limb[joint]
        turn[j] = axes @ rig.rotation[j].T
        if end is not None:
            turn[j] = rotation_between(turn[j] @ (rig.joints[limb[end]] - rig.joints[j]), direction) @ turn[j]
    turn[descendants([limb["Hand"]], skeleton.parents)] = turn[limb["Hand"]]


def _turn_fingers(
    turn: Float[np.ndarray, "J 3 3"],
    skeleton: AnimatedRig,
    limb: dict[str, int],
    axes: Float[np.ndarray, "3 3"],
    left: float,
) -> None:
    """Set the turns of straight fingers, and of a thumb half way between them and the front (VRM T-pose 1.7, 1.8).

    The last joint of a finger, whose end is not known, turns with the one before.
    """
    for finger in FINGERS:
        target = axes @ [left, 0.0, 1.0 if finger == "Thumb" else 0.0]
        chain = [limb[name] for k in (1, 2, 3) if (name := f"Hand{finger}{k}") in limb]
        for joint, end in pairwise(chain):
            bone = skeleton.rig.joints[end] - skeleton.rig.joints[joint]
            turn[joint] = rotation_between(turn[joint] @ bone, target) @ turn[joint]
            turn[end] = turn[joint]


def _turn_leg(
    turn: Float[np.ndarray, "J 3 3"],
    skeleton: AnimatedRig,
    limb: dict[str, int],
    axes: Float[np.ndarray, "3 3"],
    tolerance: float,
) -> None:
    """Set the turns of a leg that stands, with its foot to the front; the foot keeps its slope."""
    joints, down = skeleton.rig.joints, -axes[:, 1]
    for joint, end in (("UpLeg", "Leg"), ("Leg", "Foot")):
        bone = joints[limb[end]] - joints[limb[joint]]
        if bone @ down < np.cos(np.radians(tolerance)) * np.linalg.norm(bone):
            turn[limb[joint]] = rotation_between(bone, down)
    if "ToeBase" in limb:
        foot = joints[limb["ToeBase"]] - joints[limb["Foot"]]
        turn[[limb["Foot"], limb["ToeBase"]]] = rotation_between(foot - (foot @ down) * down, axes[:, 2])


def _rest_vertices(
    vertices: Float[np.ndarray, "V 3"], rig: Rig, turn: Float[np.ndarray, "J 3 3"], joints: Float[np.ndarray, "J 3"]
) -> Float[np.ndarray, "V 3"]:
    """Compute vertices in a rest pose such that skinning from there to the file's pose gives the file's vertices.

    Where joints of one vertex turn so differently that this has no stable solution, the vertices are skinned to the
    rest pose instead.
    """
    back = turn.swapaxes(-1, -2)
    blended = blend_matrices(rig.weights, back)
    wanted = vertices - rig.weights @ (rig.joints - (back @ joints[..., None])[..., 0])
    stable = np.linalg.det(blended) > LEAST_DETERMINANT
    moved = skin_points(vertices, rig.weights, turn, joints - (turn @ rig.joints[..., None])[..., 0])
    moved[stable] = np.linalg.solve(blended[stable], wanted[stable][..., None])[..., 0]
    return moved


class _Bone(NamedTuple):
    """A bone of a layout: its parent's index, its rest position and its motion."""

    name: str
    parent: int
    source: int
    """Joint whose rotation the bone has."""
    joint: Float[np.ndarray, " 3"]
    """Place at rest."""
    path: Float[np.ndarray, "T 3"]
    weighted: bool
    """Whether the bone has that joint's weights, too."""


def _arrange(skeleton: AnimatedRig, scheme: Scheme) -> AnimatedRig:
    """Rename the joints that a scheme has, in its order and hierarchy, and add those that it has and we have not.

    Other joints follow as extra bones under their own names if they move a vertex; those that move none are left out.
    """
    rig, positions = skeleton.rig, skeleton.joint_positions()
    index = {name: j for j, name in enumerate(skeleton.names)}
    named = [index[joint] for joint in scheme.bones if joint in index]
    extra = [j for j in range(len(index)) if j not in set(named) and rig.weights[:, j].any()]
    bones, placed = list[_Bone](), dict[int, int]()
    for j in (*named, *extra):
        name = scheme.bones.get(skeleton.names[j], skeleton.names[j])
        # Named bones come first, so the parent of one is a named bone; that of an extra bone may be either.
        parent = next((placed[above] for above in ancestors(skeleton.parents, j)[1:] if above in placed), -1)
        if name in scheme.inserted and parent >= 0:
            # Half way to the joint at rest is a bone that moves with the bone above.
            above, step = bones[parent], (rig.joints[j] - bones[parent].joint) / 2
            path = above.path + skeleton.rotation[:, above.source] @ rig.rotation[above.source].T @ step
            bones.append(_Bone(scheme.inserted[name], parent, above.source, above.joint + step, path, False))
            parent = len(bones) - 1
        placed[j] = len(bones)
        bones.append(_Bone(name, parent, j, rig.joints[j], positions[:, j], True))
    names, parents, source, joints, paths, weighted = zip(*bones, strict=True)
    weights = np.where(weighted, rig.weights[:, source], 0.0)
    new = Rig(rig.rotation[list(source)], np.stack(joints), weights)
    paths = np.stack(paths, axis=1)
    rotation = skeleton.rotation[:, source]
    moved = {"rotation": rotation, "root": paths[:, 0], "positions": paths}
    return replace(skeleton, names=names, parents=parents, rig=new, person=None, **moved)


def _with_root(skeleton: AnimatedRig, name: str, up: Float[np.ndarray, " 3"], moves: bool) -> AnimatedRig:
    """Add a bone above the hips: on the ground below them at rest, with the axes of the character at rest.

    It never turns. If it moves, it has the displacement of the hips over the ground, else it stands still.
    """
    rig, frames = skeleton.rig, len(skeleton.root)
    ground = (skeleton.points @ up).min()
    joint = rig.joints[0] + (ground - rig.joints[0] @ up) * up
    path = np.tile(joint, (frames, 1))
    if moves:
        displacement = skeleton.root - rig.joints[0]
        path = path + displacement - (displacement @ up)[:, None] * up
    return replace(
        skeleton,
        names=(name, *skeleton.names),
        parents=(-1, *(parent + 1 for parent in skeleton.parents)),
        rig=Rig(
            np.concatenate([rig.rotation[:1], rig.rotation]),
            np.concatenate([joint[None], rig.joints]),
            np.pad(rig.weights, ((0, 0), (1, 0))),
        ),
        rotation=np.concatenate([np.tile(rig.rotation[0], (frames, 1, 1, 1)), skeleton.rotation], axis=1),
        root=path,
        person=None,
        positions=np.concatenate([path[:, None], skeleton.joint_positions()], axis=1),
    )
