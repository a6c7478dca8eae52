"""Rigged characters: joints, influences and their positions against a reference reader."""

from __future__ import annotations

import gltf_samples as samples
import numpy as np
from gltf_reference import ReferenceReader
from rigs import read_skin

from mimesh.io import load_mesh

FACE, BODY = slice(0, 12), slice(12, 36)
"""Vertices of the hero's meshes."""


def body_of(sample: samples.Sample) -> list[dict]:
    return sample.gltf["meshes"][0]["primitives"]


def test_joints_and_influences_match_the_reference_reader(tmp_path):
    """Weights are normalised bytes here, and the scale of the armature is 100; the face is unskinned below the chest,
    with its morph targets at their default weights."""
    path = samples.hero().glb(tmp_path / "a.glb")
    skin, mesh, reference = read_skin(path), load_mesh(path), ReferenceReader(path)
    assert (skin.joint_names, skin.parents) == (("hip", "chest"), (-1, 0))
    worlds = [reference.world(node) for node in (1, 2)]
    np.testing.assert_allclose(skin.T_world_joint, worlds, atol=1e-12)
    bind = [row.reshape(4, 4, order="F") for row in reference.values(reference.file.skins[0].inverseBindMatrices)]
    positions, weights = reference.attribute(3, 0, "POSITION"), reference.attribute(3, 0, "WEIGHTS_0")
    np.testing.assert_allclose(skin.weights[BODY], weights, atol=1e-12)
    for v in range(24):
        assert skin.joint_of[12 + v, weights[v] > 0].tolist() == np.array([0, 1, 0, 0])[weights[v] > 0].tolist()
        for k in np.flatnonzero(weights[v]):
            expected = worlds[k] @ bind[k] @ [*positions[v], 1]
            np.testing.assert_allclose(skin.points[12 + v, k], expected[:3], atol=1e-12)
    assert (skin.joint_of[FACE, 0] == 1).all()
    assert (skin.weights[FACE] == [1, 0, 0, 0]).all()
    np.testing.assert_allclose(skin.points[FACE, 0], reference.points(4, 0), atol=1e-12)
    np.testing.assert_allclose((skin.weights[..., None] * skin.points).sum(axis=1), mesh.vertices, atol=1e-12)
    np.testing.assert_array_equal(skin.mesh.faces, mesh.faces)


def test_unskinned_mesh_without_a_joint_above_follows_the_world(tmp_path):
    sample = samples.hero()
    sample.gltf["nodes"].append({"name": "floor", "mesh": 1})
    sample.gltf["scenes"][0]["nodes"].append(7)
    skin = read_skin(sample.glb(tmp_path / "a.glb"))
    assert (skin.joint_of[36:, 0] == 2).all()
    assert (skin.weights[36:, 0] == 1).all()


def test_skins_with_the_same_joints_are_merged(tmp_path):
    """A second mesh has its own skin with the same joints in another order, and the same influences result."""
    sample = samples.hero()
    bind = [np.linalg.inv(matrix).T.ravel() for matrix in samples.bind_matrices()]
    sample.gltf["skins"].append({"joints": [2, 1], "inverseBindMatrices": sample.accessor(bind[::-1])})
    sample.gltf["skins"].append({"joints": [5, 6]})  # of no mesh: not read
    attributes = dict(body_of(sample)[0]["attributes"])
    attributes["JOINTS_0"] = sample.accessor(np.tile([1, 0, 0, 0], (24, 1)), "u1")
    sample.gltf["meshes"].append({"primitives": [{**body_of(sample)[0], "attributes": attributes}]})
    sample.gltf["nodes"].append({"name": "coat", "mesh": 2, "skin": 1})
    sample.gltf["scenes"][0]["nodes"].append(7)
    skin = read_skin(sample.glb(tmp_path / "a.glb"))
    assert skin.joint_names == ("hip", "chest")
    coat = slice(36, 60)
    used = skin.weights > 0
    np.testing.assert_array_equal(np.where(used, skin.joint_of, 9)[BODY], np.where(used, skin.joint_of, 9)[coat])
    np.testing.assert_allclose(skin.points[BODY][used[BODY]], skin.points[coat][used[coat]], atol=1e-12)


def test_several_sets_of_influences_are_read(tmp_path):
    sample = samples.hero()
    for primitive in body_of(sample)[:3]:
        for number, joints in enumerate(([0, 0, 0, 0], [1, 0, 0, 0])):
            primitive["attributes"][f"JOINTS_{number}"] = sample.accessor(np.tile(joints, (24, 1)), "u2")
            weights = np.tile([0.25 + 0.5 * number, 0, 0, 0], (24, 1))
            primitive["attributes"][f"WEIGHTS_{number}"] = sample.accessor(weights)
    skin = read_skin(sample.glb(tmp_path / "a.glb"))
    assert skin.weights.shape == (36, 8)
    assert skin.joint_of[12:, 4].tolist() == [1] * 24
    np.testing.assert_allclose(skin.weights[12:, [0, 4]], np.tile([0.25, 0.75], (24, 1)))
    np.testing.assert_allclose((skin.weights[..., None] * skin.points).sum(axis=1), skin.mesh.vertices, atol=1e-12)


def test_nodes_between_joints_are_skipped(tmp_path):
    sample = samples.hero()
    sample.gltf["skins"][0]["joints"] = [2, 0]
    del sample.gltf["nodes"][2]["name"]
    skin = read_skin(sample.glb(tmp_path / "a.glb"))
    assert (skin.joint_names, skin.parents) == (("armature", "node2"), (-1, 0))
