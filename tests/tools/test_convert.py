"""Conversion between all formats keeps frames, faces and rates; notes say what is lost."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import rigs
import zoo
from matrix import matrix
from motion_files import write_bvh

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.core.options import ConvertOptions
from mimesh.io import list_animations, load_clip, load_mesh, save_clip, save_mesh
from mimesh.io.formats import CLIP_WRITERS, MESH_WRITERS
from mimesh.io.gltf.document import open_document, read_floats
from mimesh.io.gltf.draft import Draft
from mimesh.motions import load_motion, window
from mimesh.pipeline.read import far_frames_note, first_frame_note
from mimesh.tools.convert import convert
from mimesh.view.movie import MOVIES

pytestmark = pytest.mark.usefixtures("in_process")

CLIPS = sorted({*CLIP_WRITERS, ""} - {".fbx"})  # FBX needs Blender: tests/clients
MESHES = sorted(MESH_WRITERS.keys() - {".fbx"})


@pytest.mark.parametrize("suffix", CLIPS)
def test_clips_are_kept_and_become_meshes(suffix, tmp_path):
    """To each format and back through .npz: what two formats hold of a clip, they hold of each other's."""
    source, calls = tmp_path / f"b{suffix}", []
    save_clip(zoo.moving_cube(), tmp_path / "a.npz")
    convert(tmp_path / "a.npz", source, progress=lambda *done: calls.append(done))
    assert calls == [(k, 8) for k in range(1, 9)]
    written = convert(source, tmp_path / "c.npz")
    assert (written.frames, written.fps, written.vertices) == (4, 30.0, 8)
    for loaded in (load_clip(source), load_clip(tmp_path / "c.npz")):
        np.testing.assert_allclose(loaded.vertices, zoo.moving_cube().vertices, atol=1e-6)
        np.testing.assert_array_equal(loaded.mesh.faces, zoo.moving_cube().mesh.faces)
        assert loaded.fps == 30
    for frame in (None, -1):
        convert(source, tmp_path / "b.obj", ConvertOptions(frame=frame))
        np.testing.assert_allclose(
            load_mesh(tmp_path / "b.obj").vertices, zoo.moving_cube().vertices[frame or 0], atol=1e-6
        )


def test_steps_of_single_precision_far_from_the_origin_are_noted(tmp_path):
    cube = zoo.moving_cube()
    far = dataclasses.replace(
        cube, mesh=cube.mesh.with_vertices(cube.mesh.vertices + 1e6), vertices=cube.vertices + 1e6
    )
    save_clip(far, tmp_path / "a.npz")
    save_mesh(far.mesh, tmp_path / "a.ply")
    for source, target, noted in (
        ("a.npz", "b.glb", 1),
        ("a.ply", "c.glb", 1),
        ("a.ply", "c.obj", 0),
        ("b.glb", "d.glb", 0),
        ("b.glb", "e.stl", 1),
    ):
        notes = convert(tmp_path / source, tmp_path / target).notes
        assert sum("far from the origin" in note for note in notes) == noted, target


def test_a_frame_that_is_not_there_is_refused(tmp_path):
    save_clip(zoo.moving_cube(), tmp_path / "a.npz")
    with pytest.raises(InputError, match="expected --frame below its 4 frames, found 9"):
        convert(tmp_path / "a.npz", tmp_path / "b.obj", ConvertOptions(frame=9))


@pytest.mark.parametrize("suffix", MESHES)
def test_meshes_are_kept_and_their_colours_kept_or_noted_as_lost(suffix, tmp_path):
    colored = dataclasses.replace(zoo.cube(), vertex_colors=np.full((8, 4), [0.2, 0.4, 0.6, 1.0]))
    save_mesh(colored, tmp_path / "a.ply")
    notes = convert(tmp_path / "a.ply", tmp_path / f"b{suffix}").notes
    written = convert(tmp_path / f"b{suffix}", tmp_path / "c.npz")
    assert (written.frames, written.fps) == (1, None)
    first, second = load_mesh(tmp_path / f"b{suffix}"), load_mesh(tmp_path / "c.npz")
    assert (first.vertex_colors is None) == any("vertex colours" in note for note in notes)
    for loaded in (first, second):
        corners = zoo.cube().vertices[zoo.cube().faces]
        np.testing.assert_allclose(loaded.vertices[loaded.faces], corners, atol=1e-6)


def test_range_of_frames_is_converted(tmp_path):
    save_clip(zoo.moving_cube(), tmp_path / "a.npz")
    assert convert(tmp_path / "a.npz", tmp_path / "b.npz", ConvertOptions(start=1, step=2)).fps == 15
    np.testing.assert_array_equal(load_clip(tmp_path / "b.npz").vertices, zoo.moving_cube().vertices[1::2])


@pytest.mark.slow
@matrix("suffix", MOVIES, quick=MOVIES[:1])
def test_movies_have_all_frames(suffix, tmp_path):
    save_clip(zoo.moving_cube(3), tmp_path / "a.npz")
    calls, path = [], tmp_path / f"b{suffix}"
    convert(tmp_path / "a.npz", path, progress=lambda *done: calls.append(done))
    assert path.stat().st_size > 1000
    assert calls == [(k, 6) for k in range(1, 7)]
    if suffix == ".mp4":
        with pytest.importorskip("av").open(str(path)) as movie:
            stream = movie.streams.video[0]
            assert stream.average_rate == 30
            pictures = [frame.to_ndarray(format="rgb24") for frame in movie.decode(stream)]
        assert len(pictures) == 3
        assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 50


def test_notes_name_what_is_lost(tmp_path):
    save_clip(zoo.moving_cube(), tmp_path / "a.npz")
    assert "first of 4 frames" in convert(tmp_path / "a.npz", tmp_path / "b.obj", ConvertOptions(frame=None)).notes[-1]
    with pytest.raises(InputError, match="for --morphs"):
        convert(tmp_path / "a.npz", tmp_path / "b.webp", ConvertOptions(morphs=True))


def test_options_without_effect_are_refused(tmp_path):
    save_clip(zoo.moving_cube(), tmp_path / "a.glb")
    save_mesh(zoo.cube(), tmp_path / "a.ply")
    mesh, frames = tmp_path / "b.obj", tmp_path / "b.npz"
    for options in ({"fps": 12.0}, {"animation": "Run"}, {"start": 1}, {"stop": 2}, {"step": 2}):
        with pytest.raises(InputError, match=f"expected no --{next(iter(options))} "):
            convert(tmp_path / "a.glb", mesh, ConvertOptions(**options))
    with pytest.raises(InputError, match="expected no --start"):
        convert(tmp_path / "a.glb", mesh, ConvertOptions(frame=1, start=1))
    with pytest.raises(InputError, match="expected a folder with --frames-as"):
        convert(tmp_path / "a.glb", frames, ConvertOptions(frames_as=".obj"))
    assert not mesh.exists()
    assert not frames.exists()


@pytest.mark.parametrize("name", ["b.pc2", "b"])
def test_lost_frame_rate_is_noted(name, tmp_path):
    save_clip(zoo.moving_cube(), tmp_path / "a.glb")
    written = convert(tmp_path / "a.glb", tmp_path / name, ConvertOptions(fps=24.0))
    assert f"read {name} with --fps 24" in " ".join(written.notes)
    assert load_clip(tmp_path / name, fps=24.0).fps == 24.0
    assert "--fps" not in " ".join(convert(tmp_path / "a.glb", tmp_path / name, ConvertOptions(fps=30.0)).notes)


def test_pose_of_a_mesh_from_a_clip_is_noted(tmp_path):
    save_clip(zoo.moving_cube(), tmp_path / "a.glb")
    assert convert(tmp_path / "a.glb", tmp_path / "b.obj").notes == (
        "b.obj is the mesh at rest; --frame takes a pose of its animation",
    )
    assert convert(tmp_path / "a.glb", tmp_path / "c.obj", ConvertOptions(frame=2)).notes == ()


def test_unknown_suffixes_are_refused(tmp_path):
    save_mesh(zoo.cube(), tmp_path / "a.obj")
    with pytest.raises(InputError, match=r"expected an output in one of .*\.glb.*, found '.max'; name another"):
        convert(tmp_path / "a.obj", tmp_path / "b.max")
    (tmp_path / "c.blend").write_bytes(b"BLENDER")
    with pytest.raises(InputError, match=r"expected one of .*\.pc2.*, found '.blend'; save it .* Blender"):
        convert(tmp_path / "c.blend", tmp_path / "d.obj")


@pytest.mark.parametrize("fps", [float("inf"), 1e9])
def test_impossible_frame_rates_are_refused(fps, tmp_path):
    save_clip(zoo.moving_cube(), tmp_path / "a.glb")
    with pytest.raises(InputError, match="expected a frame rate from"):
        load_clip(tmp_path / "a.glb", fps=fps)


def test_a_first_frame_far_from_all_others_is_noted():
    rest = zoo.cube()
    shift = np.zeros((20, len(rest.vertices), 3))
    shift[:, :4, 0] = 0.01 * np.arange(20)[:, None]
    moving = Clip(rest, rest.vertices + shift, 30.0)
    assert first_frame_note(moving, 0, "a.bvh") == ()
    shift[0, :4, 0] = 1.0
    posed = Clip(rest, rest.vertices + shift, 30.0)
    (note,) = first_frame_note(posed, 0, "a.bvh")
    assert note.startswith("a.bvh: frame 0 differs from the others")
    assert first_frame_note(posed, 1, "a.bvh") == ()


def test_single_frames_far_from_their_neighbours_are_noted():
    rest = zoo.cube()
    vertices = rest.vertices + 0.3 * np.arange(40)[:, None, None]  # a fast way over the ground is no fault
    assert far_frames_note(Clip(rest, vertices, 30.0), "a.glb") == ()
    vertices[7] += [5, 0, 0]
    (note,) = far_frames_note(Clip(rest, vertices, 30.0), "a.glb")
    assert note.startswith("a.glb: frame 7 is far from the frames before and after")
    vertices[20] += [0, 5, 0]
    (note,) = far_frames_note(Clip(rest, vertices, 30.0), "a.glb")
    assert note.startswith("a.glb: frames 7, 20 are far")
    # Of few frames, or where every second one is far, it is a motion of which few frames are taken.
    assert far_frames_note(Clip(rest, vertices[6:9], 30.0), "a.glb") == ()
    vertices[::2] += [5, 0, 0]
    assert far_frames_note(Clip(rest, vertices, 30.0), "a.glb") == ()


def test_bones_alone_are_written_by_another_command(tmp_path):
    with pytest.raises(InputError, match=r"bones alone; write it with mimesh animate CHARACTER a.bvh -o b.vrma"):
        convert(tmp_path / "a.bvh", tmp_path / "b.vrma")


@pytest.fixture
def walker(tmp_path) -> Path:
    """Write a skinned character with two animations of six frames, and GPU instances of a prop."""

    def with_instances(draft: Draft) -> None:
        places = draft.add_floats(np.array([[1.0, 0, 0], [2, 0, 0]]))
        extension = {"attributes": {"TRANSLATION": places}}
        positions = draft.add_floats(zoo.cube().vertices, 34962, bounds=True)
        primitive = {"attributes": {"POSITION": positions}, "indices": draft.add_indices(zoo.cube().faces)}
        draft.gltf["meshes"].append({"primitives": [primitive]})
        draft.gltf["nodes"].append({"name": "crates", "mesh": 1, "extensions": {"EXT_mesh_gpu_instancing": extension}})
        draft.gltf["scenes"][0]["nodes"].append(len(draft.gltf["nodes"]) - 1)
        draft.gltf["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]

    clips = {"walk": rigs.exercise(rigs.figure()), "run": rigs.exercise(rigs.figure(), seed=1)}
    return rigs.character(tmp_path / "walker.glb", clips=clips, change=with_instances)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_bones_and_animations_are_kept(suffix, walker, tmp_path):
    written = convert(walker, tmp_path / f"b{suffix}")
    assert written.notes == (f"b{suffix} has the animations walk, run",)
    gltf = open_document(tmp_path / f"b{suffix}").gltf
    assert (len(gltf["skins"]), len(gltf["animations"])) == (1, 2)
    assert not any("targets" in primitive for mesh in gltf["meshes"] for primitive in mesh["primitives"])
    for name in ("walk", "run"):
        before, after = (load_clip(path, animation=name) for path in (walker, tmp_path / f"b{suffix}"))
        np.testing.assert_array_equal(after.vertices, before.vertices)
    (crates,) = [node for node in gltf["nodes"] if node.get("name") == "crates"]
    index = crates["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["TRANSLATION"]
    places = read_floats(open_document(tmp_path / f"b{suffix}"), index)
    np.testing.assert_array_equal(places, [[1, 0, 0], [2, 0, 0]])


def test_chosen_frames_stay_on_the_bones(walker, tmp_path):
    whole = load_clip(walker, animation="run")
    convert(walker, tmp_path / "b.glb", ConvertOptions(animation="run"))
    assert list_animations(tmp_path / "b.glb") == ("run",)
    np.testing.assert_array_equal(load_clip(tmp_path / "b.glb").vertices, whole.vertices)
    written = convert(walker, tmp_path / "c.glb", ConvertOptions(animation="run", start=1, step=2))
    assert (written.frames, written.fps) == (len(whole.vertices[1::2]), whole.fps / 2)
    assert len(open_document(tmp_path / "c.glb").gltf["skins"]) == 1
    cut = load_clip(tmp_path / "c.glb", fps=written.fps)
    np.testing.assert_allclose(cut.vertices, whole.vertices[1::2], atol=1e-4)


def test_what_another_format_leaves_out_is_said(walker, tmp_path):
    lost = "bones and their animations and the GPU instances of 1 nodes"
    notes = convert(walker, tmp_path / "b.obj").notes
    assert (
        f"left out of b.obj: {lost}; mimesh convert walker.glb b.glb keeps them, mimesh capture walker.glb writes the "
        "motion of bones"
    ) in notes
    notes = convert(walker, tmp_path / "walker.obj").notes
    assert any(note.startswith(f"left out of walker.obj: {lost}; walker.glb keeps them, mimesh") for note in notes)
    notes = convert(walker, tmp_path / "c.glb", ConvertOptions(morphs=True)).notes
    assert f"left out of c.glb: {lost}; without options for frames they are kept" in notes
    assert "skins" not in open_document(tmp_path / "c.glb").gltf
    with pytest.raises(InputError, match=r"mimesh rig walker.glb -o d.vrm --author NAME --license URL"):
        convert(walker, tmp_path / "d.vrm")
    with pytest.raises(InputError, match=r"expected .glb or .gltf for --morphs, found '.usda'"):
        convert(walker, tmp_path / "d.usda", ConvertOptions(morphs=True))


def test_a_capture_becomes_the_body_with_its_bones(tmp_path):
    path = write_bvh(tmp_path / "a.bvh", load_body(), window(load_motion("jump"), 0.0, 0.2))
    assert "--morphs writes its surface alone" in convert(path, tmp_path / "a.glb").notes[-1]
    gltf = open_document(tmp_path / "a.glb").gltf
    assert len(gltf["skins"]) == 1
    assert not any("targets" in primitive for mesh in gltf["meshes"] for primitive in mesh["primitives"])
    difference = load_clip(tmp_path / "a.glb").vertices - np.asarray(load_clip(path).vertices)
    assert np.linalg.norm(difference, axis=-1).mean() < 1e-3  # four weights a vertex
    written = convert(path, tmp_path / "b.glb", ConvertOptions(step=3))
    assert written.fps == load_clip(path).fps / 3
    assert len(open_document(tmp_path / "b.glb").gltf["skins"]) == 1
