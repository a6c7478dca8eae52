"""Identities that keep their rigs: the same person on another rig, changes of the file, drivings of any kind."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import SCHEMES, renamed
from matrix import matrix
from motion_files import write_bvh
from networks import write_network
from people import person as person_mesh
from people import walk
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.engine_names import SCHEMES as ENGINE_NAMES
from mimesh.core.options import FrameRange, MotionOptions
from mimesh.io import load_clip, load_mesh, save_mesh
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.draft import Draft
from mimesh.io.gltf.own_animation import OwnAnimation
from mimesh.motions import load_motion, window
from mimesh.motions.motion import joint_tracks
from mimesh.pipeline import animate, transfer

EXACT = 1e-5
"""Largest distance of a vertex, over the size of the mesh, where both rigs have the same weights and rest pose."""
LOOSE = {"A-pose": 2e-3, "no hands": 0.05}
"""The same for kinds of rigs whose rest pose has to be estimated: limbs are aligned by their directions, which does not
show their twist, and a forearm without a hand joint by its surface."""
QUARTER = Rotation.from_euler("y", 90, degrees=True).as_matrix()


@pytest.fixture(scope="module")
def driving(tmp_path_factory) -> Path:
    """Write person 0 with a clip, in a T-pose, with our names."""
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "T-pose")[0]


def deviation(vertices: np.ndarray, expected: np.ndarray) -> float:
    """Compare two motions that may start at different places."""
    shift = (vertices[0] - expected[0]).mean(axis=0)
    return np.abs(vertices - expected - shift).max() / np.ptp(expected[0], axis=0).max()


def truth(person: rigs.Figure, rest: np.ndarray | None = None) -> np.ndarray:
    return np.stack([rigs.posed(person, frame, rest) for frame in rigs.exercise(person)])


@matrix("scheme", SCHEMES, quick=["unreal", "biped"])
def test_the_same_person_on_a_rig_with_other_names_and_axes(scheme, model, driving, tmp_path):
    path = rigs.character(tmp_path / "a.glb", name=renamed(scheme), frames=3)
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    assert deviation(result.clip.vertices, truth(rigs.figure())) < EXACT


@matrix("kind", rigs.KINDS, quick=["A-pose", "feet on roots", "no hands"])
def test_the_same_person_on_a_rig_of_another_kind(kind, model, driving, tmp_path):
    path, person, rest = rigs.of_kind(tmp_path / "a.glb", kind, moving=False, name=renamed("mixamo"), frames=3)
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    expected = np.tile(truth(person, rest), (1, rigs.KINDS[kind].get("skins", 1), 1))
    assert deviation(result.clip.vertices, expected) < LOOSE.get(kind, EXACT)


@matrix("kind", [kind for kind in rigs.KINDS if kind not in ("no toes", "no hands")], quick=["A-pose"])
def test_the_rig_of_the_driving_may_be_of_any_kind(kind, model, tmp_path):
    path, *_ = rigs.of_kind(tmp_path / "move.glb", kind, name=renamed("biped"))
    identity = rigs.character(tmp_path / "a.glb", name=renamed("godot"), frames=3)
    result = animate(str(identity), str(path), model)
    assert deviation(result.clip.vertices, truth(rigs.figure())) < LOOSE.get(kind, EXACT)


TRIANGLES = {"LeftShoulder": "Neck", "RightShoulder": "Neck", "LeftUpLeg": "LowerBack", "RightUpLeg": "LowerBack"}
"""Parents of limbs in 3ds Max Bipeds."""


@pytest.mark.parametrize("which", ["identity", "driving"])
def test_limbs_that_hang_on_spine_and_neck_go_with_hips_and_chest(which, model, tmp_path):
    person = rigs.figure()
    motion, kinds = rigs.exercise(person), {"identity": {}, "driving": {}}
    kinds[which] = {"name": renamed("biped"), "hold": TRIANGLES}
    identity = rigs.character(tmp_path / "i.glb", frames=3, **kinds["identity"])
    driving = rigs.character(tmp_path / "d.glb", clips={"move": motion}, **kinds["driving"])
    result = animate(str(identity), str(driving), model)
    assert result.own is not None
    assert deviation(result.clip.vertices, truth(person)) < EXACT
    result.save_skinned(tmp_path / "o.glb")
    assert deviation(load_clip(tmp_path / "o.glb").vertices, truth(person)) < 2 * EXACT
    nodes = [node["name"] for node in open_document(identity).gltf["nodes"]]
    for joint in ("LowerBack", "Spine", "Spine1", "Neck", "Head"):
        node = nodes.index(kinds["identity"].get("name", str)(joint))
        since = result.own.node_matrices([node])[:, 0] @ np.linalg.inv(result.own.source.rest.T_world_node[node])
        turned = np.stack([frame[person.names.index(joint), :3, :3] for frame in motion])
        wrong = Rotation.from_matrix(since[:, :3, :3] @ turned.swapaxes(-1, -2)).magnitude()
        assert np.degrees(wrong).max() < 1e-3, joint


@pytest.mark.parametrize("which", ["identity", "driving", "both"])
def test_a_rest_pose_between_the_axes_has_its_own_front(which, model, tmp_path):
    """The result goes where the identity faces in its file, and its limbs stay with its trunk."""
    oblique = Rotation.from_euler("y", -40, degrees=True).as_matrix()
    turns = {of: oblique if which in (of, "both") else np.eye(3) for of in ("identity", "driving")}
    driving = rigs.character(tmp_path / "d.glb", clips={"move": rigs.exercise(rigs.figure())}, turn=turns["driving"])
    identity = rigs.character(tmp_path / "i.glb", name=renamed("mixamo"), frames=3, turn=turns["identity"])
    result = animate(str(identity), str(driving), model)
    assert deviation(result.clip.vertices, truth(rigs.figure()) @ turns["identity"].T) < EXACT
    assert result.notes == ()


@pytest.fixture(scope="module")
def of_other_person(driving, model, tmp_path_factory) -> np.ndarray:
    path = rigs.character(tmp_path_factory.mktemp("other") / "a.glb", 1)
    return animate(str(path), str(driving), model).clip.vertices


def test_an_identity_that_faces_another_axis_moves_along_it(of_other_person, model, driving, tmp_path):
    result = animate(str(rigs.character(tmp_path / "a.glb", 1, turn=QUARTER)), str(driving), model)
    assert result.own is not None
    assert deviation(result.clip.vertices, of_other_person @ QUARTER.T) < EXACT


@matrix(("scale", "shift"), [(100.0, (50.0, 0, 0)), (0.01, (3.0, 0.5, -2.0))], quick=[(100.0, (50.0, 0, 0))])
def test_size_and_place_of_the_identity_are_kept(scale, shift, of_other_person, model, driving, tmp_path):
    person = rigs.figure(1)
    moved = dataclasses.replace(person, joints=scale * person.joints + shift, vertices=scale * person.vertices + shift)
    result = animate(str(rigs.character(tmp_path / "a.glb", person=moved)), str(driving), model).clip.vertices
    np.testing.assert_allclose(result, scale * of_other_person + shift, atol=2 * EXACT * max(scale, 1))


@matrix("scale", [-1.0, (-1.0, 1.0, 1.0), (1.0, -1.0, -1.0)], quick=[(-1.0, 1.0, 1.0)])
def test_mirroring_nodes_that_the_bind_pose_does_not_have_are_taken_back(scale, model, driving, tmp_path):
    """Exporters leave nodes in some frame of an animation. Joints that are enlarged there stay so."""
    person = rigs.figure()

    def change(draft: Draft) -> None:
        for joint in ("LeftForeArm", "LeftHand"):
            entry = draft.gltf["nodes"][2 + person.names.index(joint)]
            matrix = np.array(entry["matrix"]).reshape(4, 4)
            matrix[:3] *= np.broadcast_to(scale, 3)[:, None]
            entry["matrix"] = matrix.ravel().tolist()

    path = rigs.character(tmp_path / "a.glb", change=change, name=renamed("mixamo"))
    result = animate(str(path), str(driving), model, motion=MotionOptions(contacts=False))
    assert result.own is not None
    assert deviation(result.clip.vertices, truth(person)) < EXACT
    result.save_skinned(tmp_path / "out.glb")
    assert deviation(load_clip(tmp_path / "out.glb").vertices, truth(person)) < EXACT


def test_rigs_below_mirroring_nodes_are_kept_and_move_as_they_are_seen(model, driving, tmp_path):
    """The mirror image of an identity in the mirror image of a motion is that of the result; left is where it is."""
    person, flip = rigs.figure(), np.array([-1.0, 1.0, 1.0])
    clips = {"move": rigs.exercise(person)}
    seen = rigs.character(tmp_path / "seen.glb", clips=clips, change=rigs.mirror)
    identity = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), frames=3, change=rigs.mirror)
    both = animate(str(identity), str(seen), model)
    assert both.own is not None
    assert deviation(both.clip.vertices, truth(person) * flip) < EXACT
    both.save_skinned(tmp_path / "out.glb")
    assert deviation(load_clip(tmp_path / "out.glb").vertices, truth(person) * flip) < EXACT
    plain = rigs.character(tmp_path / "b.glb", name=renamed("mixamo"), frames=3)
    straight = MotionOptions(contacts=False)  # the samples of a surface are not mirrored
    mirrored = animate(str(identity), str(driving), model, motion=straight).clip.vertices
    assert deviation(mirrored, animate(str(plain), str(seen), model, motion=straight).clip.vertices * flip) < EXACT


@pytest.mark.parametrize("shown", ["placed", "posed"])
def test_hands_touch_the_body_however_the_file_shows_it(shown, model, tmp_path):
    """Exporters write other nodes than those of the bind pose: frames of an animation, a place in a scene."""
    aside = np.tile(np.eye(4), (len(rigs.figure(1).parents), 1, 1))
    aside[:, :3, 3] = [0, 0, 5]
    moved = aside if shown == "placed" else rigs.exercise(rigs.figure(1), 1, seed=9)[0]
    files = [rigs.character(tmp_path / f"{k}.glb", 1, faces=1000, moved=of) for k, of in enumerate((None, moved))]
    clip = write_bvh(tmp_path / "walk.bvh", load_body(), window(load_motion("walk"), 0.0, 1.0))
    few, off = FrameRange(0, None, 8), MotionOptions(contacts=False)
    at_rest, other = (animate(str(file), str(clip), model, frames=few).clip.vertices for file in files)
    free = animate(str(files[0]), str(clip), model, frames=few, motion=off).clip.vertices
    assert deviation(free, at_rest) > 0.01
    assert deviation(other, at_rest) < 5e-4


def test_limbs_of_one_joint_point_where_the_drivings_limbs_do(model, driving, tmp_path):
    person = rigs.changed(rigs.figure(), "one joint a limb")
    path = rigs.character(tmp_path / "blocks.glb", person=person, name=renamed("kaykit"))
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    whole = rigs.figure()
    remaining, frames = rigs.kept(), rigs.exercise(whole)
    at_rest = whole.vertices[remaining]
    for limb, end in (("LeftArm", "LeftHand"), ("RightUpLeg", "RightFoot")):
        j, tail = whole.names.index(limb), whole.names.index(end)
        near = np.argsort(np.linalg.norm(at_rest - whole.joints[tail], axis=1))[:6]
        carried = person.weights[remaining][near][:, person.names.index(limb)].min()
        assert carried > 0.9
        for t, frame in enumerate(frames):
            points = whole.joints[[j, tail], :, None]
            ends = frame[[j, tail], :3, :3] @ points
            ends = ends[..., 0] + frame[[j, tail], :3, 3]
            wanted = ends[1] - ends[0]
            before = at_rest[near].mean(axis=0) - whole.joints[j]
            chosen = result.skeleton.transforms()[t, result.skeleton.names.index(renamed("kaykit")(limb)), :3, :3]
            found = chosen @ before
            cosine = found @ wanted / np.linalg.norm(found) / np.linalg.norm(wanted)
            assert np.degrees(np.arccos(min(cosine, 1.0))) < 8


def without_mesh(draft) -> None:
    """Leave out the mesh and the skin, as files of motions do."""
    for node in draft.gltf["nodes"]:
        node.pop("mesh", None)
        node.pop("skin", None)
    for key in ("meshes", "skins"):
        del draft.gltf[key]


def test_a_clip_without_a_mesh_drives_a_rig(model, tmp_path):
    """The person has the size of the clip's skeleton; the motion's path scales with the legs."""
    path, *_ = rigs.of_kind(tmp_path / "move.glb", "T-pose", change=without_mesh, armature=np.eye(4))
    identity = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"))
    result = animate(str(identity), str(path), model, motion=MotionOptions(ground=False, contacts=False))
    assert result.own is not None
    transforms, expected = result.skeleton.transforms(), rigs.exercise(rigs.figure())
    names = rigs.figure().names
    for limb in ("LeftForeArm", "RightLeg", "Spine1"):
        j = result.skeleton.names.index(renamed("mixamo")(limb))
        for t, frame in enumerate(expected):
            turn = transforms[t, j, :3, :3] @ frame[names.index(limb), :3, :3].T
            assert np.degrees(Rotation.from_matrix(turn).magnitude()) < 2


def test_a_bvh_file_drives_a_rig(model, tmp_path):
    motion = window(load_motion("walk"), 0.0, 0.3)
    body = load_body()
    path = write_bvh(tmp_path / "walk.bvh", body, motion)
    identity = rigs.character(tmp_path / "a.glb", name=renamed("unreal"))
    result = animate(str(identity), str(path), model)
    assert result.own is not None
    assert result.notes == (
        "walk faces -z in its first frame and +z in its rest pose: the result is turned as far from the front of its "
        'own; driving_front="-z" has it begin facing that',
    )
    wanted = joint_tracks(body, motion)[1]
    found, names = result.skeleton.joint_positions(), result.skeleton.names
    for side in ("Left", "Right"):
        for start, end in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot")):
            joints = [f"{side}{start}", f"{side}{end}"]
            expected = bone_directions(wanted[:, [body.joint(joint) for joint in joints]])
            bones = bone_directions(found[:, [names.index(renamed("unreal")(joint)) for joint in joints]])
            cosine = (expected * bones).sum(axis=1).clip(-1, 1)
            assert np.degrees(np.arccos(cosine)).max() < 3, joints
    hips = found[:, names.index(renamed("unreal")("Hips"))]
    way, wanted_way = hips[-1] - hips[0], wanted[-1, 0] - wanted[0, 0]
    np.testing.assert_allclose(way, wanted_way, atol=0.2 * np.linalg.norm(wanted_way))  # legs are of other lengths


def bone_directions(positions: np.ndarray) -> np.ndarray:
    """Compute unit vectors from the first to the second of two joints in every frame."""
    vectors = positions[:, 1] - positions[:, 0]
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_a_pose_is_put_on_the_nodes_and_the_rig_is_kept(model, tmp_path):
    person = rigs.figure()
    frame = rigs.exercise(person)[-1]
    driving = rigs.character(tmp_path / "pose.glb", moved=frame)
    identity = rigs.character(tmp_path / "a.glb", name=renamed("godot"), frames=3)
    result = transfer(str(identity), str(driving), model)
    expected = rigs.posed(person, frame)
    assert deviation(result.mesh.vertices[None], expected[None]) < EXACT
    result.save(tmp_path / "out.glb")
    assert deviation(load_mesh(tmp_path / "out.glb").vertices[None], expected[None]) < EXACT
    old, new = (open_document(path).gltf for path in (identity, tmp_path / "out.glb"))
    assert new["skins"] == old["skins"]
    assert [node["name"] for node in new["nodes"]] == [node["name"] for node in old["nodes"]]


def test_a_pose_comes_before_the_animations_of_the_file(model, tmp_path):
    """Programs play the first animation of a file on opening it; that of the pose holds all that others move."""
    person = rigs.figure()
    frame = rigs.exercise(person)[-1]
    driving = rigs.character(tmp_path / "pose.glb", moved=frame)
    identity, *_ = rigs.of_kind(tmp_path / "a.glb", "T-pose", name=renamed("godot"), change=tail)
    transfer(str(identity), str(driving), model).save(tmp_path / "out.glb")
    expected = rigs.posed(person, frame)[None]
    played = load_clip(tmp_path / "out.glb", animation="0")
    assert deviation(load_mesh(tmp_path / "out.glb").vertices[None], expected) < EXACT
    assert deviation(load_clip(tmp_path / "out.glb").vertices, expected) < EXACT
    assert deviation(played.vertices, expected) < EXACT
    old, new = (open_document(path).gltf["animations"] for path in (identity, tmp_path / "out.glb"))
    assert [animation["name"] for animation in new] == ["pose", *(animation["name"] for animation in old)]
    targets = [{(c["target"]["node"], c["target"]["path"]) for c in animation["channels"]} for animation in new]
    assert targets[0] >= set.union(*targets)
    np.testing.assert_allclose(
        load_clip(tmp_path / "out.glb", animation="move").vertices, load_clip(identity).vertices, atol=1e-6
    )


def test_a_vrm_gets_no_animation_with_its_pose(model, tmp_path):
    """Files of VRM have none by their specification; one that has stays as it is."""

    def as_vrm(draft: Draft) -> None:
        draft.gltf["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "humanoid": {"humanBones": {}}}}

    driving = rigs.character(tmp_path / "pose.glb", moved=rigs.exercise(rigs.figure())[-1])
    identity, *_ = rigs.of_kind(tmp_path / "a.vrm", "T-pose", name=renamed("vrm"), change=as_vrm)
    result = transfer(str(identity), str(driving), model)
    assert result.own is not None
    for name in ("out.glb", "out.vrm"):
        result.save(tmp_path / name)
        animations = open_document(tmp_path / name).gltf["animations"]
        assert [animation["name"] for animation in animations] == ["move"]


def tail(draft: Draft) -> None:
    """Let the file's animation move a node that no person has."""
    gltf = draft.gltf
    gltf["nodes"].append({"name": "tail"})
    gltf["nodes"][0]["children"].append(len(gltf["nodes"]) - 1)
    animation = gltf["animations"][0]
    target = {"node": len(gltf["nodes"]) - 1, "path": "scale"}
    animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
    values = draft.add_floats(np.linspace(1, 2, 6)[:, None] * np.ones(3))
    animation["samplers"].append({"input": animation["samplers"][0]["input"], "output": values})


@pytest.fixture(scope="module")
def biped(driving, model, tmp_path_factory):
    """A character with the bones of a 3ds Max Biped, and its result."""
    identity = rigs.character(tmp_path_factory.mktemp("biped") / "a.glb", name=renamed("biped"), frames=3)
    return identity, animate(str(identity), str(driving), model)


@matrix("names", ["mixamo", "unreal", "vrm", "godot", "rigify"], quick=["unreal"])
def test_bones_get_the_names_of_engines_and_a_root_bone(names, biped, tmp_path):
    identity, result = biped
    result.save_skinned(tmp_path / "out.glb", names=names, root_bone=True, fps=40.0)
    gltf = open_document(tmp_path / "out.glb").gltf
    bones = [node["name"] for node in gltf["nodes"]]
    assert {ENGINE_NAMES[names].bones[joint] for joint in ("Hips", "LeftArm", "RightLeg", "Head")} <= set(bones)
    written = load_clip(tmp_path / "out.glb")
    assert written.fps == 40
    size = np.ptp(result.clip.vertices[0], axis=0).max()
    np.testing.assert_allclose(written.vertices[::2], result.clip.vertices, atol=EXACT * size)
    root, scheme = bones.index(ENGINE_NAMES[names].root), ENGINE_NAMES[names]
    assert root in gltf["skins"][0]["joints"]
    way = root_way(tmp_path / "out.glb", root)
    floor = load_mesh(identity).vertices[:, 1].min()
    np.testing.assert_allclose(way[:, 1], floor, atol=EXACT * size)
    hips = load_mesh(identity).source.rest.T_world_node[bones.index(scheme.bones["Hips"]), :3, 3]
    np.testing.assert_allclose(way[0, [0, 2]], hips[[0, 2]], atol=EXACT * size)
    path = result.skeleton.joint_positions()[:, result.skeleton.names.index(renamed("biped")("Hips"))]
    np.testing.assert_allclose(way[::2, [0, 2]] - way[0, [0, 2]], (path - path[0])[:, [0, 2]], atol=EXACT * size)
    assert np.ptp(way[:, 2]) > 0.1 * size


def root_way(path: Path, root: int) -> np.ndarray:
    """Read where a node is in the frames of a file's first animation."""
    mesh, clip = load_mesh(path), load_clip(path, animation="0")
    values = clip.skeleton.values()
    frames = len(clip)
    return OwnAnimation(mesh.source, "", values, clip.fps, frames, {}).node_matrices([root])[:, 0, :3, 3]


@pytest.mark.parametrize("names", ["unreal", "own"])
def test_the_root_bone_stands_still_unless_asked(names, biped, tmp_path):
    """Unreal's skeleton has one always; files of others have none."""
    biped[1].save_skinned(tmp_path / "out.glb", names=names)
    gltf = open_document(tmp_path / "out.glb").gltf
    bones = [node["name"] for node in gltf["nodes"]]
    assert ("root" in bones) == (names == "unreal")
    if names == "unreal":
        assert bones.index("root") in gltf["skins"][0]["joints"]
        assert np.ptp(root_way(tmp_path / "out.glb", bones.index("root")), axis=0).max() == 0


def test_a_still_mesh_without_a_rig_is_no_rig(model, driving, tmp_path):
    save_mesh(person_mesh(0), tmp_path / "a.glb")
    result = animate(str(tmp_path / "a.glb"), str(driving), model)
    assert result.own is None
    assert not any("rig" in note for note in result.notes)


def test_frames_of_a_file_whose_nodes_have_matrices_are_those_that_are_written(model, driving, tmp_path):
    path = rigs.of_kind(tmp_path / "a.glb", "feet on roots", shape=1, moving=False)[0]
    result = animate(str(path), str(driving), model)
    result.save_skinned(tmp_path / "out.glb")
    written = load_clip(tmp_path / "out.glb").vertices
    assert np.ptp(written, axis=0).max() > 0.1
    assert deviation(result.clip.vertices, written) < EXACT


def test_models_without_joints_leave_the_rig_out(driving, tmp_path):
    pytest.importorskip("onnx")
    network = str(write_network(tmp_path / "npt.onnx"))
    identity = rigs.character(tmp_path / "a.glb")
    result = animate(str(identity), walk(frames=2), network)
    assert result.own is None
    assert result.skeleton is None
