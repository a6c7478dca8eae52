"""Find the finger joints of rigged hands: by name, and where names say nothing by place.

Hands may have one to five chains of joints below them: mittens, hands of cartoons and claws have fewer than people.
Where there is no joint of the hand, fingers with names hang on the forearm. Character frame: y up, facing +z.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from ..core.geometry import unit_vectors
from ..core.rig import descendants
from .character_limbs import carried_vertices, moves_vertices, surface_areas
from .joint_names import FINGERS, ancestors, finger_joints, is_finger_stub, name_words, named_fingers, named_joints
from .skinned_character import SkinnedCharacter

THUMB = 0.75
"""Distance of the first joint of a thumb from the wrist, over that of the next finger, up to which it is one."""
APART, SPREAD = 30.0, 1.5
"""Angle (degrees) from which on a chain that points elsewhere than all others is a thumb, if it is also so many times
the largest angle between these: claws stand apart as much as their neighbours do. Chosen by eye."""
METACARPAL = 0.5
"""Distance of a metacarpal from the wrist, over that of the joint after it, up to which the first of more than three
joints is one."""
WHOLE_HAND = 0.75
"""Share of the surface below the wrist from which on a joint carries the palm: it is none of a finger."""
FEWEST_UNNAMED = 4
"""Chains that are fingers where the name of the hand says nothing either."""
PLACES = (("Middle",), ("Index", "Pinky"), ("Index", "Middle", "Pinky"), FINGERS[1:])
"""Names of one to four fingers from the thumb's side on: they are spread over the whole palm."""


def find_fingers(rig: SkinnedCharacter, joints: Mapping[str, int], sides: Iterable[str]) -> dict[str, int]:
    """Find the finger joints of a character's hands, by name or else by place.

    Args:
        rig: a character that faces +z.
        joints: joint of the shipped body -> index of the character's.
        sides: of the hands, Left or Right.
    """
    carriers = {side: [joints[at] for part in ("Hand", "ForeArm") if (at := side + part) in joints] for side in sides}
    hands = {f"{side}Hand": of[0] for side, of in carriers.items() if of}
    found = named_fingers(rig.joint_names, rig.parents, hands)
    moving, known = moves_vertices(rig), named_joints(rig.joint_names, rig.parents)
    for side in sides:
        named = {name[:-1] for name in finger_joints(side) if name in found and moving[found[name]]}
        stubs = any(is_finger_stub(rig.joint_names[found[f"{name}1"]]) for name in named if f"{name}1" in found)
        if f"{side}Hand" not in joints or named - {f"{side}Hand{FINGERS[0]}"} or stubs:
            continue
        # Where no names are known, two or three chains may be anything: parts of a palm, a thumb beside all fingers.
        placed = fingers_by_place(rig, joints[f"{side}Hand"], side, found.get(f"{side}Hand{FINGERS[0]}1"))
        chains = sum(name.endswith("1") for name in placed)
        if len(placed) > len(named) and (chains >= FEWEST_UNNAMED or f"{side}Hand" in known):
            found = {name: joint for name, joint in found.items() if not name.startswith(side)} | placed
    return found


def fingers_by_place(rig: SkinnedCharacter, hand: int, side: str, thumb: int | None = None) -> dict[str, int]:
    """Find the finger joints below a hand by place alone; none where more than five chains of joints begin there.

    The thumb of five chains begins nearest to the wrist; of fewer it begins much nearer or points elsewhere, if there
    is one. The others follow from its side on, or without it from the front: palms of a T-pose face down.

    Args:
        rig: a character that faces +z.
        hand: its joint.
        side: of the hand, Left or Right.
        thumb: a joint of the thumb, where it is known.
    """
    chains = _chains(rig, hand)
    if not chains or len(chains) > len(FINGERS):
        return {}
    known = [k for k, chain in enumerate(chains) if thumb in chain]
    apart = known[0] if known else _thumb(rig, hand, chains)
    others = [k for k in range(len(chains)) if k != apart]
    if others:
        start = rig.joints[[chain[0] for chain in chains]]
        along = start[others].mean(axis=0) - rig.joints[hand]
        across = np.array([0.0, 0.0, 1.0]) if apart is None else start[apart] - start[others].mean(axis=0)
        across = across - (across @ along) / (along @ along) * along
        others.sort(key=lambda k: -float(start[k] @ across))
    named = dict(zip(PLACES[len(others) - 1], others, strict=True)) if others else {}
    named |= {} if apart is None else {FINGERS[0]: apart}
    return {f"{side}Hand{finger}{k}": j for finger, c in named.items() for k, j in enumerate(chains[c][:3], 1)}


def _chains(rig: SkinnedCharacter, hand: int) -> list[list[int]]:
    """List the chains of joints below a hand that may be fingers, without metacarpals."""
    moving, parents = moves_vertices(rig), rig.parents
    below = [j for j in descendants([hand], parents) if j != hand and moving[j]]
    ends = [j for j in below if not any(parents[k] == j for k in below)]
    shared = Counter(j for end in ends for j in ancestors(parents, end))
    chains = [[j for j in ancestors(parents, end)[::-1] if j in below and shared[j] == 1] for end in ends]
    areas, carried = surface_areas(rig), {j: carried_vertices(rig, j) for j in (hand, *below)}
    most = WHOLE_HAND * areas[carried[hand]].sum()
    chains = [[j for j in chain if areas[carried[j]].sum() < most] for chain in chains]
    # The surface of a finger goes on beyond it: things in hands are apart.
    corners = {chain[0]: carried[chain[0]][rig.mesh.faces] for chain in chains if chain}
    meets = {j: bool((of.any(axis=1) & ~of.all(axis=1)).any()) for j, of in corners.items()}
    chains = [c for c in chains if c and (meets[c[0]] or "finger" in name_words(rig.joint_names[c[0]])[1])]
    reach = np.linalg.norm(rig.joints - rig.joints[hand], axis=1)
    return [c[1:] if len(c) > 3 and reach[c[0]] < METACARPAL * reach[c[1]] else c for c in chains]


def _thumb(rig: SkinnedCharacter, hand: int, chains: list[list[int]]) -> int | None:
    if len(chains) == 1:
        return None
    start = rig.joints[[chain[0] for chain in chains]]
    reach = np.linalg.norm(start - rig.joints[hand], axis=1)
    nearest, second = np.sort(reach)[:2]
    near = int(reach.argmin()) if len(chains) == len(FINGERS) or nearest < THUMB * second else None
    if near is not None and len(chains) > 2:
        return near
    ends = [rig.mesh.vertices[carried_vertices(rig, chain[0])].mean(axis=0) for chain in chains]
    pointing = unit_vectors(np.array(ends) - start)
    angles = np.degrees(np.arccos((pointing @ pointing.T).clip(-1, 1)))
    if len(chains) == 2:
        # The one that points elsewhere than the forearm: the joint of a mitten may begin at the wrist.
        forearm = unit_vectors(rig.joints[hand] - rig.joints[rig.parents[hand]])
        return int((pointing @ forearm).argmin()) if angles[0, 1] > APART else near
    apart = [np.delete(row, k).min() for k, row in enumerate(angles)]
    spread = [np.delete(np.delete(angles, k, 0), k, 1).max() for k in range(len(chains))]
    k = int(np.argmin(spread))
    return k if apart[k] > max(APART, SPREAD * spread[k]) else None
