"""Properties of every method: moving, scaling, turning and reordering inputs changes results only accordingly."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from grouped_options import grouped
from networks import write_mime_network, write_network, write_sequence_network
from people import person, walk

import mimesh
from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import ORIENTATIONS, ROTATIONS
from mimesh.methods.base import Method
from mimesh.methods.find import find_model
from mimesh.methods.npt import OVERLAP
from mimesh.pipeline import animate, transfer

IDENTITY = person(0)
SAME_COUNT = person(1, pose=0)
FEWER, MORE = person(1, pose=1, faces=600), person(2, pose=2, faces=1500)
FAST = ("copy", "per_vertex", "global_max", "truth", "sequence", "mime")
SLOW = ("deformation-transfer",)
"""Methods that take seconds a mesh."""
WINDOW = 3
"""Frames in a window of the sequence network, which it reads before it yields the first result."""


@pytest.fixture(scope="module", params=[*FAST, *SLOW])
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

    def move(self, model: str, identity: Mesh = IDENTITY) -> np.ndarray:
        return transfer(identity, self.driving, model, **grouped(**self.options(model), ensemble=2, seed=5)).vertices


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


def turn_to(axes: str) -> np.ndarray:
    return ROTATIONS[ORIENTATIONS.index((axes[:2], axes[2:]))]


CHANGES = {
    "moved": (dict(scale=3.7, shift=(100.0, 2.0, -5.0)), dict(scale=0.01, rotation=turn_to("+y-x"))),
    "z up": (dict(rotation=turn_to("+z-y"), shift=(3.0, -7.0, 0.1)), dict(rotation=turn_to("-x+z"), scale=4.0)),
}
"""Changes of identity and driving. Methods share the code that undoes them, which tests/core/test_normalization.py and
test_heading.py prove for all axes."""


@pytest.mark.parametrize("change", CHANGES)
def test_a_moved_identity_moves_the_result_and_a_moved_driving_does_not(model, change):
    if model in SLOW and change != "moved":
        pytest.skip("takes seconds")
    of_identity, of_driving = CHANGES[change]
    identity = changed(IDENTITY, **of_identity)
    expected = changed(dataclasses.replace(IDENTITY, vertices=unchanged(model)[-1]), **of_identity)
    result = trials(model)[-1].changed(**of_driving).move(model, identity)
    assert np.allclose(result, expected.vertices, rtol=0, atol=2e-6 * np.ptp(identity.vertices, axis=0).max())


def test_permuted_meshes_permute_the_result_and_change_no_bit(model):
    if model == "copy":
        pytest.skip("copy pairs vertices by index")
    order = np.random.default_rng(3).permutation(len(IDENTITY.vertices))
    for trial, expected in zip(trials(model), unchanged(model), strict=True):
        of_driving = np.random.default_rng(4).permutation(len(trial.driving.vertices))
        faces = np.random.default_rng(5).permutation(len(trial.driving.faces))
        driving, reference = (
            dataclasses.replace(mesh, faces=mesh.faces[faces])
            for mesh in (permute_vertices(trial.driving, of_driving), permute_vertices(trial.reference, of_driving))
        )
        at = np.argsort(order)[trial.markers[:, 0]], np.argsort(of_driving)[trial.markers[:, 1]]
        shuffled = Trial(driving, reference, np.stack(at, axis=1))
        assert np.array_equal(shuffled.move(model, permute_vertices(IDENTITY, order)), expected[order])


def test_permuted_driving_clip_changes_no_bit(model):
    if model in ("copy", *SLOW):
        pytest.skip("copy pairs vertices by index; slow methods move frame by frame")
    clip = walk(faces=600)
    order = np.random.default_rng(4).permutation(clip.vertices.shape[1])
    shuffled = Clip(permute_vertices(clip.mesh, order), clip.vertices[:, order], clip.fps)
    expected = animate(IDENTITY, clip, model).clip.vertices
    assert np.array_equal(animate(IDENTITY, shuffled, model).clip.vertices, expected)


def test_a_repeated_call_gives_the_same_bits_and_modifies_no_argument(model):
    trial = trials(model)[0]
    meshes = IDENTITY, trial.driving, trial.reference
    before = [mesh.vertices.copy() for mesh in meshes]
    assert np.array_equal(trial.move(model), unchanged(model)[0])
    assert all(np.array_equal(mesh.vertices, old) for mesh, old in zip(meshes, before, strict=True))


def test_frames_are_read_one_at_a_time(model):
    """Constant memory: the result of a frame is yielded before the next frame (or two windows further) is read."""
    read, trial = [], trials(model)[0]
    ahead = 2 * WINDOW - OVERLAP - 1 if model.endswith("sequence.onnx") else 0

    def frames():
        for t in range(3 + ahead):
            read.append(t)
            yield trial.driving.vertices

    method = find_model(model, **trial.options(model))
    if not isinstance(method, Method):
        pytest.skip("joints are kept of all frames, vertices of none")
    drive = method.prepare(IDENTITY, Clip.still(trial.driving))
    for t, vertices in enumerate(drive(frames())):
        assert len(read) <= t + 1 + ahead
        assert vertices.shape == IDENTITY.vertices.shape


@pytest.mark.parametrize(
    ("made", "found"),
    [
        (lambda vertices: vertices[:-1], r"in frame 0, found some of shape"),
        (lambda vertices: vertices * np.nan, r"in frame 0, found NaN or infinity"),
        (None, r"a frame for each of the driving's, found none"),
    ],
)
def test_frames_of_a_programs_own_method_are_checked(made, found):
    class Own:
        name, rough = "own", False

        def prepare(self, identity, driving):
            return lambda frames: iter([made(identity.vertices)] if made else [])

    with pytest.raises(mimesh.InputError, match=rf"own: expected .*{found}"):
        mimesh.transfer(IDENTITY, IDENTITY, Own())
