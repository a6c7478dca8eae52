"""People of rigid parts: named nodes that show boxes, with a skin or without; their parts turn, and never bend."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from motion_files import bone_directions, write_bvh

from mimesh.__main__ import run
from mimesh.bodies import load_body
from mimesh.core.geometry import nearest_rotation
from mimesh.core.options import Hints, MotionOptions
from mimesh.io import load_mesh
from mimesh.io.gltf.draft import Draft
from mimesh.motions import load_motion, window
from mimesh.motions.motion import BONES
from mimesh.pipeline import animate
from mimesh.pipeline.gltf_rigs import rig_facts

CENTRE = {"Hips": ("", 1.0), "Spine": ("Hips", 1.12), "Neck": ("Spine", 1.48), "Head": ("Neck", 1.55)}
SIDE = {
    **{"Arm": ("Spine", 0.2, 1.42), "ForeArm": ("Arm", 0.48, 1.42), "Hand": ("ForeArm", 0.72, 1.42)},
    **{"UpLeg": ("Hips", 0.1, 0.94), "Leg": ("UpLeg", 0.1, 0.5), "Foot": ("Leg", 0.1, 0.09)},
}
PLACES = {name: (above, np.array([0.0, y, 0.0])) for name, (above, y) in CENTRE.items()}
for _side, _sign in (("Left", 1), ("Right", -1)):
    for _part, (_above, _x, _y) in SIDE.items():
        PLACES[_side + _part] = (_above if _above in CENTRE else _side + _above, np.array([_sign * _x, _y, 0.0]))
NAMES = list(PLACES)
CORNERS = np.array([[x, y, z] for x in (-0.06, 0.06) for y in (-0.04, 0.1) for z in (-0.05, 0.05)])
TRIANGLES = np.array(list("013032467475045051237276026064157173"), int)
VRM = {"Arm": "UpperArm", "ForeArm": "LowerArm", "Hand": "Hand", "UpLeg": "UpperLeg", "Leg": "LowerLeg", "Foot": "Foot"}


def boxes(path: Path, kind: str) -> Path:
    """Write a person of boxes: "nodes", "skin" (without inverse bind matrices), "vrm", "scaled" or "meshes below"."""
    draft = Draft({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "meshes": [], "nodes": []})
    indices, nodes = draft.add_indices(TRIANGLES), draft.gltf["nodes"]
    for number, (name, (above, place)) in enumerate(PLACES.items()):
        scale = (
            np.array([1.0, 2.0, 0.5]) if kind == "scaled" and name.endswith(("Hand", "Foot", "Head")) else np.ones(3)
        )
        attributes = {"POSITION": draft.add_floats(CORNERS / scale, bounds=True)}
        draft.gltf["meshes"].append({"primitives": [{"attributes": attributes, "indices": indices}]})
        step = place - (PLACES[above][1] if above else 0.0)
        shown = {"scale": scale.tolist()} if kind == "scaled" else {}
        nodes.append({"name": f"part{number}" if kind == "vrm" else name, "translation": step.tolist(), **shown})
        if above:
            nodes[NAMES.index(above)].setdefault("children", []).append(number)
    for number in range(len(NAMES)):
        if kind not in ("skin", "meshes below"):
            nodes[number]["mesh"] = number
            continue
        part = {"name": f"Cube.{number:03}", "mesh": number}
        if kind == "skin":
            part["skin"] = 0
            draft.gltf["scenes"][0]["nodes"].append(len(nodes))
            attributes = draft.gltf["meshes"][number]["primitives"][0]["attributes"]
            view = draft.add_view(np.tile(np.array([number, 0, 0, 0], "<u1"), (8, 1)))
            place = {"bufferView": view, "componentType": 5121, "count": 8, "type": "VEC4"}
            attributes["JOINTS_0"] = draft.add_accessor(place)
            attributes["WEIGHTS_0"] = draft.add_floats(np.tile([1.0, 0, 0, 0], (8, 1)))
        else:
            nodes[number].setdefault("children", []).append(len(nodes))
        nodes.append(part)
    if kind == "skin":
        draft.gltf["skins"] = [{"joints": list(range(len(NAMES)))}]
    if kind == "vrm":
        bones = {name.lower(): name for name in CENTRE}
        bones |= {f"{side.lower()}{VRM[part]}": side + part for side in ("Left", "Right") for part in SIDE}
        listed = {bone: {"node": NAMES.index(name)} for bone, name in bones.items()}
        meta = {"name": "x", "authors": ["x"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
        draft.gltf["extensions"] = {
            "VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": listed}}
        }
    draft.save(path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nodes", "skin", "vrm", "scaled", "meshes below"])
def test_parts_turn_rigidly_to_the_directions_of_the_driving(kind, model, tmp_path):
    path = boxes(tmp_path / ("a.vrm" if kind == "vrm" else "a.glb"), kind)
    facts = rig_facts(load_mesh(path))
    assert facts is not None
    assert facts.stance.text == "up +y, front +z, a person by its rig"
    body, motion = load_body(), window(load_motion("walk"), 0.0, 0.3)
    driving = str(write_bvh(tmp_path / "walk.bvh", body, motion))
    hints = Hints(driving_up="+y", driving_front="+z")
    result = animate(str(path), driving, model, hints=hints, motion=MotionOptions(ground=False, contacts=False))
    assert result.own is not None
    assert not any("is not used" in note for note in result.notes)
    rest = load_mesh(path).vertices.reshape(len(NAMES), 8, 3)
    wanted = bone_directions(body, motion)
    order = [int(np.linalg.norm(rest.mean(axis=1) - place - CORNERS.mean(axis=0), axis=1).argmin())
             for _, place in PLACES.values()]  # fmt: skip
    for t, frame in enumerate(result.clip.vertices):
        parts = frame.reshape(len(NAMES), 8, 3)
        centred, still = (points - points.mean(axis=1, keepdims=True) for points in (parts, rest))
        turn = nearest_rotation(np.einsum("pvk,pvl->pkl", centred, still))
        np.testing.assert_allclose(centred, np.einsum("pkl,pvl->pvk", turn, still), atol=1e-5)
        for joint, tail in BONES.items():
            bone = PLACES[tail][1] - PLACES[joint][1]
            cosine = turn[order[NAMES.index(joint)]] @ bone / np.linalg.norm(bone) @ wanted[joint][t]
            assert np.degrees(np.arccos(min(cosine, 1.0))) < 0.1


def test_the_command_rig_keeps_nodes_as_joints(tmp_path, capsys):
    path = boxes(tmp_path / "a.glb", "nodes")
    assert run(["rig", str(path), "-o", str(tmp_path / "b.glb"), "--json", "--no-preview"]) == 0
    assert json.loads(capsys.readouterr().out)["joints"] >= len(NAMES)


def test_parts_of_a_mesh_that_was_cut_are_no_rig(tmp_path):
    """All nodes are at the origin: a limb that turned about it would leave its place."""
    path = boxes(tmp_path / "a.gltf", "nodes")
    gltf = json.loads(path.read_text())
    for node in gltf["nodes"]:
        del node["translation"]
    path.write_text(json.dumps(gltf))
    assert rig_facts(load_mesh(path)) is None


@pytest.mark.parametrize("names", [["Cube"] * 16, [f"{name}Joint" if name == "Hips" else "part" for name in NAMES]])
def test_parts_that_are_not_named_as_a_persons_are_no_rig(names, tmp_path):
    path = boxes(tmp_path / "a.gltf", "nodes")
    text = path.read_text()
    for old, new in sorted(zip(NAMES, names, strict=True), key=lambda pair: -len(pair[0])):
        text = text.replace(f'"{old}"', f'"{new}"')
    path.write_text(text)
    assert rig_facts(load_mesh(path)) is None
