"""The extension in Blender: its buttons give the same result as mimesh on the same arrays.

Blender is the module `bpy` in an environment of its own: `make clients` makes one, or MIMESH_BPY names its Python.
"""

import json
import zipfile

import numpy as np
import pytest
from client_programs import run_in_blender
from grouped_options import grouped
from people import person, walk

import mimesh
from mimesh.pipeline.known import shown_bones

pytestmark = pytest.mark.client
AXES = {"up": "+z", "driving_up": "+z"}
JOINTS = {"root": "keep", "ground": True}


def z_up(vertices):
    return np.stack([vertices[..., 0], -vertices[..., 2], vertices[..., 1]], axis=-1)


@pytest.fixture(scope="module")
def outcome(archive, tmp_path_factory):
    """Run `blender_scene.py` in Blender; return the folder of its results."""
    folder, clip = tmp_path_factory.mktemp("scene"), walk(1, frames=6, faces=2500)
    identity = person(0, faces=3000)
    np.savez(
        folder / "meshes.npz",
        identity=z_up(identity.vertices),
        identity_faces=identity.faces,
        driving=z_up(clip.vertices),
        driving_faces=clip.mesh.faces,
    )
    mimesh.animate(person(2, faces=2000), clip).save_skinned(folder / "driving.glb")
    run_in_blender("blender_scene.py", archive, folder, tmp_path_factory.mktemp("blender"))
    return folder


@pytest.fixture(scope="module")
def facts(outcome):
    return json.loads((outcome / "facts.json").read_text())


def run_mimesh(outcome, name, faces, **options):
    """Return the frames that the extension made, and the result of mimesh on the driving frames Blender evaluated."""
    case, scene = np.load(outcome / f"{name}.npz"), np.load(outcome / "scene.npz")
    frames = case["driving"].astype(np.float32)
    driving = mimesh.Mesh(frames[0].astype(np.float64), scene[faces].astype(np.int64), name="driving")
    identity = mimesh.Mesh(scene["identity"], scene["faces"].astype(np.int64), name="identity")
    return case["result"], mimesh.animate(identity, mimesh.Clip(driving, frames, 24.0), **grouped(**AXES | options))


def skinned_frames(result):
    """Compute linear blend skinning with four weights per vertex, vertex by vertex."""
    skeleton = result.skeleton
    joints, weights = skeleton.strongest()
    bones = skeleton.rig.bones(skeleton.parents)
    frames = []
    for turns, root in zip(skeleton.rotation, skeleton.root, strict=True):
        joints_now = [root]
        for bone, parent in zip(bones, skeleton.parents[1:], strict=True):
            joints_now.append(joints_now[parent] + turns[parent] @ bone)
        moved = np.zeros_like(skeleton.mesh.vertices)
        for v, vertex in enumerate(skeleton.mesh.vertices):
            for j, weight in zip(joints[v], weights[v], strict=True):
                local = skeleton.rig.rotation[j].T @ (vertex - skeleton.rig.joints[j])
                moved[v] += weight * (joints_now[j] + turns[j] @ local)
        frames.append(moved)
    return np.stack(frames)


def relative_error(frames, expected):
    """Return the largest distance of a vertex from its expected position, as a fraction of the mesh's extent."""
    return np.linalg.norm(frames - expected, axis=-1).max() / np.ptp(expected[0], axis=0).max()


@pytest.mark.parametrize(("name", "model"), [("keys", "mime"), ("other", "npt-maxpool")])
def test_shape_keys_equal_the_frames(outcome, facts, name, model):
    frames, result = run_mimesh(outcome, name, "driving", model=model)
    assert relative_error(frames, result.clip.vertices) < 1e-5
    assert facts[name]["keys"] == ["Basis", *(f"frame {frame}" for frame in range(4, 9))]


@pytest.mark.parametrize(("name", "faces", "options"), [("bones", "driving", JOINTS), ("skinned", "skin", {})])
def test_armature_moves_as_the_joints(outcome, facts, name, faces, options):
    frames, result = run_mimesh(outcome, name, faces, **options)
    assert relative_error(frames, skinned_frames(result)) < 1e-5
    assert tuple(facts[name]["bones"]) == result.skeleton.names


def test_pose_button_makes_one_frame(outcome, facts):
    frames, result = run_mimesh(outcome, "posed", "skin")
    assert relative_error(frames, skinned_frames(result)) < 1e-5
    frames, result = run_mimesh(outcome, "pose key", "driving")
    assert relative_error(frames, result.clip.vertices) < 1e-5
    assert facts["pose key"]["keys"] == ["Basis", "frame 1"]


def test_rig_button_makes_a_copy_at_rest_with_the_weights_of_rig(outcome, facts):
    made, scene, fact = np.load(outcome / "rigged.npz"), np.load(outcome / "scene.npz"), facts["rigged"]
    identity = mimesh.Mesh(scene["identity"], scene["faces"].astype(np.int64), name="hero")
    skeleton = mimesh.rig(identity, hints=mimesh.Hints(up="+z")).skeleton
    assert fact["outcome"] == ["FINISHED"]
    assert fact["unchanged"]
    order = [fact["bones"].index(name) for name in skeleton.names]
    assert len(order) == len(fact["bones"])
    assert fact["modifiers"] == [["ARMATURE", True]]
    assert (fact["keys"], fact["animated"], fact["made"]) == (False, False, "hero at rest")
    np.testing.assert_allclose(made["shown"], scene["identity"], atol=1e-5)
    # Blender rounds the extension's positions by 2e-7, which moves finger joints by up to 4e-4 of the size, others not.
    off = np.abs(made["heads"][order] - skeleton.rig.joints).max(axis=1)
    fingers = np.array(["Hand" in name and name[-1].isdigit() for name in skeleton.names])
    assert off[~fingers].max() < 1e-5
    assert off[fingers].max() < 1e-3 * np.ptp(scene["identity"], axis=0).max()
    joints, weights = skeleton.strongest()
    expected = np.zeros((len(joints), len(order)))
    np.put_along_axis(expected, joints, weights, axis=1)
    np.testing.assert_allclose(made["weights"].sum(axis=1), 1.0, atol=1e-5)
    # The numbers of Blender's own NumPy differ a little: of nearly equal weights another one may be the fourth.
    assert np.abs(made["weights"][:, order] - expected).sum(axis=1).mean() < 1e-3


def test_rig_button_has_the_names_and_the_rest_pose_of_an_engine(outcome, facts):
    made, scene, fact = np.load(outcome / "rigged for mixamo.npz"), np.load(outcome / "scene.npz"), "rigged for mixamo"
    identity = mimesh.Mesh(scene["identity"], scene["faces"].astype(np.int64), name="hero")
    skeleton = mimesh.rig(identity, hints=mimesh.Hints(up="+z")).laid_out(mimesh.Layout("mixamo", rest="T"))
    names = facts[fact]["bones"]
    assert sorted(names) == sorted(skeleton.names)
    order = [names.index(name) for name in skeleton.names]
    np.testing.assert_allclose(made["heads"][order], skeleton.rig.joints, atol=1e-4)
    apart = np.abs(made["shown"] - skeleton.mesh.vertices)
    assert apart.max() < 1e-3, "Blender's own NumPy makes slightly other weights"
    assert apart.mean() < 1e-5


def test_capture_button_plays_the_joints_where_the_driving_is(outcome, facts):
    found, result = run_mimesh(outcome, "captured", "driving")
    captured = mimesh.capture(result.driving, hints=mimesh.Hints(up="+z"))
    assert facts["captured"]["outcome"] == ["FINISHED"]
    assert tuple(facts["captured"]["bones"]) == captured.names
    assert facts["captured"]["made"] == facts["captured"]["action"] == "dancer captured"
    places = np.zeros_like(found)
    for j, parent in enumerate(captured.parents):
        bone = captured.rest[j] - captured.rest[parent]
        places[:, j] = captured.root if parent < 0 else places[:, parent] + captured.rotation[:, parent] @ bone
    expected = z_up(places)
    size = captured.report["height"]
    assert np.abs((found - found[0, 0]) - (expected - expected[0, 0])).max() < 1e-4 * size
    np.testing.assert_allclose(found[0, 0], result.driving_joints["Hips"], atol=1e-3 * size)


def test_identity_object_is_unchanged(facts):
    cases = [fact for fact in facts.values() if "unchanged" in fact]
    assert len(cases) == 8
    assert all(case["unchanged"] and case["outcome"] == ["FINISHED"] for case in cases)


def test_modifiers_that_keep_vertices_are_baked_and_others_kept(facts):
    kept, baked = facts["modified"]["SUBSURF"], facts["modified"]["SMOOTH"]
    assert kept["modifiers"] == ["ARMATURE", "SUBSURF"]
    assert baked["modifiers"] == ["ARMATURE"]
    assert kept["vertices"] == baked["vertices"]
    assert kept["apart"] < 1e-6
    assert baked["apart"] > 1e-3


def test_cancelled_work_leaves_no_data(facts):
    for stopped in facts["stopped"]:
        assert stopped["before"] == stopped["after"]


def test_work_runs_in_steps_and_escape_cancels_it(facts):
    done = facts["clicked"][-1]
    assert [one["outcome"] for one in facts["clicked"]] == [["CANCELLED"], ["CANCELLED"], ["FINISHED"]]
    assert [one["left"] for one in facts["clicked"]] == [True, True, False]
    assert done["steps"] > 5
    for one in facts["clicked"]:
        assert (one["timers"], one["text"], one["last"]) == (0, "", None)


def test_panel_draws_all_properties(facts):
    assert {
        "Identity",
        "Driving",
        "Model",
        "Result",
        "Step",
        "Animate",
        "Pose",
        "Smooth",
        "Front",
        "Show joints",
        "Clear",
        "Rig",
        "Capture",
    } <= set(facts["drawn"])


def test_moved_empties_are_corrections(outcome, facts):
    picked, seen = np.load(outcome / "picked.npz"), facts["corrected"]
    corrections = {
        "joints": {"LeftLeg": picked["identity"][0]},
        "driving_joints": {"RightForeArm": picked["driving"][0]},
    }
    frames, result = run_mimesh(outcome, "corrected", "driving", **corrections)
    assert relative_error(frames, result.clip.vertices) < 1e-5
    assert relative_error(frames, run_mimesh(outcome, "corrected", "driving")[1].clip.vertices) > 1e-3
    assert tuple(seen["joints"]) == tuple(sorted(shown_bones()))
    assert seen["same"]
    assert seen["parent"] == "hero"
    assert max(seen["kept"]) < 1e-5, "showing them again keeps the moved ones"
    assert "Moved: 1 of the identity, 1 of the driving" in seen["drawn"]
    assert "expected frame 1, in which they were shown, among those taken, found 5 to 6" in seen["other frames"]
    assert seen["cleared"]


def test_invalid_settings_are_explained(facts):
    assert "expected a first frame before the last" in facts["no frames"]
    for case, what in (("no rig", "Rig"), ("no capture", "Capture")):
        assert f"{what}: expected the model mime, found npt; choose it as the model" in facts[case]
    assert "expected a model with joints (mime), found npt-maxpool; choose another with the model" in facts["no joints"]


def test_build_is_reproducible(archive):
    listing = zipfile.ZipFile(archive).infolist()
    assert [entry.filename for entry in listing] == sorted(entry.filename for entry in listing)
    assert {entry.date_time for entry in listing} == {(1980, 1, 1, 0, 0, 0)}
