"""What VRM's extensions say: bones with fingers, expressions, and morph targets by name."""

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


@pytest.mark.parametrize("version", [0, 1])
def test_all_bones_are_known_with_both_spellings_of_the_thumb(version, tmp_path):
    path, _, nodes = vrm(tmp_path / "a.vrm", version)
    expected = {JOINT_OF[bone]: node for bone, node in nodes.items()}
    assert len(expected) == len(BONES) == 52
    assert vrm_bones(open_document(path)) == expected
    # The names of the nodes say nothing.
    assert read_own_rig(load_mesh(path)).person == expected


def edited(path, change):
    """A document with other JSON."""
    document = open_document(path)
    gltf = {**document.gltf, "extensions": change(document.gltf["extensions"])}
    return dataclasses.replace(document, gltf=gltf)


@pytest.mark.parametrize(
    "extension",
    [
        {"VRMC_vrm": {"expressions": {"preset": {"aa": 3, "ih": {"morphTargetBinds": [1, {"node": -1, "index": 0}]}}}}},
        {"VRMC_vrm": {"expressions": [], "humanoid": {"humanBones": {"hips": {"node": True}}}}},
        {"VRM": {"blendShapeMaster": {"blendShapeGroups": [3, {"binds": {"mesh": 0}}, {"presetName": None}]}}},
        {"VRMC_vrm_animation": {"expressions": {"preset": {"aa": {"node": 10**9}}, "custom": 3}, "humanoid": None}},
        [],
    ],
)
def test_damaged_extensions_say_nothing(extension, tmp_path):
    document = edited(vrm(tmp_path / "a.vrm")[0], lambda _: extension)
    assert vrm_bones(document) == {}
    assert all(expression.binds == () for expression in vrm_expressions(document).values())
    assert animated_expressions(document) == {}


def test_presets_of_vrm_0_have_the_names_of_vrm_1(tmp_path):
    groups = {"A": {"presetName": "a", "binds": [{"mesh": 0, "index": 1, "weight": 50}]}, "Mine": {}, "B": {}}
    groups["B"]["presetName"] = "Blink_L"
    path, _, _ = vrm(tmp_path / "a.vrm", 0, ("x", "y"), groups)
    found, document = vrm_expressions(open_document(path)), open_document(path)
    shown = next(number for number, node in enumerate(document.gltf["nodes"]) if "mesh" in node)
    assert found.keys() == {"aa", "Mine", "blinkLeft"}
    assert found["aa"].binds == ((shown, 1, 0.5),)


def test_spellings_of_targets():
    same = ("browInnerUp", "BrowInnerUp", "brow_inner_up", "blendShape1.browInnerUp", "Brow Inner Up")
    assert {plain_target(name) for name in same} == {"browinnerup"}
    assert {plain_target(name) for name in ("mouthSmileLeft", "mouthSmile_L", "mouthSmileL", "mouth_smile_l")} == {
        "mouthsmileleft"
    }
    assert plain_target("mouthRoll") == "mouthroll"
    assert plain_target("viseme_RR") == "visemerr"


def test_weights_go_to_targets_of_their_name(tmp_path):
    """Equal names count before other spellings, targets without a counterpart keep the weight of the file."""
    path, _, _ = vrm(tmp_path / "a.vrm", targets=("JawOpen", "jawOpen", "mouth_smile_L", "other"))
    document = open_document(path)
    document.gltf["meshes"][0]["weights"] = [0.1, 0.2, 0.3, 0.4]
    node = next(number for number, entry in enumerate(document.gltf["nodes"]) if "mesh" in entry)
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


def test_names_in_primitives_are_read_and_damaged_ones_are_not(tmp_path):
    path, _, _ = vrm(tmp_path / "a.vrm", 0, targets=("a", "b"))
    document = open_document(path)
    node = next(number for number, entry in enumerate(document.gltf["nodes"]) if "mesh" in entry)
    mesh = document.gltf["meshes"][0]
    mesh["primitives"][0]["extras"] = mesh.pop("extras")
    assert target_names(document, node) == ["a", "b"]
    for damaged in (3, {"targetNames": 3}, {"targetNames": ["a", 3]}):
        mesh["primitives"][0]["extras"] = damaged
        assert target_names(document, node) == []


def test_expressions_of_an_animation_are_weights_between_0_and_1(tmp_path):
    _, rig, _ = vrm(tmp_path / "a.vrm")
    path, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig), frames=3, expressions={"aa": np.array([-1, 0.5, 2])})
    document = open_document(path)
    (row,) = named_weights(document, read_channels(document, 0), np.arange(3) / 30)
    assert (row.name, row.owner) == ("aa", None)
    assert np.allclose(row.values, [0, 0.5, 1], atol=1e-6)


def test_an_animation_plays_on_the_shipped_body(tmp_path):
    _, rig, _ = vrm(tmp_path / "a.vrm")
    path, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig), expressions={"aa": np.ones(6)})
    clip = load_clip(path)
    assert (len(clip), clip.fps) == (6, 30.0)
    assert len(load_mesh(path).vertices) == 6890
    # Axes of the nodes are random, yet the person of the file stands and faces +z in the first frame's rest.
    person = clip.skeleton.person()
    assert {"LeftHandThumb1", "RightHandPinky3"} <= set(person.joints)
    assert person.weights.shape == (6890, len(person.joints))
    assert np.allclose(person.weights.sum(axis=1), 1)


def test_a_vrm_holds_no_animation(tmp_path):
    path, rig, _ = vrm(tmp_path / "a.vrm")
    drive, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig))
    result = mimesh.animate(path, drive)
    for save in (result.save, result.save_skinned):
        with pytest.raises(InputError, match=r"found \.vrm, which holds none by its specification; write b\.vrma "):
            save(tmp_path / "b.vrm")
    assert not (tmp_path / "b.vrm").exists()
