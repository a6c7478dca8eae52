"""Names of the shipped body's joints in game engines and other programs, and bones that these add or demand.

Facts and where they are from:

* mixamo: the joints that Mixamo's rigger makes, without the `_End` and fourth finger joints, which carry nothing
  (Ready Player Me documents the same list: "Avatar templates").
* unreal: the skeleton of the UE5 mannequins Manny and Quinn. No page of Epic's documentation lists it; the names and
  parents are those that public projects check for. The UE4 mannequin has the same names but ends its spine at spine_03
  and its neck at neck_01, and has no metacarpals.
* vrm: `humanoid.md` of VRM 1.0, also the list of three-vrm. Unity's HumanBodyBones are the same bones with a capital.
* godot: `SkeletonProfileHumanoid` of Godot 4 (scene/resources/skeleton_profile.cpp), where also `required` is from.
* rigify: the deform bones (DEF-) of a rig that Blender's Rigify generates from its human metarig. These are the names
  of the vertex groups of a mesh that is bound to such a rig, and the bones that leave Blender; the metarig's own names
  are the same without DEF-, but its bones are replaced when the rig is generated.

Joints of ours without a name in a scheme: LHipJoint, RHipJoint, the finger stubs, and Neck1 where there is one neck.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..core.options import Layout
from .joint_names import FINGERS

TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head")
"""Joints of trunk and neck, from the hips up."""
LIMBS = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")
REQUIRED = (
    *("Hips", "LowerBack", "Head"),
    *(f"{side}{limb}" for side in ("Left", "Right") for limb in LIMBS if limb not in ("Shoulder", "ToeBase")),
)
"""Joints without which no scheme is written: the 15 bones that VRM 1.0 requires, by our names."""
SIDES = (
    {"Side": "Left", "side": "left", "S": "L", "s": "l"},
    {"Side": "Right", "side": "right", "S": "R", "s": "r"},
)
"""Spellings of a side in the patterns of names."""


@dataclass(frozen=True)
class Scheme:
    """Names and layout of one program's humanoid skeleton."""

    program: str
    bones: dict[str, str]
    """Joint of ours -> bone, in the order in which bones are written, parents first; empty: all joints stay."""
    root: str
    """Bone above the hips that carries the displacement over the ground."""
    has_root: bool = False
    """Whether the skeleton always has that bone; if not, it is optional."""
    inserted: dict[str, str] = field(default_factory=dict)
    """Bone -> bone that the scheme has between this one and its parent, and we have not. It moves no vertex."""


def _bones(trunk: str, limbs: str, fingers: tuple[str, ...]) -> dict[str, str]:
    """Build the table of a scheme from patterns; "-" stands for a joint that the scheme does not have."""
    bones = dict(zip(TRUNK, trunk.split(), strict=True))
    ours = [f"Hand{finger}{k}" for finger in FINGERS for k in (1, 2, 3)]
    for side in SIDES:
        patterns = limbs.split()
        rows = [*zip(LIMBS[:4], patterns[:4], strict=True), *zip(ours, fingers, strict=True)]
        rows += zip(LIMBS[4:], patterns[4:], strict=True)
        bones |= {side["Side"] + joint: pattern.format(**side) for joint, pattern in rows}
    return {joint: bone for joint, bone in bones.items() if bone != "-"}


def _phalanges(pattern: str, thumb: tuple[str, str, str], finger: tuple[str, str, str]) -> tuple[str, ...]:
    """Spell out fifteen finger joints that are called by names of their phalanges, such as {side}IndexProximal."""
    rows = [("Thumb", thumb), *((name, finger) for name in ("Index", "Middle", "Ring", "Little"))]
    return tuple(pattern + name + phalanx for name, names in rows for phalanx in names)


def _numbered(pattern: str, fingers: tuple[str, ...]) -> tuple[str, ...]:
    """Spell out fifteen finger joints that are called by numbers; `pattern` has @ for the finger and # for 1 to 3."""
    return tuple(pattern.replace("@", finger).replace("#", str(k)) for finger in fingers for k in (1, 2, 3))


_THUMB, _FINGER = ("Metacarpal", "Proximal", "Distal"), ("Proximal", "Intermediate", "Distal")
_METACARPALS = {
    f"{finger}_01_{side['s']}": f"{finger}_metacarpal_{side['s']}"
    for side in SIDES
    for finger in ("index", "middle", "ring", "pinky")
}
SCHEMES = {
    "own": Scheme("own", {}, root="Root"),
    "mixamo": Scheme(
        "Mixamo",
        _bones(
            "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck - mixamorig:Head",
            " ".join("mixamorig:{Side}" + limb for limb in LIMBS),
            _numbered("mixamorig:{Side}Hand@#", FINGERS),
        ),
        root="Root",
    ),
    "unreal": Scheme(
        "Unreal Engine 5",
        _bones(
            "pelvis spine_01 spine_03 spine_05 neck_01 neck_02 head",
            "clavicle_{s} upperarm_{s} lowerarm_{s} hand_{s} thigh_{s} calf_{s} foot_{s} ball_{s}",
            _numbered("@_0#_{s}", ("thumb", "index", "middle", "ring", "pinky")),
        ),
        root="root",
        has_root=True,
        inserted={"spine_03": "spine_02", "spine_05": "spine_04", **_METACARPALS},
    ),
    "vrm": Scheme(
        "VRM 1.0",
        _bones(
            "hips spine chest upperChest neck - head",
            "{side}Shoulder {side}UpperArm {side}LowerArm {side}Hand "
            "{side}UpperLeg {side}LowerLeg {side}Foot {side}Toes",
            _phalanges("{side}", _THUMB, _FINGER),
        ),
        root="Root",
    ),
    "godot": Scheme(
        "Godot 4",
        _bones(
            "Hips Spine Chest UpperChest Neck - Head",
            "{Side}Shoulder {Side}UpperArm {Side}LowerArm {Side}Hand "
            "{Side}UpperLeg {Side}LowerLeg {Side}Foot {Side}Toes",
            _phalanges("{Side}", _THUMB, _FINGER),
        ),
        root="Root",
    ),
    "rigify": Scheme(
        "Rigify",
        _bones(
            " ".join(["DEF-spine", *(f"DEF-spine.00{k}" for k in range(1, 7))]),
            "DEF-shoulder.{S} DEF-upper_arm.{S} DEF-forearm.{S} DEF-hand.{S} "
            "DEF-thigh.{S} DEF-shin.{S} DEF-foot.{S} DEF-toe.{S}",
            _numbered("DEF-@.0#.{S}", ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")),
        ),
        root="root",
    ),
}
"""Schemes by their name in `--names`."""


def root_name(layout: Layout) -> str | None:
    """Name the bone above the hips, if there is to be one."""
    scheme = SCHEMES[layout.names]
    return scheme.root if layout.root_bone or scheme.has_root else None
