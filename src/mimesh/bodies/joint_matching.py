"""Match the joints of a rig whose names say nothing to those of the shipped body: by the surface they move, and place.

What is compared is the part of the surface that a joint carries together with all joints below it: it does not depend
on twist bones, helpers, fingers, and on how many joints a trunk has.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.geometry import vertex_areas
from ..core.rig import Rig, descendant_matrix
from .body_model import load_body
from .character_limbs import SIDES, missing_limbs, moves_vertices
from .joint_names import common_ancestors, trunk_joints
from .skinned_character import SkinnedCharacter

LIMBS = tuple(
    tuple(side + part for part in parts)
    for side in SIDES
    for parts in (("Shoulder", "Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot", "ToeBase"))
)
"""Limbs of the shipped body that are chains of joints."""
FEET = (("UpLeg", "Leg"), ("Foot", "ToeBase"))
"""Parts of a leg that may be chains of their own."""
UPPER = {"ForeArm": "Arm", "Leg": "UpLeg"}
"""A lower limb without an upper one is the whole arm or leg: figures of blocks."""
PELVIS = ("Hips", "LHipJoint", "RHipJoint")
"""Joints of the shipped body that move together with the hips."""
MATCH, NEARNESS = 0.3, 1.5
"""Score of a pair of joints: MATCH, plus their overlap, minus NEARNESS times their distance over the limb's length;
pairs below 0 are none. Chosen on characters whose names are known (docs/log/rigs.md)."""
BLOCK = 4096
"""Vertices whose weights are compared at once; bounds the memory."""


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
    overlap = carried_overlap(rig, body)
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


def carried_overlap(rig: SkinnedCharacter, body: Rig) -> Float[np.ndarray, "B J"]:
    """Compare the surface that each of the body's B joints carries with that which each of the rig's J joints does.

    Returns the area of the intersection over that of the union; weights count as shares of a vertex's area.
    """
    below, body_below = descendant_matrix(rig.parents), descendant_matrix(load_body().parents)
    areas = _areas(rig)
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
    return common / np.maximum(theirs + ours[:, None] - common, np.finfo(float).tiny)


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
    """Match the joints of arms and legs; joints that two limbs would share are above both, and belong to neither."""
    names = load_body().joint_names
    index = [[names.index(name) for name in limb] for limb in LIMBS]
    lengths = [np.linalg.norm(np.diff(body.joints[limb], axis=0), axis=1).sum() for limb in index]
    scores = [_scores(overlap, rig, body, limb, length) for limb, length in zip(index, lengths, strict=True)]
    shared: list[int] = []
    while True:
        for score in scores:
            score[:, shared] = 0
        chains = [_match_limb(limb, score, rig.parents) for limb, score in zip(LIMBS, scores, strict=True)]
        shared = [joint for joint, count in Counter(j for chain in chains for j in chain.values()).items() if count > 1]
        if not shared:
            break
    found = {name: joint for chain in chains for name, joint in chain.items()}
    for side in SIDES:
        for lower, upper in UPPER.items():
            if side + upper not in found and side + lower in found:
                found[side + upper] = found.pop(side + lower)
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
    np.add.at(own, rig.joint_of, (_areas(rig) * hips)[:, None] * rig.weights)
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


def _areas(rig: SkinnedCharacter) -> Float[np.ndarray, " V"]:
    """Compute the area of each vertex; all count alike where there are no faces."""
    mesh = rig.mesh
    return vertex_areas(mesh.vertices, mesh.faces) if len(mesh.faces) else np.ones(len(mesh.vertices))
