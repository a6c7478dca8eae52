"""Write results as VRM animations (.vrma), and rigged people as VRM 1.0 (.vrm): T-pose, y up, +z front, in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..bodies.engine_names import SCHEMES, root_name
from ..bodies.engine_rig import engine_rig, t_posed
from ..bodies.hands import straight_hands
from ..core.animated_rig import AnimatedRig, RigAnimation
from ..core.errors import InputError, option
from ..core.geometry import nearest_rotation
from ..core.normalization import ORIENTATIONS, ROTATIONS
from ..core.options import Layout
from ..core.rig import Rig
from ..io import joints_file, save_vrm, save_vrma
from ..io.gltf.edit import GltfSource
from ..io.gltf.own_animation import OwnAnimation, own_pose, write_own_rig
from ..io.gltf.own_rig import read_own_rig
from ..io.gltf.scene import world_matrices
from ..io.gltf.vrm import PUBLIC_LICENSE, VrmMeta, vrm_bones, vrm_version
from ..io.usd import stage_axes
from ..motions.bone_motion import NEEDED, TRUNK, BoneMotion, bone_joints, bone_names, t_pose, t_pose_frames
from ..rigs.character import names_above

if TYPE_CHECKING:
    from ..core.mesh import Mesh
    from ..io.gltf.own_rig import OwnRig
    from .result import ClipResult
    from .rigging import RiggedMesh


def save_bone_motions(results: Sequence[ClipResult], path: Path, names: Sequence[str], layout: Layout) -> None:
    """Write the bones of results of one identity as a .vrma with an animation for each.

    Args:
        layout: only its frame rate may differ from the default.
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


def vrm_meta(name: str, author: str | Sequence[str] | None, license: str | None, path: Path) -> VrmMeta:
    """Return who made a character, and its licence.

    Raises:
        InputError: one of them is missing, or the licence is no URL.
    """
    authors = (author,) if isinstance(author, str) else tuple(author or ())
    needed = {"author": any(authors), "license": license}
    missing = [option(name) for name, given in needed.items() if not given]
    if missing or not license:
        raise InputError(
            f"{path}: expected {option('author')} and {option('license')} for a .vrm, found no "
            f"{' and no '.join(missing)}; the licence may be {PUBLIC_LICENSE}, or write a .glb"
        )
    if not license.startswith(("https://", "http://")):
        raise InputError(f"{option('license')}: expected a URL, found {license!r}; give for example {PUBLIC_LICENSE}")
    return VrmMeta(name, tuple(filter(None, authors)), license)


def save_as_vrm(
    rigged: RiggedMesh, layout: Layout, author: str | Sequence[str] | None, license: str | None, path: Path
) -> None:
    """Write a rigged mesh as .vrm; a file that is one already stays as it is."""
    own, report = rigged.own, rigged.report
    if rigged.body != "human":
        raise InputError(f"{path}: expected a person for a .vrm, found a four-legged animal; write a .glb")
    if layout.rest == "A" or (own is not None and root_name(layout) is not None):
        found = f"{option('rest', 'A')} or {option('root_bone')}"
        raise InputError(f"{path}: expected a T-pose without a root bone, found {found}; leave it out")
    if own is not None and vrm_version(own.source.document) is not None:
        with joints_file(path, animated=False) as temporary:
            write_own_rig(own_pose(own, rigged.mesh.name, layout), temporary)
        return
    meta = vrm_meta(rigged.mesh.name, author, license, path)
    turn = ROTATIONS[ORIENTATIONS.index((report["up"], report["front"]))]
    if own is not None:
        joints = check_joints(own.person, path)  # the T-pose needs these, too
        animation, posed = _own_t_pose(rigged, own, layout)
        bones = {bone: own.person[joint] for bone, joint in zip(bone_names(joints), joints, strict=True)}
        hips = posed.joint_positions()[0, (posed.person or {})["Hips"]]
        origin = _below(hips, next(animation.vertices()), turn)
        save_vrm(animation, bones, meta, turn, origin, path)
        return
    rig = engine_rig(_upright(rigged.skeleton, turn), layout.names, layout.root_bone, "T", leg_tolerance=0.0)
    bone_of = SCHEMES[layout.names].bones
    index = {name: j for j, name in enumerate(rig.names)}
    known = {
        joint: index[bone_of.get(joint, joint)] for joint in rigged.skeleton.names if bone_of.get(joint, joint) in index
    }
    joints = check_joints(known, path)
    bones = {bone: known[joint] for bone, joint in zip(bone_names(joints), joints, strict=True)}
    origin = _below(rig.rig.joints[known["Hips"]], rig.mesh.vertices, np.eye(3))
    save_vrm(rig, bones, meta, np.eye(3), origin, path)


def _below(
    hips: Float[np.ndarray, " 3"], vertices: Float[np.ndarray, "V 3"], turn: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, " 3"]:
    """Return the point on the ground below the hips, where `turn` takes up to y."""
    return hips + ((vertices - hips) @ turn[1]).min() * turn[1]


def _upright(skeleton: AnimatedRig, turn: Float[np.ndarray, "3 3"]) -> AnimatedRig:
    """Turn a rig at rest to y up, +z front, and scale it to metres where its file says its unit."""
    mesh, rig = skeleton.mesh, skeleton.rig
    metres = stage_axes(mesh)[1]
    moved = mesh.with_vertices(metres * (mesh.vertices @ turn.T))
    moved = replace(moved, up="+y")
    if not isinstance(mesh.source, GltfSource):
        moved = replace(moved, source=None)  # which would say that the file has another unit
    new = Rig(turn @ rig.rotation, metres * (rig.joints @ turn.T), rig.weights)
    return replace(skeleton, mesh=moved, rig=new, rotation=new.rotation[None], root=new.joints[:1])


def written_skeleton(rigged: RiggedMesh, layout: Layout, path: Path) -> AnimatedRig:
    """Return the skeleton of a rigged mesh, and its mesh, at rest as a file has them: a .vrm in the T-pose."""
    own = rigged.own
    if path.suffix.lower() != ".vrm":
        return rigged.laid_out(layout) if own is None else rigged.skeleton
    if own is None:
        axes = {"up": rigged.report["up"], "front": rigged.report["front"]}
        return engine_rig(rigged.skeleton, layout.names, layout.root_bone, "T", **axes, leg_tolerance=0.0)
    animation, posed = _own_t_pose(rigged, own, layout)
    rig = Rig(posed.rotation[0], posed.joint_positions()[0], posed.rig.weights)
    return replace(posed, mesh=posed.mesh.with_vertices(next(animation.vertices())), rig=rig)


def _own_t_pose(rigged: RiggedMesh, own: OwnRig, layout: Layout) -> tuple[OwnAnimation, AnimatedRig]:
    """Return the T-pose of the bones of a file, with the soles on the ground that they are on at rest.

    It is an animation of the file's nodes, and of the joints.
    """
    up, front = rigged.report["up"], rigged.report["front"]
    posed = t_posed(rigged.skeleton, up, front)
    vertical = ROTATIONS[ORIENTATIONS.index((up, front))][1]

    def animation(skeleton: AnimatedRig) -> OwnAnimation:
        tracks = own.tracks(own.humanoid.tree()[0], skeleton.transforms())
        return own_pose(own, rigged.mesh.name, layout, tracks)

    ground = (rigged.skeleton.mesh.vertices @ vertical).min() - (next(animation(posed).vertices()) @ vertical).min()
    posed = replace(posed, root=posed.root + ground * vertical)
    return animation(posed), posed
