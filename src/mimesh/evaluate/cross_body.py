"""`cross-body`: characters that others made and rigged. Driving and truth are two of them in one pose.

The characters are a folder of .glb, .gltf or .vrm files (y up, facing +z). A pose of our own body becomes rotations of
their bones by joint names, after each limb has been turned from where it rests to where ours rests. So a pose means the
same directions in the world for everybody, and characters of one skeleton that rest alike get the same bone rotations.

Who is in which split: of each skeleton that three or more characters share, the first by file name belongs to `val`,
and all others to `test`. No character is in both. A pair of `test` stays within one skeleton, a pair of `val` goes
across two. The poses are drawn as those of `human-wide`, with seeds of their own.
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
from ..bodies.joint_names import named_joints, require_joints
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..io.gltf.skin import read_skin
from ..motions.retarget import BONES, NEEDED, alignments, to_local
from .pairs import Pair, Pose, human
from .protocols import Wide

SUFFIXES = (".glb", ".gltf", ".vrm")


@dataclass(frozen=True)
class CrossBody(Wide):
    """Pairs of the characters in a folder, who stand as their files have them (two of three) or as in `human-wide`."""

    data: Path = Path()

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        character_pairs = self.character_pairs(split)
        mover, actor = character_pairs[(i + self.kinds.index(kind)) % len(character_pairs)]
        as_made = rng.random() < 2 / 3
        stand = Pose(pose_at_rest(mover, human()), "rest") if as_made else self.rest(split, kind, i, rng)
        played = self.played(split, kind, i, rng)
        return _stage(mover, actor, stand, played)

    def character_pairs(self, split: str) -> list[tuple[SkinnedCharacter, SkinnedCharacter]]:
        """Who is moved and who drives, in all ordered pairs of the split.

        Raises:
            InputError: the folder has no pairs for this split, or a character that cannot take our poses.
        """
        if split not in ("val", "test"):
            raise InputError(f"{split}: expected val or test of {self.name}, found no such split; nobody trains on it")
        return _character_pairs(self.data, split)


def cross_body(data: str | Path) -> CrossBody:
    """The protocol over the characters of a folder.

    Raises:
        InputError: no folder, or one without two characters of one skeleton.
    """
    protocol = CrossBody("cross-body", 1, ("table6", "limits", "clips"), pairs=12, spread=0.0, data=Path(data))
    protocol.character_pairs("test")
    return protocol


def pose_on_rig(
    rig: SkinnedCharacter, body: RiggedBody, rotmat: Float[np.ndarray, "J 3 3"]
) -> Float[np.ndarray, "R 3 3"]:
    """Local joint rotations that give the rig the pose of our body.

    Limb bones point exactly where ours point. Joints that we have no name for follow their parent, and a root above
    the hips moves as the hips do (some rigs hang their legs on it).
    """
    index = named_joints(rig.joint_names, rig.parents)
    aligned = alignments(rig.joints, index, body)
    turned, _ = body.skinning_transforms(body.joints, rotmat)
    own = {j: turned[body.joint(joint)] @ aligned.get(joint, np.eye(3)).T for joint, j in index.items()}
    world = np.empty((len(rig.parents), 3, 3))
    for j, parent in enumerate(rig.parents):
        world[j] = own[j] if j in own else world[parent] if parent >= 0 else own[index["Hips"]]
    return to_local(world[None], rig.parents)[0]


def pose_at_rest(rig: SkinnedCharacter, body: RiggedBody) -> Float[np.ndarray, "J 3 3"]:
    """Our body's local rotations in the pose in which the rig rests: an A-pose, a T-pose with bent elbows."""
    aligned = alignments(rig.joints, named_joints(rig.joint_names, rig.parents), body)
    world = np.stack([aligned.get(joint, np.eye(3)) for joint in body.joint_names])
    return to_local(world[None], body.parents)[0]


def find_landmarks(rig: SkinnedCharacter) -> Int[np.ndarray, "M"]:
    """Vertices of the rig at `bodies.landmarks.LANDMARKS`: found as on our body, in its T-pose and at its height."""
    body, index = human(), named_joints(rig.joint_names, rig.parents)
    tee = pose_on_rig(rig, body, np.tile(np.eye(3), (len(body.parents), 1, 1)))
    transforms = rig.skinning_transforms(tee)
    size = np.ptp(body.vertices[:, 1]) / np.ptp(rig.mesh.vertices[:, 1])
    joints, role = body.joints.copy(), {j: body.joint(joint) for joint, j in index.items()}
    stand_in = {joint: index[joint.replace("ToeBase", "Foot")] for joint in ("LeftToeBase", "RightToeBase")}
    for joint, j in {**stand_in, **index}.items():  # a foot without toes begins where the toes would
        joints[body.joint(joint)] = size * (transforms[j] @ [*rig.joints[j], 1.0])[:3]
    for j, parent in enumerate(rig.parents):
        role.setdefault(j, role.get(parent, 0))
    weights = np.zeros((len(rig.weights), len(body.parents)))
    held_by = np.array([role[j] for j in range(len(rig.parents))] + [0])[rig.joint_of]
    np.add.at(weights, (np.arange(len(weights))[:, None], held_by), rig.weights)
    none, no_joint = np.zeros((0, len(weights), 3)), np.zeros((0, len(joints), 3))
    twin = RiggedBody("", size * rig.posed(tee), rig.mesh.faces, none, joints, no_joint, weights,
                      body.joint_names, body.parents)  # fmt: skip
    return np.array(list(landmarks(twin).values()))


def check_character(rig: SkinnedCharacter, path: str | Path) -> SkinnedCharacter:
    """Return the rig if it can take the poses of our body.

    Raises:
        InputError: limb joints of unknown names, limbs that are no chains (feet on a root of their own), or a person
            who does not stand y up and face +z.
    """
    index = named_joints(rig.joint_names, rig.parents)
    require_joints(index, NEEDED, rig.joint_names, path)
    for joint, tail in BONES.items():
        if not _hangs_on(rig, index[tail], index[joint]):
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
    skeletons = _skeletons(data)
    if split == "test":
        groups = [group[1:] if len(group) > 2 else group for group in skeletons]
        character_pairs = [pair for group in groups for pair in permutations(group, 2)]
        needed = "two characters of one skeleton"
    else:
        character_pairs = list(permutations([group[0] for group in skeletons if len(group) > 2], 2))
        needed = "two skeletons of three characters each"
    if not character_pairs:
        raise InputError(
            f"{data}: expected {needed} among its .glb, .gltf and .vrm files for the split {split}, found skeletons of "
            f"{', '.join(str(len(group)) for group in skeletons) or 'no'} characters; add some"
        )
    return character_pairs


@cache
def _skeletons(data: Path) -> list[list[SkinnedCharacter]]:
    """The characters of a folder by skeleton (equal joint names and parents), by file name."""
    if not data.is_dir():
        raise InputError(f"{data}: expected a folder of rigged characters, found none; give it with --data")
    groups: dict[frozenset[tuple[str, str]], dict[Path, SkinnedCharacter]] = {}
    for path in sorted(path for path in data.iterdir() if path.suffix.lower() in SUFFIXES):
        rig = read_skin(path)
        groups.setdefault(rig.bones(), {})[path] = rig
    return [[check_character(rig, path) for path, rig in group.items()] for group in groups.values() if len(group) > 1]


def _stage(mover: SkinnedCharacter, actor: SkinnedCharacter, stand: Pose, played: Pose) -> Pair:
    """The mover stands, the actor plays; truth is the mover playing. `copy` needs both to have the same triangles."""
    rest, reference = (rig.posed(pose_on_rig(rig, human(), stand.rotmat)) for rig in (mover, actor))
    truth, driving = (rig.posed(pose_on_rig(rig, human(), played.rotmat)) for rig in (mover, actor))
    twins = np.array_equal(mover.mesh.faces, actor.mesh.faces)
    return Pair(
        identity=_mesh(mover, rest, stand.label),
        driving=_mesh(actor, driving, played.label),
        truth=truth,
        height=float(np.ptp(mover.mesh.vertices[:, 1])),
        aligned=driving if twins else None,
        aligned_reference=reference if twins else None,
        reference=reference,
        markers=np.stack([find_landmarks(mover), find_landmarks(actor)], axis=1),
        truth_name=f"{mover.mesh.name}_{played.label}",
    )


def _mesh(rig: SkinnedCharacter, vertices: Float[np.ndarray, "V 3"], pose: str) -> Mesh:
    name = f"{rig.mesh.name}_{pose}"
    return dataclasses.replace(rig.mesh, vertices=vertices, corner_normals=None, source=None, name=name)


def _hangs_on(rig: SkinnedCharacter, joint: int, holder: int) -> bool:
    while joint >= 0 and joint != holder:
        joint = rig.parents[joint]
    return joint == holder
