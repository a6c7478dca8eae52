"""Fingers in `mime`: gestures on another person's hand, symmetries, clips, and hands that show no fingers."""

from functools import cache, partial

import numpy as np
import pytest
from grouped_options import grouped
from hand_gestures import GESTURES, finger_rotations, fingertips, gestures, within_limits

import mimesh
from mimesh.bodies import load_body
from mimesh.bodies.hands import body_with_fingers, load_hands
from mimesh.bodies.joint_names import finger_joints, named_fingers, named_joints
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.geometry import MIRROR, rigid_motion
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.normalization import Normalization
from mimesh.methods.find import find_mime
from mimesh.methods.onnx_models import load_hand_finder
from mimesh.mime.body_fit import SurfaceSample
from mimesh.mime.hands import DIFFERENT_ABOVE, SAME_BELOW, settled_bends
from mimesh.pipeline.file_rigs import NO_RIGS
from mimesh.pipeline.joint_route import joint_route
from mimesh.pipeline.known import Known
from mimesh.pipeline.placed import KEYFRAMES, surface_motion

pytestmark = pytest.mark.usefixtures("kept")
AXES = {"up": "+y", "front": "+z", "driving_up": "+y", "driving_front": "+z"}
BODY = body_with_fingers()
PERSON_HEIGHT_MM = 1700.0


def person(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=16)


def pose(gesture: str) -> np.ndarray:
    """Give both hands a gesture; the rest of the body stays at rest."""
    angles = within_limits(gestures(np.array([GESTURES.index(gesture)]), np.random.default_rng(0)))[0]
    rotmat = np.tile(np.eye(3), (55, 1, 1))
    rotmat[25:40], rotmat[40:] = finger_rotations(angles, left=True), finger_rotations(angles, left=False)
    return rotmat


def mesh(seed: int, gesture: str | None = None) -> Mesh:
    rotmat = np.tile(np.eye(3), (55, 1, 1)) if gesture is None else pose(gesture)
    return Mesh(BODY.posed(person(seed), rotmat), BODY.faces, name=f"{gesture}{seed}")


def tip_error(vertices: np.ndarray, truth: np.ndarray) -> float:
    """Measure the mean error of the fingertips in the palm's frame, in mm on a person of 1.7 m."""
    distances = []
    for side in ("Left", "Right"):
        palm = BODY.weights[:, BODY.joint(f"{side}Hand")] > 0.5
        of_fingers = [BODY.joint(name) for name in finger_joints(side)]
        tips = fingertips(BODY.vertices, BODY.weights[:, of_fingers], BODY.joints[of_fingers])
        rotation, offset = rigid_motion(vertices[palm], truth[palm])
        distances.append(np.linalg.norm(vertices[tips] @ rotation.T + offset - truth[tips], axis=1))
    return float(PERSON_HEIGHT_MM * np.mean(distances) / np.ptp(truth[:, 1]))


@cache
def moved(identity: int, driving: int, gesture: str | None = None, model: str = "mime"):
    return mimesh.transfer(mesh(identity), mesh(driving, gesture), model, **grouped(**AXES))


@pytest.mark.slow
@pytest.mark.parametrize("gesture", ["fist", "thumb up"])
def test_a_gesture_comes_to_another_persons_hand(gesture):
    truth = BODY.posed(person(1), pose(gesture))
    new, rigid = (moved(1, 2, gesture, model) for model in ("mime", "mime-rigid-fingers"))
    assert new.report["fingers"] == ["left", "right"]
    assert rigid.report["fingers"] == []
    assert tip_error(new.vertices, truth) < max(0.5 * tip_error(rigid.vertices, truth), 8.0)


@pytest.mark.slow
def test_hands_that_are_bent_alike_keep_their_joints():
    """Errors of the predictions must not bend fingers that the driving does not bend."""
    assert moved(3, 4).report["fingers"] == []
    assert np.array_equal(moved(3, 4).vertices, moved(3, 4, None, "mime-rigid-fingers").vertices)


@pytest.mark.slow
def test_hands_may_point_anywhere():
    """The driving person turned about the vertical and with bent arms has the same fingers."""
    rotmat = pose("fist")
    rotmat[0] = rotvec_to_rotmat(np.array([0.0, 0.6, 0.0]))
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        rotmat[BODY.joint(f"{side}Arm")] = rotvec_to_rotmat(np.array([0.0, -0.4 * sign, -1.0 * sign]))
        rotmat[BODY.joint(f"{side}ForeArm")] = rotvec_to_rotmat(np.array([0.0, -0.8 * sign, 0.0]))
    driving = Mesh(BODY.posed(person(2), rotmat), BODY.faces, name="turned")
    result = mimesh.transfer(mesh(1), driving, **grouped(**AXES))
    assert tip_error(result.vertices, BODY.posed(person(1), rotmat)) < 25


@pytest.mark.slow
def test_mirrored_meshes_give_the_mirrored_fingers():
    left_only = np.tile(np.eye(3), (55, 1, 1))
    left_only[25:40] = pose("fist")[25:40]
    driving = Mesh(BODY.posed(person(2), left_only), BODY.faces, name="left fist")
    result = mimesh.transfer(mesh(1), driving, **grouped(**AXES)).vertices
    flipped = [Mesh(m.vertices * MIRROR, m.faces[:, ::-1], name=m.name) for m in (mesh(1), driving)]
    mirrored = mimesh.transfer(*flipped, **grouped(**AXES)).vertices * MIRROR
    assert np.linalg.norm(result - mirrored, axis=1).mean() * PERSON_HEIGHT_MM / np.ptp(result[:, 1]) < 6


@pytest.mark.slow
def test_stumps_change_nothing_to_the_last_bit():
    """An identity without fingers is moved as without the network of hands, whatever the driving's fingers do."""
    whole = mesh(1)
    shares = load_hands().shares
    kept = (shares[:, :, 0] > 0.5).all(axis=0)
    rank = np.cumsum(kept) - 1
    faces = whole.faces[kept[whole.faces].all(axis=1)]
    stumps = Mesh(whole.vertices[kept], rank[faces], name="stumps")
    moved = mimesh.transfer(stumps, mesh(2, "fist"), **grouped(**AXES))
    assert moved.report["fingers"] == []
    rigid = mimesh.transfer(stumps, mesh(2, "fist"), "mime-rigid-fingers", **grouped(**AXES))
    assert np.array_equal(moved.vertices, rigid.vertices)


@pytest.mark.slow
def test_fingers_with_holes_follow_their_hand():
    """A scan with a hole in a finger says little about its bend."""
    driving = mesh(2, "fist")
    tip = np.argmax(driving.vertices[:, 0])
    near = np.linalg.norm(driving.vertices - driving.vertices[tip], axis=1) < 0.03
    pierced = Mesh(driving.vertices, driving.faces[~near[driving.faces].any(axis=1)], name="pierced")
    assert moved(1, 2, "fist").report["fingers"] == ["left", "right"]
    assert mimesh.transfer(mesh(1), pierced, **grouped(**AXES)).report["fingers"] == ["right"]


@pytest.mark.slow
def test_fingers_are_followed_through_a_clip():
    """From a flat hand to a fist and back: fingers move with the driving's, and end where they began."""
    angles = within_limits(gestures(np.array([GESTURES.index("fist")]), np.random.default_rng(0)))[0]
    frames, truth = [], []
    for share in (0.0, 0.6, 0.9, 0.0):
        rotmat = np.tile(np.eye(3), (55, 1, 1))
        rotmat[25:40] = finger_rotations(share * angles, left=True)
        rotmat[40:] = finger_rotations(share * angles, left=False)
        frames.append(BODY.posed(person(2), rotmat))
        truth.append(BODY.posed(person(1), rotmat))
    clip = Clip(Mesh(frames[0], BODY.faces, name="closing"), np.stack(frames), 30.0)
    result = mimesh.animate(mesh(1), clip, **grouped(**AXES))
    errors = [tip_error(moved, true) for moved, true in zip(result.clip.vertices, truth, strict=True)]
    assert max(errors) < 15
    assert np.abs(result.clip.vertices[0] - result.clip.vertices[-1]).max() < 1e-3
    skeleton = result.skeleton
    assert skeleton is not None
    assert len(skeleton.names) == 61
    joints = named_joints(skeleton.names, skeleton.parents)
    found = named_fingers(skeleton.names, skeleton.parents, joints)
    assert [skeleton.names[j] for j in found.values()] == [*finger_joints("Left"), *finger_joints("Right")]
    assert np.allclose(skeleton.rig.weights.sum(axis=1), 1.0)
    assert skeleton.deviation(result.frames) < 5e-3


@pytest.mark.slow
def test_prepared_fingers_are_called_as_by_mixamo():
    mime = find_mime("mime")
    identity, driving = mesh(1), mesh(2, "point")
    norms = [Normalization.fit(m, "+y", "+z") for m in (identity, driving)]
    meshes = [Mesh(n.apply(m.vertices), m.faces, name=m.name) for n, m in zip(norms, (identity, driving), strict=True)]
    clip = Clip.still(meshes[1])
    surface = partial(surface_motion, clip, Normalization.fit(meshes[1], "+y", "+z"))
    character, motion = mime.with_fingers(mime.rig(meshes[0]), meshes[0], mime.capture(clip), surface)
    assert character.joints[31:34] == ("LeftHandThumb1", "LeftHandThumb2", "LeftHandThumb3")
    assert character.joints[-1] == motion.joints[-1] == "RightHandPinky3"
    assert np.allclose(character.rig.weights.sum(axis=1), 1.0)


def test_small_differences_of_bends_are_settled_and_large_ones_stay():
    rng = np.random.default_rng(0)
    axis = rng.normal(size=(15, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    driving = rotvec_to_rotmat(rng.normal(size=(15, 3)))
    near, far = (driving @ rotvec_to_rotmat(np.radians(a) * axis) for a in (0.9 * SAME_BELOW, 1.1 * DIFFERENT_ABOVE))
    assert np.allclose(settled_bends(near, driving), driving)
    assert np.allclose(settled_bends(far, driving), far)


def test_hands_of_any_number_of_vertices_take_bounded_memory(monkeypatch):
    """The network gets a few queries at a time, which changes no weight but for rounding."""
    finder = load_hand_finder(load_body().joint_names)
    rng = np.random.default_rng(0)
    points, queries = (SurfaceSample(*rng.normal(0, 0.05, (2, n, 3))) for n in (finder.network.points, 70))
    whole = finder.network._run_in_chunks(points, queries)
    monkeypatch.setattr("mimesh.mime.hands.CHUNK", 30)
    np.testing.assert_allclose(finder.network._run_in_chunks(points, queries).scores, whole.scores, atol=1e-4)


@pytest.mark.slow
def test_corrected_joints_stay_where_they_are_put_and_the_others_can_be_passed_back():
    identity, driving = mesh(1), mesh(2, "fist")
    plain = moved(1, 2, "fist")
    assert plain.joints is not None
    assert plain.driving_joints is not None
    known = [{name: found[name] + [0.0, 0.02, 0.01] for name in ("LeftHand", "RightForeArm", "LeftFingerBase")}
             for found in (plain.joints, plain.driving_joints)]  # fmt: skip
    result = mimesh.transfer(identity, driving, **grouped(**AXES, joints=known[0], driving_joints=known[1]))
    assert result.report["fingers"] == ["left", "right"]
    for found, positions in ((result.joints, known[0]), (result.driving_joints, known[1])):
        assert found is not None
        for name, position in positions.items():
            np.testing.assert_allclose(found[name], position, atol=1e-6)
    again = mimesh.transfer(
        identity, driving, **grouped(**AXES, joints=plain.joints, driving_joints=plain.driving_joints)
    )
    assert again.report["fingers"] == ["left", "right"]
    assert np.abs(again.vertices - plain.vertices).max() < 0.05


@pytest.mark.slow
def test_planted_feet_are_those_without_fingers():
    """Soles and the correction of the legs are the same to rounding, whether fingers move or not."""
    left = np.tile(np.eye(3), (55, 1, 1))
    frames = []
    for t in range(5):
        rotmat = pose("fist") if t % 2 else left.copy()
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            rotmat[BODY.joint(f"{side}UpLeg")] = rotvec_to_rotmat(np.array([0.3 * sign * np.sin(t / 2), 0.0, 0.0]))
        frames.append(BODY.posed(person(2), rotmat))
    clip = Clip(Mesh(frames[0], BODY.faces, name="walk"), np.stack(frames), 15.0)
    moved, rigid = (mimesh.animate(mesh(1), clip, model, **grouped(**AXES)) for model in ("mime", "mime-rigid-fingers"))
    assert moved.report["fingers"] == ["left", "right"]
    feet = BODY.weights[:, [BODY.joint(f"{side}{part}") for side in ("Left", "Right") for part in ("Foot", "ToeBase")]]
    on_foot = feet.sum(axis=1) > 0.9
    apart = moved.clip.vertices[:, on_foot] - rigid.clip.vertices[:, on_foot]
    # The first frame's bounding box, which has fingers in it, says where the whole result stands.
    assert np.abs(apart - apart[0, 0]).max() < 1e-5


def test_bodies_without_forearms_or_without_the_network_of_hands_have_no_fingers(monkeypatch):
    joints = load_body().joint_names
    assert load_hand_finder(joints) is not None
    assert load_hand_finder(tuple(name for name in joints if name != "LeftForeArm")) is None
    assert load_hand_finder(tuple(name for name in joints if name != "RightHand")) is None
    monkeypatch.setattr("mimesh.methods.onnx_models.HANDS", "missing.onnx")
    assert load_hand_finder(joints) is None


@pytest.mark.slow
def test_a_fist_between_two_keyframes_moves_the_fingers():
    model, frames = find_mime("mime"), np.repeat(mesh(2).vertices[None], 200, axis=0)
    assert not {95, 96, 97, 98} & set(np.linspace(0, 199, KEYFRAMES).round().astype(int))
    for gesture, joints in ((None, 31), ("fist", 61)):
        frames[95:99] = mesh(2, gesture).vertices
        clip = Clip(mesh(2), frames.astype(np.float32), 30.0)
        route = joint_route(mesh(1), clip, model, Known(tuple(AXES.values())), NO_RIGS)
        assert len(route.retarget.character.joints) == joints
