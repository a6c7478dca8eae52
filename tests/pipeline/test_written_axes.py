"""Formats that have an up axis of their own are written standing, and surfaces right side out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rigs
from people import person, walk

from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.core.options import ConvertOptions, Hints
from mimesh.io import load_clip, load_mesh, save_mesh
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.draft import AccessorCopier
from mimesh.pipeline import animate, transfer
from mimesh.pipeline.rigging import rig
from mimesh.tools.convert import convert
from mimesh.tools.notes import not_kept

LYING = {
    "+y": np.eye(3),
    "+z": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.diag([1, -1, -1]),
    "-z": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "+x": np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    "-x": np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
}
"""Up axis of a file -> rotation of what stands y up into it."""


def lying(up: str) -> Mesh:
    mesh = person(0)
    return mesh.with_vertices(mesh.vertices @ LYING[up].T)


def volume(mesh: Mesh, vertices: np.ndarray) -> float:
    a, b, c = vertices[mesh.faces].swapaxes(0, 1).astype(float)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.slow
@pytest.mark.parametrize("up", LYING)
@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
def test_results_stand_in_gltf_and_lie_as_they_did_elsewhere(up, suffix, model, tmp_path):
    path, out = tmp_path / f"a{suffix}", tmp_path / "a.glb"
    save_mesh(lying(up), path)
    hints = Hints(up=up, front="+y" if up[1] == "z" else "+z", body="human")
    moved = transfer(str(path), person(1), model, hints=hints)
    moved.save(out)
    np.testing.assert_allclose(load_mesh(out).vertices, moved.vertices @ LYING[up], atol=1e-5)
    assert [note for note in not_kept(moved.mesh, out) if "turned" in note] == (
        [] if up == "+y" else [f"a has up {up}: a.glb is turned to +y, which its format has up"]
    )
    moved.save(tmp_path / f"b{suffix}")
    np.testing.assert_allclose(load_mesh(tmp_path / f"b{suffix}").vertices, moved.vertices, atol=1e-5)
    clip = animate(str(path), walk(), model, hints=hints)
    for save in (clip.save_skinned, clip.save):
        save(out)
        of_file = np.asarray(load_clip(out).vertices)
        np.testing.assert_allclose(of_file, clip.clip.vertices @ LYING[up], atol=3e-2 if save != clip.save else 1e-5)
    rigged = rig(str(path), model, hints=Hints(up=up, front=hints.front, body="human"), fingers=False)
    rigged.save(out)
    np.testing.assert_allclose(load_mesh(out).vertices, load_mesh(path).vertices @ LYING[up], atol=1e-5)


def test_convert_turns_by_a_given_axis_and_says_where_one_is_missing(tmp_path):
    save_mesh(dataclasses.replace(lying("+z"), up=None), tmp_path / "a.obj")
    (note,) = convert(tmp_path / "a.obj", tmp_path / "a.glb").notes
    assert note == 'a.glb has y up, its shape looks like up +z: up="+z" turns it'
    (note,) = convert(tmp_path / "a.obj", tmp_path / "b.glb", ConvertOptions(up="z")).notes
    assert note == "a has up +z: b.glb is turned to +y, which its format has up"
    np.testing.assert_allclose(load_mesh(tmp_path / "b.glb").vertices, person(0).vertices, atol=1e-5)
    with pytest.raises(InputError, match=r"a: expected a file without an up axis for up=\"\+z\", found \+y"):
        convert(tmp_path / "a.glb", tmp_path / "c.glb", ConvertOptions(up="z"))
    with pytest.raises(InputError, match=r"c.obj: expected one of \.glb .* for up=\"\+z\", which have y up"):
        convert(tmp_path / "a.obj", tmp_path / "c.obj", ConvertOptions(up="z"))


@pytest.mark.parametrize("skinned", [False, True])
def test_below_a_mirroring_node_the_surface_stays_right_side_out(skinned, model, tmp_path):
    """A skin moves vertices whatever their node is: where the node mirrored them, the order of corners is turned."""
    if skinned:
        rigs.character(tmp_path / "a.glb")
    else:
        save_mesh(person(0), tmp_path / "a.glb")
    draft = AccessorCopier(open_document(tmp_path / "a.glb"), whole=True).draft
    rigs.mirror(draft)
    draft.save(tmp_path / "mirrored.glb")
    mesh = load_mesh(tmp_path / "mirrored.glb")
    expected = volume(mesh, mesh.vertices)
    assert expected > 0
    moved = animate(str(tmp_path / "mirrored.glb"), walk(), model)
    moved.save_skinned(tmp_path / "out.glb")
    nodes = open_document(tmp_path / "out.glb").gltf["nodes"]
    shown = next(node for node in nodes if "skin" in node)
    assert "scale" not in shown
    written = load_clip(tmp_path / "out.glb")
    assert volume(written.mesh, np.asarray(written.vertices[0])) == pytest.approx(expected, rel=0.1)
