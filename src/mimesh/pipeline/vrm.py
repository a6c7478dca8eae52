"""Write rigged people as VRM 1.0 (.vrm): in the T-pose, y up, +z front and in metres, with maker and licence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..bodies.engine_names import SCHEMES, root_name
from ..bodies.engine_rig import Layout, engine_rig, t_posed
from ..core.animated_rig import AnimatedRig
from ..core.errors import InputError, option
from ..core.normalization import ORIENTATIONS, ROTATIONS
from ..core.rig import Rig
from ..io import joints_file, save_vrm
from ..io.gltf.edit import GltfSource
from ..io.gltf.own_animation import write_own_rig
from ..io.gltf.vrm import PUBLIC_LICENSE, VrmMeta, vrm_version
from ..io.usd import stage_axes
from ..motions.bone_motion import bone_names
from .skinned import own_pose
from .vrma import check_joints

if TYPE_CHECKING:
    from ..io.gltf.own_animation import OwnAnimation
    from ..io.gltf.own_rig import OwnRig
    from .rigging import RiggedMesh


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
    """Write a rigged mesh as .vrm; a file that is one already stays as it is.

    Raises:
        InputError: it is no person, another pose is asked for, maker or licence are missing, or the path cannot be
            written to.
    """
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
