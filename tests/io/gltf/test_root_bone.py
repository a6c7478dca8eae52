"""A root bone in the file of a rigged person: its place and axes, its skin, and that everything else stays."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import rigs
from matrix import matrix
from scipy.spatial.transform import Rotation

from mimesh.bodies.joint_names import ancestors
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.animation import read_channels
from mimesh.io.gltf.document import Document, open_document, read_floats
from mimesh.io.gltf.draft import Draft
from mimesh.io.gltf.edit import GltfSource
from mimesh.io.gltf.own_animation import OwnAnimation, write_own_animations
from mimesh.io.gltf.own_rig import GltfJoints, read_own_rig
from mimesh.io.gltf.scene import node_parents, world_matrices

SAME = 1e-6
"""Largest distance of a vertex or a node, over the size of the mesh, with and without a root bone."""
FIRST = 2
"""Node of the first joint in the files of `rigs`."""
PERSON = rigs.figure()


def below(name: str, place: tuple[float, float, float], person: rigs.Figure = PERSON) -> rigs.Figure:
    """Put a joint without weights above all joints of a person; motions move it instead of the hips."""
    return rigs.Figure(
        (name, *person.names),
        (-1, *(parent + 1 for parent in person.parents)),
        np.concatenate([[place], person.joints]),
        np.pad(person.weights, ((0, 0), (1, 0))),
        person.vertices,
    )


def spline(draft: Draft) -> None:
    """Add a clip of cubic splines, whose samplers move the topmost joint and another node."""
    gltf = draft.gltf
    rest = gltf["nodes"][FIRST]
    gltf["nodes"].append({"name": "other"})
    gltf["scenes"][0]["nodes"].append(len(gltf["nodes"]) - 1)
    times = draft.add_floats(np.array([[0.0], [0.1], [0.3]]), bounds=True)
    generator = np.random.default_rng(4)
    samplers, channels = [], []
    for path in ("translation", "rotation"):
        value = np.array(rest[path])
        keys = value + generator.normal(scale=0.3 * np.abs(value).max(), size=(9, len(value)))
        samplers.append({"input": times, "output": draft.add_floats(keys), "interpolation": "CUBICSPLINE"})
        for node in (FIRST, len(gltf["nodes"]) - 1):
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
    gltf["animations"].append({"name": "spline", "samplers": samplers, "channels": channels})


def moving_armature(draft: Draft) -> None:
    """Let the node above all joints move: forward, and about the vertical."""
    gltf = draft.gltf
    rotation = Rotation.from_matrix(np.array(gltf["nodes"][0].pop("matrix")).reshape(4, 4)[:3, :3].T / 100)
    turns = [(Rotation.from_euler("y", angle, degrees=True) * rotation).as_quat() for angle in range(0, 60, 10)]
    gltf["nodes"][0] |= {"scale": [100.0] * 3, "rotation": rotation.as_quat().tolist()}
    animation = gltf["animations"][0]
    times = animation["samplers"][0]["input"]
    for path, values in (("translation", np.outer(np.arange(6), [0.01, 0.0, 0.05])), ("rotation", np.array(turns))):
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": {"node": 0, "path": path}})
        animation["samplers"].append({"input": times, "output": draft.add_floats(values)})


def props(draft: Draft) -> None:
    """Give the topmost joint a plane beside the person, and a still joint with a box below it."""
    gltf = draft.gltf
    corners = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0, 0.01]])
    triangle = {"POSITION": draft.add_floats(corners, bounds=True)}
    gltf["meshes"].append({"primitives": [{"attributes": triangle, "indices": draft.add_indices(np.array([0, 1, 2]))}]})
    number = len(gltf["nodes"])
    gltf["nodes"] += [{"name": "box", "mesh": 1}, {"name": "stand", "children": [number]}]
    gltf["nodes"] += [{"name": "plane", "mesh": 1}]
    gltf["nodes"][FIRST]["children"] += [number + 1, number + 2]


WIDE = np.array([[2.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
FILES = {
    "hips on top": {},
    "a joint above the hips moves": {"person": below("Body", (0.0, 0.1, 0.0))},
    "a joint above the hips is still": {"person": below("Base", (0.0, 0.0, 0.0)), "still": True},
    "metres, y up": {"armature": np.eye(4)},
    "feet on roots": {"hold": {"LeftFoot": "", "RightFoot": ""}},
    "the armature moves": {"change": moving_armature},
    "three skins": {"skins": 3},
    "nodes in another pose": {"moved": rigs.exercise(PERSON, 1, seed=9)[0]},
    "turned": {"turn": Rotation.from_euler("y", 90, degrees=True).as_matrix()},
    "old splines": {"change": spline},
    "props on a still joint": {"person": below("Base", (0.0, 0.0, 0.0)), "still": True, "change": props},
    "unequal scale above": {"armature": WIDE, "flat": True},
}


def written(path: Path, kind: str) -> OwnAnimation:
    """Write a file of a kind, and return an animation of its nodes that moves as its clip does."""
    options = dict(FILES[kind])
    person = options.pop("person", PERSON)
    motion = rigs.exercise(person)
    if options.pop("still", False):  # the topmost joint stays, the hips have the motion
        motion = [np.concatenate([np.eye(4)[None], frame]) for frame in rigs.exercise(PERSON)]
    if options.pop("flat", False):
        # Joints below unequal scales have shears, so nothing turns.
        motion = [np.tile(np.eye(4), (len(person.names), 1, 1)) for _ in motion]
        for t, frame in enumerate(motion):
            frame[:, :3, 3] = [0.02 * t, 0.01 * t, 0.1 * t]
    rigs.character(path, person=person, clips={"move": motion}, **options)
    return animation_of(path, [name for name in ("Hips", "LeftFoot", "RightArm") if name in person.names])


def animation_of(path: Path, joints: list[str]) -> OwnAnimation:
    """Return an animation of a file's nodes that moves as its first clip does."""
    mesh, clip = load_mesh(path), load_clip(path, animation="0")
    assert isinstance(mesh.source, GltfSource)
    assert isinstance(clip.skeleton, GltfJoints)
    names = [node["name"] for node in mesh.source.document.gltf["nodes"]]
    nodes = {joint: names.index(joint) for joint in joints}
    return OwnAnimation(mesh.source, "new", clip.skeleton.values(), clip.fps, len(clip), nodes)


def saved(animation: OwnAnimation, path: Path, name: str | None, moves: bool = True) -> Document:
    write_own_animations([animation.with_layout({}, name, moves)], path)
    return open_document(path)


def worlds(document: Document) -> dict[str, np.ndarray]:
    world = world_matrices(document)
    return dict(zip((node["name"] for node in document.gltf["nodes"]), world, strict=True))


QUICK = ("the armature moves", "nodes in another pose")


@matrix("kind", FILES, quick=QUICK)
def test_the_bone_is_on_the_floor_with_the_axes_of_the_world_and_in_the_skin(kind, tmp_path):
    """It has the way of the hips over the ground, and vertices and nodes stay in all animations."""
    animation = written(tmp_path / "a.glb", kind)
    plain = saved(animation, tmp_path / "plain.glb", None)
    still, rooted = (saved(animation, tmp_path / f"{n}.glb", "Root", moves=n == "Root") for n in ("still", "Root"))
    check_bone(animation, rooted)
    check_way(animation, rooted, tmp_path / "Root.glb")
    assert not any(channel.node == len(plain.gltf["nodes"]) for channel in read_channels(still, 0))
    size = np.ptp(animation.source.vertices, axis=0).max()
    at_rest = worlds(plain)
    for name, document in (("still", still), ("Root", rooted)):
        vertices = load_mesh(tmp_path / f"{name}.glb").vertices
        np.testing.assert_allclose(vertices, animation.source.vertices, atol=SAME * size, rtol=0)
        for number in range(len(plain.gltf["animations"])):
            one, other = (load_clip(tmp_path / f"{n}.glb", animation=str(number)).vertices for n in ("plain", name))
            np.testing.assert_allclose(other, one, atol=SAME * size, rtol=0)
        now = worlds(document)
        for node, world in at_rest.items():
            np.testing.assert_allclose(now[node][:3, 3], world[:3, 3], atol=SAME * size)
            np.testing.assert_allclose(now[node][:3, :3], world[:3, :3], atol=1e-6 * np.abs(world).max())


def check_bone(animation: OwnAnimation, new: Document) -> None:
    """Check the place of a bone at rest and in the skins."""
    old = animation.source.document
    root, size = len(old.gltf["nodes"]), np.ptp(animation.source.vertices, axis=0).max()
    world = world_matrices(new)
    hips = world[animation.joints["Hips"], :3, 3]
    scale = np.cbrt(np.linalg.det(world[root, :3, :3]))
    np.testing.assert_allclose(world[root, :3, :3] / scale, np.eye(3), atol=1e-6)
    floor = animation.source.vertices[:, 1].min()
    np.testing.assert_allclose(world[root, :3, 3], [hips[0], floor, hips[2]], atol=1e-6 * size)
    assert len(new.gltf["skins"]) == len(old.gltf["skins"])
    for before, after in zip(old.gltf["skins"], new.gltf["skins"], strict=True):
        assert after["joints"] == [*before["joints"], root]
        matrices = read_floats(new, after["inverseBindMatrices"])
        np.testing.assert_array_equal(matrices[:-1], read_floats(old, before["inverseBindMatrices"]))
        bound = np.linalg.inv(matrices[-1].reshape(4, 4).T)
        # The bone has the place in the pose of the skin that it has in that of the nodes.
        parents = node_parents(old)
        top = next(j for j in before["joints"] if parents[j] not in before["joints"])
        of_top = np.linalg.inv(matrices[before["joints"].index(top)].reshape(4, 4).T)
        np.testing.assert_allclose(world[root] @ np.linalg.inv(bound), world[top] @ np.linalg.inv(of_top), atol=1e-4)
    parents = tuple(node_parents(new))
    assert all(root in ancestors(parents, joint) for joint in new.gltf["skins"][0]["joints"])


def check_way(animation: OwnAnimation, new: Document, path: Path) -> None:
    """Check that a bone has the way of the hips over the ground in a written file."""
    root, size = len(new.gltf["nodes"]) - 1, np.ptp(animation.source.vertices, axis=0).max()
    hips = animation.node_matrices([animation.joints["Hips"]])[:, 0, :3, 3]
    assert np.ptp(hips[:, [0, 2]], axis=0).max() > 0.1 * size
    mesh, clip = load_mesh(path), load_clip(path, animation="0")
    moved = OwnAnimation(mesh.source, "", clip.skeleton.values(), clip.fps, len(clip), {}).node_matrices([root])[:, 0]
    way = moved[:, :3, 3] - world_matrices(new)[root, :3, 3]
    np.testing.assert_allclose(way, (hips - hips[0]) * [1, 0, 1], atol=SAME * size)
    assert {channel.path for channel in read_channels(new, 0) if channel.node == root} == {"translation"}


def test_a_still_joint_above_the_hips_goes_along(tmp_path):
    """Programs take the way over the ground from the topmost bone; a joint that turns back the way would do no good."""
    animation = written(tmp_path / "a.glb", "props on a still joint")
    new = saved(animation, tmp_path / "b.glb", "Root")
    names = [node["name"] for node in new.gltf["nodes"]]
    moved = {names[channel.node] for channel in read_channels(new, 0) if channel.path == "translation"}
    assert {"Root", "Hips", "box", "plane"} <= moved
    assert not {"Base", "stand"} & moved


def test_a_bone_that_the_file_has_is_used(tmp_path):
    """A file with a root bone that stands still gets no second one, and keeps its name."""
    animation = written(tmp_path / "a.glb", "a joint above the hips moves")
    saved(animation, tmp_path / "still.glb", "root", moves=False)
    before, after = (read_own_rig(load_mesh(tmp_path / name)).person for name in ("a.glb", "still.glb"))
    assert after == before, "own rigs are read with the bone"
    again = animation_of(tmp_path / "still.glb", list(animation.joints))
    new = saved(again, tmp_path / "b.glb", "Root")
    names = [node["name"] for node in new.gltf["nodes"]]
    assert names == [node["name"] for node in again.source.document.gltf["nodes"]]
    assert names.count("root") == 1
    moved = {(names[channel.node], channel.path) for channel in read_channels(new, 0)}
    assert ("root", "translation") in moved
    one, other = (load_clip(tmp_path / name, animation="0").vertices for name in ("still.glb", "b.glb"))
    np.testing.assert_allclose(other, one, atol=SAME * np.ptp(one[0], axis=0).max(), rtol=0)
    renamed = dataclasses.replace(again, root_bone="base", renamed={again.joints["Hips"]: "pelvis"})
    write_own_animations([renamed], tmp_path / "c.glb")
    assert [node["name"] for node in open_document(tmp_path / "c.glb").gltf["nodes"]].count("base") == 1


def test_a_root_of_the_file_that_moves_is_no_root_bone(tmp_path):
    person = below("Root", (0, 0, 0))
    rigs.character(tmp_path / "a.glb", person=person, clips={"move": rigs.exercise(person)})
    new = saved(animation_of(tmp_path / "a.glb", ["Hips"]), tmp_path / "b.glb", "Root")
    names = [node["name"] for node in new.gltf["nodes"]]
    assert (names[FIRST], names[-1]) == ("Root (of the file)", "Root")
    assert new.gltf["nodes"][-1]["children"] == [FIRST]
