"""`capture`: joints of a clip of surfaces are those that moved it, whatever its axes; files of them play as it does."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rigs
from people import walk
from zoo import ring

import mimesh
from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.core.errors import InputError, RefusedMeshError
from mimesh.core.geometry import angles_between, nearest_rotation
from mimesh.core.mesh import Clip, Mesh
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.motion import read_skeleton
from mimesh.motions import motion_clip
from mimesh.motions.bvh import load_bvh
from mimesh.motions.procedural import walk_motion

BODY = load_body()


@pytest.fixture(scope="module")
def clip() -> Clip:
    return walk(frames=12)


@pytest.fixture(scope="module")
def captured(clip) -> mimesh.CapturedClip:
    return mimesh.capture(clip)


def test_joints_are_found_in_a_t_pose_and_in_every_frame(captured, clip):
    assert captured.names == BODY.joint_names
    assert captured.rotation.shape == (len(clip), len(captured.names), 3, 3)
    assert captured.fps == clip.fps
    assert captured.report["confidence"] > 0.5
    place = dict(zip(captured.names, captured.rest, strict=True))
    arm = place["LeftHand"] - place["LeftArm"]
    assert arm[0] > 0.95 * np.linalg.norm(arm), "arms are horizontal, the left one to +x"
    assert place["LeftFoot"][1] < 0.2 * place["Head"][1]
    assert captured.rest[:, 1].min() == 0


def test_a_file_of_joints_has_the_motion(captured, tmp_path):
    path = captured.save(tmp_path / "walk.bvh")
    read = load_bvh(path)
    order = [captured.names.index(name) for name in read.joint_names]
    world = [read.rotmat[:, 0]]
    for j, parent in enumerate(read.parents[1:], 1):
        world.append(world[parent] @ read.rotmat[:, j])
    np.testing.assert_allclose(np.stack(world, axis=1), captured.rotation[:, order], atol=1e-4)
    np.testing.assert_allclose(read.root, captured.root, atol=1e-4)
    assert captured.save(tmp_path / "walk.vrma").stat().st_size > 1000
    with pytest.raises(InputError, match=r"expected one of \.bvh \.fbx \.glb \.gltf \.vrma for joints, found '\.obj'"):
        captured.save(tmp_path / "walk.obj")


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_gltf_file_of_joints_has_the_skeleton_and_the_motion(captured, suffix, tmp_path):
    document = open_document(captured.save(tmp_path / f"walk{suffix}"))
    read = read_skeleton(document)
    assert "meshes" not in document.gltf
    order = [captured.names.index(name) for name in read.joint_names]
    assert read.fps == captured.fps
    assert [read.joint_names[p] for p in read.parents[1:]] == [captured.names[captured.parents[j]] for j in order[1:]]
    world = [read.rotmat[:, 0]]
    for j, parent in enumerate(read.parents[1:], 1):
        world.append(world[parent] @ read.rotmat[:, j])
    np.testing.assert_allclose(np.stack(world, axis=1), captured.rotation[:, order], atol=2e-3)
    np.testing.assert_allclose(read.root, captured.root, atol=1e-6)


def test_the_unit_of_a_file_becomes_metres(captured, tmp_path):
    centimetres = dataclasses.replace(
        captured, rest=100 * captured.rest, root=100 * captured.root, report=captured.report | {"unit": 0.01}
    )
    for suffix in (".glb", ".vrma"):
        read = [read_skeleton(open_document(one.save(tmp_path / f"a{suffix}"))) for one in (captured, centimetres)]
        np.testing.assert_allclose(read[1].root, read[0].root, atol=1e-6)
        np.testing.assert_allclose(read[1].offsets, read[0].offsets, atol=1e-6)


@pytest.mark.slow
def test_feet_are_on_the_ground_by_turns():
    """Of a walk each foot stands for most of a step, and one of the two always."""
    seconds, fps = 2.0, 30.0
    clip = motion_clip(BODY, sample_shape(BODY, 0, 0), walk_motion(BODY, 0, 0, seconds=seconds, fps=fps))
    bare = dataclasses.replace(clip, mesh=Mesh(clip.mesh.vertices, BODY.faces, "walk"), skeleton=None, headings=None)
    report = mimesh.capture(bare).report
    contacts = report["contacts"]
    assert list(contacts) == ["LeftFoot", "RightFoot"]
    stands = np.zeros((2, len(clip)), bool)
    for foot, intervals in enumerate(contacts.values()):
        assert 1 <= len(intervals) <= 4
        for start, stop in intervals:
            assert 0 <= start < stop <= len(clip)
            stands[foot, start:stop] = True
    assert (stands.any(axis=0)).mean() > 0.9
    assert 0.4 < stands.mean() < 0.85
    assert 1.2 < report["height"] < 2.2
    assert "unit" not in report
    assert "contacts" not in mimesh.capture(bare, frames=mimesh.FrameRange(stop=2)).report


@pytest.mark.slow
def test_the_unit_is_that_of_the_file(tmp_path):
    mimesh.save_clip(walk(frames=2), tmp_path / "walk.glb")
    assert mimesh.capture(tmp_path / "walk.glb").report["unit"] == 1.0


@pytest.mark.slow
def test_axes_range_and_unit_of_the_clip_change_nothing_else(captured, clip):
    """z up, in centimetres, every second frame."""
    lying = 100 * np.stack([clip.vertices[..., 0], -clip.vertices[..., 2], clip.vertices[..., 1]], axis=-1)
    turned = Clip(Mesh(lying[0].astype(float), clip.mesh.faces, "lying"), lying, clip.fps)
    found = mimesh.capture(turned, hints=mimesh.Hints(up="+z", front="-y"), frames=mimesh.FrameRange(step=2))
    assert found.fps == clip.fps / 2
    assert np.median(angles_between(found.rotation, captured.rotation[::2])) < 3
    np.testing.assert_allclose(found.root, 100 * captured.root[::2], atol=3)


def test_joints_of_a_file_are_taken_as_they_are(captured, tmp_path):
    again = mimesh.capture(captured.save(tmp_path / "walk.bvh"))
    assert "confidence" not in again.report
    assert np.median(angles_between(again.rotation, captured.rotation)) < 1


@pytest.mark.slow
def test_joints_of_a_character_become_a_t_pose_in_any_order(captured, clip, tmp_path):
    """Its file lists children before parents."""
    moving = mimesh.animate(clip.mesh, clip).save_skinned(tmp_path / "moving.glb", names="unreal")
    found = mimesh.capture(moving)
    assert "confidence" not in found.report
    assert all(parent < j for j, parent in enumerate(found.parents))
    place = dict(zip(found.names, found.rest, strict=True))
    for name, joint in dict(zip(captured.names, captured.rest, strict=True)).items():
        if name in place and name != "Hips":
            ours, theirs = joint - captured.rest[0], place[name] - place["Hips"]
            assert np.linalg.norm(ours - theirs) < 0.06 * np.ptp(captured.rest[:, 1]), name


def test_a_note_names_the_joints_without_which_a_capture_moves_others_no_more(captured, tmp_path):
    """Figures of blocks have one joint for an arm."""
    blocks = rigs.figure().without("LeftForeArm", "RightForeArm")
    path = rigs.character(tmp_path / "blocks.glb", person=blocks, clips={"move": rigs.exercise(blocks)})
    found = mimesh.capture(path)
    assert any("has no joints for LeftForeArm, RightForeArm: " in note for note in found.notes)
    with pytest.raises(InputError, match="found none for LeftForeArm, RightForeArm"):
        mimesh.load_clip(found.save(tmp_path / "blocks.bvh"))
    assert not any("has no joints" in note for note in captured.notes)


@pytest.mark.slow
def test_smoothing_and_corrections_are_those_of_animate(captured, clip):
    smooth = mimesh.capture(clip, smooth=0.2)
    assert np.abs(np.diff(smooth.root, 2, axis=0)).mean() < np.abs(np.diff(captured.root, 2, axis=0)).mean()
    with pytest.raises(InputError, match="joints: expected names of joints, found 'Elbow'"):
        mimesh.capture(clip, hints=mimesh.Hints(joints={"Elbow": [0, 0, 0]}))


@pytest.mark.slow
def test_what_is_no_body_is_refused():
    with pytest.raises(RefusedMeshError, match=r"^ring: expected a person or a four-legged animal"):
        mimesh.capture(Clip.still(ring()))
    with pytest.raises(InputError, match="body: expected human, quadruped or auto, found other"):
        mimesh.capture(Clip.still(ring()), hints=mimesh.Hints(body="other"))


@pytest.mark.slow
def test_a_capture_moves_the_same_body_as_the_clip_did(tmp_path):
    shape = sample_shape(BODY, 0, 0)
    clip = motion_clip(BODY, shape, walk_motion(BODY, 0, 0, seconds=2.0, fps=30.0))
    bare = dataclasses.replace(clip, mesh=Mesh(clip.mesh.vertices, BODY.faces, "walk"), skeleton=None, headings=None)
    path = mimesh.capture(bare).save(tmp_path / "walk.bvh")
    rest = Mesh(BODY.posed(shape, np.tile(np.eye(3), (len(BODY.parents), 1, 1))), BODY.faces, "rest")
    moved = mimesh.animate(rest, path, motion=mimesh.MotionOptions(ground=False)).clip.vertices
    millimetres = []
    for mine, truth in zip(moved, np.asarray(clip.vertices, float), strict=True):
        centres = mine.mean(axis=0), truth.mean(axis=0)
        turn = nearest_rotation((truth - centres[1]).T @ (mine - centres[0]))
        millimetres.append(1e3 * np.linalg.norm((mine - centres[0]) @ turn.T - (truth - centres[1]), axis=1))
    assert np.mean(millimetres) < 5
    assert np.max(millimetres) < 25


def test_without_feet_nothing_is_said_of_when_they_are_on_the_ground():
    """Scans often end above the floor."""
    clip = walk(frames=8, faces=3000)
    low = clip.mesh.vertices[:, 1] < clip.mesh.vertices[:, 1].min() + 0.2
    legless = Mesh(clip.mesh.vertices, clip.mesh.faces[~low[clip.mesh.faces].any(axis=1)])
    report = mimesh.capture(Clip(legless, clip.vertices, clip.fps)).report
    assert "contacts" not in report
