"""Files of skinned meshes have four weights a vertex: frames that move so, their deviation, and the root's options."""

import numpy as np
import pytest
from networks import write_mime_network
from people import person, walk

from mimesh.core.mesh import Clip
from mimesh.pipeline import animate

pytest.importorskip("onnx")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A network whose weights are spread over many joints."""
    return str(write_mime_network(tmp_path_factory.mktemp("networks") / "mime.onnx"))


@pytest.mark.parametrize("skinned", [True, None])
def test_skinned_frames_are_those_of_the_file(skinned, model, tmp_path):
    limited, whole = (animate(person(0), walk(frames=3), model, skinned=value) for value in (skinned, False))
    assert ((limited.skeleton.rig.weights > 0).sum(axis=1) <= 4).all()
    assert ((whole.skeleton.rig.weights > 0).sum(axis=1) > 4).any()
    limited.save_skinned(tmp_path / "limited.glb")
    whole.save_skinned(tmp_path / "whole.glb")
    assert limited.report["skinned_deviation"] < 1e-5
    assert limited.report["influence_deviation"] == pytest.approx(whole.report["skinned_deviation"], rel=0.2)
    assert whole.report["skinned_deviation"] > 1e-4
    assert "influence_deviation" not in whole.report


def test_a_pose_keeps_all_weights_unless_it_becomes_skinned(model):
    pose = Clip.still(person(1, pose=0))
    assert "influence_deviation" not in animate(person(0), pose, model, skinned=None).report
    assert "influence_deviation" in animate(person(0), pose, model, skinned=True).report


@pytest.mark.parametrize(("root", "moves"), [("scale", True), ("keep", True), ("drop", False)])
def test_the_root_goes_as_asked(root, moves, model):
    path = animate(person(0), walk(frames=3), model, root=root, ground=True).skeleton.root
    assert (np.ptp(path[:, [0, 2]], axis=0).max() > 0.01) == moves
