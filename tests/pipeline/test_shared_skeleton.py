"""Clips of the identity's own skeleton: copied, with the whole report; with options, its joints are used."""

from __future__ import annotations

import numpy as np
import pytest
import rigs
from grouped_options import grouped

from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.options import MotionOptions
from mimesh.pipeline import animate


@pytest.fixture(scope="module")
def walker(tmp_path_factory) -> str:
    """Write person 0 with a clip."""
    clips = {"move": rigs.exercise(rigs.figure())}
    return str(rigs.character(tmp_path_factory.mktemp("walker") / "hero.glb", clips=clips))


@pytest.mark.parametrize("options", [[], pytest.param(["--morphs"], marks=pytest.mark.slow)])
def test_a_copied_clip_has_a_picture_and_a_page(options, walker, model, tmp_path, capsys):
    output = tmp_path / "out.glb"
    assert run(["animate", walker, walker, "-m", model, "-o", str(output), *options]) == 0
    assert (tmp_path / "out.preview.png").stat().st_size > 1000
    assert capsys.readouterr().err == ""


def test_the_report_of_a_copied_clip_has_the_keys_of_others(walker, model):
    copied, moved = (animate(walker, walker, model, motion=MotionOptions(root=root)) for root in ("scale", "drop"))
    assert set(moved.report) - set(copied.report) <= {"influence_deviation", "body"}
    assert copied.report["identity"]["front"] == moved.report["identity"]["front"]


def test_options_that_change_the_motion_use_the_joints_of_the_file(walker, model):
    copied, dropped = (
        animate(walker, walker, model, motion=MotionOptions(root=root, ground=False)) for root in ("scale", "drop")
    )
    assert dropped.own is not None
    assert dropped.notes == ()
    across = (copied.clip.vertices - dropped.clip.vertices) - (copied.clip.vertices - dropped.clip.vertices)[0]
    # Frames differ by one displacement over the ground each.
    assert np.ptp(across, axis=1).max() < 1e-5
    assert np.linalg.norm(across[-1].mean(axis=0)) > 0.1


@pytest.mark.parametrize("options", [{"smooth": -1.0}, {"up": "q"}, {"root": "high"}])
def test_options_are_checked_where_a_clip_is_copied(options, walker, model):
    with pytest.raises(InputError):
        animate(walker, walker, model, **grouped(**options))
