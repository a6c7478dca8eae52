"""Find the limbs of a rigged humanoid of any maker: the joint that carries each limb, and its two ends at rest.

Rigs that `named_joints` alone cannot use: feet on roots of their own (inverse kinematics), no hand joint, and figures
of blocks with one joint a limb. Joints whose names say nothing are matched to those of the shipped body by the surface
that they move and by place (`match_joints`). Character frame: y up, facing +z, the left side is +x.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.errors import InputError
from ..core.geometry import vertex_areas
from ..core.normalization import bbox_centre
from ..core.rig import Rig, descendant_matrix, descendants
from .body_model import load_body
from .joint_names import ancestors, called_hips, common_ancestors, named_joints, other_side, parents_first, trunk_joints
from .skinned_character import SkinnedCharacter

FindJoints = Callable[[SkinnedCharacter], dict[str, int]]
"""Finds the joints of a character, y up, that `name_limb_joints` finds by name; raises InputError if it cannot."""
SIDES = ("Left", "Right")
TAILS = {"Arm": ("ForeArm", "Hand"), "ForeArm": ("Hand",), "UpLeg": ("Leg", "Foot"), "Leg": ("Foot",)}
"""Limbs without their side, and the joints at their other end: the first one that a character has."""
END_SLICE = 0.2
"""Share of a limb's length over which its end is averaged, where no joint marks the end. Chosen by eye."""
CARRIED = 0.5
"""A vertex belongs to a limb if the limb's joint and those below it have more than this share of its weight."""
ACROSS = 0.5
"""Least share of the distance of the hips along x that tells left from right: on the side, it is no longer along x."""
NO_HIPS = 0.005
"""Share of all weights up to which a joint above the legs that is not called hips is a root: painting leaves traces on
roots. Trunks of figures with such roots have 0.2 and more."""
LOOSE_FOOT = 0.05
"""Largest median movement of a foot relative to its shin over the clips, in heights of the figure.

Measured: up to 0.003 for feet that a solver keeps on the shin, 0.08 and more for the other leg's shin.
"""


class UnnamedJoints(InputError):
    """Joints whose names do not say which are thighs and upper arms."""


@dataclass(frozen=True, eq=False)
class Limb:
    """A limb of a character at rest, in the frame and unit of its vertices."""

    joint: int
    """The joint that carries the limb."""
    start: Float[np.ndarray, " 3"]
    """The end nearer to the hips."""
    end: Float[np.ndarray, " 3"]
    """The other end."""


def name_limb_joints(rig: SkinnedCharacter, path: object, known: Mapping[str, int] | None = None) -> dict[str, int]:
    """Find the joint of each joint of the shipped body, as `named_joints` does, for figures with fewer joints too.

    A leg of one joint is the thigh; hips are the joint by this name or where the legs meet, or the lowest joint of the
    trunk that has weights; sides are those of the figure: some makers name them as seen by the viewer. Limb joints that
    move no vertex are left out.

    Args:
        known: joints that the file itself names, in place of those found by their names.

    Raises:
        InputError: an upper arm or a thigh is not found by name, or a limb is not a chain.
    """
    found = name_sided_joints(rig, path, known)
    left = rig.joints[found["LeftUpLeg"]] - rig.joints[found["RightUpLeg"]]
    if left[0] < -ACROSS * np.linalg.norm(left):
        found = {other_side(name): joint for name, joint in found.items()}
    if "Hips" not in found:
        right = ancestors(rig.parents, found["RightUpLeg"])
        found["Hips"] = next((j for j in ancestors(rig.parents, found["LeftUpLeg"]) if j in right), 0)
    # Figures of blocks have a root that moves them and one joint for the trunk, which may turn without the root.
    share = rig.joint_weights().sum(axis=0) / rig.weights.sum()
    least = 0.0 if known or called_hips(rig.joint_names, found["Hips"]) else NO_HIPS
    trunk = [name for name in ("LowerBack", "Spine", "Spine1") if name in found and share[found[name]] > least]
    if share[found["Hips"]] <= least and trunk:
        found["Hips"] = found.pop(trunk[0])
    for side in SIDES:
        for upper, lower in (("Arm", "ForeArm"), ("UpLeg", "Leg")):
            chain = ancestors(rig.parents, found.get(side + lower, found[side + upper]))
            if found[side + upper] not in chain:
                raise InputError(
                    f"{path}: expected the joint of the {side}{lower} below that of the {side}{upper}, found it "
                    "elsewhere in the skeleton; export the deforming bones as chains"
                )
        # A hand elsewhere in the skeleton is a handle of the animator: the end of the forearm is used instead.
        if f"{side}Hand" in found:
            arm = found.get(f"{side}ForeArm", found[f"{side}Arm"])
            if arm not in ancestors(rig.parents, found[f"{side}Hand"])[1:]:
                del found[f"{side}Hand"]
    return found


def name_sided_joints(rig: SkinnedCharacter, path: object, known: Mapping[str, int] | None = None) -> dict[str, int]:
    """Find the joints by name alone, left and right as the maker named them; see `name_limb_joints`.

    Raises:
        UnnamedJoints: an upper arm or a thigh is not found by name.
    """
    found = dict(known) if known else limbs_by_name(rig.joint_names, rig.parents)
    moving = moves_vertices(rig)
    limbs = [f"{side}{part}" for side in SIDES for part in (*TAILS, "Hand", "Foot", "ToeBase")]
    if not known and any(not moving[found[name]] for name in limbs if name in found):
        # Controls may have the names of the joints that they drive, and come before them.
        names = tuple(name if moving[j] else "" for j, name in enumerate(rig.joint_names))
        driven = limbs_by_name(names, rig.parents)
        found |= {name: driven[name] for name in limbs if name in driven}
    for name in [f"{side}{part}" for side in SIDES for part in TAILS]:
        if name in found and not moving[found[name]]:
            del found[name]
    if missing := missing_limbs(found):
        raise UnnamedJoints(
            f"{path}: expected a thigh and an upper arm on both sides by name, each with weights, found none for "
            f"{', '.join(missing)}; rename the joints, for example LeftUpLeg, LeftArm"
        )
    return found


def limbs_by_name(joint_names: tuple[str, ...], parents: tuple[int, ...]) -> dict[str, int]:
    """Find joints as `named_joints` does; a leg of one joint is the thigh."""
    found = named_joints(joint_names, parents)
    for side in SIDES:
        if f"{side}UpLeg" not in found and f"{side}Leg" in found:
            found[f"{side}UpLeg"] = found.pop(f"{side}Leg")
    return found


def missing_limbs(found: Mapping[str, int]) -> list[str]:
    """List the thighs and upper arms, which every rig of a person needs, that are not among joints by name."""
    return [name for part in ("UpLeg", "Arm") for side in SIDES if (name := f"{side}{part}") not in found]


def attach_feet(
    rig: SkinnedCharacter, joints: dict[str, int], poses: Float[np.ndarray, "N J 4 4"], path: object
) -> tuple[SkinnedCharacter, dict[str, int], Int[np.ndarray, " J"]]:
    """Make each foot a child of the shin that it moves with.

    Args:
        poses: transforms of each joint from rest to some poses; without any, a foot goes to the shin of its side.

    Returns the rig, its joints by name, and the new order of its joints (parents first): new joint k is old `order[k]`.

    Raises:
        InputError: a foot is above its shin, or moves with neither.
    """
    shins = {side: joints.get(f"{side}Leg", joints[f"{side}UpLeg"]) for side in SIDES}
    parents, joints = list(rig.parents), dict(joints)
    for side in SIDES:
        foot = joints.get(f"{side}Foot")
        if foot is None or shins[side] in ancestors(rig.parents, foot):
            continue
        movement = {
            other: np.median(_relative_movement(poses, rig.joints[foot], shin, foot)) if len(poses) else other != side
            for other, shin in shins.items()
        }
        nearest = min(movement, key=movement.__getitem__)
        if foot in ancestors(parents, shins[nearest]):  # it would be its own ancestor
            raise InputError(
                f"{path}: expected feet below shins, found a foot that holds its shin; parent the foot to it"
            )
        if movement[nearest] > LOOSE_FOOT * np.ptp(rig.mesh.vertices[:, 1]):
            raise InputError(
                f"{path}: expected feet that move with a shin in the clips, found a foot that moves with neither; "
                "export the deforming bones as chains"
            )
        parents[foot] = shins[nearest]
    return with_parents(rig, joints, parents)


def with_parents(
    rig: SkinnedCharacter, joints: dict[str, int], parents: list[int]
) -> tuple[SkinnedCharacter, dict[str, int], Int[np.ndarray, " J"]]:
    """Give the joints of a rig other parents, in the old order; returns the same as `attach_feet`."""
    order = np.array(parents_first(parents))
    rank = np.append(np.argsort(order), len(order))  # the world stays the last
    reordered = dataclasses.replace(
        rig,
        joint_names=tuple(rig.joint_names[j] for j in order),
        parents=tuple(int(rank[parents[j]]) if parents[j] >= 0 else -1 for j in order),
        T_world_joint=rig.T_world_joint[order],
        joint_of=rank[rig.joint_of],
    )
    return reordered, {name: int(rank[j]) for name, j in joints.items()}, order


def find_limbs(rig: SkinnedCharacter, joints: dict[str, int], path: object) -> dict[str, Limb]:
    """Find the limbs: LeftArm, LeftForeArm, LeftUpLeg, LeftLeg, the same of the right side, Trunk and Head.

    A limb of one joint reaches from the shoulder to the end of the hand, or from the hip to the sole, and its ends are
    centres of its surface, because blocks turn about joints at their edges. The head is left out where none is named.

    Raises:
        InputError: a limb has no length.
    """
    limbs = {}
    for side in SIDES:
        for part, tails in TAILS.items():
            if (joint := joints.get(side + part)) is not None:
                tail = next((joints[side + name] for name in tails if side + name in joints), None)
                limbs[side + part] = _limb(rig, joint, tail, whole=len(tails) > 1)
    hips = (rig.joints[joints["LeftUpLeg"]] + rig.joints[joints["RightUpLeg"]]) / 2
    shoulders = (rig.joints[joints["LeftArm"]] + rig.joints[joints["RightArm"]]) / 2
    neck = next((rig.joints[joints[name]] for name in ("Neck", "Head") if name in joints), shoulders)
    limbs["Trunk"] = Limb(joints["Hips"], hips, neck)
    head = carried_vertices(rig, joints["Head"]) if "Head" in joints else np.zeros(len(rig.weights), bool)
    if head.any():
        top = np.array([neck[0], rig.mesh.vertices[head, 1].max(), neck[2]])
        limbs["Head"] = Limb(joints["Head"], neck, top)
    short = [name for name, limb in limbs.items() if not (np.linalg.norm(limb.end - limb.start) > 0)]
    if short:
        raise InputError(
            f"{path}: expected limbs with a length at rest, found none for {', '.join(short)}; "
            "export the skeleton with its bones"
        )
    return limbs


def carried_vertices(rig: SkinnedCharacter, joint: int) -> Bool[np.ndarray, " V"]:
    """Select the vertices that a joint and those below it carry with more than the share CARRIED."""
    below = np.isin(rig.joint_of, descendants([joint], rig.parents))
    return (rig.weights * below).sum(axis=1) > CARRIED


def moves_vertices(rig: SkinnedCharacter) -> Bool[np.ndarray, " J"]:
    """Select the joints that have a weight, or a joint with a weight below them."""
    moving = np.zeros(len(rig.parents) + 1, bool)
    moving[rig.joint_of[rig.weights > 0]] = True
    for j in range(len(rig.parents) - 1, -1, -1):
        moving[rig.parents[j]] |= moving[j]  # parent -1 is the last entry, which is cut off
    return moving[:-1]


def _limb(rig: SkinnedCharacter, joint: int, tail: int | None, whole: bool) -> Limb:
    """Find the ends of a limb, whose `tail` is the joint at its end, if there is one.

    Without a tail the end is on the surface; for a `whole` limb, all of an arm or leg, so is the start.
    """
    start = rig.joints[joint]
    if tail is not None:
        return Limb(joint, start, rig.joints[tail])
    moving = moves_vertices(rig)
    children = [j for j, parent in enumerate(rig.parents) if parent == joint and moving[j]]
    if children and not whole:  # fingers begin where the hand does
        return Limb(joint, start, rig.joints[children].mean(axis=0))
    vertices = rig.mesh.vertices[carried_vertices(rig, joint)]
    if len(vertices) == 0:
        return Limb(joint, start, start)
    end = vertices.mean(axis=0)
    for _ in range(3):  # the axis defines the slices, whose centres define the axis
        axis = end - start
        along = (vertices - start) @ axis
        low, high = along.min(), along.max()
        # The centre of a bounding box: a mean would follow the density of the vertices.
        end = bbox_centre(vertices[along >= high - END_SLICE * (high - low)])
        if whole:
            start = bbox_centre(vertices[along <= low + END_SLICE * (high - low)])
    return Limb(joint, start, end)


def _relative_movement(poses, point, joint, moved):
    """Compute how far a point that one joint carries is from its median place in the frame of another, per pose."""
    homogeneous = np.append(point, 1.0)
    local = (np.linalg.inv(poses[:, joint]) @ poses[:, moved] @ homogeneous)[:, :3]
    return np.linalg.norm(local - np.median(local, axis=0), axis=1)


LIMBS = tuple(
    tuple(side + part for part in parts)
    for side in SIDES
    for parts in (("Shoulder", "Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot", "ToeBase"))
)
"""Limbs of the shipped body that are chains of joints."""
FEET = (("UpLeg", "Leg"), ("Foot", "ToeBase"))
"""Parts of a leg that may be chains of their own."""
COLLAR = 0.5
"""Length of a collar bone over that of an arm of one piece, from which on they are an upper arm and a forearm."""
UPPER = [(side + lower, side + upper) for side in SIDES for lower, upper in (("ForeArm", "Arm"), ("Leg", "UpLeg"))]
"""A lower limb without an upper one is the whole arm or leg (figures of blocks), or at least its first joint."""
SURE = 10.0
"""Score of a pair that is taken in any case: other pairs of a limb have 1.3 at most each."""
PELVIS = ("Hips", "LHipJoint", "RHipJoint")
"""Joints of the shipped body that move together with the hips."""
MATCH, NEARNESS = 0.3, 1.5
"""Score of a pair of joints: MATCH, plus their overlap, minus NEARNESS times their distance over the limb's length;
pairs below 0 are none. Chosen on characters whose names are known (docs/log/rigs.md)."""
LONG_TAIL, TWIN = 0.3, 0.05
"""Length in heights from which on a chain of joints may be a tail that hides a person's shape, and the difference of
lengths up to which two chains are the limbs of both sides."""
BLOCK = 4096
"""Vertices whose weights are compared at once; bounds the memory."""


def without_tails(rig: SkinnedCharacter) -> Iterator[SkinnedCharacter]:
    """Yield a character without what each long chain of joints without a twin carries, the longest first.

    Limbs have twins; a long tail, which has none, hides the shape of a person.
    """
    parents, moving = rig.parents, moves_vertices(rig)
    children = Counter(parent for joint, parent in enumerate(parents) if moving[joint])
    chains = []
    for leaf in [joint for joint in range(len(parents)) if moving[joint] and not children[joint]]:
        chain = [leaf]
        while parents[chain[-1]] >= 0 and children[parents[chain[-1]]] == 1:
            chain.append(parents[chain[-1]])
        chains.append(chain)
    lengths = [float(np.linalg.norm(np.diff(rig.joints[chain], axis=0), axis=1).sum()) for chain in chains]
    for k in np.argsort(lengths)[::-1].tolist():
        twins = [n for n in range(len(chains)) if n != k and abs(lengths[n] / max(lengths[k], 1e-9) - 1) < TWIN]
        if lengths[k] > LONG_TAIL * np.ptp(rig.mesh.vertices[:, 1]) and not twins:
            of_chain = (rig.weights * np.isin(rig.joint_of, chains[k])).sum(axis=1) > CARRIED
            rest = rig.mesh.faces[~of_chain[rig.mesh.faces].any(axis=1)]
            if len(rest):
                yield rig.part(rest)


def match_joints(rig: SkinnedCharacter, body: Rig, path: object) -> dict[str, int]:
    """Find the joint that corresponds to each joint of the shipped body, as `named_joints` does, but without names.

    Joints are not found where none carries the same surface. Fingers are not matched.

    Args:
        rig: a character, y up.
        body: the shipped body's joints in this character, and their weights of its vertices.
        path: in error messages.

    Raises:
        InputError: no joint is an upper arm or a thigh.
    """
    # Of the surfaces that each of the body's joints and each of the rig's carries, the area of the intersection over
    # that of the union; weights count as shares of a vertex's area.
    below, body_below = descendant_matrix(rig.parents), descendant_matrix(load_body().parents)
    areas = surface_areas(rig)
    common, theirs, ours = np.zeros((len(body_below), len(below))), np.zeros(len(below)), np.zeros(len(body_below))
    for start in range(0, len(areas), BLOCK):
        block = slice(start, start + BLOCK)
        area = areas[block, None]
        weights = np.zeros((len(area), len(below) + 1))  # the last column is the world's
        np.add.at(weights, (np.arange(len(area))[:, None], rig.joint_of[block]), rig.weights[block])
        carried, body_carried = weights[:, :-1] @ below.T, body.weights[block] @ body_below.T
        theirs, ours = theirs + (area * carried).sum(axis=0), ours + (area * body_carried).sum(axis=0)
        for b, column in enumerate(body_carried.T):
            common[b] += (area * np.minimum(carried, column[:, None])).sum(axis=0)
    overlap = common / np.maximum(theirs + ours[:, None] - common, np.finfo(float).tiny)
    found = _match_limbs(overlap, rig, body)
    if missing := missing_limbs(found):
        raise InputError(
            f"{path}: expected joints that carry both arms and both legs, found none for {', '.join(missing)}; "
            "name the joints, for example LeftUpLeg, LeftArm"
        )
    legs, chest = (common_ancestors(found, part, rig.parents) for part in ("UpLeg", "Arm"))
    if legs or chest:
        found["Hips"] = _hips(rig, body, {*legs, *chest})
    if chest:
        found |= trunk_joints(chest, _head(overlap, rig, body, chest[0]), found.get("Hips", -1), rig.parents)
    return found


def match_chain(score: Float[np.ndarray, "N J"], parents: tuple[int, ...]) -> dict[int, int]:
    """Assign joints of a tree to a chain of N joints, each below the one before, so that the sum of scores is largest.

    Members of the chain may be left out, which scores 0. Parents come before their children.
    """
    # best[j]: sum and assignment of the rest of the chain to joints strictly below j; the last entry is the whole tree.
    empty: tuple[float, dict[int, int]] = (0.0, {})
    below = [empty] * (len(parents) + 1)
    for k in range(len(score) - 1, -1, -1):
        best = list(below)
        for j in range(len(parents) - 1, -1, -1):
            total, rest = below[j]
            taken = (float(score[k, j]) + total, {k: j, **rest}) if score[k, j] > 0 else empty
            best[parents[j]] = max(best[parents[j]], best[j], taken, key=lambda option: option[0])
        below = best
    return below[-1][1]


def _match_limbs(overlap: Float[np.ndarray, "B J"], rig: SkinnedCharacter, body: Rig) -> dict[str, int]:
    """Match the joints of arms and legs; what is also another limb's joint, or above one, belongs to no limb.

    So the hips of a rig are no thigh, even if legs are predicted too high.
    """
    names = load_body().joint_names
    index = [[names.index(name) for name in limb] for limb in LIMBS]
    lengths = [np.linalg.norm(np.diff(body.joints[limb], axis=0), axis=1).sum() for limb in index]
    scores = [_scores(overlap, rig, body, limb, length) for limb, length in zip(index, lengths, strict=True)]
    below = descendant_matrix(rig.parents)
    above: list[int] = []
    while True:
        for score in scores:
            score[:, above] = 0
        chains = [_match_limb(limb, score, rig.parents) for limb, score in zip(LIMBS, scores, strict=True)]
        taken = [sorted(chain.values()) for chain in chains]
        above = [
            joint for limb, other in itertools.permutations(taken, 2) for joint in limb if below[joint, other].any()
        ]
        if not above:
            break
    for limb, score, chain in zip(LIMBS, scores, chains, strict=True):
        for lower, upper in UPPER:
            if lower in chain and upper not in chain:
                score[limb.index(upper), chain.pop(lower)] = SURE  # and what is below it is matched again
                chain |= _match_limb(limb, score, rig.parents)
    found = {name: joint for chain in chains for name, joint in chain.items()}
    for side in SIDES:
        arm = [found[side + part] for part in ("Shoulder", "Arm", "Hand") if side + part in found]
        if len(arm) == 3 and f"{side}ForeArm" not in found:
            bones = np.linalg.norm(np.diff(rig.joints[arm], axis=0), axis=1)
            if bones[0] > COLLAR * bones[1]:
                found[f"{side}Arm"], found[f"{side}ForeArm"] = found.pop(f"{side}Shoulder"), found[f"{side}Arm"]
    return found


def _match_limb(limb: tuple[str, ...], score: Float[np.ndarray, "N J"], parents: tuple[int, ...]) -> dict[str, int]:
    """Match the joints of a limb; its feet may be on a root of their own (inverse kinematics)."""
    found = match_chain(score, parents)
    for part in FEET:
        rest = [k for k, name in enumerate(limb) if name.endswith(part) and k not in found]
        if rest and not any(limb[k].endswith(part) for k in found):
            free = score[rest]
            free[:, list(found.values())] = 0
            found |= {rest[k]: joint for k, joint in match_chain(free, parents).items()}
    return {limb[k]: joint for k, joint in found.items()}


def _hips(rig: SkinnedCharacter, body: Rig, above: set[int]) -> int:
    """Find the joint among those above arms or legs that itself carries most of the surface that the hips carry."""
    hips = sum(body.weights[:, load_body().joint_names.index(name)] for name in PELVIS)
    own = np.zeros(len(rig.parents) + 1)
    np.add.at(own, rig.joint_of, (surface_areas(rig) * hips)[:, None] * rig.weights)
    return max(sorted(above, reverse=True), key=lambda joint: own[joint])


def _head(overlap: Float[np.ndarray, "B J"], rig: SkinnedCharacter, body: Rig, chest: int) -> int | None:
    """Find the joint below the chest that matches the head best; None if none does."""
    names = load_body().joint_names
    head, neck, hips = (names.index(name) for name in ("Head", "Neck", "Hips"))
    trunk = np.linalg.norm(body.joints[neck] - body.joints[hips])
    score = _scores(overlap, rig, body, [head], float(trunk))[0]
    score[descendant_matrix(rig.parents)[chest] == 0] = 0
    score[chest] = 0
    return int(score.argmax()) if score.max() > 0 else None


def _scores(
    overlap: Float[np.ndarray, "B J"], rig: SkinnedCharacter, body: Rig, joints: list[int], length: float
) -> Float[np.ndarray, "N J"]:
    """Score the pairs of some of the body's joints with all joints of the rig; 0 for joints that move no vertex."""
    distance = np.linalg.norm(body.joints[joints][:, None] - rig.joints, axis=-1)
    return (MATCH + overlap[joints] - NEARNESS * distance / length) * moves_vertices(rig)


def surface_areas(rig: SkinnedCharacter) -> Float[np.ndarray, " V"]:
    """Compute the area of each vertex; all count alike where there are no faces."""
    mesh = rig.mesh
    return vertex_areas(mesh.vertices, mesh.faces) if len(mesh.faces) else np.ones(len(mesh.vertices))
