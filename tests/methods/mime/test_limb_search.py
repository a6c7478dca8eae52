"""Search of limbs: a limb in a wrong pose is found, and a body that lies on its surface is left alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.joint_ranges import joint_ranges
from mimesh.bodies.sampled_body import PosedBody
from mimesh.core.geometry import face_normals
from mimesh.core.surface_points import interpolate, sample_surface
from mimesh.methods.mime.body_fit import LIES_ON, LimbPoses, SurfaceSample, limb_gaps, limbs, sampled_body, search_limbs

BODY, RANGES = sampled_body("quadruped"), joint_ranges("quadruped")


def standing(size=1.0):
    state = BODY.mean_person(size, np.zeros(3), np.tile(np.eye(3), (len(BODY.names), 1, 1)))
    return PosedBody(BODY, state)


def surface_of(posed):
    """Points of the body's surface that are not those that are matched."""
    body = load_body("quadruped")
    vertices = body.vertices * posed.state.size - body.joints[0] * posed.state.size
    face, barycentric = sample_surface(vertices, body.faces, 2560, np.random.default_rng(5))
    return SurfaceSample(interpolate(vertices, body.faces[face], barycentric), face_normals(vertices, body.faces)[face])


def with_turned(posed, joint, vector):
    """Turn a joint and all below it."""
    j = BODY.names.index(joint)
    rotation = np.where(
        (BODY.below[j] > 0)[:, None, None], Rotation.from_rotvec(vector).as_matrix() @ posed.state.rotation,
        posed.state.rotation,
    )  # fmt: skip
    return PosedBody(BODY, replace(posed.state, rotation=rotation))


@pytest.mark.parametrize("size", [1.0, 40.0])
def test_a_turned_limb_has_a_gap(size):
    right = standing(size)
    surface = surface_of(right)
    gaps = limb_gaps(right, surface)
    assert max(gaps.values()) < 0.012
    turned = limb_gaps(with_turned(right, "LeftThigh", [-0.8, 0, 0]), surface)
    assert turned["left hind leg"] > 5 * gaps["left hind leg"]
    assert turned["right foreleg"] == pytest.approx(gaps["right foreleg"], rel=0.05)


@pytest.mark.parametrize("size", [1.0, 40.0])
def test_a_turned_limb_is_found(size):
    right = standing(size)
    surface, wrong = surface_of(right), with_turned(right, "LeftThigh", [-0.8, 0, 0])
    found = search_limbs(wrong, surface, [wrong.state.rotation], RANGES, lambda state: state)
    before, after = limb_gaps(wrong, surface), limb_gaps(PosedBody(BODY, found), surface)
    assert after["left hind leg"] < 0.4 * before["left hind leg"]
    others = [j for j in range(len(BODY.names)) if j not in limbs("quadruped")["left hind leg"]]
    assert sum(after.values()) < sum(before.values())
    assert np.allclose(found.rotation[others][: BODY.names.index("LeftThigh")], np.eye(3))


def test_a_predicted_pose_of_a_limb_is_taken():
    right = standing()
    surface, wrong = surface_of(right), with_turned(right, "LeftThigh", [-0.8, 0, 0])
    found = search_limbs(wrong, surface, [wrong.state.rotation, right.state.rotation], RANGES, lambda state: state)
    assert limb_gaps(PosedBody(BODY, found), surface)["left hind leg"] < LIES_ON + 0.005


def test_no_search_where_limbs_lie_on_the_surface(monkeypatch):
    right = standing()
    monkeypatch.setattr("mimesh.methods.mime.body_fit.LIES_ON", 0.02)

    def refused(state):
        raise AssertionError("nothing was to be fitted again")

    assert search_limbs(right, surface_of(right), [right.state.rotation], RANGES, refused) is right.state


def test_points_of_poses_are_those_of_the_posed_body():
    posed = with_turned(standing(), "RightUpperArm", [0.3, 0.05, 0])
    limb = LimbPoses.of(posed, limbs("quadruped")["right foreleg"])
    index = np.array(limb.joints) - 1
    same = RANGES.local(posed.state.rotation)[None, index]
    assert np.allclose(limb.points(same)[0], posed.points[limb.mask], atol=1e-9)
    bent = same.copy()
    bent[0, 1, 0] -= 0.7
    rotation = posed.state.rotation.copy()
    rotation[limb.joints] = limb.world(bent)[0]
    other = PosedBody(BODY, replace(posed.state, rotation=rotation))
    assert np.allclose(limb.points(bent)[0], other.points[limb.mask], atol=1e-9)
