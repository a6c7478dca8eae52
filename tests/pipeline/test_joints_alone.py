"""Motions that come as joints without a mesh move a rig as the same joints with a mesh do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from motion_files import write_bvh
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.joint_names import finger_joints
from mimesh.core.options import MotionOptions
from mimesh.io import load_clip
from mimesh.motions import Motion
from mimesh.pipeline import animate
from mimesh.pipeline.capturing import capture

FINGERS = (*finger_joints("Left"), *finger_joints("Right"))
PERSON = rigs.figure(None, fingers=True)


def without_mesh(draft) -> None:
    """Leave out meshes and skins, so that only animated joints stay."""
    draft.gltf.pop("skins")
    draft.gltf.pop("meshes")
    for node in draft.gltf["nodes"]:
        node.pop("skin", None)
        node.pop("mesh", None)


def turns(result) -> dict[str, np.ndarray]:
    """World rotation of each joint of a result since rest, (T, 3, 3)."""
    skeleton = result.skeleton
    moved = skeleton.rotation @ skeleton.rig.rotation.swapaxes(-1, -2)
    return {name: moved[:, j] for j, name in enumerate(skeleton.names)}


def degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(Rotation.from_matrix(a @ b.swapaxes(-1, -2)).magnitude()).max())


@pytest.fixture(scope="module")
def hero(tmp_path_factory) -> str:
    """A person with fingers at rest."""
    return str(rigs.character(tmp_path_factory.mktemp("hero") / "hero.glb", person=PERSON, frames=3, faces=600))


def moved(hero: str, driving: Path, model, **options):
    return animate(hero, str(driving), model, motion=MotionOptions(ground=False, contacts=False, **options))


@pytest.mark.slow
def test_hands_and_fingers_are_those_of_the_same_joints_with_a_mesh(hero, model, tmp_path):
    motion = {"move": rigs.exercise(PERSON, joints=(*rigs.MOVING, *FINGERS))}
    rest = rigs.arms_down(PERSON)
    with_mesh, alone = (
        rigs.character(tmp_path / name, person=PERSON, rest=rest, clips=motion, change=change, faces=600)
        for name, change in (("mesh.glb", None), ("alone.glb", without_mesh))
    )
    expected, found = (turns(moved(hero, path, model)) for path in (with_mesh, alone))
    for name in expected:
        assert degrees(found[name], expected[name]) < 0.1, name


def palms(result) -> dict[str, np.ndarray]:
    """Normal of the back of each hand in the first frame, from wrist and knuckles."""
    at = dict(zip(result.skeleton.names, result.skeleton.joint_positions()[0], strict=True))
    found = {}
    for side, sign in (("Left", -1), ("Right", 1)):
        along = np.mean([at[f"{side}Hand{finger}1"] for finger in ("Index", "Middle", "Ring", "Pinky")], axis=0)
        normal = sign * np.cross(along - at[f"{side}Hand"], at[f"{side}HandIndex1"] - at[f"{side}HandPinky1"])
        found[side] = normal / np.linalg.norm(normal)
    return found


@pytest.mark.parametrize("kind", ["bvh", "amass", "amass with fingers"])
def test_palms_of_a_t_pose_face_down(kind, hero, model, tmp_path):
    """The hands of the shipped body, and of this character, hang relaxed at rest: turned by 30 degrees."""
    if kind == "bvh":
        path = write_bvh(tmp_path / "t.bvh", load_body(), still(), name=renamed("mixamo"))
    else:
        path = tmp_path / "t.npz"
        np.savez(path, poses=np.zeros((2, 66 if kind == "amass" else 156)), trans=np.zeros((2, 3)))
    result = moved(hero, path, model)
    for side in ("Left", "Right"):
        np.testing.assert_allclose(palms(result)[side], [0, 1, 0], atol=0.01)
        assert degrees(turns(result)[f"{side}ForeArm"][0], np.eye(3)) < 0.1


@pytest.mark.parametrize("joints", [52, 55])
def test_fingers_of_an_archive_move(joints, hero, model, tmp_path):
    poses = np.zeros((2, joints, 3))
    poses[1, -30:-15:3] = [0.0, 0.0, -0.8]  # first joints of the left hand
    np.savez(tmp_path / "fist.npz", poses=poses.reshape(2, -1), trans=np.zeros((2, 3)))
    found = turns(moved(hero, tmp_path / "fist.npz", model))
    bent = Rotation.from_rotvec([0.0, 0.0, -0.8]).as_matrix()
    for finger in ("Index", "Middle", "Ring", "Pinky", "Thumb"):
        for k in (1, 2, 3):
            before, after = found[f"LeftHand{finger}{k}"]
            assert degrees(after @ before.T, bent) < 0.1
            assert degrees(*found[f"RightHand{finger}{k}"]) < 0.1


@pytest.mark.parametrize("change", [None, without_mesh])
def test_a_finger_that_the_driving_lacks_follows_the_one_beside_it(change, hero, model, tmp_path):
    lacking = PERSON.without(*(f"{side}HandRing{k}" for side in ("Left", "Right") for k in (3, 2, 1)))
    bends = {name: [0.0, 0.0, -70.0] for name in FINGERS if name.startswith("Left") and name in lacking.names}
    local = {name: Rotation.from_rotvec(turn, degrees=True).as_matrix() for name, turn in bends.items()}
    fist = {"fist": [lacking.pose({}), lacking.pose(local)]}
    driving = rigs.character(tmp_path / "fist.glb", person=lacking, clips=fist, change=change)
    found = turns(moved(hero, driving, model))
    for k in (1, 2, 3):
        ring, middle = found[f"LeftHandRing{k}"], found[f"LeftHandMiddle{k}"]
        assert degrees(ring[1] @ ring[0].T, middle[1] @ middle[0].T) < 0.1
        assert degrees(ring[1] @ ring[0].T, Rotation.from_rotvec([0, 0, -70.0 * k], degrees=True).as_matrix()) < 0.1


@pytest.mark.parametrize("angle", [30, 90, 180])
def test_the_heading_of_a_capture_stays(angle, hero, model, tmp_path):
    """Its rest pose faces +z."""
    turned = Rotation.from_euler("y", angle, degrees=True).as_matrix()
    motion = still()
    motion.rotmat[:, 0] = turned
    result = moved(hero, write_bvh(tmp_path / "t.bvh", load_body(), motion, name=renamed("mixamo")), model)
    assert degrees(turns(result)["Hips"][0], turned) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("angle", [30, 90, 180])
def test_the_heading_of_a_node_above_a_rigged_driving_stays(angle, hero, model, tmp_path):
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler("y", angle, degrees=True).as_matrix()

    def change(draft):
        draft.gltf["nodes"].append({"name": "place", "matrix": turned.T.ravel().tolist(), "children": [0]})
        draft.gltf["scenes"][0]["nodes"] = [len(draft.gltf["nodes"]) - 1]

    motion = {"move": rigs.exercise(PERSON)}
    plain, placed = (
        rigs.character(tmp_path / f"{k}.glb", person=PERSON, frames=4, clips=motion, change=changes)
        for k, changes in enumerate((None, change))
    )
    expected, found = (turns(moved(hero, path, model)) for path in (plain, placed))
    for name in ("Hips", "LeftArm", "RightHandIndex2"):
        assert degrees(found[name], turned[:3, :3] @ expected[name]) < 0.1


def still() -> Motion:
    """The shipped body in its T-pose for two frames."""
    body = load_body()
    turn = np.tile(np.eye(3), (2, len(body.parents), 1, 1))
    return Motion("t", body.joint_names, turn, np.tile([0.0, 1.0, 0.0], (2, 1)), 30.0)


def way_above(name: str):
    """Make a change of a draft: the node above all joints is called so, and moves by 2 m in frames 0 and 1."""

    def change(draft) -> None:
        node = draft.gltf["nodes"][0]
        placed = np.reshape(node.pop("matrix"), (4, 4)).T
        scale = float(np.cbrt(np.linalg.det(placed[:3, :3])))
        node |= {"name": name, "rotation": Rotation.from_matrix(placed[:3, :3] / scale).as_quat().tolist()}
        node["scale"] = [scale] * 3
        animation = draft.gltf["animations"][0]
        times = draft.add_floats(np.array([[0.0], [0.05]]), bounds=True)
        way = draft.add_floats(np.array([[0.0, 0, 0], [0.0, 0.3, 2.0]]))
        animation["channels"].append(
            {"sampler": len(animation["samplers"]), "target": {"node": 0, "path": "translation"}}
        )
        animation["samplers"].append({"input": times, "output": way})

    return change


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("name", ["armature", "Armature.001"])
def test_the_way_of_a_node_above_the_joints_is_taken_over(name, size, model, tmp_path):
    """Whatever it is called: of the same skeleton, whose values are copied, and where the scale above is another."""
    waves = {"wave": [PERSON.pose({"LeftArm": Rotation.from_rotvec([0, 0, 0.1 * t]).as_matrix()}) for t in range(2)]}
    hero = rigs.character(tmp_path / "hero.glb", person=PERSON, clips={"still": [PERSON.pose({})] * 2})
    armature = np.diag([0.01 * size] * 3 + [1.0]) @ rigs.ARMATURE
    driving = rigs.character(tmp_path / "d.glb", person=PERSON, armature=armature, clips=waves, change=way_above(name))
    for root, way in (("scale", 2.0), ("keep", 2.0), ("drop", 0.0)):
        result = animate(str(hero), str(driving), model, motion=MotionOptions(root=root, ground=False))
        assert result.report.get("copied", False) == (root == "scale" and size == 100.0)
        moved = np.asarray(result.clip.vertices[1], float) - result.clip.vertices[0]
        np.testing.assert_allclose(np.median(moved, axis=0), [0.0, 0.3, way], atol=1e-4)
        if root == "scale":
            saved = load_clip(result.save_skinned(tmp_path / "rooted.glb", root_bone=True))
            np.testing.assert_allclose(saved.vertices[1], result.clip.vertices[1], atol=1e-3)


@pytest.mark.parametrize("second", ["Armature", "Other"])
def test_keys_go_to_nodes_not_to_names(second, model, tmp_path):
    """Two joints have one name; only the second one turns. With another name above, the files are not the same."""

    def change(draft) -> None:
        draft.gltf["nodes"][0]["name"] = second
        for node in draft.gltf["nodes"]:
            if node["name"] in ("LeftHandRing1", "LeftHandPinky1"):
                node["name"] = "finger"

    def renamed_armature(draft) -> None:
        change(draft)
        draft.gltf["nodes"][0]["name"] = "Armature"

    turn = {"LeftHandPinky1": Rotation.from_rotvec([0, 0, -0.5]).as_matrix()}
    bends = {"bend": [PERSON.pose({}), PERSON.pose(turn)]}
    hero = rigs.character(
        tmp_path / "hero.glb", person=PERSON, clips={"still": [PERSON.pose({})] * 2}, change=renamed_armature
    )
    driving = rigs.character(tmp_path / "d.glb", person=PERSON, clips=bends, change=change)
    result = animate(str(hero), str(driving), model)
    assert result.report["copied"]
    np.testing.assert_allclose(result.clip.vertices[1], load_clip(driving).vertices[1], atol=1e-5)


@pytest.mark.parametrize("suffix", [".bvh", pytest.param(".vrma", marks=pytest.mark.slow)])
def test_hands_of_a_captured_motion_are_read_as_they_were(suffix, hero, model, tmp_path):
    motion = still()
    motion.rotmat[1, load_body().joint("LeftHand")] = Rotation.from_rotvec([0.3, 0.5, 0.2]).as_matrix()
    path = write_bvh(tmp_path / "t.bvh", load_body(), motion, name=renamed("mixamo"))
    again = capture(str(path), model).save(tmp_path / f"again{suffix}")
    expected, found = (turns(moved(hero, each, model)) for each in (path, again))
    for name in ("LeftHand", "RightHand", "LeftHandRing2", "LeftForeArm"):
        assert degrees(found[name], expected[name]) < 0.1, name
