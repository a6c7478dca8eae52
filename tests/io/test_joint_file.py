"""Files of corrected joints survive a round trip; anything else in them is refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from mimesh.core.errors import InputError
from mimesh.core.joint_corrections import JointCorrections
from mimesh.io.joint_file import load_corrections, save_corrections, side_file


def test_round_trip(tmp_path):
    positions = {"LeftLeg": (0.125, -3.5, 1e-3), "Head": (1, 2, 3)}
    path = tmp_path / "hero.joints.json"
    save_corrections(JointCorrections.of(positions, frame=7, mesh="hero.glb", vertices=12, size=1.75), path)
    read = load_corrections(path)
    assert (read.frame, read.mesh, read.vertices, read.size, read.source) == (7, "hero.glb", 12, 1.75, str(path))
    assert list(read.positions) == list(positions)
    assert all(np.array_equal(read.positions[name], positions[name]) for name in positions)
    assert json.loads(path.read_text())["format"] == "mimesh joints"


def test_a_file_may_have_no_corrections_or_joints_alone(tmp_path):
    path = save_corrections(JointCorrections(), tmp_path / "a.json")
    assert load_corrections(path).positions == {}
    path.write_text('\ufeff{"joints": {"Head": [1, 2, 3]}}', encoding="utf-8")
    read = load_corrections(path)
    assert (read.frame, read.mesh, read.vertices) == (0, "", None)


def test_the_side_file_is_named_after_the_mesh_or_the_folder(tmp_path):
    (tmp_path / "walk.frames").mkdir()
    assert side_file(Path("a/hero.v2.glb")) == Path("a/hero.v2.joints.json")
    assert side_file(tmp_path / "walk.frames") == tmp_path / "walk.frames.joints.json"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected joints as JSON"),
        ("[1]", 'expected an object with "joints"'),
        ('{"joints": []}', 'expected an object with "joints"'),
        ("[" * 100_000, "expected joints as JSON"),
        ('{"joints": {}, "format": "other"}', "found 'other' version None"),
        ('{"joints": {}, "version": 2}', "version 2; update mimesh"),
        ('{"joints": {"Head": [1, 2]}}', "three finite numbers for Head"),
        ('{"joints": {"Head": [1, 2, NaN]}}', "three finite numbers for Head"),
        ('{"joints": {"Head": [1, 2, 1' + "0" * 400 + "]}}", "three finite numbers for Head"),
        ('{"joints": {}, "frame": -1}', "whole number for frame, found '-1'"),
        ('{"joints": {}, "frame": true}', "whole number for frame"),
        ('{"joints": {}, "vertices": 1.5}', "whole number for vertices"),
        ('{"joints": {}, "size": 0}', "positive number for size"),
        ('{"joints": {}, "size": "1 m"}', "positive number for size"),
        ('{"joints": {}}' + " " * 2**20, "bytes; check the path"),
    ],
)
def test_other_contents_are_refused(tmp_path, text, message):
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        load_corrections(tmp_path / "a.json")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(InputError, match="expected a file of joints, found none"):
        load_corrections(tmp_path / "none.json")
