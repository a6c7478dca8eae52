"""The Khronos validator finds nothing wrong with any glTF file that we write."""

import json
import subprocess

import gltf_samples as samples
import pytest
from client_programs import validator
from dressed import dressed_clip
from people import person, walk

import mimesh
from mimesh.core.mesh import Clip
from mimesh.io import load_mesh, save_clip, save_mesh

pytestmark = pytest.mark.client


def issues_of(path):
    answer = subprocess.run([*validator(), str(path)], capture_output=True, text=True, check=True)
    return json.loads(answer.stdout)["issues"]


def assert_valid(path):
    issues = issues_of(path)
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"][:5]


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_written_clip_is_valid(suffix, tmp_path):
    save_clip(dressed_clip(tmp_path / "d"), tmp_path / f"a{suffix}")
    assert_valid(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_written_mesh_is_valid(suffix, tmp_path):
    save_mesh(dressed_clip(tmp_path / "d").mesh, tmp_path / f"a{suffix}")
    assert_valid(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_written_skin_is_valid(suffix, tmp_path):
    moved = mimesh.animate(person(0, faces=2000), walk(1, frames=4, faces=2000))
    moved.save_skinned(tmp_path / f"a{suffix}")
    assert_valid(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("name", ["hero", "props"])
def test_edited_file_is_valid(name, tmp_path):
    mesh = load_mesh(getattr(samples, name)().glb(tmp_path / "a.glb"))
    save_mesh(mesh.with_vertices(mesh.vertices * 1.1), tmp_path / "b.glb")
    assert_valid(tmp_path / "b.glb")
    save_clip(Clip(mesh, mesh.vertices[None] * [[[1.0]], [[1.2]]]), tmp_path / "c.glb")
    assert_valid(tmp_path / "c.glb")
