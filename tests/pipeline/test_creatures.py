"""Creatures with other limbs move on their own bones as other creatures do, or are refused."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import rigs
from creatures import BIRD, SPIDER, Boxes, flapping, snake
from matrix import matrix
from scipy.spatial.transform import Rotation

from mimesh import animate, transfer
from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.options import Hints, MotionOptions
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.own_animation import OwnAnimation, write_own_animations

WAY = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.2], [0.2, 0.3, 0.4], [0.3, 0.0, 0.6]])


TABLES = {"bird": BIRD, "spider": SPIDER, "snake": snake(6)}
BEAK = {"Beak": ("Head", (0, 0.2, 0.7), (0, 0.2, 0.85))}
"""One joint more than other birds have: animations of an equal skeleton would be copied."""


def error(moved: np.ndarray, truth: np.ndarray) -> float:
    """Return the largest distance over the size of the first frame."""
    return float(np.linalg.norm(moved - truth, axis=-1).max() / np.ptp(truth[0], axis=0).max())


@matrix("name", TABLES, quick=["spider"])
def test_a_creature_gets_its_own_motion_back_from_a_renamed_copy(name, tmp_path):
    mine = Boxes.of(TABLES[name])
    frames = flapping(mine.names)
    path = mine.write(tmp_path / "mine.glb", frames, WAY)
    copy = mine.renamed(1)
    names = {name: copy.names[int(np.abs(copy.rig.joints - place).sum(axis=1).argmin())]
             for name, place in zip(mine.names, mine.rig.joints, strict=True)}  # fmt: skip
    turns = [{names[name]: turn for name, turn in frame.items()} for frame in frames]
    other = copy.write(tmp_path / "copy.glb", turns, WAY)
    result = animate(load_mesh(path), load_clip(other), hints=Hints(body="other"))
    assert result.report["rig"] == "own"
    assert error(result.clip.vertices, load_clip(path).vertices) < 1e-5
    assert error(result.clip.vertices, np.repeat(mine.mesh.vertices[None], 4, axis=0)) > 0.1


@pytest.mark.slow
def test_a_bird_moves_as_a_larger_one_that_faces_elsewhere(tmp_path):
    """The truth is the identity under the same turns about its own axes, and the way at its own size."""
    small, turn = Boxes.of(BIRD | BEAK), Rotation.from_euler("y", 90, degrees=True).as_matrix()
    large = Boxes.of(BIRD, size=3.0, turn=turn)
    frames = flapping(small.names, seed=2)
    turned = [{name: turn @ vector for name, vector in frame.items()} for frame in frames]
    one = small.write(tmp_path / "small.glb")
    two = large.write(tmp_path / "large.glb", turned, 3 * WAY @ turn.T)
    truth = np.stack([small.posed(small.world(turns), way) for turns, way in zip(frames, WAY, strict=True)])
    result = animate(load_mesh(one), load_clip(two), hints=Hints(body="other"))
    scale = np.linalg.norm(np.ptp(small.mesh.vertices, axis=0)) / np.linalg.norm(np.ptp(large.mesh.vertices, axis=0))
    assert error(result.clip.vertices, truth) < 3 * abs(3 * scale - 1) + 1e-4
    for root, way in (("drop", 0.0), ("keep", 1.0)):
        moved = animate(
            load_mesh(one), load_clip(two), hints=Hints(body="other"), motion=MotionOptions(root=root)
        ).clip.vertices
        shift = moved - result.clip.vertices
        across = WAY @ turn.T * 3 * [1, 0, 1]
        expected = (way - scale) * across @ turn
        np.testing.assert_allclose(shift, np.repeat(expected[:, None], shift.shape[1], axis=1), atol=1e-4)


def test_a_snake_bends_as_one_of_fewer_joints(tmp_path):
    """Its tail ends in the direction of the other's, and bends as much in the middle."""
    creatures = {4: Boxes.of(snake(4, "Tail")), 8: Boxes.of(snake(8, "Rear"))}
    for count, joints in ((8, 4), (4, 8)):
        moving = [name for name in creatures[joints].names if name[:4] in ("Tail", "Rear")]
        bent = [{}, {name: np.array([0, 1.2 / joints, 0]) for name in moving}]
        identity, driving = (
            creatures[count].write(tmp_path / "a.glb"),
            creatures[joints].write(tmp_path / "b.glb", bent),
        )
        result = animate(load_mesh(identity), load_clip(driving), hints=Hints(body="other"))
        names = [str(node.get("name")) for node in result.own.source.document.gltf["nodes"]]
        turned = result.own.node_matrices(range(len(names)))[1, :, :3, :3]
        tail = [k for k, name in enumerate(names) if name[:4] in ("Tail", "Rear")]
        angles = Rotation.from_matrix(turned[[tail[count // 2 - 1], tail[-1]]]).as_rotvec()[:, 1]
        np.testing.assert_allclose(angles, [0.6, 1.2], atol=0.16)


def test_limbs_bend_across_themselves_wherever_they_point(tmp_path):
    """A tail that hangs down wags to the side where the other's, which points back, does."""
    tail = {"Tail1": ("Body", (0, 0, -0.1), (0, -0.3, -0.2)), "Tail2": ("Tail1", (0, -0.3, -0.2), (0, -0.7, -0.2))}
    hanging = BIRD | BEAK | tail
    one, two = Boxes.of(hanging), Boxes.of(BIRD)
    wag = [{}, {"Tail1": np.array([0, 0.6, 0])}]
    result = animate(
        load_mesh(one.write(tmp_path / "a.glb")),
        load_clip(two.write(tmp_path / "b.glb", wag)),
        hints=Hints(body="other"),
    )
    moved = result.clip.vertices[1] - result.clip.vertices[0]
    tip = one.rig.weights[:, one.names.index("Tail2")] == 1
    aside = two.posed(two.world(wag[1]), np.zeros(3)) - two.mesh.vertices
    other = aside[two.rig.weights[:, two.names.index("Tail2")] == 1]
    assert np.sign(moved[tip, 0].mean()) == np.sign(other[:, 0].mean())
    assert abs(moved[tip, 0].mean()) > 0.7 * abs(other[:, 0].mean())


def test_feet_on_the_root_stay_at_legs_of_another_length(tmp_path):
    longer = {  # with other names, so that nothing is copied
        name.replace("Leg", "Claw"): (
            parent.replace("Leg", "Claw"),
            tuple(np.array(place) * [1.3, 1, 1.2]),
            tuple(np.array(end) * [1.3, 1, 1.2]),
        )
        for name, (parent, place, end) in SPIDER.items()
    }
    mine, theirs = Boxes.of(longer), Boxes.of(SPIDER)
    frames = [{}, {name: np.array([0.0, 0.3, 0.2]) for name in SPIDER if "Upper" in name}]
    world = np.stack([theirs.world(turns) for turns in frames])
    # Feet of animators stay where the legs end: moved by themselves.
    path = theirs.write(tmp_path / "driving.glb", frames)
    source = load_mesh(path).source
    names = [node.get("name") for node in source.document.gltf["nodes"]]
    tracks = {}
    for t in (1,):
        posed = theirs.skeleton(world, np.zeros((2, 3))).joint_positions()[t]
        for j, name in enumerate(theirs.names):
            if "Foot" in name:
                leg = theirs.names.index(name.replace("Foot", "Lower"))
                step = world[t, leg] @ (theirs.rig.joints[j] - theirs.rig.joints[leg])
                ends = np.stack([theirs.rig.joints[j], posed[leg] + step])
                tracks[names.index(name), "translation"] = ends
    for j, name in enumerate(theirs.names):
        if "Upper" in name:
            quaternions = Rotation.from_matrix(world[:, j]).as_quat()
            tracks[names.index(name), "rotation"] = quaternions
    write_own_animations([OwnAnimation(source, "walk", tracks, 30.0, 2, {})], path)
    result = animate(
        load_mesh(mine.write(tmp_path / "mine.glb")), load_clip(path, animation="walk"), hints=Hints(body="other")
    )
    nodes = [node.get("name") for node in result.own.source.document.gltf["nodes"]]
    places = result.own.node_matrices(range(len(nodes)))[..., :3, 3]
    for name in mine.names:
        if "Foot" in name:
            foot, leg = (places[:, nodes.index(joint)] for joint in (name, name.replace("Foot", "Lower")))
            before, after = np.linalg.norm(foot - leg, axis=1)
            assert after == pytest.approx(before, rel=0.01)
            assert np.linalg.norm(foot[1] - foot[0]) > 0.1


def test_stretching_is_kept(tmp_path):
    """A slime: one joint that its animation scales unequally."""
    slime = Boxes.of({"Root": ("", (0, 0, 0), (0, 0, 0)), "Body": ("Root", (0, 0, 0), (0, 1, 0))}, thick=0.5)
    path = slime.write(tmp_path / "slime.glb")
    source = load_mesh(path).source
    node = [entry.get("name") for entry in source.document.gltf["nodes"]].index("Body")
    squash = np.array([[1.0, 1.0, 1.0], [1.3, 0.6, 1.3]])
    write_own_animations([OwnAnimation(source, "squash", {(node, "scale"): squash}, 30.0, 2, {})], path)
    one = Boxes.of({"Root": ("", (0, 0, 0), (0, 0, 0)), "Blob": ("Root", (0, 0, 0), (0, 1.2, 0))}, thick=0.5)
    result = animate(
        load_mesh(one.write(tmp_path / "one.glb")), load_clip(path, animation="squash"), hints=Hints(body="other")
    )
    np.testing.assert_allclose(result.clip.vertices[1], result.clip.vertices[0] * squash[1], atol=1e-5)


def test_a_pose_is_transferred_and_the_rig_kept(tmp_path):
    truth = Boxes.of(BIRD | BEAK)
    one = truth.write(tmp_path / "one.glb")
    poses = flapping(tuple(BIRD), 2)[1:]
    table = {
        name: (parent, tuple(np.array(p) * 1.1), tuple(np.array(e) * 1.1)) for name, (parent, p, e) in BIRD.items()
    }
    two = Boxes.of(table)
    path = two.write(tmp_path / "two.glb", poses)
    clip = load_clip(path)
    still = dataclasses.replace(clip, vertices=clip.vertices[:1])
    out = tmp_path / "out.glb"
    result = animate(load_mesh(one), still, hints=Hints(body="other"))
    result.save_skinned(out)
    written = json.loads(out.read_bytes()[20 : 20 + int.from_bytes(out.read_bytes()[12:16], "little")])
    before = json.loads(one.read_bytes()[20 : 20 + int.from_bytes(one.read_bytes()[12:16], "little")])
    assert [node.get("name") for node in written["nodes"]] == [node.get("name") for node in before["nodes"]]
    assert written["skins"][0]["joints"] == before["skins"][0]["joints"]
    assert error(result.clip.vertices, truth.posed(truth.world(poses[0]), np.zeros(3))[None]) < 0.02
    posed = transfer(load_mesh(one), load_mesh(path), hints=Hints(body="other"))
    assert posed.report["match"]["confidence"] > 0.8


@pytest.mark.slow
def test_rigs_say_by_themselves_that_they_are_of_creatures(tmp_path, capsys):
    """Through the command line, without --body: neither names nor surfaces are those of a person."""
    small = {
        name: (parent, tuple(np.array(p) * 0.9), tuple(np.array(e) * 0.9)) for name, (parent, p, e) in BIRD.items()
    }
    one = Boxes.of(small | {"Beak": ("Head", (0, 0.2, 0.6), (0, 0.2, 0.8))}).write(tmp_path / "one.glb")
    two = Boxes.of(BIRD).write(tmp_path / "two.glb", flapping(tuple(BIRD)))
    out = tmp_path / "out.glb"
    assert run(["animate", str(one), str(two), "-o", str(out), "--no-preview", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["report"]["match"]["joints"]["Wing2.L"] == "Wing2.L"
    assert any("creature with limbs of its own" in note for note in facts["report"]["notes"])
    np.testing.assert_allclose(load_clip(out).vertices[0], load_mesh(one).vertices, atol=1e-5)


@pytest.mark.slow
def test_what_does_not_correspond_is_refused(tmp_path, capsys):
    one = Boxes.of(SPIDER).write(tmp_path / "spider.glb")
    two = Boxes.of(snake(5)).write(tmp_path / "snake.glb", flapping(("Tail1", "Tail2")))
    out = tmp_path / "out.glb"
    assert run(["animate", str(one), str(two), "-o", str(out), "--no-preview"]) == 2
    message = capsys.readouterr().err
    assert "spider.glb, snake.glb: expected" in message
    assert "confidence" in message
    assert not out.exists()


@pytest.mark.slow
def test_a_person_with_a_creature_is_refused(tmp_path):
    person = rigs.character(tmp_path / "person.glb", clips={"move": rigs.exercise(rigs.figure())})
    bird = Boxes.of(BIRD).write(tmp_path / "bird.glb", flapping(tuple(BIRD)))
    with pytest.raises(InputError, match="expected two people, two four-legged animals"):
        animate(str(person), str(bird))


def test_smoothing_needs_a_person(tmp_path):
    one, two = (Boxes.of(BIRD).write(tmp_path / f"{name}.glb", flapping(tuple(BIRD))) for name in "ab")
    with pytest.raises(InputError, match=r"^smooth:"):
        animate(str(one), str(two), hints=Hints(body="other"), motion=MotionOptions(smooth=0.1))


def test_an_animation_of_the_same_skeleton_is_still_copied(tmp_path):
    one, two = (Boxes.of(BIRD).write(tmp_path / f"{name}.glb", flapping(tuple(BIRD))) for name in "ab")
    assert animate(str(one), str(two)).report["copied"] is True
    moved = animate(str(one), str(two), motion=MotionOptions(root="drop"))  # that is no copy
    assert moved.report["copied"] is False
