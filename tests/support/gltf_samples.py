"""glTF files for the tests: JSON and bytes are built without any of the code under test."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

COMPONENT = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
QUARTER = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""Quaternion (xyzw) of the rotation by -90 degrees about x, from z up to y up."""


class Sample:
    """A document under construction: `gltf` is its JSON, `data` its only buffer."""

    def __init__(self) -> None:
        self.gltf: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
        self.data = bytearray()

    def view(self, content: bytes, **more: Any) -> int:
        self.data += bytes(-len(self.data) % 4)
        self.gltf["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content), **more})
        self.data += content
        return len(self.gltf["bufferViews"]) - 1

    def accessor(self, values: Any, dtype: str = "f4", vertex: bool = True, **more: Any) -> int:
        """Add an accessor with a buffer view of its own; vertex attributes are padded to multiples of 4 bytes."""
        rows = np.atleast_2d(np.asarray(values, f"<{dtype}"))
        rows = rows.T if np.ndim(values) == 1 else rows
        size, stride = rows.itemsize * rows.shape[1], {}
        content = rows.tobytes()
        if size % 4 and vertex:
            padded = np.zeros((len(rows), size + -size % 4), np.uint8)
            padded[:, :size] = np.frombuffer(content, np.uint8).reshape(len(rows), size)
            content, stride = padded.tobytes(), {"byteStride": padded.shape[1]}
        return self.entry(rows, dtype, bufferView=self.view(content, **stride), **more)

    def interleaved(self, *columns: Any) -> list[int]:
        """Add float accessors that share one buffer view, interleaved."""
        rows = np.concatenate([np.asarray(column, "<f4") for column in columns], axis=1)
        view = self.view(rows.tobytes(), byteStride=rows.shape[1] * 4)
        starts = np.cumsum([0] + [np.shape(column)[1] * 4 for column in columns]).tolist()
        return [
            self.entry(np.asarray(column, "<f4"), "f4", bufferView=view, byteOffset=start)
            for column, start in zip(columns, starts[:-1], strict=True)
        ]

    def sparse(self, values: Any) -> int:
        """Add a sparse float accessor without a buffer view: only rows that are not zero are stored."""
        rows = np.asarray(values, "<f4")
        nonzero = np.flatnonzero(rows.any(axis=1)).astype("<u2")
        indices = {"bufferView": self.view(nonzero.tobytes()), "componentType": 5123}
        patch = {"bufferView": self.view(rows[nonzero].tobytes())}
        return self.entry(rows, "f4", sparse={"count": len(nonzero), "indices": indices, "values": patch})

    def indices(self, values: Any, dtype: str = "u2") -> int:
        return self.accessor(np.ravel(values), dtype, vertex=False)

    def entry(self, rows: np.ndarray, dtype: str, **more: Any) -> int:
        bounds = {"min": rows.min(0).astype(float).tolist(), "max": rows.max(0).astype(float).tolist()}
        self.gltf["accessors"].append(
            {"componentType": COMPONENT[dtype], "count": len(rows), "type": KIND[rows.shape[1]], **bounds, **more}
        )
        return len(self.gltf["accessors"]) - 1

    def glb(self, path: Path) -> Path:
        path.write_bytes(pack_glb(self.document_json(), bytes(self.data)))
        return path

    def text(self, path: Path, outside: bool = False) -> Path:
        """Write a .gltf with an embedded buffer, or one in a file whose name needs percent-encoding."""
        gltf = self.document_json()
        gltf["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        if outside:
            gltf["buffers"][0]["uri"] = "the%20data.bin"
            (path.parent / "the data.bin").write_bytes(self.data)
        path.write_text(json.dumps(gltf))
        return path

    def document_json(self) -> dict[str, Any]:
        buffers = [{"byteLength": len(self.data)}] if self.data else []
        return {**self.gltf, **({"buffers": buffers} if buffers else {})}


def pack_glb(gltf: Any, data: bytes) -> bytes:
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    chunk = struct.pack("<II", len(data), 0x004E4942) + data if data else b""
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(chunk), len(text), 0x4E4F534A) + text + chunk


def png() -> bytes:
    """A 1 x 1 red PNG."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0)
    pixels = zlib.compress(b"\0\xff\0\0")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def box(half: float = 0.5) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A hard-edged box: 24 positions, normals, uv and 12 triangles."""
    positions, normals, uv, faces = [], [], [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            normal, u = np.eye(3)[axis] * side, np.eye(3)[(axis + 1) % 3]
            v = np.cross(normal, u)
            first = len(positions)
            for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                positions.append(half * (normal + s * u + t * v))
                normals.append(normal)
                uv.append([(s + 1) / 2, (t + 1) / 4 + axis / 8])
            faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return np.array(positions), np.array(normals), np.array(uv), np.array(faces)


def props() -> Sample:
    """No skin: a box shown by two nodes (one mirrored, both below a rotated and scaled parent), a strip, a fan."""
    sample = Sample()
    positions, normals, uv, faces = box()
    shared = {
        "POSITION": sample.accessor(positions),
        "NORMAL": sample.accessor(normals),
        "TEXCOORD_0": sample.accessor(uv),
    }
    strip = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0.5], [2, 1, 0.5]], float)
    fan = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.5]], float)
    sample.gltf |= {
        "scene": 1,
        "scenes": [{"name": "empty"}, {"name": "shown", "nodes": [0, 3]}],
        "nodes": [
            {"name": "root", "rotation": QUARTER, "scale": [2, 3, 4], "translation": [1, 2, 3], "children": [1, 2]},
            {"name": "left", "mesh": 0, "translation": [-3, 0, 0], "rotation": [0, 0, 0.6, 0.8]},
            {"name": "right", "mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0.5, 0, 1]},
            {"mesh": 1, "translation": [0, 9, 0]},
            {"name": "hidden", "mesh": 1},
        ],
        "meshes": [
            {"name": "box", "primitives": [{"attributes": shared, "indices": sample.indices(faces, "u1")}]},
            {
                "name": "sheets",
                "primitives": [
                    {"attributes": {"POSITION": sample.accessor(strip)}, "mode": 5},
                    {"attributes": {"POSITION": sample.accessor(fan)}, "mode": 6},
                ],
            },
        ],
    }
    return sample


def hero() -> Sample:
    """A rigged character as exporters write it, with a z-up armature of scale 100, and one of each kind of object."""
    sample = Sample()
    body = _body_mesh(sample)
    face = _face_mesh(sample)
    bind = [np.linalg.inv(matrix).T.ravel() for matrix in bind_matrices()]
    times = sample.accessor([0.0, 1.0])
    quaternions = sample.accessor([[0, 0, 0, 1], [0, 0, 0.6, 0.8]])
    inside = sample.view(png())
    sample.gltf |= {
        "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_unlit"],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point", "name": "lamp"}]}},
        "extras": {"made": "by hand"},
        "scene": 0,
        "scenes": [{"name": "stage", "nodes": [0, 5, 6]}],
        "nodes": [
            {"name": "armature", "rotation": QUARTER, "scale": [100, 100, 100], "children": [1, 3], "extras": {"a": 1}},
            {"name": "hip", "translation": [0, 0, 0.01], "rotation": [0, 0.28, 0, 0.96], "children": [2]},
            {"name": "chest", "translation": [0, 0.002, 0.01], "rotation": [0.6, 0, 0, 0.8], "children": [4]},
            {"name": "body", "mesh": 0, "skin": 0, "scale": [0.5, 1, 2], "translation": [0.1, 0.2, 0.3]},
            {"name": "face", "mesh": 1, "translation": [0, 0, 0.005], "scale": [0.01, 0.01, 0.02]},
            {"name": "eye", "camera": 0, "translation": [0, 0, 5]},
            {"name": "lamp", "extensions": {"KHR_lights_punctual": {"light": 0}}},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": sample.accessor(bind), "skeleton": 0}],
        "animations": [
            {
                "name": "turn",
                "samplers": [{"input": times, "output": quaternions}],
                "channels": [{"sampler": 0, "target": {"node": 1, "path": "rotation"}}],
            }
        ],
        "materials": [
            {"name": "cloth", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.25}},
            {
                "name": "skin",
                "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1, 1], "baseColorTexture": {"index": 1}},
                "extensions": {"KHR_materials_unlit": {}},
                "extras": {"soft": True},
            },
        ],
        "textures": [{"source": 0, "sampler": 0}, {"source": 1}],
        "samplers": [{"wrapS": 33071}],
        "images": [
            {"bufferView": inside, "mimeType": "image/png", "name": "red"},
            {"uri": "data:image/png;base64," + base64.b64encode(png()).decode()},
        ],
        "meshes": [body, face],
    }
    return sample


def bind_matrices() -> list[np.ndarray]:
    """World transforms of the joints in the bind pose: upright along z, with the scale of the armature."""
    hip, chest = np.eye(4), np.eye(4)
    hip[:3, 3], chest[:3, 3] = [0, 0, 1], [0, 0, 2]
    small = np.diag([100.0, 100.0, 100.0, 1.0])
    return [hip @ small, chest @ small]


def _body_mesh(sample: Sample) -> dict[str, Any]:
    """Two materials on one interleaved vertex buffer, lines over the same vertices, and separate points."""
    positions, normals, uv, faces = box(1.0)
    positions = positions * [0.5, 0.3, 1.0] + [0, 0, 1]
    rng = np.random.default_rng(0)
    position, normal = sample.interleaved(positions, normals)
    weights = np.round(255 * (positions[:, 2:] / 2)).astype(int)
    patch = np.zeros((24, 2))
    patch[[3, 7, 20]] = rng.random((3, 2))
    skinning = {
        "JOINTS_0": sample.accessor(np.tile([0, 1, 0, 0], (24, 1)), "u1"),
        "WEIGHTS_0": sample.accessor(
            np.concatenate([255 - weights, weights, 0 * weights, 0 * weights], axis=1), "u1", normalized=True
        ),
    }
    attributes = {
        "POSITION": position,
        "NORMAL": normal,
        "TEXCOORD_0": sample.accessor(np.round(uv * 65535), "u2", normalized=True),
        "TEXCOORD_1": sample.sparse(patch),
        "COLOR_0": sample.accessor(rng.integers(0, 256, (24, 3)), "u1", normalized=True),
        **skinning,
    }
    loose_points = {
        "POSITION": sample.accessor(rng.random((5, 3))),
        "JOINTS_0": sample.accessor(np.tile([1, 0, 0, 0], (5, 1)), "u2"),
        "WEIGHTS_0": sample.accessor(np.tile([1, 0, 0, 0], (5, 1))),
    }
    return {
        "name": "body",
        "extras": {"lod": 0},
        "primitives": [
            {"attributes": attributes, "indices": sample.indices(faces[:7]), "material": 0, "extras": {"first": True}},
            {"attributes": attributes, "indices": sample.indices(faces[7:], "u4"), "material": 1},
            {"attributes": {"POSITION": position, **skinning}, "indices": sample.indices([0, 1, 2, 3]), "mode": 1},
            {"attributes": loose_points, "mode": 0},
        ],
    }


def _face_mesh(sample: Sample) -> dict[str, Any]:
    """Not skinned, but below a joint: tangents, two morph targets with a default weight, no index accessor."""
    x, y = np.meshgrid([0.0, 0.5, 1.0], [0.0, 1.0])
    points = np.stack([x, y, 0.2 * x * x], axis=-1)
    quads = [(points[0, i], points[0, i + 1], points[1, i + 1], points[1, i]) for i in range(2)]
    positions = np.array([quad[k] for quad in quads for k in (0, 1, 2, 0, 2, 3)])
    across = np.repeat([[0.5, 0, 0.05], [0.5, 0, 0.15]], 6, axis=0)
    normals = np.cross(across, [0, 1, 0])
    along = across / np.linalg.norm(across, axis=1, keepdims=True)
    smile, frown = np.zeros((12, 3)), np.zeros((12, 3))
    smile[positions[:, 0] == 1] = [0, 0.1, 0.2]
    frown[positions[:, 1] == 1] = [0.1, 0, 0.3]
    return {
        "name": "face",
        "weights": [0.5, 0.0],
        "extras": {"targetNames": ["smile", "frown"]},
        "primitives": [
            {
                "attributes": {
                    "POSITION": sample.accessor(positions),
                    "NORMAL": sample.accessor(normals / np.linalg.norm(normals, axis=1, keepdims=True)),
                    "TANGENT": sample.accessor(np.concatenate([along, -np.ones((12, 1))], axis=1)),
                    "TEXCOORD_0": sample.accessor(positions[:, :2]),
                },
                "material": 1,
                "targets": [
                    {"POSITION": sample.accessor(smile), "NORMAL": sample.accessor(0.1 * smile)},
                    {"POSITION": sample.sparse(frown)},
                ],
            }
        ],
    }
