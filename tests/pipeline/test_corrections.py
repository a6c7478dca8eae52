"""Corrected joints: what is returned is at the correction, in the file's axes and unit, of identity and driving."""

import dataclasses

import numpy as np
import pytest
from animals import small, small_clip
from grouped_options import grouped
from people import decimation

from mimesh import InputError, animate, save_mesh, transfer
from mimesh.__main__ import run
from mimesh.bodies import load_body
from mimesh.bodies.animals import animal
from mimesh.bodies.sampling import sample_pose
from mimesh.core.joint_corrections import JointCorrections
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.options import Hints, MotionOptions
from mimesh.evaluate.measure import AXES
from mimesh.io.joint_file import load_corrections, save_corrections
from mimesh.motions.animal_clips import gait_clip
from mimesh.pipeline.known import Corrections

pytestmark = pytest.mark.usefixtures("kept")
BODY = load_body()
REMAINING, FACES = decimation(2500)
PERSON = Mesh(BODY.vertices[REMAINING], FACES, "person")


def posed(seed):
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_rotvec(sample_pose(BODY, seed, 0)).as_matrix()
    return dataclasses.replace(
        PERSON, vertices=BODY.posed(np.zeros(len(BODY.components)), rotations)[REMAINING], name="pose"
    )


@pytest.fixture(scope="module")
def plain():
    return transfer(PERSON, posed(0), **grouped(AXES))


def test_results_have_the_joints_of_both_meshes(plain):
    assert tuple(plain.joints) == tuple(plain.driving_joints) == BODY.joint_names
    found = np.array([plain.joints[name] for name in BODY.joint_names])
    assert np.linalg.norm(found - BODY.joints, axis=1).mean() < 0.01
    assert transfer(PERSON, posed(0), "copy", **grouped(AXES)).joints is None


@pytest.mark.slow
def test_corrected_joints_are_where_they_were_put(plain):
    knee, elbow = plain.joints["LeftLeg"] + [0.04, 0, 0.02], plain.driving_joints["RightForeArm"] + [0, 0.03, 0]
    result = transfer(
        PERSON, posed(0), **grouped(AXES, joints={"LeftLeg": knee}, driving_joints={"RightForeArm": list(elbow)})
    )
    np.testing.assert_allclose(result.joints["LeftLeg"], knee, atol=1e-9)
    np.testing.assert_allclose(result.driving_joints["RightForeArm"], elbow, atol=1e-6)
    for name in ("Head", "RightFoot", "LeftHand"):
        assert np.linalg.norm(result.joints[name] - plain.joints[name]) < 0.01
    assert 0 < np.abs(result.vertices - plain.vertices).max() < 0.2


@pytest.mark.slow
def test_corrections_are_in_the_axes_and_unit_of_the_file(plain):
    turn = np.array([[0.0, 0, 100], [100, 0, 0], [0, 100, 0]])  # z up, facing x, in centimetres
    shift = np.array([5.0, 300, -20])
    knee = plain.joints["LeftLeg"] + [0.04, 0, 0.02]
    turned = dataclasses.replace(PERSON, vertices=PERSON.vertices @ turn.T + shift)
    expected = transfer(PERSON, posed(0), **grouped(AXES, joints={"LeftLeg": knee}))
    axes = dataclasses.replace(AXES, up="+z", front="+x")
    result = transfer(turned, posed(0), **grouped(axes, joints={"LeftLeg": turn @ knee + shift}))
    np.testing.assert_allclose(result.joints["LeftLeg"], turn @ knee + shift, atol=1e-6)
    np.testing.assert_allclose((result.vertices - shift) @ turn / 1e4, expected.vertices, atol=2e-3)


@pytest.mark.slow
def test_truly_wrong_legs_are_mended():
    """The knees of a prediction are swapped by swapping the corrections; true ones bring the result back."""
    plain = transfer(PERSON, posed(1), **grouped(AXES))
    swapped = {f"{a}{part}": plain.joints[f"{b}{part}"] for part in ("Leg", "Foot") for a, b in
               (("Left", "Right"), ("Right", "Left"))}  # fmt: skip
    wrong = transfer(PERSON, posed(1), **grouped(AXES, joints=swapped))
    right = transfer(PERSON, posed(1), **grouped(AXES, joints={name: plain.joints[name] for name in swapped}))
    errors = [np.linalg.norm(result.vertices - plain.vertices, axis=1).mean() for result in (wrong, right)]
    assert errors[1] < 0.004 < 0.01 < errors[0]


@pytest.mark.slow
def test_a_file_names_the_frame_of_the_whole_clip(tmp_path):
    frames = np.stack([posed(seed).vertices for seed in range(3)])
    clip = Clip(dataclasses.replace(PERSON, vertices=frames[0], name="clip"), frames, 30.0)
    last = transfer(PERSON, dataclasses.replace(PERSON, vertices=frames[2]), **grouped(AXES))
    elbow = last.driving_joints["LeftForeArm"]
    path = save_corrections(
        JointCorrections({"LeftForeArm": elbow}, 2, "clip.npz", len(PERSON.vertices)), tmp_path / "clip.joints.json"
    )
    plain = animate(PERSON, clip, **grouped(AXES, stop=2))
    result = animate(PERSON, clip, **grouped(AXES, stop=2, driving_joints=path))
    assert len(result.clip) == 2
    moved = result.clip.vertices - plain.clip.vertices
    assert np.linalg.norm(moved - moved.mean(axis=1, keepdims=True), axis=-1).mean() < 0.03, "but for the place"
    with pytest.raises(InputError, match="has 3 counted from 0, found 3"):
        animate(PERSON, clip, **grouped(AXES, driving_joints=JointCorrections({"Head": elbow}, 3)))


@pytest.mark.slow
def test_found_joints_are_not_smoothed():
    """They are edited and given back, so they lie in the frame and not beside it."""
    clip = Clip(PERSON, np.stack([posed(seed).vertices for seed in range(3)]), 30.0)
    plain, smooth = (animate(PERSON, clip, motion=MotionOptions(smooth=s)).driving_joints for s in (0.0, 0.3))
    np.testing.assert_array_equal(list(plain.values()), list(smooth.values()))


@pytest.mark.slow
def test_no_corrections_change_nothing(plain):
    for joints in (None, {}):
        again = transfer(PERSON, posed(0), **grouped(AXES, joints=joints, driving_joints=joints))
        np.testing.assert_array_equal(again.vertices, plain.vertices)


@pytest.mark.parametrize(
    ("model", "message"), [("copy", "^joints: expected a model with joints"), ("npt", "choose another with model=...")]
)
def test_models_without_joints_refuse_corrections(model, message):
    with pytest.raises(InputError, match=message):
        transfer(PERSON, posed(0), model, **grouped(AXES, joints={"Head": (0, 1.6, 0)}))


def test_unknown_joints_are_refused():
    with pytest.raises(InputError, match="did you mean LeftLeg"):
        transfer(PERSON, posed(0), **grouped(AXES, driving_joints={"LeftLegs": (0, 1.6, 0)}))


@pytest.fixture(scope="module")
def animals():
    """A cat, a walking dog's first frame, and the plain result."""
    dog = small_clip(gait_clip("dog", "walk", seconds=0.1, fps=10.0))
    cat = dataclasses.replace(small(animal("cat")), up="+y")
    dog = dataclasses.replace(dog.mesh, vertices=np.asarray(dog.vertices[0], np.float64), up="+y")
    return cat, dog, transfer(cat, dog, hints=Hints(front="+z", driving_front="+z"))


@pytest.mark.slow
def test_joints_of_animals_are_corrected_too(animals):
    cat, dog, plain = animals
    assert tuple(plain.joints) == tuple(plain.driving_joints) == load_body("quadruped").joint_names
    hock, elbow = plain.joints["LeftFoot"] + [0.01, 0, 0.01], plain.driving_joints["RightForearm"] + [0, 0.02, 0]
    joints = {"joints": {"LeftFoot": hock}, "driving_joints": {"RightForearm": elbow}}
    result = transfer(cat, dog, **grouped(front="+z", driving_front="+z", **joints))
    assert result.report["body"] == "quadruped"
    np.testing.assert_allclose(result.joints["LeftFoot"], hock, atol=1e-9)
    np.testing.assert_allclose(result.driving_joints["RightForearm"], elbow, atol=1e-6)
    for name in ("Head", "RightFoot", "LeftHand"):
        assert np.linalg.norm(result.joints[name] - plain.joints[name]) < 0.01
    assert 0 < np.abs(result.vertices - plain.vertices).max() < 0.1


@pytest.mark.slow
def test_truly_wrong_legs_of_an_animal_are_mended(animals):
    """The hind legs of a prediction are swapped by swapping the corrections; true ones bring the result back."""
    cat, dog, plain = animals
    axes = {"front": "+z", "driving_front": "+z"}
    swapped = {f"{a}{part}": plain.joints[f"{b}{part}"] for part in ("Shin", "Foot", "Toes") for a, b in
               (("Left", "Right"), ("Right", "Left"))}  # fmt: skip
    wrong = transfer(cat, dog, **grouped(**axes, joints=swapped))
    right = transfer(cat, dog, **grouped(**axes, joints={name: plain.joints[name] for name in swapped}))
    height = np.ptp(cat.vertices[:, 1])
    errors = [np.linalg.norm(result.vertices - plain.vertices, axis=1).mean() / height for result in (wrong, right)]
    assert errors[1] < 0.01 < 0.02 < errors[0]


def test_names_of_corrected_joints_say_what_both_meshes_are():
    at = np.zeros(3)
    assert Corrections(JointCorrections({"LeftThigh": at})).body == "quadruped"
    assert Corrections(None, JointCorrections({"LeftUpLeg": at, "Head": at})).body == "human"
    assert Corrections(JointCorrections({"Head": at, "LeftFoot": at})).body is None
    assert Corrections(JointCorrections({"LeftThigh": at, "LeftUpLeg": at})).body is None


def test_joints_of_an_animal_are_refused_for_people_and_for_other_creatures():
    joints = {"LeftThigh": (0, 0.9, 0)}
    with pytest.raises(InputError, match="expected names of joints, found 'LeftThigh'"):
        transfer(PERSON, posed(0), **grouped(AXES, body="human", joints=joints))
    with pytest.raises(InputError, match=r'^joints: expected people or four-legged animals, found body="other"'):
        transfer(PERSON, posed(0), **grouped(AXES, body="other", joints=joints))


@pytest.mark.slow
def test_the_command_line_writes_and_reads_joints_of_animals(animals, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cat, dog, plain = animals
    save_mesh(cat, "cat.glb")
    save_mesh(dog, "dog.glb")
    command = ["transfer", "cat.glb", "dog.glb", "--no-preview", "-o", "out.glb"]
    assert run([*command, "--save-joints", "cat.joints.json", "--save-driving-joints", "dog.json"]) == 0
    written = load_corrections("cat.joints.json")
    assert tuple(written.positions) == tuple(load_corrections("dog.json").positions) == tuple(plain.joints)
    paw = written.positions["LeftToes"] + [0.01, 0.0, 0.02]
    save_corrections(JointCorrections({"LeftToes": paw}), "cat.joints.json")
    assert run([*command, "--save-joints", "again.json"]) == 0
    np.testing.assert_allclose(load_corrections("again.json").positions["LeftToes"], paw, atol=1e-5)
