"""Corners at one position are looked at and moved once; results have all of them, in the order of the file."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from people import person, split_everywhere, walk

from mimesh.core.geometry import first_of_each
from mimesh.core.mesh import Clip, Mesh, merged_mesh, same_colors
from mimesh.core.options import Hints
from mimesh.io import load_clip, load_mesh, save_mesh
from mimesh.pipeline import animate, transfer
from mimesh.pipeline.rigging import rig
from mimesh.view.pack import subset


def test_a_flat_shaded_mesh_moves_as_that_with_shared_corners(model, tmp_path):
    shared, clip = person(0), walk()
    flat = split_everywhere(shared)
    plain, split = animate(shared, clip, model), animate(flat, clip, model)
    corners = shared.faces.ravel()
    assert split.frames.shape == (4, len(corners))
    assert split.frames.distinct.shape == (4, len(np.unique(corners)))
    np.testing.assert_allclose(split.clip.vertices, plain.clip.vertices[:, corners], atol=1e-5)
    assert split.report["edge_stretch_max"] == pytest.approx(plain.report["edge_stretch_max"], abs=1e-5)
    assert len(split.skeleton.rig.weights) == len(split.skeleton.points) == len(np.unique(corners))
    of_plain, of_split = (r.save_skinned(tmp_path / "out.glb").deviations[0] for r in (plain, split))
    assert of_split["skinned_deviation"] == pytest.approx(of_plain["skinned_deviation"], abs=1e-5)
    written = load_clip(tmp_path / "out.glb")
    np.testing.assert_allclose(written.vertices[3], split.clip.vertices[3], atol=2e-2)
    shown = split.panels()
    assert [len(panel.clip.mesh.vertices) for panel in shown][::2] == [len(np.unique(corners))] * 2


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
def test_results_have_the_vertices_of_the_file_in_its_order(suffix, model, tmp_path):
    path = tmp_path / f"flat{suffix}"
    save_mesh(split_everywhere(person(0)), path)
    read, moved = load_mesh(path), transfer(str(path), person(1), model)
    assert moved.vertices.shape == read.vertices.shape
    moved.save(tmp_path / f"out{suffix}")
    np.testing.assert_array_equal(load_mesh(tmp_path / f"out{suffix}").faces, read.faces)
    np.testing.assert_allclose(load_mesh(tmp_path / f"out{suffix}").vertices, moved.vertices, atol=1e-5)
    rest = rig(str(path), model, hints=Hints(body="human"), fingers=False).save(tmp_path / "rig.glb")
    assert len(load_mesh(rest).vertices) == len(read.vertices)


@pytest.mark.parametrize("which", ["identity", "driving"])
def test_a_vertex_of_no_face_changes_nothing(which, model):
    """Exporters leave some far away, where nobody sees them."""
    mesh, clip = person(0), walk()
    clear = animate(mesh, clip, model).clip.vertices
    if which == "identity":
        mesh = dataclasses.replace(mesh, vertices=np.concatenate([mesh.vertices, [[0, 9.0, -30.0]]]))
    else:
        far = np.broadcast_to([0, -9.0, 30.0], (len(clip), 1, 3))
        stray = dataclasses.replace(clip.mesh, vertices=np.concatenate([clip.mesh.vertices, far[0]]))
        clip = Clip(stray, np.concatenate([clip.vertices, far], axis=1), clip.fps)
    moved = animate(mesh, clip, model).clip.vertices[:, : clear.shape[1]]
    np.testing.assert_allclose(moved, clear, atol=1e-5)


def test_colours_that_differ_at_a_position_stay_apart():
    colors = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [1, 0, 0, 1.0]])
    mesh = Mesh(np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0.0]]), np.zeros((0, 3), int), vertex_colors=colors)
    group = np.array([0, 0, 1])
    assert same_colors(mesh, group) is None
    assert same_colors(mesh, np.array([0, 1, 0])) is not None
    assert merged_mesh(mesh, group).vertices.tolist() == [[0, 0, 0], [1, 0, 0]]
    assert first_of_each(np.array([1, -1, 0, 1])).tolist() == [2, 0]


def test_a_dense_page_of_few_triangles_is_welded_alone():
    """A decimator refuses to make more triangles than there are."""
    flat = split_everywhere(person(0))
    chosen, faces = subset(flat.vertices, flat.faces, len(flat.faces) - 1)
    assert len(chosen) == len(np.unique(flat.vertices, axis=0)) > len(flat.faces) / 2
    np.testing.assert_array_equal(flat.vertices[chosen][faces], flat.vertices[flat.faces])
