"""Comparison of rigged files with those that were written from them: every kind of loss is found."""

from __future__ import annotations

import shutil

import gltf_samples as samples
import numpy as np
import pytest
from own_rigs import is_compressed, lost_content, playback_error

from mimesh.__main__ import run


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write hero.gltf, whose buffers are several files, and what `animate` makes of it and its clip."""
    folder = tmp_path_factory.mktemp("own")
    path = samples.hero().text(folder / "hero.gltf", outside=True)
    written = folder / "written.glb"
    assert run(["animate", str(path), str(path), "-o", str(written), "-q", "--no-preview"]) == 0
    return path, written


def test_nothing_is_lost_in_a_file_that_animate_writes(files):
    assert lost_content(*files) == []
    assert playback_error(files[0], "0", files[1]) < 1e-5
    assert not is_compressed(files[0])


@pytest.mark.parametrize(
    ("change", "lost"),
    [
        (lambda s: s.gltf["nodes"][1].update(name="other"), "nodes"),
        (lambda s: s.gltf["nodes"][1].update(translation=[0, 9, 0]), "nodes"),
        (lambda s: s.gltf["skins"][0].update(extras=1), "skins"),
        (lambda s: s.gltf.pop("materials"), "materials"),
        (lambda s: s.gltf["animations"][1].update(name="x"), "animations"),
        (lambda s: s.gltf["images"].pop(), "images"),
        (lambda s: s.data.__setitem__(slice(0, 4), b"\x00\x01\x02\x03"), "buffers"),
    ],
)
def test_what_is_lost_is_named(change, lost, files, tmp_path):
    sample = samples.hero()
    sample.gltf["animations"].insert(0, {"name": "new", "samplers": [], "channels": []})
    assert lost_content(files[0], sample.glb(tmp_path / "same.glb")) == []
    change(sample)
    assert lost in lost_content(files[0], sample.glb(tmp_path / "other.glb"))


def test_a_written_motion_that_is_shorter_is_no_playback(files, tmp_path):
    shutil.copy(files[1], tmp_path / "a.glb")
    sample = samples.hero()
    sample.gltf["animations"][0]["samplers"][0]["input"] = sample.accessor([0.0, 0.1])
    assert playback_error(files[0], "0", sample.glb(tmp_path / "b.glb")) == np.inf
