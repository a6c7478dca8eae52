"""NPT at run time: seams, order, root motion, ensembles, unknown scale, and files that are refused."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from networks import write_network
from people import person, split_everywhere, walk
from zoo import point_cloud, two_parts

from mimesh.core.canonical_order import canonical_order
from mimesh.core.errors import InputError
from mimesh.core.geometry import edges
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.normalization import bbox_centre, radius
from mimesh.core.options import ModelOptions
from mimesh.core.surface_points import padded_vertices
from mimesh.evaluate.measure import placed_shapes
from mimesh.evaluate.run import evaluate_command
from mimesh.methods.find import find_model
from mimesh.methods.npt import PatchDistances
from mimesh.methods.onnx_models import load_network
from mimesh.pipeline import animate, transfer

onnx = pytest.importorskip("onnx")


@pytest.fixture
def network(tmp_path):
    return str(write_network(tmp_path / "tiny.onnx"))


def test_seams_stay_closed_and_do_not_matter(network):
    whole, split = person(0), split_everywhere(person(0))
    expected = transfer(whole, person(1, 0), network).vertices[whole.faces.ravel()]
    assert np.allclose(transfer(split, person(1, 0), network).vertices, expected, atol=1e-6)


def test_pooled_pose_hardly_depends_on_the_driving_triangulation(tmp_path):
    pooled = str(write_network(tmp_path / "pooled.onnx", "global_max"))
    results = [transfer(person(0), person(1, 3, faces=faces), pooled).vertices for faces in (1000, 2000)]
    assert np.abs(results[0] - results[1]).max() < 0.1


def test_root_motion_of_the_driving_is_kept(network):
    clip, identity = walk(frames=4), person(0)
    forward = animate(identity, clip, network).clip.vertices.mean(axis=1)[:, 2]
    still = Clip(clip.mesh, np.repeat(clip.vertices[:1], 4, axis=0), clip.fps)
    jump = Clip(clip.mesh, still.vertices + np.array([0, 0.5, 0, 0.25])[:, None, None] * [0, 1, 0], clip.fps)
    assert (np.diff(forward) > 0.05).all()
    height = animate(identity, jump, network).clip.vertices[:, :, 1].min(axis=1)
    assert height[1] > height[3] > height[0] + 0.05
    assert np.isclose(height[2], height[0], atol=1e-6)


def test_root_motion_scales_with_the_identity(network):
    clip, identity = walk(frames=2), person(0)
    giant = Mesh(identity.vertices * 3, identity.faces)
    steps = [np.diff(animate(mesh, clip, network).clip.vertices.mean(axis=1), axis=0) for mesh in (identity, giant)]
    assert np.allclose(steps[0] * 3, steps[1], atol=1e-4)


def test_ensemble_is_the_mean_of_its_pairings(network):
    """Naive implementation: the mean of single pairings, each run on its own."""
    identity, driving = person(0), person(1, 0)
    method = load_network(Path(network), name="tiny", ensemble=3)
    points = padded_vertices(driving, len(identity.vertices), np.random.default_rng(0))
    at = points.at(driving.vertices).astype(np.float32)
    ranked = canonical_order(identity.vertices)
    rest = ranked.merge(identity.vertices).astype(np.float32)[None]
    pairings = [np.random.default_rng(k).permutation(len(at)) for k in range(3)]
    singles = [method.session.run(["result"], {"identity": rest, "driving": at[p][None]})[0][0] for p in pairings]
    assert np.allclose(method._run(rest[0], at, pairings), np.mean(singles, axis=0), atol=1e-6)


def test_seed_and_ensemble_change_the_result(network):
    identity, driving = person(0), person(1, 0)
    base = transfer(identity, driving, network).vertices
    assert not np.array_equal(base, transfer(identity, driving, network, options=ModelOptions(seed=1)).vertices)
    assert not np.array_equal(base, transfer(identity, driving, network, options=ModelOptions(ensemble=4)).vertices)


def test_result_of_unknown_scale_is_rescaled_to_the_identity(tmp_path):
    truth = str(write_network(tmp_path / "truth.onnx", target_scale="truth"))
    identity = person(0)
    lengths = PatchDistances.of(identity.vertices, edges(identity.faces))
    result = transfer(identity, person(1, 0), truth, options=ModelOptions(refine=False)).vertices
    assert np.isclose(lengths.total(result), lengths.total(identity.vertices), rtol=0.02)


def test_patch_distances_hardly_depend_on_roughness():
    """Edge lengths do: a size taken from them would shrink every rough result."""
    mesh = person(0, faces=13776)
    rough = mesh.vertices + np.random.default_rng(0).normal(0, 0.01, mesh.vertices.shape)
    patches, pairs = PatchDistances.of(mesh.vertices, edges(mesh.faces)), edges(mesh.faces)
    assert patches.total(rough) == pytest.approx(patches.total(mesh.vertices), rel=0.02)
    lengths = [np.linalg.norm(np.diff(points[pairs], axis=1)[:, 0], axis=1).sum() for points in (rough, mesh.vertices)]
    assert lengths[0] > 1.3 * lengths[1]
    assert patches.total(3 * mesh.vertices) == pytest.approx(3 * patches.total(mesh.vertices))


@pytest.mark.parametrize("pose_code", ["per_vertex", "global_max"])
def test_point_clouds_and_several_components_are_moved(tmp_path, pose_code):
    network = str(write_network(tmp_path / "n.onnx", pose_code))
    for identity, driving in ((point_cloud(), person(0)), (person(0), point_cloud()), (two_parts(), point_cloud())):
        result = transfer(identity, driving, network)
        assert result.vertices.shape == identity.vertices.shape
        assert np.isfinite(result.vertices).all()


def test_order_of_coincident_driving_vertices_does_not_matter():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]], float)
    later = np.array([[0, 0, 0], [1, 0.1, 0], [1, 0.2, 0], [1, 0.7, 0]])
    order = [3, 1, 0, 2]
    first, second = canonical_order(vertices).merge(later), canonical_order(vertices[order]).merge(later[order])
    assert np.array_equal(first, second)
    assert np.allclose(first, [[0, 0, 0], [1, 0.4, 0]])


def test_files_that_are_no_networks_of_ours_are_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("hello")
    write_network(tmp_path / "other.onnx", metadata=False)
    for name, message in (("none", "found no file"), ("text", "ONNX format"), ("other", "no such metadata")):
        with pytest.raises(InputError, match=message):
            find_model(str(tmp_path / f"{name}.onnx"))


def test_unknown_models_and_ensembles_below_one_are_refused():
    with pytest.raises(InputError, match=r"copy, .*npt, npt-maxpool"):
        find_model("mimic")
    with pytest.raises(InputError, match="ensemble"):
        find_model("copy", ensemble=0)


class Recorder:
    """Runs a session and keeps what it is given."""

    def __init__(self, session) -> None:
        self.session, self.given = session, []

    def run(self, names, inputs):
        self.given.append(inputs)
        return self.session.run(names, inputs)


def test_a_network_of_metres_gets_both_meshes_in_metres(tmp_path):
    """Its input is each mesh of the files, centred on its box; the result is in metres too, whatever the size."""
    method = find_model(str(write_network(tmp_path / "metres.onnx", target_scale="metres")))
    recorder = Recorder(method.session)
    tall = person(0).with_vertices(1.25 * person(0).vertices + [3.0, 2.0, 1.0])
    result = transfer(
        tall, person(1, 0), dataclasses.replace(method, session=recorder), options=ModelOptions(refine=False)
    )
    for name, mesh in (("identity", tall), ("driving", person(1, 0))):
        given = recorder.given[0][name].reshape(-1, 3)[: len(mesh.vertices)]
        assert np.allclose(
            np.sort(given, axis=0), np.sort(mesh.vertices - bbox_centre(mesh.vertices), axis=0), atol=1e-5
        )
    raw = method.session.run(["result"], recorder.given[0])[0].reshape(-1, 3)[: len(tall.vertices)]
    found, raw = (points - bbox_centre(points) for points in (result.vertices, raw))
    assert radius(found) == pytest.approx(radius(raw), rel=1e-5)


def test_a_network_of_metres_is_measured_in_metres(tmp_path):
    """`evaluate` compares the network's own results; an imported network has a card without data of a training."""
    path = write_network(tmp_path / "authors.onnx", target_scale="metres")
    imported = {"config": {"network": "npt", "model": {}}, "imported": {"file": "original_169.model"}}
    path.with_suffix(".json").write_text(json.dumps(imported))
    method = find_model(str(path))
    recorder, driving = Recorder(method.session), person(1, 0)
    network = dataclasses.replace(method, session=recorder)
    placed, origin = placed_shapes(network, person(0), Clip.still(driving), driving.vertices[None])
    given = recorder.given[0]
    assert radius(given["identity"][0]) == pytest.approx(radius(person(0).vertices - bbox_centre(person(0).vertices)))
    own = method.session.run(["result"], given)[0][0]
    assert radius(placed[0] - origin) == pytest.approx(radius(own), rel=1e-5)
    figures = evaluate_command("human-npt", [str(path)], pairs=1)
    assert "by its authors, original_169.model" in json.dumps(figures)
    assert "trained on its authors' meshes" in json.dumps(figures)


def test_a_network_of_metres_refuses_other_units(tmp_path):
    method = find_model(str(write_network(tmp_path / "metres.onnx", target_scale="metres")))
    large = person(0).with_vertices(100 * person(0).vertices)
    with pytest.raises(InputError, match=r"expected a mesh in metres.* radius of 0\.2 to 2\.5, found [\d.]+; scale"):
        transfer(large, person(1, 0), method)
