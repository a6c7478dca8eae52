"""Networks that pair vertices by index: permutations, the choice of a network, refused meshes."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from grouped_options import grouped
from networks import write_network, write_sequence_network
from people import person, split_everywhere, walk
from zoo import point_cloud

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.options import ModelOptions
from mimesh.methods import find
from mimesh.methods.find import find_model
from mimesh.pipeline import animate, prepare, transfer

pytest.importorskip("onnx")
AXES = {"up": "+y", "front": "+z", "driving_up": "+y", "driving_front": "+z", "body": "human"}
NOTE = "both meshes have the same triangles, so vertices are paired by index"


@pytest.fixture(params=["npt", "aniformer"])
def ordered(request, tmp_path):
    """A tiny network that was trained in one vertex order."""
    if request.param == "npt":
        return str(write_network(tmp_path / "tiny.onnx", pairing="order"))
    return str(write_sequence_network(tmp_path / "tiny.onnx", metadata={"pairing": "order"}))


@pytest.fixture
def zoo(tmp_path, monkeypatch):
    """The shipped weights of npt replaced by tiny ones; returns the path where the ordered ones are looked for."""
    ordered = tmp_path / f"{find.INDEX_PAIRED['npt']}.onnx"
    paths = {"npt": write_network(tmp_path / "npt.onnx"), find.INDEX_PAIRED["npt"]: ordered}
    shipped = find.weights_path
    monkeypatch.setattr(find, "weights_path", lambda model: paths.get(model) or shipped(model))
    return ordered


def moved(identity: Mesh, driving: Mesh, model: str, **options) -> np.ndarray:
    return transfer(identity, driving, model, **grouped(**AXES, **options)).vertices


def test_permuting_both_meshes_permutes_the_result_and_permuting_one_changes_it(ordered):
    identity, driving = person(0), person(1, 0)
    expected = moved(identity, driving, ordered)
    order = np.random.default_rng(0).permutation(len(identity.vertices))
    both = transfer(permute_vertices(identity, order), permute_vertices(driving, order), ordered, **grouped(**AXES))
    assert np.array_equal(both.vertices, expected[order])
    assert NOTE in both.notes
    points = Mesh(driving.vertices[order], np.zeros((0, 3), int))
    assert np.abs(moved(identity, points, ordered) - expected).max() > 0.01


def test_each_vertex_gets_the_driving_vertex_of_its_index(tmp_path):
    """Naive implementation: the network on the two files' vertices as they are numbered."""
    identity, driving = person(0), person(1, 0)
    method = find_model(str(write_network(tmp_path / "tiny.onnx", pairing="order")))
    (result,) = method.prepare(identity, Clip.still(driving))(iter([driving.vertices]))
    points = driving.vertices - (driving.vertices.min(axis=0) + driving.vertices.max(axis=0)) / 2
    points = points / np.linalg.norm(points, axis=1).max()
    inputs = {"identity": identity.vertices, "driving": points}
    inputs = {name: array.astype(np.float32)[None] for name, array in inputs.items()}
    expected = method.session.run(["result"], inputs)[0][0]
    difference = result - expected  # but for where it stands
    assert np.allclose(difference - difference.mean(axis=0), 0, atol=1e-5)


def test_seams_stay_closed(ordered):
    whole, driving = person(0), person(1, 0)
    expected = moved(whole, driving, ordered)[whole.faces.ravel()]
    assert np.allclose(moved(split_everywhere(whole), split_everywhere(driving), ordered), expected, atol=1e-6)


def test_frames_of_a_clip_are_paired_by_index(ordered):
    clip, identity = walk(frames=4), person(0)
    expected = animate(identity, clip, ordered, **grouped(**AXES)).clip.vertices
    order = np.random.default_rng(1).permutation(len(identity.vertices))
    shuffled = Clip(permute_vertices(clip.mesh, order), clip.vertices[:, order], clip.fps)
    result = animate(permute_vertices(identity, order), shuffled, ordered, **grouped(**AXES)).clip.vertices
    assert np.array_equal(result, expected[:, order])


@pytest.mark.parametrize("driving", [person(1, 0, faces=600), permute_vertices(person(1, 0), np.arange(502)[::-1])])
def test_meshes_that_do_not_correspond_are_refused(ordered, driving):
    with pytest.raises(InputError, match=r"expected the 502 vertices and the triangles of person0.*random"):
        transfer(person(0), driving, ordered)


def test_points_are_paired_by_index_if_there_are_as_many(ordered):
    points = Mesh(person(1, 0).vertices, np.zeros((0, 3), int))
    result = transfer(person(0), points, ordered, **grouped(**AXES))
    assert np.array_equal(result.vertices, moved(person(0), person(1, 0), ordered))
    assert NOTE not in result.notes
    with pytest.raises(InputError, match=f"found {len(point_cloud().vertices)} vertices"):
        transfer(person(0), point_cloud(), ordered)


def test_a_pooled_pose_has_no_pairs(tmp_path):
    pooled = str(write_network(tmp_path / "pooled.onnx", "global_max", pairing="order"))
    result = transfer(person(0), person(1, 0, faces=600), pooled)
    assert NOTE not in result.notes
    assert np.isfinite(result.vertices).all()


def test_auto_takes_the_ordered_network_for_shapes_of_one_mesh(zoo):
    identity, driving, other = person(0, faces=600), person(1, 0, faces=600), person(1, 0, faces=400)
    random = transfer(identity, driving, "npt", **grouped(**AXES))  # there are no ordered weights: said by nobody
    assert NOTE not in random.notes
    shutil.copy(write_network(zoo.with_name("other.onnx"), pairing="order"), zoo)
    ordered = transfer(identity, driving, "npt", **grouped(**AXES))
    assert NOTE in ordered.notes
    assert np.array_equal(ordered.vertices, moved(identity, driving, "npt", pairing="order"))
    assert not np.array_equal(ordered.vertices, random.vertices)
    assert np.array_equal(moved(identity, driving, "npt", pairing="random"), random.vertices)
    assert NOTE not in transfer(identity, other, "npt", **grouped(**AXES)).notes
    clouds = [Mesh(mesh.vertices, np.zeros((0, 3), int)) for mesh in (identity, driving)]
    assert NOTE not in transfer(*clouds, "npt", **grouped(**AXES)).notes
    assert NOTE in animate(identity, Clip.still(driving), "npt", **grouped(**AXES)).notes
    assert prepare(identity, driving, "npt", **grouped(**AXES)).pose(driving.vertices).shape == identity.vertices.shape


def test_order_without_ordered_weights_says_how_to_make_them(zoo):
    with pytest.raises(InputError, match=r"npt-ordered-mixed.onnx, found no file.*data.pairing=order"):
        transfer(person(0), person(1, 0), "npt", options=ModelOptions(pairing="order"))


def test_networks_of_another_pairing_are_refused(ordered, tmp_path):
    random = str(write_network(tmp_path / "random.onnx"))
    wrong = [(random, "order"), (ordered, "random"), ("copy", "order"), ("mime", "order")]
    for model, pairing in wrong:
        with pytest.raises(
            InputError, match=f"pairing.*{pairing}.*trained with data.pairing={pairing}, found .*{Path(model).name}"
        ):
            transfer(person(0), person(1, 0), model, options=ModelOptions(pairing=pairing))
    with pytest.raises(InputError, match="expected one of auto, random, order"):
        find_model("npt", pairing="index")
