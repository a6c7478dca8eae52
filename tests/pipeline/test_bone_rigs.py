"""Bones given as arrays by another program move as those of a file: in other axes, as identity and as driving."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import rigs
from animals import FEET, Animal, animal, bones, nothing_said, random_turns
from foreign_names import renamed
from matrix import matrix
from motion_files import write_bvh
from networks import write_network

from mimesh.bodies import load_body
from mimesh.bodies.joint_names import person_joints
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.normalization import Normalization
from mimesh.core.options import FrameRange, Hints, MotionOptions
from mimesh.core.person_motion import KnownJoints
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.animation import sample_nodes
from mimesh.io.gltf.own_rig import GltfJoints, read_own_rig
from mimesh.motions import load_motion, window
from mimesh.motions.bvh import load_bvh
from mimesh.pipeline import animate
from mimesh.pipeline.bone_rigs import Binding, BoneJoints, Bones, clip_of_bones, rig_of_bones
from mimesh.rigs.retarget import JointMotion

EXACT = 1e-5
"""Largest distance of a vertex, over the size of the mesh."""
Z_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From y up to z up, as Blender imports glTF: what faces +z then faces -y."""


@pytest.fixture(scope="module")
def driving(tmp_path_factory) -> Path:
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "A-pose", shape=2)[0]


def bones_of(path: Path, axes: np.ndarray = Z_UP) -> tuple[Mesh, Bones, Binding, list[int]]:
    """Read a file's mesh, bones and weights as arrays in other axes, with the node of each bone."""
    mesh = load_mesh(path)
    own = read_own_rig(mesh)
    rig = own.humanoid.character
    bones = Bones(path.stem, rig.joint_names, rig.parents, axes @ own.scene.T_world_node[own.nodes])
    turned = Mesh(rig.mesh.vertices @ axes[:3, :3].T, mesh.faces, name="bones")
    return turned, bones, Binding(rig.joint_of, rig.weights), own.nodes


def joints_of(path: Path, axes: np.ndarray = Z_UP) -> tuple[Clip, BoneJoints]:
    """Read a file's clip as arrays in other axes."""
    clip, (mesh, bones, binding, nodes) = load_clip(path), bones_of(path, axes)
    assert isinstance(clip.skeleton, GltfJoints)
    blocks = sample_nodes(clip.skeleton.document, clip.skeleton.channels, clip.skeleton.times)
    world = axes @ np.concatenate([matrices[:, nodes] for _, matrices in blocks])
    turned = Clip(mesh, clip.vertices @ axes[:3, :3].T, clip.fps)
    return turned, BoneJoints(mesh, bones, binding, world, "+z")


def deviation(found: np.ndarray, expected: np.ndarray) -> float:
    return np.abs(found - expected).max() / np.ptp(expected[0], axis=0).max()


@matrix("kind", ["feet on roots", "twists", "no toes", "A-pose"], quick=["feet on roots"])
def test_bones_of_an_identity_move_as_those_of_its_file(kind, model, driving, tmp_path):
    path = rigs.of_kind(tmp_path / "own.glb", kind, moving=False, name=renamed("unreal"))[0]
    expected = animate(str(path), str(driving), model)
    mesh, bones, binding, _ = bones_of(path)
    result = animate(mesh, load_clip(driving), model, hints=Hints(rig=rig_of_bones(mesh, bones, binding, "+z")))
    assert deviation(result.clip.vertices @ Z_UP[:3, :3], expected.clip.vertices) < EXACT
    assert result.report["rig"] == "own"
    assert result.own is None
    moved = result.skeleton.transforms()
    np.testing.assert_allclose(
        np.linalg.inv(Z_UP) @ moved @ Z_UP, expected.skeleton.transforms(), atol=EXACT * np.ptp(mesh.vertices)
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """A person in a T-pose, with our names."""
    return rigs.of_kind(tmp_path_factory.mktemp("own") / "own.glb", "T-pose", moving=False)[0]


@pytest.mark.slow
def test_bones_of_a_driving_mesh_are_used(path, model, driving):
    expected = animate(str(path), str(driving), model)
    clip, joints = joints_of(driving)
    result = animate(str(path), dataclasses.replace(clip, skeleton=joints), model)
    assert deviation(result.clip.vertices, expected.clip.vertices) < EXACT
    part = animate(str(path), dataclasses.replace(clip, skeleton=joints), model, frames=FrameRange(start=2, step=2))
    assert (
        deviation(
            part.clip.vertices,
            animate(str(path), str(driving), model, frames=FrameRange(start=2, step=2)).clip.vertices,
        )
        < EXACT
    )


def test_the_body_of_a_driving_is_found_in_any_axes(driving):
    """Its points are found at rest, whose joints are in the axes of the clip."""
    clip, joints = joints_of(driving)
    grids = []
    for drawn, axes in ((load_clip(driving), ("+y", "+z")), (dataclasses.replace(clip, skeleton=joints), ("+z", "-y"))):
        mesh = dataclasses.replace(drawn.mesh, vertices=np.asarray(drawn.vertices[0], float))
        norm = Normalization.fit(mesh, *axes)
        mesh = dataclasses.replace(mesh, vertices=norm.apply(mesh.vertices))
        grids.append(JointMotion.of_file(drawn.skeleton.person(), mesh, drawn.fps, norm).grid)
    assert grids[0].parts == grids[1].parts
    np.testing.assert_allclose(grids[1].rest, grids[0].rest, atol=EXACT)


def test_a_driving_whose_bones_are_unknown_is_read_on_its_surface(path, model, driving):
    clip, joints = joints_of(driving)
    unnamed = dataclasses.replace(joints.bones, joint_names=tuple(f"b{j}" for j in range(len(joints.bones.parents))))
    joints = dataclasses.replace(joints, bones=unnamed)
    result = animate(str(path), dataclasses.replace(clip, skeleton=joints), model, hints=Hints(driving_up="+z"))
    assert any("joints of bones are not used, they are found on its surface" in note for note in result.notes)


@pytest.fixture
def capture(tmp_path) -> Path:
    return write_bvh(tmp_path / "walk.bvh", load_body(), window(load_motion("walk"), 0.0, 0.3))


def skeleton_of(path: Path, axes: np.ndarray, scale: float = 1.0) -> tuple[Bones, np.ndarray]:
    """Read a BVH file as a skeleton in other axes and in another unit."""
    bvh = load_bvh(path)
    rotation, position = bvh.world()
    world = np.tile(np.eye(4), (*position.shape[:2], 1, 1))
    world[..., :3, :3], world[..., :3, 3] = rotation, scale * position
    rest = np.tile(np.eye(4), (len(bvh.parents), 1, 1))
    rest[:, :3, 3] = scale * bvh.rest()
    return Bones("capture", bvh.joint_names, bvh.parents, axes @ rest), axes @ world


@matrix("scale", [1.0, 37.0], quick=[37.0])
def test_a_skeleton_without_a_mesh_moves_as_its_motion_file(scale, path, model, capture):
    expected = animate(str(path), str(capture), model)
    bones, world = skeleton_of(capture, Z_UP, scale)
    clip = clip_of_bones(bones, world, expected.fps)
    assert clip.skeleton.person().leg == pytest.approx(scale * load_clip(capture).skeleton.person().leg, rel=0.2)
    result = animate(str(path), clip, model)
    assert deviation(result.clip.vertices, expected.clip.vertices) < EXACT
    kept = animate(str(path), clip, model, motion=MotionOptions(root="keep", ground=False)).skeleton.root
    # The first frame faces where the identity does, so paths are compared by their distances on the ground.
    distances = [np.linalg.norm(p - p[0], axis=1) for p in (kept[:, [0, 2]], world[:, 0, :2, 3])]
    np.testing.assert_allclose(distances[0], distances[1], atol=1e-4 * scale)


@pytest.mark.slow
def test_front_of_a_skeleton_without_a_mesh_can_be_given(path, model, capture):
    bones, world = skeleton_of(capture, Z_UP)
    ahead, back = (
        animate(str(path), clip_of_bones(bones, world, 30.0, front), model).skeleton.transforms()[:, 0, :3, :3]
        for front in ("-y", "+y")
    )
    half_turn = np.diag([-1.0, 1.0, -1.0])
    np.testing.assert_allclose(back, half_turn @ ahead, atol=1e-4)


def test_several_roots_and_fingers_of_a_skeleton_without_a_mesh():
    person = rigs.figure(None, fingers=True)
    motion = np.stack(rigs.exercise(person, joints=(*rigs.MOVING, "LeftHandIndex1", "LeftHandIndex2")))
    rest = np.tile(np.eye(4), (len(person.names) + 1, 1, 1))
    rest[1:, :3, 3] = person.joints
    world = np.concatenate([np.broadcast_to(np.eye(4), (len(motion), 1, 4, 4)), motion @ rest[1:]], axis=1)
    names, parents = ("prop", *person.names), (-1, *(p + 1 if p >= 0 else -1 for p in person.parents))
    clip = clip_of_bones(Bones("two roots", names, parents, rest), world, 30.0)
    assert isinstance(clip.skeleton, KnownJoints)
    found = clip.skeleton.person()
    for name in ("LeftHandIndex2", "LeftForeArm", "RightFoot"):
        rotation = motion[:, person.names.index(name), :3, :3]
        np.testing.assert_allclose(found.rotation[:, found.joints.index(name)], rotation, atol=1e-4)


def test_joints_of_a_person_are_counted():
    names = tuple(map(renamed("mixamo"), load_body().joint_names))
    assert {"Hips", "LeftArm", "RightLeg"} <= set(person_joints(names, load_body().parents))
    assert person_joints(("root", "tail", "fin"), (-1, 0, 1)) == {}


def test_rigs_that_cannot_be_used_are_explained(path, driving, tmp_path):
    mesh, bones, binding, _ = bones_of(path)
    with pytest.raises(InputError, match="stands upright"):
        rig_of_bones(mesh, bones, binding, "+y")
    stretched = bones.T_world_joint * np.array([1.0, 2.0, 1.0, 1.0])
    with pytest.raises(InputError, match="scaled equally"):
        rig_of_bones(mesh, dataclasses.replace(bones, T_world_joint=stretched), binding, "+z")
    loose = np.full_like(binding.joint_of, len(bones.parents))
    with pytest.raises(InputError, match="found 100% of the vertices without"):
        rig_of_bones(mesh, bones, dataclasses.replace(binding, joint_of=loose), "+z")
    with pytest.raises(InputError, match="expected finite joints"):
        clip_of_bones(bones, np.full((2, len(bones.parents), 4, 4), np.nan), 30.0)
    rig = rig_of_bones(mesh, bones, binding, "+z")
    network = str(write_network(tmp_path / "npt.onnx"))
    with pytest.raises(InputError, match=r"expected a model with joints \(mime\)"):
        animate(mesh, load_clip(driving), network, hints=Hints(rig=rig))


def animal_bones(made: Animal, axes: np.ndarray = Z_UP) -> tuple[Mesh, Bones, Binding]:
    """Give an animal as a program has it, in other axes."""
    rig = made.character(nothing_said, axes[:3, :3])
    return (
        rig.mesh,
        Bones("animal", rig.joint_names, rig.parents, rig.T_world_joint),
        Binding(rig.joint_of, rig.weights),
    )


def gallop(made: Animal, frames: int = 4) -> list[tuple[dict[str, np.ndarray], np.ndarray]]:
    return [(random_turns(t, made.order), np.array([0.0, 0.0, 0.05 * t])) for t in range(frames)]


@pytest.mark.slow
def test_bones_of_animals_move_as_those_of_their_files(tmp_path):
    identity, driving = animal(0, bones(), FEET), animal(1)
    motion = gallop(driving)
    own, other = identity.write(tmp_path / "own.glb"), driving.write(tmp_path / "driving.glb", {"gallop": motion})
    expected = animate(str(own), str(other))
    rig = rig_of_bones(*animal_bones(identity), "+z")
    assert rig.body_name == "quadruped"
    result = animate(rig.character.mesh, load_clip(other), hints=Hints(rig=rig))
    assert (result.report["rig"], result.report["body"]) == ("own", "quadruped")
    assert deviation(result.clip.vertices @ Z_UP[:3, :3], expected.clip.vertices) < EXACT
    # The driving's bones as arrays, too.
    mesh, joints, binding = animal_bones(driving)
    rest = joints.T_world_joint
    moves = np.stack([driving.transforms(*frame) for frame in motion])
    world = Z_UP @ moves @ np.linalg.inv(Z_UP) @ rest
    posed = np.stack([driving.posed(*frame) for frame in motion]) @ Z_UP[:3, :3].T
    clip = Clip(mesh, posed, 30.0, skeleton=BoneJoints(mesh, joints, binding, world, "+z"))
    both = animate(rig.character.mesh, clip, hints=Hints(rig=rig))
    assert both.notes == ()
    assert deviation(both.clip.vertices, result.clip.vertices) < EXACT


def test_the_body_of_bones_can_be_said():
    arrays = animal_bones(animal(0))
    assert rig_of_bones(*arrays, "+z", body="quadruped").body_name == "quadruped"
    assert rig_of_bones(*arrays, "+z", "-y").body_name == "quadruped"
    with pytest.raises(InputError, match="by name"):
        rig_of_bones(*arrays, "+z", body="human")


def test_bones_of_neither_are_refused_as_those_of_a_person(path):
    mesh, named, binding, _ = bones_of(path)
    unnamed = dataclasses.replace(named, joint_names=tuple(f"b{j}" for j in range(len(named.parents))))
    with pytest.raises(InputError, match="on both sides by name"):
        rig_of_bones(mesh, unnamed, binding, "+z")
    with pytest.raises(InputError, match=r"four feet|two feet"):
        rig_of_bones(mesh, named, binding, "+z", body="quadruped")
