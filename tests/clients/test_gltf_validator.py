"""The Khronos validator finds nothing wrong with any glTF file that we write."""

import json
import subprocess

import gltf_samples as samples
import numpy as np
import pytest
from client_programs import validator
from compressed_files import draco_glb
from dressed import dressed_clip
from people import person, walk
from rigs import character

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


def assert_no_worse(path, source):
    """Compare the codes of errors and warnings with those of the file that a result is made from."""
    found, known = (
        {message["code"] for message in issues_of(p)["messages"] if message["severity"] < 2} for p in (path, source)
    )
    assert found <= known


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


def test_result_of_a_draco_file_is_valid(tmp_path):
    """Quantized weights do not add up to 1, and quantized positions leave the bounds that the file states."""

    def quantized(name, values):
        return (values * np.float32(1.0003)).astype(np.float32) if name.startswith("WEIGHTS") else values

    hero = character(tmp_path / "hero.glb", faces=600, frames=1)
    small = draco_glb(hero, tmp_path / "small.glb", 10, quantized)
    moved = mimesh.animate(small, walk(1, frames=4, faces=900))
    moved.save_skinned(tmp_path / "a.glb")
    assert_no_worse(tmp_path / "a.glb", hero)
    save_mesh(load_mesh(small), tmp_path / "b.glb")
    assert_no_worse(tmp_path / "b.glb", hero)
