"""A reference reader of glTF for the tests: simple and slow, with pygltflib, loops and recursion."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib

FORMAT = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}
LARGEST = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}
COUNT = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def json_of(path: Path) -> dict[str, Any]:
    """The JSON of a .glb or .gltf."""
    content = path.read_bytes()
    if path.suffix == ".gltf":
        return json.loads(content)
    return json.loads(content[20 : 20 + struct.unpack_from("<I", content, 12)[0]])


def binary_of(path: Path) -> bytes:
    """The binary chunk of a .glb."""
    content = path.read_bytes()
    return content[28 + struct.unpack_from("<I", content, 12)[0] :]


class ReferenceReader:
    """Evaluates one file primitive by primitive: positions, normals, indices and morph weights."""

    def __init__(self, path: Path) -> None:
        self.file = pygltflib.GLTF2().load(str(path))
        uri = self.file.buffers[0].uri
        self.data = self.file.binary_blob() if uri is None else base64.b64decode(uri.partition(",")[2])

    def values(self, index: int) -> np.ndarray:
        accessor = self.file.accessors[index]
        width = COUNT[accessor.type]
        code = f"<{width}{FORMAT[accessor.componentType]}"
        rows = [[0.0] * width for _ in range(accessor.count)]
        if accessor.bufferView is not None:
            rows = self.unpack(accessor.bufferView, accessor.byteOffset or 0, code, accessor.count)
        if accessor.sparse is not None:
            sparse = accessor.sparse
            kind = f"<1{FORMAT[sparse.indices.componentType]}"
            elements = self.unpack(sparse.indices.bufferView, sparse.indices.byteOffset or 0, kind, sparse.count)
            new = self.unpack(sparse.values.bufferView, sparse.values.byteOffset or 0, code, sparse.count)
            for (element,), row in zip(elements, new, strict=True):
                rows[element] = row
        values = np.array(rows, float)
        return values / LARGEST[accessor.componentType] if accessor.normalized else values

    def unpack(self, view_index: int, offset: int, code: str, count: int) -> list[Any]:
        view = self.file.bufferViews[view_index]
        start, stride = (view.byteOffset or 0) + offset, view.byteStride or struct.calcsize(code)
        return [list(struct.unpack_from(code, self.data, start + i * stride)) for i in range(count)]

    def image(self, index: int) -> bytes:
        image = self.file.images[index]
        if image.uri:
            return base64.b64decode(image.uri.partition(",")[2])
        view = self.file.bufferViews[image.bufferView]
        return self.data[view.byteOffset or 0 :][: view.byteLength]

    def world(self, node: int) -> np.ndarray:
        parents = [i for i, other in enumerate(self.file.nodes) if node in (other.children or [])]
        local = self.local(self.file.nodes[node])
        return self.world(parents[0]) @ local if parents else local

    def local(self, node: Any) -> np.ndarray:
        if node.matrix:
            return np.array(node.matrix).reshape(4, 4, order="F")
        x, y, z, w = node.rotation or [0, 0, 0, 1]
        rotation = np.eye(4)
        for column, axis in enumerate(np.eye(3)):  # q v q*, one basis vector at a time
            u = np.array([x, y, z])
            rotation[:3, column] = 2 * (u @ axis) * u + (w * w - u @ u) * axis + 2 * w * np.cross(u, axis)
        translation, scale = np.eye(4), np.diag([*(node.scale or [1, 1, 1]), 1])
        translation[:3, 3] = node.translation or [0, 0, 0]
        return translation @ rotation @ scale

    def scene_primitives(self) -> list[tuple[int, int]]:
        """(node, primitive) of all primitives in the default scene, depth first."""
        found = []

        def visit(index: int) -> None:
            node = self.file.nodes[index]
            if node.mesh is not None:
                found.extend((index, p) for p in range(len(self.file.meshes[node.mesh].primitives)))
            for child in node.children or []:
                visit(child)

        for root in self.file.scenes[self.file.scene or 0].nodes or []:
            visit(root)
        return found

    def primitive(self, node: int, number: int) -> Any:
        return self.file.meshes[self.file.nodes[node].mesh].primitives[number]

    def attribute(self, node: int, number: int, name: str) -> np.ndarray | None:
        index = getattr(self.primitive(node, number).attributes, name, None)
        return None if index is None else self.values(index)

    def weights(self, node: int) -> list[float]:
        entry = self.file.nodes[node]
        return getattr(entry, "weights", None) or self.file.meshes[entry.mesh].weights or []

    def morphed(self, node: int, number: int, name: str, weights: list[float]) -> np.ndarray:
        values = self.attribute(node, number, name)
        for weight, target in zip(weights, self.primitive(node, number).targets or [], strict=False):
            target = target if isinstance(target, dict) else vars(target)
            if weight and target.get(name) is not None:
                values[:, :3] = values[:, :3] + weight * self.values(target[name])
        return values

    def matrices(self, node: int, number: int) -> list[np.ndarray]:
        """The 4 x 4 world matrix of each vertex: its node's, or the weighted sum of its joints'."""
        entry, joints = self.file.nodes[node], self.attribute(node, number, "JOINTS_0")
        count = len(self.attribute(node, number, "POSITION"))
        if entry.skin is None or joints is None:
            return [self.world(node)] * count
        skin, weights = self.file.skins[entry.skin], self.attribute(node, number, "WEIGHTS_0")
        bind = [row.reshape(4, 4, order="F") for row in self.values(skin.inverseBindMatrices)]
        joint = [self.world(j) @ b for j, b in zip(skin.joints, bind, strict=True)]
        return [
            sum(weights[v, k] / weights[v].sum() * joint[int(joints[v, k])] for k in range(4)) for v in range(count)
        ]

    def points(self, node: int, number: int, weights: list[float] | None = None) -> np.ndarray:
        local = self.morphed(node, number, "POSITION", self.weights(node) if weights is None else weights)
        return np.array([(m @ [*p, 1])[:3] for m, p in zip(self.matrices(node, number), local, strict=True)])

    def normals(self, node: int, number: int, weights: list[float] | None = None) -> np.ndarray:
        local = self.morphed(node, number, "NORMAL", self.weights(node) if weights is None else weights)
        world = [np.linalg.inv(m[:3, :3]).T @ n for m, n in zip(self.matrices(node, number), local, strict=True)]
        return np.array([n / np.linalg.norm(n) for n in world])

    def indices(self, node: int, number: int) -> np.ndarray:
        primitive = self.primitive(node, number)
        if primitive.indices is None:
            return np.arange(len(self.attribute(node, number, "POSITION")))
        return self.values(primitive.indices).astype(int).ravel()

    def weights_at(self, node: int, time: float) -> list[float]:
        """The animated morph weights of a node: linear between keys."""
        animation = self.file.animations[0]
        (channel,) = [c for c in animation.channels if c.target.node == node and c.target.path == "weights"]
        sampler = animation.samplers[channel.sampler]
        assert sampler.interpolation == "LINEAR"
        times = self.values(sampler.input).ravel()
        keys = self.values(sampler.output).reshape(len(times), -1)
        return [float(np.interp(time, times, column)) for column in keys.T]
