"""What every method must hold: moved, scaled, turned and reordered inputs change nothing but the undone frame."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from networks import write_mime_network, write_network, write_sequence_network
from people import person, walk

from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import ROTATIONS
from mimesh.methods.aniformer import OVERLAP
from mimesh.methods.find import MODELS, find_method
from mimesh.pipeline import animate, transfer

IDENTITY = person(0)
SAME_COUNT = person(1, pose=0)
FEWER, MORE = person(1, pose=1, faces=600), person(2, pose=2, faces=1500)
SLOW = ("skeleton", "deformation-transfer")
"""Seconds a mesh: held to some of the changes only. Its own tests hold `skeleton` to the same by default."""
WINDOW = 3
"""Frames that the network of clips sees at once, and reads before it gives the first."""


SLOWEST = pytest.param("skeleton", marks=pytest.mark.slow)
FAST = ("copy", "per_vertex", "global_max", "truth", "sequence", "mime")


@pytest.fixture(scope="module", params=[*FAST, "deformation-transfer", SLOWEST])
def model(request, tmp_path_factory):
    if request.param in ("copy", *SLOW):
        return request.param
    pytest.importorskip("onnx")
    path = tmp_path_factory.mktemp("networks") / f"{request.param}.onnx"
    if request.param == "mime":
        return str(write_mime_network(path))
    if request.param == "sequence":
        return str(write_sequence_network(path, frames=WINDOW))
    if request.param == "truth":
        return str(write_network(path, target_scale="truth"))
    return str(write_network(path, pose_code=request.param))


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """A driving mesh, and what deformation transfer is given besides: its subject at rest like the identity, marks."""

    driving: Mesh
    reference: Mesh
    markers: np.ndarray

    def changed(self, **change) -> Trial:
        return Trial(changed(self.driving, **change), changed(self.reference, **change), self.markers)

    def given(self, model: str) -> dict:
        return dict(reference=self.reference, markers=self.markers) if model == "deformation-transfer" else {}

    def move(self, model: str, identity: Mesh = IDENTITY, **options) -> np.ndarray:
        return transfer(identity, self.driving, model, **self.given(model), **options).vertices


@functools.cache
def trials(model: str) -> list[Trial]:
    drivings = {(1, 1000): SAME_COUNT, (1, 600): FEWER, (2, 1500): MORE}
    rests = [person(shape, faces=faces) for shape, faces in drivings]
    found = [
        Trial(driving, rest, np.stack([extremes(IDENTITY), extremes(rest)], axis=1))
        for driving, rest in zip(drivings.values(), rests, strict=True)
    ]
    return found[:1] if model == "copy" else found[1:2] if model in SLOW else found


def extremes(rest: Mesh) -> np.ndarray:
    """Vertices at head, hands and feet of somebody in the T-pose."""
    x, y, z = rest.vertices.T
    toes = [np.where(side * x > 0, z - 3 * y, -9).argmax() for side in (1, -1)]
    return np.array([y.argmax(), x.argmax(), x.argmin(), *toes])


@functools.cache
def unchanged(model: str) -> list[np.ndarray]:
    return [trial.move(model) for trial in trials(model)]


def changed(mesh: Mesh, rotation=ROTATIONS[0], scale=1.0, shift=(0.0, 0.0, 0.0)) -> Mesh:
    return dataclasses.replace(mesh, vertices=mesh.vertices @ rotation.T * scale + shift)


CHANGES = [dict(shift=(3.0, -7.0, 0.1)), dict(scale=4.0), dict(scale=0.01), dict(scale=3.7, shift=(100.0, 2.0, -5.0))]
CHANGES += [dict(rotation=rotation) for rotation in ROTATIONS]


def skip_most_if_slow(model, number):
    if model in SLOW and number not in (3, 17):
        pytest.skip("seconds a mesh: two changes stand for all")


def skip_copy(model):
    if model == "copy":
        pytest.skip("copy pairs vertices by index: that is what it is")


def size(mesh: Mesh) -> float:
    return float(np.ptp(mesh.vertices, axis=0).max())


@pytest.mark.parametrize("number", range(len(CHANGES)))
def test_moving_the_identity_moves_the_result_alike(model, number):
    skip_most_if_slow(model, number)
    expected = changed(dataclasses.replace(IDENTITY, vertices=unchanged(model)[0]), **CHANGES[number])
    identity = changed(IDENTITY, **CHANGES[number])
    result = trials(model)[0].move(model, identity)
    assert np.allclose(result, expected.vertices, rtol=0, atol=2e-6 * size(identity))


@pytest.mark.parametrize("number", range(len(CHANGES)))
def test_moving_the_driving_changes_nothing(model, number):
    skip_most_if_slow(model, number)
    for trial, expected in zip(trials(model), unchanged(model), strict=True):
        result = trial.changed(**CHANGES[number]).move(model)
        assert np.allclose(result, expected, rtol=0, atol=2e-6 * size(IDENTITY))


def test_permuting_the_identity_permutes_the_result_and_nothing_else(model):
    skip_copy(model)
    order = np.random.default_rng(3).permutation(len(IDENTITY.vertices))
    for trial, expected in zip(trials(model), unchanged(model), strict=True):
        markers = np.stack([np.argsort(order)[trial.markers[:, 0]], trial.markers[:, 1]], axis=1)
        result = dataclasses.replace(trial, markers=markers).move(model, permute_vertices(IDENTITY, order))
        assert np.array_equal(result, expected[order])


def test_permuting_the_driving_changes_no_bit(model):
    skip_copy(model)
    for trial, expected in zip(trials(model), unchanged(model), strict=True):
        order = np.random.default_rng(4).permutation(len(trial.driving.vertices))
        faces = np.random.default_rng(5).permutation(len(trial.driving.faces))
        driving, reference = (
            dataclasses.replace(mesh, faces=mesh.faces[faces])
            for mesh in (permute_vertices(trial.driving, order), permute_vertices(trial.reference, order))
        )
        markers = np.stack([trial.markers[:, 0], np.argsort(order)[trial.markers[:, 1]]], axis=1)
        assert np.array_equal(Trial(driving, reference, markers).move(model), expected)


def test_permuting_a_driving_clip_changes_no_bit(model):
    skip_copy(model)
    if model in SLOW:
        pytest.skip("their own tests follow clips")
    clip = walk(faces=600)
    order = np.random.default_rng(4).permutation(clip.vertices.shape[1])
    shuffled = Clip(permute_vertices(clip.mesh, order), clip.vertices[:, order], clip.fps)
    expected = animate(IDENTITY, clip, model).clip.vertices
    assert np.array_equal(animate(IDENTITY, shuffled, model).clip.vertices, expected)


def test_the_same_call_twice_gives_the_same_bits(model):
    trial = trials(model)[0]
    first, second = (trial.move(model, ensemble=2, seed=5) for _ in range(2))
    assert np.array_equal(first, second)


def test_arguments_are_left_alone(model):
    trial = trials(model)[0]
    meshes = IDENTITY, trial.driving, trial.reference
    before = [mesh.vertices.copy() for mesh in meshes]
    trial.move(model)
    assert all(np.array_equal(mesh.vertices, old) for mesh, old in zip(meshes, before, strict=True))


def test_frames_are_taken_one_at_a_time(model):
    """Constant memory: the result of a frame is there before the next is asked for, or two windows."""
    asked, trial = [], trials(model)[0]
    ahead = 2 * WINDOW - OVERLAP - 1 if model.endswith("sequence.onnx") else 0

    def frames():
        for t in range(5 + ahead):
            asked.append(t)
            yield trial.driving.vertices

    drive = find_method(model, **trial.given(model)).prepare(IDENTITY, Clip.still(trial.driving))
    for t, vertices in enumerate(drive(frames())):
        assert len(asked) <= t + 1 + ahead
        assert vertices.shape == IDENTITY.vertices.shape


def test_copy_is_among_the_models():
    assert "copy" in MODELS
