"""Metrics of results without true vertices, on characters of prisms and on the shipped body."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from check_calibration import calibration_report

from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import Limb
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.mesh import Mesh
from mimesh.evaluate.limb_metrics import LimbedCharacter, limb_metrics

FIGURES = ("limb_deg", "end_effector", "sole_height")
ENDS = {"LeftArm": "LeftForeArm", "LeftForeArm": "LeftHand", "LeftUpLeg": "LeftLeg", "LeftLeg": "LeftFoot"}
ENDS |= {joint.replace("Left", "Right"): end.replace("Left", "Right") for joint, end in ENDS.items()}
# Joints of the character of prisms: parent, and the limb from start to end with its radius.
PRISMS = {
    "Trunk": (None, (0, 1.0, 0), (0, 1.5, 0), 0.15),
    "Head": ("Trunk", (0, 1.55, 0), (0, 1.8, 0), 0.1),
    "LeftArm": ("Trunk", (0.2, 1.45, 0), (0.5, 1.45, 0), 0.04),
    "LeftForeArm": ("LeftArm", (0.5, 1.45, 0), (0.8, 1.45, 0), 0.04),
    "RightArm": ("Trunk", (-0.2, 1.45, 0), (-0.5, 1.45, 0), 0.04),
    "RightForeArm": ("RightArm", (-0.5, 1.45, 0), (-0.8, 1.45, 0), 0.04),
    "LeftUpLeg": ("Trunk", (0.1, 1.0, 0), (0.1, 0.5, 0), 0.06),
    "LeftLeg": ("LeftUpLeg", (0.1, 0.5, 0), (0.1, 0.0, 0), 0.06),
    "RightUpLeg": ("Trunk", (-0.1, 1.0, 0), (-0.1, 0.5, 0), 0.06),
    "RightLeg": ("RightUpLeg", (-0.1, 0.5, 0), (-0.1, 0.0, 0), 0.06),
}


def prism(start, end, radius: float, sides: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Make a closed prism with outward normals between two points."""
    axis = (end - start) / np.linalg.norm(end - start)
    first = np.cross(axis, [0.0, 0.0, 1.0])
    angles = 2 * np.pi * np.arange(sides)[:, None] / sides
    ring = radius * (np.cos(angles) * first + np.sin(angles) * np.cross(axis, first))
    vertices = np.concatenate([start + ring, end + ring, [start, end]])
    k, following = np.arange(sides), (np.arange(sides) + 1) % sides
    side = np.concatenate(
        [np.stack([k, following, sides + k], 1), np.stack([following, sides + following, sides + k], 1)]
    )
    caps = [np.stack([following, k, np.full(sides, 2 * sides)], 1)]
    caps += [np.stack([sides + k, sides + following, np.full(sides, 2 * sides + 1)], 1)]
    return vertices, np.concatenate([side, *caps])


def character(vertices, faces, joint_names, parents, joints, weights) -> SkinnedCharacter:
    """Make a rigged character of dense weights."""
    transforms = np.tile(np.eye(4), (len(parents), 1, 1))
    transforms[:, :3, 3] = joints
    all_joints = np.tile(np.arange(len(parents)), (len(vertices), 1))
    points = np.repeat(vertices[:, None], len(parents), axis=1)
    return SkinnedCharacter(Mesh(vertices, faces), joint_names, parents, transforms, all_joints, weights, points)


def prisms(without: tuple[str, ...] = ()) -> LimbedCharacter:
    """Make a character of rigid prisms; limbs in `without` are part of the limb above."""
    names = [name for name in PRISMS if name not in without]
    vertices, faces, owner, limbs, count = [], [], [], {}, 0
    for j, name in enumerate(names):
        start, end = (np.array(point, float) for point in PRISMS[name][1:3])
        lower = {"Arm": "ForeArm", "UpLeg": "Leg"}
        below = next((name.replace(up, low) for up, low in lower.items() if name[-len(up) :] == up), None)
        if below in without:
            end = np.array(PRISMS[below][2], float)
        limbs[name] = Limb(j, start, end)
        points, triangles = prism(start, end, PRISMS[name][3])
        vertices.append(points), faces.append(triangles + count), owner.extend([j] * len(points))
        count += len(points)
    parents = tuple(names.index(parent) if (parent := PRISMS[name][0]) else -1 for name in names)
    joints = np.array([limb.start for limb in limbs.values()])
    rig = character(
        np.concatenate(vertices), np.concatenate(faces), tuple(names), parents, joints, np.eye(len(names))[owner]
    )
    return LimbedCharacter(rig, limbs)


def turned(figure: LimbedCharacter, **rotvecs) -> np.ndarray:
    """Pose a character of prisms: rotation vectors in degrees of the joints of limbs."""
    local = np.zeros((len(figure.character.parents), 3))
    for name, rotvec in rotvecs.items():
        local[figure.limbs[name].joint] = np.radians(rotvec)
    return figure.character.posed(rotvec_to_rotmat(local))


@cache
def human(i: int | None = None) -> LimbedCharacter:
    """Wrap the shipped body, of the mean shape or a random one, and find its limbs by joint names."""
    body = load_body()
    vertices, joints = body.shaped(np.zeros(1) if i is None else sample_shape(body, 3, i))
    rig = character(vertices, body.faces, body.joint_names, body.parents, joints, body.weights)
    at = {name: joints[body.joint(name)] for name in body.joint_names}
    limbs = {name: Limb(body.joint(name), at[name], at[end]) for name, end in ENDS.items()}
    limbs["Trunk"] = Limb(body.joint("Hips"), at["Hips"], at["Neck"])
    limbs["Head"] = Limb(body.joint("Neck"), at["Neck"], np.array([0.0, vertices[:, 1].max(), at["Head"][2]]))
    return LimbedCharacter(rig, limbs)


def pose(i: int) -> np.ndarray:
    body = load_body()
    return rotvec_to_rotmat(sample_pose(body, 5, i, JOINT_LIMITS))


def scaled(figure: LimbedCharacter, size: float) -> LimbedCharacter:
    rig = figure.character
    transforms = rig.T_world_joint.copy()
    transforms[:, :3, 3] *= size
    mesh = dataclasses.replace(rig.mesh, vertices=size * rig.mesh.vertices)
    rig = dataclasses.replace(rig, mesh=mesh, T_world_joint=transforms, points=size * rig.points)
    limbs = {name: Limb(limb.joint, size * limb.start, size * limb.end) for name, limb in figure.limbs.items()}
    return LimbedCharacter(rig, limbs)


def test_the_same_character_in_the_same_pose_has_no_error():
    figure = human(0)
    posed = figure.character.posed(pose(0))
    metrics = limb_metrics(figure, figure, posed + [1.0, 2.0, 3.0], posed)
    assert [metrics[name] for name in FIGURES] == pytest.approx([0] * 3, abs=1e-6)
    assert metrics["touching"] == 1
    assert set(figure.limbs) == {name.removeprefix("limb_deg ") for name in metrics if name.startswith("limb_deg ")}


@pytest.mark.slow
def test_two_people_in_one_pose_are_near():
    """Not 0: shapes turn the axes of their surfaces (thighs most), and bones have other proportions."""
    near, rest = [], []
    for i in range(8):
        identity, driving, rotmat = human(i), human(i + 30), pose(i)
        posed = driving.character.posed(rotmat)
        near.append(limb_metrics(identity, driving, identity.character.posed(rotmat), posed))
        rest.append(limb_metrics(identity, driving, identity.rest, posed))
    median = {name: np.median([metrics[name] for metrics in near]) for name in FIGURES}
    assert median["limb_deg"] < 2.5
    assert median["end_effector"] < 0.06
    assert median["sole_height"] < 0.02
    assert np.mean([metrics["touching"] for metrics in near]) > 0.9
    assert all(np.median([m[name] for m in rest]) > 8 * median[name] for name in ("limb_deg", "end_effector"))


def test_figures_do_not_depend_on_scale_and_translation():
    identity, driving = human(0), human(1)
    result, posed = identity.character.posed(pose(0)), driving.character.posed(pose(1))
    large, small = scaled(identity, 7.0), scaled(driving, 0.01)
    first = limb_metrics(identity, driving, result, posed)
    second = limb_metrics(large, small, 7 * result + [5.0, -3.0, 1.0], 0.01 * posed - 4.0)
    assert first["limb_deg"] > 5
    assert second == {name: pytest.approx(value, rel=1e-6, abs=1e-9) for name, value in first.items()}


def test_an_arm_of_one_joint_is_compared_as_a_whole():
    whole, parts = prisms(without=("LeftForeArm", "RightForeArm")), prisms()
    bent = turned(parts, LeftForeArm=(0, 0, 90))  # from the shoulder: 0.3 to the side, then 0.3 up
    metrics = limb_metrics(whole, parts, turned(whole, LeftArm=(0, 0, 45)), bent)
    assert metrics["limb_deg LeftArm"] == pytest.approx(0, abs=1e-6)
    assert "limb_deg LeftForeArm" not in metrics
    assert limb_metrics(parts, whole, bent, whole.rest)["limb_deg LeftArm"] == pytest.approx(45)


def test_end_effectors_are_in_lengths_of_the_limb():
    """A wrist at 90 degrees is half an arm up and to the side."""
    figure = prisms()
    right = limb_metrics(figure, figure, turned(figure, LeftForeArm=(0, 0, 90)), figure.rest)
    assert right["end_effector"] == pytest.approx(0.5 * np.sqrt(2) / 4)


def test_a_lifted_foot_changes_the_sole_and_a_knee_is_none():
    figure = prisms()
    lifted = turned(figure, LeftLeg=(90, 0, 0))  # the shin points back
    metrics = limb_metrics(figure, figure, lifted, figure.rest)
    assert metrics["sole_height"] == pytest.approx((0.5 - 0.06) / 2, abs=1e-6)  # the leg is 1 long, its radius 0.06
    assert metrics["touching"] == 0.5
    assert limb_metrics(figure, figure, lifted, lifted)["touching"] == 1
    metrics = limb_metrics(figure, figure, turned(figure, LeftLeg=(120, 0, 0)), figure.rest)
    foot = 0.5 + 0.5 * np.sin(np.pi / 6) - 0.06 * np.sin(np.pi / 3)  # the knee is at 0.5, the foot above it
    assert metrics["sole_height"] == pytest.approx(foot / 2, abs=1e-6)


def test_a_character_without_measurable_limbs_has_no_figures_and_a_result_at_one_point_has():
    figure = prisms()
    empty = LimbedCharacter(figure.character, {})
    metrics = limb_metrics(empty, figure, figure.rest, figure.rest)
    assert [metrics[name] for name in (*FIGURES, "touching")] == [None] * 4
    at_a_point = limb_metrics(figure, figure, np.zeros_like(figure.rest), turned(figure, LeftArm=(0, 0, 90)))
    assert at_a_point["limb_deg"] > 5


def vertices_of(figure: LimbedCharacter, name: str) -> np.ndarray:
    """Vertices that a limb carries."""
    return figure.weights[:, list(figure.limbs).index(name)] > 0.5


def with_surface(figure: LimbedCharacter, points, faces, weights) -> LimbedCharacter:
    """Add a surface to a character, weighted to its joints."""
    rig = figure.character
    vertices = np.concatenate([figure.rest, points])
    faces = np.concatenate([rig.mesh.faces, len(figure.rest) + faces])
    weights = np.concatenate([rig.weights, np.tile(weights, (len(points), 1))])
    return LimbedCharacter(character(vertices, faces, rig.joint_names, rig.parents, rig.joints, weights), figure.limbs)


def with_mesh(figure: LimbedCharacter, **changes) -> LimbedCharacter:
    """Change the mesh of a character."""
    rig = figure.character
    return LimbedCharacter(dataclasses.replace(rig, mesh=dataclasses.replace(rig.mesh, **changes)), figure.limbs)


@pytest.mark.parametrize("name", ["LeftForeArm", "RightLeg"])
def test_a_turned_limb_has_its_angle_as_error_and_its_twist_does_not_count(name):
    figure = prisms()
    metrics = limb_metrics(figure, figure, turned(figure, **{name: (0, 0, 20)}), figure.rest)
    wrong = {key: value for key, value in metrics.items() if key.startswith("limb_deg ") and value > 1e-6}
    assert wrong == {f"limb_deg {name}": pytest.approx(20)}
    assert metrics["limb_deg"] == pytest.approx(2)
    twist = (70, 0, 0) if name == "LeftForeArm" else (0, 70, 0)
    metrics = limb_metrics(figure, figure, turned(figure, **{name: twist}), figure.rest)
    assert metrics["limb_deg"] == pytest.approx(0, abs=1e-6)


def test_joints_beside_the_middle_of_a_limb_do_not_turn_its_axis():
    """The elbow is 2 cm in front, the wrist 2 cm behind: the line of joints of the forearm is turned by 8 degrees."""
    figure = human()
    limb = figure.limbs["LeftForeArm"]
    moved = Limb(limb.joint, limb.start + [0, 0, 0.02], limb.end - [0, 0, 0.02])
    other = LimbedCharacter(figure.character, {**figure.limbs, "LeftForeArm": moved})
    assert np.degrees(np.arctan2(0.04, np.linalg.norm(limb.end - limb.start))) > 7
    assert limb_metrics(other, figure, figure.rest, figure.rest)["limb_deg LeftForeArm"] < 1


def test_what_is_beside_a_limb_does_not_turn_its_axis():
    """A shield in front of the outer half of the forearm, a strip of cloth from there to the trunk, a belly."""
    figure = prisms()
    joint = figure.limbs["LeftForeArm"].joint
    ones = np.eye(len(figure.character.parents))
    shield = prism(np.array([0.7, 1.45, 0.3]), np.array([0.95, 1.45, 0.3]), 0.15)
    armed = with_surface(figure, *shield, ones[joint])
    assert limb_metrics(armed, figure, armed.rest, figure.rest)["limb_deg LeftForeArm"] < 1
    strip = np.array([[x, y, 0] for x in (0.5, 0.8) for y in (1.45, 1.37)])
    cloth = with_surface(figure, strip, np.array([[0, 1, 2], [2, 1, 3]]), (ones[joint] + ones[0]) / 2)
    bent = {"LeftForeArm": (0, 0, 60)}
    metrics = limb_metrics(cloth, figure, turned(cloth, **bent), turned(figure, **bent))
    assert metrics["limb_deg LeftForeArm"] < 3
    low = vertices_of(figure, "Trunk") & (figure.rest[:, 1] < 1.2)
    fat = with_mesh(figure, vertices=np.where(low[:, None], figure.rest + [0, 0, 0.1], figure.rest))
    assert np.degrees(np.arccos(fat.cuts["Trunk"].axis[1])) > 5
    assert limb_metrics(fat, figure, fat.rest, figure.rest)["limb_deg Trunk"] == pytest.approx(0, abs=1e-6)


def test_limbs_with_too_little_surface_are_left_out():
    """Of the forearm a triangle is left, which does not say how the limb is turned about it."""
    figure = prisms()
    faces = figure.character.mesh.faces
    removed = np.flatnonzero(vertices_of(figure, "LeftForeArm")[faces].all(axis=1))[1:]
    bare = with_mesh(figure, faces=np.delete(faces, removed, 0))
    metrics = limb_metrics(bare, figure, bare.rest, figure.rest)
    assert figure.limbs.keys() - bare.sections == {"LeftForeArm"}
    assert "limb_deg LeftForeArm" not in metrics
    assert metrics["limb_deg"] == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
def test_shape_hardly_turns_the_thigh():
    """Fat above the thigh is shared with the trunk; counted like the rest, it turns the axis by 5 degrees."""
    axes = np.array([human(i).cuts["LeftUpLeg"].axis for i in (*range(8), *range(30, 38))])
    assert np.median(np.degrees(np.arccos((axes[:8] * axes[8:]).sum(axis=1)))) < 4.4


@pytest.mark.parametrize("degrees", [0, 45])
def test_calibration_shows_the_pose_of_the_file(degrees):
    """A T-pose and an A-pose."""
    figure = prisms()
    rest = turned(figure, LeftArm=(0, 0, -degrees), RightArm=(0, 0, degrees))
    turn = np.radians(degrees)
    direction = np.array([np.cos(turn), -np.sin(turn), 0])
    limbs = dict(figure.limbs)
    for side in ("Left", "Right"):
        mirror = direction * ([1, 1, 1] if side == "Left" else [-1, 1, 1])
        shoulder = limbs[f"{side}Arm"].start
        elbow, wrist = shoulder + 0.3 * mirror, shoulder + 0.6 * mirror
        limbs[f"{side}Arm"] = Limb(limbs[f"{side}Arm"].joint, shoulder, elbow)
        limbs[f"{side}ForeArm"] = Limb(limbs[f"{side}ForeArm"].joint, elbow, wrist)
    rig = dataclasses.replace(figure.character, mesh=dataclasses.replace(figure.character.mesh, vertices=rest))
    report = calibration_report(rig, limbs)
    assert [report[name] for name in report if name.startswith("below")] == pytest.approx([degrees] * 4, abs=1e-6)
    straight = [report[name] for name in report if name.split()[0] in ("joint", "mirror", "down", "up", "front")]
    np.testing.assert_allclose(straight, 0, atol=1e-5)
