"""`mimesh animate`: joints by default, frames with --morphs, and several clips in one file."""

import json

import numpy as np
import pytest
import rigs
from networks import write_mime_network
from people import person, walk
from vrm_files import bone_positions, vrm, vrma

import mimesh
from mimesh.cli import run
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.io.gltf.document import open_document
from mimesh.pipeline.skinned import save_skinned
from mimesh.tools.convert import choose_clips

pytest.importorskip("onnx")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """hero.glb, walk.glb, run.npz, twin.npz, pose.obj, and the network mime.onnx."""
    folder = tmp_path_factory.mktemp("clips")
    write_mime_network(folder / "mime.onnx")
    save_mesh(person(0), folder / "hero.glb")
    save_clip(walk(faces=600), folder / "walk.glb")
    save_clip(walk(2, frames=5, faces=600), folder / "run.npz")
    save_clip(walk(2, frames=5), folder / "twin.npz")  # of the identity's topology
    save_mesh(person(1, pose=0), folder / "pose.obj")
    return folder


def animate(files, *words, model="mime.onnx"):
    model = str(files / model) if model.endswith(".onnx") else model
    paths = [str(files / word) if "." in str(word) else str(word) for word in words]
    return run(["animate", str(files / "hero.glb"), *paths, "-m", model])


def test_joints_are_the_default_of_a_glb(files, capsys):
    assert animate(files, "walk.glb", "-o", "a.glb", "--no-preview", "--json") == 0
    report = json.loads(capsys.readouterr().out)["report"]
    assert report["skinned_deviation"] < 1e-4
    assert report["influence_deviation"] < 1e-5  # three joints are fewer than four
    gltf = open_document(files / "a.glb").gltf
    assert len(gltf["skins"]) == 1
    assert [animation["name"] for animation in gltf["animations"]] == ["walk"]


def test_morph_targets_and_other_formats_have_frames(files, capsys):
    for words in (["-o", "b.glb", "--morphs"], ["-o", "c.glb", "--blendshapes", "2"], ["-o", "d.npz"]):
        assert animate(files, "walk.glb", *words, "--no-preview", "--json") == 0
        assert "skinned_deviation" not in json.loads(capsys.readouterr().out)["report"]
    assert "skins" not in open_document(files / "b.glb").gltf
    assert np.allclose(load_clip(files / "b.glb").vertices, load_clip(files / "d.npz").vertices, atol=1e-4)


def test_a_model_without_joints_and_a_pose_have_frames(files):
    assert animate(files, "twin.npz", "-o", "e.glb", "--no-preview", "-q", model="copy") == 0
    assert animate(files, "pose.obj", "-o", "f.glb", "--no-preview", "-q") == 0
    assert animate(files, "pose.obj", "-o", "g.glb", "--no-preview", "-q", "--skinned") == 0
    assert ["skins" in open_document(files / f"{name}.glb").gltf for name in "efg"] == [False, False, True]


def test_a_copied_animation_has_a_preview(files, capsys):
    path = str(rigs.of_kind(files / "mover.glb", "T-pose")[0])
    assert run(["animate", path, path, "-o", str(files / "i.glb"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)["report"]
    assert report["copied"]
    assert [report[which]["up_from"] for which in ("identity", "driving")] == ["joints", "file"]
    assert report["identity"]["up"] == report["driving"]["up"] == "+y"
    assert (files / "i.preview.html").exists()


def test_a_pose_is_put_on_the_bones_of_a_rigged_file(files):
    rigged = rigs.of_kind(files / "rigged.glb", "T-pose", moving=False)[0]
    pose = rigs.of_kind(files / "standing.glb", "A-pose", moving=False)[0]
    assert run(["animate", str(rigged), str(pose), "-o", str(files / "h.glb"), "--no-preview", "-q"]) == 0
    assert open_document(files / "h.glb").gltf["skins"] == open_document(rigged).gltf["skins"]


def test_several_clips_become_animations_of_one_file(files, capsys):
    assert animate(files, "walk.glb", "run.npz", "walk.glb", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["output"] == str(files / "hero-clips.glb")
    assert (facts["frames"], facts["fps"]) == (13, 10)
    assert [(clip["frames"], clip["fps"]) for clip in facts["clips"]] == [(4, 10), (5, 10), (4, 10)]
    assert [clip["name"] for clip in facts["clips"]] == ["walk", "run", "walk-2"]
    assert all(clip["report"]["skinned_deviation"] < 1e-4 for clip in facts["clips"])
    assert load_mesh(files / "hero-clips.glb").source.animations == ("walk", "run", "walk-2")
    assert len(load_clip(files / "hero-clips.glb", animation="run")) == 5
    for name in ("walk", "run", "walk-2"):
        assert (files / f"hero-clips-{name}.preview.html").exists()
    assert animate(files, "walk.glb", "run.npz", "--no-preview") == 0
    text = capsys.readouterr().out
    assert "2 clips" in text
    assert "clip: run, 5 frames at 10 per second" in text
    assert "note: run: " not in text


@pytest.fixture(scope="module")
def moves(files):
    """A rigged file with the animations Rig|Walk, Rig|Run and one without a name."""
    path = rigs.of_kind(files / "rigged-mover.glb", "T-pose")[0]
    result = mimesh.animate(path, path)
    save_skinned([result] * 3, files / "moves.glb", animations=["Rig|Walk", "Rig|Run", "2"])
    return files / "moves.glb"


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["moves.glb", "--animation", "Walk", "--animation", "run"], ["Walk", "Run"]),
        (["moves.glb", "moves.glb", "--animation", "1", "--animation", "RIG|walk"], ["Run", "Walk"]),
        (["moves.glb", "--animation", "all"], ["Walk", "Run", "moves", "move"]),
        (["moves.glb", "walk.glb", "--animation", "all"], ["Walk", "Run", "moves", "move", "walk"]),
        (["moves.glb", "walk.glb"], ["Walk", "walk"]),
        (["moves.glb", "--animation", "Run"], ["Run"]),
        (["walk.glb", "--animation", "0"], ["walk"]),
    ],
)
def test_animations_of_driving_files_are_chosen_and_named(moves, words, names):
    start = words.index("--animation") if "--animation" in words else len(words)
    clips = choose_clips([moves.parent / word for word in words[:start]], words[start + 1 :: 2])
    assert [clip.name for clip in clips] == names


@pytest.mark.slow
def test_one_file_of_several_animations_becomes_one_file_of_several_clips(moves, tmp_path, capsys):
    words = ["animate", str(moves), str(moves), "-o", str(tmp_path / "a.glb"), "--json"]
    assert run([*words, "--animation", "Walk", "--animation", "Run"]) == 0
    assert [clip["name"] for clip in json.loads(capsys.readouterr().out)["clips"]] == ["Walk", "Run"]
    assert load_mesh(tmp_path / "a.glb").source.animations[:2] == ("Walk", "Run")
    assert (tmp_path / "a-Run.preview.html").exists()
    assert run([*words[:-1], "--animation", "Walk", "--animation", "Run"]) == 0
    text = capsys.readouterr().out
    assert f"picture: {tmp_path / 'a-Walk.preview.png'}\npage: {tmp_path / 'a-Walk.preview.html'}\n" in text
    assert f"next: open {tmp_path / 'a-Walk.preview.html'} in a browser" in text


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["moves.glb", "walk.glb", "--animation", "Walk"], "expected one for each of 2 DRIVING, found 1"),
        (["moves.glb", "--animation", "Walk", "--animation", "Fly"], "Rig|Walk, Rig|Run, 2, move), found 'Fly'"),
        (
            ["walk.glb", "--animation", "0", "--save-driving-joints", "x.json", "--animation", "0"],
            "clip with it, found 2",
        ),
    ],
)
def test_other_animations_are_refused(moves, files, words, expected, capsys):
    assert animate(files, *words) == 2
    assert expected in capsys.readouterr().err


def test_an_animation_is_chosen_once_where_one_clip_is_taken(moves, tmp_path, capsys):
    words = ["--animation", "Walk", "--animation", "Run"]
    assert run(["convert", str(moves), str(tmp_path / "a.npz"), *words]) == 2
    assert run(["render", str(moves), "-o", str(tmp_path / "a.png"), *words]) == 2
    assert capsys.readouterr().err.count("--animation: expected it once, found Walk, Run; choose one of them") == 2


def test_a_vrma_has_bones_alone(files, tmp_path, capsys):
    path, _, _ = vrm(tmp_path / "avatar.vrm")
    words = ["animate", str(path), str(files / "pose.vrma"), "--no-preview", "--json", "-o"]
    drive(files / "pose.vrma")
    assert run([*words, str(tmp_path / "a.vrma"), "--output-fps", "60"]) == 0
    assert json.loads(capsys.readouterr().out)["report"]["rig"] == "own"
    assert load_clip(tmp_path / "a.vrma").fps == 60
    assert run([*words, str(tmp_path / "b.vrma"), "--names", "mixamo"]) == 2
    assert "which has the bones of VRM; leave them out" in capsys.readouterr().err
    assert run([*words, str(tmp_path / "b.vrm")]) == 2
    assert "found .vrm, which holds none by its specification; write b.vrma" in capsys.readouterr().err


@pytest.mark.slow
def test_a_vrm_in_a_pose_has_a_note(files, tmp_path, capsys):
    path, _, _ = vrm(tmp_path / "avatar.vrm")
    drive(files / "pose.vrma")
    posed = str(tmp_path / "posed.vrm")
    assert run(["transfer", str(path), str(files / "pose.vrma"), "-o", posed, "--no-preview", "--json"]) == 0
    notes = json.loads(capsys.readouterr().out)["report"]["notes"]
    assert any(note.startswith("posed.vrm rests in the pose") for note in notes)


def drive(path):
    """Write a VRM animation of the skeleton of a generated VRM."""
    _, rig, _ = vrm(path.with_name("skeleton.vrm"))
    vrma(path, bone_positions(rig), spread=0.1)
