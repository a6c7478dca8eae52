"""A live session makes the frames that `animate` makes of a recorded clip, and refuses frames that it cannot use."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest
from animals import small, small_clip
from grouped_options import grouped
from matrix import matrix
from networks import write_network, write_sequence_network
from people import person, walk
from rigs import of_kind

import mimesh
from mimesh import InputError, LiveSession
from mimesh.bodies.animals import animal
from mimesh.core.mesh import Clip, Mesh
from mimesh.io import save_clip, save_mesh
from mimesh.motions.animal_clips import gait_clip

pytestmark = pytest.mark.usefixtures("kept")
CLOSE = 1e-3
"""Largest difference over the size of the identity."""


def differences(session: LiveSession, clip: Clip, result: Clip) -> float:
    """Compare frames of a session with those of a clip: the largest distance over the size of the identity."""
    frames = np.stack([session.pose(vertices) for vertices in clip.vertices])
    size = np.ptp(result.mesh.vertices, axis=0).max()
    return float(np.linalg.norm(frames - result.vertices, axis=-1).max() / size)


def in_other_axes(clip: Clip) -> Clip:
    """Return a clip in other axes and another unit, as files have them."""
    return Clip(
        dataclasses.replace(clip.mesh, vertices=70 * clip.mesh.vertices[:, [2, 0, 1]]),
        (70 * clip.vertices[:, :, [2, 0, 1]] + [5.0, 0, 0]).astype(np.float32),
        clip.fps,
    )


@pytest.fixture(scope="module")
def driving() -> Clip:
    return walk(1, frames=5)


@pytest.fixture(scope="module")
def session(driving, model) -> LiveSession:
    """A session with a tiny network."""
    return mimesh.prepare(person(0), driving, model)


@pytest.mark.slow
def test_a_person_moves_as_in_a_clip_and_the_first_frame_is_enough(driving):
    session, result = (
        mimesh.prepare(person(0), driving),
        mimesh.animate(person(0), driving, motion=mimesh.MotionOptions(ground=False, contacts=False)),
    )
    assert differences(session, driving, result.clip) < CLOSE
    assert session.report["driving"] == result.report["driving"]
    alone = mimesh.prepare(person(0), dataclasses.replace(driving.mesh, vertices=driving.vertices[0]))
    for t in (0, 4):
        apart = np.linalg.norm(alone.pose(driving.vertices[t]) - session.pose(driving.vertices[t]), axis=1)
        assert apart.mean() < 0.02 * np.ptp(person(0).vertices, axis=0).max()


@matrix("root", ["scale", "keep", "drop"], quick=["keep"])
def test_displacement_is_that_of_a_clip(driving, model, root):
    """The person walks 0.8 m. A tiny network finds wrong joints, in both cases the same."""
    other = in_other_axes(driving)
    result = mimesh.animate(
        person(0), other, model, motion=mimesh.MotionOptions(root=root, ground=False, contacts=False)
    ).clip
    assert differences(mimesh.prepare(person(0), other, model, root=root), other, result) < CLOSE
    travelled = np.linalg.norm((result.vertices[-1] - result.vertices[0]).mean(axis=0))
    assert {"scale": 0.4 < travelled < 2, "keep": travelled > 20, "drop": travelled < 0.4}[root], travelled


@pytest.mark.slow
def test_an_animal_moves_as_in_a_clip():
    clip, identity = small_clip(gait_clip("dog", "trot", seconds=0.2, fps=10.0)), small(animal("cow"))
    result = mimesh.animate(
        identity, clip, hints=mimesh.Hints(body="quadruped"), motion=mimesh.MotionOptions(ground=False, contacts=False)
    )
    session = mimesh.prepare(identity, clip, hints=mimesh.Hints(body="quadruped"))
    assert session.report["body"] == result.report["body"] == "quadruped"
    assert session.report["driving"]["confidence"] == result.report["driving"]["confidence"]
    assert differences(session, clip, result.clip) < CLOSE


def test_an_identity_with_a_rig_moves_on_its_own_bones(driving, model, tmp_path):
    path = of_kind(tmp_path / "a.glb", "T-pose", moving=False)[0]
    result = mimesh.animate(path, driving, model, motion=mimesh.MotionOptions(ground=False, contacts=False))
    assert result.report["rig"] == "own"
    assert differences(mimesh.prepare(path, driving, model), driving, result.clip) < CLOSE


def test_another_shape_of_one_mesh_moves_by_its_vertices():
    """What is neither a person nor an animal, where a known frame has about its pose: deformation transfer."""
    frames = np.stack([bent_strip(bend) for bend in (0.6, 0.0, -0.5)])
    faces = strip_faces()
    clip = Clip(Mesh(frames[0], faces, name="strip"), frames, 30.0)
    identity = Mesh(bent_strip(0.0) * [1.5, 1.0, 1.0], faces, name="wide")
    session = mimesh.prepare(identity, clip, hints=mimesh.Hints(body="other"))
    assert any("vertex by vertex" in note for note in session.notes)
    assert differences(session, clip, mimesh.animate(identity, clip, hints=mimesh.Hints(body="other")).clip) < CLOSE


def bent_strip(bend: float) -> np.ndarray:
    along, across = np.meshgrid(np.linspace(0, 2, 9), [-0.2, 0.0, 0.3], indexing="ij")
    height = bend * np.square(along) / 2 + 0.1 * np.square(across)
    return np.stack([across, height, along], axis=-1).reshape(-1, 3)


def strip_faces() -> np.ndarray:
    corners = [3 * row + column for row in range(8) for column in range(2)]
    return np.array([face for k in corners for face in ((k, k + 1, k + 3), (k + 1, k + 4, k + 3))])


@pytest.mark.parametrize("model", ["npt", "deformation-transfer", "copy"])
def test_models_without_joints_move_as_in_a_clip(driving, model, tmp_path):
    """The size of all results is that of the first one, whatever frame a session is asked for first."""
    clip = Clip(driving.mesh, driving.vertices[:3], driving.fps)
    identity = person(0)
    options = {"reference": person(1)} if model == "deformation-transfer" else {}
    if model == "npt":
        model = str(write_network(tmp_path / "small.onnx"))
    result = mimesh.animate(identity, clip, model, **grouped(**options)).clip
    session = mimesh.prepare(identity, clip, model, **grouped(**options))
    later = session.pose(clip.vertices[2])
    size = np.ptp(identity.vertices, axis=0).max()
    assert np.abs(later - result.vertices[2]).max() < CLOSE * size
    assert differences(session, clip, result) < CLOSE


def test_a_model_of_windows_of_frames_is_refused(driving, tmp_path):
    network = str(write_sequence_network(tmp_path / "windows.onnx"))
    with pytest.raises(InputError, match=r"from that frame alone, found windows.*animate"):
        mimesh.prepare(person(0), driving, network)


def test_files_of_a_mesh_and_of_a_clip(driving, session, model, tmp_path):
    identity = person(0)
    first = dataclasses.replace(driving.mesh, vertices=driving.vertices[0])
    save_mesh(first, tmp_path / "first.obj")
    save_clip(driving, tmp_path / "walk.npz")
    save_mesh(identity, tmp_path / "hero.obj")
    for file, known in (("first.obj", mimesh.prepare(identity, first, model)), ("walk.npz", session)):
        of_file = mimesh.prepare(tmp_path / "hero.obj", tmp_path / file, model)
        frame = driving.vertices[2]
        assert np.allclose(of_file.pose(frame), known.pose(frame), atol=1e-4)


def test_frames_have_no_influence_on_each_other(driving, session):
    """Any order, number type and container; the array belongs to the caller."""
    forward = [session.pose(vertices) for vertices in driving.vertices]
    kept = forward[1].copy()
    backward = [session.pose(vertices) for vertices in driving.vertices[::-1]][::-1]
    assert np.array_equal(forward, backward)
    forward[1][:] = 0
    assert np.array_equal(session.pose(driving.vertices[1].tolist()), kept)
    assert np.abs(session.pose(driving.vertices[1].astype(np.float32)) - kept).max() < 1e-5
    mesh = Mesh(driving.vertices[1], driving.mesh.faces.copy())
    assert np.array_equal(session.pose(mesh), kept)


def damaged(vertices: np.ndarray, value: float) -> np.ndarray:
    vertices = vertices.copy()
    vertices[7, 1] = value
    return vertices


def test_a_frame_whose_first_and_last_vertex_coincide_is_used(driving, session):
    vertices = driving.vertices[2].copy()
    vertices[-1] = vertices[0]
    almost = vertices.copy()
    almost[-1] += 1e-6
    np.testing.assert_allclose(session.pose(vertices), session.pose(almost), atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda vertices: vertices[:-1], "expected vertices of shape"),
        (lambda vertices: vertices[None], "expected vertices of shape"),
        (lambda vertices: vertices.T, "expected vertices of shape .*give frame.T"),
        (lambda vertices: vertices.ravel(), "expected vertices of shape"),
        (lambda vertices: damaged(vertices, np.nan), "in 1 of [0-9]+ vertices of a frame .first: vertex 7.; leave"),
        (lambda vertices: damaged(vertices, np.inf), "first: vertex 7"),
        (lambda vertices: damaged(vertices, -1e19), "first: vertex 7"),
        (lambda vertices: 0 * vertices + 3, "all vertices at one point"),
        (lambda vertices: [["a", 0, 0]], "expected numbers"),
    ],
)
def test_unusable_frames_are_refused_and_the_session_goes_on(driving, session, change, message):
    before = session.pose(driving.vertices[2])
    with pytest.raises(InputError, match=message):
        session.pose(change(driving.vertices[2]))
    assert np.array_equal(session.pose(driving.vertices[2]), before)


def test_other_triangles_are_refused(driving, session):
    faces = driving.mesh.faces
    for other in (faces[:-1], faces[:, [0, 2, 1]]):
        with pytest.raises(InputError, match="triangles that the session was prepared with"):
            session.pose(Mesh(driving.vertices[1], other))
    assert len(session.pose(driving.vertices[1])) == len(person(0).vertices)


class Own:
    """A method that gives the driving's vertices back, and calls a function before each frame."""

    name, rough, body = "own", False, "human"

    def __init__(self, before):
        self.before = before

    def prepare(self, identity, driving):
        def drive(frames):
            for vertices in frames:
                self.before(vertices)
                yield vertices

        return drive


def test_a_model_that_fails_in_a_frame_goes_on(driving):
    def fail(vertices):
        if vertices[0, 0] > 1e6:
            raise ArithmeticError("too far")

    session = mimesh.prepare(person(0), driving, Own(fail))
    before = session.pose(driving.vertices[1])
    with pytest.raises(ArithmeticError):
        session.pose(driving.vertices[1] + [1e8, 0, 0])
    assert np.array_equal(session.pose(driving.vertices[1]), before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"root": "up"}, "^root: expected"),
        ({"model": "npt", "root": "drop"}, "expected a model with joints"),
    ],
)
def test_unusable_options_are_refused(driving, options, message):
    with pytest.raises(InputError, match=message):
        mimesh.prepare(person(0), driving, **options)


def test_memory_does_not_grow(driving, session):
    def used(frames: int) -> int:
        for k in range(frames):
            session.pose(driving.vertices[k % len(driving)])
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = used(20)
        assert used(80) - before < 10_000
    finally:
        tracemalloc.stop()
