"""Map the joints of a foreign skeleton to those of the shipped body, by their names and the hierarchy.

The name of a limb joint contains a side and a part, in either order and many spellings: LeftUpLeg, mixamorig:LeftUpLeg,
L_Thigh, thigh.L, J_Bip_L_UpperLeg, "Bip01 L Thigh". Trunk joints are found from the hierarchy, whatever their names:
the trunk is the chain from the hips to the common ancestor of both arms, the neck the chain from there to the head.
Only what is called neck is one wherever the arms hang: in 3ds Max Bipeds, below it.
Finger joints are found among those below a hand: LeftHandIndex1, index_01_l, L_Index1, leftIndexProximal, f_index.01.L,
finger2-1.L (five fingers counted from 1), "Bip01 L Finger1" (counted from 0), LThumb, LeftSecondPP (Xsens).
The Japanese names of MikuMikuDance are translated first.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

from ..core.errors import InputError
from ..core.printable import listed

T = TypeVar("T")
PARTS = {
    "HipJoint": "hipjoint",
    "Leg": "lowerleg lowleg loleg downleg shin shank calf tibia knee leg",
    "UpLeg": "upleg upperleg thigh thighbend femur hip leg",
    "Foot": "ankle foot",
    "ToeBase": "toebase toe toes toe0 ball metatarsals foot",
    "ForeArm": "forearm lowerarm lowarm loarm larm farm forearmbend elbow radius ulna",
    "Arm": "upperarm uparm uarm humerus shldr shldrbend arm shoulder",
    "Shoulder": "clavicle collar collarbone scapula shoulder",
    "Hand": "wrist hand fist",
}
"""Limb joints of the shipped body without their side, and words that others use for them, the least ambiguous first.

A name is used once, and rows are matched from the top. So the meaning of an ambiguous word depends on the other names:
`leg` is the shin if there is a thigh, and the thigh if there is a knee; `shoulder` is the upper arm if there are a
collar and an elbow, and the collar if there is an arm.
"""
FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")
"""Fingers of a hand in the order of their joints, three each."""
BESIDE = {
    "Index": ("Middle", "Ring", "Pinky"),
    "Middle": ("Ring", "Pinky", "Index"),
    "Ring": ("Pinky", "Middle", "Index"),
    "Pinky": ("Ring", "Middle", "Index"),
}
"""Fingers that a finger moves with where it is lacking: an index finger points alone, a thumb has none beside it."""
FEWEST_FINGERS = 3
"""Fingers of joints without a mesh are read from so many on, or where one has two joints: optical captures have one or
two of one joint each, mostly noise."""
FINGER_STUBS = ("FingerBase", "HandFinger1", "Thumb")
"""Joints that stand for all fingers in the list of 31: with finger joints, the hand takes their weights."""
FINGER_WORDS = {
    **{"thumb": 0, "index": 1, "pointer": 1, "fore": 1, "middle": 2, "mid": 2, "ring": 3},
    **{"pinky": 4, "pinkie": 4, "little": 4, "pink": 4, "small": 4},
}
"""Words for a finger, and its place in FINGERS."""
ORDINALS = {"first": 0, "second": 1, "third": 2, "fourth": 3, "fifth": 4}
"""The same where no other word says which finger it is."""
METACARPAL = {"metacarpal", "mc"}
NO_PHALANX = {"palm", *METACARPAL, "carpal", "carpus", "end", "tip", "nub", "base", "meta"}
"""Words of joints below a hand that are none of a finger's three; a thumb's first one may be a metacarpal."""
JAPANESE = {
    **{
        "左": "left",
        "右": "right",
        "下半身": "hips",
        "上半身": "spine",
        "首": "neck",
        "頭": "head",
        "全ての親": "root",
    },
    **{"肩": "collar", "腕": "arm", "ひじ": "elbow", "肘": "elbow", "手首": "wrist", "足首": "ankle", "足": "leg"},
    **{"ひざ": "knee", "膝": "knee", "つま先": "toe", "足先ex": "toe", "捩": "twist", "先": "tip", "親指": "thumb"},
    **{"人指": "index", "人差指": "index", "人差し指": "index", "中指": "middle", "薬指": "ring", "小指": "pinky"},
    **{"足d": "leg", "ひざd": "knee", "足首d": "ankle"},
}
"""Words in the names of MikuMikuDance. Those with a D are copies of leg joints, which carry the weights."""
MIDDLE = {"x", "m"}
"""Last words of joints that are on no side: Auto-Rig Pro (head.x), AdvancedSkeleton (Head_M)."""
HIPS = ("hips", "hip", "pelvis")
"""Words for the root of trunk and legs."""
SIDES = {"left": "Left", "l": "Left", "right": "Right", "r": "Right"}
"""Words for a side."""
_WORDS = "|".join(sorted({word for words in PARTS.values() for word in words.split()}))
_LIMB = re.compile(f"(left|right|l|r)({_WORDS})(?:01)?|({_WORDS})(?:01)?(left|right|l|r)")
OTHER_SIDE = {"Left": "Right", "Right": "Left", "L": "R", "R": "L"}
"""Sides in the names of the shipped body's joints, and those that mirror them."""
_SIDE = re.compile("Left|Right|[LR](?=[A-Z])")
_RUN = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
_JAPANESE = re.compile("|".join(sorted(JAPANESE, key=len, reverse=True)), re.IGNORECASE)
_HAND_WORDS = {
    *FINGER_WORDS,
    *ORDINALS,
    *NO_PHALANX,
    *SIDES,
    "mixamorig",
    "hand",
    "finger",
    "proximal",
    "intermediate",
    "distal",
}
_HAND_WORD = re.compile("|".join(sorted(_HAND_WORDS, key=len, reverse=True)) + r"|\d+")
_STUBS = {stub: {side + stub for side in ("Left", "Right", "L", "R")} for stub in FINGER_STUBS}
_RIG_PREFIX = re.compile(r"^(mixamorig\d*|jbip|bip\d*|def)")
NO_MEANING = {
    *("bone", "bn", "joint", "jnt", "node", "def", "sk", "bip", "mixamorig"),
    *("armature", "skeleton", "rig", "root", "ctrl", "control", "end"),
}
"""Words in names of joints that say nothing about what they are."""
SHOWN = 12
"""Largest number of joint names that an error quotes."""


def named_joints(joint_names: tuple[str, ...], parents: tuple[int, ...]) -> dict[str, int]:
    """Find the index of the joint that corresponds to each joint of the shipped body; joints not found are left out.

    `parents` come before their children, -1 for roots. Fingers are found by `named_fingers`. If two joints have
    one name, the first is taken, but of one skeleton: a control rig may have the names of the joints that it drives,
    in another namespace. Of a trunk longer than the shipped body's the first, the middle and the last joint are
    taken; a shorter one is mapped to the last joints.
    """
    plain = _of_one_skeleton(plain_names(joint_names), joint_names)
    found = _limbs(plain)
    hips = _hips(plain)
    legs = common_ancestors(found, "UpLeg", parents)
    if hips or legs:
        found["Hips"] = hips[0] if hips else legs[0]
    hips = found.get("Hips", -1)
    chest = common_ancestors(found, "Arm", parents)
    # Joints called neck that carry both arms are left out, unless the trunk has no others.
    if (below := [j for j in chest if "neck" not in plain[j]]) and below[0] not in ancestors(parents, hips):
        chest = below
    if chest:
        found |= trunk_joints(chest, _head(plain, parents, chest[0]), hips, parents)
    return found


def called_hips(joint_names: tuple[str, ...], joint: int) -> bool:
    """Tell whether a joint is the hips by its name."""
    return joint in _hips(plain_names(joint_names))


def common_ancestors(found: Mapping[str, int], part: str, parents: tuple[int, ...]) -> list[int]:
    """List the common ancestors of the left and right joint of a part, nearest first; empty if there are none."""
    if not all(side + part in found for side in ("Left", "Right")):
        return []
    first, second = (ancestors(parents, found[side + part]) for side in ("Left", "Right"))
    return [j for j in first if j in second]


def trunk_joints(chest: list[int], head: int | None, hips: int, parents: tuple[int, ...]) -> dict[str, int]:
    """Name the joints of trunk and neck by the hierarchy.

    Args:
        chest: the common ancestors of both arms that are no neck, nearest first.
        head: joint of the head, if it is known.
        hips: joint of the hips; -1 if it is not known.
    """
    # Hips beside the trunk: it begins below the joint that carries both.
    trunk = _below(chest, next((j for j in ancestors(parents, hips) if j in chest), -1))
    spread = [trunk[0], trunk[len(trunk) // 2], trunk[-1]] if len(trunk) > 2 else trunk
    found: dict[str, int] = dict(zip(("LowerBack", "Spine", "Spine1")[3 - len(spread) :], spread, strict=True))
    if head is None:
        return found
    neck = _below(ancestors(parents, head), chest[0])[:-1]
    ends = [neck[0], neck[-1]] if len(neck) > 1 else neck
    return found | {"Head": head, **dict(zip(("Neck", "Neck1"), ends, strict=False))}


def person_joints(joint_names: tuple[str, ...], parents: tuple[int, ...]) -> dict[str, int]:
    """Find the joints of a person and of fingers; none where thighs or upper arms are missing."""
    found = named_joints(joint_names, parents)
    needed = [(f"{side}Arm",) for side in ("Left", "Right")]
    needed += [(f"{side}UpLeg", f"{side}Leg") for side in ("Left", "Right")]
    if not all(any(name in found for name in either) for either in needed):
        return {}
    hands = {name: found[name] for side in ("Left", "Right") if (name := f"{side}Hand") in found}
    return found | named_fingers(joint_names, parents, hands)


def finger_joints(side: str) -> tuple[str, ...]:
    """List the names of the fifteen finger joints of a side, Left or Right: LeftHandThumb1, ..., LeftHandPinky3."""
    return tuple(f"{side}Hand{finger}{k}" for finger in FINGERS for k in (1, 2, 3))


def without_fingers(positions: dict[str, T]) -> dict[str, T]:
    """Leave out the finger joints of a figure."""
    fingers = {*finger_joints("Left"), *finger_joints("Right")}
    return {name: value for name, value in positions.items() if name not in fingers}


def with_finger_joints(joint_names: tuple[str, ...]) -> tuple[str, ...]:
    """List the joints of a figure with fingers: the shipped body's without finger stubs, then thirty of fingers."""
    kept = tuple(name for name in joint_names if not any(name in stubs for stubs in _STUBS.values()))
    return kept + finger_joints("Left") + finger_joints("Right")


def named_fingers(joint_names: tuple[str, ...], parents: tuple[int, ...], hands: dict[str, int]) -> dict[str, int]:
    """Find the index of each finger joint below the given hands ({"LeftHand": index, ...}); others are left out.

    A finger's joints are those of one finger by name, from the hand outwards; the first three that are no metacarpal
    and no end count. So the numbers in names, from 0, 1 or none, do not matter.
    """
    found = {}
    for side in ("Left", "Right"):
        if f"{side}Hand" not in hands:
            continue
        hand = hands[f"{side}Hand"]
        below = [j for j in range(len(parents)) if hand in ancestors(parents, j)[1:]]
        # A word of the hand's own name says nothing about a joint below it: base of CC_Base_L_Hand (Character Creator).
        said = NO_PHALANX.intersection(_hand_words(_own_name(joint_names[hand])))
        words = {j: [w for w in _hand_words(_own_name(joint_names[j])) if w not in said] for j in below}
        first = 0 if any(_finger_number(parts) == 0 for parts in words.values()) else 1
        places: dict[int, int] = {}  # in FINGERS
        for j in below:
            named = (table[word] for table in (FINGER_WORDS, ORDINALS) for word in words[j] if word in table)
            number = _finger_number(words[j])
            place = next(named, None if number is None else number - first)
            if place is not None and not NO_PHALANX.intersection(words[j]) - (METACARPAL if place == 0 else set()):
                places[j] = place
        # Numbers of one chain beside fingers with names are those of its joints: all other fingers in one (Synty).
        numbered = [j for j in places if _finger_number(words[j]) is not None]
        chained = all(numbered[0] in ancestors(parents, j) for j in numbered)
        if chained and 1 < len(numbered) < len(places):
            places |= dict.fromkeys(numbered, FINGERS.index("Middle"))
        # Beside a thumb with a name the index finger is the first that has a number: hands of cartoons.
        elif any(places[j] == 0 for j in places if j not in numbered and not is_finger_stub(joint_names[j])):
            least = min((places[j] for j in numbered), default=0)
            places |= {j: min(places[j] - least + 1, len(FINGERS) - 1) for j in numbered}
        # The shipped body's stubs stand for fingers that no others do: HandFinger1 for all, Thumb for one.
        named = [j for j in places if _finger_number(words[j]) is None]
        for stub, others in (("HandFinger1", named), ("Thumb", [j for j in named if places[j] == 0])):
            for j in [j for j in places if joint_names[j].split(":")[-1] in _STUBS[stub]]:
                if any(k != j and j not in ancestors(parents, k) for k in others):
                    del places[j]
        for number, finger in enumerate(FINGERS):
            chain = [j for j, place in places.items() if place == number]
            # Parents come first, so the chain is in order; a second chain of the same finger is no part of the first.
            chain = [j for j in chain if j == chain[0] or chain[0] in ancestors(parents, j)]
            found |= {f"{side}Hand{finger}{k}": j for k, j in enumerate(chain[:3], 1)}
    return found


def followed_fingers(joint: str) -> tuple[str, ...]:
    """List the joints that a finger joint follows where it is lacking: those above it, then of the fingers beside it.

    Empty for other joints.
    """
    side, _, name = joint.partition("Hand")
    finger, number = name[:-1], name[-1:]
    if side not in ("Left", "Right") or finger not in FINGERS:
        return ()
    chains = [(finger, int(number) - 1), *((other, int(number)) for other in BESIDE.get(finger, ()))]
    return tuple(f"{side}Hand{of}{k}" for of, count in chains for k in range(count, 0, -1))


def is_finger_stub(name: str) -> bool:
    """Tell whether the name of a joint ends as one of the shipped body's that stand for fingers."""
    return name.endswith(tuple(stub for stubs in _STUBS.values() for stub in stubs))


def stands_for(fingers: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """List the fingers that each finger of a hand stands for: itself, and those that the hand lacks beside it."""
    found: dict[str, tuple[str, ...]] = dict.fromkeys(fingers, ())
    for finger in FINGERS:
        own = next((other for other in (finger, *BESIDE.get(finger, ())) if other in found), None)
        if own is not None:
            found[own] += (finger,)
    return found


def captured_fingers(
    joint_names: tuple[str, ...], parents: tuple[int, ...], found: Mapping[str, int]
) -> dict[str, int]:
    """Find the finger joints of a skeleton without a mesh by name, in hands that have enough of them.

    Args:
        found: joints that are known, as `named_joints` finds them.
    """
    fingers: dict[str, int] = {}
    for side in ("Left", "Right"):
        hand = f"{side}Hand"
        named = named_fingers(joint_names, parents, {hand: found[hand]}) if hand in found else {}
        if sum(name.endswith("1") for name in named) >= FEWEST_FINGERS or any(name.endswith("2") for name in named):
            fingers |= named
    return fingers


def require_joints(found: dict[str, int], needed: Iterable[str], joint_names: tuple[str, ...], path: object) -> None:
    """Check that all needed joints were found.

    Raises:
        InputError: some were not; the message lists them and the names in the file.
    """
    missing = [joint for joint in dict.fromkeys(needed) if joint not in found]
    if missing:
        raise InputError(
            f"{path}: expected hips and, left and right, thigh, shin, foot, upper arm, forearm and hand by name, found "
            f"none for {', '.join(missing)} among {listed(joint_names, SHOWN)}; "
            "rename the joints, for example Hips, LeftUpLeg, LeftLeg, LeftFoot, LeftArm, LeftForeArm, LeftHand; "
            "give an animal or another creature as .glb, with its mesh"
        )


def plain_names(joint_names: tuple[str, ...]) -> list[str]:
    """Simplify names: lower case, without separators, namespaces and first or last words that most names share.

    Last words that number most joints, each with a number of its own (LeftArm_010 of Sketchfab), go like those.
    """
    words = [[w for w in re.split(r"[._\s-]+", _own_name(name).lower()) if w] for name in joint_names]
    numbered = [parts for parts in words if len(parts) > 1 and parts[-1].isdecimal()]
    if 2 * len(numbered) > len(words) and len({int(parts[-1]) for parts in numbered}) == len(numbered):
        for parts in numbered:
            del parts[-1]
    # Remove prefixes, then suffixes, until no word is common to most names.
    for end in (0, -1):
        while True:
            counts = Counter(parts[end] for parts in words if len(parts) > 1 and parts[end] not in SIDES)
            common, count = counts.most_common(1)[0] if counts else ("", 0)
            if 2 * count <= len(words):
                break
            for parts in words:
                if len(parts) > 1 and parts[end] == common:
                    del parts[end]
    for parts in words:
        if len(parts) > 1 and parts[-1] in MIDDLE:
            del parts[-1]
    # Auto-Rig Pro's thigh_stretch.l is the thigh, beside thigh_twist.l.
    return [_RIG_PREFIX.sub("", "".join(part for part in parts if part != "stretch")) for parts in words]


def ancestors(parents: Sequence[int], joint: int) -> list[int]:
    """List a joint and its ancestors, up to the root."""
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = parents[joint]
    return chain


def parents_first(parents: Sequence[int]) -> list[int]:
    """Order joints so that each is after its parent; where all are already, the order stays."""
    if all(parent < j for j, parent in enumerate(parents)):
        return list(range(len(parents)))
    return sorted(range(len(parents)), key=lambda j: len(ancestors(parents, j)))


def without_side(name: str) -> str:
    """Take the side off the name of a joint of a shipped body: LeftArm, LHipJoint; other names stay."""
    return name[side.end() :] if (side := _SIDE.match(name)) else name


def other_side(name: str) -> str:
    """Swap left and right in the name of a joint of the shipped body: LeftArm, LHipJoint; other names stay."""
    side = _SIDE.match(name)
    return name if side is None else OTHER_SIDE[side[0]] + name[side.end() :]


def name_words(name: str) -> tuple[int, tuple[str, ...]]:
    """Split the name of any creature's joint: its side (1 left, -1 right, 0 none) and the words that say something."""
    runs = [run.lower() for run in _RUN.findall(_own_name(name))]
    side = next(({"Left": 1, "Right": -1}[SIDES[run]] for run in runs if run in SIDES), 0)
    words = [run[:-1] if len(run) > 3 and run.endswith("s") else run for run in runs if not run.isdigit()]
    return side, tuple(word for word in words if word not in SIDES and word not in NO_MEANING and len(word) > 1)


def _own_name(name: str) -> str:
    """Return a name without its namespace, and in Latin letters if it is one of MikuMikuDance."""
    own = name.split(":")[-1]
    if own.isascii():
        return own
    return _JAPANESE.sub(lambda found: f"{JAPANESE[found[0].lower()]}_", unicodedata.normalize("NFKC", own))


def _hand_words(name: str) -> list[str]:
    """Split the name of a joint below a hand into words and numbers: at separators, capitals and digits.

    Names in one case, such as lthumb1, are split if they consist of known words: ring is no part of spring.
    """
    words = []
    for run in _RUN.findall(name):
        parts = _HAND_WORD.findall(run.lower())
        words += parts if "".join(parts) == run.lower() else []
    return words


def _finger_number(parts: list[str]) -> int | None:
    """Read the number of a finger that is called by one: the first digit after the word `finger`."""
    if "finger" not in parts or any(word in FINGER_WORDS for word in parts):
        return None
    digits = [word for word in parts[parts.index("finger") :] if word.isdigit()]
    return int(digits[0][0]) if digits else None


def _of_one_skeleton(plain: list[str], joint_names: tuple[str, ...]) -> list[str]:
    """Clear the names that the namespace with the most limbs has, too; of equal ones, that of a control rig is left."""
    spaces = [name.rpartition(":")[0] for name in joint_names]
    if len({*spaces}) < 2 or len({*plain}) == len(plain):
        return plain
    limbs = {
        space: len(_limbs([p if s == space else "" for p, s in zip(plain, spaces, strict=True)])) for space in spaces
    }
    best = max(limbs, key=lambda space: (limbs[space], "ctrl" not in space.lower()))
    taken = {name for name, space in zip(plain, spaces, strict=True) if space == best}
    return [name if space == best or name not in taken else "" for name, space in zip(plain, spaces, strict=True)]


def _limbs(plain: list[str]) -> dict[str, int]:
    by_word: dict[tuple[str, str], int] = {}
    for j, name in enumerate(plain):
        if match := _LIMB.fullmatch(name):
            side, part = (match[1], match[2]) if match[1] else (match[4], match[3])
            by_word.setdefault((SIDES[side], part), j)
    found = {}
    for side in ("Left", "Right"):
        for part, words in PARTS.items():
            word = next((word for word in words.split() if (side, word) in by_word), None)
            if word is not None:
                joint = f"{side[0]}HipJoint" if part == "HipJoint" else f"{side}{part}"
                # A name is used once: later rows may have the same word.
                found[joint] = by_word.pop((side, word))
    return found


def _hips(plain: list[str]) -> list[int]:
    return [plain.index(word) for word in (*HIPS, *(f"c{word}" for word in HIPS)) if word in plain]


def _below(chain: list[int], top: int) -> list[int]:
    """Select the part of a chain below one of its joints, from the top down; of a chain without it all but the root."""
    stop = chain.index(top) if top in chain else len(chain) - 1
    return chain[:stop][::-1]


def _head(plain: list[str], parents: tuple[int, ...], chest: int) -> int | None:
    """Find the head by name, or else the last descendant of the chest named spine or neck."""
    descendants = [j for j in range(len(plain)) if chest in ancestors(parents, j)[1:]]
    heads = [j for j in descendants if plain[j] in ("head", "chead", "head1")]
    heads = heads or [j for j in descendants if plain[j].startswith(("spine", "neck"))][-1:]
    return heads[0] if heads else None
