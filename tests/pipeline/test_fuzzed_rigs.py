"""Rigs with random damages: every command gives a readable result, or one line about what is wrong."""

from __future__ import annotations

import pytest
import rig_fuzz
import rigs
from foreign_names import renamed

VARIANTS = 3


@pytest.fixture(scope="module")
def checker(tmp_path_factory):
    pytest.importorskip("onnx")
    return rig_fuzz.Checker(tmp_path_factory.mktemp("fuzz"))


@pytest.mark.parametrize("seed", range(VARIANTS))
def test_commands_survive_random_damages(seed, checker, tmp_path):
    """More variants, of real files: `rig_fuzz.py` as a script."""
    person = rigs.figure()
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), clips={"move": rigs.exercise(person, 3)})
    done = rig_fuzz.mutate(path, tmp_path / "damaged.glb", 1000 + seed)
    assert list(checker.failures(tmp_path / "damaged.glb", path)) == [], done
