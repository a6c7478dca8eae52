"""Checks the JSON of a glTF document before any of it is used: version, extensions, types, references and sizes.

The tables name locations in the JSON tree: `[]` stands for each item of a list, `{}` for each value of an object; a
location that a file does not have is skipped. After `check_document`, the reader uses indices without further checks.
Numbers in comments are sections of the glTF 2.0 specification; the tables follow 5 Properties Reference.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...core.budgets import DEPTH, FACES, JOINTS, MORPHED, SHOWN, VERTICES
from ...core.errors import InputError, damaged

COMPONENT_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy dtype of each `componentType` (3.6.2.2 Accessor Data Types); buffers are little endian."""
COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Components of an element of each accessor `type` (3.6.2.2)."""

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
"""Values of `bufferView.target`: vertex attributes and indices (5.11 Buffer View)."""

TEXTURE_TRANSFORM = "extensions KHR_texture_transform"
SPECULAR_GLOSSINESS = "extensions KHR_materials_pbrSpecularGlossiness"

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
COMPRESSION_EXTENSIONS = {DRACO, *MESHOPT}
"""Compressed vertex data. Where it is not required, the file has uncompressed data too, which is read instead."""
DRACO_OBJECT = f"meshes [] primitives [] extensions {DRACO}"
MESHOPT_OBJECTS = tuple(f"bufferViews [] extensions {name}" for name in MESHOPT)

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
    DRACO_OBJECT: ("bufferView", "attributes"),
    **dict.fromkeys(MESHOPT_OBJECTS, ("buffer", "byteLength", "byteStride", "count", "mode")),
}
"""Properties that objects must have."""

NON_NEGATIVE_INTEGERS = {
    "accessors []": "componentType count byteOffset",
    "accessors [] sparse": "count",
    "accessors [] sparse indices": "byteOffset componentType",
    "accessors [] sparse values": "byteOffset",
    "bufferViews []": "byteOffset byteLength byteStride",
    "buffers []": "byteLength",
    "meshes [] primitives []": "mode",
    f"{DRACO_OBJECT} attributes": "{}",
    **dict.fromkeys(MESHOPT_OBJECTS, "byteOffset byteLength byteStride count"),
}
"""Integers of 0 or more: the locations that have them, and their names there."""

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
"""Locations of lists of numbers, with their length; None for any."""

STRINGS = (
    "extensionsUsed []",
    "extensionsRequired []",
    "accessors [] type",
    "buffers [] uri",
    "images [] uri",
    "nodes [] name",
    "meshes [] name",
    "materials [] name",
    *(f"{place} {key}" for place in MESHOPT_OBJECTS for key in ("mode", "filter")),
)
"""Locations of strings."""

_EXTENDED = ("textures []", "materials []", "materials [] pbrMetallicRoughness baseColorTexture")
OBJECTS = (
    "animations []",
    *(f"{place} extensions{each}" for place in _EXTENDED for each in ("", " {}")),
    "meshes [] primitives [] extensions",
    "bufferViews [] extensions",
)
"""Locations of JSON objects that the reader looks into, besides those above."""

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
    f"{DRACO_OBJECT} bufferView": "bufferViews",
    **{f"{place} buffer": "buffers" for place in MESHOPT_OBJECTS},
}
"""Locations of indices, with the top-level list that they point into (3.3 Indices and Names)."""

IMAGE_EXTENSIONS = {"KHR_texture_basisu"}
"""Image formats that are not supported. Where they are not required, the file has PNG or JPEG too."""

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
"""First characters of the names of extensions that describe appearance only and refer to no accessors."""

ANIMATION_POINTER = "KHR_animation_pointer"
SUPPORTED_EXTENSIONS = ("KHR_mesh_quantization", ANIMATION_POINTER, *COMPRESSION_EXTENSIONS)
"""Quantized and compressed attributes are read. Animation pointers are not: they stay in a file with its animations, or
are dropped with all of them, so they cannot dangle in a written file."""

ATTRIBUTE_TYPES = {
    "POSITION": "VEC3",
    "NORMAL": "VEC3",
    "TANGENT": "VEC4",
    "TEXCOORD": "VEC2",
    "JOINTS": "VEC4",
    "WEIGHTS": "VEC4",
    "COLOR": "VEC4",
}
"""Accessor type of each attribute by its name before the underscore (3.7.2.1); colours may also be VEC3."""
MORPH_TARGET_TYPES = {"POSITION": "VEC3", "NORMAL": "VEC3", "TANGENT": "VEC3"}
"""Accessor type of each attribute that a morph target may have (3.7.2.2 Morph Targets)."""
INDEX_TYPES = (5121, 5123, 5125)
"""Component types of indices, those of sparse accessors included: unsigned byte, short, int (5.24, 3.6.2.3)."""

LARGEST = 3.4e38
"""Largest number in the JSON: about that of float32. Python's reader takes NaN and infinity, which JSON has not."""


def is_supported(extension: str) -> bool:
    """Return whether a file with this extension is read correctly and its accessors can be renumbered on writing."""
    return extension in SUPPORTED_EXTENSIONS or extension.startswith(APPEARANCE_PREFIXES)


def check_document(gltf: Any, path: Path) -> None:
    """Check the JSON of a glTF file.

    Raises:
        InputError: not glTF 2, a required extension that is not supported, or a missing, mistyped or dangling entry.
    """
    if not isinstance(gltf, dict):
        raise InputError(
            f"{path}: expected a JSON object, found {type(gltf).__name__}; export the file again as glTF 2.0"
        )
    if isinstance(gltf.get("nodes"), list):
        JOINTS.check(len(gltf["nodes"]), path)
    # A reader of 2.0 may open any later 2.x: minor versions are compatible (3.2 Asset).
    asset = gltf.get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if not str(version).startswith("2."):
        raise InputError(f"{path}: expected glTF version 2.0, found {version}; export it again as glTF 2.0")
    for name in _values_at(gltf, "extensionsRequired []", path):  # 3.12 Specifying Extensions
        if str(name) in IMAGE_EXTENSIONS:
            raise InputError(
                f"{path}: expected PNG or JPEG textures, found required {name}; export with such textures "
                "(gltf-transform: 'png' or 'jpeg')"
            )
        if not is_supported(str(name)):
            raise InputError(
                f"{path}: expected no extension that changes the geometry, found required {name}; export without it"
            )
    # In this order: required properties first, so that the checks after them need not ask whether these are there.
    for location, names in REQUIRED.items():
        for item in _values_at(gltf, location, path):
            for name in names:
                _expect(isinstance(item, dict) and name in item, path, f"'{name}' in each of '{location}'", item)
    for locations, fits, kind in (
        ([f"{at} {key}" for at, keys in NON_NEGATIVE_INTEGERS.items() for key in keys.split()], _is_index, "a count"),
        (STRINGS, lambda value: isinstance(value, str), "text"),
        (OBJECTS, lambda value: isinstance(value, dict), "an object"),
    ):
        for location in locations:
            for value in _values_at(gltf, location, path):
                _expect(fits(value), path, f"{kind} in '{location}'", value)
    for location, length in NUMBER_LISTS.items():
        for value in _values_at(gltf, location, path):
            _expect(_is_numbers(value, length), path, f"{length or 'some'} numbers in '{location}'", value)
    for location, name in REFERENCES.items():
        for value in _values_at(gltf, location, path):
            count = len(gltf.get(name, ()))
            _expect(_is_index(value) and value < count, path, f"'{location}' to be one of {count} {name}", value)
    for primitive in _values_at(gltf, "meshes [] primitives []", path):
        _check_primitive(gltf, primitive, path)


def check_sizes(gltf: dict[str, Any], size: int, path: Path) -> None:
    """Check the numbers of vertices, triangles and morph targets that nodes show, each as often as shown."""
    nodes, accessors = gltf.get("nodes", []), gltf.get("accessors", [])
    # How many nodes are below each other; loops are reported by those who walk the tree.
    below = {child for node in nodes for child in node.get("children", [])}
    reached, level, depth = set(range(len(nodes))) - below, set(range(len(nodes))) - below, 0
    while level:
        depth += 1
        level = {child for index in level for child in nodes[index].get("children", [])} - reached
        reached |= level
    DEPTH.check(depth, path)
    parts = corners = morphed = 0
    for mesh, shown in Counter(node["mesh"] for node in nodes if "mesh" in node).items():
        deformed = set()  # primitives with the same vertices, one for each material, are deformed once
        for primitive in gltf["meshes"][mesh]["primitives"]:
            if "POSITION" not in primitive["attributes"]:
                continue
            position, targets = primitive["attributes"]["POSITION"], primitive.get("targets", [])
            count = accessors[position]["count"]
            indexed = accessors[primitive["indices"]]["count"] if "indices" in primitive else count
            VERTICES.check(count, path)
            parts += shown
            # Strips and fans have up to one triangle for each index, lists a third.
            corners += shown * indexed * (1 if primitive.get("mode", 4) == 4 else 3)
            key = (position, tuple(target.get("POSITION") for target in targets))
            morphed += shown * count * len(targets) if key not in deformed else 0
            deformed.add(key)
    SHOWN.check(parts, path)
    FACES.check(corners // 3, path)
    MORPHED.check(morphed, path, size)


def element_size(accessor: dict[str, Any], index: int, path: Path) -> int:
    """Return the bytes of one element; columns of matrices start at multiples of 4 bytes (3.6.2.4 Data Alignment)."""
    component, kind = accessor["componentType"], accessor["type"]
    if component not in COMPONENT_TYPES or kind not in COMPONENT_COUNTS:
        raise damaged(path, f"a glTF 2.0 type in accessor {index}", f"{component} {kind}")
    width = np.dtype(COMPONENT_TYPES[component]).itemsize
    if not kind.startswith("MAT"):
        return COMPONENT_COUNTS[kind] * width
    columns = int(kind[3])
    return columns * (columns * width + -columns * width % 4)


def list_primitives(gltf: dict[str, Any]) -> list[dict[str, Any]]:
    """List the primitives of all meshes."""
    return [primitive for mesh in gltf.get("meshes", []) for primitive in mesh["primitives"]]


def _check_primitive(gltf: dict[str, Any], primitive: dict[str, Any], path: Path) -> None:
    """Check the types of a primitive's attributes, morph targets and indices, and that attributes have one count."""
    attributes, accessors = primitive["attributes"], gltf.get("accessors", [])
    if "POSITION" not in attributes:
        return  # nothing to draw without positions (3.7.2.1); the primitive is copied unread
    count = accessors[attributes["POSITION"]]["count"]
    owners = [(attributes, ATTRIBUTE_TYPES), *((target, MORPH_TARGET_TYPES) for target in primitive.get("targets", []))]
    for name, index, kinds in ((name, index, kinds) for owner, kinds in owners for name, index in owner.items()):
        accessor = accessors[index]
        kind = kinds.get(name.partition("_")[0], accessor["type"])
        kind = "VEC3" if name.startswith("COLOR_") and accessor["type"] == "VEC3" else kind
        found = f"{accessor['count']} {accessor['type']}"
        _expect(found == f"{count} {kind}", path, f"{count} {kind} in {name}", found)
    if "indices" in primitive:
        accessor = accessors[primitive["indices"]]
        good = accessor["componentType"] in INDEX_TYPES and accessor["type"] == "SCALAR"
        _expect(good, path, "unsigned indices", f"{accessor['componentType']} {accessor['type']}")


def _values_at(value: Any, location: str, path: Path) -> Iterator[Any]:
    step, _, rest = location.partition(" ")
    if step == "[]":
        _expect(isinstance(value, list), path, f"a list before '{location}'", value)
        inner = value
    else:
        _expect(isinstance(value, dict), path, f"an object around '{location}'", value)
        inner = value.values() if step == "{}" else [value[step]] if step in value else []
    for item in inner:
        if rest:
            yield from _values_at(item, rest, path)
        else:
            yield item


def _is_index(value: Any) -> bool:
    # A bool is an int in Python, but not in JSON.
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_numbers(value: Any, length: int | None) -> bool:
    return (
        isinstance(value, list)
        and (length is None or len(value) == length)
        and all(isinstance(number, (int, float)) and abs(number) <= LARGEST for number in value)
    )


def _expect(good: bool, path: Path, expected: str, found: Any) -> None:
    if not good:
        text = repr(found)
        text = text if len(text) <= 60 else text[:57] + "..."
        raise damaged(path, expected, text)
