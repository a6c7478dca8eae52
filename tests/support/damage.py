"""Damage files at random: bytes, numbers and words of text, values of JSON, members of archives.

A change takes the content of a file and a generator. Those of containers (.glb, .npz, .usdz) damage one part and keep
the lengths around it right, as a file with a wrong length is refused before the part is read.
"""

from __future__ import annotations

import copy
import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from random import Random
from typing import Any

from gltf_samples import pack_glb

Change = Callable[[bytes, Random], bytes]
WHOLE = (0, 1, -1, 127, 255, 32767, 65535, 65536, 2**31 - 1, -(2**31))
"""Whole numbers at which types and counts end."""
FLOATS = (float("nan"), float("inf"), -float("inf"), -0.0, 1e30, -1e38, 1e-38)
PACKED = [struct.pack(f"{order}i", number) for order in "<>" for number in WHOLE]
PACKED += [struct.pack(f"{order}{kind}", number) for order in "<>" for kind in "fd" for number in FLOATS]
NUMBERS = (
    "0", "-0", "1", "-1", "65536", "2147483647", "4294967296", "99999999999999999999", "1e-9", "1e30", "1e39", "1e309",
    "5e-324", "nan", "-inf", "0x10", "1_0", ".", "1e", "\u0661", "9" * 400, "1/2/3", "1//", "-3//-3",
)  # fmt: skip
"""Numbers in text, and what looks like one."""
TEXTS = ("", " ", "\x00", "\ud800", "Größe 大小", "../../x", "a" * 3000, "NaN", "None", "\\", "%s", '"')


def some_bytes(data: bytes, rng: Random) -> bytes:
    """Change, fill, remove or repeat bytes, write a number of a type at any place, or cut the file there."""
    out, place, length = bytearray(data), rng.randrange(len(data) + 1), 1 << rng.randrange(8)
    kind = rng.randrange(6)
    if kind == 0:
        out[place : place + 1] = rng.randbytes(1)
    elif kind == 1:
        out[place : place + length] = rng.choice((b"\0", b"\xff", b"\x80", b"\n", b"#", b'"')) * length
    elif kind == 2:
        del out[place : place + length]
    elif kind == 3:
        out[place:place] = out[place : place + length]
    elif kind == 4:
        number = rng.choice(PACKED)
        out[place : place + len(number)] = number
    else:
        del out[place:]
    return bytes(out)


def some_text(data: bytes, rng: Random) -> bytes:
    """Replace a number or a word; remove, repeat or move lines; at times change bytes."""
    kind, words = rng.randrange(8), list(re.finditer(rb"[^\s,()\[\]{}]+", data))
    if kind == 0 or not words:
        return some_bytes(data, rng)
    if kind <= 2:
        lines = data.split(b"\n")
        place, start, count = rng.randrange(len(lines)), rng.randrange(len(lines)), 1 << rng.randrange(4)
        lines[place : place + rng.choice((0, count))] = lines[start : start + count] * rng.choice((0, 1, 30))
        return b"\n".join(lines)
    word = rng.choice(words)
    new: bytes = rng.choice(NUMBERS if re.search(rb"\d", word.group()) else TEXTS).encode("utf-8", "surrogatepass")
    new = rng.choice(words).group() if kind == 3 else new
    return data[: word.start()] + new + data[word.end() :]


def some_json(data: bytes, rng: Random) -> bytes:
    """Change one value of a JSON document: its number, type, key or place; at times its text."""
    if rng.random() < 0.1:
        return some_text(data, rng)
    try:
        root = json.loads(data)
    except ValueError:  # damaged before
        return some_text(data, rng)
    places, stack = [], [root]
    while stack:
        holder: Any = stack.pop()
        if isinstance(holder, dict | list):
            places += [(holder, key) for key in (holder if isinstance(holder, dict) else range(len(holder)))]
            stack += holder.values() if isinstance(holder, dict) else holder
    holder, key = rng.choice(places)
    value, kind = holder[key], rng.randrange(4)
    if kind == 0:
        del holder[key]
    elif kind == 1:
        other, name = rng.choice(places)
        holder[key] = copy.deepcopy(other[name])
    elif kind == 2 or not isinstance(value, str | float | int):
        holder[key] = rng.choice((None, True, [], {}, "x", 0, -1, 0.5, [value], {"0": value}))
    else:
        holder[key] = rng.choice(TEXTS if isinstance(value, str) else (*WHOLE, *FLOATS, value + 1, 10**400))
    return json.dumps(root).encode()


def some_glb(data: bytes, rng: Random) -> bytes:
    """Change the JSON or the binary chunk of a .glb; at times the whole file."""
    size = struct.unpack_from("<I", data, 12)[0] if len(data) > 20 else 0
    text, binary = data[20 : 20 + size], data[28 + size :]
    try:
        if rng.random() < 0.3:
            return pack_glb(json.loads(text), some_bytes(binary, rng)[: len(binary)].ljust(len(binary), b"\0"))
        return pack_glb(json.loads(some_json(text, rng)), binary)
    except ValueError:  # no JSON, now or before
        return some_bytes(data, rng)


def some_npy(data: bytes, rng: Random) -> bytes:
    """Change the text of the header of a .npy, or any bytes."""
    if rng.random() < 0.3 or len(data) < 10:
        return some_bytes(data, rng)
    size = struct.unpack_from("<H", data, 8)[0]
    types = rb"'<f4' '>f8' '<f2' '<i8' '|O' '<U3' '<c16' '<M8[s]' '|V0' '|b1' ('<f4',(3,)) [('a','<f4')]".split()
    head = re.sub(rb"(?<='descr': )'[^']*'", lambda found: rng.choice((found.group(), *types)), data[10 : 10 + size])
    head = some_text(head, rng)[:60000]
    return data[:8] + struct.pack("<H", len(head)) + head + data[10 + size :]


def some_zip(data: bytes, rng: Random) -> bytes:
    """Change, swap or remove a member of a .npz or .usdz; at times the bytes of the archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # what zipfile raises for an archive that was damaged before
        return some_bytes(data, rng)
    if rng.random() < 0.15 or not members:
        return some_bytes(data, rng)
    name, other = rng.choice(list(members)), rng.choice(list(members))
    change = some_npy if name.endswith(".npy") else some_bytes
    members[name] = members[other] if rng.random() < 0.1 else change(members[name], rng)
    if rng.random() < 0.1:
        del members[other]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            info = zipfile.ZipInfo(name)
            filled = -(file.tell() + 34 + len(name.encode())) % 64  # contents at multiples of 64 bytes, as USD has them
            info.extra = struct.pack("<HH", 0x1986, filled) + bytes(filled)
            archive.writestr(info, content)
    return file.getvalue()
