"""Properties of every method: moving, scaling, turning and reordering inputs changes results only accordingly."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from matrix import matrix
from networks import write_mime_network, write_network, write_sequence_network
from people import person, walk

from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import ORIENTATIONS, ROTATIONS
from mimesh.methods.aniformer import OVERLAP
from mimesh.methods.find import find_method
from mimesh.pipeline import animate, transfer

IDENTITY = person(0)
SAME_COUNT = person(1, pose=0)
FEWER, MORE = person(1, pose=1, faces=600), person(2, pose=2, faces=1500)
SLOW = ("skeleton", "deformation-transfer")
"""Methods that take seconds a mesh."""
WINDOW = 3
"""Frames in a window of the sequence network, which it reads before it yields the first result."""


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
    """A driving mesh, with a reference (its subject at rest, as the identity) and markers for deformation transfer."""

    driving: Mesh
    reference: Mesh
    markers: np.ndarray

    def changed(self, **change) -> Trial:
        return Trial(changed(self.driving, **change), changed(self.reference, **change), self.markers)

    def options(self, model: str) -> dict:
        return dict(reference=self.reference, markers=self.markers) if model == "deformation-transfer" else {}

    def move(self, model: str, identity: Mesh = IDENTITY, **options) -> np.ndarray:
        return transfer(identity, self.driving, model, **self.options(model), **options).vertices


@functools.cache
def trials(model: str) -> list[Trial]:
    drivings = {(1, 1000): SAME_COUNT, (1, 600): FEWER, (2, 1500): MORE}
    rests = [person(shape, faces=faces) for shape, faces in drivings]
    made = [
        Trial(driving, rest, np.stack([extremes(IDENTITY), extremes(rest)], axis=1))
        for driving, rest in zip(drivings.values(), rests, strict=True)
    ]
    return made[:1] if model == "copy" else made[1:2] if model in SLOW else made


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


CHANGES = {f"{up}{front}": dict(rotation=turn) for (up, front), turn in zip(ORIENTATIONS, ROTATIONS, strict=True)}
CHANGES |= {"far": dict(shift=(3.0, -7.0, 0.1)), "large": dict(scale=4.0), "small": dict(scale=0.01)}
CHANGES["moved"] = dict(scale=3.7, shift=(100.0, 2.0, -5.0))
SAMPLE = ("moved", "+y-x", "+z-y", "-x+z")
"""A turn about the vertical, one of files with z up, and one that lies: all methods share the code that undoes them,
which tests/core/test_normalization.py and test_heading.py prove; one method is tested with all changes."""
CASES = [(model, change) for model in FAST for change in (CHANGES if model == "per_vertex" else SAMPLE)]
CASES += [(model, change) for model in SLOW for change in SAMPLE[:2]]
QUICK = [(model, change) for model, change in CASES if change in SAMPLE and model != "skeleton"]
CHANGED = pytest.mark.parametrize(
    ("model", "change"), matrix(("model", "change"), CASES, quick=QUICK).args[1], indirect=["model"]
)


def skip_copy(model):
    if model == "copy":
        pytest.skip("copy pairs vertices by index")


def size(mesh: Mesh) -> float:
    return float(np.ptp(mesh.vertices, axis=0).max())


@CHANGED
def test_moved_identity_moves_the_result(model, change):
    expected = changed(dataclasses.replace(IDENTITY, vertices=unchanged(model)[0]), **CHANGES[change])
    identity = changed(IDENTITY, **CHANGES[change])
    result = trials(model)[0].move(model, identity)
    assert np.allclose(result, expected.vertices, rtol=0, atol=2e-6 * size(identity))


@CHANGED
def test_moved_driving_does_not_change_the_result(model, change):
    result = trials(model)[-1].changed(**CHANGES[change]).move(model)
    assert np.allclose(result, unchanged(model)[-1], rtol=0, atol=2e-6 * size(IDENTITY))


def test_permuted_identity_permutes_the_result(model):
    skip_copy(model)
    order = np.random.default_rng(3).permutation(len(IDENTITY.vertices))
    for trial, expected in zip(trials(model), unchanged(model), strict=True):
        markers = np.stack([np.argsort(order)[trial.markers[:, 0]], trial.markers[:, 1]], axis=1)
        result = dataclasses.replace(trial, markers=markers).move(model, permute_vertices(IDENTITY, order))
        assert np.array_equal(result, expected[order])


def test_permuted_driving_changes_no_bit(model):
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


def test_permuted_driving_clip_changes_no_bit(model):
    skip_copy(model)
    if model in SLOW:
        pytest.skip("tested in their own files")
    clip = walk(faces=600)
    order = np.random.default_rng(4).permutation(clip.vertices.shape[1])
    shuffled = Clip(permute_vertices(clip.mesh, order), clip.vertices[:, order], clip.fps)
    expected = animate(IDENTITY, clip, model).clip.vertices
    assert np.array_equal(animate(IDENTITY, shuffled, model).clip.vertices, expected)


def test_repeated_call_gives_the_same_bits(model):
    trial = trials(model)[0]
    first, second = (trial.move(model, ensemble=2, seed=5) for _ in range(2))
    assert np.array_equal(first, second)


def test_arguments_are_not_modified(model):
    trial = trials(model)[0]
    meshes = IDENTITY, trial.driving, trial.reference
    before = [mesh.vertices.copy() for mesh in meshes]
    trial.move(model)
    assert all(np.array_equal(mesh.vertices, old) for mesh, old in zip(meshes, before, strict=True))


def test_frames_are_read_one_at_a_time(model):
    """Constant memory: the result of a frame is yielded before the next frame (or two windows further) is read."""
    read, trial = [], trials(model)[0]
    ahead = 2 * WINDOW - OVERLAP - 1 if model.endswith("sequence.onnx") else 0

    def frames():
        for t in range(5 + ahead):
            read.append(t)
            yield trial.driving.vertices

    drive = find_method(model, **trial.options(model)).prepare(IDENTITY, Clip.still(trial.driving))
    for t, vertices in enumerate(drive(frames())):
        assert len(read) <= t + 1 + ahead
        assert vertices.shape == IDENTITY.vertices.shape
