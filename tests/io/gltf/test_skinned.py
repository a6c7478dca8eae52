"""Skinned results: at rest as in the source file, and in every frame of the animation as in the clip."""

import copy
import dataclasses

import numpy as np
import pytest
from networks import write_mime_network
from people import person, walk

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import load_mesh, save_mesh, save_skinned
from mimesh.io.gltf.document import open_document, read_accessor
from mimesh.io.gltf.read import read_rest
from mimesh.pipeline import animate

pytest.importorskip("onnx")


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    network = write_mime_network(tmp_path_factory.mktemp("networks") / "mime.onnx")
    return animate(person(0), walk(faces=600), str(network))


def frame_of(path, t):
    """The file's vertices in frame t, read at rest after the values of frame t were written into the joint nodes."""
    document = open_document(path)
    gltf = copy.deepcopy(document.gltf)
    animation = gltf["animations"][0]
    for channel in animation["channels"]:
        values = read_accessor(document, animation["samplers"][channel["sampler"]]["output"])
        gltf["nodes"][channel["target"]["node"]][channel["target"]["path"]] = values[t].astype(float).tolist()
    return read_rest(dataclasses.replace(document, gltf=gltf))[0].vertices


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_skinned_frames_equal_the_frames_of_the_result(result, tmp_path, suffix):
    path = result.save_skinned(tmp_path / f"hero{suffix}")
    assert result.report["skinned_deviation"] < 1e-5  # three joints are fewer than four
    assert np.allclose(load_mesh(path).vertices, person(0).vertices, atol=1e-5)
    for t in (0, 1, len(result.clip) - 1):
        assert np.allclose(frame_of(path, t), result.clip.vertices[t], atol=1e-4)


def test_skinned_file_keeps_the_materials_of_its_source(result, tmp_path):
    save_mesh(person(0), tmp_path / "hero.glb")
    network = write_mime_network(tmp_path / "mime.onnx")
    loaded = animate(tmp_path / "hero.glb", walk(faces=600), str(network))
    path = loaded.save_skinned(tmp_path / "moved.glb")
    gltf = open_document(path).gltf
    assert [skin["joints"] for skin in gltf["skins"]] == [gltf["skins"][0]["joints"]]
    assert gltf["materials"] == open_document(tmp_path / "hero.glb").gltf["materials"]
    assert np.allclose(load_mesh(path).vertices, load_mesh(tmp_path / "hero.glb").vertices, atol=1e-5)
    assert np.allclose(frame_of(path, 2), loaded.clip.vertices[2], atol=1e-4)


def test_skinned_weights_sum_to_1_and_quaternions_are_continuous(result, tmp_path):
    document = open_document(result.save_skinned(tmp_path / "hero.glb"))
    attributes = document.gltf["meshes"][0]["primitives"][0]["attributes"]
    joints, weights = (read_accessor(document, attributes[name]) for name in ("JOINTS_0", "WEIGHTS_0"))
    assert np.allclose(weights.sum(axis=1), 1, atol=1e-6)
    assert (joints[weights == 0] == 0).all()
    animation = document.gltf["animations"][0]
    for sampler in animation["samplers"][:-1]:
        quaternions = read_accessor(document, sampler["output"])
        assert np.allclose(np.linalg.norm(quaternions, axis=1), 1, atol=1e-6)
        assert ((quaternions[1:] * quaternions[:-1]).sum(axis=1) > 0).all()


def test_skinned_result_of_a_model_without_joints_is_refused(tmp_path):
    result = animate(person(0), Clip.still(person(1, pose=0)), "copy")
    with pytest.raises(InputError, match=r"--skinned: expected a model with joints \(mime\), found copy"):
        result.save_skinned(tmp_path / "hero.glb")


def test_skinned_result_in_another_format_is_refused(result, tmp_path):
    with pytest.raises(InputError, match=r"expected \.glb or \.gltf for joints, found '\.obj'"):
        save_skinned(result.skeleton, 30.0, tmp_path / "hero.obj")
