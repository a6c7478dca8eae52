"""Characters of glTF files are posed as the shipped body is, and as a viewer shows the file with moved nodes."""

from __future__ import annotations

import numpy as np
import pytest
import rigs
from rigs import read_skin

from mimesh.bodies import load_body
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.io import load_mesh


@pytest.fixture(scope="module")
def body():
    return load_body()


def pose(body, i: int = 0) -> np.ndarray:
    return rotvec_to_rotmat(sample_pose(body, 5, i, JOINT_LIMITS))


def rest_pose(rig: SkinnedCharacter) -> np.ndarray:
    return np.tile(np.eye(3), (len(rig.parents), 1, 1))


@pytest.mark.parametrize("frames", [0, 1])
def test_a_character_at_rest_is_the_mesh_of_the_file(frames, tmp_path):
    path = rigs.character(tmp_path / "a.glb", frames=frames)
    rig, mesh = read_skin(path), load_mesh(path)
    np.testing.assert_allclose(rig.posed(rest_pose(rig)), mesh.vertices, atol=1e-12)
    np.testing.assert_array_equal(rig.mesh.faces, mesh.faces)


@pytest.mark.parametrize("frames", [0, 1])
def test_a_file_of_the_body_is_posed_as_the_body(body, frames, tmp_path):
    """For any joint axes, scale and up axis; two sets of influences are read."""
    rig = read_skin(rigs.character(tmp_path / "a.glb", shape=2, frames=frames))
    by_name = pose(body)[[body.joint(name) for name in rig.joint_names]]
    expected = body.posed(sample_shape(body, 7, 2), pose(body))[rigs.kept()]
    np.testing.assert_allclose(rig.posed(by_name), expected, atol=2e-6)


def test_posing_equals_moving_the_nodes_of_the_file(body, tmp_path):
    """Also if the bind pose of the file differs from its rest pose."""
    rest = read_skin(rigs.character(tmp_path / "a.glb"))
    order = [rest.joint_names.index(name) for name in body.joint_names]
    once = rest.skinning_transforms(pose(body, 1)[[body.joint(name) for name in rest.joint_names]])
    bent = read_skin(rigs.character(tmp_path / "b.glb", moved=once[:-1][order]))
    assert np.ptp(bent.points, axis=1).max() > 0.01
    local = pose(body, 2)[[body.joint(name) for name in bent.joint_names]]
    root = np.array([0.5, 0.0, -0.25])
    twice = bent.skinning_transforms(local, root)[:-1][order] @ once[:-1][order]
    shown = load_mesh(rigs.character(tmp_path / "c.glb", moved=twice))
    np.testing.assert_allclose(bent.posed(local, root), shown.vertices, atol=5e-6)


def test_vertices_weighted_to_the_world_do_not_move(tmp_path):
    rig = read_skin(rigs.character(tmp_path / "a.glb"))
    free = SkinnedCharacter(**{**vars(rig), "joint_of": np.full_like(rig.joint_of, len(rig.parents))})
    turned = np.tile(rotvec_to_rotmat(np.array([0.0, 1.0, 0.0])), (len(rig.parents), 1, 1))
    np.testing.assert_allclose(free.posed(turned, np.ones(3)), rig.mesh.vertices, atol=1e-12)
