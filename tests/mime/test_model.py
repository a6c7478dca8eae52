"""mime at run time: still and rigid motions are reproduced, samples lie on the surface, all vertices have weights."""

import dataclasses

import numpy as np
import pytest
from networks import write_mime_network
from people import person, walk
from scipy.spatial.transform import Rotation

from mimesh.core.mesh import Clip
from mimesh.core.rig import leg_length
from mimesh.core.surface_points import SurfacePoints
from mimesh.methods.find import find_model
from mimesh.mime.prediction import Denoiser
from mimesh.pipeline import animate, transfer
from mimesh.rigs.retarget import Retarget

pytest.importorskip("onnx")
IDENTITY, DRIVING = person(0), person(1, pose=1, faces=600)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return str(write_mime_network(tmp_path_factory.mktemp("networks") / "mime.onnx"))


@pytest.fixture(scope="module")
def method(path):
    return find_model(path)


def moved(method, frames, mesh=DRIVING):
    return moved_from(method, Clip(mesh, np.stack(frames)[:1]), frames)


def moved_from(method, keyframes, frames, identity=IDENTITY):
    retarget = Retarget.of(method.rig(identity), method.capture(keyframes))
    return [retarget.frame(t, vertices) for t, vertices in enumerate(frames)]


def test_rotation_of_the_driving_rotates_the_result_and_the_same_frame_gives_the_same(method):
    turn = Rotation.from_rotvec([0.0, 1.2, 0.4]).as_matrix()
    first, second, again = moved(method, [DRIVING.vertices, DRIVING.vertices @ turn.T, DRIVING.vertices])
    assert np.array_equal(first, again)
    first, second = (frame - frame.mean(axis=0) for frame in (first, second))
    assert np.allclose(second, first @ turn.T, atol=1e-5)


def test_inverted_faces_do_not_change_the_result(method):
    inverted = [dataclasses.replace(mesh, faces=mesh.faces[:, ::-1]) for mesh in (IDENTITY, DRIVING)]
    results = [
        moved_from(method, Clip.still(driving), [DRIVING.vertices], identity)[0]
        for identity, driving in ((IDENTITY, DRIVING), inverted)
    ]
    assert np.array_equal(*results)


def test_backs_of_faces_do_not_change_the_result(method):
    # Each face a second time, in the opposite winding, as programs for interiors write people.
    distinct = [np.sort(np.unique(np.sort(m.faces), axis=0, return_index=True)[1]) for m in (IDENTITY, DRIVING)]
    plain = [dataclasses.replace(m, faces=m.faces[f]) for m, f in zip((IDENTITY, DRIVING), distinct, strict=True)]
    backed = [dataclasses.replace(m, faces=np.concatenate([m.faces, m.faces[:, ::-1]])) for m in plain]
    results = [
        moved_from(method, Clip.still(driving), [DRIVING.vertices], identity)[0]
        for identity, driving in (plain, backed)
    ]
    assert np.array_equal(*results)


def test_other_poses_give_other_results(path):
    clip = walk(faces=600)
    result = animate(IDENTITY, clip, path).clip.vertices
    centred = result - result.mean(axis=1, keepdims=True)
    assert np.linalg.norm(centred[0] - centred[len(clip) // 2], axis=-1).max() > 0.02


def test_root_motion_is_scaled_by_leg_length(method):
    shift = np.array([0.3, 0.0, -0.2])
    first, second = moved(method, [DRIVING.vertices, DRIVING.vertices + shift])
    length = [leg_length(method._rig(mesh)[0].joints, method.legs) for mesh in (IDENTITY, DRIVING)]
    assert np.allclose(second - first, shift * length[0] / length[1], atol=1e-5)


def test_predictions_do_not_depend_on_rotations_of_keyframes(method):
    turns = Rotation.random(4, random_state=0).as_matrix()
    turned = [DRIVING.vertices, *(DRIVING.vertices @ turn.T for turn in turns)]
    results = [
        moved_from(method, Clip(DRIVING, np.stack(frames)), frames[:1])[0]
        for frames in (turned, [DRIVING.vertices] * 5, [DRIVING.vertices])
    ]
    assert np.allclose(results[0], results[1], atol=1e-4)
    assert not np.allclose(results[0], results[2], atol=1e-6), "all keyframes are used"


def test_noisy_mesh_is_predicted_denoised_and_tracked_as_it_is(method):
    """In its own keyframe a mesh has not moved, with or without noise: the rotations are those of the prediction."""
    noise = 0.02 * np.random.default_rng(0).normal(size=DRIVING.vertices.shape)
    noisy = dataclasses.replace(DRIVING, vertices=DRIVING.vertices + noise)
    denoised = dataclasses.replace(noisy, vertices=Denoiser.of(noisy)(noisy.vertices))
    follow_noisy, _ = method._follow(Clip.still(noisy))
    follow_denoised, _ = method._follow(Clip.still(denoised))
    assert not np.array_equal(denoised.vertices, noisy.vertices)
    assert np.allclose(follow_noisy(noisy.vertices)[0], follow_denoised(denoised.vertices)[0], atol=1e-6)


def test_weights_do_not_depend_on_the_chunk_size(method, monkeypatch):
    whole = moved(method, [DRIVING.vertices])[0]
    monkeypatch.setattr("mimesh.mime.prediction.CHUNK", 100)
    assert np.allclose(moved(method, [DRIVING.vertices])[0], whole, atol=1e-6)


def test_samples_lie_on_the_surface_and_move_with_it():
    samples = SurfacePoints.of(DRIVING, 500, np.random.default_rng(0))
    points, normals = samples.points(DRIVING.vertices), samples.normals(DRIVING.vertices)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    low, high = DRIVING.vertices.min(axis=0), DRIVING.vertices.max(axis=0)
    assert ((points >= low) & (points <= high)).all()
    assert np.allclose(samples.points(2 * DRIVING.vertices + 1), 2 * points + 1)
    part = samples.part(1, 4)
    assert len(part.corners) == 125
    assert np.array_equal(part.points(DRIVING.vertices), points[1::4])


def test_seams_stay_closed(path):
    """Two vertices at one position get the same weights, whatever their normals."""
    duplicates = IDENTITY.vertices[:50]
    doubled = dataclasses.replace(IDENTITY, vertices=np.concatenate([IDENTITY.vertices, duplicates]))
    result = animate(doubled, walk(faces=600), path).clip.vertices
    assert np.array_equal(result[:, :50], result[:, -50:])


@pytest.mark.slow
def test_coarse_people_are_recognised():
    """Confidence does not depend on the resolution of a mesh."""
    result = transfer(person(0, faces=600), person(1, pose=1, faces=600))
    assert result.notes == ()
    assert result.report["identity"]["margin"] > 0.9
