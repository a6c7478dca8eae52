"""Other people's rigs pose as ours do, and as a viewer shows their file with its nodes moved."""

from __future__ import annotations

import numpy as np
import pytest
import rigs

from mimesh.bodies import load_body
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.io import load_mesh
from mimesh.io.gltf.skin import read_skin


@pytest.fixture(scope="module")
def body():
    return load_body()


def rig_of(path) -> SkinnedCharacter:
    return read_skin(path)


def pose(body, i: int = 0) -> np.ndarray:
    return rotvec_to_rotmat(sample_pose(body, 5, i, JOINT_LIMITS))


def still(rig: SkinnedCharacter) -> np.ndarray:
    return np.tile(np.eye(3), (len(rig.parents), 1, 1))


@pytest.mark.parametrize("frames", [0, 1])
def test_at_rest_it_is_the_mesh_of_the_file(frames, tmp_path):
    path = rigs.character(tmp_path / "a.glb", frames=frames)
    rig, mesh = rig_of(path), load_mesh(path)
    np.testing.assert_allclose(rig.posed(still(rig)), mesh.vertices, atol=1e-12)
    np.testing.assert_array_equal(rig.mesh.faces, mesh.faces)


def test_our_body_as_a_rig_is_our_body(body):
    count = len(body.vertices)
    joints = np.tile(np.eye(4), (len(body.parents), 1, 1))
    joints[:, :3, 3] = body.joints
    all_joints = np.tile(np.arange(len(body.parents)), (count, 1))
    points = np.repeat(body.vertices[:, None], len(body.parents), axis=1)
    rig = SkinnedCharacter(body.mesh(), body.joint_names, body.parents, joints, all_joints, body.weights, points)
    root = np.array([0.1, -0.2, 0.3])
    np.testing.assert_allclose(rig.posed(pose(body), root), body.posed(np.zeros(1), pose(body), root), atol=1e-12)


@pytest.mark.parametrize("frames", [0, 1])
def test_a_file_of_our_body_poses_as_our_body(body, frames, tmp_path):
    """Whatever the axes of its joints, its scale and its up; two sets of influences are read."""
    rig = rig_of(rigs.character(tmp_path / "a.glb", shape=2, frames=frames))
    by_name = pose(body)[[body.joint(name) for name in rig.joint_names]]
    expected = body.posed(sample_shape(body, 7, 2), pose(body))[rigs.kept()]
    np.testing.assert_allclose(rig.posed(by_name), expected, atol=2e-6)


def test_it_is_what_a_viewer_shows_when_the_nodes_move(body, tmp_path):
    """Also where the file was bound in another pose than that in which it rests."""
    rest = rig_of(rigs.character(tmp_path / "a.glb"))
    order = [rest.joint_names.index(name) for name in body.joint_names]
    once = rest.skinning_transforms(pose(body, 1)[[body.joint(name) for name in rest.joint_names]])
    bent = rig_of(rigs.character(tmp_path / "b.glb", moved=once[:-1][order]))
    assert np.ptp(bent.points, axis=1).max() > 0.01
    local = pose(body, 2)[[body.joint(name) for name in bent.joint_names]]
    root = np.array([0.5, 0.0, -0.25])
    twice = bent.skinning_transforms(local, root)[:-1][order] @ once[:-1][order]
    shown = load_mesh(rigs.character(tmp_path / "c.glb", moved=twice))
    np.testing.assert_allclose(bent.posed(local, root), shown.vertices, atol=5e-6)


def test_turning_the_root_turns_the_character(body, tmp_path):
    rig = rig_of(rigs.character(tmp_path / "a.glb"))
    local = pose(body)[[body.joint(name) for name in rig.joint_names]]
    turn, turned = rotvec_to_rotmat(np.array([0.3, -1.0, 0.2])), local.copy()
    turned[0] = turn @ local[0]
    expected = (rig.posed(local) - rig.joints[0]) @ turn.T + rig.joints[0]
    np.testing.assert_allclose(rig.posed(turned), expected, atol=1e-12)


def test_what_hangs_on_the_world_stays(tmp_path):
    rig = rig_of(rigs.character(tmp_path / "a.glb"))
    free = SkinnedCharacter(**{**vars(rig), "joint_of": np.full_like(rig.joint_of, len(rig.parents))})
    turned = np.tile(rotvec_to_rotmat(np.array([0.0, 1.0, 0.0])), (len(rig.parents), 1, 1))
    np.testing.assert_allclose(free.posed(turned, np.ones(3)), rig.mesh.vertices, atol=1e-12)


def test_bones_say_who_shares_a_skeleton(tmp_path):
    one, other = rig_of(rigs.character(tmp_path / "a.glb")), rig_of(rigs.character(tmp_path / "b.glb", shape=3))
    hung = rig_of(rigs.character(tmp_path / "c.glb", hold={"Head": "Spine1"}))
    named = rig_of(rigs.character(tmp_path / "d.glb", name=str.upper))
    assert one.bones() == other.bones()
    assert len({one.bones(), hung.bones(), named.bones()}) == 3
