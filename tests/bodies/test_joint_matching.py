"""Joints found without names: rigs of other kinds of the same body, whose own joints are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rigs
from people import rigged

from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import match_chain, match_joints, without_tails
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.core.rig import Rig

LIMB_JOINTS = [f"{side}{part}" for side in ("Left", "Right") for part in rigs.LIMBS]
BODY = rigs.figure()


def matched(person: rigs.Figure, seed: int = 0, predicted: rigs.Figure = BODY) -> dict[str, str]:
    """Match a person's joints, in another order and without names; returns the names that were not shown."""
    rng = np.random.default_rng(seed)
    depth = [0] * len(person.parents)
    for j, parent in enumerate(person.parents):
        depth[j] = depth[parent] + 1 if parent >= 0 else 0
    order = np.lexsort((rng.random(len(depth)), depth))  # parents first, else any
    rank = np.argsort(order)
    parents = tuple(int(rank[person.parents[j]]) if person.parents[j] >= 0 else -1 for j in order)
    names = tuple(f"joint_{k}" for k in range(len(order)))
    mesh = Mesh(person.vertices, load_body().faces)
    character = rigged(mesh, names, parents, person.joints[order], person.weights[:, order])
    found = match_joints(character, Rig(np.tile(np.eye(3), (31, 1, 1)), predicted.joints, predicted.weights), "a.glb")
    return {name: person.names[order[joint]] for name, joint in found.items()}


@pytest.mark.parametrize("changes", [(), ("twists",), ("spines",), ("no toes",), ("twists", "no toes")], ids=str)
def test_limbs_hips_and_head_are_found_whatever_else_there_is(changes):
    found = matched(rigs.changed(rigs.figure(), *changes))
    assert {name: found.get(name) for name in (*LIMB_JOINTS, "Hips", "Head")} == {
        name: name for name in (*LIMB_JOINTS, "Hips", "Head")
    }


def test_the_trunk_is_the_chain_from_hips_to_chest():
    found = matched(rigs.changed(rigs.figure(), "spines"))  # two more joints, between these
    assert [found[name] for name in ("LowerBack", "Spine", "Spine1")] == ["LowerBack", "Spine", "Spine1"]


def test_a_limb_of_one_joint_is_the_upper_one():
    found = matched(rigs.changed(rigs.figure(), "one joint a limb"))
    assert all(found[f"{side}{part}"] == f"{side}{part}" for side in ("Left", "Right") for part in ("Arm", "UpLeg"))
    assert not any(name.endswith(("ForeArm", "Leg", "Foot")) for name in found if not name.endswith("UpLeg"))


@pytest.mark.parametrize("inwards", [(0.0, 0.0), (0.12, 0.06), (0.12, 0.18)])
def test_three_joints_are_an_arm_though_they_lie_too_near_to_the_trunk(inwards):
    """As those of CesiumMan, whose shoulders and elbows lie where others have collar bones and upper arms."""
    person = rigs.figure().without("LeftShoulder", "RightShoulder")
    joints = person.joints.copy()
    for sign, side in ((1, "Left"), (-1, "Right")):
        for part, metres in zip(("Arm", "ForeArm"), inwards, strict=True):
            joints[person.names.index(side + part), 0] -= sign * metres
    found = matched(dataclasses.replace(person, joints=joints))
    arms = [f"{side}{part}" for side in ("Left", "Right") for part in ("Arm", "ForeArm", "Hand")]
    assert {name: found.get(name) for name in arms} == {name: name for name in arms}
    assert "LeftShoulder" not in found


def test_hips_are_no_thigh_of_a_leg_that_is_predicted_too_high():
    """As of bones without a surface around: the left thigh and knee where hips and thigh are, the foot at the knee."""
    high = dataclasses.replace(BODY, joints=BODY.joints.copy(), weights=BODY.weights.copy())
    hips, thigh, shin, foot = (BODY.names.index(name) for name in ("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot"))
    high.joints[[thigh, shin, foot]] = BODY.joints[[hips, thigh, shin]]
    person = rigs.changed(BODY, "no toes").without("LHipJoint", "RHipJoint", "LeftFoot", "RightFoot")
    found = matched(person, predicted=high)
    expected = ["LeftUpLeg", "LeftLeg", "RightUpLeg", "RightLeg", "Hips"]
    assert [found.get(name) for name in expected] == expected


def test_a_foot_on_a_root_of_its_own_is_found():
    parents = tuple(-1 if name == "LeftFoot" else p for name, p in zip(BODY.names, BODY.parents, strict=True))
    found = matched(rigs.Figure(BODY.names, parents, BODY.joints, BODY.weights, BODY.vertices))
    assert (found["LeftFoot"], found["LeftLeg"]) == ("LeftFoot", "LeftLeg")


def test_a_rig_without_arms_is_refused():
    person = rigs.figure()
    arms = [name for name in person.names if any(part in name for part in ("Arm", "Hand", "Finger", "Thumb", "Should"))]
    with pytest.raises(InputError, match="LeftArm, RightArm"):
        matched(person.without(*arms[::-1]))


def test_a_chain_takes_the_best_descendants_in_order():
    parents = (-1, 0, 1, 2, 0)
    score = np.array([[0.1, 0.5, 0.4, 0.0, 0.9], [0.0, 0.6, 0.3, 0.8, 0.0]])
    assert match_chain(score, parents) == {0: 1, 1: 3}  # 0.9 at joint 4 has nothing below it
    assert match_chain(np.array([[0.0, 0, 0, 0, 0.2], [0.1, 0, 0, 0, 0]]), parents) == {0: 4}
    assert match_chain(-score, parents) == {}


def test_a_chain_that_carries_all_of_a_mesh_is_no_tail():
    """As a skinned rod: without the chain nothing would be left to look at."""
    mesh = Mesh(BODY.vertices, load_body().faces)
    joints = np.linspace([0.0, 0.0, 0.0], [0.0, 1.7, 0.0], 4)
    nearest = np.abs(mesh.vertices[:, None, 1] - joints[:, 1]).argmin(axis=1)
    rod = rigged(mesh, ("a", "b", "c", "d"), (-1, 0, 1, 2), joints, np.eye(4)[nearest])
    assert [*without_tails(rod)] == []
