"""Writing a mesh into its source file again: new positions, and everything else as it was."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import gltf_samples as samples
import numpy as np
import pytest
from gltf_reference import ReferenceReader, json_of

from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.io.gltf import read_gltf, write_gltf
from mimesh.io.gltf.draft import Draft


@pytest.fixture(params=["hero", "props"])
def sample(request: pytest.FixtureRequest) -> samples.Sample:
    return getattr(samples, request.param)()


def wave(points: np.ndarray) -> np.ndarray:
    """A smooth deformation that moves every point."""
    return points + 0.3 * np.sin(points @ np.array([[1, 2, 0], [0, 1, -1], [2, 0, 1.0]]) + 1) + [0.1, 0.2, 0.3]


def rotate_all(points: np.ndarray) -> np.ndarray:
    """A rotation by 1.2 radians about (1, 2, 2) / 3."""
    x, y, z = 1 / 3, 2 / 3, 2 / 3
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(1.2) * cross + (1 - np.cos(1.2)) * cross @ cross
    return points @ rotation.T


def written(mesh: Mesh, path: Path, move: Any = None) -> Path:
    write_gltf(mesh if move is None else mesh.with_vertices(move(mesh.vertices)), path)
    return path


def used_accessors(gltf: dict[str, Any]) -> set[int]:
    primitives = [primitive for mesh in gltf["meshes"] for primitive in mesh["primitives"]]
    owners = [owner for p in primitives for owner in (p["attributes"], *p.get("targets", []))]
    indices = {primitive["indices"] for primitive in primitives if "indices" in primitive}
    return indices | {index for owner in owners for index in owner.values()}


def test_written_positions_and_normals_are_read_back(sample, tmp_path):
    """The reference reader agrees, without any skin, and nothing in the file is unused."""
    path = sample.glb(tmp_path / "a.glb")
    mesh = read_gltf(path)
    path.unlink()  # the mesh needs its file no more
    moved = mesh.with_vertices(wave(mesh.vertices))
    written(moved, tmp_path / "b.gltf")
    written(moved, tmp_path / "c.glb")
    path = written(moved, tmp_path / "b.glb")
    assert path.read_bytes() == (tmp_path / "c.glb").read_bytes()
    for loaded in (read_gltf(path), read_gltf(tmp_path / "b.gltf")):
        np.testing.assert_allclose(loaded.vertices, moved.vertices, atol=1e-6 * np.ptp(moved.vertices))
        np.testing.assert_array_equal(loaded.faces, mesh.faces)
        with_normals = slice(0, 24)  # the strip and the fan of the props have none: theirs are face normals
        np.testing.assert_allclose(loaded.corner_normals[with_normals], moved.corner_normals[with_normals], atol=1e-6)
    reference = ReferenceReader(path)
    for span in loaded.source.rest.vertex_ranges:
        for primitive in span.primitives:
            found = reference.points(span.node, primitive)
            np.testing.assert_allclose(found, moved.vertices[span.start : span.stop], atol=2e-6)
    for shown in reference.scene_primitives():
        index = reference.primitive(*shown).attributes.POSITION
        accessor, positions = reference.file.accessors[index], reference.values(index)
        assert (accessor.min, accessor.max) == (positions.min(axis=0).tolist(), positions.max(axis=0).tolist())
    gltf = json_of(path)
    assert used_accessors(gltf) == set(range(len(gltf["accessors"])))
    views = [a["bufferView"] for a in gltf["accessors"]] + [i["bufferView"] for i in gltf.get("images", [])]
    assert sorted(views) == list(range(len(gltf["bufferViews"])))
    end = 0
    for view in gltf["bufferViews"]:
        assert view["byteOffset"] == end
        end += view["byteLength"] + -view["byteLength"] % 4
    assert gltf["buffers"] == [{"byteLength": end}]


def test_written_accessors_stay_shared(tmp_path):
    hero, props = (
        json_of(written(read_gltf(make().glb(tmp_path / "a.glb")), tmp_path / "b.glb", wave))["meshes"]
        for make in (samples.hero, samples.props)
    )
    first, second, lines, loose_points = hero[0]["primitives"]
    assert first["attributes"] == second["attributes"]
    assert lines["attributes"]["POSITION"] == first["attributes"]["POSITION"]
    assert loose_points["attributes"]["POSITION"] != first["attributes"]["POSITION"]
    left, right = (props[number]["primitives"][0] for number in (0, 2))
    assert left["attributes"]["TEXCOORD_0"] == right["attributes"]["TEXCOORD_0"]
    assert left["indices"] == right["indices"]
    assert left["attributes"]["POSITION"] != right["attributes"]["POSITION"]


def test_written_images_keep_their_bytes(tmp_path):
    sample = samples.hero()
    (tmp_path / "red.png").write_bytes(samples.png())
    sample.gltf["images"].append({"uri": "red.png", "name": "outside"})
    out = tmp_path / "elsewhere"
    out.mkdir()
    for path in (out / "b.glb", out / "b.gltf"):
        reference = ReferenceReader(written(read_gltf(sample.text(tmp_path / "a.gltf")), path, wave))
        assert [reference.image(number) for number in range(3)] == [samples.png()] * 3
        assert [image.mimeType for image in reference.file.images] == ["image/png"] * 3
        assert [image.name for image in reference.file.images] == ["red", None, "outside"]


def test_written_points_and_hidden_nodes_keep_their_positions(tmp_path):
    """Points of a skinned mesh keep their world positions, nodes outside the scene their old mesh."""
    hero = samples.hero().glb(tmp_path / "a.glb")
    new = ReferenceReader(written(read_gltf(hero), tmp_path / "b.glb", wave))
    np.testing.assert_allclose(new.points(3, 3), ReferenceReader(hero).points(3, 3), atol=3e-6)
    props = samples.props().glb(tmp_path / "a.glb")
    new = ReferenceReader(written(read_gltf(props), tmp_path / "b.glb", wave))
    np.testing.assert_array_equal(new.points(4, 0), ReferenceReader(props).points(4, 0))


def test_mesh_without_normals_is_written_with_smooth_ones(tmp_path):
    mesh = dataclasses.replace(read_gltf(samples.hero().glb(tmp_path / "a.glb")), corner_normals=None)
    loaded = read_gltf(written(mesh, tmp_path / "b.glb"))
    corners = loaded.corner_normals[4:].reshape(-1, 3)
    points = loaded.vertices[loaded.faces[4:]].reshape(-1, 3)
    for point in np.unique(points.round(5), axis=0):
        at_point = corners[np.abs(points - point).max(axis=1) < 1e-4]
        np.testing.assert_allclose(at_point, at_point[:1].repeat(len(at_point), 0), atol=1e-5)


def test_source_file_without_normals_is_written_without(tmp_path):
    sample = samples.hero()
    for mesh in sample.gltf["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["attributes"].pop("NORMAL", None)
            [target.pop("NORMAL", None) for target in primitive.get("targets", [])]
    mesh = read_gltf(sample.glb(tmp_path / "a.glb"))
    assert mesh.corner_normals is None
    loaded = read_gltf(written(mesh, tmp_path / "b.glb", wave))
    assert loaded.corner_normals is None


def test_tangents_and_morph_targets_of_what_has_moved_are_left_out(tmp_path):
    """The mesh keeps the shape that the weights of its targets gave it."""
    mesh = read_gltf(samples.hero().glb(tmp_path / "a.glb"))
    assert "the blend shapes" in mesh.source.notes[0]
    path = written(mesh, tmp_path / "b.glb")
    np.testing.assert_allclose(read_gltf(path).vertices, mesh.vertices, atol=3e-6)
    old, new = (json_of(tmp_path / name)["meshes"][1] for name in ("a.glb", "b.glb"))
    assert {"weights", "extras"} <= old.keys()
    assert "targetNames" in old["extras"]
    assert "weights" not in new
    assert "targetNames" not in new["extras"]
    for was, now in zip(old["primitives"], new["primitives"], strict=True):
        assert "targets" in was
        assert was["attributes"].keys() - now["attributes"].keys() == {"TANGENT"}
        assert "targets" not in now


@pytest.mark.parametrize(
    "node",
    [{"scale": [0, 0, 0]}, {"scale": [1, 0, 1]}, {"translation": [1e6, 0, 0]}, {"scale": [-1e-30, 1, 1]}],
    ids=["point", "flat", "far", "thin"],
)
def test_mesh_of_a_singular_or_distant_node_moves_to_a_new_node(node, tmp_path):
    sample = samples.hero()
    sample.gltf["nodes"][3] = {"name": "body", "mesh": 0, "skin": 0, **node}
    path = sample.glb(tmp_path / "a.glb")
    mesh = read_gltf(path)
    loaded = read_gltf(written(mesh, tmp_path / "b.glb", wave))
    np.testing.assert_allclose(loaded.vertices, wave(mesh.vertices), atol=3e-6)
    gltf = json_of(tmp_path / "b.glb")
    assert gltf["nodes"][3] == {"name": "body", **node}
    assert gltf["nodes"][7]["name"] == "body"
    assert gltf["scenes"][0]["nodes"] == [0, 5, 6, 7]
    np.testing.assert_array_equal(loaded.faces, mesh.faces)  # the winding order is kept
    loose_points = ReferenceReader(tmp_path / "b.glb").points(7, 3)
    np.testing.assert_allclose(loose_points, ReferenceReader(path).points(3, 3), atol=1e-6)


def test_mesh_far_from_the_origin_stays_in_its_node(tmp_path):
    """Float32 is finer in the node's frame than in world coordinates."""
    sample = samples.props()
    sample.gltf["nodes"][0]["translation"] = [1e5, 0, 0]
    mesh = read_gltf(sample.glb(tmp_path / "a.glb"))
    written(mesh, tmp_path / "b.glb")
    assert len(json_of(tmp_path / "b.glb")["nodes"]) == 5
    np.testing.assert_allclose(read_gltf(tmp_path / "b.glb").vertices, mesh.vertices, atol=1e-5)


def test_unknown_extension_keeps_the_indices_of_its_data(tmp_path):
    sample = samples.hero()
    secret = sample.accessor(np.arange(6.0))
    sample.gltf["extensionsUsed"] += ["ACME_fur"]
    sample.gltf["nodes"][3]["extensions"] = {"ACME_fur": {"accessor": secret}}
    path = sample.glb(tmp_path / "a.glb")
    mesh = read_gltf(path)
    reference = ReferenceReader(written(mesh, tmp_path / "b.glb", wave))
    assert json_of(tmp_path / "b.glb")["nodes"][3]["extensions"] == {"ACME_fur": {"accessor": secret}}
    np.testing.assert_array_equal(reference.values(secret).ravel(), np.arange(6.0))
    np.testing.assert_allclose(reference.points(3, 0), wave(mesh.vertices)[12:], atol=2e-6)
    assert [reference.image(number) for number in range(2)] == [samples.png()] * 2


def test_skinned_node_outside_the_scene_keeps_its_skin(tmp_path):
    """A node outside the scene is not read, and therefore not changed."""
    sample = samples.hero()
    sample.gltf["nodes"].append({"name": "twin", "mesh": 0, "skin": 0})
    path = sample.glb(tmp_path / "a.glb")
    new = ReferenceReader(written(read_gltf(path), tmp_path / "b.glb", wave))
    assert new.file.nodes[3].skin is None
    np.testing.assert_allclose(new.points(7, 0), ReferenceReader(path).points(7, 0), atol=1e-12)


def test_mesh_of_another_topology_is_refused(tmp_path):
    mesh = read_gltf(samples.hero().glb(tmp_path / "a.glb"))
    fewer = dataclasses.replace(mesh, faces=mesh.faces[:-1], corner_normals=None, corner_uv=None)
    with pytest.raises(ValueError, match="must have the 36 vertices and 16 faces of its source, got 36 and 15"):
        write_gltf(fewer, tmp_path / "b.glb")


def test_a_glb_of_four_gigabytes_is_refused(tmp_path):
    draft = Draft({"asset": {"version": "2.0"}})
    draft.size = 2**32
    with pytest.raises(InputError, match=r"less than 4 GiB in a .glb, found 4,294,967,\d+ bytes; write a .gltf"):
        draft.save(tmp_path / "a.glb")
    assert not (tmp_path / "a.glb").exists()


def test_optional_compression_and_animation_pointers_are_not_written(tmp_path):
    sample = samples.hero()
    primitive = sample.gltf["meshes"][0]["primitives"][0]
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    pointer = {"KHR_animation_pointer": {"pointer": "/materials/0/emissiveFactor"}}
    channel = {"sampler": 0, "target": {"path": "pointer", "extensions": pointer}}
    sample.gltf["animations"][0]["channels"].append(channel)
    sample.gltf["extensionsUsed"] += ["KHR_draco_mesh_compression", "KHR_animation_pointer"]
    gltf = json_of(written(read_gltf(sample.glb(tmp_path / "a.glb")), tmp_path / "b.glb", wave))
    assert gltf["extensionsUsed"] == ["KHR_lights_punctual", "KHR_materials_unlit"]
    assert "extensions" not in gltf["meshes"][0]["primitives"][0]
    assert "animations" not in gltf
