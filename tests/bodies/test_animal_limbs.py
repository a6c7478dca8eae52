"""Joints of animals are found by where they are and what they move, whatever they are called."""

import dataclasses

import numpy as np
import pytest
from animals import BODY, FEET, LEGS, animal, bones
from creatures import SPIDER, Boxes
from matrix import matrix
from people import rigged
from rigs import figure

from mimesh.bodies.animal_limbs import name_animal_joints
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.character_pool import FACING, facing_rotation
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.motions.animal_rig import animal_facing

SHAPES = (None, 0, 1, 2)
OF_TRUNK = {"Spine1", "Spine2", "Spine3", "Spine4", "Chest"}


def found_in(made, **options) -> dict[str, str]:
    """Find joints: the name that each got -> the joint of the body that it is."""
    named = name_animal_joints(made.character(**options), "a.glb")
    return {name: made.order[joint] for name, joint in named.items()}


def person() -> SkinnedCharacter:
    """Make a person in a T-pose."""
    made = figure(0)
    return rigged(Mesh(made.vertices, np.array([[0, 1, 2]])), made.names, made.parents, made.joints, made.weights)


def with_a_leg_cut_off() -> SkinnedCharacter:
    """Make an animal whose left foreleg has no surface."""
    made = animal(0)
    rig = made.character()
    legs = [j for j, name in enumerate(made.order) if name.startswith("Left") and name[4:] in LEGS["front"]]
    keep = np.flatnonzero((rig.weights * np.isin(rig.joint_of, legs)).sum(axis=1) <= 0.1)
    rank = np.full(len(rig.weights), -1)
    rank[keep] = np.arange(len(keep))
    faces = rank[rig.mesh.faces]
    mesh = Mesh(rig.mesh.vertices[keep], faces[(faces >= 0).all(axis=1)])
    rows = {name: getattr(rig, name)[keep] for name in ("joint_of", "weights", "points")}
    return dataclasses.replace(rig, mesh=mesh, **rows)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@matrix("seed", SHAPES, quick=[1])
def test_legs_neck_head_and_tail_are_found_without_names(count, seed):
    made = animal(seed, bones(count))
    found = found_in(made)
    assert {name: joint for name, joint in found.items() if name not in OF_TRUNK} == {
        name: name for name in made.order if name not in OF_TRUNK
    }
    # Joints of the trunk are numbered by their places.
    trunk = [found[name] for name in BODY.joint_names if name in OF_TRUNK and name in found]
    assert trunk == ["Spine2", "Chest"]


@matrix("seed", SHAPES, quick=[2])
def test_feet_with_roots_of_their_own_belong_to_the_nearest_leg(seed):
    found = found_in(animal(seed, bones(4), FEET))
    assert all(found[side + part] == side + part for side in SIDES for chain in LEGS.values() for part in chain)


@pytest.mark.parametrize("seed", [None, 0, 2])  # in shape 1 they are so near to the upper arms that they are left out
@pytest.mark.parametrize(("count", "spell"), [(4, None), (2, str)])
def test_shoulder_blades_are_not_upper_arms(seed, count, spell):
    """They are told by one joint too many in the leg, or by their names."""
    made = animal(seed, {*bones(count), "LeftScapula", "RightScapula"})
    found = found_in(made, **({} if spell is None else {"spell": spell}))
    for side in SIDES:
        assert found[side + "Scapula"] == side + "Scapula"
        assert found[side + "UpperArm"] == side + "UpperArm"


@pytest.mark.parametrize("trunk", [("Hips", "Head"), ("Hips", "Chest", "Head"), ("Hips", "Chest", "Neck1", "Head")])
def test_animals_without_a_tail_have_none(trunk):
    found = found_in(animal(0, bones(3, trunk)))
    assert found["Head"] == "Head"
    assert not any(name.startswith("Tail") for name in found)
    assert ("Neck1" in found) == ("Neck1" in trunk)


def test_names_of_heads_and_tails_are_believed():
    """A jaw is farther in front than the rest of the head, and a tail of one joint is not found without its name."""
    made = animal(0, bones(3, ("Hips", "Chest", "Head", "Jaw", "Tail1")))
    assert found_in(made, spell=str)["Head"] == "Head"
    assert found_in(made, spell=str)["Tail1"] == "Tail1"
    assert "Tail1" not in found_in(made)


@pytest.mark.parametrize("facing", [facing for facing in FACING if facing])
@matrix("seed", SHAPES, quick=[0])
def test_animals_face_where_their_head_is(facing, seed):
    turned = animal(seed, bones(2)).character(turn=facing_rotation(facing).T)
    assert animal_facing(turned, "a.glb") == facing


def test_size_place_and_order_of_vertices_do_not_matter():
    made = animal(1)
    rig = made.character()
    expected = name_animal_joints(rig, "a.glb")
    order = np.random.default_rng(0).permutation(len(rig.weights))
    assert name_animal_joints(rig.permuted(order), "a.glb") == expected
    moved = np.array([5.0, -2.0, 9.0])
    frames = rig.T_world_joint.copy()
    frames[:, :3, 3] = 30 * rig.joints + moved
    mesh = Mesh(30 * rig.mesh.vertices + moved, rig.mesh.faces)
    other = dataclasses.replace(rig, mesh=mesh, T_world_joint=frames, points=30 * rig.points + moved)
    assert name_animal_joints(other, "a.glb") == expected


THREE_LEGS = [name for name in bones(3) if not (name.startswith("Left") and name[4:] in LEGS["front"])]
OTHERS = {
    "a person": (person, r"a\.glb: expected .*(feet|legs|person)"),
    "a spider": (lambda: Boxes.of(SPIDER).character, "expected four legs, found .* of the feet on other joints"),
    "three rigged legs": (lambda: animal(0, THREE_LEGS).character(), "expected a joint in each of four feet"),
    "three legs": (with_a_leg_cut_off, "expected four feet on the ground, found none left front"),
    "several skeletons": (
        lambda: animal(0, bones(3), detached=("LeftThigh",)).character(),
        "expected legs that hang on one joint",
    ),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_what_is_no_animal_on_four_rigged_legs_is_refused(kind):
    make, message = OTHERS[kind]
    with pytest.raises(InputError, match=message):
        name_animal_joints(make(), "a.glb")


@pytest.mark.parametrize("facing", [facing for facing in FACING if facing])
def test_a_named_tail_is_behind_however_large_it_is(facing):
    """Pets of blocks have a long tail of a joint of its own, and their head is that of the trunk."""
    made = animal(0, bones(1, ("Hips", "Tail1")))
    turned = made.character(spell=lambda name: "tail" if name == "Tail1" else "Bone", turn=facing_rotation(facing).T)
    assert animal_facing(turned, "a.glb") == facing
    assert "Head" not in name_animal_joints(turned.turned(facing_rotation(facing)), "a.glb")
    assert "Head" not in name_animal_joints(turned.turned(facing_rotation(facing) @ facing_rotation("-z")), "a.glb")


@pytest.mark.parametrize("facing", [facing for facing in FACING if facing])
def test_names_of_legs_say_where_an_animal_without_a_head_faces(facing):
    """Without names, the first of two opposite fronts is taken."""
    front = tuple(part for part in LEGS["front"])
    made = animal(0, bones(1, ("Hips",)))
    spelled = made.character(
        spell=lambda name: "leg-front" if name.endswith(front) else "leg-back", turn=facing_rotation(facing).T
    )
    assert animal_facing(spelled, "a.glb") == facing
