"""What every method must hold: moved, scaled, turned and reordered inputs change nothing but the undone frame."""

import dataclasses

import numpy as np
import pytest
from networks import write_network
from people import person, walk

from mimesh.frame import ROTATIONS
from mimesh.mesh import Clip, Mesh, permute_vertices
from mimesh.methods import MODELS, find_method
from mimesh.pipeline import animate, transfer

IDENTITY = person(0)
SAME_COUNT = person(1, pose=0)
FEWER, MORE = person(1, pose=1, faces=600), person(2, pose=2, faces=1500)


@pytest.fixture(scope="module", params=["copy", "per_vertex", "global_max", "truth"])
def model(request, tmp_path_factory):
    if request.param == "copy":
        return "copy"
    pytest.importorskip("onnx")
    path = tmp_path_factory.mktemp("networks") / f"{request.param}.onnx"
    if request.param == "truth":
        return str(write_network(path, target_scale="truth"))
    return str(write_network(path, pose_code=request.param))


def drivings(model):
    return [SAME_COUNT] if model == "copy" else [SAME_COUNT, FEWER, MORE]


def changed(mesh: Mesh, rotation=ROTATIONS[0], scale=1.0, shift=(0.0, 0.0, 0.0)) -> Mesh:
    return dataclasses.replace(mesh, vertices=mesh.vertices @ rotation.T * scale + shift)


CHANGES = [dict(shift=(3.0, -7.0, 0.1)), dict(scale=4.0), dict(scale=0.01), dict(scale=3.7, shift=(100.0, 2.0, -5.0))]
CHANGES += [dict(rotation=rotation) for rotation in ROTATIONS]


def size(mesh: Mesh) -> float:
    return float(np.ptp(mesh.vertices, axis=0).max())


@pytest.mark.parametrize("change", CHANGES, ids=range(len(CHANGES)))
def test_moving_the_identity_moves_the_result_alike(model, change):
    expected = changed(transfer(IDENTITY, SAME_COUNT, model).mesh, **change)
    identity = changed(IDENTITY, **change)
    result = transfer(identity, SAME_COUNT, model)
    assert np.allclose(result.vertices, expected.vertices, rtol=0, atol=2e-6 * size(identity))


@pytest.mark.parametrize("change", CHANGES, ids=range(len(CHANGES)))
def test_moving_the_driving_changes_nothing(model, change):
    for driving in drivings(model):
        expected = transfer(IDENTITY, driving, model).vertices
        result = transfer(IDENTITY, changed(driving, **change), model)
        assert np.allclose(result.vertices, expected, rtol=0, atol=2e-6 * size(IDENTITY))


def test_permuting_the_identity_permutes_the_result_and_nothing_else(model):
    if model == "copy":
        pytest.skip("copy pairs vertices by index: that is what it is")
    order = np.random.default_rng(3).permutation(len(IDENTITY.vertices))
    for driving in drivings(model):
        expected = transfer(IDENTITY, driving, model).vertices[order]
        assert np.array_equal(transfer(permute_vertices(IDENTITY, order), driving, model).vertices, expected)


def test_permuting_the_driving_changes_no_bit(model):
    if model == "copy":
        pytest.skip("copy pairs vertices by index: that is what it is")
    for driving in drivings(model):
        order = np.random.default_rng(4).permutation(len(driving.vertices))
        faces = np.random.default_rng(5).permutation(len(driving.faces))
        shuffled = permute_vertices(driving, order)
        shuffled = dataclasses.replace(shuffled, faces=shuffled.faces[faces])
        assert np.array_equal(transfer(IDENTITY, shuffled, model).vertices, transfer(IDENTITY, driving, model).vertices)


def test_permuting_a_driving_clip_changes_no_bit(model):
    if model == "copy":
        pytest.skip("copy pairs vertices by index: that is what it is")
    clip = walk(faces=600)
    order = np.random.default_rng(4).permutation(clip.vertices.shape[1])
    shuffled = Clip(permute_vertices(clip.mesh, order), clip.vertices[:, order], clip.fps)
    expected = animate(IDENTITY, clip, model).clip.vertices
    assert np.array_equal(animate(IDENTITY, shuffled, model).clip.vertices, expected)


def test_the_same_call_twice_gives_the_same_bits(model):
    first, second = (transfer(IDENTITY, SAME_COUNT, model, ensemble=2, seed=5).vertices for _ in range(2))
    assert np.array_equal(first, second)


def test_arguments_are_left_alone(model):
    before = [IDENTITY.vertices.copy(), SAME_COUNT.vertices.copy()]
    transfer(IDENTITY, SAME_COUNT, model)
    assert np.array_equal(before[0], IDENTITY.vertices)
    assert np.array_equal(before[1], SAME_COUNT.vertices)


def test_frames_are_taken_one_at_a_time(model):
    """Constant memory: the result of a frame is there before the next frame is asked for."""
    asked = []

    def frames():
        for t in range(3):
            asked.append(t)
            yield SAME_COUNT.vertices

    drive = find_method(model, ensemble=1, seed=0).prepare(IDENTITY, SAME_COUNT)
    for t, vertices in enumerate(drive(frames())):
        assert asked == list(range(t + 1))
        assert vertices.shape == IDENTITY.vertices.shape


def test_copy_is_among_the_models():
    assert "copy" in MODELS
