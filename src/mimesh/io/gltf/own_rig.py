"""Reads the own rig of a glTF character and the joints of a glTF clip, and moves the rig's nodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...bodies.character_limbs import FindJoints
from ...bodies.character_pool import facing_rotation, sampled_poses
from ...bodies.skinned_character import SkinnedCharacter
from ...core.errors import InputError
from ...core.geometry import continuous_quaternions, nearest_rotation
from ...core.mesh import Mesh
from ...core.person_motion import PersonMotion
from ...motions.animal_rig import animal_rig
from ...motions.humanoid_rig import HumanoidRig, humanoid_rig
from .animation import AnimatedValues, AnimationChannel, animated_nodes, sample_joints
from .character import read_clips, read_standing, read_standing_animal, rig_at_rest
from .check import damaged
from .document import Document
from .edit import GltfSource
from .motion import PLAYED_PATHS, front_before_placing, rest_matrices
from .read import RestScene, unweighted_vertices
from .scene import local_matrices, local_matrix, node_parents, node_properties, sort_parents_first, world_matrices

UNSKINNED = 0.02
"""Largest share of vertices without any joint; more of them is a damaged skin."""
SHEAR = 1e-3
"""Largest deviation of a joint's axes from right angles: node transforms cannot hold shears (glTF 2.0, 3.5.3)."""
UNCHANGED = 5e-7
"""Distance, over the size of the character, by which a vertex may be off because nodes keep values of their file."""


@dataclass(frozen=True, eq=False)
class FileRig:
    """The rig of any creature or thing in a glTF file."""

    source: GltfSource
    character: SkinnedCharacter
    """At rest, in the axes and unit of the file."""
    nodes: list[int]
    """Node of each joint of the character."""
    scene: RestScene
    """The scene in the rest pose of the character."""

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
        extent = np.ptp(self.character.mesh.vertices, axis=0)
        for node in sort_parents_first(document, parent):
            above = world[parent[node]]
            if node not in moved:
                world[node] = above @ static[node]
                continue
            local = np.linalg.inv(above) @ moved[node] @ self.scene.T_world_node[node]
            unit = np.cbrt(np.abs(np.linalg.det(above[0, :3, :3])))
            distance, angle = UNCHANGED * extent.max() / unit, UNCHANGED * extent.max() / np.linalg.norm(extent)
            entry = node_properties(document.gltf["nodes"][node])
            found = node_tracks(entry, local, distance, angle)
            tracks |= {(node, path): values for path, values in found.items()}
            # The nodes below undo what this one is off, so that errors along a chain do not add up.
            world[node] = above @ local_matrix({**entry, **found})
        return tracks


@dataclass(frozen=True, eq=False)
class OwnRig(FileRig):
    """The rig of a person or of a four-legged animal in a glTF file."""

    humanoid: HumanoidRig

    @property
    def person(self) -> dict[str, int]:
        """Node of each joint that is known to be a person's."""
        return {name: self.nodes[joint] for name, joint in self.humanoid.joints.items()}


def read_file_rig(mesh: Mesh) -> FileRig:
    """Read the rig of any creature or thing in its bind pose, from a mesh that comes from a glTF file.

    Raises:
        InputError: no skin, or a damaged one.
    """
    source = _rigged_source(mesh)
    document = source.document
    scene = dataclasses.replace(source.rest, T_world_node=rest_matrices(document))
    rig, nodes = rig_at_rest(mesh, document, scene)
    _check_skin(rig, nodes, document, scene)
    own = FileRig(source, rig, nodes, scene)
    _check_above(own, list(range(len(nodes))))
    return own


def read_own_rig(mesh: Mesh, find: FindJoints | None = None, body: str = "human") -> OwnRig:
    """Read the rig of a mesh that comes from a glTF file.

    Args:
        find: finds joints of a person whose names say nothing.
        body: `human` or `quadruped`.

    Raises:
        UnnamedJoints: limbs are not found by name, and nothing else finds them.
        InputError: no skin, a damaged one, or joints that are not those of a person; the message says why.
    """
    source = _rigged_source(mesh)
    document, path = source.document, source.document.path
    of_animal = body == "quadruped"
    if of_animal:
        standing = read_standing_animal(mesh, document, source.rest)
    else:
        standing = read_standing(mesh, document, source.rest, find)
    rig, nodes = standing.rig, standing.nodes
    _check_skin(rig, nodes, document, standing.scene)
    turn = facing_rotation(standing.facing)

    def poses() -> np.ndarray:
        rest = standing.scene.T_world_node[nodes]
        return sampled_poses(read_clips(document, rest, nodes, rig.parents, lambda name: False), rig, np.eye(3))

    if of_animal:
        humanoid, order = animal_rig(rig, turn, path)
    else:
        humanoid, order = humanoid_rig(rig, turn, standing.known, poses, path)
    own = OwnRig(source, humanoid.character, [nodes[k] for k in order], standing.scene, humanoid)
    _check_above(own, humanoid.tree()[0])
    hips = own.person["Hips"]
    worlds = np.stack([own.scene.T_world_node[hips], world_matrices(document)[hips]])
    if np.prod(np.linalg.det(worlds[:, :3, :3])) < 0:
        raise InputError(f"{path}: expected a rig as it was bound, found a mirrored one; apply its scale")
    return own


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
    body: str = "human"
    """Body whose joints are read."""
    find: FindJoints | None = None
    """Finds joints of the mesh whose names say nothing."""
    whole: bool = False
    """Whether the frames are those of the whole animation, at the rate of its keys."""

    @property
    def has_joints(self) -> bool:
        """Whether the file has any joints: a mesh may be moved by morph targets alone."""
        return self.mesh is None or has_rig(self.mesh)

    def cut(self, frames: slice) -> GltfJoints:
        """Select frames of the clip."""
        played = None if self.played is None else self.played.cut(frames)
        times = self.times[frames]
        return dataclasses.replace(self, times=times, played=played, whole=self.whole and len(times) == len(self.times))

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
        rig = read_own_rig(self.mesh, self.find, self.body)
        humanoid, document = rig.humanoid, self.document
        nodes = [rig.nodes[humanoid.joints[name]] for name in humanoid.person]
        world = sample_joints(document, self.channels, self.times, nodes)
        if not np.isfinite(world).all():
            raise damaged(document.path, "finite joints", "NaN or infinity")
        motion = humanoid.motion(world, rig.scene.T_world_node[nodes])
        assert motion.front is not None
        return dataclasses.replace(motion, front=front_before_placing(document, rig.scene.T_world_node, motion.front))


def check_sound(rig: SkinnedCharacter, T_world_joint: Float[np.ndarray, "J 4 4"], path: object) -> None:
    """Check that vertices have joints, and that joints can be animated.

    Raises:
        InputError: they do not, or cannot.
    """
    _check_share(float((rig.weights * (rig.joint_of == len(rig.parents))).sum(axis=1).mean()), path)
    _check_scales(T_world_joint[np.unique(rig.joint_of[rig.joint_of < len(rig.parents)])], path)


def _check_bound(document: Document) -> None:
    """Check that skins say where joints were when the mesh was bound, and that joints can be animated from there."""
    skins = document.gltf.get("skins", [])
    if any("inverseBindMatrices" not in skin for skin in skins):
        raise damaged(document.path, "inverse bind matrices in every skin", "none")
    joints = sorted({joint for skin in skins for joint in skin["joints"]})
    _check_scales(local_matrices(document)[joints], document.path)


def _rigged_source(mesh: Mesh) -> GltfSource:
    """Return the file of a mesh.

    Raises:
        InputError: it has no skin, or is damaged.
    """
    source = mesh.source
    if not isinstance(source, GltfSource) or not has_rig(mesh):
        raise InputError(f"{mesh.name}: expected a skin, found none; export the mesh together with its armature")
    if source.document.damage is not None:
        raise InputError(f"{source.document.path}: {source.document.damage}; export it again")
    return source


def _check_skin(rig: SkinnedCharacter, nodes: list[int], document: Document, scene: RestScene) -> None:
    """Check that vertices have joints and weights, and that skins say where joints were when the mesh was bound."""
    check_sound(rig, scene.T_world_node[nodes], document.path)
    _check_bound(document)
    _check_share(unweighted_vertices(document, scene) / len(rig.weights), document.path)


def _check_share(bare: float, path: object) -> None:
    """Check that only a small share of the vertices is without weights."""
    if bare > UNSKINNED:
        raise InputError(
            f"{path}: expected a skin with weights, found {bare:.0%} of the vertices without; bind the mesh again"
        )


def _check_above(own: FileRig, joints: list[int]) -> None:
    """Check that the frames in which some joints move have one scale."""
    document = own.source.document
    parent, static = node_parents(document), local_matrices(document)
    moved = {own.nodes[joint] for joint in joints}
    frames, above = {-1: np.eye(4)}, []
    for node in sort_parents_first(document, parent):
        if node in moved:
            above.append(frames[parent[node]])
        frames[node] = np.eye(4) if node in moved else frames[parent[node]] @ static[node]
    _check_scales(np.stack(above), document.path)


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


def node_tracks(
    own: Mapping[str, Float[np.ndarray, " _"]], local: Float[np.ndarray, "T 4 4"], distance: float, angle: float
) -> dict[str, Float[np.ndarray, "T _"]]:
    """Decompose local transforms into those of translation, rotation and scale that differ from the file's.

    Args:
        own: the properties that the node has in the file.
        distance: difference of translations that counts as none, in the unit of the node's parent.
        angle: the same of rotations, in radians, and of scales, relative.
    """
    from scipy.spatial.transform import Rotation

    linear = local[:, :3, :3]
    # Scales are those of the bind pose, which the file's nodes may not be in, nor have been mirrored since.
    signs = np.where(own["scale"] < 0, -1.0, 1.0)
    mirrored = np.linalg.det(linear[0]) * signs.prod() < 0
    scale = np.linalg.norm(linear, axis=1) * (-signs if mirrored else signs)
    rotation = Rotation.from_matrix(nearest_rotation(linear / np.where(scale == 0, 1.0, scale)[:, None])).as_quat()
    values = {
        "translation": (local[:, :3, 3], distance),
        # Two unit quaternions with the angle x between them are rotations 2 x apart.
        "rotation": (continuous_quaternions(rotation, own["rotation"]), angle / 2),
        "scale": (scale, angle * np.abs(scale).max()),
    }
    return {
        path: _constant_if_still(track, tolerance)
        for path, (track, tolerance) in values.items()
        if np.linalg.norm(track - own[path], axis=1).max() > tolerance
    }


def _constant_if_still(track: Float[np.ndarray, "T C"], tolerance: float) -> Float[np.ndarray, "T C"]:
    """Take the first value in all frames if the others differ by rounding errors alone: it has one key then."""
    still = np.linalg.norm(track - track[0], axis=1).max() <= tolerance
    return np.broadcast_to(track[0], track.shape) if still else track
