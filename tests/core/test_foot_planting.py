"""Soles are planted: contacts are detected on surfaces, legs reach by IK, cycles close, and nothing else changes."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.core.foot_planting import (
    HEIGHTS,
    LONGEST,
    STRAIGHT,
    PosedJoints,
    _ground,
    _knee_direction,
    _solve,
    find_contacts,
    foot_skate,
    is_cyclic,
    keep_above_floor,
    level_soles,
    move_ankle,
    plant_feet,
)
from mimesh.core.geometry import vertex_normals
from mimesh.core.joint_tracks import JointTrack, root_path
from mimesh.core.rig import Rig, descendants, leg_length
from mimesh.core.skinning import SkinnedMesh
from mimesh.core.soles import Feet, LowParts, body_points, find_soles
from mimesh.core.surface_points import SurfacePoints
from mimesh.motions.motion import Motion, motion_clip
from mimesh.motions.procedural import gait, planted

BODY = load_body()
LEGS = tuple(tuple(BODY.joint(f"{side}{name}") for name in ("UpLeg", "Leg", "Foot")) for side in ("Left", "Right"))
PERIOD = 30
"""Frames of a cycle of the walk."""
UP = np.array([0.0, 1.0, 0.0])
STRIDE = 24.0
"""Degrees of the hip."""


def rig_of(shape, size=1.0, shin=1.0, foot=1.0):
    """Vertices and rig of a person; with `shin` shins are longer and thighs shorter, with `foot` feet are longer."""
    vertices, joints = (size * array for array in BODY.shaped(shape))
    ankles = [leg[2] for leg in LEGS]
    on_feet = BODY.weights[:, descendants(ankles, BODY.parents)].sum(axis=1) > 0.5
    for array, part in ((vertices, on_feet), (joints, descendants(ankles, BODY.parents))):
        array[part, 2] += (foot - 1) * (array[part, 2] - joints[ankles[0], 2])
    hip, knee, _ = joints[list(LEGS[0]), 1]
    for array in (vertices, joints):
        array[:, 1] = np.interp(array[:, 1], [-size, 0, knee, hip, 3 * size], [-size, 0, shin * knee, hip, 3 * size])
    return vertices, Rig(np.tile(np.eye(3), (len(joints), 1, 1)), joints, BODY.weights)


def walk(cycles=2.0, fps=30.0):
    """A periodic walk straight ahead."""
    phase = np.arange(round(cycles * PERIOD * fps / 30) + 1) / PERIOD * 30 / fps
    rotmat = np.tile(np.eye(3), (len(phase), len(BODY.joint_names), 1, 1))
    for side, shift in (("Left", 0.0), ("Right", 0.5)):
        for name, angle in zip(
            ("UpLeg", "Leg", "Foot", "ToeBase"), gait(phase + shift, STRIDE, 60.0).values(), strict=True
        ):
            turns = Rotation.from_rotvec(np.radians(np.broadcast_to(angle, phase.shape))[:, None] * [1.0, 0, 0])
            rotmat[:, BODY.joint(side + name)] = turns.as_matrix()
    return Motion("walk", BODY.joint_names, rotmat, planted(BODY, rotmat), fps)


@dataclasses.dataclass(frozen=True)
class Case:
    """The body walks and drives a person of another shape and size."""

    track: JointTrack
    skinned: SkinnedMesh
    feet: Feet
    stride: float

    def posed(self):
        return PosedJoints(self.track.rotation, root_path(self.track, self.stride, self.stride, False))

    def planted(self, **options):
        return plant_feet(self.posed(), self.track, self.skinned, self.feet, (self.stride,) * 2, **options)

    def skate(self, posed):
        return foot_skate(posed, self.track, self.feet, (self.stride,) * 2)

    def soles(self, posed):
        return self.feet.identity_soles(posed.rotation, posed.root)

    def joints(self, posed):
        return np.stack(
            [self.skinned.joint_positions(*frame) for frame in zip(posed.rotation, posed.root, strict=True)]
        )


@cache
def walking(shin=1.0):
    """Somebody of other proportions walks as the body does."""
    return case(shin=shin)


def case(motion=None, size=0.8, path=None, noise=0.0, driving_size=1.0, shin=1.0, foot=1.0):
    motion = walk() if motion is None else motion
    if path is not None:
        motion = dataclasses.replace(motion, root=motion.root + path)
    frames = driving_size * motion_clip(BODY, np.zeros(0), motion).vertices.astype(float)
    frames += noise * np.random.default_rng(0).normal(size=frames.shape)
    rotation, translation = BODY.skinning_transforms(BODY.joints, motion.rotmat, motion.root)
    positions = driving_size * ((rotation @ BODY.joints[..., None])[..., 0] + translation)
    rest, rig = rig_of(np.zeros(0), driving_size)
    vertices, identity_rig = rig_of(sample_shape(BODY, 7, 3), size, shin, foot)
    skinned = SkinnedMesh.of(vertices, identity_rig, BODY.parents)
    everyone = SurfacePoints.of_vertices(len(rest))
    leg, mine = leg_length(rig.joints, LEGS), find_soles(vertices, identity_rig, LEGS, BODY.parents)
    feet = Feet.of(LEGS, leg, mine, skinned, find_soles(rest, rig, LEGS, BODY.parents), everyone)
    assert feet is not None
    soles = np.stack([feet.driving.in_frame(frame)[0] for frame in frames])
    track = JointTrack(rotation, positions, motion.fps, soles)
    return Case(track, skinned, feet, leg_length(identity_rig.joints, LEGS) / leg)


def test_contact_points_are_on_the_sole_from_heel_to_toes():
    vertices, rig = rig_of(np.zeros(0))
    for soles, leg in zip(find_soles(vertices, rig, LEGS, BODY.parents), LEGS, strict=True):
        points = vertices[soles].mean(axis=1)
        assert (points[:, 1] < vertices[:, 1].min() + 0.02).all()
        assert (np.diff(points[:, 2]) > 0.03).all()
        assert (np.sign(points[:, 0]) == np.sign(rig.joints[leg[2], 0])).all()


def test_of_a_leg_without_an_ankle_the_lowest_part_is_its_sole():
    vertices, rig = rig_of(np.zeros(0))
    for soles in find_soles(vertices, rig, tuple(leg[:2] for leg in LEGS), BODY.parents):
        assert (vertices[soles].mean(axis=1)[:, 1] < vertices[:, 1].min() + 0.03).all()


@pytest.mark.parametrize("bones", [1, 2])
def test_legs_that_cannot_bend_stand_by_the_height_of_the_root(bones):
    """The lowest sole is as high over the ground as the driving's in each frame; without, stiff legs sink into it."""
    whole = walking()
    feet = dataclasses.replace(whole.feet, legs=tuple(leg[:bones] for leg in LEGS))
    rotation = whole.track.rotation.copy()
    for leg in LEGS:
        rotation[:, descendants([leg[bones - 1]], BODY.parents)] = rotation[:, leg[bones - 1], None]
    stiff = dataclasses.replace(whole, feet=feet, track=dataclasses.replace(whole.track, rotation=rotation))
    before, after = stiff.posed(), stiff.planted()
    np.testing.assert_array_equal(after.rotation, before.rotation)
    assert stiff.skate(after)[0] < 0.9 * stiff.skate(before)[0]
    driving = stiff.stride * whole.track.soles[..., 1].min(axis=(1, 2))
    errors = [feet.identity_soles(of.rotation, of.root)[..., 1].min(axis=(1, 2)) - driving for of in (before, after)]
    leg = whole.stride * feet.driving_leg
    assert np.ptp(errors[0]) > 0.05 * leg
    assert np.ptp(errors[1]) < 0.03 * leg


@pytest.mark.parametrize(("above", "found"), [(-0.05, True), (0.02, True), (0.12, False)])
def test_a_leg_without_a_foot_stands_on_its_lowest_part_if_it_reaches_the_ankle(above, found):
    """Figures of blocks and stylised ones have such legs; scans often end above the floor. Heights in metres."""
    vertices, rig = rig_of(np.zeros(0))
    knee, ankle, toes = (BODY.joint(f"Left{name}") for name in ("Leg", "Foot", "ToeBase"))
    weights = rig.weights.copy()
    weights[:, knee] += weights[:, [ankle, toes]].sum(axis=1)
    weights[:, [ankle, toes]] = 0
    of_leg = weights[:, knee] > 0.5
    kept = ~of_leg | (vertices[:, 1] > rig.joints[ankle, 1] + above)
    left, right = find_soles(vertices[kept], dataclasses.replace(rig, weights=weights[kept]), LEGS, BODY.parents)
    assert right is not None
    assert (left is not None) == found
    if left is not None:
        lowest = vertices[kept & of_leg, 1].min()
        assert (vertices[kept][left][..., 1] < lowest + 0.3 * (rig.joints[knee, 1] - lowest)).all()


def test_contacts_of_a_walk_are_those_of_its_gait():
    """A foot stands for 0.6 of each cycle: from the heel's strike to the toes' leaving."""
    found = walking()
    contacts = find_contacts(found.track, found.feet.driving_leg)
    share = contacts.planted.any(axis=2).mean(axis=0)
    assert ((share > 0.5) & (share < 0.8)).all()
    # The heel stands first and leaves first.
    heel, toes = contacts.standing[:, 0, 0], contacts.standing[:, 0, -1]
    at = np.arange(len(heel))
    middle = slice(PERIOD // 2, PERIOD // 2 + PERIOD)  # one contact of the left foot, which strikes at 0 and PERIOD
    assert np.average(at[middle], weights=heel[middle]) != np.average(at[middle], weights=toes[middle])
    assert not contacts.ground_step.any()


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_planted_soles_of_other_proportions_do_not_slide_more_than_the_driving_ones(noise):
    found = case(noise=noise, shin=1.25)
    raw, planted_motion = found.posed(), found.planted()
    (before, driving), (after, _) = found.skate(raw), found.skate(planted_motion)
    assert after < 1.2 * driving
    assert noise or before > 1.5 * driving


def test_standing_soles_of_skeletons_without_a_mesh_are_level():
    """Those of a foot that tilts are up to 3 % of a leg above the floor; in the air they stay."""
    found = walking()
    leg, floor = found.feet.driving_leg, -0.01
    tilted = found.track.soles + 0.03 * leg * np.sin(np.arange(len(found.track.soles)))[:, None, None, None] ** 2 * UP
    track = dataclasses.replace(found.track, soles=tilted)
    levelled = level_soles(track, leg, 0, lambda lowest: floor)
    contacts = find_contacts(track, leg)
    assert contacts is not None
    stands = contacts.standing.max(axis=2) > 0.99
    assert stands.any(axis=0).all()
    np.testing.assert_allclose(levelled.soles[1:][stands][..., 1].min(axis=1), floor, atol=1e-3)
    air = np.pad(contacts.standing.max(axis=2) < 0.5, ((1, 1), (0, 0)), constant_values=True)
    air = air[1:] & air[:-1]
    assert air.any(axis=0).all()
    np.testing.assert_array_equal(levelled.soles[air], track.soles[air])


def test_soles_do_not_sink_or_float_or_jump():
    """No point of the feet is accelerated by more than 1.15 times the largest acceleration of before."""
    found = walking()
    raw, corrected = found.posed(), found.planted()
    contacts = find_contacts(found.track, found.feet.driving_leg)
    driving = found.stride * found.track.soles[..., 1].min(axis=2)
    spread, largest, turns = [], [], []
    for posed in (raw, corrected):
        soles = found.soles(posed)
        spread.append(np.ptp((soles[..., 1].min(axis=2) - driving)[contacts.near > 0.99]))
        largest.append(np.linalg.norm(np.diff(soles, 2, axis=0), axis=-1).max())
        turns.append(np.abs(np.diff(posed.rotation, 2, axis=0)).max())
    assert spread[1] < min(0.03 * found.stride * found.feet.driving_leg, spread[0])
    assert largest[1] < 1.15 * largest[0]
    assert turns[1] < 1.5 * turns[0]


def test_long_feet_do_not_swing_through_the_floor():
    """Feet three times as long swing deeper by a quarter of a leg, more than legs of people are corrected by."""
    whole = case(foot=3.0)
    leg, theirs = whole.stride * whole.feet.driving_leg, whole.stride * whole.track.soles[..., 1].min(axis=(1, 2))
    before, after = (
        np.ptp(whole.soles(posed)[..., 1].min(axis=(1, 2)) - theirs) for posed in (whole.posed(), whole.planted())
    )
    assert before > 0.24 * leg
    assert after < 0.08 * leg


def test_knees_that_are_bent_backwards_have_one_side():
    """By about as much as would cancel out with the front, which decides then."""
    front = np.tile([0.0, 0.0, 1.0], (5, 1))
    back = np.linspace(1 - 1e-4, 1 + 1e-4, 5) * np.mean(STRAIGHT)
    thigh = np.stack([0 * back, -np.sqrt(1 - back**2), -back], axis=1)
    found = _knee_direction(thigh, np.tile([0.0, -1.0, 0.0], (5, 1)), front)
    np.testing.assert_allclose(found, front, atol=1e-9)


def test_bones_keep_their_lengths_and_feet_their_directions():
    found = walking(1.25)
    raw, corrected = found.posed(), found.planted()
    lengths, after = (
        np.linalg.norm(np.diff(found.joints(posed)[:, list(LEGS[0])], axis=1), axis=-1) for posed in (raw, corrected)
    )
    assert np.abs(lengths - after).max() < 1e-12
    assert np.allclose(np.linalg.det(corrected.rotation), 1)
    turned = {BODY.joint(f"{side}{name}") for side in ("Left", "Right") for name in ("UpLeg", "Leg")}
    others = [j for j in range(len(BODY.parents)) if j not in turned]
    assert np.array_equal(raw.rotation[:, others], corrected.rotation[:, others])
    assert np.abs(raw.rotation - corrected.rotation).max() > 0.01


def test_a_cycle_closes():
    found = case(walk(1.0))
    assert is_cyclic(found.track, found.feet.driving_leg)
    corrected = found.planted()
    assert np.abs(corrected.rotation[-1] - corrected.rotation[0]).max() < 1e-5
    moved = corrected.root[-1] - corrected.root[0]
    straight = found.track.positions[-1, 0] - found.track.positions[0, 0]
    assert abs(moved[1]) < 1e-5
    # Ahead the step may have another length; to the side there is no drift.
    side = np.cross(straight / np.linalg.norm(straight), [0, 1, 0])
    assert abs((moved - found.stride * straight) @ side) < 1e-5
    seam = np.diff(np.concatenate([corrected.root, corrected.root[1:3] + moved]), 2, axis=0)
    assert np.linalg.norm(seam, axis=-1)[-2:].max() <= 1.05 * np.linalg.norm(seam, axis=-1)[:-2].max()


def test_captured_cycles_end_about_as_they_begin():
    """The hands of one who walks are somewhere else after a cycle."""
    found = case(walk(1.0))
    leg, last = found.feet.driving_leg, found.track.positions.copy()
    last[-1, BODY.joint("LeftHand")] += [0.03 * leg, 0.03 * leg, 0.0]
    track = dataclasses.replace(found.track, positions=last)
    assert is_cyclic(track, leg)
    corrected = dataclasses.replace(found, track=track).planted()
    assert np.abs(corrected.rotation[-1] - corrected.rotation[0]).max() < 1e-5
    last[-1, BODY.joint("LeftHand")] += 0.1 * leg
    assert not is_cyclic(dataclasses.replace(found.track, positions=last), leg)


def test_a_cycle_in_place_does_not_drift():
    motion = walk(1.0)
    ramp = -np.linspace(0, 1, len(motion.root))[:, None] * (motion.root[-1] - motion.root[0])
    found = case(motion, path=ramp)
    contacts = find_contacts(found.track, found.feet.driving_leg)
    assert np.linalg.norm(contacts.ground_step) * motion.fps == pytest.approx(
        np.linalg.norm(motion.root[-1] - motion.root[0]) / (len(motion.root) - 1) * motion.fps, rel=0.1
    )
    corrected = found.planted()
    assert np.abs(corrected.root[-1] - corrected.root[0]).max() < 1e-5
    (before, driving), (after, _) = found.skate(found.posed()), found.skate(corrected)
    assert after < max(1.3 * driving, 0.7 * before)


def test_in_place_everyone_makes_the_steps_of_the_own_legs():
    """The ground moves as the own soles do: with the driving's, scaled, feet that are shorter would have to lunge."""
    motion = walk(1.0)
    here = case(motion, path=-np.linspace(0, 1, len(motion.root))[:, None] * (motion.root[-1] - motion.root[0]))
    posed, steps = here.posed(), []
    for longer in (1.0, 1.5):  # steps of the driving over those of the same directions
        scale = (longer * here.stride, here.stride)
        steps.append(np.ptp(here.soles(plant_feet(posed, here.track, here.skinned, here.feet, scale))[..., 2]))
    assert steps[1] == pytest.approx(steps[0], rel=0.02)
    assert steps[0] == pytest.approx(np.ptp(here.soles(posed)[..., 2]), rel=0.05)


@pytest.mark.parametrize(("every", "speed", "ground"), [(3, 5.0, 0.0), (5, 0.1, 0.3)])
def test_the_ground_of_who_runs_in_place_is_where_soles_are_fast(every, speed, ground):
    """In some frames they are on it, in the others slow, 0.3 leg lengths above; who is slow below has sunk."""
    low = np.arange(60) % every == 0
    heights, speeds = (np.where(low, *values)[:, None, None] for values in ((0.0, 0.3), (speed, 0.1)))
    assert _ground(heights, speeds) == ground


def test_nothing_changes_without_contacts():
    """Swimming: the hips are as low as the feet; flying: the feet move with the body."""
    motion = walk()
    lying = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    swim = dataclasses.replace(motion, rotmat=motion.rotmat.copy())
    swim.rotmat[:, 0] = lying @ swim.rotmat[:, 0]
    still, flight = (
        motion.rotmat[:1].repeat(len(motion.root), 0),
        np.arange(len(motion.root))[:, None] * [0.0, 0.1, 0.2],
    )
    for found in (case(swim), case(dataclasses.replace(motion, rotmat=still, root=flight))):
        raw, corrected = found.posed(), found.planted()
        assert np.array_equal(raw.rotation, corrected.rotation)
        assert np.array_equal(raw.root, corrected.root)


@pytest.mark.slow
def test_size_and_frame_rate_have_no_influence():
    small, large = walking().planted(), case(size=8.0, driving_size=10.0).planted()
    assert np.abs(large.rotation - small.rotation).max() < 1e-3
    assert np.abs(large.root / 10 - small.root).max() < 1e-3
    corrections = []
    for found in (walking(1.25), case(walk(fps=90.0), shin=1.25)):
        corrections.append((found.planted().root - found.posed().root)[:: round(found.track.fps / 30)])
    slow, fast = (correction - correction[0] for correction in corrections)
    assert np.abs(slow).max() > 0.02
    assert np.abs(fast - slow).max() < 0.3 * np.abs(slow).max()


def test_a_path_that_is_kept_is_kept():
    found = walking()
    corrected = found.planted(free_root=False)
    assert np.abs(corrected.root - found.posed().root)[:, [0, 2]].max() < 1e-6
    heights_only = found.planted(slides=False)
    assert np.array_equal(heights_only.root[:, [0, 2]], found.posed().root[:, [0, 2]])


def test_the_ankle_goes_to_its_target_as_far_as_the_leg_reaches():
    found = walking()
    raw = found.posed()
    positions, leg = found.joints(raw), LEGS[0]
    for offset in ([0.02, 0.01, 0.03], [0.0, -0.5, 0.0], [0.0, 0.0, 0.0]):
        rotation = move_ankle(raw.rotation, positions, leg, np.tile(offset, (len(positions), 1)), BODY.parents)
        after = found.joints(PosedJoints(rotation, raw.root))
        length = np.linalg.norm(np.diff(positions[:, list(leg)], axis=1), axis=-1).sum(axis=1)
        reach = np.linalg.norm(after[:, leg[2]] - after[:, leg[0]], axis=1)
        before = np.linalg.norm(positions[:, leg[2]] - positions[:, leg[0]], axis=1)
        assert (reach < np.maximum(LONGEST * length, before) + 1e-9).all()
        wanted = positions[:, leg[2]] + offset
        near = np.linalg.norm(wanted - after[:, leg[0]], axis=1) < LONGEST * length
        assert np.abs((after[:, leg[2]] - wanted)[near]).max(initial=0) < 1e-9
        # The knee bends to the front.
        assert ((after[:, leg[1]] - (after[:, leg[0]] + after[:, leg[2]]) / 2)[:, 2] > -0.03).all()


def test_a_trend_of_heights_does_not_go_on_where_no_foot_stands():
    """One foot stands in the middle third, and errors of its height grow there."""
    frames, standing = 60, slice(20, 40)
    weight, error = np.zeros((frames, 1)), np.zeros((frames, 1))
    weight[standing], error[standing, 0] = 1.0, np.linspace(0, 0.2, 20)
    root = _solve(weight, error, frames, 30.0, HEIGHTS, (False, False), np.array([False]))[0]
    assert root[39] - root[20] > 0.15
    assert np.ptp(root[:20]) < 0.01
    assert np.ptp(root[40:]) < 0.01


def test_contacts_have_no_gaps_and_intervals_that_are_too_short():
    contacts = find_contacts(walking().track, walking().feet.driving_leg)
    standing = np.zeros_like(contacts.standing)
    for start, stop in ((5, 20), (22, 30), (40, 42), (50, 60)):  # between frames: a gap of one frame, a blink, the end
        standing[start:stop] = 1.0
    contacts = dataclasses.replace(contacts, standing=standing)
    assert contacts.intervals(60.0) == 2 * [[(5, 31), (40, 43), (50, 61)]]
    assert contacts.intervals(100.0) == 2 * [[(5, 31), (50, 61)]]
    assert dataclasses.replace(contacts, standing=0 * standing).intervals(60.0) == [[], []]


ARMS = tuple(tuple(BODY.joint(f"{side}{name}") for name in ("Arm", "ForeArm", "Hand")) for side in ("Left", "Right"))


def plank():
    """Somebody supports himself on toes and straight arms, for two thirds of a second."""
    rotmat = np.tile(np.eye(3), (20, len(BODY.joint_names), 1, 1))
    rotmat[:, 0] = Rotation.from_euler("x", 73.3, degrees=True).as_matrix()
    for side, sign in (("Left", 1), ("Right", -1)):
        for part, axis, angle in (("Arm", "y", -80), ("ForeArm", "y", -10), ("Hand", "z", 75)):
            rotmat[:, BODY.joint(side + part)] = Rotation.from_euler(axis, sign * angle, degrees=True).as_matrix()
        rotmat[:, BODY.joint(f"{side}ToeBase")] = Rotation.from_euler("x", -50, degrees=True).as_matrix()
    return Motion("plank", BODY.joint_names, rotmat, np.zeros((20, 3)))


@pytest.mark.parametrize("arm", [0.85, 1.15])
def test_hands_stand_where_the_drivings_do(arm):
    """With longer arms they are in the floor, with shorter ones above it: elbows, hips and shoulders make up for it."""
    motion = plank()
    frames = motion_clip(BODY, np.zeros(0), motion).vertices.astype(float)
    (rest, rig), (vertices, own) = rig_of(np.zeros(0)), rig_of(np.zeros(0))
    for array in (vertices, own.joints):
        array[:, 0] = np.sign(array[:, 0]) * np.interp(abs(array[:, 0]), [0, 0.2, 2], [0, 0.2, 0.2 + arm * 1.8])
    skinned, leg = SkinnedMesh.of(vertices, own, BODY.parents), leg_length(rig.joints, LEGS)
    everyone = SurfacePoints.of_vertices(len(rest))
    mine, theirs = (find_soles(p, r, LEGS, BODY.parents, ARMS) for p, r in ((vertices, own), (rest, rig)))
    feet = Feet.of(LEGS, leg, mine, skinned, theirs, everyone, ARMS)
    assert feet is not None
    rotation, translation = BODY.skinning_transforms(BODY.joints, motion.rotmat, motion.root)
    positions = (rotation @ BODY.joints[..., None])[..., 0] + translation
    track = JointTrack(rotation, positions, motion.fps, np.stack([feet.driving.in_frame(frame)[0] for frame in frames]))
    assert track.soles is not None
    driving = track.soles[..., 1].min(axis=2)
    assert np.ptp(driving[0]) < 0.02
    posed = PosedJoints(rotation, positions[:, 0])

    def error(moved):
        return feet.identity_soles(moved.rotation, moved.root)[..., 1].min(axis=2) - driving

    before, planted = error(posed), plant_feet(posed, track, skinned, feet, (1.0, 1.0))
    assert np.abs(before[:, 2:]).min() > 0.06
    assert np.abs(error(planted)).max() < 0.02
    joints = skinned.joint_positions(planted.rotation[0], planted.root[0])
    bones = np.linalg.norm(np.diff(joints[list(ARMS[0])], axis=0), axis=1)
    np.testing.assert_allclose(bones, np.linalg.norm(np.diff(own.joints[list(ARMS[0])], axis=0), axis=1), atol=1e-6)


RESTS = {
    "sits": {"UpLeg": -93.0},
    "kneels": {"UpLeg": -5.0, "Leg": 96.0, "Foot": 75.0},
}
"""Turns of the joints of both legs about x (degrees) that bring a person who stands onto seat or knees."""


def going_down(name, frames=48):
    """A person who stands for a while, goes down in a second, and stays there: its lowest point is on the floor."""
    share = np.clip((np.arange(frames) - 12) / 20, 0, 1)
    turns = np.tile(np.eye(3), (frames, len(BODY.parents), 1, 1))
    for joint, angle in RESTS[name].items():
        for side in ("Left", "Right"):
            vectors = np.multiply.outer(share * np.radians(angle), [1.0, 0.0, 0.0])
            turns[:, BODY.joint(side + joint)] = Rotation.from_rotvec(vectors).as_matrix()
    still = Motion(name, BODY.joint_names, turns, np.zeros((frames, 3)), 20.0)
    lowest = motion_clip(BODY, np.zeros(0), still).vertices[..., 1].min(axis=1)
    return dataclasses.replace(still, root=np.multiply.outer(-lowest, [0.0, 1.0, 0.0]))


def resting(name, thicker, bones=3):
    """Return what goes down: the feet of both, heights of the driving, and the identity before and after planting.

    The heights are those of the lowest point of the body and of the lowest sole in each frame.

    Args:
        thicker: how much thicker than the driving the identity is.
        bones: joints of a leg; the others go with the last of these.
    """
    motion = going_down(name)
    frames = motion_clip(BODY, np.zeros(0), motion).vertices.astype(float)
    (rest, rig), (vertices, own) = rig_of(np.zeros(0)), rig_of(np.zeros(0))
    above_feet = np.clip((vertices[:, 1:2] - own.joints[LEGS[0][2], 1]) / 0.1, 0, 1)
    vertices = vertices + thicker * above_feet * vertex_normals(vertices, BODY.faces)
    skinned, leg = SkinnedMesh.of(vertices, own, BODY.parents), leg_length(rig.joints, LEGS)
    stiff = tuple(joints[:bones] for joints in LEGS)
    everyone = SurfacePoints.of_vertices(len(rest))
    mine, theirs = (find_soles(p, r, legs, BODY.parents) for p, r, legs in ((vertices, own, stiff), (rest, rig, LEGS)))
    bodies = tuple(body_points(p, r, legs, BODY.parents) for p, r, legs in ((vertices, own, stiff), (rest, rig, LEGS)))
    feet = Feet.of(stiff, leg, mine, skinned, theirs, everyone, bodies=(bodies[0], bodies[1]))
    assert feet is not None
    rotation, translation = BODY.skinning_transforms(BODY.joints, motion.rotmat, motion.root)
    positions = (rotation @ BODY.joints[..., None])[..., 0] + translation
    soles, body = (np.stack(points) for points in zip(*map(feet.driving.in_frame, frames), strict=True))
    track = JointTrack(rotation, positions, motion.fps, soles, body[..., 1].min(axis=1))
    turned = rotation.copy()
    for joints in stiff:
        turned[:, descendants([joints[-1]], BODY.parents)] = rotation[:, joints[-1], None]
    posed = PosedJoints(turned if bones < 3 else rotation, positions[:, 0])
    heights = np.stack([body[..., 1].min(axis=1), soles[..., 1].min(axis=(1, 2))])
    return feet, heights, posed, plant_feet(posed, track, skinned, feet, (1.0, 1.0))


@pytest.mark.parametrize("name", RESTS)
@pytest.mark.parametrize("thicker", [-0.03, 0.03])
def test_knees_and_seats_rest_where_the_drivings_do(name, thicker):
    """Those of a thicker person would be in the floor, those of a thinner one over it."""
    feet, driving, posed, planted = resting(name, thicker)

    def lowest(moved):
        heel = feet.identity_soles(moved.rotation, moved.root)[..., 1].min(axis=(1, 2))
        return np.stack([feet.identity_lowest(moved.rotation, moved.root), heel])

    before, after = lowest(posed) - driving, lowest(planted) - driving
    assert driving[0, -1] < 0.01
    assert np.abs(before[0, -1]) > 0.015
    assert np.abs(after[0, -1]) < 0.01
    assert np.abs(after[1]).max() < 0.005, "feet stay where they are"
    assert np.abs(np.diff(after)).max() < 0.02, "no step in a twentieth of a second"


def test_soles_stand_at_any_tilt():
    """The lowest contact point is as low as the lowest vertex, on heels and on toes."""
    whole, tilts = walking(), np.radians(np.arange(-40, 41, 20))
    turns = np.tile(np.eye(3), (len(tilts), len(BODY.joint_names), 1, 1))
    foot = Rotation.from_rotvec(np.multiply.outer(tilts, [1.0, 0.0, 0.0])).as_matrix()
    turns[:, descendants([leg[2] for leg in LEGS], BODY.parents)] = foot[:, None]
    root = np.tile(whole.posed().root[:1], (len(tilts), 1))
    lowest = whole.skinned.posed_frames(turns, root)[..., 1].min(axis=1)
    soles = whole.feet.identity_soles(turns, root)[..., 1].min(axis=(1, 2))
    np.testing.assert_allclose(soles, lowest, atol=0.003)


def test_blocks_rest_on_what_is_lowest():
    """Shins that do not bend reach through the floor on which those of who kneels lie."""
    feet, heights, posed, planted = resting("kneels", 0.0, bones=1)
    lowest = [feet.identity_lowest(of.rotation, of.root, with_soles=True) for of in (posed, planted)]
    before, after = lowest - heights.min(axis=0)
    assert np.ptp(before) > 0.05
    assert abs(after[-1] - after[0]) < 0.015
    assert np.ptp(after) < 0.03


@pytest.mark.parametrize(
    ("longer", "palms", "thicker", "raised"),
    [(1.35, True, 0.0, 0.0), (1.35, False, 0.0, 0.05), (1.0, True, 0.12, 0.05)],
)
def test_arms_and_seats_that_reach_lower_than_the_drivings_are_on_the_floor(longer, palms, thicker, raised):
    """The driving sits on the floor or over it, and its arms hang."""
    motion = going_down("sits")
    for side, angle in (("Left", -45), ("Right", 45)):
        motion.rotmat[:, BODY.joint(f"{side}Arm")] = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    motion.root[20:, 1] += raised
    (rest, rig), (vertices, own) = rig_of(np.zeros(0)), rig_of(np.zeros(0))
    on_trunk = BODY.weights[:, :3].sum(axis=1)[:, None]
    vertices += thicker * on_trunk * vertex_normals(vertices, BODY.faces)
    for array in (vertices, own.joints):
        array[:, 0] = np.sign(array[:, 0]) * np.interp(abs(array[:, 0]), [0, 0.2, 2], [0, 0.2, 0.2 + longer * 1.8])
    mine, theirs = (find_soles(p, r, LEGS, BODY.parents, ARMS) for p, r in ((vertices, own), (rest, rig)))
    mine = mine if palms else (*mine[:2], None, None)
    skinned, leg = SkinnedMesh.of(vertices, own, BODY.parents), leg_length(rig.joints, LEGS)
    feet = Feet.of(LEGS, leg, mine, skinned, theirs, SurfacePoints.of_vertices(len(rest)), ARMS)
    parts = LowParts.of(vertices, own, skinned, (LEGS, ARMS), mine)
    assert feet is not None
    assert parts is not None
    rotation, translation = BODY.skinning_transforms(BODY.joints, motion.rotmat, motion.root)
    positions = (rotation @ BODY.joints[..., None])[..., 0] + translation
    frames = motion_clip(BODY, np.zeros(0), motion).vertices.astype(float)
    track = JointTrack(rotation, positions, motion.fps, np.stack([feet.driving.in_frame(frame)[0] for frame in frames]))
    planted = plant_feet(PosedJoints(rotation, positions[:, 0]), track, skinned, feet, (1.0, 1.0))
    lifted = keep_above_floor(planted, track, parts, feet, 1.0)
    before, after = (skinned.posed_frames(of.rotation, of.root)[..., 1].min(axis=1) for of in (planted, lifted))
    assert before[-1] < -0.04
    assert after.min() > -0.02
    soles = [feet.identity_soles(of.rotation, of.root)[:, :2] for of in (planted, lifted)]
    np.testing.assert_allclose(*soles, atol=0.01)
    np.testing.assert_allclose(lifted.rotation[:4], planted.rotation[:4], atol=1e-5, err_msg="before it gets low")
    misread = SkinnedMesh.of(vertices - [0.0, 3.0, 0.0], own, BODY.parents)  # legs deep in the floor
    far = LowParts.of(vertices, own, misread, (LEGS, ARMS), mine)
    assert far is not None
    np.testing.assert_array_equal(keep_above_floor(planted, track, far, feet, 1.0).rotation, planted.rotation)
