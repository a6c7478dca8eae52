"""Rigs of animals: lengths of legs whatever bones they have, limbs of fewer bones, feet, and how rest poses differ."""

import dataclasses
import itertools

import numpy as np
import pytest
from animals import BODY, FEET, LEGS, animal, bones, nothing_said, random_turns

from mimesh.bodies.anatomy import QUADRUPED
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.character_pool import FACING, facing_rotation
from mimesh.bodies.joint_names import ancestors
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.rig import leg_length
from mimesh.motions.animal_rig import animal_rig, rest_directions

SHAPES = (None, 0, 1)


def rig_of(made, facing: str = "+z", **options):
    back = facing_rotation(facing)
    return animal_rig(made.character(turn=back.T, **options), back, "a.glb")


def positions(body_joints: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(BODY.joint_names, body_joints, strict=True))


@pytest.mark.parametrize("seed", SHAPES)
def test_legs_of_fewer_bones_are_as_long_as_whole_ones(seed):
    """Within 10 %: how much of a leg of one bone is above the wrist is not known."""
    whole = rig_of(animal(seed))[0]
    for count in (1, 2, 3):
        assert rig_of(animal(seed, bones(count)))[0].leg == pytest.approx(whole.leg, rel=0.1)


def test_the_leg_of_the_body_is_the_mean_of_its_legs():
    indices = tuple(tuple(BODY.joint(name) for name in leg) for leg in QUADRUPED.legs)
    assert rig_of(animal())[0].leg == pytest.approx(leg_length(BODY.joints, indices), rel=0.01)


def test_legs_have_the_joints_from_hip_to_ankle_that_the_animal_has_and_parents_come_first():
    for count in (4, 3):
        assert [len(leg) for leg in rig_of(animal(0, bones(count)))[0].legs] == [3, 3, 3, 3]
    rig = rig_of(animal(0, bones(2)))[0]
    assert all(0 < len(leg) < 3 for leg in rig.legs)
    assert all(set(leg) <= set(rig.joints.values()) for leg in rig.legs)
    assert list(rig.person) == sorted(rig.person, key=rig.body.joint)
    assert rig.person[0] == "Hips"


@pytest.mark.parametrize(
    ("count", "of_front"),
    [(1, {"UpperArm": "Fingers"}), (2, {"Forearm": "Fingers"}), (3, {"Hand": "Fingers"}), (4, {})],
)
def test_last_joints_of_legs_stand_for_what_is_below_them(count, of_front):
    matching = dict(zip(LEGS["front"], LEGS["hind"], strict=True))
    of_leg = of_front | {matching[start]: matching[end] for start, end in of_front.items()}
    expected = {side + start: side + end for side in SIDES for start, end in of_leg.items()}
    assert rig_of(animal(0, bones(count)))[0].whole_limbs == expected


def test_an_upper_leg_without_a_joint_below_stands_for_both():
    kept = [name for name in bones(4) if not name.endswith(("Forearm", "Shin"))]
    made = rig_of(animal(0, bones(4)))[0]
    less = {name: joint for name, joint in made.joints.items() if name in kept or "Spine" in name}
    found = dataclasses.replace(made, joints=less).whole_limbs
    assert found == {
        **{f"{side}UpperArm": f"{side}Hand" for side in SIDES},
        **{f"{side}Thigh": f"{side}Foot" for side in SIDES},
    }


@pytest.mark.parametrize("seed", SHAPES)
def test_feet_with_roots_of_their_own_become_children_of_their_legs(seed):
    made = animal(seed, bones(4), FEET)
    rig, order = rig_of(made)
    character = rig.character
    for side in SIDES:
        for chain in LEGS.values():
            foot, above = (rig.joints[side + part] for part in (chain[-1], chain[-2]))
            assert character.parents[foot] == above
    assert all(parent < j for j, parent in enumerate(character.parents))
    assert [character.joint_names[k] for k in range(len(order))] == [nothing_said(made.order[j]) for j in order]
    hips = rig.joints["Hips"]
    assert all(hips in ancestors(character.parents, joint) for joint in rig.joints.values())
    # It is the same animal.
    np.testing.assert_allclose(np.sort(character.joints, axis=0), np.sort(made.joints, axis=0))
    turned = character.skinned(character.skinning_transforms(np.tile(np.eye(3), (len(order), 1, 1))))
    np.testing.assert_allclose(turned, made.mesh.vertices, atol=1e-9)


@pytest.mark.parametrize("seed", SHAPES)
def test_feet_that_their_legs_carry_more_of_are_children_of_these_too(seed):
    """Else hooves stay where they are while the leg goes."""
    made = animal(seed, bones(4), FEET)
    character = made.character()
    ends = [(side + foot, side + above) for side in SIDES for *_, above, foot in LEGS.values()]
    last = {made.order.index(foot): made.order.index(above) for foot, above in ends}
    mine = np.isin(character.joint_of, list(last))
    above = np.vectorize(lambda joint: last.get(joint, joint))(character.joint_of)
    # A third of the weights of each foot stays on its own joint.
    weights = np.concatenate(
        [np.where(mine, character.weights / 3, character.weights), np.where(mine, 2 * character.weights / 3, 0)], axis=1
    )
    sloppy = dataclasses.replace(
        character,
        joint_of=np.concatenate([character.joint_of, above], axis=1),
        weights=weights,
        points=np.repeat(character.mesh.vertices[:, None], weights.shape[1], axis=1),
    )
    rig, order = animal_rig(sloppy, np.eye(3), "a.glb")
    parents = {order[j]: order[parent] for j, parent in enumerate(rig.character.parents) if parent >= 0}
    assert not {order[joint] for joint in rig.joints.values()} & set(last)
    assert {foot: parents[foot] for foot in last} == last


@pytest.mark.parametrize("facing", [facing for facing in FACING if facing])
def test_frames_and_lengths_do_not_depend_on_where_an_animal_faces(facing):
    straight, turned = rig_of(animal(0))[0], rig_of(animal(0), facing)[0]
    assert turned.joints == straight.joints
    assert turned.leg == pytest.approx(straight.leg)
    for name, frame in straight.frames.items():
        np.testing.assert_allclose(turned.turn @ turned.frames[name], frame, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_body_with_fewer_bones_rests_nearly_as_it_does(count):
    """Where a foot without a joint stands is not known: it is taken to be below the last joint, within 21 degrees."""
    fewer = {name: point for name, point in positions(BODY.joints).items() if name in bones(count)}
    last = {side + chain[count - 1] for side in SIDES for chain in LEGS.values()}
    for name, turn in rest_directions(fewer, 0.0, BODY).items():
        assert np.trace(turn) > 1 + 2 * np.cos(np.radians(22 if name in last else 1e-5)), name


@pytest.mark.parametrize("degrees", [-40, 35])
def test_a_lowered_neck_rests_turned_by_as_much(degrees):
    turn = rotvec_to_rotmat(np.radians([degrees, 0.0, 0.0]))
    joints = BODY.joints.copy()
    neck = BODY.joint("Neck1")
    for j in range(len(joints)):
        if neck in ancestors(BODY.parents, j):
            joints[j] = joints[neck] + turn @ (joints[j] - joints[neck])
    found = rest_directions(positions(joints), 0.0, BODY)
    for name in ("Neck1", "Neck2", "Neck3"):
        np.testing.assert_allclose(found[name], turn, atol=1e-9)
    assert "Head" not in found
    np.testing.assert_allclose(found["LeftThigh"], np.eye(3), atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_rest_directions_take_bones_of_the_body_to_those_of_the_animal(seed):
    """Neck, tail and legs in a random rest pose; bones of other lengths have the same directions."""
    rotmat = np.tile(np.eye(3), (len(BODY.parents), 1, 1))
    for name, turn in random_turns(seed, BODY.joint_names, 25).items():
        rotmat[BODY.joint(name)] = turn
    joints = BODY.skinning_transforms(BODY.joints, rotmat)
    joints = np.einsum("jkl,jl->jk", joints[0], BODY.joints) + joints[1]
    found = rest_directions(positions(3.0 * joints), -0.1, BODY)
    legs = [[side + part for part in chain] for side in SIDES for chain in LEGS.values()]
    chains = [*legs, ["Neck1", "Neck2", "Neck3", "Head"], [f"Tail{k}" for k in range(1, 7)]]
    for start, end in (pair for chain in chains for pair in itertools.pairwise(chain)):
        ours, theirs = (points[BODY.joint(end)] - points[BODY.joint(start)] for points in (BODY.joints, joints))
        turned = found[start] @ (ours / np.linalg.norm(ours))
        np.testing.assert_allclose(turned, theirs / np.linalg.norm(theirs), atol=1e-9, err_msg=start)
