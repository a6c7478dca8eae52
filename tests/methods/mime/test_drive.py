"""mime at run time: still and rigid motions are reproduced, samples lie on the surface, all vertices have weights."""

import dataclasses
import json

import numpy as np
import pytest
from networks import write_mime_network
from people import person, walk
from scipy.spatial.transform import Rotation

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.rig import leg_length
from mimesh.core.surface_points import SurfacePoints
from mimesh.methods.find import find_method
from mimesh.methods.mime.prediction import Denoiser
from mimesh.pipeline import animate, transfer

pytest.importorskip("onnx")
IDENTITY, DRIVING = person(0), person(1, pose=1, faces=600)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return str(write_mime_network(tmp_path_factory.mktemp("networks") / "mime.onnx"))


@pytest.fixture(scope="module")
def method(path):
    return find_method(path)


def moved(method, frames, mesh=DRIVING):
    drive = method.prepare(IDENTITY, Clip(mesh, np.stack(frames)[:1]))
    return list(drive(iter(frames)))


def test_still_driving_gives_a_still_result(method):
    first, *others = moved(method, [DRIVING.vertices] * 4)
    assert all(np.array_equal(frame, first) for frame in others)


def test_rotation_of_the_driving_rotates_the_result(method):
    turn = Rotation.from_rotvec([0.0, 1.2, 0.4]).as_matrix()
    first, second = moved(method, [DRIVING.vertices, DRIVING.vertices @ turn.T])
    first, second = (frame - frame.mean(axis=0) for frame in (first, second))
    assert np.allclose(second, first @ turn.T, atol=1e-5)


def test_inverted_faces_do_not_change_the_result(path):
    inverted = [dataclasses.replace(mesh, faces=mesh.faces[:, ::-1]) for mesh in (IDENTITY, DRIVING)]
    results = [transfer(*meshes, path).vertices for meshes in ((IDENTITY, DRIVING), inverted)]
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


def first_of(method, frames):
    """The result in the first frame, with all frames as keyframes."""
    return next(method.prepare(IDENTITY, Clip(DRIVING, np.stack(frames)))(iter(frames[:1])))


def test_all_keyframes_are_used(method):
    clip = walk(faces=600)
    frames = [vertices.astype(float) for vertices in clip.vertices]
    one, all_keyframes = (
        next(method.prepare(IDENTITY, Clip(clip.mesh, np.stack(keyframes)))(iter(frames[:1])))
        for keyframes in (frames[:1], frames)
    )
    assert not np.allclose(one, all_keyframes, atol=1e-6)


def test_predictions_do_not_depend_on_rotations_of_keyframes(method):
    turns = Rotation.random(4, random_state=0).as_matrix()
    turned = [DRIVING.vertices, *(DRIVING.vertices @ turn.T for turn in turns)]
    assert np.allclose(first_of(method, turned), first_of(method, [DRIVING.vertices] * 5), atol=1e-4)


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
    monkeypatch.setattr("mimesh.methods.mime.prediction.CHUNK", 100)
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


@pytest.mark.parametrize("count", [40, 5000])
def test_samples_of_a_point_cloud_are_its_vertices(count):
    cloud = Mesh(DRIVING.vertices, np.zeros((0, 3), int))
    samples = SurfacePoints.of(cloud, count, np.random.default_rng(0))
    assert len(np.unique(samples.corners[:, 0])) == min(count, len(cloud.vertices)) or count > len(cloud.vertices)
    assert not samples.normals(cloud.vertices).any()


def test_seams_stay_closed(path):
    """Two vertices at one position get the same weights, whatever their normals."""
    duplicates = IDENTITY.vertices[:50]
    doubled = dataclasses.replace(IDENTITY, vertices=np.concatenate([IDENTITY.vertices, duplicates]))
    result = animate(doubled, walk(faces=600), path).clip.vertices
    assert np.array_equal(result[:, :50], result[:, -50:])


@pytest.mark.parametrize("key", ["joints", "parents", "legs", "points"])
def test_file_without_a_skeleton_is_refused(path, tmp_path, key):
    import onnx

    model = onnx.load(path)
    card = json.loads(model.metadata_props[0].value)
    del card[key]
    model.metadata_props[0].value = json.dumps(card)
    onnx.save(model, str(tmp_path / "odd.onnx"))
    with pytest.raises(InputError, match=f"expected {key} in its metadata"):
        find_method(str(tmp_path / "odd.onnx"))


@pytest.mark.slow
def test_coarse_people_are_recognised():
    """Confidence does not depend on the resolution of a mesh."""
    for faces in (600, 1000):
        result = transfer(person(0, faces=faces), person(1, pose=1, faces=faces))
        assert result.notes == ()
        assert result.report["identity"]["margin"] > 0.9
