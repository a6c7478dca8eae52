"""transfer and animate: position, range, notes, report, timing and checks of their arguments."""

import dataclasses

import numpy as np
import pytest
from grouped_options import grouped
from networks import write_mime_network, write_network
from people import person, walk
from zoo import cube, grid

from mimesh.core.animated_rig import AnimatedRig
from mimesh.core.errors import InputError
from mimesh.core.frame_buffer import LazyFrames
from mimesh.core.geometry import vertex_normals
from mimesh.core.mesh import Clip, Mesh, far_note
from mimesh.core.options import FrameRange, Hints, ModelOptions
from mimesh.core.rig import Rig
from mimesh.io import load_mesh, save_mesh
from mimesh.pipeline import animate, transfer
from mimesh.pipeline.report import quality, torn_note
from mimesh.rigs.character import Character
from mimesh.view.pack import MotionLimits


def ground_point(vertices):
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])


def test_result_has_the_position_of_the_identity():
    identity = dataclasses.replace(person(0), vertices=person(0).vertices + [4, 1, -3])
    result = transfer(identity, person(1, 2), "copy")
    assert np.allclose(ground_point(result.vertices), ground_point(identity.vertices), atol=1e-9)


def test_rigid_motion_is_reproduced():
    identity = person(0)
    angle = np.radians(20)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    frames = np.stack([identity.vertices, identity.vertices @ turn.T + [1, 0.5, 0]])
    result = animate(identity, Clip(identity, frames, 24.0), "copy")
    assert np.allclose(result.clip.vertices, frames, atol=1e-5)
    assert result.fps == 24.0
    assert result.clip.vertices.dtype == np.float32


def test_transfer_is_animate_with_one_frame():
    identity, driving = person(0), person(1, 0)
    still = Clip.still(driving)
    expected = transfer(identity, driving, "copy").vertices
    assert np.allclose(animate(identity, still, "copy").clip.vertices[0], expected, atol=1e-6)


def test_range_of_frames_is_taken_at_the_same_speed():
    identity, clip = person(0), walk(frames=6)
    calls = []
    result = animate(
        identity,
        clip,
        "copy",
        frames=FrameRange(start=1, step=2),
        progress=lambda done, total: calls.append((done, total)),
    )
    assert len(result.clip) == 3
    assert result.fps == clip.fps / 2
    assert calls == [(1, 3), (2, 3), (3, 3)]
    assert animate(identity, clip, "copy", frames=FrameRange(stop=2, fps=50.0)).fps == 50.0


@pytest.mark.slow
def test_a_file_of_joints_is_written_without_making_all_frames(tmp_path, monkeypatch):
    """Report, file and page ask for few frames, which are those of the whole clip; only `clip` makes all."""
    network = write_mime_network(tmp_path / "net.onnx")
    clip = walk(frames=200)
    made = []
    monkeypatch.setattr(Character, "posed", counted_calls(Character.posed, made))
    result = animate(person(0), clip, str(network))
    result.save_skinned(tmp_path / "out.glb")
    page = result.player(tmp_path / "out.html", motion=MotionLimits(frames=10)).read_text()
    assert 0 < len(made) < 0.9 * len(clip)
    assert "every 20th of 200 frames is shown" in page
    chosen = [0, 7, 199, 7]
    few = list(result.frames.at(chosen))
    assert len(result.frames) == len(result.clip) == 200
    np.testing.assert_array_equal(np.stack(few), result.clip.vertices[chosen])
    with pytest.raises(InputError, match="most: expected 1 frame or more, found 0"):
        result.panels(0)


def counted_calls(function, calls):
    """Return a function that notes each of its calls."""

    def call(*args):
        calls.append(None)
        return function(*args)

    return call


@pytest.mark.parametrize(
    ("options", "message"),
    [({"step": 0}, "^step"), ({"start": 99}, "expected start and stop"), ({"fps": -1.0}, "with fps=")],
)
def test_wrong_ranges_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        animate(person(0), walk(), "copy", **grouped(**options))


def test_arrays_with_nan_are_refused():
    broken = dataclasses.replace(person(0), vertices=person(0).vertices * np.nan)
    for pair in ((broken, person(0)), (person(0), broken)):
        with pytest.raises(InputError, match="NaN"):
            transfer(*pair, "copy")
    with pytest.raises(InputError, match="NaN"):
        animate(person(0), Clip(person(0), broken.vertices[None]), "copy")


def test_uncertain_facing_is_noted_and_a_given_one_is_not():
    unsure = transfer(cube(), cube(), "copy", hints=Hints(front=None))
    axes = (("up", "front"), ("driving_up", "driving_front"))
    advice = [f" give {up}=... and {front}=... if it faces elsewhere" for up, front in axes]
    assert [note.split(";")[1] for note in unsure.notes] == advice
    sure = transfer(cube(), cube(), "copy", hints=Hints(up="y", front="z", driving_up="y", driving_front="z"))
    assert sure.notes == ()
    assert np.allclose(sure.vertices, cube().vertices)
    axes = {"up": "+y", "front": "+z", "up_from": "given"}
    assert sure.report["identity"] == axes | {"detected": False, "margin": 1.0}


def test_notes_of_the_identitys_file_are_passed_on():
    class Source:
        suffix, notes = ".glb", ("its skin was dropped",)

        def write(self, mesh, path): ...

    result = transfer(dataclasses.replace(person(0), source=Source()), person(1, 0), "copy")
    assert "its skin was dropped" in result.notes


def test_a_result_is_apart_from_the_arrays_of_the_caller():
    vertices, faces = person(0).vertices.copy(), person(0).faces.copy()
    given = {
        "vertices": vertices,
        "faces": faces,
        "corner_uv": np.full((len(faces), 3, 2), 0.5),
        "corner_normals": vertex_normals(vertices, faces)[faces],
        "vertex_colors": np.ones((len(vertices), 4)),
    }
    result = transfer(Mesh(**given), person(2, 1), "copy")
    before = {name: getattr(result.mesh, name).copy() for name in given}
    for name, array in given.items():
        array[:] = 0
        np.testing.assert_array_equal(getattr(result.mesh, name), before[name])
        assert before[name].any()


def test_files_and_meshes_give_the_same_result(tmp_path):
    identity, driving = person(0), person(1, 0)
    save_mesh(identity, tmp_path / "identity.obj")
    save_mesh(driving, tmp_path / "driving.obj")
    result = transfer(tmp_path / "identity.obj", str(tmp_path / "driving.obj"), "copy")
    assert np.allclose(result.vertices, transfer(identity, driving, "copy").vertices, atol=1e-5)
    saved = load_mesh(result.save(tmp_path / "result.obj"))
    assert np.allclose(saved.vertices, result.vertices, atol=1e-5)
    assert result.seconds["write"] > 0


def test_quality_of_known_changes():
    mesh = cube()

    def measured(scale: float, of: Mesh = mesh) -> dict:
        return quality(of, LazyFrames.stored(mesh.vertices[None] * scale))

    assert measured(1.0) == {
        "edge_stretch_max": 1.0,
        "edge_stretch_p99": 1.0,
        "torn_share": 0.0,
    }
    assert np.isclose(measured(2.0)["edge_stretch_max"], 2)
    assert np.isclose(measured(0.5)["edge_stretch_max"], 2)
    assert measured(1.0, Mesh(mesh.vertices, np.zeros((0, 3), int))) == {}


def test_a_corner_pulled_away_is_torn_and_a_larger_result_is_not():
    """Of 12 sides and 4 diagonals of cells, squares 12 + 4 x 2, the two sides at a corner without a diagonal count."""
    mesh = grid(3)
    pulled = 5 * mesh.vertices
    assert quality(mesh, LazyFrames.stored(pulled[None]))["torn_share"] == 0
    pulled[2] *= 20
    torn = quality(mesh, LazyFrames.stored(pulled[None]))
    assert torn["torn_share"] == pytest.approx(2 / 20)
    assert any(np.allclose(torn["torn_at"], (mesh.vertices[2] + mesh.vertices[k]) / 2, atol=1e-5) for k in (1, 5))


def test_a_torn_result_has_a_note():
    rest, driving = person(0), person(1, 0)
    torn = driving.vertices.copy()
    torn[np.argsort(torn[:, 1])[::3]] *= 2
    said = "of the surface of identity is torn, its edges more than 3 times as long as at rest"
    for vertices, noted in ((driving.vertices, 0), (torn, 1)):
        notes = transfer(dataclasses.replace(rest, name="identity"), driving.with_vertices(vertices), "copy").notes
        assert sum(said in note for note in notes) == noted


def test_the_note_on_torn_surface_names_the_nearest_joint_and_the_place():
    joints = Rig(np.tile(np.eye(3), (2, 1, 1)), np.array([[0.0, 1, 0], [0.7, 1.4, 0]]), np.eye(2)[[0] * 9])
    skeleton = AnimatedRig(grid(3), ("Hips", "LeftHand"), (-1, 0), joints, joints.rotation[None], np.zeros((1, 3)))
    report = {"torn_share": 0.024, "torn_at": [0.5, 1.25, 0.0]}
    (note,) = torn_note(report, "bull", found=True, skeleton=skeleton)
    assert "2% of the surface of bull is torn" in note
    assert "most near LeftHand (the point 0.5, 1.25, 0 of the mesh at rest)" in note
    assert "near the point 0.5, 1.25, 0" in torn_note(report, "bull", found=False)[0]


def test_a_person_far_from_the_origin_keeps_the_shape_and_has_a_note():
    """Moved to UTM coordinates, whose numbers are 0.5 m apart in single precision."""
    moved = np.array([5e5, 0.0, 5e6])
    near, far = person(0), person(0).with_vertices(person(0).vertices + moved)
    expected, found = (animate(mesh, walk(), "copy") for mesh in (near, far))
    np.testing.assert_allclose(found.clip.vertices - moved, expected.clip.vertices, atol=1e-6)
    assert [note for note in found.notes if "far from the origin" in note] == list(far_note(far))
    assert "are 0.5 apart there, and it measures 1." in far_note(far)[0]
    assert far_note(far)[0] in transfer(far, person(1, 0), "copy").notes
    assert not any("far from" in note for note in expected.notes)
    assert not any("torn" in note for note in found.notes)


def test_clip_of_one_frame_is_noted():
    pose = person(1, 2)
    result = animate(person(0), Clip(pose, pose.vertices[None].astype(np.float32)), "copy")
    assert any("one frame" in note for note in result.notes)
    assert not any("one frame" in note for note in animate(person(0), walk(1), "copy").notes)


@pytest.mark.parametrize(
    ("markers", "found"),
    [
        (np.zeros((5, 3)), "float64 (5, 3)"),
        (np.zeros((5, 3), int), "int64 (5, 3)"),
        (np.zeros((5, 2)), "float64 (5, 2)"),
        (np.zeros(4, int), "int64 (4,)"),
        ([[0, 0], [1]], "object (2,)"),
        ([], "float64 (0,)"),
    ],
)
def test_unusable_markers_are_refused(markers, found):
    message = (
        f"markers: expected whole numbers of shape (M, 2), found {found}; rows are (identity vertex, driving vertex)"
    )
    mesh = person(0)
    with pytest.raises(InputError) as error:
        transfer(mesh, mesh, "deformation-transfer", options=ModelOptions(reference=mesh, markers=markers))
    assert str(error.value) == message


@pytest.mark.parametrize("row", [[1000, 0], [0, 1000], [-1, 0]])
def test_markers_out_of_range_are_refused_in_one_line(row):
    mesh = person(0)
    with pytest.raises(InputError, match=r"expected vertices of person0 in 0\.\.") as error:
        transfer(
            mesh,
            mesh,
            "deformation-transfer",
            options=ModelOptions(reference=mesh, markers=[[1, 1], [2, 2], [3, 3], row]),
        )
    assert "\n" not in str(error.value)


def test_markers_may_be_a_list_of_pairs():
    identity, driving, reference = (person(shape, pose, faces=400) for shape, pose in ((0, 3), (1, 5), (1, 3)))
    marks = np.unique(np.concatenate([identity.vertices.argmax(axis=0), identity.vertices.argmin(axis=0)]))
    pairs = np.stack([marks, marks], axis=1)
    results = [
        transfer(
            identity, driving, "deformation-transfer", options=ModelOptions(reference=reference, markers=markers)
        ).vertices
        for markers in (pairs.astype(np.uint16), pairs.tolist())
    ]
    assert np.array_equal(*results)


def test_heading_of_the_clip_against_its_reference_does_not_matter():
    """The reference faces +z, the clip +x from its first frame on: the result faces +z and walks there."""
    identity, reference, clip = person(0), person(1), walk(1, 3)
    aside = np.stack([clip.vertices[..., 2], clip.vertices[..., 1], -clip.vertices[..., 0]], axis=-1)
    turned = Clip(dataclasses.replace(clip.mesh, vertices=aside[0]), aside)
    axes = {"up": "+y", "front": "+z", "driving_up": "+y", "reference": reference}
    expected = animate(identity, clip, "deformation-transfer", **grouped(driving_front="+z", **axes)).clip.vertices
    result = animate(identity, turned, "deformation-transfer", **grouped(driving_front="+x", **axes)).clip.vertices
    assert np.abs(result - expected).max() < 1e-5
    steps = (result[1:] - result[:-1]).mean(axis=1)
    assert (steps[:, 2] > 3 * np.abs(steps[:, 0])).all()


def test_refinement_is_the_models_default_or_the_users_choice(tmp_path):
    """By default `copy` is not refined."""
    rough = dataclasses.replace(person(0), vertices=person(0).vertices + 0.01 * np.sin(1e4 * person(0).vertices))
    plain, refined = (
        transfer(person(0), rough, "copy", options=ModelOptions(refine=refine)) for refine in (None, True)
    )
    assert np.array_equal(
        plain.vertices, transfer(person(0), rough, "copy", options=ModelOptions(refine=False)).vertices
    )
    assert refined.report["edge_stretch_p99"] < plain.report["edge_stretch_p99"]
    assert refined.seconds["refine"] > 0
    assert all(value >= 0 for value in refined.seconds.values())


def test_a_vertex_network_is_refined_unless_the_user_says_no(tmp_path):
    pytest.importorskip("onnx")
    network, axes = str(write_network(tmp_path / "npt.onnx")), {"up": "+y", "front": "+z", "body": "human"}
    default, unrefined, refined = (
        transfer(
            person(0), person(1, 0), network, **grouped(refine=refine, driving_up="+y", driving_front="+z", **axes)
        ).vertices
        for refine in (None, False, True)
    )
    assert np.array_equal(default, refined)
    assert not np.array_equal(default, unrefined)


def test_collapsed_first_frame_is_refused():
    clip = walk(faces=600)
    vertices = clip.vertices.copy()
    vertices[2] = 0.0
    with pytest.raises(InputError, match="walk"):
        animate(person(0), dataclasses.replace(clip, vertices=vertices), "copy", frames=FrameRange(start=2))


@pytest.mark.slow
def test_a_tetrahedron_gives_a_finite_result():
    """The smallest mesh that is moved."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    tetrahedron = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), faces, name="tetrahedron")
    assert np.isfinite(transfer(tetrahedron, person(0), hints=Hints(body="human")).vertices).all()


def test_meshes_of_arrays_are_called_by_what_they_are_for():
    identity, clip = Mesh(person(0).vertices, person(0).faces), walk(frames=3)
    flat = Mesh(np.zeros((5, 3)) + [1, 2, 3])
    with pytest.raises(InputError, match=r"^driving: expected a mesh with some size"):
        transfer(identity, flat, "copy")
    with pytest.raises(InputError, match=r"^identity: "):
        transfer(flat, identity, "copy")
    with pytest.raises(InputError, match=r"^driving: "):
        animate(identity, Clip(flat, np.repeat(flat.vertices[None], 3, axis=0), clip.fps), "copy")
    with pytest.raises(InputError, match=r"^hero: "):
        transfer(Mesh(flat.vertices, name="hero"), identity, "copy")
