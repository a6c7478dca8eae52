"""Which joint is which: those of somebody else's skeleton that stand for ours, by their names and by what holds what.

A limb joint is a side and a part, in either order and however it is written: LeftUpLeg, mixamorig:LeftUpLeg, L_Thigh,
thigh.L, J_Bip_L_UpperLeg, "Bip01 L Thigh". The trunk goes by the hierarchy: its joints are those between the hips and
where both arms hang, its neck those between there and the head, whatever they are called.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

from ..core.errors import InputError

PARTS = {
    "HipJoint": "hipjoint",
    "Leg": "lowerleg lowleg shin calf tibia knee leg",
    "UpLeg": "upleg upperleg thigh thighbend femur hip leg",
    "Foot": "ankle foot",
    "ToeBase": "toebase toe toes toe0 ball metatarsals foot",
    "ForeArm": "forearm lowerarm lowarm forearmbend elbow radius",
    "Arm": "upperarm uparm humerus shldr shldrbend arm shoulder",
    "Shoulder": "clavicle collar collarbone shoulder",
    "Hand": "wrist hand",
}
"""Our limb joints without their side: what others call them, the surest word first.

A word means what is not found by a surer one: `leg` is the shin beside a thigh, and the thigh beside a knee; `shoulder`
is the upper arm beside a collar and an elbow, and the collar beside an arm. Rows are served from the top.
"""
HIPS = ("hips", "hip", "pelvis")
SIDES = {"left": "Left", "l": "Left", "right": "Right", "r": "Right"}
_WORDS = "|".join(sorted({word for words in PARTS.values() for word in words.split()}))
_LIMB = re.compile(f"(left|right|l|r)({_WORDS})(?:01)?|({_WORDS})(?:01)?(left|right|l|r)")
_RIGS = re.compile(r"^(mixamorig\d*|jbip|bip\d*|def)")
SHOWN = 12
"""Names of a file that an error quotes."""


def named_joints(joint_names: tuple[str, ...], parents: tuple[int, ...]) -> dict[str, int]:
    """Index of the joint that stands for each of ours, as far as there is one; fingers are left out.

    `parents` come before their children, -1 for roots. Of two joints of one name the first counts. Of a longer trunk
    than ours the first, the middle and the last joint are taken, of a shorter one the last ones.
    """
    plain = plain_names(joint_names)
    found = _limbs(plain)
    hips = [plain.index(word) for word in (*HIPS, *(f"c{word}" for word in HIPS)) if word in plain]
    legs = _shared(found, ("LeftUpLeg", "RightUpLeg"), parents)
    if hips or legs:
        found["Hips"] = hips[0] if hips else legs[0]
    chest = _shared(found, ("LeftArm", "RightArm"), parents)
    if chest:
        trunk = _below(chest, found.get("Hips", -1))
        spread = [trunk[0], trunk[len(trunk) // 2], trunk[-1]] if len(trunk) > 2 else trunk
        found |= dict(zip(("LowerBack", "Spine", "Spine1")[3 - len(spread) :], spread, strict=True))
        found |= _head(plain, parents, chest[0])
    return found


def require_joints(found: dict[str, int], needed: Iterable[str], joint_names: tuple[str, ...], path: object) -> None:
    """Check that a skeleton has the joints that are needed.

    Raises:
        InputError: it lacks some; the message lists these and what there is instead.
    """
    missing = [joint for joint in dict.fromkeys(needed) if joint not in found]
    if missing:
        more = f" and {len(joint_names) - SHOWN} more" if len(joint_names) > SHOWN else ""
        raise InputError(
            f"{path}: expected hips and, left and right, thigh, shin, foot, upper arm, forearm and hand by name, found "
            f"none for {', '.join(missing)} among {', '.join(joint_names[:SHOWN])}{more}; "
            "rename the joints, for example Hips, LeftUpLeg, LeftLeg, LeftFoot, LeftArm, LeftForeArm, LeftHand"
        )


def plain_names(joint_names: tuple[str, ...]) -> list[str]:
    """Names in lower case without separators, namespaces and the words that most names of a file begin or end with."""
    words = [[w for w in re.split(r"[._\s-]+", name.split(":")[-1].lower()) if w] for name in joint_names]
    for end in (0, -1):
        while (common := _common(words, end)) is not None:
            for own in words:
                if len(own) > 1 and own[end] == common:
                    del own[end]
    return [_RIGS.sub("", "".join(own)) for own in words]


def _common(words: list[list[str]], end: int) -> str | None:
    """The first (or last) word of more than half of all names, unless it is a side."""
    counts = Counter(own[end] for own in words if len(own) > 1 and own[end] not in SIDES)
    word, count = counts.most_common(1)[0] if counts else ("", 0)
    return word if 2 * count > len(words) else None


def _limbs(plain: list[str]) -> dict[str, int]:
    """Limb joints of both sides by name alone."""
    there: dict[tuple[str, str], int] = {}
    for j, name in enumerate(plain):
        if match := _LIMB.fullmatch(name):
            side, part = (match[1], match[2]) if match[1] else (match[4], match[3])
            there.setdefault((SIDES[side], part), j)
    found = {}
    for side in ("Left", "Right"):
        for part, words in PARTS.items():
            word = next((word for word in words.split() if (side, word) in there), None)
            if word is not None:
                ours = f"{side[0]}HipJoint" if part == "HipJoint" else f"{side}{part}"
                found[ours] = there.pop((side, word))
    return found


def _chain(joint: int, parents: tuple[int, ...]) -> list[int]:
    """A joint and all that hold it, up to the root."""
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = parents[joint]
    return chain


def _shared(found: dict[str, int], pair: tuple[str, str], parents: tuple[int, ...]) -> list[int]:
    """The joint that holds both of a pair, nearest first, and all above it; empty where there is none."""
    if not all(joint in found for joint in pair):
        return []
    one, two = (_chain(found[joint], parents) for joint in pair)
    return [j for j in one if j in two]


def _below(chain: list[int], top: int) -> list[int]:
    """The part of a chain below one of its joints, from the top down; a chain without it loses its root."""
    stop = chain.index(top) if top in chain else len(chain) - 1
    return chain[:stop][::-1]


def _head(plain: list[str], parents: tuple[int, ...], chest: int) -> dict[str, int]:
    """Head and neck: the head by name, or else the last joint above the chest that is called spine or neck."""
    above = [j for j in range(len(plain)) if chest in _chain(j, parents)[1:]]
    heads = [j for j in above if plain[j] in ("head", "chead")]
    heads = heads or [j for j in above if plain[j].startswith(("spine", "neck"))][-1:]
    if not heads:
        return {}
    neck = _below(_chain(heads[0], parents), chest)[:-1]
    ends = [neck[0], neck[-1]] if len(neck) > 1 else neck
    return {"Head": heads[0], **dict(zip(("Neck", "Neck1"), ends, strict=False))}
