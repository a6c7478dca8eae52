"""Limb joints are found by side and part in any spelling, trunk joints by the hierarchy."""

import numpy as np
import pytest
from foreign_names import CENTRE, SCHEMES, renamed, spelt

from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import name_sided_joints
from mimesh.bodies.joint_names import named_joints, require_joints
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.motions.motion import BONES
from mimesh.motions.retarget import NEEDED

OURS = load_body()


def skeleton(scheme: str, without: bool = True) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Our skeleton with the names of a scheme; joints that it lacks are left out, or get names without meaning."""
    names, parents, index = [], [], {-1: -1}
    for j, (joint, parent) in enumerate(zip(OURS.joint_names, OURS.parents, strict=True)):
        if without and joint not in spelt(scheme):
            index[j] = index[parent]
        else:
            index[j] = len(names)
            names.append(renamed(scheme)(joint))
            parents.append(index[parent])
    return tuple(names), tuple(parents)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_names_of_common_rigs_are_recognised(scheme):
    names, parents = skeleton(scheme)
    found = {joint: names[j] for joint, j in named_joints(names, parents).items()}
    assert found == spelt(scheme)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_numbers_that_all_joints_have_say_nothing(scheme):
    names, parents = skeleton(scheme)
    numbered = tuple(f"{name}_0{len(names) - j}" for j, name in enumerate(names))  # as Sketchfab writes them
    assert named_joints(("_rootJoint", *numbered), (-1, *(p + 1 for p in parents))) == {
        joint: j + 1 for joint, j in named_joints(names, parents).items()
    }


@pytest.mark.parametrize("scheme", SCHEMES)
def test_case_and_an_additional_root_do_not_matter(scheme):
    names, parents = skeleton(scheme, without=False)
    found = named_joints(names, parents)
    with_root = named_joints(("Armature", *(name.upper() for name in names)), (-1, *(p + 1 for p in parents)))
    assert with_root == {joint: j + 1 for joint, j in found.items()}
    assert set(NEEDED) <= set(found)
    assert len(set(found.values())) == len(found)


def test_names_of_the_shipped_body_map_to_themselves():
    fingers = ("Thumb", "Finger")
    expected = {joint: j for j, joint in enumerate(OURS.joint_names) if not any(word in joint for word in fingers)}
    assert named_joints(OURS.joint_names, OURS.parents) == expected


def test_mixed_spellings_in_one_file_are_recognised_and_words_shared_by_most_names_ignored():
    """Some exporters drop the colon, or number a second character."""
    names, parents = skeleton("mixamo")
    spellings = ("mixamorig{}", "mixamorig_{}", "mixamorig1:{}", "mixamorig1{}", "{}")
    mixed = tuple(spellings[j % 5].format(name.split(":")[1]) for j, name in enumerate(names))
    assert named_joints(mixed, parents) == named_joints(names, parents)
    names, parents = skeleton("unreal")
    marked = tuple(f"Character1_{name}_jnt" for name in names)
    assert named_joints(marked, parents) == named_joints(names, parents)


@pytest.mark.parametrize(("joints", "taken"), [(1, [0]), (2, [0, 1]), (3, [0, 1, 2]), (4, [0, 2, 3]), (5, [0, 2, 4])])
def test_trunks_of_other_lengths_are_mapped(joints, taken):
    trunk = tuple(f"bone{k}" for k in range(joints))
    names = ("Hips", *trunk, "LeftArm", "RightArm", "Neck", "Head")
    top = len(trunk)
    found = named_joints(names, (*range(-1, top), top, top, top, top + 3))
    assert [found[joint] - 1 for joint in ("LowerBack", "Spine", "Spine1") if joint in found] == taken
    assert (names[found["Neck"]], names[found["Head"]]) == ("Neck", "Head")


BIPED = ["Bip01", "Pelvis", "Spine", "Spine1", "Spine2", "Neck", "Head"]
"""The trunk of a 3ds Max Biped, each joint below the one before; the arms hang on the neck."""


@pytest.mark.parametrize(
    ("trunk", "expected"),
    [
        (BIPED, "Pelvis Spine Spine1 Spine2 Neck - Head"),
        ([*BIPED[:-1], "Neck1", "Head"], "Pelvis Spine Spine1 Spine2 Neck Neck1 Head"),
        (["Bip01", "Pelvis", "Spine", "Neck", "Head"], "Pelvis - - Spine Neck - Head"),
        (["Bip01", "Pelvis", "Neck", "Head"], "Pelvis - - Neck - - Head"),  # the trunk has no other joint
        (BIPED[:-1], "Pelvis Spine Spine1 Spine2 - - Neck"),
    ],
)
def test_a_neck_that_carries_the_arms_is_a_neck(trunk, expected):
    names, parents = [name if name == "Bip01" else f"Bip01 {name}" for name in trunk], [*range(-1, len(trunk) - 1)]
    for side in "LR":
        for top, chain in (("Neck", "Clavicle UpperArm Forearm Hand"), ("Pelvis", "Thigh Calf Foot Toe0")):
            for k, part in enumerate(chain.split()):
                parents.append(len(names) - 1 if k else names.index(f"Bip01 {top}"))
                names.append(f"Bip01 {side} {part}")
    found = {joint: names[j] for joint, j in named_joints(tuple(names), tuple(parents)).items()}
    trunk_of = zip(CENTRE, expected.split(), strict=True)
    limbs = {joint: name for joint, name in spelt("biped").items() if joint not in CENTRE}
    assert found == limbs | {joint: f"Bip01 {name}" for joint, name in trunk_of if name != "-"}


def test_errors_of_missing_joints_are_one_line():
    names = ("root", "tail", *(f"leg{k}" for k in range(20)))
    parents = tuple(np.arange(-1, len(names) - 1).tolist())
    with pytest.raises(InputError, match=r"^fox: expected hips .* found none for .*LeftLeg") as error:
        require_joints(named_joints(names, parents), NEEDED, names, "fox")
    assert "among root, tail, leg0" in str(error.value)
    assert "and 10 more" in str(error.value)
    assert "\n" not in str(error.value)
    assert all(joint in str(error.value) for joint in BONES)


def test_a_fist_is_a_hand_where_no_joint_is_called_so():
    names, parents = skeleton("quaternius")
    fists = tuple(name.replace("Hand", "Fist").replace("Wrist", "Fist") for name in names)
    found = named_joints(fists, parents)
    assert found == named_joints(names, parents)
    extended = (*names, "Fist.L")
    assert named_joints(extended, (*parents, found["LeftHand"])) == found
    shins = tuple(name.replace("LowerLeg", "DownLeg") for name in names)
    assert named_joints(shins, parents) == found


def miku() -> tuple[tuple[str, ...], tuple[int, ...]]:
    """The hierarchy of MikuMikuDance: hips beside the trunk, and copies of the legs beside the legs."""
    trunk = ["全ての親", "センター", "グルーブ", "腰", "上半身", "上半身2", "首", "頭"]
    names, parents = [*trunk, "下半身"], [-1, 0, 1, 2, 3, 4, 5, 6, 3]
    for side in "左右":
        for chain in ("上半身2 肩P 肩 腕 腕捩 ひじ 手捩 手首", "下半身 足 ひざ 足首 つま先",
                      "下半身 足D ひざD 足首D 足先EX", "全ての親 足IK親 足ＩＫ つま先ＩＫ"):  # fmt: skip
            top, *below = chain.split()
            for k, name in enumerate(below):
                parents.append(len(names) - 1 if k else names.index(top))
                names.append(side + name)
    return tuple(names), tuple(parents)


@pytest.mark.parametrize("control", ["Hero_Ctrl:{}", "Actor:{}"])
def test_a_control_rig_beside_a_skeleton_is_left(control):
    """It comes first, and has the same names in another namespace; an actor lacks joints."""
    names, parents = skeleton("cmu")
    shown = len(names) - (5 if "Actor" in control else 0)
    controls = [control.format(name) for name in names[:shown]]
    both = (*controls, "Reference", *(f"Hero:{name}" for name in names))
    found = named_joints(both, (*parents[:shown], -1, *(p + shown + 1 if p >= 0 else shown for p in parents)))
    assert {joint: both[j] for joint, j in found.items()} == {
        joint: f"Hero:{names[j]}" for joint, j in named_joints(names, parents).items()
    }


def test_the_trunk_of_mikumikudance_begins_beside_the_hips():
    names, parents = miku()
    found = {joint: names[j] for joint, j in named_joints(names, parents).items()}
    expected = spelt("mmd") | {"Spine": "上半身", "Spine1": "上半身2"}
    assert found == expected


def test_copies_of_leg_joints_that_carry_the_weights_are_the_legs():
    names, parents = miku()
    weighted = [
        j for j, name in enumerate(names) if name[1:] not in ("足", "ひざ", "足首", "つま先") and "Ｋ" not in name
    ]
    count = len(weighted)
    points = np.random.default_rng(0).normal(size=(count, 3))
    rig = SkinnedCharacter(
        Mesh(points, np.zeros((0, 3), int)), names, parents, np.tile(np.eye(4), (len(names), 1, 1)),
        np.array(weighted)[:, None], np.ones((count, 1)), points[:, None],
    )  # fmt: skip
    found = {joint: names[j] for joint, j in name_sided_joints(rig, "miku").items()}
    legs = {"UpLeg": "足D", "Leg": "ひざD", "Foot": "足首D", "ToeBase": "足先EX"}
    assert {f"Left{part}": found[f"Left{part}"] for part in legs} == {f"Left{p}": f"左{n}" for p, n in legs.items()}
    assert found["RightArm"] == "右腕"
