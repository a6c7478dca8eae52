"""Convert FBX files in text form to binary ones, which most programs write."""

from __future__ import annotations

import re
import struct
import zlib
from typing import Any

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
