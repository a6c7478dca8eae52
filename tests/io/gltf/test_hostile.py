"""Unusual but valid glTF files: all data besides positions and normals is in the written file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import quote

import gltf_samples as samples
import numpy as np
import pytest
from gltf_reference import ReferenceReader, binary_of, json_of

from mimesh.core.mesh import Clip
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh

MOVED = ("POSITION", "NORMAL", "TANGENT", "JOINTS_0", "WEIGHTS_0")
BYTES_OF = ("accessors", "bufferViews", "buffers", "images", "skins", "animations")
OPTIONAL = ("materials_variants", "lights_punctual")
FOLDER = "Größe & 大小 #1"


def sparse_over_a_view(sample: samples.Sample, values: np.ndarray) -> int:
    """An accessor with two wrong rows in its buffer view, which its sparse values correct."""
    wrong, elements = values.copy(), np.array([1, len(values) - 1])
    wrong[elements] += 9
    index = sample.accessor(wrong)
    indices = {"bufferView": sample.view(elements.astype("<u4").tobytes()), "componentType": 5125}
    patch = {"bufferView": sample.view(values[elements].astype("<f4").tobytes())}
    sample.gltf["accessors"][index] |= {"sparse": {"count": 2, "indices": indices, "values": patch}}
    return index


def unusual_document() -> samples.Sample:
    """Quantised points under a scaling node, two scenes, variants, transformed textures, extras of every kind."""
    sample = samples.Sample()
    positions, normals, uv, faces = samples.box(0.5)
    rng = np.random.default_rng(0)
    attributes = {
        "POSITION": sample.accessor(np.round((positions + 0.5) * 65535), "u2", normalized=True),
        "NORMAL": sample.accessor(np.round(normals * 127), "i1", normalized=True),
        "TEXCOORD_0": sample.accessor(np.round(uv * 255), "u1", normalized=True),
        "TEXCOORD_1": sparse_over_a_view(sample, rng.random((24, 2))),
        "COLOR_0": sample.accessor(rng.random((24, 4))),
        "COLOR_1": sample.accessor(rng.integers(0, 65536, (24, 3)), "u2", normalized=True),
        "_HEAT": sample.accessor(rng.random(24)),
    }
    soup = positions[faces.ravel()] + [3, 0, 0]
    red = {"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0], "scale": [2, -1]}}}
    variants = {"mappings": [{"material": 1, "variants": [0], "name": "x"}, {"material": 0, "variants": [1]}]}
    sample.gltf |= {
        "extensionsUsed": [f"KHR_{name}" for name in ("mesh_quantization", "texture_transform", *OPTIONAL)],
        "extensionsRequired": ["KHR_mesh_quantization", "KHR_texture_transform"],
        "extensions": {
            "KHR_materials_variants": {"variants": [{"name": "été"}, {"name": "winter 冬"}]},
            "KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {}, "extras": [1, {"a": None}]}]},
        },
        "extras": {"nested": [1, 2.5, "ü", None, {"deep": True}]},
        "scene": 1,
        "scenes": [{"name": "other", "nodes": [4]}, {"name": "shown 舞台", "nodes": [0], "extras": 7}],
        "nodes": [
            {"name": "root / 根", "scale": [-2, 1, 1], "rotation": samples.QUARTER, "children": [1, 3]},
            {"name": "grown", "scale": [0.5, 4, 1], "translation": [1, 2, 3], "children": [2]},
            {"name": "name with  spaces", "mesh": 0, "matrix": [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, -1, 0, 5, 6, 7, 1]},
            {"name": "lamp", "extensions": {"KHR_lights_punctual": {"light": 0}}, "camera": 0},
            {"name": "elsewhere", "mesh": 0, "extras": {"x": "y"}},
        ],
        "cameras": [{"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 9}}],
        "materials": [
            {"name": "Ziegel rot", "pbrMetallicRoughness": {"baseColorTexture": red}, "normalTexture": {"index": 0}},
            {"name": "Ziegel rot", "emissiveFactor": [1, 0, 0], "alphaMode": "MASK", "alphaCutoff": 0.25},
        ],
        "textures": [{"source": 0, "sampler": 0, "name": "t"}],
        "samplers": [{"magFilter": 9728, "wrapS": 33648}],
        "images": [{"bufferView": sample.view(samples.png()), "mimeType": "image/png", "name": "red ü"}],
        "meshes": [
            {
                "name": "box 箱",
                "extras": {"lod": 1},
                "primitives": [
                    {
                        "attributes": attributes,
                        "indices": sample.indices(faces, "u1"),
                        "material": 0,
                        "extensions": {"KHR_materials_variants": variants},
                    },
                    {"attributes": {"POSITION": sample.accessor(soup)}, "material": 1, "extras": "no indices"},
                    {"attributes": {"POSITION": sample.accessor(soup[:5])}, "mode": 3},
                    {"attributes": {"POSITION": sample.accessor(soup[:6])}, "mode": 5},
                ],
            }
        ],
    }
    return sample


def reference_without_extras(path: Path) -> ReferenceReader:
    """Open a copy of the file without extras, of which pygltflib accepts only objects."""
    copy, gltf = path.with_stem("plain"), without_extras(json_of(path))
    is_text = path.suffix == ".gltf"
    copy.write_bytes(json.dumps(gltf).encode() if is_text else samples.pack_glb(gltf, binary_of(path)))
    return ReferenceReader(copy)


def without_extras(value: Any) -> Any:
    if isinstance(value, list):
        return [without_extras(item) for item in value]
    if isinstance(value, dict):
        return {key: without_extras(item) for key, item in value.items() if key != "extras"}
    return value


def resolved(path: Path) -> dict[str, Any]:
    """The JSON of a file with accessor values in place of their indices, without data that writing changes or drops."""
    reference, gltf = reference_without_extras(path), json_of(path)
    for mesh in gltf["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["attributes"] = {
                name: values_of(reference, index)
                for name, index in primitive["attributes"].items()
                if name not in MOVED
            }
            primitive["indices"] = values_of(reference, primitive["indices"]) if "indices" in primitive else None
            primitive["targets"] = len(primitive.get("targets", []))
    images = [(reference.image(number), image.get("name")) for number, image in enumerate(gltf.get("images", []))]
    return {**{key: value for key, value in gltf.items() if key not in BYTES_OF}, "images": images}


def values_of(reference: ReferenceReader, index: int) -> tuple:
    entry = reference.file.accessors[index]
    return entry.componentType, entry.type, bool(entry.normalized), reference.values(index).tolist()


def without_meshes(path: Path) -> dict[str, Any]:
    """Move each mesh into the nodes that show it, because shared ones may have become several, without its targets."""
    gltf = resolved(path)
    meshes = gltf.pop("meshes")
    for mesh in meshes:
        mesh.pop("weights", None)
        mesh.get("extras", {}).pop("targetNames", None)
        if not mesh.get("extras"):
            mesh.pop("extras", None)
        for primitive in mesh["primitives"]:
            primitive.pop("targets", None)
            primitive["attributes"].pop("TANGENT", None)
    for node in gltf["nodes"]:
        if "mesh" in node:
            node["mesh"] = meshes[node["mesh"]]
        node.pop("skin", None)
        node.pop("weights", None)
    return gltf


MAKERS = ((unusual_document, ".glb"), (unusual_document, ".gltf"), (samples.hero, ".glb"), (samples.props, ".gltf"))


@pytest.mark.parametrize(("make", "suffix"), MAKERS)
def test_files_keep_all_but_positions_and_normals(make, suffix, tmp_path):
    path = make().glb(tmp_path / "a.glb")
    mesh, before = load_mesh(path), without_meshes(path)
    moved = mesh.with_vertices(mesh.vertices * [1, 1.5, 1] + [0, 0.25, 1])
    save_mesh(moved, tmp_path / f"b{suffix}")
    assert without_meshes(tmp_path / f"b{suffix}") == before
    assert not {"skins", "animations"} & json_of(tmp_path / f"b{suffix}").keys()
    loaded = load_mesh(tmp_path / f"b{suffix}")
    assert np.allclose(loaded.vertices, moved.vertices, atol=1e-6 * np.ptp(moved.vertices))
    for name in ("faces", "corner_uv", "vertex_colors"):
        assert np.array_equal(getattr(loaded, name), getattr(mesh, name))
    assert loaded.parts == mesh.parts
    frames = np.stack([mesh.vertices + [t, 0, 0.5 * t] for t in range(3)])
    save_clip(Clip(mesh, frames), tmp_path / "c.glb")
    assert without_meshes(tmp_path / "c.glb") == before
    clip = load_clip(tmp_path / "c.glb")
    assert np.allclose(clip.vertices, frames, atol=1e-6 * np.ptp(frames))
    assert clip.mesh.parts == mesh.parts


NAMES = [("the data.bin", quote), ("50%20off.bin", str), ("数据 #1?.bin", quote), ("a+b&c.bin", str)]


@pytest.mark.parametrize(("name", "escape"), NAMES)
def test_buffers_and_images_in_other_files_are_found(name, escape, tmp_path):
    sample = unusual_document()
    (tmp_path / FOLDER / "maps").mkdir(parents=True)
    (tmp_path / FOLDER / name).write_bytes(sample.data)
    picture = f"maps/{Path(name).stem}.png"
    (tmp_path / FOLDER / picture).write_bytes(samples.png())
    gltf = sample.document_json()
    gltf["buffers"][0]["uri"] = escape(name)
    gltf["images"].append({"uri": escape(picture)})
    (tmp_path / FOLDER / "a b.gltf").write_text(json.dumps(gltf), "utf-8")
    mesh = load_mesh(tmp_path / FOLDER / "a b.gltf")
    assert np.array_equal(mesh.vertices, load_mesh(unusual_document().glb(tmp_path / "a.glb")).vertices)
    save_mesh(mesh, tmp_path / "out" / "a b.gltf")
    reference = reference_without_extras(tmp_path / "out" / "a b.gltf")
    assert [reference.image(number) for number in range(2)] == [samples.png()] * 2


def test_optional_image_format_is_kept_beside_the_png(tmp_path):
    sample = unusual_document()
    sample.gltf["extensionsUsed"].append("KHR_texture_basisu")
    ktx = b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(68)
    sample.gltf["images"].append({"bufferView": sample.view(ktx), "mimeType": "image/ktx2"})
    sample.gltf["textures"][0]["extensions"] = {"KHR_texture_basisu": {"source": 1}}
    mesh = load_mesh(sample.glb(tmp_path / "a.glb"))
    save_mesh(mesh, tmp_path / "b.glb")
    assert json_of(tmp_path / "b.glb")["textures"][0] == sample.gltf["textures"][0]
    assert reference_without_extras(tmp_path / "b.glb").image(1) == ktx
    assert mesh.parts[0].material.texture == samples.png()
