"""Full disks are reported in one line, and no incomplete files remain."""

import errno
import os
import resource

import numpy as np
import pytest
from zoo import grid

from mimesh.core import frame_buffer
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import save_clip
from mimesh.view.movie import save_movie

ONE_FILE = (".glb", ".gltf", ".npz", ".pc2", ".usda", ".usdc", ".usdz")


@pytest.fixture
def clip():
    mesh = grid(20)
    noise = np.random.default_rng(0).normal(0.0, 0.01, (40, *mesh.vertices.shape))
    return Clip(mesh, mesh.vertices + noise, 24.0)


@pytest.fixture
def small_file_limit():
    """Limit files of this process to 8 KiB."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**13, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


# The temporary file of a glTF buffer hits the limit too, and raises once more when it is closed.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("suffix", ONE_FILE)
def test_clip_on_a_full_disk_is_refused_without_leftovers(clip, suffix, tmp_path, small_file_limit):
    with pytest.raises(InputError, match="expected a place"):
        save_clip(clip, tmp_path / f"a{suffix}")
    assert not [path for path in tmp_path.iterdir() if path.suffix not in (".obj", ".mtl")]


def test_movie_on_a_full_disk_is_refused_without_leftovers(tmp_path, small_file_limit):
    pictures = np.random.default_rng(0).integers(0, 255, (4, 64, 64, 3), dtype=np.uint8)
    with pytest.raises(InputError, match="expected a place"):
        save_movie(list(pictures), tmp_path / "a.gif", 10.0)
    assert not list(tmp_path.iterdir())


def test_full_temporary_folder_is_refused(monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(frame_buffer, "LARGE", 1)
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(InputError, match="set TMPDIR"):
        frame_buffer.allocate_frames(10, 1000, np.float64)
