"""What VRM's extensions say: bones with fingers, expressions, and morph targets by name."""

import copy
import dataclasses

import numpy as np
import pytest
from vrm_files import BONES, bone_positions, vrm, vrma

import mimesh
from mimesh.bodies.engine_names import SCHEMES
from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.animation import read_channels
from mimesh.io.gltf.copied_motion import NamedWeights, morph_tracks, named_weights, plain_target, target_names
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.own_rig import read_own_rig
from mimesh.io.gltf.vrm import animated_expressions, vrm_bones, vrm_expressions

JOINT_OF = {bone: joint for joint, bone in SCHEMES["vrm"].bones.items()}


TARGETS = ("JawOpen", "jawOpen", "mouth_smile_L", "other")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A VRM 0 and a VRM 1 with morph targets, each with its rig and its nodes."""
    folder = tmp_path_factory.mktemp("vrm")
    groups = {"A": {"presetName": "a", "binds": [{"mesh": 0, "index": 1, "weight": 50}]}, "Mine": {}, "B": {}}
    groups["B"]["presetName"] = "Blink_L"
    return [vrm(folder / f"{version}.vrm", version, TARGETS, groups) for version in (0, 1)]


@pytest.fixture
def document(files):
    """The VRM 1, whose JSON a test may change."""
    opened = open_document(files[1][0])
    return dataclasses.replace(opened, gltf=copy.deepcopy(opened.gltf))


def shown_by(document):
    return next(number for number, node in enumerate(document.gltf["nodes"]) if "mesh" in node)


@pytest.mark.parametrize("version", [0, 1])
def test_all_bones_are_known_with_both_spellings_of_the_thumb(version, files):
    path, _, nodes = files[version]
    expected = {JOINT_OF[bone]: node for bone, node in nodes.items()}
    assert len(expected) == len(BONES) == 52
    assert vrm_bones(open_document(path)) == expected
    # The names of the nodes say nothing.
    assert read_own_rig(load_mesh(path)).person == expected


@pytest.mark.parametrize(
    "extension",
    [
        {"VRM": {"humanoid": {"humanBones": {"hips": 3}}}},
        {"VRMC_vrm": {"expressions": {"preset": {"aa": 3, "ih": {"morphTargetBinds": [1, {"node": -1, "index": 0}]}}}}},
        {"VRMC_vrm": {"expressions": [], "humanoid": {"humanBones": {"hips": {"node": True}}}}},
        {"VRM": {"blendShapeMaster": {"blendShapeGroups": [3, {"binds": {"mesh": 0}}, {"presetName": None}]}}},
        {"VRMC_vrm_animation": {"expressions": {"preset": {"aa": {"node": 10**9}}, "custom": 3}, "humanoid": None}},
        [],
    ],
)
def test_damaged_extensions_say_nothing(extension, document):
    document.gltf["extensions"] = extension
    assert vrm_bones(document) == {}
    assert all(expression.binds == () for expression in vrm_expressions(document).values())
    assert animated_expressions(document) == {}


def test_presets_of_vrm_0_have_the_names_of_vrm_1(files):
    document = open_document(files[0][0])
    found = vrm_expressions(document)
    assert found.keys() == {"aa", "Mine", "blinkLeft"}
    assert found["aa"].binds == ((shown_by(document), 1, 0.5),)


def test_spellings_of_targets():
    same = ("browInnerUp", "BrowInnerUp", "brow_inner_up", "blendShape1.browInnerUp", "Brow Inner Up")
    assert {plain_target(name) for name in same} == {"browinnerup"}
    assert {plain_target(name) for name in ("mouthSmileLeft", "mouthSmile_L", "mouthSmileL", "mouth_smile_l")} == {
        "mouthsmileleft"
    }
    assert plain_target("mouthRoll") == "mouthroll"
    assert plain_target("viseme_RR") == "visemerr"


def test_weights_go_to_targets_of_their_name(document):
    """Equal names count before other spellings, targets without a counterpart keep the weight of the file."""
    document.gltf["meshes"][0]["weights"] = [0.1, 0.2, 0.3, 0.4]
    document.gltf["extensions"]["VRMC_vrm"]["expressions"] = {}
    node = shown_by(document)
    rows = [
        NamedWeights("jawOpen", "head", np.array([0.0, 1.0])),
        NamedWeights("MouthSmileLeft", "", np.array([1.0, 0.0])),
    ]
    rows.append(NamedWeights("jawOpen", "teeth", np.zeros(2)))
    tracks = morph_tracks(document, rows)
    assert tracks.keys() == {(node, "weights")}
    assert tracks[node, "weights"].tolist() == [[0, 0, 1, 0.4], [1, 1, 0, 0.4]]
    assert morph_tracks(document, rows[2:])[node, "weights"].tolist() == [[0, 0, 0.3, 0.4]] * 2
    assert morph_tracks(document, [NamedWeights("cheekPuff", "", np.ones(2))]) == {}


def test_names_in_primitives_are_read_and_damaged_ones_are_not(document):
    node = shown_by(document)
    mesh = document.gltf["meshes"][0]
    mesh["primitives"][0]["extras"] = mesh.pop("extras")
    assert target_names(document, node) == list(TARGETS)
    for damaged in (3, {"targetNames": 3}, {"targetNames": ["a", 3]}):
        mesh["primitives"][0]["extras"] = damaged
        assert target_names(document, node) == []


def test_an_animation_plays_on_the_shipped_body(files, tmp_path):
    """Its expressions are weights between 0 and 1."""
    _, rig, _ = files[1]
    path, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig), frames=3, expressions={"aa": np.array([-1, 0.5, 2])})
    document = open_document(path)
    (row,) = named_weights(document, read_channels(document, 0), np.arange(3) / 30)
    assert (row.name, row.owner) == ("aa", None)
    assert np.allclose(row.values, [0, 0.5, 1], atol=1e-6)
    clip = load_clip(path)
    assert (len(clip), clip.fps) == (3, 30.0)
    assert len(load_mesh(path).vertices) == 6890
    # Axes of the nodes are random, yet the person of the file stands and faces +z in the first frame's rest.
    person = clip.skeleton.person()
    assert {"LeftHandThumb1", "RightHandPinky3"} <= set(person.joints)
    assert person.weights.shape == (6890, len(person.joints))
    assert np.allclose(person.weights.sum(axis=1), 1)


def test_a_vrm_holds_no_animation(files, model, tmp_path):
    path, rig, _ = files[1]
    drive, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig), frames=2)
    result = mimesh.animate(path, drive, model)
    for save in (result.save, result.save_skinned):
        with pytest.raises(InputError, match=r"found \.vrm, which holds none by its specification; write b\.vrma "):
            save(tmp_path / "b.vrm")
    assert not (tmp_path / "b.vrm").exists()
