"""Scans: meshes of one person or animal in motion that have no topology in common."""

import shutil

import fast_simplification
import numpy as np
import pytest

import mimesh
from mimesh.bodies import character, load_body
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.errors import OtherTopologyError, RefusedMeshError
from mimesh.core.geometry import angles_between
from mimesh.core.mesh import Mesh
from mimesh.motions.animal_clips import animal_clip
from mimesh.motions.motion import motion_clip
from mimesh.motions.procedural import walk_motion
from mimesh.pipeline.read import _likeliest

FRAMES, FPS = 4, 10.0


def write_scans(folder, clip, turn=None, seed=0):
    """Write each frame of a clip with triangles of its own; `turn` is applied to the points."""
    rng, faces = np.random.default_rng(seed), clip.mesh.faces.astype(np.int32)
    folder.mkdir()
    for t, vertices in enumerate(np.asarray(clip.vertices)):
        reduced = fast_simplification.simplify(vertices, faces, rng.uniform(0.5, 0.8))
        points = reduced[0].astype(float)
        mesh = Mesh(points if turn is None else points @ turn.T, reduced[1].astype(int))
        mimesh.save_mesh(mesh, folder / f"scan_{t:02d}.ply")


@pytest.fixture(scope="module")
def walk():
    body = load_body()
    motion = walk_motion(body, 3, 0, seconds=FRAMES / FPS, fps=FPS)
    return motion_clip(body, None, motion), motion


@pytest.fixture(scope="module")
def scans(walk, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans") / "walk"
    write_scans(folder, walk[0])
    return folder


@pytest.fixture(scope="module")
def captured(scans):
    return mimesh.capture(scans, frames=mimesh.FrameRange(fps=FPS))


def world(motion):
    """Return the world rotations of a motion of the shipped body."""
    body, rotation = load_body(), motion.rotmat.copy()
    for j, parent in enumerate(body.parents):
        if parent >= 0:
            rotation[:, j] = rotation[:, parent] @ rotation[:, j]
    return rotation


def test_a_clip_still_needs_one_topology(scans):
    with pytest.raises(
        OtherTopologyError, match=r"expected the topology of scan_00\.ply.*or give the folder to animate"
    ):
        mimesh.load_clip(scans)


@pytest.mark.slow
def test_the_motion_is_that_of_the_person(captured, walk):
    truth = world(walk[1])
    limbs = [captured.names.index(f"{side}{name}") for side in ("Left", "Right") for name in ("UpLeg", "Leg", "Arm")]
    # The scans may begin facing another axis of their file, which is +z in what is captured.
    turns = [rotvec_to_rotmat(np.array([[0, angle, 0]]))[0] for angle in np.radians([0, 90, 180, 270])]
    apart = min(float(angles_between(turn @ captured.rotation, truth)[:, limbs].mean()) for turn in turns)
    assert apart < 6
    assert captured.rotation.shape == (FRAMES, len(captured.names), 3, 3)
    assert captured.fps == FPS
    assert 0.9 < captured.report["height"] / np.ptp(load_body().joints[:, 1]) < 1.1


def test_the_note_names_what_is_moved(captured):
    [note] = [note for note in captured.notes if "different topologies" in note]
    assert f"in each of the {FRAMES}, and scan_" in note
    assert captured.report["confidence"] > 0.5


@pytest.mark.slow
def test_other_axes_and_another_unit_give_the_same_motion(walk, captured, tmp_path):
    upright = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])
    write_scans(tmp_path / "turned", walk[0], 100 * np.linalg.inv(upright))
    found = mimesh.capture(tmp_path / "turned", hints=mimesh.Hints(up="+z"), frames=mimesh.FrameRange(fps=FPS))
    assert np.ptp(found.root, axis=0) == pytest.approx(100 * np.ptp(captured.root, axis=0), abs=1.0)
    local = [of.rotation[:, :1].swapaxes(-1, -2) @ of.rotation for of in (found, captured)]
    assert angles_between(*local).mean() < 1


@pytest.mark.slow
def test_a_mesh_moves_as_by_frames_of_one_topology(walk, scans):
    hero = character("heavy")
    options = mimesh.MotionOptions(ground=False, contacts=False)
    by_scans = mimesh.animate(hero, scans, frames=mimesh.FrameRange(fps=FPS), motion=options)
    by_clip = mimesh.animate(hero, walk[0], motion=options)
    apart = np.linalg.norm(np.asarray(by_scans.clip.vertices) - np.asarray(by_clip.clip.vertices), axis=-1)
    assert apart.mean() < 0.01 * np.ptp(hero.vertices[:, 1])
    assert by_scans.fps == FPS


@pytest.mark.slow
def test_only_the_frames_taken_are_read(scans, tmp_path):
    shutil.copytree(scans, tmp_path / "some")
    for name in ("scan_01.ply", "scan_03.ply"):
        (tmp_path / "some" / name).write_bytes((scans / name).read_bytes()[:100])
    (tmp_path / "some" / "scan_01.ply").write_bytes((scans / "scan_00.ply").read_bytes())
    found = mimesh.capture(tmp_path / "some", frames=mimesh.FrameRange(stop=3, step=2, fps=FPS))
    assert (len(found.root), found.fps) == (2, FPS / 2)


@pytest.mark.slow
def test_corrected_joints_are_those_of_the_first_scan(scans, captured):
    """They are found on the mesh that is moved, as those of any other clip."""
    left = captured.found.track.positions[0, captured.names.index("LeftHand")]
    place = captured.found.norm.undo(left[None])[0] + [0.0, 0.05, 0.0]
    hints = mimesh.Hints(joints={"LeftHand": place.tolist()})
    found = mimesh.capture(scans, hints=hints, frames=mimesh.FrameRange(stop=2, fps=FPS))
    hand = found.found.track.positions[0, found.names.index("LeftHand")]
    assert np.abs(found.found.norm.undo(hand[None])[0] - place).max() < 0.02


@pytest.mark.slow
def test_animals(tmp_path):
    clip = animal_clip("horse gallop")
    chosen = np.arange(0, 12, 3)
    write_scans(tmp_path / "gallop", mimesh.Clip(clip.mesh, np.asarray(clip.vertices[chosen]), FPS))
    found = mimesh.capture(tmp_path / "gallop", frames=mimesh.FrameRange(fps=FPS))
    assert found.body == "quadruped"
    assert len(found.root) == len(chosen)


@pytest.mark.slow
def test_things_are_refused(tmp_path):
    (tmp_path / "boxes").mkdir()
    rng = np.random.default_rng(0)
    for t in range(3):
        points = rng.uniform(-1, 1, (30 + t, 3))
        faces = np.array([[k, k + 1, k + 2] for k in range(len(points) - 2)])
        mimesh.save_mesh(Mesh(points, faces), tmp_path / "boxes" / f"{t}.obj")
    with pytest.raises(RefusedMeshError):
        mimesh.capture(tmp_path / "boxes")


def test_a_misread_rotation_is_replaced():
    angles = np.linspace(0, 40, 9)  # five degrees a frame
    angles[4] += 150
    rotation = rotvec_to_rotmat(np.radians(angles)[:, None] * [0.0, 0.0, 1.0])[:, None]
    rotation = np.concatenate([rotation, np.tile(np.eye(3), (9, 1, 1, 1))], axis=1)
    kept = _likeliest(rotation)
    assert kept[4, 0] in (3, 5)
    assert (np.delete(kept[:, 0], 4) == np.delete(np.arange(9), 4)).all()
    assert (kept[:, 1] == np.arange(9)).all()
