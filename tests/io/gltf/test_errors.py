"""Errors in glTF files: each is one line that names the file, what was expected and what was found."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gltf_samples as samples
import pytest

from mimesh.core.errors import InputError
from mimesh.io import load_mesh, save_mesh
from mimesh.io.gltf import read_gltf

JsonChange = Callable[[dict[str, Any]], Any]


def check_refused(path: Path, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_gltf(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: expected ")
    assert "\n" not in text


def attribute(gltf: dict[str, Any], name: str, mesh: int = 0) -> dict[str, Any]:
    """Return the accessor of an attribute of a mesh's first primitive."""
    return gltf["accessors"][gltf["meshes"][mesh]["primitives"][0]["attributes"][name]]


def first(gltf: dict[str, Any]) -> dict[str, Any]:
    return gltf["meshes"][0]["primitives"][0]


def bind(gltf: dict[str, Any]) -> dict[str, Any]:
    return gltf["accessors"][gltf["skins"][0]["inverseBindMatrices"]]


JSON_CHANGES: dict[str, tuple[JsonChange, str]] = {
    "gltf 1": (lambda g: g.update(asset={"version": "1.0"}), "glTF version 2.0, found 1.0"),
    "no asset": (lambda g: g.pop("asset"), "glTF version 2.0, found None"),
    "unknown": (lambda g: g.update(extensionsRequired=["ACME_fur"]), "found required ACME_fur; export without it"),
    "image format": (lambda g: g.update(extensionsRequired=["KHR_texture_basisu"]), "PNG or JPEG .*KHR_texture_basisu"),
    "accessors no list": (lambda g: g.update(accessors={}), "a list before"),
    "node no object": (lambda g: g["nodes"].append(5), "an object around"),
    "no count": (lambda g: g["accessors"][0].pop("count"), "'count' in each of 'accessors \\[\\]'"),
    "negative": (lambda g: g["accessors"][0].update(count=-1), "a count in 'accessors \\[\\] count', found -1"),
    "type number": (lambda g: g["accessors"][0].update(type=3), "text in 'accessors \\[\\] type'"),
    "strange type": (lambda g: g["accessors"][0].update(type="VEC9"), "24 VEC3 in POSITION, found '24 VEC9'"),
    "strange colours": (lambda g: attribute(g, "COLOR_0").update(type="VEC2"), "24 VEC4 in COLOR_0, found '24 VEC2'"),
    "strange index type": (
        lambda g: g["accessors"][first(g)["indices"]].update(type="VEC9"),
        "unsigned indices, found '5123 VEC9'",
    ),
    "strange matrix": (lambda g: bind(g).update(type="MAT9"), "glTF 2.0 type in accessor .*, found 5126 MAT9"),
    "strange component": (
        lambda g: g["accessors"][0].update(componentType=5130),
        "glTF 2.0 type in accessor 0, found 5130 VEC3",
    ),
    "matrix": (lambda g: g["nodes"][0].update(matrix=[1, 0]), "16 numbers in 'nodes \\[\\] matrix'"),
    "extensions": (lambda g: g["materials"][0].update(extensions=[1]), "an object in"),
    "dangling mesh": (lambda g: g["nodes"][3].update(mesh=9), "'nodes \\[\\] mesh' to be one of 2 meshes, found 9"),
    "dangling scene": (lambda g: g.update(scene=4), "'scene' to be one of 1 scenes, found 4"),
    "dangling accessor": (lambda g: first(g)["attributes"].update(NORMAL=999), "to be one of .* accessors, found 999"),
    "dangling texture": (lambda g: g["textures"][0].update(source=7), "to be one of 2 images, found 7"),
    "accessor past its view": (lambda g: bind(g).update(count=9), "576 bytes for accessor 22, found 128"),
    "view past its buffer": (lambda g: g["bufferViews"][0].update(byteLength=10**6), "buffer view 0 inside its buffer"),
    "attribute count": (lambda g: attribute(g, "NORMAL").update(count=7), "24 VEC3 in NORMAL, found '7 VEC3'"),
    "position type": (
        lambda g: attribute(g, "POSITION", 1).update(type="VEC2"),
        "12 VEC3 in POSITION, found '12 VEC2'",
    ),
    "float indices": (
        lambda g: first(g).update(indices=first(g)["attributes"]["NORMAL"]),
        "unsigned indices, found '5126 VEC3'",
    ),
    "no weights": (
        lambda g: [p["attributes"].pop("WEIGHTS_0", 0) for p in g["meshes"][0]["primitives"]],
        "WEIGHTS for each set of JOINTS",
    ),
    "joint out of range": (lambda g: g["skins"][0].update(joints=[1], inverseBindMatrices=0), "inverse bind matrices"),
    "too few joints": (
        lambda g: [g["skins"][0].pop("inverseBindMatrices"), g["skins"][0].update(joints=[1])],
        "joints below 1",
    ),
    "no triangles": (
        lambda g: [p.update(mode=1) for mesh in g["meshes"] for p in mesh["primitives"]],
        r"with triangles, found none \(2 meshes, 1 animations\)",
    ),
    "base64": (lambda g: g["images"][1].update(uri="data:image/png;base64,%%%"), "base64 data"),
    "not ASCII": (lambda g: g["images"][1].update(uri="data:image/png;base64,\u00e4"), "base64 data"),
    "lost buffer": (lambda g: g["buffers"][0].update(uri="lost.bin"), "the data of buffer 0, found no file 'lost.bin'"),
    "short buffer": (lambda g: g["buffers"][0].update(byteLength=10**6), "1000000 bytes in buffer 0"),
    "no data": (lambda g: g["buffers"].append({"byteLength": 4}), "the data of buffer 1, found no file 'inside'"),
    "number beyond float32": (lambda g: g["nodes"][0].update(scale=[1e39, 1, 1]), "3 numbers in 'nodes .. scale'"),
    "signed sparse": (
        lambda g: next(a for a in g["accessors"] if "sparse" in a)["sparse"]["indices"].update(componentType=5122),
        "unsigned sparse indices",
    ),
}


def changed_hero(path: Path, modify: JsonChange) -> Path:
    """Write the hero with other JSON."""
    sample = samples.hero()
    sample.gltf = json.loads(json.dumps(sample.document_json()))
    modify(sample.gltf)
    path.write_bytes(samples.pack_glb(sample.gltf, bytes(sample.data)))
    return path


@pytest.mark.parametrize("name", JSON_CHANGES)
def test_invalid_json_values_are_refused(name, tmp_path):
    modify, message = JSON_CHANGES[name]
    check_refused(changed_hero(tmp_path / "a.glb", modify), message)


def test_numbers_out_of_range_are_refused(tmp_path):
    sparse = samples.hero()
    entry = next(a for a in sparse.gltf["accessors"] if "sparse" in a)
    start = sparse.gltf["bufferViews"][entry["sparse"]["indices"]["bufferView"]]["byteOffset"]
    sparse.data[start : start + 2] = struct.pack("<H", 999)
    check_refused(sparse.glb(tmp_path / "a.glb"), "sparse indices below 24 in accessor .*, found 999")
    faces = samples.hero()
    faces.gltf["meshes"][0]["primitives"][0]["indices"] = faces.indices([0, 1, 24])
    check_refused(faces.glb(tmp_path / "b.glb"), "face indices below 24, found 24")
    props, positions = samples.props(), samples.box()[0]
    positions[3, 1] = float("nan")
    accessor = props.accessor(positions, min=[0, 0, 0], max=[0, 0, 0])
    props.gltf["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = accessor
    check_refused(props.glb(tmp_path / "c.glb"), "finite coordinates, found NaN or infinity in 2 of 58")


def test_truncated_glb_is_refused(tmp_path):
    content = samples.hero().glb(tmp_path / "a.glb").read_bytes()
    for length in (0, 10, 19, 100, 5000, -1, -100):
        (tmp_path / "a.glb").write_bytes(content[:length])
        check_refused(tmp_path / "a.glb", "truncated|binary glTF")


def test_invalid_glb_header_is_refused(tmp_path):
    path = samples.props().glb(tmp_path / "a.glb")
    content = path.read_bytes()
    binary = 20 + struct.unpack_from("<I", content, 12)[0]
    for offset, value, message in (
        (0, b"fTlg", "a binary glTF .* found b'fTlg'"),
        (4, b"\1\0\0\0", "GLB version 2, found 1"),
        (16, b"BIN\0", "JSON chunk first"),
        (binary, struct.pack("<I", 10**6), "a binary chunk of 1000000 bytes"),
    ):
        path.write_bytes(content[:offset] + value + content[offset + len(value) :])
        check_refused(path, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"{", "JSON, found text that does not parse"),
        (b'{"asset": "\xff"}', "JSON, found text that does not parse"),
        (b'{"asset": {"version": "2.0"}, "extras": NaN}', "NaN is not a JSON number"),
        (b"[]", "a JSON object, found list"),
        (b"[" * 100_000, "JSON, found text that does not parse"),
        (b'{"asset": {"version": "2.0"}}', "with triangles, found none"),
    ],
)
def test_invalid_json_text_is_refused(text, message, tmp_path):
    path = tmp_path / "a.gltf"
    path.write_bytes(text)
    check_refused(path, message)


def test_half_of_a_surrogate_pair_in_a_name_is_replaced(tmp_path):
    """JSON can escape it, but no text can hold it: it could not be written again."""
    sample = samples.hero()
    sample.gltf["nodes"][1]["name"] = "a\ud800b \U0001f9b4"
    mesh = load_mesh(sample.glb(tmp_path / "a.glb"))
    save_mesh(mesh, tmp_path / "b.glb")
    assert load_mesh(tmp_path / "b.glb").source.document.gltf["nodes"][1]["name"] == "a\ufffdb \U0001f9b4"


LINKS = {
    "loop": lambda g: g["nodes"][2].update(children=[4, 1]),
    "own child": lambda g: g["nodes"][6].update(children=[6]),
    "two parents": lambda g: g["nodes"][5].update(children=[4]),
}


@pytest.mark.parametrize("name", LINKS)
def test_nodes_that_are_no_tree_are_refused(name, tmp_path):
    check_refused(changed_hero(tmp_path / "a.glb", LINKS[name]), "one parent|below itself")
