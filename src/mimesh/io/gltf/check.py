"""What a glTF document must look like before any of it is used: versions, extensions, types, references.

The tables name places in the JSON tree: `[]` stands for each item of a list, `{}` for each value of an object, and a
place that is absent is skipped. After `check_document` the rest of the reader follows indices without looking.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...core.errors import InputError

TEXTURE_TRANSFORM, SPECULAR_GLOSSINESS = (
    "extensions KHR_texture_transform",
    "extensions KHR_materials_pbrSpecularGlossiness",
)

REQUIRED = {
    "accessors []": ("componentType", "count", "type"),
    "accessors [] sparse": ("count", "indices", "values"),
    "accessors [] sparse indices": ("bufferView", "componentType"),
    "accessors [] sparse values": ("bufferView",),
    "bufferViews []": ("buffer", "byteLength"),
    "buffers []": ("byteLength",),
    "meshes []": ("primitives",),
    "meshes [] primitives []": ("attributes",),
    "skins []": ("joints",),
}

NON_NEGATIVE_INTEGERS = (
    "accessors [] componentType",
    "accessors [] count",
    "accessors [] byteOffset",
    "accessors [] sparse count",
    "accessors [] sparse indices byteOffset",
    "accessors [] sparse indices componentType",
    "accessors [] sparse values byteOffset",
    "bufferViews [] byteOffset",
    "bufferViews [] byteLength",
    "bufferViews [] byteStride",
    "buffers [] byteLength",
    "meshes [] primitives [] mode",
)

NUMBER_LISTS = {
    "nodes [] matrix": 16,
    "nodes [] translation": 3,
    "nodes [] rotation": 4,
    "nodes [] scale": 3,
    "nodes [] weights": None,
    "meshes [] weights": None,
    "materials [] pbrMetallicRoughness baseColorFactor": 4,
    f"materials [] pbrMetallicRoughness baseColorTexture {TEXTURE_TRANSFORM} offset": 2,
    f"materials [] pbrMetallicRoughness baseColorTexture {TEXTURE_TRANSFORM} scale": 2,
    f"materials [] {SPECULAR_GLOSSINESS} diffuseFactor": 4,
    f"materials [] {SPECULAR_GLOSSINESS} diffuseTexture {TEXTURE_TRANSFORM} offset": 2,
    f"materials [] {SPECULAR_GLOSSINESS} diffuseTexture {TEXTURE_TRANSFORM} scale": 2,
}

STRINGS = (
    "extensionsUsed []",
    "extensionsRequired []",
    "accessors [] type",
    "buffers [] uri",
    "images [] uri",
    "nodes [] name",
    "meshes [] name",
    "materials [] name",
)

OBJECTS = (
    "animations []",
    "textures [] extensions",
    "textures [] extensions {}",
    "materials [] extensions",
    "materials [] extensions {}",
    "materials [] pbrMetallicRoughness baseColorTexture extensions",
    "materials [] pbrMetallicRoughness baseColorTexture extensions {}",
    "meshes [] primitives [] extensions",
    "bufferViews [] extensions",
)

REFERENCES = {
    "scenes [] nodes []": "nodes",
    "scene": "scenes",
    "nodes [] children []": "nodes",
    "nodes [] mesh": "meshes",
    "nodes [] skin": "skins",
    "skins [] joints []": "nodes",
    "skins [] inverseBindMatrices": "accessors",
    "meshes [] primitives [] attributes {}": "accessors",
    "meshes [] primitives [] targets [] {}": "accessors",
    "meshes [] primitives [] indices": "accessors",
    "meshes [] primitives [] material": "materials",
    "textures [] source": "images",
    "materials [] pbrMetallicRoughness baseColorTexture index": "textures",
    f"materials [] {SPECULAR_GLOSSINESS} diffuseTexture index": "textures",
    "images [] bufferView": "bufferViews",
    "accessors [] bufferView": "bufferViews",
    "accessors [] sparse indices bufferView": "bufferViews",
    "accessors [] sparse values bufferView": "bufferViews",
    "bufferViews [] buffer": "buffers",
}

COMPRESSION_EXTENSIONS = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
"""Extensions that hide the vertices from us where they are required; elsewhere the file has plain data beside them."""

IMAGE_EXTENSIONS = {"KHR_texture_basisu"}
"""Extensions that hide the pictures from us where they are required; elsewhere the file has PNG or JPEG beside them."""

APPEARANCE_PREFIXES = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_xmp",
    "VRM",
    "MSFT_texture",
)
"""Beginnings of the names of extensions that say how things look and hold no vertex data."""

SUPPORTED_EXTENSIONS = ("KHR_mesh_quantization", "KHR_animation_pointer")


def is_understood(extension: str) -> bool:
    """Whether a file with this extension is read rightly, and its buffers may be repacked, by the rest of `io.gltf`."""
    return extension in SUPPORTED_EXTENSIONS or extension.startswith(APPEARANCE_PREFIXES)


ATTRIBUTE_TYPES = {
    "POSITION": "VEC3",
    "NORMAL": "VEC3",
    "TANGENT": "VEC4",
    "TEXCOORD": "VEC2",
    "JOINTS": "VEC4",
    "WEIGHTS": "VEC4",
}
MORPH_TARGET_TYPES = {"POSITION": "VEC3", "NORMAL": "VEC3", "TANGENT": "VEC3"}
INDEX_TYPES = (5121, 5123, 5125)


def check_document(gltf: Any, path: Path) -> None:
    """Check the JSON of a glTF file.

    Raises:
        InputError: not glTF 2, an extension that cannot be done without, or a missing, mistyped or dangling entry.
    """
    if not isinstance(gltf, dict):
        raise InputError(
            f"{path}: expected a JSON object, found {type(gltf).__name__}; export the file again as glTF 2.0"
        )
    _check_version(gltf, path)
    _check_extensions(gltf, path)
    for place, names in REQUIRED.items():
        for item in _values_at(gltf, place, path):
            for name in names:
                _expect(isinstance(item, dict) and name in item, path, f"'{name}' in each of '{place}'", item)
    for place in NON_NEGATIVE_INTEGERS:
        for value in _values_at(gltf, place, path):
            _expect(_is_index(value), path, f"a count in '{place}'", value)
    for place in STRINGS:
        for value in _values_at(gltf, place, path):
            _expect(isinstance(value, str), path, f"text in '{place}'", value)
    for place in OBJECTS:
        for value in _values_at(gltf, place, path):
            _expect(isinstance(value, dict), path, f"an object in '{place}'", value)
    for place, length in NUMBER_LISTS.items():
        for value in _values_at(gltf, place, path):
            _expect(_is_numbers(value, length), path, f"{length or 'some'} numbers in '{place}'", value)
    for place, name in REFERENCES.items():
        for value in _values_at(gltf, place, path):
            count = len(gltf.get(name, ()))
            _expect(_is_index(value) and value < count, path, f"'{place}' to be one of {count} {name}", value)
    for primitive in _values_at(gltf, "meshes [] primitives []", path):
        _check_primitive(gltf, primitive, path)


def _check_version(gltf: dict[str, Any], path: Path) -> None:
    asset = gltf.get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if not str(version).startswith("2."):
        raise InputError(f"{path}: expected glTF version 2.0, found {version}; export it again as glTF 2.0")


def _check_extensions(gltf: dict[str, Any], path: Path) -> None:
    for name in _values_at(gltf, "extensionsRequired []", path):
        if str(name) in COMPRESSION_EXTENSIONS:
            raise InputError(
                f"{path}: expected plain vertex data, found {name}; export without compression (Blender: untick "
                "'Compression'; gltf-transform: 'copy' after removing it)"
            )
        if str(name) in IMAGE_EXTENSIONS:
            raise InputError(
                f"{path}: expected PNG or JPEG textures, found required {name}; export with such textures "
                "(gltf-transform: 'png' or 'jpeg')"
            )
        if not is_understood(str(name)):
            raise InputError(
                f"{path}: expected no extension that changes the geometry, found required {name}; export without it"
            )


def _check_primitive(gltf: dict[str, Any], primitive: dict[str, Any], path: Path) -> None:
    """Attributes and targets of the right kind, one element for each vertex; indices that can count."""
    attributes, accessors = primitive["attributes"], gltf.get("accessors", [])
    if "POSITION" not in attributes:
        return  # nothing to draw; such a primitive is carried along unread
    count = accessors[attributes["POSITION"]]["count"]
    owners = [(attributes, ATTRIBUTE_TYPES), *((target, MORPH_TARGET_TYPES) for target in primitive.get("targets", []))]
    for name, index, kinds in ((name, index, kinds) for owner, kinds in owners for name, index in owner.items()):
        accessor = accessors[index]
        kind = kinds.get(name.partition("_")[0], accessor["type"])
        found = f"{accessor['count']} {accessor['type']}"
        _expect(found == f"{count} {kind}", path, f"{count} {kind} in {name}", found)
    if "indices" in primitive:
        accessor = accessors[primitive["indices"]]
        good = accessor["componentType"] in INDEX_TYPES and accessor["type"] == "SCALAR"
        _expect(good, path, "unsigned indices", f"{accessor['componentType']} {accessor['type']}")


def _values_at(value: Any, place: str, path: Path) -> Iterator[Any]:
    """Everything at a place of the tree; lists and objects on the way must be lists and objects."""
    step, _, rest = place.partition(" ")
    if step == "[]":
        _expect(isinstance(value, list), path, f"a list before '{place}'", value)
        inner = value
    else:
        _expect(isinstance(value, dict), path, f"an object around '{place}'", value)
        inner = value.values() if step == "{}" else [value[step]] if step in value else []
    for item in inner:
        if rest:
            yield from _values_at(item, rest, path)
        else:
            yield item


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_numbers(value: Any, length: int | None) -> bool:
    return (
        isinstance(value, list)
        and (length is None or len(value) == length)
        and all(isinstance(number, (int, float)) for number in value)
    )


def _expect(good: bool, path: Path, expected: str, found: Any) -> None:
    if not good:
        text = repr(found)
        text = text if len(text) <= 60 else text[:57] + "..."
        raise InputError(f"{path}: expected {expected}, found {text}; the file is damaged, export it again")
