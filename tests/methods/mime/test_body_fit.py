"""Fits find the joints that a person has, from where they are nearly read, in any unit, place and turn."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_pose, sample_shape
from mimesh.core.geometry import face_normals
from mimesh.core.mesh import permute_vertices
from mimesh.core.surface_points import at_barycentric, sample_surface
from mimesh.evaluate.measure import AXES
from mimesh.evaluate.metrics import pmd_of_pair
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.methods.mime.body_fit import BodyFit, SurfaceSample, fit_body
from mimesh.pipeline import transfer

BODY = load_body()


def person(seed=0):
    """Points of a person in a pose of Table 6, and the truth of rotations and joints."""
    shape, pose = sample_shape(BODY, seed, 0), Rotation.from_rotvec(sample_pose(BODY, seed, 0)).as_matrix()
    vertices, joints = BODY.posed(shape, pose), BODY.shaped(shape)[1]
    rotation, offset = BODY.skinning_transforms(joints, pose)
    face, shares = sample_surface(vertices, BODY.faces, 4096, np.random.default_rng(seed))
    cloud = SurfaceSample(at_barycentric(vertices, BODY.faces, face, shares), face_normals(vertices, BODY.faces)[face])
    return cloud, rotation, offset + (rotation @ joints[..., None])[..., 0]


def misread(rotation, joints, seed=0, turn=0.1, away=0.03):
    rng = np.random.default_rng(seed)
    off = Rotation.from_rotvec(turn * rng.normal(size=(31, 3))).as_matrix()
    return off @ rotation, joints + away * rng.normal(size=joints.shape)


def errors(found, true):
    """Mean error of rotations (degrees) and joints (metres)."""
    rotation, joints = (found.rotation, found.joints) if isinstance(found, BodyFit) else found
    cosine = (np.einsum("jab,jab->j", rotation, true[0]) - 1) / 2
    degrees = np.degrees(np.arccos(cosine.clip(-1, 1))).mean()
    return degrees, np.linalg.norm(joints - true[1], axis=1).mean()


@pytest.mark.parametrize("seed", range(4))
def test_joints_are_found(seed):
    cloud, *true = person(seed)
    read = misread(*true, seed)
    fit = fit_body(cloud, *read)
    degrees, metres = errors(fit, true)
    before = errors(read, true)
    assert max(fit.unmatched_body.values()) < 0.01
    assert degrees < 4 < before[0]
    assert metres < 0.01 < 0.04 < before[1]


def test_without_normals_too():
    cloud, *true = person()
    degrees, metres = errors(fit_body(SurfaceSample(cloud.points, 0 * cloud.normals), *misread(*true)), true)
    assert degrees < 5
    assert metres < 0.02


def test_a_surface_inside_out_is_turned_over():
    cloud, *true = person()
    read = misread(*true)
    over = fit_body(SurfaceSample(cloud.points, -cloud.normals), *read)
    assert np.array_equal(over.joints, fit_body(cloud, *read).joints)


def test_one_side_is_enough():
    cloud, *true = person()
    seen = cloud.normals[:, 2] > 0
    degrees, metres = errors(fit_body(SurfaceSample(cloud.points[seen], cloud.normals[seen]), *misread(*true)), true)
    assert degrees < 5
    assert metres < 0.015


def test_any_unit_place_and_turn():
    cloud, *true = person()
    read = misread(*true)
    turn, shift = Rotation.from_rotvec([0.4, 2.0, -1.0]).as_matrix(), np.array([3.0, -2.0, 50.0])
    moved = SurfaceSample(100 * cloud.points @ turn.T + shift, cloud.normals @ turn.T)
    here, there = fit_body(cloud, *read), fit_body(moved, turn @ read[0], 100 * read[1] @ turn.T + shift)
    assert np.allclose(there.rotation, turn @ here.rotation, atol=1e-5)
    assert np.allclose(there.joints, 100 * here.joints @ turn.T + shift, atol=1e-3)
    assert there.unmatched_body == here.unmatched_body


def test_what_no_point_tells_is_as_it_was_read():
    """A person without the arm: the rest is found, and the arm hangs where it was read."""
    cloud, *true = person()
    hand, spine = BODY.joint("LeftHand"), BODY.joint("Spine1")
    read = misread(*true, away=0.01)
    kept = cloud.points @ [1, 0, 0] < true[1][BODY.joint("LeftArm"), 0]
    fit = fit_body(SurfaceSample(cloud.points[kept], cloud.normals[kept]), *read)
    assert np.linalg.norm(fit.joints[spine] - true[1][spine]) < 0.02
    assert np.linalg.norm(fit.joints[hand] - read[1][hand]) < 0.3
    assert fit.unmatched_body["left arm"] > 0.2 > 0.02 > fit.unmatched_body["right arm"]


@pytest.mark.parametrize("flat", [[1, 1, 0], [1, 0, 0], [1e-9, 1e-9, 1e-9]])
def test_what_is_no_person_gives_numbers_all_the_same(flat):
    cloud, *true = person()
    fit = fit_body(SurfaceSample(cloud.points * flat, cloud.normals), *true)
    assert np.isfinite(fit.joints).all()
    assert np.allclose(fit.rotation @ fit.rotation.mT, np.eye(3), atol=1e-6)


def pair():
    return PROTOCOLS["human-npt"].pair("val", "unseen", 1)


def test_mime_is_a_fit_from_where_its_network_reads():
    trial = pair()
    fit, alone = (
        pmd_of_pair(transfer(trial.identity, trial.driving, model, **AXES).vertices, trial.truth)
        for model in ("mime", "mime-network")
    )
    assert fit < 0.5e-4 < alone


def test_shuffled_vertices_change_nothing_but_their_order():
    trial, rng = pair(), np.random.default_rng(5)
    expected = transfer(trial.identity, trial.driving, "mime", **AXES).vertices
    order = rng.permutation(len(trial.identity.vertices))
    meshes = permute_vertices(trial.identity, order), permute_vertices(trial.driving, rng.permutation(len(order)))
    assert np.array_equal(transfer(*meshes, "mime", **AXES).vertices, expected[order])
