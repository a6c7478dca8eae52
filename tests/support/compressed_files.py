"""Draco and meshopt compressed copies of glTF files."""

import copy

import numpy as np
import pytest
from gltf_samples import pack_glb

from mimesh.io.gltf.document import element_bytes, open_document, read_accessor

DRACO, MESHOPT = "KHR_draco_mesh_compression", "EXT_meshopt_compression"


def with_plain_views(path):
    """Return the JSON of a file, one tight buffer view for each accessor with data, and the bytes of these."""
    document = open_document(path)
    gltf, chunks = copy.deepcopy(document.gltf), []
    images = [
        bytes(document.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
        for view in (document.gltf["bufferViews"][i["bufferView"]] for i in gltf.get("images", []) if "bufferView" in i)
    ]
    gltf["bufferViews"] = []
    for index, accessor in enumerate(gltf["accessors"]):
        if "bufferView" not in accessor and "sparse" not in accessor:
            continue
        accessor.pop("sparse", None)
        accessor |= {"bufferView": len(chunks), "byteOffset": 0}
        chunks.append(np.ascontiguousarray(element_bytes(document, index)))
        gltf["bufferViews"].append({"buffer": 0, "byteLength": chunks[-1].nbytes})
    for image, content in zip([i for i in gltf.get("images", []) if "bufferView" in i], images, strict=True):
        image["bufferView"] = len(chunks)
        chunks.append(np.frombuffer(content, np.uint8))
        gltf["bufferViews"].append({"buffer": 0, "byteLength": len(content)})
    return gltf, chunks


def require(gltf, name):
    for key in ("extensionsUsed", "extensionsRequired"):
        gltf[key] = [*gltf.get(key, []), name]


def meshopt_glb(plain, path, name=MESHOPT, version=0):
    """Compress every accessor of a file without loss, with a fallback buffer that has no bytes."""
    meshopt = pytest.importorskip("meshopt")
    gltf, chunks = with_plain_views(plain)
    indices = {p["indices"] for mesh in gltf["meshes"] for p in mesh["primitives"] if "indices" in p}
    triangles = {
        p["indices"] for mesh in gltf["meshes"] for p in mesh["primitives"] if "indices" in p and p.get("mode", 4) == 4
    }
    parts, fallback = [], 0
    for index, accessor in enumerate(gltf["accessors"]):
        if "bufferView" not in accessor:
            continue
        view, rows = gltf["bufferViews"][accessor["bufferView"]], chunks[accessor["bufferView"]]
        start = sum(len(part) for part in parts)
        if index in indices and rows.shape[1] > 1:
            mode, values = "INDICES", rows.view(f"<u{rows.shape[1]}").reshape(-1)
            mode = "TRIANGLES" if index in triangles and len(values) % 3 == 0 else mode
        else:
            rows = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4)))
            mode, values = "ATTRIBUTES", rows
        parts.append(meshopt.encode_gltf_buffer(values, mode, version))
        length = len(parts[-1])
        parts[-1] += bytes(-length % 4)
        stride = rows.shape[1]
        view |= {"buffer": 1, "byteOffset": fallback, "byteLength": rows.nbytes}
        if mode == "ATTRIBUTES":
            view["byteStride"] = stride
        extension = {"buffer": 0, "byteOffset": start, "byteLength": length, "byteStride": stride}
        view["extensions"] = {name: {**extension, "count": len(rows), "mode": mode}}
        fallback += rows.nbytes + -rows.nbytes % 4
    for view, rows in zip(gltf["bufferViews"], chunks, strict=True):
        if "extensions" not in view:
            view["byteOffset"] = sum(len(part) for part in parts)
            parts.append(rows.tobytes() + bytes(-rows.nbytes % 4))
    binary = b"".join(parts)
    gltf["buffers"] = [{"byteLength": len(binary)}, {"byteLength": fallback, "extensions": {name: {"fallback": True}}}]
    require(gltf, name)
    path.write_bytes(pack_glb(gltf, binary))
    return path


def draco_glb(plain, path):
    """Compress the triangles of a file; positions, normals and the like are quantized, joints and weights are not."""
    draco = pytest.importorskip("DracoPy")
    gltf, chunks = with_plain_views(plain)
    document = open_document(plain)
    blobs = []
    for mesh in gltf["meshes"]:
        for primitive in mesh["primitives"]:
            if primitive.get("mode", 4) != 4 or "indices" not in primitive:
                continue
            attributes = primitive["attributes"]
            arrays = {name: read_accessor(document, index) for name, index in attributes.items()}
            ids = {name: number for number, name in enumerate(attributes) if name != "POSITION"}
            blob = draco.encode(
                arrays["POSITION"],
                read_accessor(document, primitive["indices"]).reshape(-1, 3).astype(np.uint32),
                quantization_bits=16,
                preserve_order=True,
                generic_attributes={100 + number: np.ascontiguousarray(arrays[name]) for name, number in ids.items()},
            )
            position = next(a for a in draco.decode(blob).attributes if a["attribute_type"] == 0)
            unique = {name: 100 + number for name, number in ids.items()} | {"POSITION": position["unique_id"]}
            primitive["extensions"] = {DRACO: {"bufferView": len(gltf["bufferViews"]), "attributes": unique}}
            gltf["bufferViews"].append({"buffer": 0, "byteLength": len(blob)})
            chunks.append(np.frombuffer(blob, np.uint8))
            blobs.append(blob)
            # Each primitive has accessors of its own, which have no data.
            for name, index in [*attributes.items(), ("indices", primitive["indices"])]:
                kept = ("componentType", "count", "type", "normalized", "min", "max")
                old = gltf["accessors"][index]
                gltf["accessors"].append({key: old[key] for key in kept if key in old})
                (primitive if name == "indices" else attributes)[name] = len(gltf["accessors"]) - 1
    assert blobs
    start = 0
    for view, rows in zip(gltf["bufferViews"], chunks, strict=True):
        view["byteOffset"] = start
        start += rows.nbytes + -rows.nbytes % 4
    binary = b"".join(rows.tobytes() + bytes(-rows.nbytes % 4) for rows in chunks)
    gltf["buffers"] = [{"byteLength": len(binary)}]
    require(gltf, DRACO)
    path.write_bytes(pack_glb(gltf, binary))
    return path
