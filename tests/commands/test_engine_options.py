"""The options of `animate` for game engines: what they write, and one line where they do not fit."""

import numpy as np
import pygltflib
import pytest
from people import person, walk

from mimesh.cli import run
from mimesh.io import save_clip, save_mesh
from mimesh.io.gltf.document import open_document


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    save_mesh(person(0), folder / "hero.obj")
    save_clip(walk(frames=3), folder / "walk.glb")
    return folder


def animate(files, *more):
    words = ["animate", files / "hero.obj", files / "walk.glb", "-o", files / "out.glb", "--no-preview", *more]
    return run([str(word) for word in words])


def test_engine_names_root_bone_rest_and_rate(files, capsys):
    options = ("--names", "unreal", "--root-bone", "--rest", "A", "--output-fps", "60")
    assert animate(files, *options) == 0
    text = capsys.readouterr().out
    assert ", 13 frames at 60 per second, " in text
    assert "note: sampled from 3 frames at 10 per second\n" in text
    gltf = open_document(files / "out.glb").gltf
    names = [gltf["nodes"][joint]["name"] for joint in gltf["skins"][0]["joints"]]
    assert names[:3] == ["root", "pelvis", "spine_01"]
    times = [gltf["accessors"][sampler["input"]] for sampler in gltf["animations"][0]["samplers"]]
    assert max((entry["count"], round(entry["max"][0], 6)) for entry in times) == (13, 0.2)


@pytest.mark.slow
def test_no_sampling_is_noted_at_the_rate_of_the_frames_that_are_taken(files, capsys):
    assert animate(files, "--step", "2", "--output-fps", "5") == 0
    text = capsys.readouterr().out
    assert ", 2 frames at 5 per second, " in text
    assert "sampled from" not in text


@pytest.mark.slow
def test_thighs_beside_the_hips_of_an_own_rig_are_noted_with_a_scheme(files, capsys):
    assert animate(files) == 0
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
    words = ["animate", files / "body.glb", files / "walk.glb", "-o", files / "moved.glb", "--no-preview"]
    assert run([str(word) for word in words]) == 0
    assert "thighs" not in capsys.readouterr().out
    assert run([str(word) for word in (*words, "--names", "vrm")]) == 0
    assert "note: body: in the hierarchy of its rig the thighs are not children of the hips" in capsys.readouterr().out
