"""The joints of a body model: a recording drives with those of its model, which needs no joints found on a surface."""

from __future__ import annotations

import json

import numpy as np
import pytest
from matrix import matrix
from motion_files import OURS, PARENTS, Z_UP, write_amass
from people import person
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation
from smpl_files import smpl_arrays, write_model

import mimesh
from mimesh.__main__ import run
from mimesh.bodies import load_body
from mimesh.bodies.hands import body_with_fingers
from mimesh.bodies.smpl_model import load_smpl_model
from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh, load_recorded_clip
from mimesh.motions import load_motion, window
from mimesh.motions.motion import joint_tracks
from mimesh.motions.smpl_clip import NAMES, smpl_rig
from mimesh.pipeline.file_rigs import Rigs

START = 4


def model_arrays(joints: int = 24) -> dict[str, np.ndarray]:
    """The arrays of a body model with the joints of the shipped body and its fingers, without pose corrections."""
    arrays, body = smpl_arrays(joints, faces=3000), body_with_fingers()
    vertices = arrays["v_template"]
    places: dict[str | int, np.ndarray] = {name: body.joints[body.joint(ours)] for name, ours in OURS.items()}
    for finger in range(30 if joints > 24 else 0):
        side, rest = divmod(finger, 15)
        name = ("Left", "Right")[side] + "Hand" + ("Index", "Middle", "Pinky", "Ring", "Thumb")[rest // 3]
        places[joints - 30 + finger] = body.joints[body.joint(f"{name}{rest % 3 + 1}")]
    for key, centre in places.items():
        j = key if isinstance(key, int) else list(PARENTS).index(key)
        near = np.argsort(np.linalg.norm(vertices - centre, axis=1))[:200]
        weights, distance = nnls(np.vstack([vertices[near].T, np.full(200, 10.0)]), np.append(centre, 10.0))
        assert distance < 1e-3
        arrays["J_regressor"][j] = 0.0
        arrays["J_regressor"][j, near] = weights
    return arrays | {"posedirs": np.zeros_like(arrays["posedirs"])}


@pytest.fixture(scope="module")
def walk():
    return window(load_motion("walk"), 0.0, 0.5)


@pytest.fixture(scope="module")
def files(walk, tmp_path_factory):
    """A body model, a recording with it in which somebody walks, z up, and the model's mean shape."""
    folder = tmp_path_factory.mktemp("smpl")
    model = write_model(folder / "model.pkl", model_arrays())
    take = write_amass(folder / "take.npz", load_body(), walk, Z_UP, 24, mocap_framerate=30.0, betas=np.zeros(10))
    assert run(["convert", str(model), str(folder / "hero.obj")]) == 0
    return model, take, folder / "hero.obj"


def distance(moved: np.ndarray, true: np.ndarray) -> float:
    """Mean distance of vertices (metres), each frame about its centre, all turned alike as the first one needs."""
    moved, true = (np.asarray(v, np.float64) - np.mean(v, axis=1, keepdims=True) for v in (moved, true))
    turn = Rotation.align_vectors(true[0], moved[0])[0].as_matrix()
    return float(np.linalg.norm(moved @ turn.T - true, axis=-1).mean())


@matrix("joints", [24, 52, 55], quick=[52])
def test_recorded_joints_are_those_of_the_motion(joints, walk, tmp_path):
    body = load_body()
    model = write_model(tmp_path / "model.npz", model_arrays(joints))
    take = write_amass(tmp_path / "take.npz", body, walk, Z_UP, joints, mocap_framerate=30.0, betas=np.zeros(10))
    skeleton = load_recorded_clip(take, model)[0].skeleton
    assert skeleton is not None
    person, (rotation, positions) = skeleton.person(), joint_tracks(body, walk)
    assert set(OURS.values()) <= set(person.joints)
    assert sum("HandIndex" in name for name in person.joints) == (0 if joints == 24 else 6)
    assert (person.up, person.front) == ("+y", "+z")
    from_hips, true_from_hips = person.positions - person.positions[:, :1], positions - positions[:, :1]
    for name in set(OURS.values()):
        k, j = person.joints.index(name), body.joint(name)
        if name != "Head":  # archives have no joint between neck and head, the body has one
            np.testing.assert_allclose(from_hips[:, k], true_from_hips[:, j], atol=0.001)
        turned = Rotation.from_matrix(person.rotation[:, k] @ np.swapaxes(rotation[:, j], -1, -2))
        if joints > 24 or "Hand" not in name:  # hands without fingers are taken as flat, those of the body are relaxed
            assert np.degrees(turned.magnitude()).max() < 0.5, name
    cut = skeleton.cut(slice(START, None)).person()
    np.testing.assert_allclose(cut.positions, person.positions[START:])


@pytest.mark.slow
def test_animate_takes_the_joints_of_the_recording(files, tmp_path, capsys):
    """The error that is left is that of the identity's joints, which are found on its surface."""
    model, take, hero = files
    command = ["animate", str(hero), str(take), "--body-model", str(model), "--start", str(START), "--no-preview"]
    assert run([*command, "--root", "keep", "--no-ground", "-o", str(tmp_path / "out.npz"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])["report"]
    assert report["driving"]["up_from"] == "joints"
    assert "prediction_spread" not in report["driving"]  # nothing was predicted
    clip = load_recorded_clip(take, model)[0]
    assert distance(load_clip(tmp_path / "out.npz").vertices, clip.vertices[START:]) < 0.01


def test_an_identity_with_the_rig_of_its_model_moves_as_the_model_does(files):
    model, take, _ = files
    clip = load_recorded_clip(take, model)[0]
    rig = smpl_rig(load_smpl_model(model))
    moved = mimesh.animate(
        load_mesh(model), clip, motion=mimesh.MotionOptions(root="keep", ground=False), hints=mimesh.Hints(rig=rig)
    )
    assert distance(moved.clip.vertices, clip.vertices) < 1e-4


def test_models_without_known_joints_are_found_on_the_surface(tmp_path, walk):
    """One of another number of joints, and one whose joints are no person's tree: both drive as surfaces."""
    body = load_body()
    other, wrong = smpl_arrays(33, faces=600), smpl_arrays(24, faces=600)
    wrong["kintree_table"][0, 1:] = np.maximum(np.arange(1, 24) - 2, 0)
    assert 33 not in NAMES
    for arrays, notes in ((other, 0), (wrong, 1)):
        model = write_model(tmp_path / "model.npz", arrays)
        take = write_amass(tmp_path / "take.npz", body, walk, Z_UP, 24, betas=np.zeros(10))
        rigs = Rigs.read(person(), load_recorded_clip(take, model)[0])
        assert rigs.driving is None
        assert ["the joints of take are not used" in note for note in rigs.notes] == [True] * notes
    with pytest.raises(InputError, match=r"body model of people \(24, 52, 55 joints\), found 33"):
        smpl_rig(load_smpl_model(write_model(tmp_path / "dog.npz", other)))
