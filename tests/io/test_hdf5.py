"""HDF5 files in the layout of DFAUST's registrations: several clips of one topology, stored as (V, 3, T)."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
import zoo
from people import person
from smpl_files import write_dfaust

from mimesh.__main__ import run
from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.io import list_animations, load_clip, load_mesh, save_mesh

h5py = pytest.importorskip("h5py")
GRID = zoo.grid()
NAMES = ("50002_chicken_wings", "50002_jumping_jacks", "50009_hips")


@pytest.fixture(scope="module")
def clips():
    """Three clips of a grid: more frames than are read at once, and shorter ones."""
    rng = np.random.default_rng(0)
    moved = [GRID.vertices + 0.1 * rng.standard_normal((frames, 1, 3)) for frames in (40, 3, 1)]
    return {name: points.astype(np.float32) for name, points in zip(NAMES, moved, strict=True)}


@pytest.fixture(scope="module")
def path(clips, tmp_path_factory):
    return write_dfaust(tmp_path_factory.mktemp("dfaust") / "registrations_f.hdf5", clips, GRID.faces)


@pytest.mark.parametrize(
    ("choice", "options"),
    [("50002_chicken_wings", {"chunks": (10, 3, 1)}), ("50002_CHICKEN_WINGS", {"compression": "gzip"}), ("0", {})],
)
def test_a_chosen_clip_is_read_exactly(choice, options, clips, tmp_path):
    path = write_dfaust(tmp_path / "registrations_m.hdf5", clips, GRID.faces.astype(np.uint32), **options)
    clip = load_clip(path, animation=choice)
    np.testing.assert_array_equal(clip.vertices, clips[NAMES[0]])
    np.testing.assert_array_equal(clip.mesh.faces, GRID.faces)
    assert (clip.fps, clip.mesh.name) == (60.0, NAMES[0])
    assert load_clip(path, animation=choice, fps=30.0).fps == 30.0


def test_the_names_are_listed_where_none_is_chosen(path):
    assert list_animations(path) == NAMES
    for load in (load_clip, load_mesh):
        with pytest.raises(InputError, match="one of its 3 clips.*with animation=...: " + ", ".join(NAMES)):
            load(path)
    with pytest.raises(InputError, match=r"50002_chicken_wings, 50002_jumping_jacks, 50009_hips.*'running'"):
        load_clip(path, animation="running")


def test_the_only_clip_needs_no_name(clips, tmp_path):
    path = write_dfaust(tmp_path / "one.hdf5", {"hips": clips["50009_hips"]}, GRID.faces)
    np.testing.assert_array_equal(load_clip(path).vertices, clips["50009_hips"])
    np.testing.assert_allclose(load_mesh(path).vertices, clips["50009_hips"][0])


def test_look_lists_the_clips(path, capsys, monkeypatch):
    # How the figure stands takes a network seconds to find.
    monkeypatch.setattr("mimesh.tools.inspect._stands", lambda mesh: None)
    assert run(["look", str(path)]) == 0
    printed = capsys.readouterr().out
    for name, seconds in zip(NAMES, ("0.67 s", "0.05 s", "0.02 s"), strict=True):
        assert f"{name}, {seconds}" in printed
    assert run(["look", str(path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)["files"][0]
    assert facts["animations"] == list(NAMES)
    assert (facts["frames"], facts["vertices"]) == (40, 25)


def test_clips_are_converted_from_the_command_line(path, clips, tmp_path, capsys):
    assert run(["convert", str(path), str(tmp_path / "out.npz")]) == 2
    assert "50002_jumping_jacks" in capsys.readouterr().err
    assert run(["convert", str(path), str(tmp_path / "out.npz"), "--animation", NAMES[1]]) == 0
    with np.load(tmp_path / "out.npz") as written:
        np.testing.assert_allclose(written["vertices"], clips[NAMES[1]], atol=1e-5)
        assert written["fps"] == 60.0
    assert run(["convert", str(path), str(tmp_path / "pose.obj"), "--animation", NAMES[1], "--frame", "2"]) == 0
    np.testing.assert_allclose(load_mesh(tmp_path / "pose.obj").vertices, clips[NAMES[1]][2], atol=1e-5)


@pytest.mark.slow
def test_animate_takes_several_clips_of_a_file(model, tmp_path, capsys):
    body, rng = load_body(), np.random.default_rng(0)
    clips = {
        name: body.vertices + 0.1 * rng.standard_normal((frames, 1, 3))
        for name, frames in zip(NAMES, (1, 3, 1), strict=True)
    }
    path = write_dfaust(tmp_path / "registrations_f.hdf5", clips, body.faces)
    save_mesh(person(), tmp_path / "hero.obj")
    command = ["animate", str(tmp_path / "hero.obj"), str(path), "-m", model, "--no-preview"]
    choice = ["--animation", NAMES[1], "--animation", "50009_hips"]
    assert run([*command, *choice, "-o", str(tmp_path / "out.glb"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [clip["name"] for clip in facts["clips"]] == [NAMES[1], "50009_hips"]
    assert any(
        "has no frame rate: 60 frames a second are taken" in note for note in facts["clips"][0]["report"]["notes"]
    )


def write_with(path, **datasets):
    with h5py.File(path, "w") as file:
        for name, data in datasets.items():
            file[name] = data
    return path


POINTS = np.random.default_rng(0).random((4, 3, 2))
FACES = np.array([[0, 1, 2], [1, 2, 3]])
WRONG = {
    "no faces": ({"a": POINTS}, "expected a dataset 'faces'"),
    "no clips": ({"faces": FACES}, r"expected datasets of shape \(V, 3, T\).*found none"),
    "frames first": ({"a": np.moveaxis(POINTS, 2, 0), "faces": FACES}, r"\(V, 3, T\).*found a \(2, 4, 3\)"),
    "quads": ({"a": POINTS, "faces": np.zeros((1, 4), int)}, r"'faces' to be whole numbers of shape \(F, 3\)"),
    "faces of other vertices": ({"a": POINTS, "faces": FACES + 2}, r"face indices in 0\.\.3, found 5"),
    "no frames": ({"a": POINTS[..., :0], "faces": FACES}, "at least one frame"),
    "NaN": ({"a": POINTS * np.nan, "faces": FACES}, "NaN or infinity"),
    "text": ({"a": "hello", "faces": FACES}, r"\(V, 3, T\)"),
}


@pytest.mark.parametrize("name", WRONG)
def test_other_layouts_give_one_line(name, tmp_path):
    datasets, message = WRONG[name]
    with pytest.raises(InputError, match=message) as error:
        load_clip(write_with(tmp_path / "a.hdf5", **datasets))
    assert "\n" not in str(error.value)


def test_a_file_cut_short_is_refused(tmp_path):
    path = write_with(tmp_path / "a.hdf5", a=np.random.default_rng(0).random((500, 3, 9)), faces=FACES)
    data = path.read_bytes()
    for end in (0, 8, 600, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:end])
        with pytest.raises(InputError) as error:
            load_clip(path)
        assert "\n" not in str(error.value)


def test_a_dataset_whose_name_is_no_text_is_no_clip(tmp_path):
    path = write_with(tmp_path / "a.hdf5", a=POINTS, other=POINTS, faces=FACES)
    path.write_bytes(path.read_bytes().replace(b"other", b"oth\xffr"))
    assert list_animations(path) == ("a",)
    assert len(load_clip(path)) == 2


def test_a_dataset_that_claims_more_than_it_stores_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file.create_dataset("a", shape=(6890, 3, 10**9), dtype="f4", chunks=(6890, 3, 1))
        file["faces"] = FACES
    with pytest.raises(InputError, match="expected the values of 'a' in the file, found 0 bytes"):
        load_clip(tmp_path / "a.hdf5")


def test_a_chunk_that_would_fill_the_memory_is_refused(tmp_path):
    """A dataset in one chunk would be unpacked whole for every block of frames: minutes for a file of two megabytes."""
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        shape = (200_000, 3, 200)
        data = file.create_dataset("a", shape=shape, dtype="f4", chunks=shape, compression="gzip")
        data.id.write_direct_chunk((0, 0, 0), b"0" * 250_000)
        file["faces"] = FACES
    with pytest.raises(InputError, match="expected chunks of at most 256 MiB in 'a', found 457; save it in smaller"):
        load_clip(tmp_path / "a.hdf5")


def test_chunks_of_many_frames_are_unpacked_once(tmp_path):
    """20,000 frames in one chunk, more than HDF5 keeps: unpacked for every 32 frames, it would take half a minute."""
    points = np.random.default_rng(0).random((30, 3, 1)).astype(np.float32) + np.zeros(20_000, np.float32)
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file.create_dataset("a", data=points, chunks=points.shape, compression="gzip", compression_opts=1)
        file["faces"] = FACES
    started = time.process_time()
    np.testing.assert_array_equal(load_clip(tmp_path / "a.hdf5").vertices, np.moveaxis(points, 2, 0))
    assert time.process_time() - started < 5


def test_links_to_other_files_are_not_followed(tmp_path):
    other = write_with(tmp_path / "other.hdf5", a=POINTS, faces=FACES)
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file["a"] = h5py.ExternalLink(str(other), "/a")
        file["faces"] = FACES
    with pytest.raises(InputError, match=r"expected datasets of shape \(V, 3, T\)"):
        load_clip(tmp_path / "a.hdf5")
    (tmp_path / "secret").write_bytes(np.ones((4, 3, 2)).tobytes())
    with h5py.File(tmp_path / "b.hdf5", "w") as file:
        file.create_dataset("a", shape=(4, 3, 2), dtype="f8", external=[(str(tmp_path / "secret"), 0, 192)])
        file["faces"] = FACES
    with pytest.raises(InputError, match=r"expected datasets of shape \(V, 3, T\)"):
        load_clip(tmp_path / "b.hdf5")
