"""Files of skinned meshes have four weights a vertex: frames that move so, their deviation, and the root's options."""

import numpy as np
import pytest
from people import person, walk

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.core.options import MotionOptions
from mimesh.io import load_clip
from mimesh.io.gltf.document import open_document, read_accessor
from mimesh.pipeline import animate
from mimesh.pipeline.rigging import rig

pytestmark = pytest.mark.usefixtures("kept")


@pytest.mark.parametrize("skinned", [pytest.param(True, marks=pytest.mark.slow), None])
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


def test_eight_weights_a_vertex_are_in_two_sets(tmp_path):
    """glTF 2.0, 3.7.3.3: sets of four; all weights of a vertex sum to 1, and joints of no weight are 0."""
    result = animate(person(0), walk(frames=3), motion=MotionOptions(skinned=True, influences=8))
    four = animate(person(0), walk(frames=3), motion=MotionOptions(skinned=True))
    assert result.report["influence_deviation"] < 0.5 * four.report["influence_deviation"]
    (deviations,) = result.save_skinned(tmp_path / "a.glb").deviations
    assert deviations["skinned_deviation"] < 1e-5
    document = open_document(tmp_path / "a.glb")
    for mesh in document.gltf["meshes"]:
        for primitive in mesh["primitives"]:
            sets = [
                [read_accessor(document, primitive["attributes"][f"{name}_{k}"]) for k in (0, 1)]
                for name in ("JOINTS", "WEIGHTS")
            ]
            assert "JOINTS_2" not in primitive["attributes"]
            joints, weights = (np.concatenate(parts, axis=1) for parts in sets)
            assert joints.shape == weights.shape == (len(joints), 8)
            np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
            assert (np.diff(weights, axis=1) <= 0).all()
            assert not joints[weights == 0].any()
    np.testing.assert_allclose(load_clip(tmp_path / "a.glb").vertices, result.clip.vertices, atol=1e-4)


def test_a_rig_has_as_many_weights_as_asked_for(tmp_path):
    rigged = rig(person(0))
    for count, sets in ((4, 1), (8, 2)):
        document = open_document(rigged.save(tmp_path / f"{count}.glb", influences=count))
        attributes = document.gltf["meshes"][0]["primitives"][0]["attributes"]
        assert [name for name in attributes if name.startswith("WEIGHTS")] == [f"WEIGHTS_{k}" for k in range(sets)]
    with pytest.raises(InputError, match="expected 4 or 8 weights a vertex, found 6"):
        rigged.save(tmp_path / "a.glb", influences=6)
    with pytest.raises(InputError, match=r"expected 4 weights a vertex in a \.vrm, found 8"):
        rigged.save(tmp_path / "a.vrm", influences=8)


def test_a_pose_keeps_all_weights_unless_it_becomes_skinned():
    pose = Clip.still(person(1, pose=0))
    assert "influence_deviation" not in animate(person(0), pose, motion=MotionOptions(skinned=None)).report
    assert "influence_deviation" in animate(person(0), pose, motion=MotionOptions(skinned=True)).report


@pytest.mark.parametrize(("root", "moves"), [("scale", True), ("keep", True), ("drop", False)])
def test_the_root_goes_as_asked(root, moves):
    path = animate(person(0), walk(frames=3), motion=MotionOptions(root=root, ground=True)).skeleton.root
    assert (np.ptp(path[:, [0, 2]], axis=0).max() > 0.01) == moves
