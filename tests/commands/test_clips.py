"""`mimesh animate`: joints by default, frames with --morphs, names of engines, and several clips in one file."""

import json

import numpy as np
import pygltflib
import pytest
import rigs
from networks import write_mime_network
from people import person, walk
from vrm_files import bone_positions, vrm, vrma

import mimesh
from mimesh.bodies import load_body
from mimesh.commands.facts import print_facts
from mimesh.commands.options import OutputOptions
from mimesh.io import load_clip, load_mesh, save_bvh, save_clip, save_mesh
from mimesh.io.gltf.document import open_document
from mimesh.motions.procedural import walk_motion
from mimesh.pipeline.skinned import distinct_names, save_skinned
from mimesh.tools.driving import choose_clips

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


def animate(files, call, *words, model="mime.onnx"):
    """Animate hero.glb by files of the folder; words with a dot are their names."""
    paths = [str(files / word) if "." in word else word for word in ("hero.glb", *words, "-m", model)]
    ended = call(" ".join(["animate", *paths]))
    assert ended.code == 0, ended.err
    return ended


def written(files, call, *words, **options):
    """Animate, and return the facts that are printed as JSON."""
    return json.loads(animate(files, call, *words, "--json", **options).out)


def test_joints_are_the_default_of_a_glb(files, call):
    report = written(files, call, "walk.glb", "-o", "a.glb", "--no-preview")["report"]
    assert report["skinned_deviation"] < 1e-4
    assert report["influence_deviation"] < 1e-5  # three joints are fewer than four
    gltf = open_document(files / "a.glb").gltf
    assert len(gltf["skins"]) == 1
    assert [animation["name"] for animation in gltf["animations"]] == ["walk"]


def test_morph_targets_and_other_formats_have_frames(files, call):
    for words in (["-o", "b.glb", "--morphs"], ["-o", "d.npz"]):
        assert "skinned_deviation" not in written(files, call, "walk.glb", *words, "--no-preview")["report"]
    assert "skins" not in open_document(files / "b.glb").gltf
    assert np.allclose(load_clip(files / "b.glb").vertices, load_clip(files / "d.npz").vertices, atol=1e-4)


def test_a_model_without_joints_and_a_pose_have_frames(files, call):
    animate(files, call, "twin.npz", "-o", "e.glb", "--no-preview", model="copy")
    animate(files, call, "pose.obj", "-o", "f.glb", "--no-preview")
    animate(files, call, "pose.obj", "-o", "g.glb", "--no-preview", "--skinned")
    assert ["skins" in open_document(files / f"{name}.glb").gltf for name in "efg"] == [False, False, True]


def test_a_pose_is_put_on_the_bones_of_a_rigged_file(files, call):
    rigged = rigs.of_kind(files / "rigged.glb", "T-pose", moving=False)[0]
    pose = rigs.of_kind(files / "standing.glb", "A-pose", moving=False)[0]
    assert call(f"animate {rigged} {pose} -o {files / 'h.glb'} --no-preview").code == 0
    assert open_document(files / "h.glb").gltf["skins"] == open_document(rigged).gltf["skins"]


@pytest.mark.slow
def test_several_clips_become_animations_of_one_file(files, call, capsys):
    facts = written(files, call, "walk.glb", "run.npz", "walk.glb")
    assert facts["output"] == str(files / "hero-clips.glb")
    assert (facts["frames"], facts["fps"]) == (13, 10)
    assert [(clip["frames"], clip["fps"]) for clip in facts["clips"]] == [(4, 10), (5, 10), (4, 10)]
    names = ["walk", "run", "walk-2"]
    assert [clip["name"] for clip in facts["clips"]] == names
    assert all(clip["report"]["skinned_deviation"] < 1e-4 for clip in facts["clips"])
    assert load_mesh(files / "hero-clips.glb").source.animations == tuple(names)
    assert len(load_clip(files / "hero-clips.glb", animation="run")) == 5
    pages = [files / f"hero-clips-{name}.preview" for name in names]
    assert all(page.with_suffix(".preview.html").exists() for page in pages)
    print_facts(facts, OutputOptions())
    text = capsys.readouterr().out
    assert "3 clips" in text
    assert "clip: run, 5 frames at 10 per second" in text
    assert "note: run: " not in text
    assert f"picture: {pages[0]}.png\npage: {pages[0]}.html\n" in text
    assert f"next: open {pages[0]}.html in a browser" in text


@pytest.mark.slow
def test_only_the_first_of_many_clips_get_pictures_and_pages(files, call):
    report = written(files, call, *["walk.glb"] * 5, "-o", "many.glb", "--stop", "2")["report"]
    names = [f"many-{name}.preview" for name in ("walk", "walk-2", "walk-3")]
    assert report["pictures"] == [str(files / f"{name}.png") for name in names]
    assert {path.name for path in files.glob("many*.html")} == {f"{name}.html" for name in names}
    assert [note for note in report["notes"] if note.startswith("pictures and pages are of the first 3 of 5 clips; ")]
    text = animate(files, call, *["walk.glb"] * 5, "-o", "out/many.glb", "--stop", "2").out
    command = f"mimesh render {files / 'out' / 'many.glb'} -o NAME.html --animation NAME shows another\n"
    assert text.count(f"\nnote: pictures and pages are of the first 3 of 5 clips; {command}") == 1
    report = written(files, call, *["walk.glb"] * 5, "-o", "none.glb", "--stop", "2", "--no-preview")["report"]
    assert not [note for note in report["notes"] if note.startswith("pictures")]


@pytest.mark.slow
def test_engine_names_root_bone_rest_and_rate(files, call):
    options = ("--names", "unreal", "--root-bone", "--rest", "A", "--output-fps", "60")
    text = animate(files, call, "walk.glb", "-o", "j.glb", "--no-preview", "--stop", "3", *options, model="mime").out
    assert ", 13 frames at 60 per second, " in text
    assert "note: sampled from 3 frames at 10 per second\n" in text
    gltf = open_document(files / "j.glb").gltf
    names = [gltf["nodes"][joint]["name"] for joint in gltf["skins"][0]["joints"]]
    assert names[:3] == ["root", "pelvis", "spine_01"]
    times = [gltf["accessors"][sampler["input"]] for sampler in gltf["animations"][0]["samplers"]]
    assert max((entry["count"], round(entry["max"][0], 6)) for entry in times) == (13, 0.2)
    text = animate(files, call, "walk.glb", "-o", "k.glb", "--no-preview", "--step", "2", "--output-fps", "5").out
    assert ", 2 frames at 5 per second, " in text, "the rate of the frames that are taken: nothing is sampled"
    assert "sampled from" not in text
    text = animate(files, call, "walk.glb", "-o", "l.glb", "--no-preview", "--stop", "3", "--output-fps", "24").out
    assert "note: sampled from 3 frames at 10 per second: its last 0.033 s, less than a frame, are left out\n" in text


@pytest.mark.slow
def test_thighs_beside_the_hips_of_an_own_rig_are_noted_with_a_scheme(files, call):
    animate(files, call, "walk.glb", "-o", "out.glb", "--no-preview", model="mime")
    gltf = pygltflib.GLTF2().load(str(files / "out.glb"))
    nodes = {node.name: (number, node) for number, node in enumerate(gltf.nodes)}
    (hips, hips_node), root = nodes["Hips"], pygltflib.Node(name="Body", children=[])
    for joint, thigh in (("LHipJoint", "LeftUpLeg"), ("RHipJoint", "RightUpLeg")):
        number, node = nodes[thigh]
        above = [hips_node.translation, nodes[joint][1].translation]
        node.translation = np.sum([node.translation, *above], axis=0).tolist()  # no bone is turned at rest
        nodes[joint][1].children.remove(number)
        root.children.append(number)
    root.children.append(hips)
    gltf.animations = []
    gltf.nodes.append(root)
    gltf.scenes[0].nodes = [n for n in gltf.scenes[0].nodes if n != hips] + [len(gltf.nodes) - 1]
    gltf.save(str(files / "body.glb"))
    line = f"animate {files / 'body.glb'} {files / 'walk.glb'} -o {files / 'moved.glb'} --no-preview"
    assert "hierarchy" not in call(line).out
    assert (
        "note: body: in the hierarchy of its rig LeftUpLeg, RightUpLeg are below other bones than in a humanoid"
        in call(f"{line} --names vrm").out
    )


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
        (["moves.glb", "walk.glb", "--animation", "all"], ["Walk", "Run", "moves", "move", "walk-2"]),
        (["moves.glb", "walk.glb"], ["Walk", "walk-2"]),
        (["moves.glb", "--animation", "Run"], ["Run"]),
        (["walk.glb", "--animation", "0"], ["walk"]),
    ],
)
def test_animations_of_driving_files_are_chosen_and_named(moves, words, names):
    start = words.index("--animation") if "--animation" in words else len(words)
    clips = choose_clips([moves.parent / word for word in words[:start]], words[start + 1 :: 2])
    assert [clip.name for clip in clips] == names


@pytest.mark.slow
def test_one_file_of_several_animations_becomes_one_file_of_several_clips(moves, tmp_path, call):
    out = tmp_path / "a.glb"
    facts = json.loads(
        call(f"animate {moves} {moves} -o {out} --no-preview --json --animation Walk --animation Run").out
    )
    assert [clip["name"] for clip in facts["clips"]] == ["Walk", "Run"]
    assert all(clip["report"]["copied"] for clip in facts["clips"])
    assert load_mesh(out).source.animations[:2] == ("Walk", "Run")


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
def test_other_animations_are_refused(moves, files, words, expected, refuses):
    paths = [str(files / word) if "." in word else word for word in ("hero.glb", *words)]
    refuses(" ".join(["animate", *paths]), expected)


@pytest.mark.slow
def test_a_vrma_has_bones_alone(files, tmp_path, call):
    path, _, _ = vrm(tmp_path / "avatar.vrm")
    _, rig, _ = vrm(tmp_path / "skeleton.vrm")
    vrma(tmp_path / "pose.vrma", bone_positions(rig), spread=0.1)
    line = f"animate {path} {tmp_path / 'pose.vrma'} --no-preview --json -o {tmp_path}"
    facts = json.loads(call(f"{line}/a.vrma --output-fps 60").out)
    assert (facts["report"]["rig"], facts["fps"]) == ("own", 60)
    assert "meshes" not in open_document(tmp_path / "a.vrma").gltf
    assert "which has the bones of VRM; leave them out" in call(f"{line}/b.vrma --names mixamo").err
    assert "found .vrm, which holds none by its specification; write b.vrma" in call(f"{line}/b.vrm").err


def test_notes_of_a_capture_are_told_once(files, call, tmp_path):
    capture = save_bvh(walk_motion(load_body(), 0, 0, seconds=0.2), load_body(), tmp_path / "walk.bvh")
    capture.write_text(capture.read_text() + capture.read_text().splitlines()[-1] + "\n")
    ended = call(
        f"animate {files / 'hero.glb'} {capture} -m {files / 'mime.onnx'} -o {tmp_path / 'a.glb'} --no-preview"
    )
    assert ended.out.count("note: walk.bvh") == 1, ended.out


def test_clips_whose_names_a_system_takes_for_one_are_numbered():
    assert distinct_names(["a/b", "a:b", "Walk", "walk", "walk"]) == ["a/b", "a:b-2", "Walk", "walk-2", "walk-3"]
