"""Gaits and postures of quadrupeds: pure, on the ground, with the order of the feet that their names say."""

import numpy as np
import pytest
from animals import BODY
from matrix import matrix

from mimesh.bodies.quadruped import LIMITS
from mimesh.bodies.sampling import limits_rotvec
from mimesh.motions import gaits
from mimesh.motions.gaits import GAITS, LEGS, POSTURES, gait_motion, posture_motion, quadruped_poses, swing
from mimesh.motions.motion import Motion, rotmat_to_rotvec

QUICK = ("walk", "bound", "sit")
MADE = [(gait_motion, name) for name in GAITS] + [(posture_motion, name) for name in POSTURES]
EACH = matrix(("make", "name"), MADE, quick=lambda case: case[1] in QUICK)
LAST = {"Hind": "Toes", "Front": "Fingers"}
NEAR = 0.03
"""Height (metres) below which a foot is on the ground: it rolls, and the spine moves the hips up and down."""


def all_poses(motion: Motion) -> np.ndarray:
    return BODY.posed(np.zeros(1), motion.rotmat, motion.root)


def foot_heights(motion: Motion) -> dict[str, np.ndarray]:
    """Compute the height of the lowest vertex of each foot in every frame, by the names of LEGS."""
    vertices, heights = all_poses(motion), {}
    for leg in LEGS:
        kind = "Hind" if leg.endswith("Hind") else "Front"
        foot = BODY.weights[:, BODY.joint(leg.removesuffix(kind) + LAST[kind])] > 0.5
        heights[leg] = vertices[:, foot, 1].min(axis=1)
    return heights


@EACH
def test_motions_are_pure_roughly_within_the_limits_of_the_joints_and_on_the_ground(make, name):
    one, again = make(BODY, name, 1, 3), make(BODY, name, 1, 3)
    np.testing.assert_array_equal(one.rotmat, again.rotmat)
    np.testing.assert_array_equal(one.root, again.root)
    low, high = np.degrees(limits_rotvec(BODY, LIMITS))
    for other in (make(BODY, name, 0, 3), make(BODY, name, 1, 4)):
        assert np.abs(other.rotmat - one.rotmat).max() > 0.01
        degrees = np.degrees(rotmat_to_rotvec(other.rotmat))
        beyond = np.maximum(low - degrees, degrees - high)
        assert beyond.max() < (
            1 if make is gait_motion else 15
        )  # postures have random turns of 3 degrees in all joints
    np.testing.assert_allclose(all_poses(one)[::5, :, 1].min(axis=1), 0, atol=1e-6)


@matrix("name", list(GAITS), quick=["trot"])
def test_every_foot_stands_for_its_share_of_the_cycle_and_lifts(name):
    for leg, height in foot_heights(gait_motion(BODY, name, 0, 0, seconds=4.0)).items():
        assert (height < NEAR).mean() > 0.8 * GAITS[name].duty, leg
        assert height.max() > 0.025, leg


@pytest.mark.parametrize(
    ("name", "together", "apart"),
    [
        ("walk", [], [("LeftHind", "RightHind"), ("LeftFront", "RightFront")]),
        ("pace", [("LeftHind", "LeftFront"), ("RightHind", "RightFront")], [("LeftHind", "RightHind")]),
        ("trot", [("LeftHind", "RightFront"), ("RightHind", "LeftFront")], [("LeftHind", "LeftFront")]),
        ("bound", [("LeftHind", "RightHind"), ("LeftFront", "RightFront")], [("LeftHind", "LeftFront")]),
    ],
)
def test_feet_move_in_the_order_of_the_gait(name, together, apart):
    """Angles of shoulder and hip: the feet's heights also have the movement of the trunk."""
    motion = gait_motion(BODY, name, 0, 0, seconds=4.0)
    angles = np.degrees(rotmat_to_rotvec(motion.rotmat))[:, :, 0]
    swings = {leg: angles[:, BODY.joint(leg.replace("Hind", "Thigh").replace("Front", "UpperArm"))] for leg in LEGS}
    for pairs, sign in ((together, 1), (apart, -1)):
        for one, other in pairs:
            assert sign * np.corrcoef(swings[one], swings[other])[0, 1] > 0.5, (one, other)


@pytest.mark.parametrize("duty", [0.3, 0.65])
def test_a_leg_goes_back_on_the_ground_and_forward_in_the_air_without_jumps(duty):
    phase = np.linspace(0, 1, 2001)
    place, lifted = swing(phase, duty)
    on_ground = phase < duty
    assert (np.diff(place[on_ground]) > 0).all()
    assert (np.diff(place[~on_ground]) < 0).all()
    assert (lifted[on_ground] == 0).all()
    assert lifted.max() == pytest.approx(1, abs=1e-5)
    assert np.abs(np.diff([*place, place[0]])).max() < 0.01
    assert (place.min(), place.max()) == pytest.approx((-1, 1), abs=0.01)


@matrix("name", ["walk", "pace", "trot", "canter", "bound"], quick=["canter"])
def test_gaits_go_forward(name):
    for i in range(3):
        path = gait_motion(BODY, name, 0, i).root
        assert path[-1, 2] > 0.2
        assert abs(path[-1, 0]) < 0.4 * path[-1, 2]


def test_postures_are_what_they_are_called():
    still = {name: BODY.posed(np.zeros(1), posture_motion(BODY, name, 0, 0).rotmat[[0, 30]]) for name in POSTURES}
    head, hips = (BODY.weights[:, BODY.joint(name)] > 0.5 for name in ("Head", "Hips"))
    for name, poses in still.items():
        np.testing.assert_allclose(poses[0], BODY.vertices, atol=1e-9, err_msg=name)
    above = {name: poses[1] - [0, poses[1, :, 1].min(), 0] for name, poses in still.items()}
    assert above["eat"][head, 1].mean() < 0.7 * BODY.vertices[head, 1].mean() < above["look up"][head, 1].mean()
    assert above["sit"][hips, 1].mean() < 0.8 * BODY.vertices[hips, 1].mean()
    rest, lying = np.ptp(still["lie"][..., 1], axis=1)
    assert lying < 0.85 * rest


def test_splits_have_other_poses(monkeypatch):
    monkeypatch.setattr(gaits, "TAKES", 3)
    train, val, test = (quadruped_poses(BODY, split) for split in ("train", "val", "test"))
    assert train.shape == val.shape == test.shape == (len(train), len(BODY.parents), 3)
    assert np.isfinite(train).all()
    for one, other in ((train, val), (train, test), (val, test)):
        assert not {row.tobytes() for row in one if row.any()} & {row.tobytes() for row in other if row.any()}
