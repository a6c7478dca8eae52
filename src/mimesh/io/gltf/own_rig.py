"""Reads the own rig of a glTF character and the joints of a glTF clip, and moves the rig's nodes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...bodies.character_pool import facing_rotation, sampled_poses
from ...bodies.skinned_character import SkinnedCharacter
from ...core.errors import InputError
from ...core.geometry import nearest_rotation
from ...core.mesh import Mesh
from ...core.person_motion import PersonMotion
from ...motions.humanoid_rig import HumanoidRig, humanoid_rig
from .animation import AnimationChannel, animated_nodes
from .bake import AnimatedValues, sample_nodes
from .character import read_clips, read_standing
from .document import Document
from .edit import GltfSource
from .motion import PLAYED_PATHS
from .read import RestScene
from .scene import local_matrices, node_parents, node_properties, sort_parents_first
from .skin import unweighted_vertices

UNSKINNED = 0.02
"""Largest share of vertices without any joint; more of them is a damaged skin."""
SHEAR = 1e-3
"""Largest deviation of a joint's axes from right angles: node transforms cannot hold shears (glTF 2.0, 3.5.3)."""
UNCHANGED = 1e-6
"""Difference, relative to the size of the character, below which a node keeps the value of its file."""


@dataclass(frozen=True, eq=False)
class OwnRig:
    """The rig of a character in a glTF file."""

    source: GltfSource
    humanoid: HumanoidRig
    nodes: list[int]
    """Node of each joint of the character."""
    scene: RestScene
    """The scene in the rest pose of the character."""

    @property
    def person(self) -> dict[str, int]:
        """Node of each joint that is known to be a person's."""
        return {name: self.nodes[joint] for name, joint in self.humanoid.joints.items()}

    def tracks(self, joints: list[int], transforms: Float[np.ndarray, "T K 4 4"]) -> AnimatedValues:
        """Compute the animated values of the file's nodes that give some joints a motion.

        Args:
            joints: indices of joints of the character.
            transforms: rigid transform of each of them from the rest pose to every frame, in the world of the file.
        """
        document = self.source.document
        parent = node_parents(document)
        static = local_matrices(document)
        moved = {self.nodes[joint]: transforms[:, k] for k, joint in enumerate(joints)}
        world: dict[int, np.ndarray] = {-1: np.eye(4)[None]}
        tracks: AnimatedValues = {}
        size = float(np.ptp(self.humanoid.character.mesh.vertices, axis=0).max())
        for node in sort_parents_first(document, parent):
            above = world[parent[node]]
            if node not in moved:
                world[node] = above @ static[node]
                continue
            world[node] = moved[node] @ self.scene.T_world_node[node]
            local = np.linalg.inv(above) @ world[node]
            tracks |= _node_tracks(document.gltf["nodes"][node], node, local, size)
        return tracks


def read_own_rig(mesh: Mesh) -> OwnRig:
    """Read the rig of a mesh that comes from a glTF file.

    Raises:
        InputError: no skin, a damaged one, or joints that are not those of a person; the message says why.
    """
    source = mesh.source
    if not isinstance(source, GltfSource) or not has_rig(mesh):
        raise InputError(f"{mesh.name}: expected a skin, found none; export the mesh together with its armature")
    document = source.document
    path = document.path
    if document.damage is not None:
        raise InputError(f"{path}: {document.damage}; export it again")
    standing = read_standing(dataclasses.replace(mesh, vertices=source.vertices), document, source.rest)
    rig, nodes = standing.rig, standing.nodes
    check_sound(rig, standing.scene.T_world_node[nodes], path)
    _check_bound(document, path)
    bare = unweighted_vertices(document, standing.scene) / len(rig.weights)
    if bare > UNSKINNED:
        raise InputError(
            f"{path}: expected a skin with weights, found {bare:.0%} of the vertices without; bind the mesh again"
        )
    turn = facing_rotation(standing.facing)

    def poses() -> np.ndarray:
        rest = standing.scene.T_world_node[nodes]
        return sampled_poses(read_clips(document, rest, nodes, rig.parents, lambda name: False), rig, np.eye(3))

    humanoid, order = humanoid_rig(rig, turn, standing.known, poses, path)
    return OwnRig(source, humanoid, [nodes[k] for k in order], standing.scene)


def has_rig(mesh: Mesh) -> bool:
    """Return whether a mesh comes from a glTF file with a skin or with several moving parts."""
    if not isinstance(mesh.source, GltfSource):
        return False
    document = mesh.source.document
    return bool(document.gltf.get("skins")) or len(animated_nodes(document, PLAYED_PATHS)) > 1


@dataclass(frozen=True, eq=False)
class GltfJoints:
    """The joints of a glTF file in the frames of a clip that was read from it (`Clip.skeleton`)."""

    document: Document
    channels: list[AnimationChannel]
    times: Float[np.ndarray, " T"]
    mesh: Mesh | None
    """The mesh that the clip shows; None: the file has no mesh."""
    played: PersonMotion | None = None
    """Joints of the body that plays the motion of a file without a mesh."""

    @property
    def has_joints(self) -> bool:
        """Whether the file has any joints: a mesh may be moved by morph targets alone."""
        return self.mesh is None or has_rig(self.mesh)

    def cut(self, frames: slice) -> GltfJoints:
        """Select frames of the clip."""
        played = None if self.played is None else self.played.cut(frames)
        return dataclasses.replace(self, times=self.times[frames], played=played)

    def values(self) -> AnimatedValues:
        """Sample the animated values of all nodes."""
        return {(channel.node, channel.path): channel.sample(self.times) for channel in self.channels}

    def person(self) -> PersonMotion:
        """Read the joints of a person.

        Raises:
            InputError: as `read_own_rig`.
        """
        if self.mesh is None:
            assert self.played is not None
            return self.played
        rig = read_own_rig(self.mesh)
        humanoid, document = rig.humanoid, self.document
        nodes = [rig.nodes[humanoid.joints[name]] for name in humanoid.person]
        blocks = sample_nodes(document, self.channels, self.times)
        world = np.concatenate([matrices[:, nodes] for _, matrices in blocks])
        if not np.isfinite(world).all():
            raise InputError(f"{document.path}: expected finite joints, found NaN or infinity; export it again")
        return humanoid.motion(world, rig.scene.T_world_node[nodes])


def check_sound(rig: SkinnedCharacter, T_world_joint: Float[np.ndarray, "J 4 4"], path: object) -> None:
    """Check that vertices have joints, and that joints can be animated.

    Raises:
        InputError: they do not, or cannot.
    """
    loose = float((rig.weights * (rig.joint_of == len(rig.parents))).sum(axis=1).mean())
    if loose > UNSKINNED:
        raise InputError(
            f"{path}: expected a skin with weights, found {loose:.0%} of the vertices without; bind the mesh again"
        )
    _check_scales(T_world_joint[np.unique(rig.joint_of[rig.joint_of < len(rig.parents)])], path)


def _check_bound(document: Document, path: Path) -> None:
    """Check that skins say where joints were when the mesh was bound, and that joints can be animated from there."""
    skins = document.gltf.get("skins", [])
    if any("inverseBindMatrices" not in skin for skin in skins):
        raise InputError(f"{path}: expected inverse bind matrices in every skin, found none; export it again")
    joints = sorted({joint for skin in skins for joint in skin["joints"]})
    _check_scales(local_matrices(document)[joints], path)


def _check_scales(transforms: Float[np.ndarray, "J 4 4"], path: object) -> None:
    """Check that joints have a size, which is the same along all axes."""
    linear = transforms[:, :3, :3]
    scale = np.linalg.norm(linear, axis=1)
    if not (scale > 0).all():
        raise InputError(f"{path}: expected joints with a size, found one scaled to nothing; give it a size")
    unit = linear / scale[:, None]
    if (
        np.abs(unit.swapaxes(-1, -2) @ unit - np.eye(3)).max(initial=0.0) > SHEAR
        or (np.ptp(scale, axis=1) > SHEAR * scale.max(axis=1)).any()
    ):
        raise InputError(f"{path}: expected joints scaled equally along all axes, found others; apply their scale")


def _node_tracks(entry: dict[str, Any], node: int, local: Float[np.ndarray, "T 4 4"], size: float) -> AnimatedValues:
    """Decompose local transforms into those of translation, rotation and scale that differ from the file's."""
    from scipy.spatial.transform import Rotation

    own = node_properties(entry)
    scale = np.where(own["scale"] == 0, 1.0, own["scale"])
    linear = local[:, :3, :3] / scale  # columns without the file's scale
    factor = np.cbrt(np.abs(np.linalg.det(linear)))
    rotation = Rotation.from_matrix(nearest_rotation(linear)).as_quat()
    # Signs as in the frame before, for programs that interpolate without taking the shorter arc.
    signs = np.cumprod(np.where((rotation[1:] * rotation[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    rotation[1:] *= signs[:, None]
    rotation *= -1.0 if rotation[0] @ own["rotation"] < 0 else 1.0
    found: AnimatedValues = {}
    unit = np.linalg.norm(local[:, :3, 3]).max(initial=0) + size
    if np.abs(local[:, :3, 3] - own["translation"]).max() > UNCHANGED * unit:
        found[node, "translation"] = local[:, :3, 3]
    if np.abs(rotation - own["rotation"]).max() > UNCHANGED:
        found[node, "rotation"] = rotation
    if np.abs(factor - 1).max() > SHEAR:
        found[node, "scale"] = factor[:, None] * scale
    return found
