"""Animals with rigs of any maker move like each other: other shapes, joints and names, and what is refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from animals import BODY, FEET, Animal, animal, bones, coefficients, random_turns, small, small_clip
from matrix import matrix
from rigs import of_kind

import mimesh
from mimesh.__main__ import run
from mimesh.bodies.animals import animal as shipped_animal
from mimesh.bodies.character_pool import facing_rotation
from mimesh.bodies.characters import proportioned
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.errors import InputError
from mimesh.evaluate.metrics import pmd_aligned
from mimesh.evaluate.pairs import Pair
from mimesh.evaluate.protocols import PROTOCOLS, QUADRUPED
from mimesh.io import load_clip
from mimesh.motions.animal_clips import gait_clip
from mimesh.tools.inspect import inspect_file

pytestmark = pytest.mark.usefixtures("kept")
OTHER = proportioned(
    BODY,
    {f"Neck{k}": 1.3 for k in (1, 2, 3)} | {f"Tail{k}": 1.4 for k in range(1, 7)} | {"Forearm": 1.2, "Shin": 1.2},
    {"Head": 1.2, "Spine2": 1.3},
    size=0.6,
)
"""A smaller animal whose bones have the directions of the shipped quadruped's and other lengths: poses are exact."""
FRAMES = 4
LEG_BONES = [name for name in bones() if name.startswith(("Left", "Right")) and name not in FEET]


def other(kept=None, detached=()) -> Animal:
    return Animal(coefficients(None), bones() if kept is None else tuple(kept), detached, OTHER)


def dance(kept, frames: int = FRAMES) -> list[tuple[dict[str, np.ndarray], np.ndarray]]:
    """Make poses of some joints; the root goes forward."""
    return [(random_turns(t, kept), np.array([0.0, 0.0, 0.05 * t])) for t in range(frames)]


def sideways(vertices: np.ndarray) -> np.ndarray:
    """Move every frame to one place."""
    return vertices - vertices.mean(axis=1, keepdims=True)


def errors(result, identity: Animal, motion, size: float = 1.0) -> np.ndarray:
    """Compute distances of vertices from the identity's shape in the driving's poses, over its height."""
    truth = np.stack([size * identity.posed(turns) for turns, _ in motion])
    height = np.ptp(size * identity.mesh.vertices[:, 1])
    return np.linalg.norm(sideways(result.clip.vertices) - sideways(truth), axis=-1) / height


PAIRS = {
    "small": lambda: (other(), animal()),
    "large": lambda: (animal(), other()),
    "feet of identity": lambda: (other(detached=FEET), animal()),
    "feet of driving": lambda: (animal(), other(detached=FEET)),
    "no trunk": lambda: (other(bones(4, ("Hips", "Head"))), animal()),
    "two bones": lambda: (animal(4, bones(2)), animal(4, bones(2))),
    "one bone": lambda: (other(bones(1)), animal(None, bones(1))),
}


@matrix("pair", PAIRS, quick=["two bones"])
def test_the_result_is_the_identity_in_the_pose_of_the_driving(pair, tmp_path):
    """Measured: up to 3e-7 of the height. The still identity is 0.2 away."""
    identity, driving = PAIRS[pair]()
    motion = dance(set(identity.order) & set(driving.order))
    one = identity.write(tmp_path / "identity.glb")
    two = driving.write(tmp_path / "driving.glb", {"dance": motion}, spell=str)
    result = mimesh.animate(str(one), str(two), motion=mimesh.MotionOptions(ground=False))
    assert result.report["rig"] == "own"
    assert result.notes == ()
    assert errors(result, identity, motion).max() < 1e-5
    still = np.stack([identity.mesh.vertices] * FRAMES) - np.stack([identity.posed(turns) for turns, _ in motion])
    assert np.linalg.norm(still, axis=-1).mean() > 0.05 * np.ptp(identity.mesh.vertices[:, 1])


LEGS = [(3, 0.01, 0.05), (2, 0.06, 0.2), (1, 0.06, 0.2)]


@matrix(("count", "mean", "most"), LEGS, quick=LEGS[1:2])
def test_legs_of_fewer_bones_follow_those_of_more(count, mean, most, tmp_path):
    """Measured: 0.004, 0.034 and 0.038 of the height on average, 0.02, 0.11 and 0.09 at most.

    The ends of legs without joints there are not known.
    """
    identity, driving = animal(0, bones(count)), animal(0)
    motion = dance(identity.order)
    one = identity.write(tmp_path / "identity.glb")
    two = driving.write(tmp_path / "driving.glb", {"dance": motion}, spell=str)
    found = errors(mimesh.animate(str(one), str(two), motion=mimesh.MotionOptions(ground=False)), identity, motion)
    assert found.mean() < mean
    assert found.max() < most


def test_bones_of_legs_and_neck_have_the_directions_of_the_driving(tmp_path):
    """Of other shapes too."""
    identity, driving = animal(0), animal(1)
    motion = dance(driving.order)
    one = identity.write(tmp_path / "identity.glb", spell=str)
    two = driving.write(tmp_path / "driving.glb", {"dance": motion}, spell=str)
    skeleton = mimesh.animate(str(one), str(two), motion=mimesh.MotionOptions(ground=False)).skeleton
    assert skeleton is not None
    places = skeleton.joint_positions()
    ours = {name: places[:, k] for k, name in enumerate(skeleton.names)}
    moves = np.stack([driving.transforms(*frame) for frame in motion])
    theirs = np.einsum("tjkl,jl->tjk", moves[..., :3, :3], driving.joints) + moves[..., :3, 3]
    for start, end in (
        ("LeftUpperArm", "LeftForearm"),
        ("RightForearm", "RightHand"),
        ("LeftThigh", "LeftShin"),
        ("RightShin", "RightFoot"),
        ("LeftFoot", "LeftToes"),
        ("Neck1", "Head"),
    ):
        bone = ours[end] - ours[start]
        wanted = theirs[:, driving.order.index(end)] - theirs[:, driving.order.index(start)]
        cosine = (bone * wanted).sum(-1) / np.linalg.norm(bone, axis=-1) / np.linalg.norm(wanted, axis=-1)
        assert cosine.min() > np.cos(np.radians(0.1)), (start, end)


def test_legs_and_tail_turn_from_how_they_are_at_rest(tmp_path):
    """Bones of the driving lie bent in straight legs, and its tail is raised: its rest is no pose of the identity."""
    identity, driving = other(), animal()
    joints = driving.joints.copy()
    for name in ("LeftForearm", "RightForearm", "LeftShin", "RightShin"):
        joints[driving.order.index(name)] += [0, 0, 0.06 if name.endswith("Forearm") else -0.06]
    for name, height in (("Tail3", 0.1), ("Tail5", 0.2)):
        joints[driving.order.index(name)] += [0, height, 0]
    driving.__dict__["joints"] = joints
    swing = rotvec_to_rotmat(np.array([0.4, 0.0, 0.0]))
    motion = [({}, np.zeros(3)), ({"LeftThigh": swing, "RightUpperArm": swing, "Tail1": swing}, np.zeros(3))]
    one = identity.write(tmp_path / "identity.glb", spell=str)
    two = driving.write(tmp_path / "driving.glb", {"walk": motion}, spell=str)
    assert (
        errors(mimesh.animate(str(one), str(two), motion=mimesh.MotionOptions(ground=False)), identity, motion).max()
        < 1e-5
    )


@pytest.mark.slow
def test_other_sizes_orders_of_vertices_and_axes_give_the_same_result(tmp_path):
    from scipy.spatial.transform import Rotation

    identity, driving = other(), animal(1)
    motion = dance(identity.order)
    order = np.random.default_rng(0).permutation(len(identity.weights))
    turn = Rotation.from_euler("y", -90, degrees=True).as_matrix()
    files = {
        "plain": identity.write(tmp_path / "plain.glb"),
        "permuted": identity.write(tmp_path / "permuted.glb", permutation=order),
        "large": identity.write(tmp_path / "large.glb", size=40.0),
        "turned": identity.write(tmp_path / "turned.glb", turn=turn),
    }
    two = driving.write(tmp_path / "driving.glb", {"dance": motion}, spell=str)
    found = {name: sideways(mimesh.animate(str(path), str(two)).clip.vertices) for name, path in files.items()}
    np.testing.assert_allclose(found["permuted"], found["plain"][:, order], atol=1e-5)
    np.testing.assert_allclose(found["large"] / 40, found["plain"], atol=1e-5)
    np.testing.assert_allclose(found["turned"], found["plain"] @ turn.T, atol=1e-5)


def test_feet_of_the_result_stay_on_the_ground_where_the_driving_stands(tmp_path):
    """Poses of the spine alone would lift or sink them."""
    identity, driving = other(), animal()
    motion = [(random_turns(t, ("Neck1", "Head", "Tail1")), np.zeros(3)) for t in range(FRAMES)]
    one = identity.write(tmp_path / "identity.glb")
    two = driving.write(tmp_path / "driving.glb", {"look": motion}, spell=str)
    result = mimesh.animate(str(one), str(two))
    size = np.ptp(identity.mesh.vertices[:, 1])
    assert errors(result, identity, motion).max() < 0.01
    lowest = result.clip.vertices[..., 1].min(axis=1)
    np.testing.assert_allclose(lowest, identity.mesh.vertices[:, 1].min(), atol=0.005 * size)
    assert result.report["foot_skate"] is not None
    assert result.report["foot_skate"] < 0.01


def test_the_written_file_has_the_identitys_bones_and_the_motion(tmp_path, capsys):
    identity, driving = other(), animal()
    motion = dance(identity.order)
    one = identity.write(tmp_path / "identity.glb")
    two = driving.write(tmp_path / "driving.glb", {"dance": motion}, spell=str)
    out = tmp_path / "out.glb"
    assert run(["animate", str(one), str(two), "-o", str(out), "--no-ground", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"]["rig"] == "own"
    written = load_clip(out)
    truth = np.stack([identity.posed(turns) for turns, _ in motion])
    error = np.linalg.norm(sideways(written.vertices[:FRAMES]) - sideways(truth), axis=-1)
    assert error.max() < 2e-3 * np.ptp(identity.mesh.vertices[:, 1])
    names = {node.get("name") for node in gltf_of(out)["nodes"]}
    assert {f"Bone.{7 * BODY.joint(name) % len(BODY.joint_names):03d}" for name in identity.order} <= names


def gltf_of(path: Path) -> dict:
    from mimesh.io.gltf.document import open_document

    return open_document(path).gltf


@pytest.mark.parametrize("facing", ["-x"])
def test_look_says_that_a_rig_is_of_an_animal_and_where_it_faces(facing, tmp_path, capsys):
    path = other().write(tmp_path / "cow.glb", turn=facing_rotation(facing).T)
    assert run(["look", str(path)]) == 0
    out = capsys.readouterr().out
    assert f"up +y, front {facing}, a four-legged animal by its rig" in out
    assert "taken for a person" not in out


def test_files_with_one_skeleton_are_copied(tmp_path):
    """As those of people are."""
    made = animal(0)
    motion = dance(made.order)
    one = made.write(tmp_path / "identity.glb")
    two = made.write(tmp_path / "driving.glb", {"dance": motion})
    result = mimesh.animate(str(one), str(two))
    assert result.report["copied"]
    assert errors(result, made, motion).max() < 1e-3


def test_a_person_and_an_animal_are_refused_with_both_names(tmp_path):
    cow = animal(0).write(tmp_path / "cow.glb", {"dance": dance(bones())})
    man = of_kind(tmp_path / "man.glb", "T-pose")[0]
    for identity, driving, kinds in (
        (cow, man, "cow is taken for a four-legged animal, and man for a person"),
        (man, cow, "man is taken for a person, and cow for a four-legged animal"),
    ):
        with pytest.raises(InputError, match=kinds) as raised:
            mimesh.animate(str(identity), str(driving))
        assert "body" in str(raised.value)
        assert "--" not in str(raised.value)


@pytest.mark.slow
def test_animals_taken_for_people_have_no_rig_of_a_person(tmp_path):
    one = animal(0).write(tmp_path / "cow.glb")
    two = animal(1).write(tmp_path / "goat.glb", {"dance": dance(bones())}, spell=str)
    result = mimesh.animate(str(one), str(two), hints=mimesh.Hints(body="human"))
    assert "rig" not in result.report
    assert any("the rig of cow is not used" in note for note in result.notes)
    assert any("the joints of goat are not used" in note for note in result.notes)
    chosen = mimesh.animate(str(one), str(two), hints=mimesh.Hints(body="quadruped"))
    assert chosen.report["rig"] == "own"


def test_wrong_bodies_are_refused(tmp_path, capsys):
    pytest.importorskip("onnx")
    from networks import write_mime_network

    own = write_mime_network(tmp_path / "own.onnx")
    one = animal(0).write(tmp_path / "cow.glb")
    two = animal(1).write(tmp_path / "goat.glb", {"dance": dance(bones())}, spell=str)
    assert run(["animate", str(one), str(two), "--body", "octopus"]) == 2
    assert "--body: expected one of auto, human, quadruped, other, found 'octopus'" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"^body: expected human with the model own, found quadruped"):
        mimesh.animate(str(one), str(two), str(own), hints=mimesh.Hints(body="quadruped"))


# Without rigs: the body is chosen by the shape, and joints are predicted.


def surfaces(i: int) -> Pair:
    return QUADRUPED.pair("val", "gaits", i)


@pytest.mark.slow
def test_animals_without_rigs_are_taken_for_animals_and_moved():
    """Nearer to the truth than the identity as it is, in the driving's pose and not on its head."""
    pair = surfaces(0)
    result = mimesh.transfer(pair.identity, pair.driving, hints=mimesh.Hints(up="+y", driving_up="+y"))
    assert pmd_aligned(result.mesh.vertices, pair.truth) < 0.5 * pmd_aligned(pair.identity.vertices, pair.truth)


@pytest.mark.slow
def test_animals_without_axes_are_found_upright():
    pair = surfaces(0)
    lying = dataclasses.replace(pair.identity, vertices=pair.identity.vertices[:, [0, 2, 1]] * [1, -1, 1], up=None)
    result = mimesh.transfer(lying, pair.driving, hints=mimesh.Hints(driving_up="+y"))
    assert result.report["identity"]["up"] == "+z"


@pytest.mark.slow
def test_a_person_and_an_animal_without_rigs_are_refused():
    person = PROTOCOLS["human-npt"].pair("val", "seen", 0).identity
    with pytest.raises(InputError, match=r"taken for a person.*four-legged animal"):
        mimesh.transfer(person, surfaces(0).driving, hints=mimesh.Hints(up="+y", driving_up="+y"))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".bvh", ".glb"])
def test_joints_of_an_animal_alone_move_another_animal(tmp_path, suffix):
    walk = dance(LEG_BONES)
    driving = animal().write(tmp_path / "cat.glb", {"walk": walk})
    joints = mimesh.capture(driving).save(tmp_path / f"walk{suffix}")
    result = mimesh.animate(other().write(tmp_path / "cow.glb"), joints)
    assert result.report["body"] == "quadruped"
    assert not any("people" in note for note in result.notes)
    assert errors(result, other(), walk).max() < 0.02
    assert "of a four-legged animal" in dict(inspect_file(joints).details)["motion"]


@pytest.mark.slow
def test_the_facing_of_an_animal_without_a_rig_is_noted_only_where_up_is_not_known():
    driving, cat = small_clip(gait_clip("dog", "walk", seconds=0.2, fps=10.0)), small(shipped_animal("cat"))
    known = mimesh.animate(dataclasses.replace(cat, up="+y"), driving, hints=mimesh.Hints(driving_up="+y"))
    assert known.report["body"] == "quadruped"
    assert not any("facing" in note or "looks like" in note for note in known.notes)
    assert (known.report["identity"]["up"], known.report["identity"]["front"]) == ("+y", "+z")
    bare = dataclasses.replace(cat, up=None)
    found = mimesh.animate(bare, driving, hints=mimesh.Hints(body="quadruped", driving_up="+y"))
    assert any("the facing of cat is uncertain" in note for note in found.notes)
