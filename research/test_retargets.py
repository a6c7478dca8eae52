"""Figures of retargeting, and the report of the script that measures them."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
from retargets import Actor, body_limbs, measure

from mimesh.bodies import load_body
from mimesh.core.frame_buffer import LazyFrames
from mimesh.core.mesh import Clip
from mimesh.pipeline.result import ClipResult, Timer

SCRIPT = Path(__file__).with_name("measure_rigs.py")


def still(frames: int) -> Clip:
    mesh = load_body().mesh()
    return Clip(mesh, np.tile(mesh.vertices, (frames, 1, 1)), 30.0)


def result_of(clip: Clip, report: dict) -> ClipResult:
    return ClipResult(clip.mesh, LazyFrames.stored(clip.vertices), clip.fps, "mime", Timer(), report, ())


def test_a_character_that_is_turned_over_for_a_few_frames_is_found():
    driving, moved = still(40), still(40)
    moved.vertices[18:23, :, :2] *= -1
    actor = Actor("still", "none", driving, body_limbs())
    report = {"driving": {"front": "+z"}}
    upright = [measure(result_of(clip, report), actor.limbed, actor)["upright"] for clip in (driving, moved)]
    assert upright[0] == pytest.approx(1.0)
    assert upright[1] == pytest.approx(-1.0)


def test_exceptions_while_figures_are_computed_are_part_of_them(monkeypatch):
    script = runpy.run_path(str(SCRIPT))

    def failing(*_):
        raise FloatingPointError("no figure")

    result = result_of(still(2), {})
    monkeypatch.setitem(script["_measure_pair"].__globals__, "retarget", lambda *_: result)
    monkeypatch.setitem(script["_measure_pair"].__globals__, "measure", failing)
    actor = Actor("still", "none", still(2), body_limbs())
    row = script["_measure_pair"](still(2).mesh, actor.limbed, actor)
    assert row["error"] == "FloatingPointError('no figure')"


def test_a_report_has_a_line_for_each_pair():
    report = {"commit": "a", "results": {"all": {"limb_deg": {"mean": 1.0}}}, "figures": [{"a": 1, "b": {"c": 2}}] * 3}
    text = runpy.run_path(str(SCRIPT))["_layout"](report)
    assert json.loads(text) == report
    assert sum(line.startswith('  {"a": 1, "b": {"c": 2}}') for line in text.splitlines()) == 3
