"""Animations: channels interpolate as glTF 2.0 says, and baked frames equal a file at rest in that pose."""

from __future__ import annotations

import json
from pathlib import Path

import gltf_samples as samples
import numpy as np
import pytest
import zoo
from scipy.spatial.transform import Rotation, Slerp

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import load_clip, load_mesh, save_clip
from mimesh.io.gltf.animation import AnimationChannel, animated_nodes, frame_rate, select_channels, taken_animations
from mimesh.io.gltf.document import Document, MappedFiles, open_document

HIP_QUATERNIONS = [[0, 0, 0, 1], [0, 0, 0.6, 0.8]]
"""Rotation (xyzw) of the hero's hip at 0 s and 1 s."""
FACE = 4
"""Node of the hero with two morph targets."""


def hero_with_hip_rotation(tmp_path, quaternion):
    """Return the vertices of the hero at rest with another rotation of its hip."""
    sample = samples.hero()
    sample.gltf["nodes"][1]["rotation"] = list(quaternion)
    return load_mesh(sample.glb(tmp_path / "turned.glb")).vertices


def test_skinned_vertices_equal_the_mesh_at_rest_in_each_pose(tmp_path):
    path = samples.hero().glb(tmp_path / "hero.glb")
    clip = load_clip(path, fps=4.0)
    assert len(clip) == 5
    slerp = Slerp([0, 1], Rotation.from_quat(HIP_QUATERNIONS))
    for t in range(5):
        expected = hero_with_hip_rotation(tmp_path, slerp(t / 4).as_quat())
        assert np.allclose(clip.vertices[t], expected, atol=1e-6 * np.ptp(expected))
    assert np.array_equal(clip.mesh.vertices, clip.vertices[0])
    assert not np.allclose(clip.vertices[0], clip.vertices[4])


def test_animated_morph_weights_interpolate_linearly(tmp_path):
    sample = samples.hero()
    keys = np.array([[0.0, 0.0], [1.0, 0.0]])
    samplers = [{"input": sample.accessor([0.0, 0.5]), "output": sample.accessor(keys.ravel())}]
    channels = [{"sampler": 0, "target": {"node": FACE, "path": "weights"}}]
    sample.gltf["animations"] = [{"channels": channels, "samplers": samplers}]
    clip = load_clip(sample.glb(tmp_path / "morph.glb"), fps=4.0)
    assert len(clip) == 3
    assert np.allclose(clip.vertices[1], (clip.vertices[0] + clip.vertices[2]) / 2)
    assert not np.allclose(clip.vertices[2], clip.vertices[0])
    sample.gltf["nodes"][FACE]["weights"] = keys[1].tolist()
    assert np.allclose(load_mesh(sample.glb(tmp_path / "posed.glb")).vertices, clip.vertices[2])


def test_of_keys_at_one_time_the_last_one_counts(tmp_path):
    sample = samples.hero()
    keys = [[0, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0.6, 0.8]]
    sample.gltf["animations"][0]["samplers"][0] = {
        "input": sample.accessor([0.0, 0.5, 0.5]),
        "output": sample.accessor(keys),
    }
    clip = load_clip(sample.glb(tmp_path / "twice.glb"), fps=2.0)
    assert len(clip) == 2
    assert np.allclose(clip.vertices[1], hero_with_hip_rotation(tmp_path, keys[2]), atol=1e-5)


def channel(values, interpolation, path="translation"):
    return AnimationChannel(0, path, np.array([1.0, 2.0, 4.0]), np.array(values, float), interpolation)


def test_channel_interpolates_by_step_line_and_cubic():
    steps = channel([[0], [10], [20]], "STEP")
    assert steps.sample(np.array([0, 1, 1.99, 2, 3.9, 4, 9]))[:, 0].tolist() == [0, 0, 0, 10, 10, 20, 20]
    lines = channel([[0], [10], [20]], "LINEAR")
    assert lines.sample(np.array([0, 1.5, 3, 9]))[:, 0].tolist() == [0, 5, 15, 20]
    # A cubic whose tangents are those of a parabola is that parabola.
    cubic = channel([[2 * t, t * t, 2 * t] for t in (1.0, 2.0, 4.0)], "CUBICSPLINE")
    assert np.allclose(cubic.sample(np.array([1.0, 1.3, 2.0, 3.1, 4.0, 7.0]))[:, 0], [1, 1.69, 4, 9.61, 16, 16])


def test_channel_rotations_take_the_shorter_arc_and_have_unit_length():
    half = np.sqrt(0.5)
    rotations = channel([[0, 0, 0, 1], [0, 0, -half, -half], [0, 0, 1, 0]], "LINEAR", "rotation")
    expected = Rotation.from_rotvec([0, 0, np.pi / 4]).as_matrix()
    assert np.allclose(Rotation.from_quat(rotations.sample(np.array([1.5]))[0]).as_matrix(), expected)
    assert np.allclose(np.linalg.norm(rotations.sample(np.linspace(0, 5, 21)), axis=1), 1)


def test_frame_rate_is_that_of_the_keys():
    def keys(times, fps=None):
        return [AnimationChannel(0, "scale", np.array(times), np.ones((len(times), 3)), "LINEAR", fps)]

    assert frame_rate(keys(np.arange(9) / 24)) == 24
    assert frame_rate(keys(np.arange(9) / 30)) == 30
    assert frame_rate(keys([0, 0.0171, 0.0533, 0.2019])) is None
    assert frame_rate(keys(np.arange(3) / 2)) == 24, "a curve of three keys"
    assert frame_rate(keys([0.0, 1 / 24, 3 / 24])) == 24, "a frame without a key"
    assert frame_rate(keys(np.arange(3) / 2, 2.0)) == 2
    assert frame_rate(keys([0.0, 0.4, 0.8], 2.0)) == 25, "keys that another program moved"
    assert frame_rate(keys(np.arange(3) / 2, 2.0) + keys([0.0])) == 24, "of two animations one says nothing"


@pytest.mark.parametrize("stated", [0, -5.0, 1e9, True, "5", None, [5.0]])
def test_a_stated_rate_that_is_none_is_passed_over(stated, tmp_path):
    mesh = zoo.cube()
    save_clip(Clip(mesh, np.stack([mesh.vertices + [k, 0, 0] for k in range(3)]), 5.0), tmp_path / "a.gltf")
    gltf = json.loads((tmp_path / "a.gltf").read_text())
    gltf["animations"][0]["extras"]["mimesh"]["fps"] = stated
    (tmp_path / "a.gltf").write_text(json.dumps(gltf))
    assert load_clip(tmp_path / "a.gltf").fps == 25


@pytest.mark.parametrize(
    ("frames", "fps"), [(1, 7.0), (2, 5.0), (2, 23.976), (4, 0.5), (13, 7.3), (13, 15.0), (13, 29.97), (13, 72.0)]
)
def test_clip_keeps_frames_and_rate_when_written_and_read(fps, frames, tmp_path):
    mesh = zoo.cube()
    clip = Clip(mesh, np.stack([mesh.vertices + [np.sin(k), k * k, 0] for k in range(frames)]), fps)
    save_clip(clip, tmp_path / "a.glb")
    loaded = load_clip(tmp_path / "a.glb")
    assert loaded.fps == (fps if frames > 1 else 30)
    np.testing.assert_allclose(loaded.vertices, clip.vertices, atol=1e-4)


def hero_with_three_animations(tmp_path):
    sample = samples.hero()
    first = sample.gltf["animations"][0]
    times = sample.accessor([0.0, 0.5])
    rest = {"channels": first["channels"], "samplers": [{**first["samplers"][0], "input": times}]}
    sample.gltf["animations"] = [first, {**rest, "name": "rig|short"}, rest]
    return sample.glb(tmp_path / "named.glb")


def test_animation_is_selected_by_name_or_index(tmp_path):
    path = hero_with_three_animations(tmp_path)
    frames = {None: 11, "turn": 11, "rig|short": 6, "short": 6, "2": 6, "Turn": 11, "SHORT": 6}
    assert {name: len(load_clip(path, fps=10.0, animation=name)) for name in frames} == frames
    with pytest.raises(InputError, match=r"turn, rig\|short, 2.*animation"):
        load_clip(path, animation="walk")
    (tmp_path / "cube.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"with animation=..."):
        load_clip(tmp_path / "cube.obj", animation="walk")


def moving(node, path="rotation"):
    """The entry of an animation that moves one property of a node."""
    return {"channels": [{"target": {"node": node, "path": path}, "sampler": 0}]}


def test_animations_of_other_nodes_are_read_with_the_first_and_alternatives_are_not(tmp_path):
    """Blender writes one animation for each object that moves."""
    sample = samples.hero()
    first = sample.gltf["animations"][0]
    moved = first["channels"][0]["target"]["node"]
    other = next(node for node in range(len(sample.gltf["nodes"])) if node != moved)
    sample.gltf["animations"] = [first, *({**first, **moving(node)} for node in (other, moved))]
    document = open_document(sample.glb(tmp_path / "a.glb"))
    assert [found.node for found in select_channels(document, None)] == [moved, other]
    assert taken_animations(document) == (0, 1)


def test_nodes_that_any_animation_moves_are_listed():
    """A new animation has keys for all of them: other programs mix it with those of other nodes."""
    gltf = {"nodes": [{}, {}, {}], "animations": [moving(0), moving(2), moving(1, "weights"), moving(9)]}
    path = Path("a.glb")
    assert animated_nodes(Document(path, gltf, b"", (), MappedFiles(path)), {"rotation"}) == {0, 2}


def test_a_damaged_animation_beside_the_first_is_refused_only_if_it_is_asked_for(tmp_path):
    sample = samples.hero()
    first = sample.gltf["animations"][0]
    sample.gltf["animations"] = [first, {"name": "empty", "channels": [{"target": {"path": "scale"}}]}, {**first}]
    sample.gltf["animations"][1]["channels"][0]["target"]["node"] = 1
    path = sample.glb(tmp_path / "a.glb")
    assert len(load_clip(path, fps=10.0)) == 11
    with pytest.raises(InputError, match="samplers in animation 1"):
        load_clip(path, animation="empty")


@pytest.mark.parametrize(
    "damage",
    [
        lambda gltf: gltf["animations"][0].pop("samplers"),
        lambda gltf: gltf["animations"][0]["channels"][0].update(sampler=7),
        lambda gltf: gltf["animations"][0]["channels"][0]["target"].update(node=99),
        lambda gltf: gltf["animations"][0]["samplers"][0].update(interpolation="WAVES"),
    ],
    ids=["no samplers", "no such sampler", "no such node", "unknown interpolation"],
)
def test_damaged_animation_is_refused(tmp_path, damage):
    sample = samples.hero()
    damage(sample.gltf)
    with pytest.raises(InputError, match="export it again"):
        load_clip(sample.glb(tmp_path / "damaged.glb"))
