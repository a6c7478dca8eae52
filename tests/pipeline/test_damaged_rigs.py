"""Rigs that are damaged or contradict themselves: one note says what is wrong, and joints are found on the surface."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from matrix import matrix
from scipy.spatial.transform import Rotation

from mimesh.bodies.character_limbs import name_limb_joints
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.core.options import MotionOptions
from mimesh.core.rig import homogeneous
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.draft import Draft
from mimesh.pipeline import animate

PERSON = rigs.figure()
FIRST = 2
"""Node of the first joint."""


@pytest.fixture(scope="module")
def driving(tmp_path_factory) -> Path:
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "T-pose")[0]


def node(draft: Draft, joint: str) -> dict:
    return draft.gltf["nodes"][FIRST + PERSON.names.index(joint)]


def index(joint: str) -> int:
    return FIRST + PERSON.names.index(joint)


def replace(draft: Draft, name: str, change) -> None:
    """Change the values of an attribute of the first primitive."""
    attributes = draft.gltf["meshes"][0]["primitives"][0]["attributes"]
    view = draft.gltf["accessors"][attributes[name]]["bufferView"]
    values = np.frombuffer(bytes(draft.chunks[2 * view]), "<f4").reshape(-1, 4)
    draft.chunks[2 * view] = memoryview(change(values).astype("<f4")).cast("B")


def scaled(joint: str, scale: list[float]):
    return lambda draft: _with_scale(node(draft, joint), scale)


def _with_scale(entry: dict, scale: list[float]) -> None:
    matrix = np.array(entry["matrix"]).reshape(4, 4).T
    entry["matrix"] = (matrix @ np.diag([*scale, 1.0])).T.ravel().tolist()


def weights_times(factor: float):
    def change(draft: Draft) -> None:
        for name in ("WEIGHTS_0", "WEIGHTS_1"):
            replace(draft, name, lambda values: factor * values)

    return change


def some_weights(value: float):
    """Give every second vertex only these weights."""

    def change(draft: Draft) -> None:
        for name in ("WEIGHTS_0", "WEIGHTS_1"):
            replace(
                draft, name, lambda values: np.where(np.arange(len(values))[:, None] % 2, value * np.ones(4), values)
            )

    return change


def limb_missing(draft: Draft) -> None:
    """Rename all joints of a leg."""
    for joint in ("LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase", "LHipJoint"):
        node(draft, joint)["name"] = f"part{index(joint)}"


def duplicate_names(draft: Draft) -> None:
    for joint in PERSON.names:
        node(draft, joint)["name"] = "Bone"


def joints_elsewhere(draft: Draft) -> None:
    """The skin of the shown mesh has its joints below a node that the scene does not have; the scene has others."""
    draft.gltf["nodes"][0]["children"].remove(FIRST)


DAMAGES = {
    "no weights": (weights_times(0.0), "skin with weights, found 100%|weights"),
    "half without weights": (some_weights(0.0), "skin with weights, found 50%"),
    "half with NaN weights": (some_weights(float("nan")), "skin with weights, found 50%"),
    "half with infinite weights": (some_weights(float("inf")), "skin with weights, found 50%"),
    "half with negative weights": (some_weights(-1.0), "skin with weights, found 50%"),
    "a joint scaled to nothing": (scaled("LeftForeArm", [0.0, 0.0, 0.0]), "scaled to nothing|finite|length"),
    "a sheared joint": (scaled("LeftForeArm", [1.0, 3.0, 0.5]), "scaled equally"),
    "a limb missing": (limb_missing, "LeftUpLeg"),
    "duplicate names": (duplicate_names, "LeftUpLeg"),
}


QUICK = ("half with NaN weights", "duplicate names")


@matrix("damage", DAMAGES, quick=QUICK)
def test_a_damaged_rig_gives_a_note_and_the_surface(damage, model, driving, tmp_path):
    change, message = DAMAGES[damage]
    path = rigs.character(tmp_path / "a.glb", change=change, name=renamed("mixamo"))
    result = animate(str(path), str(driving), model)
    assert result.own is None
    notes = [note for note in result.notes if "is not used" in note]
    assert len(notes) == 1
    assert "\n" not in notes[0]
    assert re.search("expected .*; ", notes[0])
    assert re.search(message, notes[0])
    assert np.isfinite(result.clip.vertices).all()


@matrix("damage", DAMAGES, quick=QUICK[:1])
def test_a_damaged_rig_of_the_driving_gives_a_note_and_the_surface(damage, model, tmp_path):
    path, *_ = rigs.of_kind(tmp_path / "a.glb", "T-pose")
    damaged = rigs.character(tmp_path / "b.glb", change=DAMAGES[damage][0], name=renamed("mixamo"))
    result = animate(str(path), load_clip(damaged), model)
    assert result.own is not None
    assert any("are not used" in note for note in result.notes)


def test_two_characters_in_a_file_are_no_identity(model, driving, tmp_path):
    """The second has its own skeleton, below the same armature."""

    def twice(draft: Draft) -> None:
        gltf, count = draft.gltf, len(PERSON.names)
        start = len(gltf["nodes"])
        for number in range(FIRST, FIRST + count):
            entry = dict(gltf["nodes"][number])
            if "children" in entry:
                entry["children"] = [child - FIRST + start for child in entry["children"]]
            gltf["nodes"].append(entry)
        skin = dict(gltf["skins"][0])
        gltf["skins"].append(skin | {"joints": [joint - FIRST + start for joint in skin["joints"]]})
        gltf["nodes"].append({"name": "twin", "mesh": 0, "skin": 1})
        gltf["nodes"][0]["children"] += [start, len(gltf["nodes"]) - 1]
        matrix = np.array(gltf["nodes"][start]["matrix"])
        matrix[12] += 0.02
        gltf["nodes"][start]["matrix"] = matrix.tolist()

    path = rigs.character(tmp_path / "a.glb", change=twice, name=renamed("mixamo"))
    with pytest.raises(
        InputError, match=r"^a: expected one character, found 2: body, twin; say which with part=\.\.\."
    ):
        animate(str(path), str(driving), model)


def extra_skins(draft: Draft) -> None:
    """Skins that no node uses: without joints, and of some joints without inverse bind matrices."""
    draft.gltf["skins"] += [{"joints": []}, {"joints": draft.gltf["skins"][0]["joints"][:2]}]


def idle(scale: list[float]):
    """Add a joint that moves no vertex below the head, with a joint of usual scale below it."""

    def change(draft: Draft) -> None:
        count = len(draft.gltf["nodes"])
        node(draft, "Head").setdefault("children", []).append(count)
        draft.gltf["nodes"] += [{"name": "leaf", "scale": scale, "children": [count + 1]}, {"name": "tip"}]
        skin = draft.gltf["skins"][0]
        skin["joints"] += [count, count + 1]
        accessor = draft.gltf["accessors"][skin["inverseBindMatrices"]]
        matrices = np.frombuffer(bytes(draft.chunks[2 * accessor["bufferView"]]), "<f4").reshape(-1, 16)
        skin["inverseBindMatrices"] = draft.add_matrices(
            np.concatenate([matrices, matrices[-2:]]).reshape(-1, 4, 4).swapaxes(1, 2)
        )

    return change


def zeros_for_bind_matrices(draft: Draft) -> None:
    """An accessor without a view is one of zeros (glTF 2.0, 3.6.2.3)."""
    del draft.gltf["accessors"][draft.gltf["skins"][0]["inverseBindMatrices"]]["bufferView"]


def nan_for_an_idle_joint(draft: Draft) -> None:
    idle([1.0, 1.0, 1.0])(draft)
    skin = draft.gltf["skins"][0]
    chunk = draft.chunks[2 * draft.gltf["accessors"][skin["inverseBindMatrices"]]["bufferView"]]
    matrices = np.frombuffer(bytes(chunk), "<f4").reshape(-1, 4, 4).swapaxes(1, 2).copy()
    matrices[-1] = np.nan
    skin["inverseBindMatrices"] = draft.add_matrices(matrices)


SOUND = {
    "bind matrices of zeros: bound as the nodes are": {"change": zeros_for_bind_matrices, "armature": np.eye(4)},
    "NaN in the bind matrix of an idle joint": {"change": nan_for_an_idle_joint},
    "skins without use": {"change": extra_skins},
    "an idle joint scaled unequally": {"change": idle([1.0, 1.3, 1.0])},
    "an idle joint scaled to nothing": {"change": idle([0.0, 0.0, 0.0])},
    "weights are divided by their sum": {"change": weights_times(0.3)},
    "legs on roots of their own move with the hips": {"hold": {"LHipJoint": "", "RHipJoint": ""}},
    "joints outside of the scene move the mesh": {"change": joints_elsewhere, "armature": np.eye(4)},
    "a skeleton that lies at rest is raised": {"turn": np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])},
}
"""Oddities of files with which a person moves as without them: a motion has directions in the world."""


@pytest.fixture(scope="module")
def whole(driving, model, tmp_path_factory) -> np.ndarray:
    path = rigs.character(tmp_path_factory.mktemp("whole") / "a.glb", name=renamed("mixamo"))
    return animate(str(path), str(driving), model).clip.vertices


@pytest.mark.slow
@pytest.mark.parametrize("oddity", SOUND)
def test_odd_rigs_move_as_others(oddity, whole, model, driving, tmp_path):
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), **SOUND[oddity])
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    noted = any("without a usable inverse bind matrix" in note for note in result.notes)
    assert noted == ("bind matri" in oddity)
    assert np.ptp(whole, axis=0).max() > 0.1
    shift = (result.clip.vertices[0] - whole[0]).mean(axis=0)
    np.testing.assert_allclose(result.clip.vertices - shift, whole, atol=1e-5)


LYING = {
    "+z": np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]),
    "-y": np.diag([1.0, -1.0, -1.0]),
    "+x": np.array([[0, 1.0, 0], [-1.0, 0, 0], [0, 0, 1.0]]),
}
"""Rotations of whole characters after which this axis of the file is up from the feet to the head."""


@matrix("up", [*LYING], quick=["+z"])
def test_a_rig_that_lies_in_its_own_axes_moves_in_them(up, whole, model, driving, tmp_path):
    """As auto-riggers write whose models are not converted to y up: no node above the joints raises them."""
    turn = LYING[up]
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), turn=turn, armature=np.eye(4))
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    assert result.report["identity"]["up"] == up
    assert any(note.startswith(f"a.glb lies: by its rig it stands up {up}") for note in result.notes)
    upright = result.clip.vertices @ turn
    np.testing.assert_allclose(upright - (upright[0] - whole[0]).mean(axis=0), whole, atol=1e-5)
    result.save_skinned(tmp_path / "b.glb")
    again = animate(str(rigs.character(tmp_path / "c.glb")), str(tmp_path / "b.glb"), model).clip.vertices
    np.testing.assert_allclose(again - (again[0] - whole[0]).mean(axis=0), whole, atol=1e-5)


def all_fours(lean: float) -> np.ndarray:
    """Local rotations of the joints that bring a person from the T-pose onto hands and feet; `lean` in degrees."""
    rest = np.tile(np.eye(3), (len(PERSON.names), 1, 1))
    forward = Rotation.from_euler("x", lean, degrees=True).as_matrix()
    rest[PERSON.names.index("Hips")] = forward
    for side, sign in (("Left", -1), ("Right", 1)):
        down = Rotation.from_euler("z", 90 * sign, degrees=True).as_matrix()
        rest[PERSON.names.index(f"{side}Arm")] = forward.T @ down
        rest[PERSON.names.index(f"{side}UpLeg")] = forward.T
    return rest


@matrix(("lean", "side"), [(90.0, 1), (90.0, -1), (40.0, 1), (40.0, -1)], quick=[(40.0, -1)])
def test_animals_with_the_names_of_a_persons_joints_are_no_person(lean, side, model, driving, tmp_path):
    """Nor are they where another orientation of the bind pose sets them on their hind legs."""
    person = rigs.figure()
    if lean < 60:  # a giraffe: front legs that reach the ground from high shoulders
        person = longer_arms(person)
    path = rigs.character(
        tmp_path / "a.glb", person=person, rest=all_fours(lean), turn=np.diag([side, 1.0, side]), name=renamed("mixamo")
    )
    result = animate(str(path), str(driving), model)
    assert result.own is None
    assert any("stands upright" in note for note in result.notes)


def longer_arms(person: rigs.Figure) -> rigs.Figure:
    """Give a person in the T-pose arms of the length of its legs and trunk."""
    vertices, joints = person.vertices.copy(), person.joints.copy()
    shoulder = abs(joints[person.names.index("LeftArm"), 0])
    for points in (vertices, joints):
        outside = np.maximum(np.abs(points[:, 0]) - shoulder, 0.0)
        points[:, 0] += 1.2 * np.sign(points[:, 0]) * outside
    return dataclasses.replace(person, vertices=vertices, joints=joints)


STRANGE_CHANNELS = {
    "a node before the first": {"sampler": 0, "target": {"node": -1, "path": "rotation"}},
    "a node after the last": {"sampler": 0, "target": {"node": 10**6, "path": "rotation"}},
    "weights of a node without a mesh": {"sampler": 0, "target": {"node": 3, "path": "weights"}},
    "no target": {"sampler": 0},
    "no object": None,
}


@matrix("channels", [*STRANGE_CHANNELS, "no list"], quick=["a node after the last"])
def test_damaged_animations_beside_the_new_one_stay_as_they_are(channels, model, driving, tmp_path):
    def change(draft: Draft) -> None:
        wrong = None if channels == "no list" else [STRANGE_CHANNELS[channels]]
        draft.gltf["animations"] = [{"name": "old", "channels": wrong, "samplers": []}]

    path = rigs.character(tmp_path / "a.glb", change=change, name=renamed("mixamo"))
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    result.save_skinned(tmp_path / "out.glb")
    np.testing.assert_allclose(load_clip(tmp_path / "out.glb").vertices, result.clip.vertices, atol=1e-5)
    kept = [open_document(file).gltf["animations"][-1] for file in (path, tmp_path / "out.glb")]
    assert kept[0] == kept[1]


@pytest.mark.parametrize("name", ["joint beyond the skin", "fewer bind matrices"])
def test_files_whose_surface_is_not_known_are_refused(name, tmp_path):
    def change(draft: Draft) -> None:
        skin = draft.gltf["skins"][0]
        if name == "fewer bind matrices":
            draft.gltf["accessors"][skin["inverseBindMatrices"]]["count"] -= 2
        else:
            del skin["joints"][-3:]

    path = rigs.character(tmp_path / "a.glb", change=change)
    with pytest.raises(InputError, match=r"^[^\n]*expected .* in skin 0, found [^\n]*$"):
        load_mesh(path)


def box(draft: Draft, weight: float, size: int = 2) -> np.ndarray:
    """Add a cube of size ** 3 points, with a skin of one joint at a node of its own; returns the points."""
    points = np.stack(np.meshgrid(*[np.linspace(0.3, 0.4, size)] * 3), axis=-1).reshape(-1, 3)
    count = len(points)
    joints = {"bufferView": draft.add_view(np.zeros((count, 4), "<u1")), "componentType": 5121, "type": "VEC4"}
    attributes = {"POSITION": draft.add_floats(points, bounds=True)}
    attributes |= {"JOINTS_0": draft.add_accessor(joints | {"count": count})}
    attributes |= {"WEIGHTS_0": draft.add_floats(np.tile([weight, 0, 0, 0], (count, 1)))}
    triangles = draft.add_indices(np.arange(3 * (count // 3)))
    gltf, first = draft.gltf, len(draft.gltf["nodes"])
    gltf["meshes"].append({"primitives": [{"attributes": attributes, "indices": triangles}]})
    gltf["nodes"] += [{"name": "anchor"}, {"name": "prop", "mesh": 1, "skin": 1}]
    gltf["skins"].append({"joints": [first]})
    gltf["scenes"][0]["nodes"] += [first, first + 1]
    return points


@pytest.mark.parametrize(
    ("weight", "size", "said"), [(1.0, 2, "go with the hips: anchor"), (1.0, 5, "go with the hips: anchor"),
                                 (0.0, 2, "without weights, which are not bent: prop")]
)  # fmt: skip
def test_a_prop_on_a_skin_of_its_own_leaves_the_person_its_rig(weight, size, said, whole, model, driving, tmp_path):
    """Without inverse bind matrices, these are identities: the box is in the frame of its joint."""
    path = rigs.character(
        tmp_path / "a.glb", change=lambda draft: box(draft, weight, size), name=renamed("mixamo"), armature=np.eye(4)
    )
    result = animate(str(path), str(driving), model, motion=MotionOptions(contacts=False))  # arms avoid the prop
    assert result.own is not None
    assert any(said in note for note in result.notes)
    person, prop = np.split(np.asarray(result.clip.vertices), [whole.shape[1]], axis=1)
    shift = (person[0] - whole[0]).mean(axis=0)
    np.testing.assert_allclose(person - shift, whole, atol=1e-5)
    edges = np.linalg.norm(np.diff(prop, axis=1), axis=-1)
    np.testing.assert_allclose(edges, np.tile(edges[0], (len(edges), 1)), atol=1e-5)
    assert np.ptp(edges[0]) < 0.2  # as it is in the file: 0.1 wide


@pytest.mark.parametrize("joint", ["Head", "LeftHand"])
def test_a_joint_that_is_enlarged_in_its_node_stays_so(joint, whole, model, driving, tmp_path):
    """The skin is bound with scale 1; the file shows a large head, and so does the result."""
    path = rigs.character(tmp_path / "a.glb", change=scaled(joint, [1.3] * 3), name=renamed("mixamo"))
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    below = [PERSON.names.index(name) for name in PERSON.names if name.startswith(joint)]
    part = np.flatnonzero(PERSON.weights[rigs.kept()][:, below].sum(axis=1) > 0.9999)
    others = np.flatnonzero(PERSON.weights[rigs.kept()][:, PERSON.names.index("LeftUpLeg")] > 0.9)
    sizes, usual = (np.ptp(clip[:, part], axis=1) for clip in (np.asarray(result.clip.vertices), whole))
    np.testing.assert_allclose(sizes, 1.3 * usual, rtol=1e-4)
    shift = (result.clip.vertices[0] - whole[0])[others].mean(axis=0)
    np.testing.assert_allclose(result.clip.vertices[:, others] - shift, whole[:, others], atol=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.001])
def test_a_trace_of_weight_does_not_make_a_root_the_hips(share):
    """The legs of figures of blocks hang on the root beside the body."""
    names = ("root", "body", "arm-left", "arm-right", "leg-left", "leg-right", "head")
    parents = (-1, 0, 1, 1, 0, 0, 1)
    joints = np.array(
        [[0, 0, 0], [0, 0.9, 0], [0.2, 1.4, 0], [-0.2, 1.4, 0], [0.1, 0.9, 0], [-0.1, 0.9, 0], [0, 1.5, 0]]
    )
    joint_of = np.repeat(np.arange(1, 7), 10)[:, None] * [1, 0]
    weights = np.tile([1 - share, share], (60, 1))
    points = joints[joint_of[:, 0]] + np.random.default_rng(0).normal(scale=0.05, size=(60, 3))
    frames = homogeneous(np.tile(np.eye(3), (7, 1, 1)), joints)
    mesh = Mesh(points, np.arange(60).reshape(-1, 3))
    rig = SkinnedCharacter(mesh, names, parents, frames, joint_of, weights, np.repeat(points[:, None], 2, axis=1))
    assert names[name_limb_joints(rig, "blocks")["Hips"]] == "body"
