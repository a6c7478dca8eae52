"""Meshes and clips come out of a child process as it made them, frame by frame, and leave no temporary files."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import tempfile

import numpy as np
import pytest
from zoo import grid

from mimesh.core.errors import InputError
from mimesh.core.frame_buffer import LARGE
from mimesh.core.mesh import Material, Part
from mimesh.io import load_mesh, save_mesh, usd
from mimesh.io.usd import UsdSource, hand_over_mesh, read_usd_clip, take_mesh

READERS = """
import os, resource
import numpy as np
from mimesh.core.mesh import Mesh
from mimesh.io.usd import UsdSource, hand_over_clip

SOURCE = UsdSource(".usd", np.array([3]), "Y", 1.0, ())

def peak():
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

def long_clip(source, target, fps, progress):
    count, vertices = map(int, source.read_text().split())
    mesh = Mesh(np.random.default_rng(0).normal(size=(vertices, 3)), np.array([[0, 1, 2]]), source=SOURCE)
    before = peak()
    hand_over_clip(target, mesh, (mesh.vertices + number for number in range(count)), count, 25.0, progress)
    (source.parent / "growth").write_text(str(peak() - before))

def crash(source, target, fps, progress):
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]), source=SOURCE)

    def frames():
        yield mesh.vertices
        os.abort()

    hand_over_clip(target, mesh, frames(), 9, 25.0, progress)
"""


@pytest.fixture
def read(tmp_path, monkeypatch):
    """Read a clip of some frames and vertices with one of READERS; temporary files are made in the folder `tmp`."""
    (tmp_path / "test_readers.py").write_text(READERS)
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))

    def call(name, count, vertices, progress=None):
        path = tmp_path / "a.xyz"
        path.write_text(f"{count} {vertices}")
        monkeypatch.setattr(usd, "CLIP_READER", f"test_readers:{name}")
        return read_usd_clip(path, None, progress)

    return call


def test_every_field_of_a_mesh_is_handed_over(tmp_path):
    rng, mesh = np.random.default_rng(0), grid(3)
    wool, silk = Material("wool, Größe 大", (0.1, 0.2, 0.3, 0.4), b"\x89PNG\n\0 image"), Material("silk")
    parts = (Part("a", 0, 2, wool), Part("b", 2, 5), Part("c", 5, 7, silk), Part("d", 7, 8, wool))
    mesh = dataclasses.replace(
        mesh,
        name="two\nlines",
        corner_uv=rng.normal(size=(8, 3, 2)),
        corner_normals=rng.normal(size=(8, 3, 3)),
        vertex_colors=rng.uniform(size=(9, 4)),
        parts=parts,
        up="+z",
        source=UsdSource(".usda", np.arange(5), "Z", 0.01, ("a", "ü")),
    )
    hand_over_mesh(tmp_path / "mesh", mesh, count=3)
    taken, facts = take_mesh(tmp_path / "mesh")
    assert facts["count"] == 3
    for one, other in ((mesh, taken), (mesh.source, taken.source)):
        for field in dataclasses.fields(one):
            before, after = getattr(one, field.name), getattr(other, field.name)
            if isinstance(before, np.ndarray):
                np.testing.assert_array_equal(after, before)
                assert after.dtype == before.dtype
            elif field.name != "source":
                assert after == before
    hand_over_mesh(
        tmp_path / "bare", dataclasses.replace(grid(3), source=UsdSource(".usd", np.arange(0), "Y", 1.0, ()))
    )
    assert take_mesh(tmp_path / "bare")[0].corner_uv is None


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is measured as Linux counts it")
def test_long_clips_are_read_frame_by_frame(read, tmp_path):
    calls = []
    count, vertices = 300, 20_000
    clip = read("long_clip", count, vertices, lambda done, total: calls.append((done, total)))
    assert clip.vertices.nbytes > 2 * LARGE
    assert int((tmp_path / "growth").read_text()) < 16 * 2**20
    assert isinstance(clip.vertices, np.memmap)
    assert not list((tmp_path / "tmp").iterdir())  # the mapped file has no name any more
    np.testing.assert_allclose(clip.vertices[count - 1] - clip.vertices[0], count - 1)
    assert clip.fps == 25.0
    assert calls == sorted(set(calls))
    assert calls[-1] == (count, count)


def test_crash_between_frames_is_one_line(read, tmp_path):
    with pytest.raises(InputError, match=r"a\.xyz: expected a file that can be read, found that its decoder crashed"):
        read("crash", 9, 3)
    assert not list((tmp_path / "tmp").iterdir())


def test_too_small_disk_is_named(read, tmp_path):
    with pytest.raises(InputError, match=r"expected room for .* MiB of frames, found .*; free some") as caught:
        read("long_clip", 10**6, 10**6)
    assert "mimesh-" not in str(caught.value)
    assert not list((tmp_path / "tmp").iterdir())


@pytest.mark.slow
def test_the_library_is_not_loaded_by_the_reading_process_and_a_clip_outlives_its_file(tmp_path):
    pytest.importorskip("pxr")
    save_mesh(grid(), tmp_path / "a.usda")
    program = f"""
import os, sys
from mimesh.io import load_clip, save_mesh
os.chdir({str(tmp_path)!r})
clip = load_clip("a.usda")
os.unlink("a.usda")
print("pxr" in sys.modules)
save_mesh(clip.mesh, "b.usda")
print("pxr" in sys.modules)
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ | {"PYTHONWARNINGS": ""})
    assert done.stdout.split() == ["False", "True"]  # new files are written by this process
    np.testing.assert_allclose(load_mesh(tmp_path / "b.usda").vertices, grid().vertices, atol=1e-7)
