"""FBX 7.4 files in text form, written as the tests need them: a skinned arm, with an animation and blend shapes."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

TICKS = 46186158000
"""Time units of FBX in a second."""
UPPER, LOWER = 1, 3
"""Lengths of the arm's bones, in the file's unit."""


def numbers(values: object) -> str:
    """Write an array of FBX: its length, and the numbers."""
    flat = np.asarray(values).ravel()
    text = ",".join(f"{value:.17g}" for value in flat.tolist())
    return f"*{len(flat)} {{\n a: {text}\n}}"


@dataclass
class FbxFile:
    """Objects and connections of a file, and its axes and unit."""

    unit: float = 1.0
    """Centimetres."""
    up: int = 1
    """Axis that is up: 1 for y, 2 for z."""
    fps: int = 6
    """Time mode; 6 is 30 frames a second, 11 is 24."""
    objects: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=list)

    def add(self, kind: str, number: int, name: str, subtype: str, body: str = "") -> int:
        self.objects.append(f'{kind}: {number}, "{name}", "{subtype}" {{\n{body}\n}}')
        return number

    def link(self, child: int, parent: int, prop: str = "") -> None:
        self.links.append(f'C: "OP",{child},{parent}, "{prop}"' if prop else f'C: "OO",{child},{parent}')

    def model(self, number: int, name: str, subtype: str, parent: int, properties: str = "") -> int:
        """Add a node below another; 0 is the root."""
        self.add("Model", number, f"Model::{name}", subtype, f"Version: 232\nProperties70: {{\n{properties}\n}}")
        self.link(number, parent)
        return number

    def save(self, path: Path) -> Path:
        front = 2 if self.up == 1 else 1
        sign = 1 if self.up == 1 else -1
        newline = "\n"
        path.write_text(
            f"""; FBX 7.4.0 project file
FBXHeaderExtension: {{
 FBXHeaderVersion: 1003
 FBXVersion: 7400
}}
GlobalSettings: {{
 Version: 1000
 Properties70: {{
  P: "UpAxis", "int", "Integer", "",{self.up}
  P: "UpAxisSign", "int", "Integer", "",1
  P: "FrontAxis", "int", "Integer", "",{front}
  P: "FrontAxisSign", "int", "Integer", "",{sign}
  P: "CoordAxis", "int", "Integer", "",0
  P: "CoordAxisSign", "int", "Integer", "",1
  P: "UnitScaleFactor", "double", "Number", "",{self.unit}
  P: "TimeMode", "enum", "", "",{self.fps}
 }}
}}
Objects: {{
{newline.join(self.objects)}
}}
Connections: {{
{newline.join(self.links)}
}}
"""
        )
        return path


def vector(name: str, kind: str, values: object) -> str:
    """Write a property of three numbers."""
    return f'P: "{name}", "{kind}", "", "A",' + ",".join(f"{value:.17g}" for value in np.asarray(values).tolist())


def translation(values: object) -> str:
    return vector("Lcl Translation", "Lcl Translation", values)


def rotation(degrees: object) -> str:
    return vector("Lcl Rotation", "Lcl Rotation", degrees)


def scaling(values: object) -> str:
    return vector("Lcl Scaling", "Lcl Scaling", values)


def arm_points() -> tuple[np.ndarray, np.ndarray]:
    """Points of a square tube along y of length UPPER + LOWER, in three rings, and its sides as polygons of four."""
    ring = np.array([[1, 0, 1], [1, 0, -1], [-1, 0, -1], [-1, 0, 1]]) * 0.25
    points = np.concatenate([ring + [0, height, 0] for height in (0, UPPER, UPPER + LOWER)])
    sides = [
        [4 * level + k, 4 * level + (k + 1) % 4, 4 * level + 4 + (k + 1) % 4, 4 * level + 4 + k]
        for level in (0, 1)
        for k in range(4)
    ]
    return points, np.array(sides)


def arm_weights() -> np.ndarray:
    """Weights of the points on the upper and the lower bone."""
    return np.repeat([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]], 4, axis=0)


def geometry(file: FbxFile, number: int, points: np.ndarray, polygons: np.ndarray, extra: str = "") -> int:
    """Add a mesh; the last corner of a polygon is stored as its complement."""
    corners = np.array(polygons)
    corners[:, -1] = ~corners[:, -1]
    body = f"Vertices: {numbers(points)}\nPolygonVertexIndex: {numbers(corners)}\nGeometryVersion: 124\n{extra}"
    return file.add("Geometry", number, "Geometry::arm", "Mesh", body)


def arm(file: FbxFile | None = None, root: str = "", extra: str = "") -> FbxFile:
    """Return a file with an arm of two bones, at rest along y from the origin.

    Args:
        root: properties of a node above the bones.
        extra: layers of the geometry.
    """
    file = file or FbxFile()
    points, polygons = arm_points()
    geometry(file, 100, points, polygons, extra)
    file.model(200, "skin", "Mesh", 0)
    file.link(100, 200)
    file.model(201, "armature", "Null", 0, root)
    file.model(202, "Upper", "LimbNode", 201)
    file.model(203, "Lower", "LimbNode", 202, translation([0, UPPER, 0]))
    file.add("Deformer", 300, "Deformer::skin", "Skin", "Version: 101\nLink_DeformAcuracy: 50")
    file.link(300, 100)
    for k, bone in enumerate((202, 203)):
        weights = arm_weights()[:, k]
        used = np.flatnonzero(weights)
        bind = np.eye(4)
        bind[1, 3] = UPPER * k
        body = "\n".join(
            (
                f"Version: 100\nIndexes: {numbers(used)}",
                f"Weights: {numbers(weights[used])}",
                f"Transform: {numbers(np.linalg.inv(bind).T)}",
                f"TransformLink: {numbers(bind.T)}",
            )
        )
        file.add("Deformer", 301 + k, "SubDeformer::bone", "Cluster", body)
        file.link(301 + k, 300)
        file.link(bone, 301 + k)
    return file


def material(file: FbxFile, number: int, name: str, color: object, node: int = 200) -> int:
    """Add a material of a diffuse colour to a node."""
    body = f'Version: 102\nShadingModel: "phong"\nProperties70: {{\n{vector("DiffuseColor", "Color", color)}\n}}'
    file.add("Material", number, f"Material::{name}", "", body)
    file.link(number, node)
    return number


def texture(file: FbxFile, number: int, name: str, owner: int) -> int:
    """Add a texture file to the diffuse colour of a material."""
    body = f'Type: "TextureVideoClip"\nFileName: "C:\\elsewhere\\{name}"\nRelativeFilename: "..\\lost\\{name}"'
    file.add("Texture", number, f"Texture::{name}", "", body)
    file.link(number, owner, "DiffuseColor")
    return number


def stack(file: FbxFile, number: int, name: str, seconds: float) -> int:
    """Add an animation; returns its layer."""
    stop = round(seconds * TICKS)
    times = "\n".join(
        f'P: "{key}", "KTime", "Time", "",{value}'
        for key, value in {"LocalStart": 0, "LocalStop": stop, "ReferenceStart": 0, "ReferenceStop": stop}.items()
    )
    file.add("AnimationStack", number, f"AnimStack::{name}", "", f"Properties70: {{\n{times}\n}}")
    file.add("AnimationLayer", number + 1, "AnimLayer::Base", "")
    file.link(number + 1, number)
    return number + 1


def curve(
    file: FbxFile, number: int, layer: int, owner: int, prop: str, channel: str, seconds: list[float], values: object
) -> None:
    """Add a linear curve of one component of a property: `channel` is "d|X", "d|Y", "d|Z" or "d|DeformPercent"."""
    times = [round(second * TICKS) for second in seconds]
    file.add("AnimationCurveNode", number, "AnimCurveNode::", "", "Properties70: {\n}")
    file.link(number, layer)
    file.link(number, owner, prop)
    body = "\n".join(
        (
            "Default: 0\nKeyVer: 4008",
            f"KeyTime: {numbers(times)}",
            f"KeyValueFloat: {numbers(values)}",
            f"KeyAttrFlags: {numbers([4])}",
            f"KeyAttrDataFloat: {numbers([0, 0, 0, 0])}",
            f"KeyAttrRefCount: {numbers([len(times)])}",
        )
    )
    file.add("AnimationCurve", number + 1, "AnimCurve::", "", body)
    file.link(number + 1, number, channel)


def blend_shape(file: FbxFile, number: int, name: str, offsets: dict[int, object], percent: float = 0.0) -> int:
    """Add a blend shape to the arm's mesh; returns the channel that drives it."""
    file.add("Deformer", number, "Deformer::face", "BlendShape", "Version: 100")
    file.link(number, 100)
    body = f"Version: 100\nDeformPercent: {percent}\nFullWeights: {numbers([100.0])}"
    file.add("Deformer", number + 1, f"SubDeformer::face.{name}", "BlendShapeChannel", body)
    file.link(number + 1, number)
    body = f"Version: 100\nIndexes: {numbers(list(offsets))}\nVertices: {numbers(list(offsets.values()))}"
    body += f"\nNormals: {numbers(np.zeros((len(offsets), 3)))}"
    file.add("Geometry", number + 2, f"Geometry::{name}", "Shape", body)
    file.link(number + 2, number + 1)
    return number + 1


TOKEN = re.compile(r'"[^"]*"|[{}:,*]|[^\s"{}:,*]+')
MAGIC = b"Kaydara FBX Binary  \x00\x1a\x00"
FLOATS = {"Vertices", "Weights", "Transform", "TransformLink", "KeyValueFloat", "FullWeights", "Normals"}
"""Nodes whose numbers are real."""
LONG = {"KeyTime"}
PACKED_FROM = 32
"""Numbers from which an array is compressed."""


def as_binary(text: str, version: int = 7400) -> bytes:
    """Return a binary file of version 7.4 with the nodes of a text; comments are left out."""
    tokens = TOKEN.findall(re.sub(r"(?m)^\s*;.*$", "", text))
    out = bytearray(MAGIC + struct.pack("<I", version))
    place = 0
    while place < len(tokens):
        place = _node(tokens, place, out)
    return bytes(out) + bytes(13)


def _node(tokens: list[str], place: int, out: bytearray) -> int:
    """Append a node that begins at a token, with those in it; returns the place after it."""
    name, start = tokens[place], len(out)
    place += 2  # the name and its colon
    values, place = _values(tokens, place, name)
    written = b"".join(values)
    out += bytes(12) + bytes([len(name)]) + name.encode() + written
    if place < len(tokens) and tokens[place] == "{":
        place += 1
        while tokens[place] != "}":
            place = _node(tokens, place, out)
        place += 1
        out += bytes(13)  # an empty node ends the list
    struct.pack_into("<III", out, start, len(out), len(values), len(written))
    return place


def _values(tokens: list[str], place: int, name: str) -> tuple[list[bytes], int]:
    """Read the values of a node up to the next node or brace."""
    if tokens[place] == "*":
        first = place + 5  # * count { a :
        stop = tokens.index("}", first)
        numbers = [word for word in tokens[first:stop] if word != ","]
        return [_array(name, numbers)], stop + 1
    values, expected = [], True
    while place < len(tokens) and tokens[place] not in "{}":
        if tokens[place] == ",":
            place, expected = place + 1, True
        elif expected:
            values.append(_value(tokens[place], name))
            place, expected = place + 1, False
        else:
            break  # the name of the next node
        if expected is False and place + 1 < len(tokens) and tokens[place + 1] == ":" and tokens[place] != ",":
            break
    return values, place


def _value(word: str, name: str) -> bytes:
    """Pack one value: text, a whole number or a real one."""
    if word[0] == '"':
        text = word[1:-1]
        # Text has "class::name" where binary files have the name, two bytes, and the class.
        kind, _, own = text.partition("::")
        packed = (f"{own}\x00\x01{kind}" if "::" in text else text).encode()
        return b"S" + struct.pack("<I", len(packed)) + packed
    number: Any = float(word)
    if re.fullmatch(r"-?\d+", word):
        large = name not in ("Version", "FBXVersion", "FBXHeaderVersion", "KeyVer")
        return (b"L" + struct.pack("<q", int(word))) if large else (b"I" + struct.pack("<i", int(word)))
    return b"D" + struct.pack("<d", number)


def _array(name: str, numbers: list[str]) -> bytes:
    """Pack an array, compressed where it is long."""
    kind, code = ("d", "d") if name in FLOATS else ("l", "q") if name in LONG else ("i", "i")
    values = [float(number) if kind == "d" else int(number) for number in numbers]
    data = struct.pack(f"<{len(values)}{code}", *values)
    packed = zlib.compress(data) if len(values) >= PACKED_FROM else data
    return kind.encode() + struct.pack("<III", len(values), packed is not data, len(packed)) + packed
