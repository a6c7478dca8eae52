"""`rigs`: rigged characters of a folder, their rigs hidden, beside the skeleton and weights that `mimesh.rig` finds.

A method gets the mesh at rest alone, y up and facing +z. What it finds is compared on a fixed list of joints (LISTED):
makers give characters fingers, twist bones, faces and props as they like, and these count as their nearest ancestor of
the list. `joints_pct` compares joints of one name; it and `deform_mm` are what a user sees. Figures of other projects
are of other lists of joints, most with fingers.

J2J, J2B, B2B and IoU are those of RigNet's evaluation (Xu et al., SIGGRAPH 2020, section 6): lengths are shares of the
longest side of the mesh's box, and each distance is the mean of both directions. Bones are segments from a joint to its
parent, (N, 2, 3).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES
from ..bodies.character_pool import Pool, PoolCharacter
from ..core.animated_rig import INFLUENCES, AnimatedRig
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..core.options import Hints, needs_joints
from ..core.rig import Rig, nearest_columns
from ..core.skinning import SkinnedMesh
from ..methods.find import moves_joints
from .character_folder import read_character_folder
from .characters import character_label
from .measure import EXTRA_INPUTS
from .pairs import Pair
from .protocols import Protocol

if TYPE_CHECKING:
    from PIL import Image

LIMBS = tuple(side + part for side in SIDES for part in ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot"))
"""Joints of limbs."""
COMPARED = (*LIMBS, "Neck", "Head")
"""Joints of `joints_pct`."""
LISTED = (
    *("Hips", "LowerBack", "Spine", "Spine1", *COMPARED),
    *(side + part for side in SIDES for part in ("Shoulder", "ToeBase")),
)
"""Joints of all other figures: those of a person without fingers, and one of the two of the neck."""
AXES = {"up": "+y", "front": "+z"}
UPRIGHT = Hints(**AXES)
"""What a method is told beside the mesh."""
FRAMES = 10
"""Frames of a clip, evenly spread, in which deformations are compared."""
CLIPS = 3
"""Clips of a character, evenly spread over its list, in which deformations are compared."""


@dataclass(frozen=True, eq=False)
class ListedRig:
    """Joints of LISTED that a rig has, and the weights of all of its joints added up by these."""

    names: tuple[str, ...]
    joints: Float[np.ndarray, "J 3"]
    parents: tuple[int, ...]
    weights: Float[np.ndarray, "V J"]

    @classmethod
    def of(
        cls,
        known: dict[str, int],
        joints: Float[np.ndarray, "K 3"],
        parents: tuple[int, ...],
        weights: Float[np.ndarray, "V K"],
    ) -> ListedRig:
        """Reduce a rig with parents before children to the joints that are `known` by name and in the list.

        Joints above all of these count as the first of them.
        """
        kept = sorted({joint: name for name, joint in known.items() if name in LISTED}.items())
        order = [joint for joint, _ in kept]
        nearest = nearest_columns({joint: k for k, joint in enumerate(order)}, parents, -1)
        above = tuple(int(nearest[parents[joint]]) for joint in order)  # parent -1 is the last entry
        summed = weights @ (nearest[:-1, None].clip(0) == np.arange(len(kept)))
        return cls(tuple(name for _, name in kept), joints[order], above, summed)

    @classmethod
    def of_maker(cls, character: PoolCharacter) -> ListedRig:
        """Reduce the rig of a character's maker."""
        rig = character.rig
        return cls.of(character.joints, rig.joints, rig.parents, rig.joint_weights())

    @classmethod
    def found(cls, rig: AnimatedRig) -> ListedRig:
        """Reduce a rig that was found, with the weights that a file of it has."""
        weights = rig.rig.limited(INFLUENCES).weights
        if rig.group is not None:  # a vertex that no joint moves has the row -1
            weights = np.where(rig.group[:, None] < 0, 0.0, weights[rig.group])
        return cls.of({name: j for j, name in enumerate(rig.names)}, rig.rig.joints, rig.parents, weights)

    @property
    def bones(self) -> Float[np.ndarray, "B 2 3"]:
        """Parent and joint of each bone."""
        pairs = [(parent, j) for j, parent in enumerate(self.parents) if parent >= 0]
        return self.joints[np.array(pairs, int).reshape(-1, 2)]

    def directions(self) -> Float[np.ndarray, "J 3"]:
        """Return the bone of each joint: to its first child, or from its parent where it has none."""
        first = {parent: j for j, parent in reversed(list(enumerate(self.parents)))}
        ends = [(j, first[j]) if j in first else (parent, j) for j, parent in enumerate(self.parents)]
        return np.stack([self.joints[end] - self.joints[start] for start, end in ends])

    def columns(self, names: tuple[str, ...]) -> Float[np.ndarray, "V N"]:
        """Add up the weights by some of the joints, which has the root; the others count as the nearest above."""
        column_of = {self.names.index(name): k for k, name in enumerate(names)}
        nearest = nearest_columns(column_of, self.parents, column_of.get(0, 0))[:-1]
        return self.weights @ (nearest[:, None] == np.arange(len(names)))


@dataclass(frozen=True, eq=False, kw_only=True)
class RigTrial(Pair):
    """A character without its rig, twice, and the character."""

    character: PoolCharacter


@dataclass(frozen=True)
class RiggedPeople(Protocol):
    """The characters of a folder: of a split of its pool, and of rigged files in it. Packs take turns."""

    data: Path = Path()

    def pool(self, split: str) -> Pool:
        """Read the characters, once, and the files that cannot be used with the reasons."""
        return _read(self.data, split)

    def check(self, split: str) -> None:
        """Raise InputError for a folder without a character that can be measured."""
        if not self.pool(split).characters:
            reasons = "".join(f"; {reason}" for reason in list(self.pool(split).refusals())[:1])
            raise InputError(f"{self.data}: expected rigged people of the split {split}, found none{reasons}; add some")

    def left_out(self, split: str) -> dict[str, int]:
        return self.pool(split).refusals()

    def count(self, kind: str, requested: int = 0, split: str = "test") -> int:
        count = len(self.pool(split).characters)
        return min(requested or count, count)

    def pair(self, split: str, kind: str, i: int) -> RigTrial:
        """Give character `i`, in the vertex order of its file."""
        character = self.pool(split).characters[i]
        mesh = Mesh(character.rig.mesh.vertices, character.rig.mesh.faces, name=character.meta.file)
        height = float(np.ptp(mesh.vertices[:, 1]))
        label = character_label(character.meta)
        return RigTrial(
            identity=mesh,
            driving=mesh,
            truth=mesh.vertices,
            height=height,
            metres=1.7 / height,
            groups=(label, label),
            character=character,
        )


def rigs(data: str | Path) -> RiggedPeople:
    """Return the protocol of a folder."""
    return RiggedPeople("rigs", 1, ("people",), pairs=0, spread=0.0, data=Path(data))


@lru_cache(maxsize=2)
def _read(data: Path, split: str) -> Pool:
    pool = read_character_folder(data, split)
    packs: dict[str, list[PoolCharacter]] = {}
    for character in pool.characters:
        packs.setdefault(character.meta.pack, []).append(character)
    turns = (character for turn in zip_longest(*packs.values()) for character in turn if character is not None)
    return dataclasses.replace(pool, characters=tuple(turns))


def measure_rig(trial: RigTrial, method: str) -> dict[str, Any]:
    """Find the rig of a character and compare it with its maker's (metrics: docs/conventions.md).

    {"failed": reason} if the mesh is refused, {"why": reason} for a method that finds no joints.

    Args:
        method: "mime", or the path of an .onnx file that was trained as `mime` is.
    """
    from ..pipeline.rigging import rig

    if method in EXTRA_INPUTS or not moves_joints(method):
        return {"why": str(needs_joints("model", method))}
    started = time.perf_counter()
    try:
        rigged = rig(trial.identity, method, hints=UPRIGHT)
    except InputError as error:
        return {"failed": str(error)}
    facts = {"seconds": time.perf_counter() - started, "body": rigged.body, "warned": bool(rigged.notes)}
    if rigged.body != "human":
        return facts | {"failed": f"taken for a {rigged.body}"}
    return facts | compare(trial, ListedRig.found(rigged.skeleton))


def compare(trial: RigTrial, found: ListedRig) -> dict[str, Any]:
    """Compare a rig that was found with the maker's; both are of the mesh of the trial."""
    truth, size = ListedRig.of_maker(trial.character), float(np.ptp(trial.identity.vertices, axis=0).max())
    shared = tuple(name for name in truth.names if name in found.names)
    error = joint_errors(found, truth, trial.height)
    tolerance = limb_radius(truth.joints, truth.directions(), trial.identity.vertices, trial.identity.faces)
    skeletons = (found.joints, found.bones), (truth.joints, truth.bones)
    figures: dict[str, Any] = {
        "joints_pct": mean_of_compared(error),
        "j2j": 100 / size * joints_to_joints(found.joints, truth.joints),
        "j2b": 100 / size * joints_to_bones(*skeletons),
        "b2b": 100 / size * bones_to_bones(found.bones, truth.bones),
        "iou": 100 * matched_share(found.joints, truth.joints, tolerance),
        "weights_l1": weights_apart(found.columns(shared), truth.columns(shared)),
        "joints": {name: round(value, 3) for name, value in error.items()},
    }
    deformed = deformation_error(trial, found)
    return figures | ({} if deformed is None else {"deform_mm": deformed})


def joint_errors(found: ListedRig, truth: ListedRig, height: float) -> dict[str, float]:
    """Compute the distances of the joints that both rigs have, in percent of the height of the mesh."""
    at, of = (dict(zip(rig.names, rig.joints, strict=True)) for rig in (found, truth))
    return {name: 100 / height * float(np.linalg.norm(at[name] - of[name])) for name in truth.names if name in at}


def mean_of_compared(errors: Mapping[str, float]) -> float:
    """Return the mean over the joints of COMPARED."""
    return float(np.mean([error for name, error in errors.items() if name in COMPARED]))


def deformation_error(trial: RigTrial, found: ListedRig) -> float | None:
    """Play the maker's clips with a rig that was found; give the mean distance of the vertices for a person of 1.7 m.

    Each joint turns as the maker's joint of its name, or as the nearest above that the maker has. Where the maker's
    leaves its place in its parent, as feet do that hands of a rig pull, it goes as far. None without clips.
    """
    character = trial.character
    clips = list(character.clips)
    chosen = [clips[k * len(clips) // min(len(clips), CLIPS)] for k in range(min(len(clips), CLIPS))]
    if not chosen:
        return None
    turning = [character.joints.get(name, -1) for name in found.names]
    for j, parent in enumerate(found.parents):
        turning[j] = turning[parent] if turning[j] < 0 <= parent else turning[j]
    unmoved = found.weights.sum(axis=1, keepdims=True) == 0
    weights = found.weights + unmoved * np.eye(len(found.names))[0]
    rest = Rig(np.tile(np.eye(3), (len(found.names), 1, 1)), found.joints, weights)
    skinned = SkinnedMesh.of(trial.identity.vertices, rest, found.parents)
    # Where each joint has a maker's of its own, that joint at rest, else a point that moves with the one above.
    pivots = character.rig.joints[turning]
    errors = []
    for name in chosen:
        count = min(FRAMES, len(character.clips[name]))
        frames = np.arange(count) * len(character.clips[name]) // count
        for transforms in character.transforms_of_frames(name, frames):
            moves = transforms[turning]
            positions = _moved(moves, found.joints)
            for j, parent in enumerate(found.parents):
                if parent >= 0:
                    place = positions[parent] + moves[parent, :3, :3] @ (found.joints[j] - found.joints[parent])
                    positions[j] = place + _moved(moves[j], pivots[j]) - _moved(moves[parent], pivots[j])
            result = skinned.posed_at(moves[:, :3, :3], positions)
            errors.append(np.linalg.norm(result - character.rig.skinned(transforms), axis=1).mean())
    return 1700 / trial.height * float(np.mean(errors))


def _moved(transform: Float[np.ndarray, "*N 4 4"], point: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    return (transform[..., :3, :3] @ point[..., None])[..., 0] + transform[..., :3, 3]


def rig_comparison(trial: RigTrial, method: str) -> Image.Image:
    """Draw the bones of the maker above those that a method finds, over the mesh."""
    from ..pipeline.rigging import rig
    from ..tools.preview import bones_picture
    from ..view.sheet import stack

    truth = ListedRig.of_maker(trial.character)
    found = ListedRig.found(rig(trial.identity, method, hints=UPRIGHT).skeleton)
    rows = (("maker", truth), (Path(method).stem, found))
    return stack([bones_picture(trial.identity, of.joints, of.parents, label, **AXES) for label, of in rows])


BONE_STEPS = 50
"""Points that a bone is sampled at. Their spacing is a fiftieth of the longest limb, a thousandth of a person."""
RAYS = 12
"""Rays about a bone that measure how thick a limb is."""
MOST_TESTS = 1 << 22
"""Pairs of a ray and a triangle that are tested at once; bounds the memory."""


def joints_to_joints(first: Float[np.ndarray, "N 3"], second: Float[np.ndarray, "M 3"]) -> float:
    """Return J2J: the mean distance of each joint to the nearest of the other skeleton."""
    distance = np.linalg.norm(first[:, None] - second[None], axis=-1)
    return float(distance.min(axis=1).mean() + distance.min(axis=0).mean()) / 2


def joints_to_bones(
    first: tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "A 2 3"]],
    second: tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "B 2 3"]],
) -> float:
    """Return J2B of two skeletons (joints, bones): the mean distance of each joint to the nearest bone of the other."""
    (joints, bones), (others, other_bones) = first, second
    return (_to_bones(joints, other_bones) + _to_bones(others, bones)) / 2


def bones_to_bones(first: Float[np.ndarray, "A 2 3"], second: Float[np.ndarray, "B 2 3"]) -> float:
    """Return B2B: the mean distance of points of each bone to the nearest bone of the other skeleton.

    Points lie evenly on all bones together, so that a long bone counts as much as it is long.
    """
    return (_to_bones(_points_on(first), second) + _to_bones(_points_on(second), first)) / 2


def matched_share(
    joints: Float[np.ndarray, "N 3"], truth: Float[np.ndarray, "M 3"], tolerance: Float[np.ndarray, " M"]
) -> float:
    """Return IoU: the share of the joints of both skeletons that have a partner within the tolerance.

    Partners are found by the Hungarian algorithm over the distances.

    Args:
        tolerance: of each joint of the truth; RigNet takes half of the local diameter (`limb_radius`).
    """
    from scipy.optimize import linear_sum_assignment

    distance = np.linalg.norm(joints[:, None] - truth[None], axis=-1)
    rows, columns = linear_sum_assignment(distance)
    matched = np.count_nonzero(distance[rows, columns] < tolerance[columns])
    return 2 * matched / (len(joints) + len(truth))


def limb_radius(
    joints: Float[np.ndarray, "N 3"],
    directions: Float[np.ndarray, "N 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
) -> Float[np.ndarray, " N"]:
    """Measure the distance from each joint to the surface, at right angles to its bone: the median of RAYS rays.

    A joint from which no ray meets the surface gets 0.

    Args:
        directions: of the bone of each joint, of any length; where it is 0, the bone counts as upright.
    """
    radius = np.zeros(len(joints))
    angles = np.arange(RAYS) * 2 * np.pi / RAYS
    for k, (joint, direction) in enumerate(zip(joints, directions, strict=True)):
        length = np.linalg.norm(direction)
        along = direction / length if length else np.array([0.0, 1.0, 0.0])
        side = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
        side /= np.linalg.norm(side)
        rays = np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * np.cross(along, side)
        hits = _first_hits(joint, rays, vertices[faces])
        hits = hits[np.isfinite(hits)]
        radius[k] = np.median(hits) if len(hits) else 0.0
    return radius


def weights_apart(first: Float[np.ndarray, "V J"], second: Float[np.ndarray, "V J"]) -> float:
    """Return the mean over the vertices of the L1 distance of their weights, from 0 to 2; columns correspond."""
    return float(np.abs(first - second).sum(axis=1).mean())


def _to_bones(points: Float[np.ndarray, "N 3"], bones: Float[np.ndarray, "B 2 3"]) -> float:
    start, along = bones[None, :, 0], (bones[:, 1] - bones[:, 0])[None]
    step = points[:, None] - start
    length = np.maximum((along**2).sum(-1), np.finfo(float).tiny)
    share = np.clip((step * along).sum(-1) / length, 0, 1)
    return float(np.linalg.norm(step - share[..., None] * along, axis=-1).min(axis=1).mean())


def _points_on(bones: Float[np.ndarray, "B 2 3"]) -> Float[np.ndarray, "P 3"]:
    length = np.linalg.norm(bones[:, 1] - bones[:, 0], axis=1)
    counts = np.maximum(np.ceil(BONE_STEPS * length / length.max()).astype(int), 1)
    shares = [(np.arange(count) + 0.5) / count for count in counts]
    return np.concatenate([a + share[:, None] * (b - a) for (a, b), share in zip(bones, shares, strict=True)])


def _first_hits(
    origin: Float[np.ndarray, " 3"], rays: Float[np.ndarray, "R 3"], triangles: Float[np.ndarray, "F 3 3"]
) -> Float[np.ndarray, " R"]:
    """Measure how far unit rays from one point go to the first triangle, from either side; infinite without one.

    Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    nearest = np.full(len(rays), np.inf)
    at_once = max(MOST_TESTS // len(rays), 1)
    for begin in range(0, len(triangles), at_once):
        corner = triangles[begin : begin + at_once, 0]
        one, two = (triangles[begin : begin + at_once, k] - corner for k in (1, 2))
        step = origin - corner
        across, around = np.cross(rays[:, None], two[None]), np.cross(step, one)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / (one * across).sum(-1)
            u, v = (step * across).sum(-1) * scale, (rays[:, None] * around).sum(-1) * scale
            far = (two * around).sum(-1) * scale
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (far > 0)
        nearest = np.minimum(nearest, np.where(hit, far, np.inf).min(axis=1))
    return nearest
