"""What holds for every format: a new file of any mesh reads back, names may be long or odd, extras are named."""

from __future__ import annotations

import dataclasses
import importlib.util
import os

import numpy as np
import pytest
import trimesh
import zoo
from nasty import triangle_soup

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Part
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.io.formats import MESH_WRITERS

pytestmark = pytest.mark.usefixtures("in_process")
EXACT, SINGLE = ("obj", "npz"), ("ply", "stl", "usdc", "glb")
"""Formats that keep numbers of 64 and of 32 bits."""
NO_POINTS = ("stl", "abc")
"""Formats without point clouds."""
LIBRARIES = {".usd": "pxr", ".usda": "pxr", ".usdc": "pxr", ".usdz": "pxr"}
ODD_NAME = os.fsdecode(b"h\xffro")
"""A name with a byte that is no text, as Python decodes it: with a lone surrogate."""


def needs(suffix: str) -> None:
    """Skip the test of a format whose library is not installed."""
    if (library := LIBRARIES.get(f".{suffix.lstrip('.')}")) is not None:
        pytest.importorskip(library)


@pytest.mark.parametrize("make", zoo.ZOO)
@pytest.mark.parametrize("suffix", [*EXACT, *SINGLE])
def test_new_file_of_any_mesh_reads_back(suffix, make, tmp_path):
    mesh = make()
    needs(suffix)
    if make is zoo.point_cloud and suffix in NO_POINTS:
        return
    save_mesh(mesh, tmp_path / f"new.{suffix}")
    reread = load_mesh(tmp_path / f"new.{suffix}")
    expected = mesh.vertices if suffix in EXACT else mesh.vertices.astype(np.float32)
    if suffix == "stl":  # corners that touch are welded anew
        np.testing.assert_array_equal(reread.vertices[reread.faces], expected[mesh.faces])
    else:
        np.testing.assert_allclose(reread.vertices, expected, rtol=0, atol=1e-6 if suffix == "glb" else 0)
        np.testing.assert_array_equal(reread.faces, mesh.faces)
        assert len(load_clip(tmp_path / f"new.{suffix}")) == 1
    if suffix in ("ply", "stl", "obj") and len(mesh.faces):
        other = trimesh.load(tmp_path / f"new.{suffix}", process=False, force="mesh")
        np.testing.assert_array_equal(
            triangle_soup(other.vertices, other.faces), triangle_soup(expected.astype(float), mesh.faces)
        )


@pytest.mark.parametrize("suffix", ["obj", "PLY", "STL", "NPZ", "OBJ", "glb", "gltf"])
def test_file_names_of_maximal_length_and_in_upper_case_are_written(suffix, tmp_path):
    name = "大" * 80 + f".{suffix}"  # 240 bytes and the suffix
    save_mesh(zoo.cube(), tmp_path / name)
    mesh = load_mesh(tmp_path / name)
    save_mesh(mesh, tmp_path / "again" / name)  # as the file that was read
    assert np.array_equal(load_mesh(tmp_path / "again" / name).vertices, mesh.vertices)
    if suffix == "NPZ":
        save_clip(Clip.still(mesh), tmp_path / "clip.NPZ")
        assert len(load_clip(tmp_path / "clip.NPZ")) == 1


@pytest.mark.parametrize("suffix", sorted(MESH_WRITERS.keys() - {".fbx"}))
def test_names_that_are_no_text_are_written(suffix, tmp_path):
    needs(suffix)
    cube = zoo.cube()
    for name in (ODD_NAME, "\ud800"):
        mesh = dataclasses.replace(cube, name=name, parts=(Part(name, 0, 6), Part("rest", 6, 12)))
        save_mesh(mesh, tmp_path / f"a{suffix}")
        assert len(load_mesh(tmp_path / f"a{suffix}").faces) == len(cube.faces)


EXTRAS = {".usda": ("pxr", "usd"), ".fbx": ("ufbx", "fbx")}


@pytest.mark.parametrize("suffix", EXTRAS)
def test_a_missing_library_names_the_extra(suffix, tmp_path, monkeypatch):
    package, extra = EXTRAS[suffix]
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == package else find(name, *rest))
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"content")
    uses = [load_mesh, load_clip] + ([lambda path: save_mesh(zoo.cube(), path)] if suffix in MESH_WRITERS else [])
    for use in uses if suffix != ".fbx" else uses[:2]:
        with pytest.raises(InputError, match=rf"found it not installed; pip install 'mimesh\[{extra}\]'"):
            use(path)


@pytest.mark.parametrize("suffix", ["obj", "npz", "ply", "stl", "usdc", "glb", "pc2"])
def test_a_mesh_too_far_from_the_origin_for_single_precision_is_kept_or_refused(suffix, tmp_path):
    needs(suffix)
    mesh, path = zoo.cube(), tmp_path / f"a.{suffix}"
    far = mesh.with_vertices(mesh.vertices + [0, 1e8, 0])
    save = save_mesh if suffix != "pc2" else lambda mesh, path: save_clip(Clip.still(mesh), path)
    if suffix in ("obj", "npz", "ply"):
        save(far, path)
        np.testing.assert_allclose(load_mesh(path).vertices, far.vertices, rtol=1e-15)
        return
    with pytest.raises(InputError, match=r"which measures 1, where such numbers are 8 apart; move it there"):
        save(far, path)
    assert not path.exists()
