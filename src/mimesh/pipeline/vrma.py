"""Turn results into motions of VRM's humanoid bones, and write them as VRM animations (.vrma)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..bodies.hands import straight_hands
from ..core.animated_rig import RigAnimation
from ..core.errors import InputError, option
from ..core.geometry import nearest_rotation
from ..core.normalization import ORIENTATIONS, ROTATIONS
from ..core.options import Layout
from ..io import save_vrma
from ..io.gltf.own_animation import OwnAnimation
from ..io.gltf.own_rig import read_own_rig
from ..io.gltf.scene import world_matrices
from ..io.gltf.vrm import vrm_bones, vrm_version
from ..motions.bone_motion import NEEDED, TRUNK, BoneMotion, bone_joints, t_pose, t_pose_frames
from ..rigs.character import names_above

if TYPE_CHECKING:
    from ..core.animated_rig import AnimatedRig
    from ..core.mesh import Mesh
    from .result import ClipResult


def save_bone_motions(results: Sequence[ClipResult], path: Path, names: Sequence[str], layout: Layout) -> None:
    """Write the bones of results of one identity as a .vrma with an animation for each.

    Args:
        layout: only its frame rate may differ from the default.

    Raises:
        InputError: joints that are not those of a person, or another layout.
    """
    check_bones_layout(layout, path)
    motions = [_bone_motion(result, name, layout.fps, path) for result, name in zip(results, names, strict=True)]
    with results[0].seconds.step("write"):
        save_vrma(motions, path)


def check_bones_layout(layout: Layout, path: Path) -> None:
    """Raise InputError if a layout changes more than the frame rate: a .vrma has the bones of VRM."""
    if layout != Layout(fps=layout.fps):
        raise InputError(
            f"{option('names')}, {option('root_bone')}, {option('rest')}: expected a .glb or .gltf with them, found "
            f"{path.name}, which has the bones of VRM; leave them out"
        )


def _bone_motion(result: ClipResult, name: str, fps: float | None, path: Path) -> BoneMotion:
    """Return the motion of the humanoid bones of a result, at another frame rate unless that is None."""
    if result.own is not None and result.identity is not None:
        animation = result.own if fps is None else result.own.resampled(fps)
        return _own_bone_motion(result.identity, animation, name, path)
    if result.skeleton is None:
        raise InputError(
            f"{path}: expected a model with joints (mime), found {result.model}; choose another with "
            f"{option('model', ...)}"
        )
    animation = RigAnimation(name, result.skeleton, result.fps).resampled(fps)
    facing = result.report["identity"]
    turn = ROTATIONS[ORIENTATIONS.index((facing["up"], facing["front"]))]
    return _found_bone_motion(animation.skeleton, turn, name, animation.fps, path)


def _own_bone_motion(identity: Mesh, animation: OwnAnimation, name: str, path: Path) -> BoneMotion:
    """Return the motion of the bones of an identity's own file.

    The nodes of a VRM are in the T-pose already, and programs play the animation on these: they are its rest.
    """
    rig = read_own_rig(identity)
    document, humanoid = rig.source.document, rig.humanoid
    joints = check_joints(rig.person, path)
    nodes = [rig.person[joint] for joint in joints]
    is_vrm = vrm_version(document) is not None and bool(vrm_bones(document))
    at_rest = world_matrices(document) if is_vrm else rig.scene.T_world_node
    rest, world = at_rest[nodes], animation.node_matrices(nodes)
    moved = nearest_rotation(world[..., :3, :3] @ np.linalg.pinv(rest[:, :3, :3]))
    turn = humanoid.turn
    hips = world[:, 0, :3, 3] @ turn.T
    if is_vrm:
        return BoneMotion(name, joints, rest[:, :3, 3] @ turn.T, turn @ moved @ turn.T, hips, animation.fps)
    frames = np.stack([humanoid.frames[joint] for joint in joints])
    floor = float(humanoid.character.mesh.vertices[:, 1].min())
    return since_t_pose(
        name, joints, rest[:, :3, 3] @ turn.T, turn @ frames, turn @ moved @ frames, hips, floor, animation.fps
    )


def _found_bone_motion(
    skeleton: AnimatedRig, turn: Float[np.ndarray, "3 3"], name: str, fps: float, path: Path
) -> BoneMotion:
    """Return the motion of joints that were found on a surface; `turn` takes its axes to y up, +z front."""
    index = {joint: j for j, joint in enumerate(skeleton.names)}
    joints = check_joints(index, path)
    chosen = [index[joint] for joint in joints]
    rest = skeleton.rig.joints[chosen] @ turn.T
    floor = float((skeleton.points @ turn.T)[:, 1].min())
    straight = straight_hands(skeleton.names, names_above(skeleton.names, skeleton.parents))[chosen]
    frames, rotation = turn @ skeleton.rig.rotation[chosen], turn @ skeleton.rotation[:, chosen] @ straight
    return since_t_pose(name, joints, rest, frames, rotation, skeleton.root @ turn.T, floor, fps)


def since_t_pose(
    name: str,
    joints: tuple[str, ...],
    rest: Float[np.ndarray, "J 3"],
    frames: Float[np.ndarray, "J 3 3"],
    rotation: Float[np.ndarray, "T J 3 3"],
    hips: Float[np.ndarray, "T 3"],
    floor: float,
    fps: float,
) -> BoneMotion:
    """Change from the T-pose of the shipped body to that of VRM; y is up, and the person faces +z at rest.

    Args:
        frames: rotation of each joint from the shipped body's T-pose to rest.
        rotation: world rotation of each joint since that T-pose.
        floor: height of the ground.
    """
    placed = t_pose(joints, rest, frames)
    index = {joint: k for k, joint in enumerate(joints)}
    ankles = [index["LeftFoot"], index["RightFoot"]]
    # The ankles are as high above the ground as at rest.
    height = rest[ankles, 1].mean() - floor + placed[0, 1] - placed[ankles, 1].mean()
    start = np.array([rest[0, 0], floor, rest[0, 2]])
    placed = placed - placed[0] + [0.0, height, 0.0]
    since = rotation @ t_pose_frames(joints, placed).swapaxes(-1, -2)
    return BoneMotion(name, joints, placed, since, hips - start, fps)


def check_joints(known: dict[str, int], path: Path) -> tuple[str, ...]:
    """Select the joints that VRM has bones for; raises InputError where required ones are missing."""
    missing = [joint for joint in NEEDED if joint not in known]
    missing += [] if any(joint in known for joint in TRUNK) else ["Spine"]
    if missing:
        raise InputError(
            f"{path}: expected the bones that VRM requires, found none for {', '.join(missing)}; write a .glb, or find "
            f"joints on the surface with {option('rig', 'mimesh')}"
        )
    return bone_joints(known)
