"""`cross-body`: rigged characters by other authors. The driving mesh and the truth are two of them in the same pose.

The characters are a folder of .glb, .gltf or .vrm files (y up, facing +z). A pose of the shipped body becomes rotations
of their joints, which are found by name, after each limb has been turned from its own rest direction to that of the
shipped body. So a pose means the same directions in the world for every character, and characters with one skeleton and
one rest pose get the same joint rotations.

Splits: of each skeleton that three or more characters share, the first one by file name belongs to `val` and the others
to `test`; no character is in both. Pairs of `test` have one skeleton, pairs of `val` have two different ones. Poses are
drawn like those of `human-wide`, with other seeds.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from itertools import permutations
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody
from ..bodies.body_model import landmarks
from ..bodies.joint_names import ancestors, named_joints, plain_names, require_joints
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..core.rig import local_rotations
from ..io.gltf.skin_file import read_skin
from ..motions.retarget import BONES, NEEDED, alignments
from .pairs import Pair, Pose, human
from .protocols import Wide

SUFFIXES = (".glb", ".gltf", ".vrm")


@dataclass(frozen=True)
class CrossBody(Wide):
    """Pairs of characters of a folder. Two of three identities are in the rest pose of their file."""

    data: Path = Path()
    """The folder of characters."""

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        pairs = self.character_pairs(split)
        identity, driving = pairs[(i + self.kinds.index(kind)) % len(pairs)]
        in_file_pose = rng.random() < 2 / 3
        file_pose = Pose(pose_at_rest(identity, human()), "rest")
        rest = file_pose if in_file_pose else self.sample_rest_pose(split, kind, i, rng)
        pose = self.sample_driving_pose(split, kind, i, rng)
        return _make_pair(identity, driving, rest, pose)

    def character_pairs(self, split: str) -> list[tuple[SkinnedCharacter, SkinnedCharacter]]:
        """Return all ordered pairs (identity, driving) of characters of a split.

        Raises:
            InputError: the folder has no pairs for this split, or a character that `check_character` refuses.
        """
        if split not in ("val", "test"):
            raise InputError(f"{split}: expected val or test of {self.name}, found no such split; nobody trains on it")
        return _character_pairs(self.data, split)


def cross_body(data: str | Path) -> CrossBody:
    """Return the protocol for the characters of a folder.

    Raises:
        InputError: no folder, or one without two characters with the same skeleton.
    """
    protocol = CrossBody("cross-body", 1, ("table6", "limits", "clips"), pairs=12, spread=0.0, data=Path(data))
    protocol.character_pairs("test")
    return protocol


def pose_on_rig(
    rig: SkinnedCharacter, body: RiggedBody, rotmat: Float[np.ndarray, "J 3 3"]
) -> Float[np.ndarray, "R 3 3"]:
    """Return local joint rotations that give a rig the pose of the shipped body.

    Limb bones get exactly the directions of the body's bones. Joints without a known name follow their parent, and a
    root above the hips rotates like the hips, because in some rigs the legs are children of that root.
    """
    index = named_joints(rig.joint_names, rig.parents)
    aligned = alignments(rig.joints, index, body)
    body_world, _ = body.skinning_transforms(body.joints, rotmat)
    # World rotation of a named joint: first from the rig's rest direction to the body's, then as the body's joint.
    named = {j: body_world[body.joint(joint)] @ aligned.get(joint, np.eye(3)).T for joint, j in index.items()}
    world = np.empty((len(rig.parents), 3, 3))
    for j, parent in enumerate(rig.parents):
        world[j] = named[j] if j in named else world[parent] if parent >= 0 else named[index["Hips"]]
    return local_rotations(world[None], rig.parents)[0]


def pose_at_rest(rig: SkinnedCharacter, body: RiggedBody) -> Float[np.ndarray, "J 3 3"]:
    """Return the local joint rotations that give the shipped body the rest pose of a rig, such as an A-pose."""
    aligned = alignments(rig.joints, named_joints(rig.joint_names, rig.parents), body)
    world = np.stack([aligned.get(joint, np.eye(3)) for joint in body.joint_names])
    return local_rotations(world[None], body.parents)[0]


def find_landmarks(rig: SkinnedCharacter) -> Int[np.ndarray, "M"]:
    """Find the vertices of a rig at the landmarks of the shipped body (`body_model.LANDMARKS`)."""
    body, index = human(), named_joints(rig.joint_names, rig.parents)
    t_pose = pose_on_rig(rig, body, np.tile(np.eye(3), (len(body.parents), 1, 1)))
    # Rigs without toes get the position of the ankle for them; where toes exist, `index` overrides it.
    substitutes = {joint: index[joint.replace("ToeBase", "Foot")] for joint in ("LeftToeBase", "RightToeBase")}
    points = {joint: (j, rig.joints[j]) for joint, j in {**substitutes, **index}.items()}
    return np.array(list(landmarks(as_body(rig, rig.skinning_transforms(t_pose), index, points)).values()))


def as_body(
    rig: SkinnedCharacter,
    t_pose: Float[np.ndarray, "K 4 4"],
    index: dict[str, int],
    points: dict[str, tuple[int, Float[np.ndarray, " 3"]]],
) -> RiggedBody:
    """Wrap a rig in the shipped body's T-pose and at its height as a RiggedBody with the body's joints.

    Functions of the shipped body such as `landmarks` work on it. Each vertex is weighted to the nearest named joint
    above its own joint.

    Args:
        t_pose: transforms of the rig's joints from rest to the T-pose.
        index: the rig's joint of each joint of the body that it has.
        points: place of each joint of the body: a joint of the rig, and the point at rest that it carries.
    """
    body = human()
    scale = np.ptp(body.vertices[:, 1]) / np.ptp(rig.mesh.vertices[:, 1])
    joints = body.joints.copy()
    for joint, (j, point) in points.items():
        joints[body.joint(joint)] = scale * (t_pose[j] @ [*point, 1.0])[:3]
    # Influences of the fixed world count as the root joint.
    columns = rig.nearest_columns({j: body.joint(joint) for joint, j in index.items()}, other=0)
    weights = rig.summed_weights(columns, len(body.parents))
    return shapeless(body, "", scale * rig.skinned(t_pose), rig.mesh.faces, joints, weights)


def shapeless(
    body: RiggedBody,
    name: str,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    joints: Float[np.ndarray, "J 3"],
    weights: Float[np.ndarray, "V J"],
) -> RiggedBody:
    """Return another body with the joint tree of a shipped one, and no shape coefficients."""
    no_shapes, no_joint_shapes = np.zeros((0, len(vertices), 3)), np.zeros((0, len(joints), 3))
    return RiggedBody(
        name, vertices, faces, no_shapes, joints, no_joint_shapes, weights, body.joint_names, body.parents
    )


def check_character(rig: SkinnedCharacter, path: str | Path) -> SkinnedCharacter:
    """Return the rig if it can take the poses of the shipped body.

    Raises:
        InputError: limb joints with unknown names, limbs that are not chains (such as feet that are children of the
            root), or a character that is not y up and facing +z.
    """
    index = named_joints(rig.joint_names, rig.parents)
    require_joints(index, NEEDED, rig.joint_names, path)
    for joint, tail in BONES.items():
        if not _is_below(rig, index[tail], index[joint]):
            raise InputError(
                f"{path}: expected {rig.joint_names[index[tail]]} below {rig.joint_names[index[joint]]}, found it "
                "elsewhere in the skeleton; export the deforming bones as chains"
            )
    left, right, foot = (rig.joints[index[joint]] for joint in ("LeftUpLeg", "RightUpLeg", "LeftFoot"))
    if not (left[0] > right[0] and left[1] > foot[1]):
        raise InputError(
            f"{path}: expected a person who stands y up and faces +z, found the left hip at {left.round(3).tolist()}, "
            f"the right at {right.round(3).tolist()}, the left foot at {foot.round(3).tolist()}; turn it, export again"
        )
    return rig


@cache
def _character_pairs(data: Path, split: str) -> list[tuple[SkinnedCharacter, SkinnedCharacter]]:
    """Return the ordered pairs of a split; see the module for who is in which split."""
    skeletons = _skeletons(data)
    if split == "test":
        groups = [group[1:] if len(group) > 2 else group for group in skeletons]
        pairs = [pair for group in groups for pair in permutations(group, 2)]
        expected = "two characters of one skeleton"
    else:
        pairs = list(permutations([group[0] for group in skeletons if len(group) > 2], 2))
        expected = "two skeletons of three characters each"
    if not pairs:
        raise InputError(
            f"{data}: expected {expected} among its .glb, .gltf and .vrm files for the split {split}, found skeletons "
            f"of {', '.join(str(len(group)) for group in skeletons) or 'no'} characters; add some"
        )
    return pairs


@cache
def _skeletons(data: Path) -> list[list[SkinnedCharacter]]:
    """Read the characters of a folder, sorted by file name, and group them by skeleton (see `_skeleton`).

    Skeletons of one character are left out.
    """
    if not data.is_dir():
        raise InputError(f"{data}: expected a folder of rigged characters, found none; give it with --data")
    groups: dict[frozenset[tuple[str, str]], dict[Path, SkinnedCharacter]] = {}
    for path in sorted(path for path in data.iterdir() if path.suffix.lower() in SUFFIXES):
        rig = read_skin(path)
        groups.setdefault(_skeleton(rig), {})[path] = rig
    return [[check_character(rig, path) for path, rig in group.items()] for group in groups.values() if len(group) > 1]


def _skeleton(rig: SkinnedCharacter) -> frozenset[tuple[str, str]]:
    """Return the names of the joints that are a person's, each with that of the next one above it.

    Namespaces (mixamorig, mixamorig7), the order of joints and others beside a person's do not matter.
    """
    plain, known = plain_names(rig.joint_names), {*named_joints(rig.joint_names, rig.parents).values()}
    known = known or {*range(len(plain))}
    above = {j: next((k for k in ancestors(rig.parents, j)[1:] if k in known), None) for j in known}
    return frozenset((plain[j], "" if k is None else plain[k]) for j, k in above.items())


def _make_pair(identity: SkinnedCharacter, driving: SkinnedCharacter, rest: Pose, pose: Pose) -> Pair:
    """Make a pair from two characters and two poses; see `pairs.make_pair`.

    The baseline `copy` needs a true correspondence, which exists only if both characters have the same triangles.
    """
    identity_rest, reference = (rig.posed(pose_on_rig(rig, human(), rest.rotmat)) for rig in (identity, driving))
    truth, driving_posed = (rig.posed(pose_on_rig(rig, human(), pose.rotmat)) for rig in (identity, driving))
    same_topology = np.array_equal(identity.mesh.faces, driving.mesh.faces)
    height = float(np.ptp(identity.mesh.vertices[:, 1]))
    return Pair(
        identity=_mesh(identity, identity_rest, rest.label),
        driving=_mesh(driving, driving_posed, pose.label),
        truth=truth,
        height=height,
        metres=1.7 / height,
        aligned=driving_posed if same_topology else None,
        aligned_reference=reference if same_topology else None,
        reference=reference,
        markers=np.stack([find_landmarks(identity), find_landmarks(driving)], axis=1),
        truth_name=f"{identity.mesh.name}_{pose.label}",
        groups=(identity.mesh.name, driving.mesh.name),
    )


def _mesh(rig: SkinnedCharacter, vertices: Float[np.ndarray, "V 3"], pose: str) -> Mesh:
    name = f"{rig.mesh.name}_{pose}"
    return dataclasses.replace(rig.mesh, vertices=vertices, corner_normals=None, source=None, name=name)


def _is_below(rig: SkinnedCharacter, joint: int, ancestor: int) -> bool:
    """Return whether a joint is a descendant of another, or that joint itself."""
    while joint >= 0 and joint != ancestor:
        joint = rig.parents[joint]
    return joint == ancestor
