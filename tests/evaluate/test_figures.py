"""Figures of the papers: every kind of row can be drawn, colours follow vertices, missing data are reported."""

import numpy as np
import pytest
from networks import write_network, write_sequence_network
from PIL import Image

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.evaluate.figures import FIGURES, figure_command, vertex_index_colors, vertex_order_rows
from mimesh.io import save_mesh


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    return str(write_network(tmp_path_factory.mktemp("networks") / "tiny.onnx"))


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    folder = tmp_path_factory.mktemp("people")
    save_mesh(load_body().mesh(), folder / "somebody.obj")
    return folder


@pytest.mark.parametrize("name", ["npt-6", "npt-8", "npt-10", "npt-11", "npt-12"])
def test_figure_is_drawn_with_one_row(name, network, people, tmp_path):
    out = tmp_path / "figure.png"
    assert figure_command(name, out, (network,), 1, people) == 1
    picture = np.asarray(Image.open(out))
    assert picture.shape[1] >= 3 * 300
    assert picture.std() > 5


@pytest.mark.parametrize("name", ["aniformer-5", "aniformer-noise"])
def test_figure_of_a_clip_has_rows_of_frames(name, people, tmp_path):
    network = str(write_sequence_network(tmp_path / "tiny.onnx"))
    assert figure_command(name, tmp_path / "figure.png", (network,), 1, people) == 2
    assert np.asarray(Image.open(tmp_path / "figure.png")).shape[1] >= 6 * 300


def test_colours_follow_the_vertices_of_a_shuffled_pair(network):
    first, second = vertex_order_rows((network,), 2, None)
    for tile in first + second:
        assert np.array_equal(tile.colors, vertex_index_colors(len(tile.mesh.vertices)))
    assert not np.array_equal(first[0].mesh.vertices, second[0].mesh.vertices)
    assert np.allclose(*(np.sort(row[0].mesh.vertices, axis=0) for row in (first, second)))


def test_unknown_figures_and_missing_data_are_reported(tmp_path, network):
    with pytest.raises(InputError, match="npt-6, npt-7"):
        figure_command("npt-5", tmp_path / "a.png")
    with pytest.raises(InputError, match="give one"):
        figure_command("npt-10", tmp_path / "a.png", (network,))
    with pytest.raises(InputError, match="found none"):
        figure_command("npt-10", tmp_path / "a.png", (network,), 1, tmp_path)
    with pytest.raises(InputError, match="found neither"):
        figure_command("npt-9", tmp_path / "a.png", ("nobody",))
    assert all(figure.row_count > 0 for figure in FIGURES.values())
