"""Buffers of long clips are files that keep their values and release their memory; short clips are plain arrays."""

import sys

import numpy as np
import pytest

from mimesh.core import frame_buffer
from mimesh.core.frame_buffer import LARGE, allocate_frames, evenly_spread, release_pages
from mimesh.core.mesh import Mesh
from mimesh.io import load_clip, save_mesh

TRIANGLE = np.array([[0, 1, 2]])


def test_buffers_of_short_clips_are_in_memory():
    frames = allocate_frames(3, 5, np.float32)
    assert (frames.shape, frames.dtype, type(frames)) == ((3, 5, 3), np.float32, np.ndarray)
    release_pages(frames)


def test_buffers_of_long_clips_keep_their_values(monkeypatch):
    monkeypatch.setattr(frame_buffer, "LARGE", 100)
    frames = allocate_frames(7, 50, np.float64)
    assert isinstance(frames, np.memmap)
    values = np.random.default_rng(0).normal(size=frames.shape)
    for t in range(7):
        frames[t] = values[t]
        release_pages(frames)
    assert np.array_equal(frames, values)
    release_pages(frames[2:5])
    assert np.array_equal(frames[2:5:2], values[2:5:2])


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_pages_of_a_long_clip_are_released():
    def resident() -> int:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * 4096

    frames = allocate_frames(4, LARGE // 36, np.float32)
    before = resident()
    for t in range(4):
        frames[t] = t
        release_pages(frames)
    assert resident() - before < frames.nbytes / 4
    assert frames[:, -1, -1].tolist() == [0, 1, 2, 3]


def test_a_folder_read_into_a_file_has_the_same_frames(tmp_path, monkeypatch):
    rng = np.random.default_rng(1)
    for t in range(5):
        save_mesh(Mesh(rng.normal(size=(3, 3)), TRIANGLE), tmp_path / f"{t}.obj")
    expected = load_clip(tmp_path).vertices
    monkeypatch.setattr(frame_buffer, "LARGE", 10)
    monkeypatch.setattr(frame_buffer, "PAGED", 1)
    found = load_clip(tmp_path).vertices
    assert isinstance(found, np.memmap)
    assert np.array_equal(found, expected)


@pytest.mark.parametrize(
    ("frames", "most", "chosen"), [(11, 4, [0, 3, 7, 10]), (1000, 3, [0, 500, 999]), (3, 5, [0, 1, 2]), (9, 1, [0])]
)
def test_the_frames_nearest_to_even_steps_are_chosen(frames, most, chosen):
    assert evenly_spread(frames, most).tolist() == chosen
