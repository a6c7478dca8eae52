"""Files of skinned meshes have four weights a vertex: frames that move so, their deviation, and the root's options."""

import numpy as np
import pytest
from people import person, walk

from mimesh.core.mesh import Clip
from mimesh.core.options import MotionOptions
from mimesh.pipeline import animate


@pytest.mark.parametrize("skinned", [True, None])
def test_skinned_frames_are_those_of_the_file(skinned, tmp_path):
    limited, whole = (
        animate(person(0), walk(frames=3), motion=MotionOptions(skinned=value)) for value in (skinned, False)
    )
    assert ((limited.skeleton.rig.weights > 0).sum(axis=1) <= 4).all()
    assert ((whole.skeleton.rig.weights > 0).sum(axis=1) > 4).any()
    (exact,) = limited.save_skinned(tmp_path / "limited.glb").deviations
    (written,) = whole.save_skinned(tmp_path / "whole.glb").deviations
    assert exact["skinned_deviation"] < 1e-5
    assert limited.report["influence_deviation"] == pytest.approx(written["skinned_deviation"], rel=0.2)
    assert written["skinned_deviation"] > 1e-4
    assert "influence_deviation" not in whole.report


def test_a_pose_keeps_all_weights_unless_it_becomes_skinned():
    pose = Clip.still(person(1, pose=0))
    assert "influence_deviation" not in animate(person(0), pose, motion=MotionOptions(skinned=None)).report
    assert "influence_deviation" in animate(person(0), pose, motion=MotionOptions(skinned=True)).report


@pytest.mark.parametrize(("root", "moves"), [("scale", True), ("keep", True), ("drop", False)])
def test_the_root_goes_as_asked(root, moves):
    path = animate(person(0), walk(frames=3), motion=MotionOptions(root=root, ground=True)).skeleton.root
    assert (np.ptp(path[:, [0, 2]], axis=0).max() > 0.01) == moves
