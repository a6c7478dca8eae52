"""Reads rigged .glb, .gltf, .vrm or .fbx of any maker: people and animals with limbs and clips, like those of a pool.

Rest is the bind pose of the largest skin (`motion.rest_matrices`); the nodes' transforms in the file are often a frame
of an animation, and are used only where the bind pose does not stand. Joints are found by VRM's humanoid bones, where
the file lists them, else by their names. A file without skins is a figure of rigid parts: moving nodes are its joints.

Facing: glTF characters face +z and VRM 0 characters -z. Joint names and feet check that: where two of the three agree,
they are right. Some makers export -z, others name sides as the viewer sees them. Animals face where their heads are.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...bodies.animal_limbs import name_animal_joints
from ...bodies.character_limbs import (
    SIDES,
    FindJoints,
    UnnamedJoints,
    attach_feet,
    carried_vertices,
    find_limbs,
    limbs_by_name,
    missing_limbs,
    name_limb_joints,
    name_sided_joints,
)
from ...bodies.character_pool import (
    CLASSES,
    CharacterClip,
    CharacterMeta,
    PoolCharacter,
    facing_rotation,
    sampled_poses,
)
from ...bodies.joint_names import ancestors, without_fingers
from ...bodies.skinned_character import SkinnedCharacter
from ...core.errors import InputError, damaged
from ...core.geometry import nearest_rotation
from ...core.mesh import Mesh, check_mesh
from ...core.rig import homogeneous
from ...motions.animal_rig import animal_facing
from ...motions.posed_rest import action_front, on_all_fours, rests_in_action
from .animation import animated_nodes, animation_names, frame_times, read_channels, sample_joints
from .document import Document, open_document
from .motion import PLAYED_PATHS, bind_poses, is_motion, rest_matrices
from .read import RestScene, read_rest, rig_on_nodes, skin_joints
from .scene import node_parents, scene_nodes, sort_parents_first, world_matrices
from .vrm import read_origin, vrm_bones, vrm_version

CLIP_FPS = 30.0
"""Frame rate at which clips are read."""
MAX_FRAMES = 1800
"""Frames that are read of a clip: one minute."""
UPRIGHT = 0.5
"""Cosine of the largest angle (60 degrees) between trunk or legs of a character that stands and the vertical."""
LEANING = 0.85
"""The same (32 degrees) of a character whose arms reach the ground."""
NEAR_GROUND = 0.1
"""Height above the lowest vertex, in heights of the character, below which arms reach the ground."""
SHORTEST_LEG = 0.05
"""Smallest height of the hips above the lowest vertex, in heights of the character."""
SHORTEST_TOES = 0.02
"""Smallest distance from ankle to the middle of the foot that says where a foot points, in heights of the character."""
APART = 0.1
"""Largest share of the skinning weight on skeletons without any joint of the character: a second character, or LODs."""
APART_PROP = 0.5
"""The same on skeletons whose joints are not named as limbs: a prop may have more vertices than who carries it."""
NOT_STATED = "not stated"
"""Licence of a character whose file and folder name none."""
PAIRS = ("UpLeg", "Arm")
"""Joints whose two sides say where left is."""
AXES = {"+z": (0, 1), "-z": (0, -1), "+x": (1, 0), "-x": (-1, 0)}
"""Horizontal direction (x, z) of each facing."""


def read_rigged_character(path: str | Path, pack: str = "", licence: str = "", body: str = "human") -> PoolCharacter:
    """Read a character, turned to face +z, with all of its clips, which are in its file.

    Args:
        licence: of files that do not state one.
        body: `human`, or `quadruped` of an animal, which has no limbs.

    Raises:
        InputError: a damaged file, no mesh, no limbs by name, a character that does not stand upright, or an animal
            without four legs on one skeleton.
    """
    path, of_animal = Path(path), body == "quadruped"
    document = open_document(path)
    if is_motion(document):
        raise InputError(f"{path}: expected a rigged mesh, found animations without a mesh; give them with --clips")
    mesh, scene = read_rest(document)
    standing = (read_standing_animal if of_animal else read_standing)(check_mesh(mesh, path), document, scene)
    turn, nodes = standing.turn, standing.nodes
    rig = carried_part(standing.rig).turned(turn)
    clips, file_parents = read_clips(document, standing.scene.T_world_node[nodes], nodes, rig.parents), rig.parents
    (maker, stated), clips_file = read_origin(document), str(path) if clips else ""
    licence = stated or licence or NOT_STATED
    meta = CharacterMeta(path.stem, pack, maker, licence, "", CLASSES[body], "train", standing.facing, clips_file)
    if of_animal:
        joints, order = name_animal_joints(rig, path), np.arange(len(rig.parents))
        return PoolCharacter(meta, rig, joints, {}, clips, file_parents, order, turn)
    joints = name_limb_joints(rig, path, without_fingers(standing.known))
    rig, joints, order = attach_feet(rig, joints, sampled_poses(clips, rig, turn), path)
    return PoolCharacter(meta, rig, joints, find_limbs(rig, joints, path), clips, file_parents, order, turn)


def read_clips(
    document: Document, T_world_rest: Float[np.ndarray, "J 4 4"], nodes: list[int], parents: Iterable[int]
) -> dict[str, CharacterClip]:
    """Read the animations of a file as frames of joints relative to their parents; scales are dropped."""
    from scipy.spatial.transform import Rotation

    clips = {}
    rest_inverse = np.linalg.pinv(T_world_rest[:, :3, :3])
    rest_rotation = nearest_rotation(T_world_rest[:, :3, :3])
    for number, name in enumerate(animation_names(document)):
        channels = read_channels(document, number)
        if not any(channel.path == "rotation" for channel in channels):
            continue
        times = frame_times(document, channels, CLIP_FPS)[:MAX_FRAMES]
        world = sample_joints(document, channels, times, nodes)
        if not np.isfinite(world).all():
            continue
        rigid = homogeneous(nearest_rotation(world[..., :3, :3] @ rest_inverse) @ rest_rotation, world[..., :3, 3])
        local = rigid.copy()
        for j, parent in enumerate(parents):
            if parent >= 0:
                local[:, j] = np.linalg.inv(rigid[:, parent]) @ rigid[:, j]
        quaternions = Rotation.from_matrix(local[..., :3, :3].reshape(-1, 3, 3)).as_quat()
        clips[name] = CharacterClip(quaternions.reshape(*local.shape[:2], 4), local[..., :3, 3])
    return clips


class NotUpright(InputError):
    """A character that does not stand upright in the pose that is taken as its rest pose."""


NO_PERSON = (UnnamedJoints, NotUpright)
"""Reasons why a rig is not that of a person, so that it may be that of an animal."""


@dataclass(frozen=True, eq=False)
class StandingCharacter:
    """A character of a glTF file in a rest pose in which it stands."""

    rig: SkinnedCharacter
    """All vertices of the Mesh; joint frames without scales."""
    nodes: list[int]
    """Node of each joint."""
    facing: str
    """Where it faces once it is upright, such as +z."""
    known: dict[str, int]
    """Joints that the file itself names, or that were found without names: joint of the shipped body -> index."""
    scene: RestScene
    """The scene with its nodes in that pose."""
    upright: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    """Rotation that sets it upright, of a person who lies in the file."""

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """Rotation from the file's axes to y up, +z front."""
        return facing_rotation(self.facing) @ self.upright


def read_standing(
    mesh: Mesh, document: Document, scene: RestScene, find: FindJoints | None = None
) -> StandingCharacter:
    """Read the rig of a scene in its bind pose, or in the pose of the file's nodes where it stands in none.

    A person who lies in a T- or A-pose, as those of z-up programs that were not converted do, is read as it stands in
    its own axes; others who do not stand were bound in an action.

    Args:
        find: finds joints whose names say nothing.

    Raises:
        InputError: limbs that are not found, or several characters; `NotUpright` of who is on all fours.
    """
    for T_world_node in bind_poses(document):
        bound = dataclasses.replace(scene, T_world_node=T_world_node)
        try:
            return _standing(mesh, document, bound, find)
        except NotUpright:
            continue  # the bind pose may have another orientation
        except InputError:
            break
    try:
        return _standing(mesh, document, scene, find)
    except NotUpright:
        bound = dataclasses.replace(scene, T_world_node=rest_matrices(document))
        return _standing(mesh, document, bound, find, fallen=True)


def _standing(
    mesh: Mesh, document: Document, scene: RestScene, find: FindJoints | None, fallen: bool = False
) -> StandingCharacter:
    """Read the rig with the nodes of `scene` as its rest pose; who is `fallen` stands in none; see `read_standing`."""
    path, bones = document.path, vrm_bones(document)
    rig, nodes = rig_at_rest(mesh, document, scene, without_fingers(bones).values())
    known = {name: nodes.index(node) for name, node in bones.items() if node in nodes}
    if find is not None:
        try:
            name_sided_joints(rig, path, known)
        except UnnamedJoints:
            known = find(carried_part(rig))
    upright = _upright(rig, name_sided_joints(rig, path, known)) if fallen else np.eye(3)
    rule = "-z" if vrm_version(document) == 0 else "+z"
    facing = standing_facing(rig.turned(upright), known, rule, path, fallen)
    return StandingCharacter(rig, nodes, facing, known, scene, upright)


def _upright(rig: SkinnedCharacter, joints: dict[str, int]) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation that takes the axis nearest to a person's trunk, from the hips up, to y.

    It is about x, as conversions between programs with other axes are, unless the trunk is along x. None is needed
    where the person is in action after it, too: then it was bound as it is.
    """
    trunk = _middle(rig, joints, "Arm") - _middle(rig, joints, "UpLeg")
    up = np.where(np.arange(3) == np.abs(trunk).argmax(), np.sign(trunk), 0.0)
    left = np.cross(up, [0.0, 0.0, 1.0]) if up[0] else np.array([1.0, 0.0, 0.0])
    upright = np.stack([left, up, np.cross(left, up)])
    return np.eye(3) if rests_in_action(_places(rig.turned(upright), joints)) else upright


def rig_at_rest(
    mesh: Mesh, document: Document, scene: RestScene, bones: Collection[int] = ()
) -> tuple[SkinnedCharacter, list[int]]:
    """Read the rig of a mesh with the nodes of `scene` as its rest pose, without scales, and the node of each joint.

    Joints are those of the shown skins, else the nodes of rigid parts, and `bones`.
    """
    path, joint_nodes = document.path, skin_joints(document, scene)
    if not joint_nodes:
        joint_nodes = _rigid_parts(document)
    rig, nodes = rig_on_nodes(mesh, document, scene, joint_nodes.union(bones))
    if not all(np.isfinite(array).all() for array in (rig.points, rig.T_world_joint)):
        raise damaged(path, "a rest pose of finite numbers", "NaN or infinity")
    frames = homogeneous(nearest_rotation(rig.T_world_joint[:, :3, :3]), rig.joints)
    at_rest = dataclasses.replace(mesh, vertices=(rig.weights[..., None] * rig.points).sum(axis=1))
    return dataclasses.replace(rig, mesh=at_rest, T_world_joint=frames), nodes


def names_person(document: Document) -> bool:
    """Tell whether the nodes of rigid parts are named as the joints of a person, or listed as such by a VRM file.

    Not where they are at one place, as the parts of a mesh that was cut: these have no joints to turn about.
    """
    if vrm_bones(document):
        return True
    limbs = _limb_nodes(document, _rigid_parts(document))
    places = world_matrices(document)[[limbs[side + part] for part in PAIRS for side in SIDES if limbs], :3, 3]
    return bool(limbs) and bool((np.ptp(places.reshape(2, 2, 3), axis=1).max(axis=-1) > 0).all())


def _rigid_parts(document: Document) -> set[int]:
    """List the nodes that show a mesh or that an animation moves; those above them too, if these name the limbs."""
    parts = animated_nodes(document, PLAYED_PATHS)
    parts |= {node for node in scene_nodes(document) if "mesh" in document.gltf["nodes"][node]}
    node_parent = node_parents(document)
    above = {node for part in parts for node in ancestors(node_parent, part)}
    return above if not _limb_nodes(document, parts) and _limb_nodes(document, above) else parts


def _limb_nodes(document: Document, nodes: Collection[int]) -> dict[str, int]:
    """Find the nodes of limbs by name among some; none where thighs or upper arms are missing."""
    order = [node for node in sort_parents_first(document, node_parents(document)) if node in nodes]
    names = tuple(str(document.gltf["nodes"][node].get("name", "")) for node in order)
    found = limbs_by_name(names, (-1,) * len(names))
    return {} if missing_limbs(found) else {name: order[joint] for name, joint in found.items()}


def standing_facing(rig: SkinnedCharacter, known: dict[str, int], rule: str, path: object, fallen: bool = False) -> str:
    """Check that a rig is that of one person who stands, and find where the person faces; see `find_facing`.

    Args:
        known: joints that the file itself names.
        fallen: who does not stand, lies in no T-pose and is not on all fours was bound in an action; the hips tell the
            facing.

    Raises:
        InputError: limbs that are not found by name, several characters, or a trunk that is not upright.
    """
    part, joints = carried_part(rig), name_sided_joints(rig, path, known)
    # Nearly all weights are to be on the skeletons of the named joints; a rig may have several roots.
    roots = np.array([ancestors(part.parents, j)[-1] for j in range(len(part.parents))])
    named = np.isin(roots, roots[list(joints.values())])
    apart = (part.weights * ~np.append(named, True)[part.joint_of]).sum() / part.weights.sum()
    others = tuple(name for name, of_person in zip(part.joint_names, named, strict=True) if not of_person)
    prop = bool(missing_limbs(limbs_by_name(others, (-1,) * len(others))))
    if apart > (APART_PROP if prop else APART):
        raise InputError(
            f"{path}: expected one character, found {apart:.0%} of the weights on other skeletons; export it alone"
        )
    if not _stands(part, joints):
        places = _places(part, joints)
        if fallen and not on_all_fours(places) and np.array_equal(_upright(part, joints), np.eye(3)):
            return _nearest_axis(action_front(places))
        raise NotUpright(f"{path}: expected a character that stands upright at rest, y up, found another rest pose; "
                         "turn it, or leave it out")  # fmt: skip
    return find_facing(part, joints, rule)


def _stands(rig: SkinnedCharacter, joints: dict[str, int]) -> bool:
    """Tell whether a character stands upright on its legs, y up, and not on all fours as animals do.

    Animals may have the names of a person's joints, and a wrong orientation sets them on their hind legs: these are
    then horizontal, as a trunk is that front legs carry. Of 205 files of people, monsters and figures of blocks, trunks
    lean by up to 8 degrees, legs point down within 39 degrees, and arms end above 0.22 of the height.
    """
    heights = rig.mesh.vertices[:, 1]
    ground, height = heights.min(), np.ptp(heights)
    hips, shoulders = (_middle(rig, joints, part) for part in ("UpLeg", "Arm"))
    ends = []
    for side in SIDES:
        # The lower end of a leg: its ankle, else its knee, else the middle of what its one joint carries.
        tail = next((joints[side + part] for part in ("Foot", "Leg") if side + part in joints), None)
        joint = joints[f"{side}UpLeg"] if tail is None else tail
        carried = carried_vertices(rig, joint) & (tail is None)
        ends.append(rig.mesh.vertices[carried].mean(axis=0) if carried.any() else rig.joints[joint])
    trunk, legs = shoulders - hips, hips - np.mean(ends, axis=0)
    arms = np.any([carried_vertices(rig, joints[f"{side}Arm"]) for side in SIDES], axis=0)
    on_arms = heights[arms].min(initial=np.inf) - ground < NEAR_GROUND * height
    return bool(
        trunk[1] > (LEANING if on_arms else UPRIGHT) * np.linalg.norm(trunk)
        and legs[1] >= UPRIGHT * np.linalg.norm(legs)
        and hips[1] - ground > SHORTEST_LEG * height
    )


def find_facing(rig: SkinnedCharacter, joints: dict[str, int], rule: str) -> str:
    """Find where a character faces: the rule of its format, where its joints' names or its feet agree with it.

    Args:
        joints: joints by name, left and right as the maker named them.
        rule: facing by the rule of the file's format, such as +z.
    """
    hips, shoulders = (rig.joints[joints[f"Left{part}"]] - rig.joints[joints[f"Right{part}"]] for part in PAIRS)
    left = hips + shoulders
    front = np.array([-left[2], left[0]])  # x and z of left x up
    by_names = _nearest_axis(front)
    if by_names == rule:
        return rule
    toes = np.zeros(2)
    for foot in (joints[f"{side}Foot"] for side in SIDES if f"{side}Foot" in joints):
        carried = carried_vertices(rig, foot)
        if carried.any():  # horizontal vector from the ankle to the middle of the foot
            points = rig.mesh.vertices[carried]
            toes += ((points.min(axis=0) + points.max(axis=0)) / 2 - rig.joints[foot])[[0, 2]]
    ahead = toes @ AXES[by_names]
    if abs(ahead) > 2 * SHORTEST_TOES * np.ptp(rig.mesh.vertices[:, 1]):
        return by_names if ahead > 0 else _nearest_axis(-np.array(AXES[by_names]))
    # Feet do not say: sides that the viewer sees are more frequent than files that break the rule.
    return rule if np.dot(AXES[rule], AXES[by_names]) < 0 else by_names


def _nearest_axis(direction: np.ndarray) -> str:
    """Find the facing whose axis is nearest to a horizontal direction (x, z)."""
    return max(AXES, key=lambda axis: float(np.dot(AXES[axis], direction)))


def _middle(rig: SkinnedCharacter, joints: dict[str, int], part: str) -> Float[np.ndarray, " 3"]:
    return (rig.joints[joints[f"Left{part}"]] + rig.joints[joints[f"Right{part}"]]) / 2


def _places(rig: SkinnedCharacter, joints: dict[str, int]) -> dict[str, Float[np.ndarray, " 3"]]:
    return {name: rig.joints[joint] for name, joint in joints.items()}


def carried_part(rig: SkinnedCharacter) -> SkinnedCharacter:
    """Leave out triangles that no joint carries (a floor, a stand), and vertices without triangles."""
    carried = (rig.weights * (rig.joint_of < len(rig.parents))).sum(axis=1) > 0
    faces = rig.mesh.faces[carried[rig.mesh.faces].all(axis=1)]
    if not len(faces):
        raise InputError(f"{rig.mesh.name}: expected triangles that joints carry, found none; bind the mesh again")
    return rig.part(faces)


def read_standing_animal(mesh: Mesh, document: Document, scene: RestScene) -> StandingCharacter:
    """Read the rig of a scene in its bind pose, or in the pose of the file's nodes where it stands in none.

    Bind poses of other orientations are not tried: a person who lies has four feet on the ground, too.
    """

    def standing(scene: RestScene) -> StandingCharacter:
        rig, nodes = rig_at_rest(mesh, document, scene)
        return StandingCharacter(rig, nodes, animal_facing(carried_part(rig), document.path), {}, scene)

    with contextlib.suppress(InputError):
        return standing(dataclasses.replace(scene, T_world_node=rest_matrices(document)))
    return standing(scene)
