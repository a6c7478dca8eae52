"""Figures of the papers: every kind of row can be drawn, colours follow vertices, missing data are reported."""

import numpy as np
import pytest
from matrix import matrix
from networks import write_network, write_sequence_network
from PIL import Image

from mimesh.__main__ import run
from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.evaluate.figures import (
    FIGURES,
    animal_clip_rows,
    figure_command,
    influence_rows,
    one_clip_rows,
)
from mimesh.io import save_mesh


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    return str(write_network(tmp_path_factory.mktemp("networks") / "tiny.onnx"))


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    folder = tmp_path_factory.mktemp("people")
    save_mesh(load_body().mesh(), folder / "somebody.obj")
    return folder


@matrix("name", ["npt-6", "npt-8", "npt-10", "npt-11", "npt-12", "npt-14"], quick=["npt-8", "npt-10"])
def test_figure_is_drawn_with_one_row(name, network, people, tmp_path):
    out = tmp_path / "figure.png"
    assert figure_command(name, out, (network,), 1, people) == 1
    picture = np.asarray(Image.open(out))
    assert picture.shape[1] >= 3 * 300
    assert picture.std() > 5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["aniformer-5", "aniformer-noise"])
def test_figure_of_a_clip_has_rows_of_frames(name, people, tmp_path):
    network = str(write_sequence_network(tmp_path / "tiny.onnx"))
    assert figure_command(name, tmp_path / "figure.png", (network,), 1, people) == 2
    assert np.asarray(Image.open(tmp_path / "figure.png")).shape[1] >= 6 * 300


@pytest.mark.slow
def test_figure_of_a_clip_of_animals_has_the_truth_below(tmp_path):
    network = str(write_sequence_network(tmp_path / "tiny.onnx", metadata={"body": "quadruped"}))
    driving, result, truth = animal_clip_rows((network,), 1, None)
    assert driving[1].label == "horse, gallop, frame 2"
    assert [len(row) for row in (driving, result, truth)] == [6, 6, 6]
    # One shuffle for all: a vertex of the truth has the weights of that of the identity, and edges keep their length.
    identity = result[0].mesh
    assert driving[0].mesh is truth[0].mesh is None
    for row in (result, truth):
        assert np.array_equal(row[1].mesh.faces, identity.faces)
    edges = identity.faces[:, :2]
    old, new = (np.linalg.norm(np.diff(t.mesh.vertices[edges], axis=1)[:, 0], axis=1) for t in (result[0], truth[3]))
    assert np.median(np.abs(new / old - 1)) < 0.05
    assert figure_command("aniformer-animals", tmp_path / "figure.png", (network,)) == 3


@pytest.mark.slow
def test_a_figure_leaves_out_models_without_weights_and_names_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(["figure", "npt-12", "--rows", "1", "-o", str(tmp_path / "figure.png")]) == 0
    assert "make npt-full by python scripts/train_on_gpu.py OUT" in capsys.readouterr().err
    assert np.asarray(Image.open(tmp_path / "figure.png")).shape[1] == 4 * 300  # deformation transfer alone
    assert run(["figure", "npt-12", "-m", "npt-full", "-o", str(tmp_path / "other.png")]) == 2


@pytest.mark.slow
def test_figures_without_results_or_of_several_identities_are_drawn(tmp_path):
    assert [len(row) for row in influence_rows((), 3, None)] == [4, 4, 4]
    network = str(write_sequence_network(tmp_path / "tiny.onnx", metadata={"pairing": "order"}))
    driving, *results = one_clip_rows((network,), 2, None)
    assert [len(row) for row in (driving, *results)] == [6, 6, 6]
    assert not np.allclose(results[0][0].mesh.vertices, results[1][0].mesh.vertices)


def test_unknown_figures_and_missing_data_are_reported(tmp_path, network, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"npt-maxpool-quadruped, .* weights in ablations.*table animals --train"):
        figure_command("npt-14", tmp_path / "a.png")
    with pytest.raises(InputError, match="npt-6, npt-7"):
        figure_command("npt-5", tmp_path / "a.png")
    with pytest.raises(InputError, match="give one"):  # before any weights are looked for
        figure_command("npt-10", tmp_path / "a.png")
    with pytest.raises(InputError, match="found none"):
        figure_command("npt-10", tmp_path / "a.png", (network,), 1, tmp_path)
    with pytest.raises(InputError, match="found neither"):
        figure_command("npt-9", tmp_path / "a.png", ("nobody",))
    assert all(figure.row_count > 0 for figure in FIGURES.values())
