"""Hands that touch the body stay on it, on bodies of other girth, and arms stay out of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.foot_planting import PosedJoints
from mimesh.core.geometry import vertex_normals
from mimesh.core.joint_tracks import JointTrack
from mimesh.core.mesh import Mesh
from mimesh.core.options import Hints, MotionOptions
from mimesh.core.rig import Rig
from mimesh.core.skinning import SkinnedMesh, skinning_transforms
from mimesh.core.surface_points import SurfacePoints, generator, interpolate
from mimesh.pipeline import transfer
from mimesh.rigs.body_grid import BodyGrid
from mimesh.rigs.contacts import Contacts

BODY = load_body()
ARMS = tuple(tuple(BODY.joint(f"{side}{name}") for name in ("Arm", "ForeArm", "Hand")) for side in SIDES)
FAT, THIN = (BODY.shaped(size * np.eye(16)[2]) for size in (-3.0, 5.0))
"""Fatter and thinner by 3 and 5 standard deviations of a component that changes the depth of the trunk."""
BELLY = {
    "Shoulder": (0.17, -0.08, 0.18),
    "Arm": (0.5, -0.47, -1.09),
    "ForeArm": (0.24, -1.73, -0.18),
    "Hand": (-0.01, -0.18, -0.3),
}
"""Rotation vectors (radians) of the left arm, whose palm is on the belly of the mean shape then."""


def posed(pose, joints):
    rotation, translation = skinning_transforms(joints, rotvec_to_rotmat(pose), BODY.parents)
    return rotation, (rotation @ joints[..., None])[..., 0] + translation


def belly():
    pose = np.zeros((1, len(BODY.joint_names), 3))
    for name, vector in BELLY.items():
        for side, sign in zip(SIDES, (1, -1), strict=True):
            pose[0, BODY.joint(f"{side}{name}")] = np.array(vector) * (1, sign, sign)
    return pose


def grid(points, joints):
    return BodyGrid.of(points, BODY.weights, joints, BODY.joint_names, BODY.parents)


def still(joints):
    return Rig(np.broadcast_to(np.eye(3), (len(joints), 3, 3)), joints, BODY.weights)


def sampled(points, joints, seed, pose: float | np.ndarray = 0.0):
    """Find the points of a body from other samples of its surface, in a pose."""
    rotation, places = posed(pose * np.ones((1, len(joints), 3)), joints)
    samples = SurfacePoints.of(BODY.mesh(points), 8192, generator(seed, 0))
    weights = interpolate(BODY.weights, samples.corners, samples.barycentric)
    vertices = SkinnedMesh.of(points, still(joints), BODY.parents).posed_at(rotation[0], places[0])
    rig = Rig(rotation[0], places[0], weights)
    cloud = Mesh(samples.points(vertices), np.zeros((0, 3), int))
    return BodyGrid.of_pose(cloud, rig, BODY.joint_names, BODY.parents)


def kept(identity, pose, fps=30.0, cyclic=False):
    """Return the identity with the driving's rotations, and with contacts; the driving has the mean shape."""
    points, joints = identity
    skinned = SkinnedMesh.of(points, still(joints), BODY.parents)
    contacts = Contacts.of(grid(BODY.vertices, BODY.joints), grid(points, joints), skinned, ARMS)
    assert contacts is not None
    rotation, positions = posed(pose, BODY.joints)
    copied = PosedJoints(rotation, np.broadcast_to(joints[0], (len(pose), 3)))
    return skinned, copied, contacts.kept(copied, JointTrack(rotation, positions, fps), cyclic)


def wrists(skinned, of):
    return skinned.joint_positions(of.rotation, of.root)[:, [arm[-1] for arm in ARMS]]


def depth(skinned, of):
    """Return the depths of hands in trunk and legs, negative outside (metres)."""
    points = skinned.posed(of.rotation[-1], of.root[-1])
    part = np.array(BODY.joint_names)[BODY.weights.argmax(axis=1)]
    hands = np.char.find(part, "Hand") >= 0
    body = np.isin(part, ["Hips", "LowerBack", "Spine", "Spine1", "LeftUpLeg", "RightUpLeg"])
    nearest = KDTree(points[body]).query(points[hands])[1]
    normal = vertex_normals(points, BODY.faces)[body][nearest]
    return ((points[body][nearest] - points[hands]) * normal).sum(axis=1)


def test_hands_on_the_belly_are_not_in_a_fat_one():
    skinned, copied, moved = kept(FAT, belly())
    assert np.median(depth(skinned, copied)) > 0.03
    assert np.median(depth(skinned, moved)) < 0.015
    hands = [arm[-1] for arm in ARMS]
    np.testing.assert_array_equal(moved.rotation[:, hands], copied.rotation[:, hands])


def test_hands_on_the_belly_reach_a_thin_one():
    skinned, copied, moved = kept(THIN, belly())
    assert np.percentile(depth(skinned, copied), 99) < -0.03
    assert np.percentile(depth(skinned, moved), 99) > -0.018


def test_the_same_body_sampled_elsewhere_in_another_pose_moves_nothing():
    skinned = SkinnedMesh.of(BODY.vertices, still(BODY.joints), BODY.parents)
    one, other = (sampled(BODY.vertices, BODY.joints, seed, pose) for seed, pose in ((1, 0.0), (2, belly())))
    assert Contacts.of(one, other, skinned, ARMS) is None
    shaped = sampled(*BODY.shaped(-1.5 * np.eye(16)[2]), 3)
    assert Contacts.of(one, shaped, skinned, ARMS) is not None


@pytest.mark.parametrize("identity", [FAT, THIN])
def test_arms_away_from_the_body_stay_to_the_last_bit(identity):
    pose = np.zeros((4, len(BODY.joint_names), 3))
    pose[:, BODY.joint("LeftArm"), 2] = np.linspace(0, 0.5, 4)
    _, copied, moved = kept(identity, pose)
    np.testing.assert_array_equal(moved.rotation, copied.rotation)


def test_hands_that_just_come_near_stay_to_the_last_bit():
    """They would move by 2 mm, and surfaces are known to 3."""
    _, copied, moved = kept(FAT, 0.9 * belly())
    np.testing.assert_array_equal(moved.rotation, copied.rotation)


def test_a_prop_in_a_hand_is_no_part_of_it():
    hand = BODY.joint("LeftHand")
    sword = BODY.joints[hand] + np.linspace(0.3, 1.0, 200)[:, None] * [1.0, 0.0, 0.0]
    weights = np.concatenate([BODY.weights, np.repeat(np.eye(len(BODY.joints))[[hand]], len(sword), axis=0)])
    points = np.concatenate([BODY.vertices, sword])
    armed = BodyGrid.of(points, weights, BODY.joints, BODY.joint_names, BODY.parents)
    assert armed is not None
    np.testing.assert_array_equal(armed.rest, grid(BODY.vertices, BODY.joints).rest)


def test_the_frame_rate_changes_little():
    share = np.clip(np.arange(121) / 60, 0, 1)[:, None, None]
    slow, fast = kept(FAT, share[::4] * belly()), kept(FAT, share * belly(), 120.0)
    np.testing.assert_allclose(wrists(fast[0], fast[2])[::4], wrists(slow[0], slow[2]), atol=0.0005)
    bend = np.diff(wrists(fast[0], fast[2]) - wrists(fast[0], fast[1]), n=2, axis=0) * 120**2
    assert np.abs(bend).max() < 3  # m/s^2, of a movement with 128


def test_a_cycle_ends_as_it_begins():
    share = 1 - 0.4 * np.sin(np.arange(31) / 30 * np.pi)[:, None, None] ** 2
    skinned, _, moved = kept(FAT, share[np.r_[0:30, 0]] * belly(), cyclic=True)
    found = wrists(skinned, moved)
    np.testing.assert_array_equal(found[0], found[-1])


@pytest.mark.slow
@pytest.mark.parametrize("whole", [True, False])
def test_arms_of_a_mesh_whose_limbs_are_not_found_with_certainty_are_left_as_they_are(whole):
    """Clothes have no head and no legs."""
    rotation, places = posed(belly(), BODY.joints)
    skinned = SkinnedMesh.of(BODY.vertices, still(BODY.joints), BODY.parents)
    driving = BODY.mesh(skinned.posed_at(rotation[0], places[0]))
    heights = FAT[0][BODY.faces][..., 1].mean(axis=1)
    neck, hips = (FAT[1][BODY.joint(name), 1] for name in ("Neck1", "LeftUpLeg"))
    kept = whole | (heights < neck) & (heights > hips)
    identity = Mesh(FAT[0], BODY.faces[kept])
    with_contacts, without = (
        transfer(identity, driving, hints=Hints(body="human"), motion=MotionOptions(contacts=contacts))
        for contacts in (True, False)
    )
    assert whole != any("not found with certainty" in note for note in with_contacts.notes)
    assert whole == (np.abs(with_contacts.vertices - without.vertices).max() > 0.02)
