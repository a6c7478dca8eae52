"""Reads the own rig of a glTF character and the joints of a glTF clip, and moves the rig's nodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float, Int

from ...bodies.character_limbs import FindJoints, moves_vertices
from ...bodies.character_pool import sampled_poses
from ...bodies.joint_names import ancestors
from ...bodies.skinned_character import SkinnedCharacter
from ...core.errors import InputError, damaged
from ...core.geometry import continuous_quaternions, nearest_rotation
from ...core.mesh import Mesh
from ...core.normalization import axis_name
from ...core.person_motion import PersonMotion
from ...motions.animal_rig import animal_rig
from ...motions.bvh import SCALED
from ...motions.humanoid_rig import HumanoidRig, humanoid_rig
from .animation import AnimatedValues, AnimationChannel, animated_nodes, sample_joints
from .character import names_person, read_clips, read_standing, read_standing_animal, rig_at_rest
from .document import Document
from .edit import GltfSource
from .motion import PLAYED_PATHS, front_before_placing, rest_matrices
from .read import RestScene, check_weights, find_skin, skin_joints, unweighted_parts
from .scene import (
    local_matrices,
    local_matrix,
    node_name,
    node_parents,
    node_properties,
    sort_parents_first,
    unbound_joints,
    used_skins,
    world_matrices,
)

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
    still: frozenset[int] = field(kw_only=True)
    """Nodes of joints that move no vertex and that no rotation can be given: they stay as the file has them."""
    notes: tuple[str, ...] = field(kw_only=True)
    """What of the file cannot be moved with the rest, one line each."""

    def tracks(self, joints: list[int], transforms: Float[np.ndarray, "T K 4 4"]) -> AnimatedValues:
        """Compute the animated values of the file's nodes that give some joints a motion.

        Args:
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
            if node not in moved or node in self.still:
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
    """Read the rig of any creature or thing in its bind pose, from a mesh that comes from a glTF file."""
    source = _rigged_source(mesh)
    document = source.document
    scene = dataclasses.replace(source.rest, T_world_node=rest_matrices(document))
    rig, nodes = rig_at_rest(mesh, document, scene)
    still, notes = _check_skin(rig, nodes, document, scene)
    own = FileRig(source, rig, nodes, scene, still=still, notes=notes)
    _check_above(own, list(range(len(nodes))))
    return own


_POSES: WeakKeyDictionary[Document, dict[Any, np.ndarray]] = WeakKeyDictionary()
"""Poses in the animations of open files. They take longer to sample than all else of a rig, which each clip reads."""


def read_own_rig(mesh: Mesh, find: FindJoints | None = None, body: str = "human") -> OwnRig:
    """Read the rig of a mesh that comes from a glTF file.

    Args:
        find: finds joints of a person whose names say nothing.

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
    still, notes = _check_skin(rig, nodes, document, standing.scene)
    turn = standing.turn

    def poses() -> np.ndarray:
        rest = standing.scene.T_world_node[nodes]
        known, key = _POSES.setdefault(document, {}), (rest.tobytes(), tuple(nodes))
        if key not in known:
            known[key] = sampled_poses(read_clips(document, rest, nodes, rig.parents), rig, np.eye(3))
        return known[key]

    if of_animal:
        humanoid, order = animal_rig(rig, turn, path)
    else:
        humanoid, order = humanoid_rig(rig, turn, standing.known, poses, path)
    ordered = [nodes[k] for k in order]
    notes += _apart(humanoid)
    up, front = axis_name(humanoid.turn[1]), axis_name(humanoid.turn[2])
    if up != "+y":
        stands = f"by its rig it stands up {up} and faces {front}, and so does the result; export it y up"
        notes += (f"{path.name} lies: {stands}",)
    own = OwnRig(source, humanoid.character, ordered, standing.scene, humanoid, still=still, notes=notes)
    _check_above(own, humanoid.tree()[0])
    hips = own.person["Hips"]
    worlds = np.stack([own.scene.T_world_node[hips], world_matrices(document)[hips]])
    if np.prod(np.linalg.det(worlds[:, :3, :3])) < 0:
        raise InputError(f"{path}: expected a rig as it was bound, found a mirrored one; apply its scale")
    return own


def has_rig(mesh: Mesh) -> bool:
    """Return whether a mesh comes from a glTF file with a skin, or with several parts that move or are a person's."""
    if not isinstance(mesh.source, GltfSource):
        return False
    document = mesh.source.document
    return bool(used_skins(document)) or len(animated_nodes(document, PLAYED_PATHS)) > 1 or names_person(document)


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

    def scaled(self) -> list[str]:
        """List the nodes whose sizes the animation changes, by name."""
        nodes, found = self.document.gltf["nodes"], []
        for channel in self.channels:
            if channel.path == "scale":
                own = node_properties(nodes[channel.node])["scale"]
                if (np.abs(channel.sample(self.times) - own) > SCALED * np.abs(own).max()).any():
                    found.append(node_name(self.document, channel.node))
        return found

    def person(self) -> PersonMotion:
        """Read the joints of a person."""
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
        if motion.up != "+y":
            return motion
        return dataclasses.replace(motion, front=front_before_placing(document, rig.scene.T_world_node, motion.front))


def check_sound(rig: SkinnedCharacter, T_world_joint: Float[np.ndarray, "J 4 4"], path: object) -> None:
    """Check that vertices have joints, and that joints can be animated."""
    check_weights(_unjointed(rig), 0.0, path)
    _check_scales(T_world_joint[_weighted(rig)], path)


def _unjointed(rig: SkinnedCharacter) -> float:
    return float((rig.weights * (rig.joint_of == len(rig.parents))).sum(axis=1).mean())


def _weighted(rig: SkinnedCharacter) -> Int[np.ndarray, " K"]:
    return np.unique(rig.joint_of[(rig.weights > 0) & (rig.joint_of < len(rig.parents))])


def _rigged_source(mesh: Mesh) -> GltfSource:
    source = mesh.source
    if not isinstance(source, GltfSource) or not has_rig(mesh):
        raise InputError(f"{mesh.name}: expected a skin, found none; export the mesh together with its armature")
    return source


def _check_skin(
    rig: SkinnedCharacter, nodes: list[int], document: Document, scene: RestScene
) -> tuple[frozenset[int], tuple[str, ...]]:
    """Check joints and weights; returns nodes that move nothing and cannot be animated, and notes of what stays."""
    path, local, moving = document.path, local_matrices(document)[nodes], moves_vertices(rig)
    check_weights(0.0, _unjointed(rig), path)
    # A rigid part may be scaled unequally, unless others hang on it: these would be sheared.
    holding = np.isin(np.arange(len(nodes)), [parent for j, parent in enumerate(rig.parents) if moving[j]])
    skinned = bool(skin_joints(document, scene))
    weighted = _weighted(rig)
    _check_scales(scene.T_world_node[nodes][weighted], path, (holding | skinned)[weighted])
    _check_scales(local[moving], path, (holding | skinned)[moving])
    unskinned = [span for span in scene.vertex_ranges if rig.joint_of[span.start, 0] == len(nodes)]
    still: list[int] = []
    for joint, parent in enumerate(rig.parents):
        if not moving[joint] and (parent in still or _scale_fault(local[joint, None], True)):
            still.append(joint)
    skins = {skin for span in scene.vertex_ranges if (skin := find_skin(document, span)) is not None}
    unbound = [
        document.gltf["skins"][skin]["joints"][joint]
        for skin in sorted(skins)
        for joint in unbound_joints(document, skin)
    ]
    left = {
        "joints without a usable inverse bind matrix, which count as bound where they are": dict.fromkeys(
            node_name(document, node) for node in unbound
        ),
        "parts without weights, which are not bent": unweighted_parts(document, scene),
        "parts without a joint, which stay where they are": dict.fromkeys(
            node_name(document, span.node) for span in unskinned
        ),
        "joints with an unequal scale or none, which move no vertex": [rig.joint_names[joint] for joint in still],
    }
    notes = (f"{path.name} has {what}: {', '.join(names)}" for what, names in left.items() if names)
    return frozenset(nodes[joint] for joint in still), tuple(notes)


def _apart(humanoid: HumanoidRig) -> tuple[str, ...]:
    """Return a note on skeletons beside the person's, which move vertices and go with the hips."""
    rig = humanoid.character
    roots = [ancestors(rig.parents, joint)[-1] for joint in range(len(rig.parents))]
    own = {roots[joint] for joint in humanoid.joints.values()}
    apart = dict.fromkeys(rig.joint_names[roots[joint]] for joint in _weighted(rig) if roots[joint] not in own)
    return (f"skeletons beside the person's, which go with the hips: {', '.join(apart)}",) if apart else ()


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


def _check_scales(
    transforms: Float[np.ndarray, "J 4 4"], path: object, equal: Bool[np.ndarray, " J"] | bool = True
) -> None:
    """Check that joints have a size, no shear and, where they are `equal`, the same scale along all axes."""
    if fault := _scale_fault(transforms, equal):
        raise InputError(f"{path}: {fault}")


def _scale_fault(transforms: Float[np.ndarray, "J 4 4"], equal: Bool[np.ndarray, " J"] | bool) -> str:
    """Say what is wrong with the scales of joints, and what to do; empty if nothing is."""
    linear = transforms[:, :3, :3]
    scale = np.linalg.norm(linear, axis=1)
    if not (scale > 0).all():
        return "expected joints with a size, found one scaled to nothing; give it a size"
    unit = linear / scale[:, None]
    unequal = (np.ptp(scale, axis=1) > SHEAR * scale.max(axis=1)) & equal
    if np.abs(unit.swapaxes(-1, -2) @ unit - np.eye(3)).max(initial=0.0) > SHEAR or unequal.any():
        return "expected joints scaled equally along all axes, found others; apply their scale"
    return ""


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
    found = {}
    for path, (track, tolerance) in values.items():
        if np.linalg.norm(track - own[path], axis=1).max() > tolerance:
            # What differs by rounding alone has the first value in all frames: it has one key then.
            still = np.linalg.norm(track - track[0], axis=1).max() <= tolerance
            found[path] = np.broadcast_to(track[0], track.shape) if still else track
    return found
