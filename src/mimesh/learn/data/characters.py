"""Rigged characters to train on: a folder of them, and points of their surfaces with the shipped body's joints.

A sub-folder is a pack, files of the folder itself are one more. A licence that a file does not state is that of the
nearest file named LICENSE or License, in its folder or above it up to the folder, which is quoted by name. Files that
the index of a pool lists in another split are left out.

A joint of a character counts as the joint of the shipped body with its name (`bodies.character_limbs`); all others
count as their nearest named ancestor. World rotations of the body's joints relate to those of the character's by an
alignment: a character's limb that is turned from rest by D has the rotation G = D A, A being the rotation from the
body's limb at rest to the character's (`evaluate.characters.rest_alignments`).

A folder of clips of any maker (.glb, .gltf, .vrm and .fbx animations, .bvh, AMASS) gives more poses. They are
retargeted to the shipped body (`motions.retarget`), so limbs keep their directions and the root its tilt, as in crawls
and rolls; headings are turned to +z. Mirror images are added. The captures whose later seconds are tested on are left
out by name (`SHIPPED_CAPTURES`); measure on nothing else that is in the folder.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ...bodies import RiggedBody, load_body
from ...bodies.character_limbs import SIDES
from ...bodies.character_pool import CLASSES, PoolCharacter
from ...core import geometry, surface_points
from ...core.errors import InputError
from ...core.frame_buffer import Progress, counted
from ...evaluate.character_folder import DAMAGED, licence_of, pack_of, read_character_folder
from ...evaluate.characters import animal_alignments, body_poses, place_body_joints, rest_alignments
from ...io.formats import JOINTED
from ...io.gltf.animation import animation_names
from ...io.gltf.character import NOT_STATED
from ...io.gltf.document import open_document
from ...io.gltf.motion import read_skeleton
from ...io.gltf.vrm import read_origin
from ...motions import Motion, mirror, resample
from ...motions.motion import rotmat_to_rotvec, turned_to_front
from ...motions.on_body import is_motion_file, motion_of_file
from ...motions.retarget import retarget_skeleton
from ..task import DataConfig, share_option

POINTS = 3000
"""Points that a character is represented by."""
PLACED = ("ForeArm", "Hand", "Leg", "Foot")
"""Joints whose position is known from the ends of limbs where a character has no such joint."""
TRUNK = ("LowerBack", "Spine", "Spine1", "Neck", "Neck1")
"""Joints that are matched by their number along the trunk: their positions differ from maker to maker."""
REASONS = 6
"""Reasons for refusals that are listed at most; files with others are counted together."""
CLIP_STEP = 2
"""Every CLIP_STEP-th frame of a clip is taken; neighbouring frames are nearly the same pose."""
LEVELS = (200, 500, 1200)
"""Numbers of triangles of a whole character. Chosen by hand: game characters of phones have about 500 to 1,500."""
LOW_POLY_SAMPLES = 2
"""Points drawn on the decimated mesh for each point that is moved to the nearest of them."""
NORMAL_WEIGHT = 0.1
"""Distance, in heights of the mesh, that counts as much as opposite normals: points stay on their side of limbs."""
SMALLEST = 12
"""Triangles below which a decimated piece is not used: the piece keeps its points."""


@dataclass(frozen=True)
class CharacterOptions(DataConfig):
    """What share of the data characters of a folder are."""

    characters: float = share_option()
    """Share of a batch that are characters of a folder, for `mime` also of primitives."""
    leave_out: tuple[str, ...] = ()
    """Packs of the folder that are not trained on."""
    words_of_characters: ClassVar[str] = ""
    """What is added to the description of the data on the card."""
    clip_kinds: ClassVar[tuple[str, ...]] = ()
    """Kinds of data to whose poses those of a folder of clips can be added."""

    @property
    def with_low_poly(self) -> bool:
        """Whether low-poly versions of the surfaces are needed."""
        return False


@dataclass(frozen=True, eq=False)
class CharacterSurface:
    """A character at rest, as large as the shipped body (root mean square distance of its points from their mean)."""

    pack: str
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    weights: Float[np.ndarray, "N J"]
    """Weights of the shipped body's joints, rows sum to 1."""
    joints: Float[np.ndarray, "J 3"]
    """Positions of the shipped body's joints."""
    alignment: Float[np.ndarray, "J 3 3"]
    """Rotation A of each joint from the shipped body's rest pose to the character's."""
    carrier: Int[np.ndarray, " J"]
    """The joint whose rotation each joint has: itself, or its nearest ancestor that the character has."""
    placed: Bool[np.ndarray, " J"]
    """Whether the position of each joint is known."""
    coarse: Float[np.ndarray, "L 2 N 3"] | None = None
    """Points and normals on the low-poly versions (`LEVELS`); None where there are none."""

    @property
    def turning(self) -> Bool[np.ndarray, " J"]:
        """Whether the character has the joint, so that its rotation is known."""
        return self.carrier == np.arange(len(self.carrier))

    @classmethod
    def of(cls, character: PoolCharacter, body: RiggedBody, low_poly: bool = False) -> CharacterSurface:
        """Sample the surface of a character at rest, and of its low-poly versions if asked."""
        mesh = character.rig.mesh
        face, share = surface_points.sample_surface(mesh.vertices, mesh.faces, POINTS, np.random.default_rng(0))
        points = surface_points.at_barycentric(mesh.vertices, mesh.faces, face, share)
        normals = geometry.face_normals(mesh.vertices, mesh.faces)[face]
        rig = character.rig
        columns = {joint: body.joint(name) for name, joint in character.joints.items()}
        weights = rig.summed_weights(rig.nearest_columns(columns, body.joint("Hips")), len(body.parents))
        vertex_weights = weights / weights.sum(axis=1, keepdims=True)
        size = body_spread(body) / np.sqrt(np.square(points - points.mean(axis=0)).sum(-1).mean())
        found, aligned, known = _rest_of(character, body)
        carrier = body.carriers(character.joints)
        alignment = np.tile(np.eye(3), (len(body.parents), 1, 1))
        joints = np.empty((len(body.parents), 3))
        for j, (name, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
            alignment[j] = aligned.get(body.joint_names[carrier[j]], np.eye(3))
            if name in found:
                joints[j] = found[name]
            else:  # as far from the parent as in the body
                joints[j] = joints[parent] + alignment[parent] @ (body.joints[j] - body.joints[parent]) / size
        coarse = None
        if low_poly:
            coarse = flattened(points, normals, mesh.vertices, mesh.faces)
            coarse[:, 0] *= size
        return cls(
            pack=character.meta.pack,
            points=size * points,
            normals=normals,
            weights=surface_points.at_barycentric(vertex_weights, mesh.faces, face, share),
            joints=size * joints,
            alignment=alignment,
            carrier=carrier,
            placed=np.array([name in known for name in body.joint_names]),
            coarse=coarse,
        )


@dataclass(frozen=True, eq=False)
class TrainingCharacters:
    """The characters of a folder that a training uses, and poses of the clips of another folder."""

    surfaces: tuple[CharacterSurface, ...]
    poses: Float[np.ndarray, "P J 3"]
    """Poses of all their clips: rotation vectors of the shipped body's joints."""
    facts: dict[str, Any]
    """For cards: `makers`, the number of characters of each "maker: pack (licence)", `sha256` of all arrays, and where
    packs were left out, `left_out`, their numbers of characters. `clips` are the facts of the other clips."""
    refused: dict[str, int]
    """Number of characters that cannot be used, by reason."""
    clips: TrainingClips | None = None
    """Clips of another folder."""
    part: ClassVar[str] = "characters"
    """Where checkpoints and cards have the facts."""

    @classmethod
    def none(cls, body: RiggedBody) -> TrainingCharacters:
        """Make an empty set, for trainings on clips alone."""
        return cls((), np.zeros((0, len(body.parents), 3)), {}, {})

    @property
    def all_poses(self) -> Float[np.ndarray, "P J 3"]:
        """Poses of the characters' clips and of the other clips."""
        return np.concatenate([self.poses, self.clips.poses]) if self.clips else self.poses

    def with_clips(self, clips: TrainingClips) -> TrainingCharacters:
        """Add a folder of clips."""
        return dataclasses.replace(self, clips=clips, facts={**self.facts, "clips": clips.facts})

    def continues(self, facts: dict[str, Any]) -> bool:
        """Tell whether a training with some facts may go on with these characters: clips may be added, none changed."""
        added = {key: value for key, value in self.facts.items() if key != "clips" or "clips" in facts}
        return not facts or facts == added

    def described(self) -> str:
        """Say in words whose the characters and clips are and how many cannot be used."""
        clips = self.clips.described() if self.clips else ""
        return "; ".join(filter(None, [self._described_characters() if self.surfaces else "", clips]))

    def _described_characters(self) -> str:
        used = ", ".join(f"{count} of {maker}" for maker, count in self.facts["makers"].items())
        packs = ", ".join(
            f"{count} of the pack {pack} left out" for pack, count in self.facts.get("left_out", {}).items()
        )
        reasons = Counter(self.refused).most_common()
        refused = [f"{count} refused: {reason}" for reason, count in reasons[:REASONS]]
        if len(reasons) > REASONS:
            refused.append(f"{sum(count for _, count in reasons[REASONS:])} refused for other reasons")
        return "; ".join(filter(None, [used, f"{len(self.poses)} poses of their clips", packs, *refused]))

    @classmethod
    def read(
        cls,
        folder: str | Path,
        body: RiggedBody,
        split: str = "train",
        leave_out: Collection[str] = (),
        low_poly: bool = False,
        progress: Progress | None = None,
    ) -> TrainingCharacters:
        """Read the characters of a folder: of a split of its pool, and of rigged files in it.

        Args:
            leave_out: packs that are not used.
            low_poly: make low-poly versions of the surfaces too.

        Raises:
            InputError: no such folder, none of its characters can be used, or a pack to leave out that it has not.
        """
        pool = read_character_folder(folder, split, progress, body.name)
        counts = Counter(character.meta.pack for character in pool.characters)
        if unknown := [pack for pack in leave_out if pack not in counts]:
            raise InputError(
                f"--leave-out {unknown[0]}: expected a pack of {folder} ({', '.join(counts) or 'none'}), "
                "found another; check its name"
            )
        characters = [character for character in pool.characters if character.meta.pack not in leave_out]
        if not characters:
            raise InputError(
                f"{folder}: expected {CLASSES[body.name]}s of the split {split}, found none that can be used"
                f"{''.join(f'; {reason}' for reason in list(pool.refusals())[:1])}; add some"
            )
        metas = [character.meta for character in characters]
        makers = Counter(f"{meta.maker or NOT_STATED}: {meta.pack} ({meta.licence})" for meta in metas)
        surfaces = tuple(
            CharacterSurface.of(character, body, low_poly)
            for character in counted(characters, len(characters), progress)
        )
        from scipy.spatial.transform import Rotation

        # Clips that characters share are taken once.
        first = {character.meta.clips_from: character for character in characters if character.clips}
        clips = [
            body_poses(character, character.transforms_of_frames(name, np.arange(0, len(clip), CLIP_STEP)), body)
            for character in first.values()
            for name, clip in character.clips.items()
        ]
        rotmat = np.concatenate([np.zeros((0, len(body.parents), 3, 3)), *clips]).reshape(-1, 3, 3)
        poses = Rotation.from_matrix(rotmat).as_rotvec().reshape(-1, len(body.parents), 3)
        digest = hashlib.sha256(poses.round(4).tobytes())
        for surface in surfaces:
            digest.update(surface.points.round(4).tobytes() + surface.weights.round(4).tobytes())
        facts: dict[str, Any] = {"makers": dict(makers), "sha256": digest.hexdigest()}
        if leave_out:  # facts of trainings without this option stay as they were
            facts["left_out"] = {pack: counts[pack] for pack in leave_out}
        return cls(surfaces, poses, facts, pool.refusals())


def _rest_of(
    character: PoolCharacter, body: RiggedBody
) -> tuple[dict[str, Float[np.ndarray, " 3"]], dict[str, Float[np.ndarray, "3 3"]], set[str]]:
    """Give the body's joints on a character at rest, their alignments, and the joints whose places are known."""
    if body.name == "quadruped":
        positions = {name: character.rig.joints[joint] for name, joint in character.joints.items()}
        known = {name for name in positions if not name.startswith(("Spine", "Chest"))}
        return positions, animal_alignments(character, body), known
    found = place_body_joints(character)
    known = {*character.joints, *(side + part for side in SIDES for part in PLACED)}.difference(TRUNK)
    return {name: point for name, (_, point) in found.items()}, rest_alignments(character), known


@cache
def body_spread(body: RiggedBody) -> float:
    """Measure the root mean square distance of a body's surface from its centroid (metres), once for all characters."""
    face, share = surface_points.sample_surface(body.vertices, body.faces, POINTS, np.random.default_rng(0))
    points = surface_points.at_barycentric(body.vertices, body.faces, face, share)
    return float(np.sqrt(np.square(points - points.mean(axis=0)).sum(-1).mean()))


def flattened(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    counts: Sequence[int] = LEVELS,
) -> Float[np.ndarray, "L 2 N 3"]:
    """Move points of a mesh to the mesh decimated to some numbers of triangles: points and normals on each.

    Each point goes to the nearest, in place and normal, of random points of the decimated mesh. So it keeps its weights
    and joints, and no triangle gets more than its share. A mesh that is coarser already keeps its points.
    """
    import fast_simplification
    from scipy.spatial import KDTree

    coarse, index = geometry.weld(vertices)
    triangles = index[faces]
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    weight = NORMAL_WEIGHT * np.ptp(vertices, axis=0).max() / 2
    result = np.tile(np.stack([points, normals]), (len(counts), 1, 1, 1))
    for level in np.argsort(counts)[::-1]:  # from fine to coarse, each from the one before: that is fast
        if len(triangles) > counts[level]:
            found = fast_simplification.simplify(coarse, triangles.astype(np.int32), target_count=counts[level])
            coarse, triangles = found[0].astype(np.float64), found[1].astype(np.int64)
            triangles = triangles[geometry.face_areas(coarse, triangles) > 0]
            if len(triangles) < SMALLEST:
                break
            rng = np.random.default_rng(0)
            face, share = surface_points.sample_surface(coarse, triangles, LOW_POLY_SAMPLES * len(points), rng)
            places = surface_points.at_barycentric(coarse, triangles, face, share)
            flat = geometry.face_normals(coarse, triangles)[face]
            tree = KDTree(np.hstack([places, weight * flat]), balanced_tree=False)
            nearest = tree.query(np.hstack([points, weight * normals]))[1]
            result[level] = places[nearest], flat[nearest]
    return result


FPS = 15.0
"""Frames a second of which poses are taken."""
LEAST_TURN = np.radians(10)
"""A pose is taken if a joint has turned by so much (radians) since the last one taken: clips rest for seconds."""
LARGEST_TURNS = {
    ("Spine1", "Head"): 100,
    ("Hips", "Spine1"): 110,
    **{(f"{side}Leg", f"{side}Foot"): 90 for side in SIDES},
    **{("Hips", f"{side}UpLeg"): 150 for side in SIDES},
}
"""Largest angle (degrees) of a joint to one above it. Poses beyond are left out: skeletons that fall apart, heads that
come off. Other clips and captures reach 88, 73, 82 and 126."""
SHIPPED_CAPTURES = ("01_01.", "01_03.")
"""Beginnings of the names of the CMU captures of the shipped takes, whose later seconds are `val` and `test`."""
HELD_OUT = "held out for evaluation"
IMPOSSIBLE = "no pose that a person can take"


@dataclass(frozen=True, eq=False)
class TrainingClips:
    """Poses of the clips of a folder."""

    poses: Float[np.ndarray, "P J 3"]
    """Rotation vectors of the shipped body's joints."""
    facts: dict[str, Any]
    """For cards: `makers`, the number of clips of each "maker: folder (licence)", `poses`, and their `sha256`."""
    refused: dict[str, str]
    """Reason why a clip or a file cannot be used, by name."""

    def described(self) -> str:
        """Say in words whose the clips are and how many cannot be used."""
        used = ", ".join(f"{count} clips of {maker}" for maker, count in self.facts["makers"].items())
        refused = "; ".join(f"{count} refused: {reason}" for reason, count in Counter(self.refused.values()).items())
        return f"{used}: {len(self.poses)} poses{'; ' if refused else ''}{refused}"

    @classmethod
    def read(cls, folder: str | Path, body: RiggedBody, progress: Progress | None = None) -> TrainingClips:
        """Read the clips of a folder and its sub-folders.

        Raises:
            InputError: no clip that can be used.
        """
        folder = Path(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file() and _is_motion(path))
        poses, makers, refused = [], Counter[str](), dict[str, str]()
        for path in counted(paths, len(paths), progress):
            try:
                maker, stated = read_origin(open_document(path)) if path.suffix.lower() in JOINTED else ("", "")
                stated = stated or licence_of(path, folder) or NOT_STATED
                maker = f"{maker or NOT_STATED}: {pack_of(path, folder)} ({stated})"
                for name, motion in _motions(path, body):
                    if isinstance(motion, InputError):
                        refused[f"{path.relative_to(folder)}, {name}"] = _plain(motion, path, name)
                    elif len(taken := distinct_poses(motion)):
                        poses += [taken, distinct_poses(mirror(motion))]
                        makers[maker] += 1
                    else:
                        refused[f"{path.relative_to(folder)}, {name}"] = IMPOSSIBLE
            except DAMAGED as error:
                refused[str(path.relative_to(folder))] = _plain(error, path, "")
        if not poses:
            reason = f"; {next(iter(refused.values()))}" if refused else ""
            raise InputError(
                f"{folder}: expected clips of people (.glb, .gltf, .vrm, .fbx, .bvh or AMASS .npz), found none "
                f"that can be used{reason}; give a folder that has some"
            )
        taken = rotmat_to_rotvec(turned_to_front(np.concatenate(poses)))
        digest = hashlib.sha256(taken.round(4).tobytes()).hexdigest()
        return cls(taken, {"makers": dict(makers), "poses": len(taken), "sha256": digest}, refused)


def distinct_poses(motion: Motion) -> Float[np.ndarray, "P J 3 3"]:
    """Select poses of a motion that a person can take and that differ from the one before by LEAST_TURN in a joint."""
    poses = resample(motion, FPS).rotmat if motion.fps > FPS else motion.rotmat
    poses = poses[possible(poses, motion.joint_names)]
    taken: Bool[np.ndarray, " T"] = np.zeros(len(poses), bool)
    last = None
    for t, pose in enumerate(poses):
        # The trace of A^T B is 1 + 2 cos(angle) for rotations A and B.
        if last is None or ((np.einsum("jab,jab->j", last, pose) - 1) / 2).min() < np.cos(LEAST_TURN):
            taken[t], last = True, pose
    return poses[taken]


def possible(poses: Float[np.ndarray, "T B 3 3"], names: tuple[str, ...]) -> Bool[np.ndarray, " T"]:
    """Select the poses of the shipped body whose joints stay within LARGEST_TURNS."""
    parents = load_body().parents
    within = np.ones(len(poses), bool)
    for (upper, lower), largest in LARGEST_TURNS.items():
        relative, joint, stop = np.tile(np.eye(3), (len(poses), 1, 1)), names.index(lower), names.index(upper)
        while joint != stop:
            relative, joint = poses[:, joint] @ relative, parents[joint]
        within &= (np.trace(relative, axis1=1, axis2=2) - 1) / 2 > np.cos(np.radians(largest))
    return within


def _motions(path: Path, body: RiggedBody) -> Iterator[tuple[str, Motion | InputError]]:
    """Iterate over the names and motions of a file, with an error in place of a motion that cannot be used."""
    if path.name.startswith(SHIPPED_CAPTURES):
        yield path.name, InputError(HELD_OUT)
    elif path.suffix.lower() not in JOINTED:
        yield path.name, motion_of_file(path)
    else:
        document = open_document(path)
        for name in animation_names(document):
            try:
                yield name, retarget_skeleton(read_skeleton(document, FPS, name), body, name, grounded=False)
            except InputError as error:
                yield name, error


def _is_motion(path: Path) -> bool:
    try:
        return path.suffix.lower() in JOINTED or is_motion_file(path)
    except DAMAGED:
        return False


def _plain(error: BaseException, path: Path, name: str) -> str:
    """Say what is wrong without naming the file or the clip, so that equal reasons are counted together."""
    text = str(error) if isinstance(error, InputError) else f"expected a sound file, found {error!r:.80}"
    return text.removeprefix(f"{path}: ").removeprefix(f"{name}: ")
