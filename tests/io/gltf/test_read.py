"""Reading glTF: the rest state against a reference reader and trimesh, and every way an array can be stored."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import gltf_samples as samples
import numpy as np
import pytest
from gltf_reference import ReferenceReader

from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.io import load_clip, load_mesh, save_mesh
from mimesh.io.beside import confined
from mimesh.io.gltf import read_gltf, write_gltf
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.edit import GltfSource
from mimesh.pipeline.gltf_rigs import rig_facts


@pytest.fixture(params=["hero", "props"])
def sample(request: pytest.FixtureRequest) -> samples.Sample:
    return getattr(samples, request.param)()


def test_rest_positions_and_normals_match_the_reference_reader(sample, tmp_path):
    path = sample.glb(tmp_path / "a.glb")
    mesh, reference = read_gltf(path), ReferenceReader(path)
    for span in mesh.source.rest.vertex_ranges:
        for primitive in span.primitives:
            found = mesh.vertices[span.start : span.stop]
            np.testing.assert_allclose(found, reference.points(span.node, primitive), atol=1e-12)
            start, stop = mesh.source.rest.faces.get((span.node, primitive), (0, 0))
            if reference.attribute(span.node, primitive, "NORMAL") is not None and stop > start:
                expected = reference.normals(span.node, primitive)[mesh.faces[start:stop] - span.start]
                np.testing.assert_allclose(mesh.corner_normals[start:stop], expected, atol=1e-12)


def test_glb_and_gltf_containers_give_the_same_mesh(sample, tmp_path):
    first = read_gltf(sample.glb(tmp_path / "a.glb"))
    for path in (sample.text(tmp_path / "b.gltf"), sample.text(tmp_path / "c.gltf", outside=True)):
        mesh = read_gltf(path)
        np.testing.assert_array_equal(mesh.vertices, first.vertices)
        np.testing.assert_array_equal(mesh.faces, first.faces)
        assert mesh.parts == first.parts
        assert mesh.source.suffix == ".gltf"
    assert (first.name, first.source.suffix) == ("a", ".glb")


def test_parts_have_the_names_and_materials_of_primitives(tmp_path):
    mesh = read_gltf(samples.hero().glb(tmp_path / "a.glb"))
    assert [(part.name, part.start, part.stop) for part in mesh.parts] == [
        ("face", 0, 4),
        ("body", 4, 11),
        ("body", 11, 16),
    ]
    cloth, skin = mesh.parts[1].material, mesh.parts[2].material
    assert (cloth.name, cloth.base_color, cloth.texture) == ("cloth", (1, 1, 1, 1), samples.png())
    assert (skin.name, skin.base_color, skin.texture) == ("skin", (0.5, 0.25, 1, 1), samples.png())
    assert mesh.parts[0].material is skin


@pytest.fixture(scope="module")
def props(tmp_path_factory) -> Mesh:
    return read_gltf(samples.props().glb(tmp_path_factory.mktemp("props") / "a.glb"))


def test_faces_of_a_mirrored_node_face_outward(props):
    mesh = props
    for start, stop in ((0, 12), (12, 24)):
        corners = mesh.vertices[mesh.faces[start:stop]]
        corners = corners - corners.mean(axis=(0, 1))
        volume = np.linalg.det(corners).sum() / 6
        assert volume == pytest.approx(24.0)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((normals[:, None] * mesh.corner_normals[start:stop]).sum(-1) > 0).all()


def test_strips_and_fans_become_triangles(props, tmp_path):
    mesh = props
    strip, fan = mesh.faces[24:28] - 48, mesh.faces[28:30] - 54
    assert strip.tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]
    assert fan.tolist() == [[1, 2, 0], [2, 3, 0]]
    assert (mesh.corner_normals[24:28] == mesh.corner_normals[24:28, :1]).all()  # no normals in the file: face normals
    # Degenerate triangles, which strips contain where they change direction, are left out.
    sample = samples.props()
    sample.gltf["meshes"][1]["primitives"][0]["indices"] = sample.indices([0, 1, 2, 2, 3, 3, 4, 5])
    mesh = read_gltf(sample.glb(tmp_path / "a.glb"))
    assert (mesh.faces[24:-2] - 48).tolist() == [[0, 1, 2], [3, 5, 4]]


def test_uv_is_flipped_to_v_up_and_follows_the_base_texture(tmp_path):
    """Its TEXCOORD set and its KHR_texture_transform: scale, offset, and rotation by 90 degrees."""
    sample = samples.hero()
    path = sample.glb(tmp_path / "a.glb")
    mesh, reference = read_gltf(path), ReferenceReader(path)
    first, second = (
        reference.attribute(3, 0, f"TEXCOORD_{k}")[mesh.faces[4:11] - 12].transpose(2, 0, 1) for k in range(2)
    )
    expected = [(first[0], first[1]), (0.1 + 0.5 * second[0], 0.2 + 0.25 * second[1])]
    expected.append((0.1 + 0.25 * second[1], 0.2 - 0.5 * second[0]))
    moved = {"scale": [0.5, 0.25], "offset": [0.1, 0.2], "texCoord": 1}
    texture = sample.gltf["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    for transform, (u, v) in zip(({}, moved, {**moved, "rotation": np.pi / 2}), expected, strict=True):
        texture["extensions"] = {"KHR_texture_transform": transform}
        found = read_gltf(sample.glb(tmp_path / "a.glb")).corner_uv[4:11]
        np.testing.assert_allclose(found, np.stack([u, 1 - v], axis=-1), atol=1e-12)


@pytest.mark.parametrize(("dtype", "normalized"), [("i1", True), ("u2", True), ("i2", False)])
def test_quantized_positions_equal_float_positions(dtype, normalized, tmp_path):
    sample, whole = samples.props(), samples.props()
    steps = np.random.default_rng(0).integers(0, 100, (24, 3))
    accessor = sample.accessor(steps, dtype, **({"normalized": True} if normalized else {}))
    sample.gltf["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = accessor
    sample.gltf["extensionsUsed"] = sample.gltf["extensionsRequired"] = ["KHR_mesh_quantization"]
    largest = np.iinfo(dtype).max if normalized else 1
    floats = whole.accessor(steps / largest)
    whole.gltf["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = floats
    quantized, plain = read_gltf(sample.glb(tmp_path / "a.glb")), read_gltf(whole.glb(tmp_path / "b.glb"))
    np.testing.assert_allclose(quantized.vertices, plain.vertices, rtol=1e-6, atol=1e-6)


def test_most_negative_normalized_integer_is_minus_one(tmp_path):
    sample = samples.props()
    rows = np.tile([-128, 127, 0], (24, 1))
    normals = sample.accessor(rows, "i1", normalized=True)
    sample.gltf["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = normals
    sample.gltf["nodes"][0] = {"children": [1, 2]}
    sample.gltf["nodes"][1] = {"mesh": 0}
    mesh = read_gltf(sample.glb(tmp_path / "a.glb"))
    np.testing.assert_allclose(mesh.corner_normals[0, 0], [-(0.5**0.5), 0.5**0.5, 0], atol=1e-12)


def _with_influences(sets: list[tuple[list[float], list[float]]]) -> samples.Sample:
    """The hero with the same joints and weights at every vertex of its body, one set for each pair."""
    sample = samples.hero()
    for primitive in sample.gltf["meshes"][0]["primitives"][:3]:
        for number, (joints, weights) in enumerate(sets):
            primitive["attributes"][f"JOINTS_{number}"] = sample.accessor(np.tile(joints, (24, 1)), "u2")
            primitive["attributes"][f"WEIGHTS_{number}"] = sample.accessor(np.tile(weights, (24, 1)))
    return sample


@pytest.mark.parametrize(
    "sets",
    [
        [([1, 0, 0, 0], [0.0, 0.0, 0.0, 0.0])],  # no weight at all: the first joint
        [([1, 99, 7, 0], [0.5, 0.0, 0.0, 0.0])],  # weights that do not sum to 1, joints of no weight out of range
        [([0, 0, 0, 0], [0.0, 0.0, 0.0, 0.0]), ([0, 1, 0, 0], [0.0, 0.7, 0.0, 0.0])],  # all weight in the second set
    ],
)
def test_invalid_influences_are_normalized(sets, tmp_path):
    odd = read_gltf(_with_influences(sets).glb(tmp_path / "a.glb"))
    plain = read_gltf(_with_influences([([1, 0, 0, 0], [1.0, 0.0, 0.0, 0.0])]).glb(tmp_path / "b.glb"))
    np.testing.assert_allclose(odd.vertices, plain.vertices, atol=1e-12)


def test_scene_of_points_is_read_as_a_point_cloud(tmp_path):
    sample = samples.props()
    points = np.random.default_rng(0).normal(size=(7, 3))
    sample.gltf["meshes"][1]["primitives"] = [{"attributes": {"POSITION": sample.accessor(points)}, "mode": 0}]
    sample.gltf["scenes"][1]["nodes"] = [3]
    mesh = read_gltf(sample.glb(tmp_path / "a.glb"))
    assert mesh.faces.shape == (0, 3)
    np.testing.assert_allclose(mesh.vertices, points + [0, 9, 0], atol=1e-6)


def test_file_without_scenes_shows_all_nodes(tmp_path):
    sample = samples.props()
    del sample.gltf["scene"], sample.gltf["scenes"]
    ranges = read_gltf(sample.glb(tmp_path / "a.glb")).source.rest.vertex_ranges
    assert [span.node for span in ranges] == [1, 2, 3, 3, 4, 4]


def test_notes_list_what_a_written_file_lacks(tmp_path):
    sample = samples.hero()
    sample.gltf["animations"] *= 3
    sample.gltf["extensionsUsed"] += ["ACME_fur"]
    sample.gltf["images"][1] = {"uri": "not%20here/lost.png"}
    source = read_gltf(sample.glb(tmp_path / "a.glb")).source
    assert isinstance(source, GltfSource)
    assert source.missing_images == ("not here/lost.png",)
    assert source.notes == (
        "dropped the skin and 3 animations and the blend shapes that the file had",
        "kept the data of extension ACME_fur as it is: it does not follow the new shape",
    )
    assert read_gltf(samples.props().glb(tmp_path / "a.glb")).source.notes == (
        "gave each of 3 nodes a mesh of its own, 2 were shared: they now move apart",
    )


def test_image_reference_to_another_kind_of_file_is_not_read(tmp_path: Path):
    (tmp_path / "secret.txt").write_text("not an image")
    (tmp_path / "red one.png").write_bytes(samples.png())
    sample = samples.hero()
    sample.gltf["images"] = [{"uri": "secret.txt"}, {"uri": "red%20one.png"}]
    document = read_gltf(sample.glb(tmp_path / "a.glb")).source.document
    assert document.images == (None, samples.png())


def test_empty_primitives_are_skipped(tmp_path):
    sample = samples.props()
    nothing = sample.entry(np.zeros((1, 3), "<f4"), "f4", count=0)
    sample.gltf["meshes"][0]["primitives"] += [{"attributes": {"POSITION": nothing}}, {"attributes": {}}]
    mesh = read_gltf(sample.glb(tmp_path / "a.glb"))
    assert len(mesh.vertices) == 58
    mesh.source.write(mesh, tmp_path / "b.glb")
    np.testing.assert_array_equal(read_gltf(tmp_path / "b.glb").faces, mesh.faces)


def test_memory_mapped_files_give_the_same_mesh(tmp_path, monkeypatch):
    path = samples.hero().glb(tmp_path / "a.glb")
    whole = read_gltf(path)
    monkeypatch.setattr("mimesh.io.gltf.document.LARGE", 100)
    paged = read_gltf(path)
    assert paged.source.document.mapped_files.maps
    assert not whole.source.document.mapped_files.maps
    paged.source.document.mapped_files.release_pages()
    np.testing.assert_array_equal(paged.vertices, whole.vertices)
    assert bytes(paged.source.document.binary) == bytes(whole.source.document.binary)
    for name, mesh in (("b.glb", paged), ("c.glb", whole)):
        write_gltf(mesh, tmp_path / name)
    assert (tmp_path / "b.glb").read_bytes() == (tmp_path / "c.glb").read_bytes()


def test_last_row_of_matrices_is_that_of_the_standard(tmp_path):
    """Other rows come from damage; with zeros there the matrix would have no inverse."""
    sound, damaged = samples.hero(), samples.hero()
    accessor = damaged.gltf["accessors"][damaged.gltf["skins"][0]["inverseBindMatrices"]]
    start = damaged.gltf["bufferViews"][accessor["bufferView"]]["byteOffset"]
    matrices = np.frombuffer(damaged.data, "<f4", 32, start).reshape(2, 16).copy()
    matrices[:, [3, 7, 11, 15]] = [[0, 0, 0, 0], [0.5, 0, 0, 1]]
    damaged.data[start : start + matrices.nbytes] = matrices.tobytes()
    meshes = [read_gltf(sample.glb(tmp_path / f"{k}.glb")) for k, sample in enumerate((sound, damaged))]
    np.testing.assert_array_equal(*(mesh.vertices for mesh in meshes))
    assert rig_facts(meshes[1]) == rig_facts(meshes[0])

    nodes, mirrored = samples.props(), samples.props()
    mirrored.gltf["nodes"][2]["matrix"][3::4] = [0, 0.25, 0, 0]
    found = [read_gltf(sample.glb(tmp_path / f"n{k}.glb")).vertices for k, sample in enumerate((nodes, mirrored))]
    np.testing.assert_array_equal(*found)


def test_a_normal_that_is_no_number_becomes_that_of_the_face(tmp_path):
    props = samples.props()
    attributes = props.gltf["meshes"][0]["primitives"][0]["attributes"]
    normals = samples.box()[1].copy()
    normals[3] = np.nan
    attributes["NORMAL"] = props.accessor(normals, min=[0, 0, 0], max=[0, 0, 0])
    mesh, right = read_gltf(props.glb(tmp_path / "a.glb")), read_gltf(samples.props().glb(tmp_path / "b.glb"))
    assert mesh.corner_normals is not None
    assert right.corner_normals is not None
    np.testing.assert_allclose(mesh.corner_normals, right.corner_normals, atol=1e-6)


def test_an_animation_with_keys_before_zero_is_played_from_its_first_key(tmp_path):
    clips = []
    for start in (0.0, -2.0, -0.4):
        sample = samples.hero()
        sampler = sample.gltf["animations"][0]["samplers"][0]
        sampler["input"] = sample.accessor([start, start + 1.0])
        clips.append(load_clip(sample.glb(tmp_path / "a.glb"), fps=30.0).vertices)
    assert len(clips[0]) == 31
    for clip in clips[1:]:
        np.testing.assert_allclose(clip, clips[0], atol=1e-6)


@pytest.mark.parametrize(
    ("node", "times"), [(1.0, [0, 1]), (True, [0, 1]), (1, [np.nan]), (1, [0, np.inf]), (1, [1, 0])]
)
def test_nodes_and_times_of_channels_are_checked(node, times, tmp_path):
    sample = samples.hero()
    animation = sample.gltf["animations"][0]
    animation["channels"][0]["target"]["node"] = node
    output = sample.accessor([[0, 0, 0, 1.0]] * len(times))
    animation["samplers"][0] = {"input": sample.accessor(np.zeros(len(times))), "output": output}
    accessor = sample.gltf["accessors"][animation["samplers"][0]["input"]]
    start = sample.gltf["bufferViews"][accessor["bufferView"]]["byteOffset"]
    sample.data[start : start + 4 * len(times)] = np.array(times, "<f4").tobytes()
    with pytest.raises(InputError, match="expected rising times with a value each"):
        load_clip(sample.glb(tmp_path / "a.glb"))


def test_chunks_of_a_glb_are_found_where_their_headers_are_wrong(tmp_path):
    props = samples.props()
    text = b"    "
    while len(text) % 4 == 0:
        props.gltf["asset"]["generator"] = props.gltf["asset"].get("generator", "") + "x"
        text = json.dumps(props.document_json()).encode()
    content, end = props.glb(tmp_path / "a.glb").read_bytes(), 20 + len(text)
    binary = end + -len(text) % 4
    right = read_gltf(tmp_path / "a.glb").vertices
    for wrong in (  # padded with zeros, counted without padding, a type 1 for BIN, a file longer than it is
        content[:end] + bytes(binary - end) + content[binary:],
        content[:12] + struct.pack("<I", len(text)) + content[16:],
        content[: binary + 4] + struct.pack("<I", 1) + content[binary + 8 :],
        content[:8] + struct.pack("<I", len(content) + 4) + content[12:],
    ):
        (tmp_path / "b.glb").write_bytes(wrong)
        assert np.array_equal(read_gltf(tmp_path / "b.glb").vertices, right)


def test_members_that_stand_for_none_are_left_out(tmp_path):
    hero = samples.hero()
    right = read_gltf(hero.glb(tmp_path / "a.glb"))
    for node in hero.gltf["nodes"]:
        node.setdefault("scale", None)
        node.setdefault("mesh", -1)
    hero.gltf["skins"][0]["skeleton"] = -1
    hero.gltf["nodes"].append(None)
    hero.gltf["scenes"][0]["nodes"].append(len(hero.gltf["nodes"]) - 1)
    mesh = read_gltf(hero.glb(tmp_path / "b.glb"))
    assert np.array_equal(mesh.vertices, right.vertices)
    assert "skeleton" not in open_document(tmp_path / "b.glb").gltf["skins"][0]
    save_mesh(mesh.with_vertices(mesh.vertices + 1), tmp_path / "c.glb")
    written = (tmp_path / "c.glb").read_bytes()
    assert b"null" not in written


@pytest.mark.parametrize("uri", [r"parts\mesh.bin", r"C:\Users\me\mesh.bin", "Mesh.BIN", "mesh.bin"])
def test_buffers_are_found_under_the_names_of_other_machines(uri, tmp_path):
    props, folder = samples.props(), tmp_path / ("parts" if "parts" in uri else "")
    folder.mkdir(exist_ok=True)
    (folder / "mesh.bin").write_bytes(props.data)
    gltf = props.document_json()
    (tmp_path / "a.gltf").write_text(json.dumps(gltf | {"buffers": [{"byteLength": len(props.data), "uri": uri}]}))
    with confined(tmp_path):
        assert len(load_mesh(tmp_path / "a.gltf").vertices) == 58
    (folder / "mesh.bin").rename(folder / "mash.bin")
    with pytest.raises(InputError, match="expected the data of buffer 0, found no file"):
        load_mesh(tmp_path / "a.gltf")
