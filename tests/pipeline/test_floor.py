"""Results stand on the floor of their driving: soles to soles, from whatever frame a clip begins, on every route."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from motion_files import write_bvh
from people import person
from scipy.spatial.transform import Rotation

import mimesh
from mimesh import FrameRange, MotionOptions
from mimesh.bodies import load_body
from mimesh.core.mesh import Clip
from mimesh.motions.motion import Motion, leg_length

BODY = load_body()
FALL = 0.3 * np.square(np.linspace(1, 0, 6))
HEIGHTS = np.concatenate([FALL, np.zeros(6)])
"""Metres of a driving that comes down from the air: 0.3, 0.19, ... 0 for half of the clip."""
CLOSE = 2e-4
"""Metres; the surface is posed in single precision."""


def turned(**degrees: float) -> dict[str, np.ndarray]:
    """Return rotations about the z axis by joint."""
    return {name: Rotation.from_euler("z", angle, degrees=True).as_matrix() for name, angle in degrees.items()}


def landing(path, **degrees: float) -> str:
    """Write a rigged person who rests in a T-pose on the floor and comes down to it from the air."""
    figure = rigs.figure(0)
    # Of what does not move the file has no keys.
    sway = [{name: angle + 5 * height for name, angle in degrees.items()} for height in HEIGHTS]
    frames = [figure.pose(turned(**s), np.array([0.0, h, 0.0])) for s, h in zip(sway, HEIGHTS, strict=True)]
    return str(rigs.character(path, clips={"landing": frames}))


def hero(path, figure: rigs.Figure | None = None) -> str:
    """Write another person, on a rig with other names."""
    return str(rigs.character(path, 1, person=figure, name=renamed("mixamo")))


def stride() -> float:
    mine, theirs = (leg_length(rigs.figure(shape).joints, rigs.figure(shape).names) for shape in (1, 0))
    return mine / theirs


def sizes(result: mimesh.ClipResult) -> float:
    """Return the ratio of the normalised sizes of identity and driving."""
    assert result.driving is not None
    assert result.identity is not None
    first = result.driving.vertices[0]
    mine, theirs = (
        np.linalg.norm(points - (points.min(axis=0) + points.max(axis=0)) / 2, axis=1).max()
        for points in (result.identity.vertices, first)
    )
    return mine / theirs


def height_of(vertices: np.ndarray) -> np.ndarray:
    """Return the height of the lowest vertex in each frame over the floor that person 1 stands on at rest."""
    return vertices[..., 1].min(axis=-1) - rigs.figure(1).vertices[rigs.kept(), 1].min()


@pytest.mark.parametrize("ground", [True, False])
@pytest.mark.parametrize("stop", [None, 3])  # with the landing, and in the air alone
def test_a_clip_that_begins_in_the_air_comes_down_to_the_floor_of_the_rest_pose(ground, stop, model, tmp_path):
    driving = landing(tmp_path / "landing.glb")
    motion, frames = MotionOptions(ground=ground), FrameRange(stop=stop)
    result = mimesh.animate(hero(tmp_path / "hero.glb"), driving, model, motion=motion, frames=frames)
    assert result.own is not None
    np.testing.assert_allclose(height_of(result.clip.vertices), stride() * HEIGHTS[:stop], atol=CLOSE)


def test_the_floor_does_not_depend_on_the_triangles_of_the_driving(model, tmp_path):
    driving = mimesh.load_clip(landing(tmp_path / "landing.glb"))
    fewer = dataclasses.replace(driving.mesh, faces=driving.mesh.faces[::2])
    heroes = [
        mimesh.animate(hero(tmp_path / "hero.glb"), clip, model).clip.vertices
        for clip in (driving, dataclasses.replace(driving, mesh=fewer))
    ]
    np.testing.assert_allclose(*heroes, atol=1e-6)


@pytest.mark.slow
def test_a_motion_file_has_one_floor_whatever_part_of_it_is_taken(model, tmp_path):
    still = np.tile(np.eye(3), (len(HEIGHTS), len(BODY.parents), 1, 1))
    path = np.stack([0 * HEIGHTS, HEIGHTS, np.linspace(0, 0.2, len(HEIGHTS))], axis=1)
    bvh = write_bvh(tmp_path / "landing.bvh", BODY, Motion("landing", BODY.joint_names, still, path))
    mine = leg_length(rigs.figure(1).joints, rigs.figure(1).names) / leg_length(BODY.joints, BODY.joint_names)
    for start, stop in ((0, None), (0, 3), (8, 12)):
        result = mimesh.animate(hero(tmp_path / "hero.glb"), bvh, model, frames=FrameRange(start, stop))
        np.testing.assert_allclose(height_of(result.clip.vertices), mine * HEIGHTS[start:stop], atol=1e-3)


def test_joints_alone_that_never_land_stay_in_the_air(tmp_path):
    """The rest pose of the file stands on its floor; the lowest frames of the clip do not."""
    still = np.tile(np.eye(3), (4, len(BODY.parents), 1, 1))
    path = np.stack([np.zeros(4), [0.3, 0.35, 0.35, 0.3], np.zeros(4)], axis=1)
    bvh = write_bvh(tmp_path / "air.bvh", BODY, Motion("air", BODY.joint_names, still, path))
    lowest = mimesh.load_clip(bvh).vertices[...].min(axis=1)[:, 1]
    np.testing.assert_allclose(lowest, path[:, 1], atol=1e-5)


def test_frames_of_a_stream_are_on_the_floor_too(model, tmp_path):
    """Of vertices alone the floor is that of the lowest soles that are shown."""
    identity, shown = hero(tmp_path / "hero.glb"), mimesh.load_clip(landing(tmp_path / "landing.glb"))
    bare = dataclasses.replace(shown, skeleton=None)
    session = mimesh.prepare(identity, bare, model)
    recorded = mimesh.animate(identity, bare, model, motion=MotionOptions(ground=False)).clip.vertices
    frames = np.stack([session.pose(vertices) for vertices in shown.vertices])
    np.testing.assert_allclose(frames, recorded, atol=CLOSE)
    assert np.ptp(frames[:, 0, 1]) > 0.1


def test_vertices_that_are_moved_without_joints_begin_in_the_air(tmp_path):
    still = person(0)
    clip = Clip(still, np.stack([still.vertices + [0.0, height, 0.0] for height in HEIGHTS]), 30.0)
    moved = mimesh.animate(still, clip, "copy").clip.vertices
    np.testing.assert_allclose(moved[..., 1].min(axis=1) - still.vertices[:, 1].min(), HEIGHTS, atol=1e-5)
    identity, driving = rigs.character(tmp_path / "hero.glb", 1), landing(tmp_path / "landing.glb")
    rigged = mimesh.animate(identity, driving, "copy", frames=FrameRange(stop=3))
    np.testing.assert_allclose(height_of(rigged.clip.vertices), HEIGHTS[:3] * sizes(rigged), atol=CLOSE)


def test_what_hangs_below_the_soles_does_not_lift_a_person(model, tmp_path):
    """A staff in the hand: its tip is a metre below the floor while the arms hang."""
    driving = landing(tmp_path / "landing.glb", LeftArm=-80.0, RightArm=80.0)
    plain, hand = rigs.figure(1), rigs.figure(1).names.index("LeftHand")
    kept = rigs.kept()
    tip = kept[plain.weights[kept, hand].argmax()]
    vertices, weights = plain.vertices.copy(), plain.weights.copy()
    vertices[tip, 0] += 1.5
    weights[tip] = np.eye(len(plain.names))[hand]
    staff = dataclasses.replace(plain, vertices=vertices, weights=weights)
    found = []
    for figure in (plain, staff):
        result = mimesh.animate(
            hero(tmp_path / "hero.glb", figure), driving, model, motion=MotionOptions(contacts=False)
        ).clip.vertices
        found.append(result[:, kept != tip])
        np.testing.assert_allclose(height_of(found[-1]), stride() * HEIGHTS, atol=CLOSE)
    assert height_of(result).min() < -0.5
    np.testing.assert_allclose(found[0][..., 1], found[1][..., 1], atol=1e-5)


def astride(path, positions: bool) -> str:
    """Write a BVH of legs that spread up to 40 degrees, with or without the path of the hips."""
    rotmat = np.tile(np.eye(3), (12, len(BODY.parents), 1, 1))
    for side, sign in (("Left", 1), ("Right", -1)):
        angles = sign * 40 * np.sin(np.linspace(0, np.pi, 12))
        turns = Rotation.from_euler("z", angles[:, None], degrees=True).as_matrix()
        rotmat[:, BODY.joint(f"{side}UpLeg")] = turns
        rotmat[:, BODY.joint(f"{side}Foot")] = turns.swapaxes(-1, -2)
    write_bvh(path, BODY, Motion("astride", BODY.joint_names, rotmat, np.zeros((12, 3))))
    if not positions:
        head, rows = (
            path.read_text().replace("CHANNELS 6 Xposition Yposition Zposition", "CHANNELS 3").split("Frame Time")
        )
        first, *values = rows.strip().split("\n")
        path.write_text("\n".join([f"{head}Frame Time{first}", *(row.split(" ", 3)[3] for row in values)]) + "\n")
    return str(path)


@pytest.mark.parametrize("positions", [pytest.param(True, marks=pytest.mark.slow), False])
def test_without_a_path_the_lowest_sole_is_on_the_floor_in_every_frame(positions, model, tmp_path):
    identity, driving = hero(tmp_path / "hero.glb"), astride(tmp_path / "astride.bvh", positions)
    result = mimesh.animate(identity, driving, model)
    assert np.abs(height_of(result.clip.vertices)).max() < 0.01
    assert any("does not move its hips" in note and "; ground=False leaves" in note for note in result.notes)
    left = mimesh.animate(identity, driving, model, motion=MotionOptions(ground=False))
    assert left.skeleton is not None
    hips = left.skeleton.root[:, 1]
    assert np.ptp(hips) < 1e-6
    assert height_of(left.clip.vertices).max() > 0.15
    assert left.notes == ()
