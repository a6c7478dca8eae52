"""Damage files at random: bytes, numbers and words of text, values of JSON, members of archives, opcodes of pickles.

A mutation takes the content of a file, a generator and the contents of all seeds of its format, and returns a content.
Those of containers (.glb, .zip, .npy, .ply, ONNX) damage one part and keep the lengths around it right, as a file with
a wrong length is refused before the part is read.
"""

from __future__ import annotations

import contextlib
import copy
import io
import json
import pickletools
import re
import struct
import warnings
import zipfile
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

from gltf_samples import pack_glb

Mutation = Callable[[bytes, Random, Sequence[bytes]], bytes]
WHOLE = (0, 1, -1, 2, 3, 127, 128, 255, 256, 32767, 65535, 65536, 2**31 - 1, -(2**31), 2**32 - 1, 2**53, 2**63 - 1)
"""Whole numbers at which types and counts end."""
NUMBERS = (
    "0", "-0", "1", "-1", "2", "255", "65536", "2147483647", "-2147483648", "4294967296", "99999999999999999999", "1e9",
    "1e-9", "1e18", "1e30", "1e39", "1e300", "1e309", "-1e309", "5e-324", "1e-400", "nan", "inf", "-inf", "0x10", "1_0",
    "1.5", ".", "+", "-", "1e", "\u0661", "9" * 400, "0" * 400 + "1", "1/2/3", "1//", "-3//-3",
)  # fmt: skip
"""Numbers in text, and what looks like one."""
TEXTS = (
    "", " ", "a", "\x00", "\ud800", "Größe 大小", "../../x", "a" * 3000, "NaN", "None", "__class__", "\\", "%s", '"',
)  # fmt: skip
ODD_BYTES = (b"\x00", b"\xff", b"\x7f", b"\x80", b"\n", b"\r", b"#", b"\\", b"{", b"}", b'"', b" ")
PACKED = ("<i", ">i", "<I", ">I", "<q", "<h", ">h", "<b")
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 1e30, -1e38, 1e-38, 1.0, 1e18)
MOST = 1 << 16
"""Bytes from which a content is not made longer."""


def some_bytes(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Change, insert, remove, repeat or move bytes, or write a number of a type at any place."""
    if not data:
        return rng.choice(ODD_BYTES)
    out, place, length = bytearray(data), rng.randrange(len(data)), min(1 << rng.randrange(8), len(data))
    kind = rng.randrange(10)
    if kind == 0:
        out[place] ^= 1 << rng.randrange(8)
    elif kind == 1:
        out[place] = rng.randrange(256)
    elif kind == 2:
        out[place : place + length] = rng.choice(ODD_BYTES) * len(out[place : place + length])
    elif kind == 3:
        del out[place : place + length]
    elif kind == 4 and len(data) < MOST:
        out[place:place] = out[place : place + length] if rng.random() < 0.5 else rng.randbytes(length)
    elif kind == 5:
        start = rng.randrange(len(data))
        out[place : place + length] = data[start : start + length]
    elif kind == 6:
        kind_of_number = rng.choice(PACKED)
        size = struct.calcsize(kind_of_number)
        number = rng.choice(WHOLE) & (256**size - 1)
        order = "big" if kind_of_number[0] == ">" else "little"
        out[place : place + size] = number.to_bytes(size, order)
    elif kind == 7:
        packed = struct.pack(rng.choice(("<f", ">f", "<d")), rng.choice(FLOATS))
        out[place : place + len(packed)] = packed
    elif kind == 8:
        del out[place:]
    else:
        other = rng.choice(seeds)
        out[place:] = other[rng.randrange(len(other) + 1) :]
    return bytes(out)


def some_text(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Replace, swap, repeat or remove numbers, words or lines; at times bytes."""
    kind = rng.randrange(10)
    if kind == 9 or not data:
        return some_bytes(data, rng, seeds)
    if kind in (6, 7):
        return _lines(data, rng, rng.choice(seeds))
    pattern = rb"[-+.\w]*\d[-+.\w]*" if kind < 3 else rb"[^\s,()\[\]{}]+"
    found = list(re.finditer(pattern, data))
    if not found:
        return some_bytes(data, rng, seeds)
    first, second = rng.choice(found), rng.choice(found)
    if kind < 3:
        new = rng.choice(NUMBERS).encode()
    elif kind == 3:
        new = b"" if rng.random() < 0.5 else first.group() + b" " + first.group()
    elif kind == 4:
        new = rng.choice(TEXTS).encode("utf-8", "surrogatepass")
    elif kind == 5:
        words = re.findall(pattern, rng.choice(seeds)) or [b""]
        new = rng.choice(words)
    else:
        new = second.group()
    return data[: first.start()] + new + data[first.end() :]


def _lines(data: bytes, rng: Random, other: bytes) -> bytes:
    """Remove, repeat, move or swap lines, or take some of another file."""
    lines, others = data.split(b"\n"), other.split(b"\n")
    place, kind = rng.randrange(len(lines)), rng.randrange(5)
    count = min(1 << rng.randrange(4), len(lines))
    if kind == 0:
        del lines[place : place + count]
    elif kind == 1 and len(data) < MOST:
        lines[place:place] = lines[place : place + count] * rng.choice((1, 1, 30))
    elif kind == 2:
        start = rng.randrange(len(lines))
        lines[place : place + count], lines[start : start + 1] = lines[start : start + 1], lines[place : place + count]
    elif kind == 3:
        start = rng.randrange(len(others))
        lines[place:place] = others[start : start + count]
    else:
        del lines[place:]
    return b"\n".join(lines)


def some_json(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Change values of a JSON document; at times its text."""
    if rng.random() < 0.1:
        return some_text(data, rng, seeds)
    try:
        root = json.loads(data)
    except (ValueError, RecursionError):
        return some_text(data, rng, seeds)
    return json.dumps(changed_json(root, rng)).encode()


def changed_json(root: Any, rng: Random) -> Any:
    """Change one value of a JSON document, which may be changed in place: its number, type, key or place."""
    places = list(_places(root))
    if not places:
        return rng.choice((root, [], {}, None, 0))
    holder, key = rng.choice(places)
    value, kind = holder[key], rng.randrange(10)
    if kind == 0:
        del holder[key]
    elif kind == 1:
        other, name = rng.choice(places)
        holder[key] = copy.deepcopy(other[name])
    elif kind == 2:
        holder[key] = rng.choice((None, True, [], {}, "", "x", 0, -1, [[]], {"a": 1}, [value], {"0": value}))
    elif kind == 3 and isinstance(holder, list):
        holder[key:key] = [copy.deepcopy(value)] * rng.choice((1, 2, 50))
    elif kind == 4 and isinstance(holder, dict):
        holder[rng.choice((*TEXTS, "extensions", "extras", "uri", "mode", "matrix"))] = holder.pop(key)
    elif isinstance(value, str):
        holder[key] = rng.choice((*TEXTS, value + value, value[:-1]))
    elif isinstance(value, float | int):
        small = (value + 1, value - 1, -value, value * 2, value * 0.3 if abs(value) < 1e300 else 7)
        holder[key] = rng.choice((*WHOLE, *small, *small, 0.5, 1e30, 1e300, -1e300, 10**400, float("nan")))
    elif isinstance(value, list):
        rng.shuffle(value)
    elif isinstance(value, dict) and value:
        value.pop(rng.choice(list(value)))
    return root


def _places(root: Any) -> list[tuple[Any, Any]]:
    """List all values of a JSON document as (list or dictionary, key)."""
    places, stack = [], [root]
    while stack:
        holder = stack.pop()
        if isinstance(holder, dict | list):
            keys = list(holder) if isinstance(holder, dict) else range(len(holder))
            places += [(holder, key) for key in keys]
            stack += [holder[key] for key in keys]
    return places


def some_glb(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Change the JSON or the binary chunk of a .glb; at times the whole file."""
    if rng.random() < 0.1 or len(data) < 20:
        return some_bytes(data, rng, seeds)
    size = struct.unpack_from("<I", data, 12)[0]
    text, binary = data[20 : 20 + size], data[28 + size :]
    if rng.random() < 0.3 and binary:
        changed = some_bytes(binary, rng, seeds)
        binary = changed[: len(binary)].ljust(len(binary), b"\0") if rng.random() < 0.8 else changed
        with contextlib.suppress(ValueError):
            return pack_glb(json.loads(text), binary)
    try:
        return pack_glb(changed_json(json.loads(text), rng), binary)
    except (ValueError, UnicodeError):  # the JSON was damaged before
        return some_bytes(data, rng, seeds)


def some_npy(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Change the text of the header of a .npy, its numbers, or any bytes."""
    kind = rng.randrange(4)
    if kind == 0 or len(data) < 10 or data[6] != 1:
        return some_bytes(data, rng, seeds)
    size = struct.unpack_from("<H", data, 8)[0]
    head, numbers = data[10 : 10 + size], data[10 + size :]
    if kind == 1:
        numbers = some_bytes(numbers, rng, seeds) if numbers else b"\0"
    elif kind == 2:
        types = (b"'<f4'", b"'>f8'", b"'<f2'", b"'<i8'", b"'<u1'", b"'|O'", b"'<U3'", b"'<c16'", b"'<f16'", b"'<M8[s]'")
        types += (b"[('a', '<f4')]", b"'|V0'", b"'|b1'", b"('<f4', (3,))")
        head = re.sub(rb"(?<='descr': )'[^']*'", lambda _: rng.choice(types), head)
        head = head.replace(b"False", rng.choice((b"True", b"False", b"None")))
    else:
        head = some_text(head, rng, [head])[:60000]
    return data[:8] + struct.pack("<H", len(head)) + head + numbers


def some_zip(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Change, rename, remove, repeat or compress a member of a .npz or .usdz; at times the bytes of the archive."""
    try:
        if rng.random() < 0.15:
            raise ValueError
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(name, archive.read(name)) for name in archive.namelist()]
    except Exception:  # what zipfile raises for an archive that was damaged before
        return some_bytes(data, rng, seeds)
    if not members:
        return some_bytes(data, rng, seeds)
    place, kind = rng.randrange(len(members)), rng.randrange(12)
    name, content = members[place]
    if kind == 0:
        del members[place]
    elif kind == 1:
        members.append((name, rng.choice(members)[1]))
    elif kind == 2:
        members[place] = (rng.choice((*TEXTS[1:3], rng.choice(members)[0], "poses.npy", "vertices.npy")), content)
    elif kind == 3:
        members[place] = (name, rng.choice(members)[1])
    else:
        change = some_npy if name.endswith(".npy") else some_text if name.endswith(".usda") else some_bytes
        members[place] = (name, change(content, rng, [entry for _, entry in members]))
    return packed_zip(members, zipfile.ZIP_DEFLATED if rng.random() < 0.1 else zipfile.ZIP_STORED)


def packed_zip(members: list[tuple[str, bytes]], method: int = zipfile.ZIP_STORED) -> bytes:
    """Pack an archive whose contents begin at multiples of 64 bytes, as USD wants them."""
    file = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w", method) as archive:
        warnings.simplefilter("ignore")  # two members of one name
        for name, content in members:
            info = zipfile.ZipInfo(name)
            info.compress_type = method
            filled = -(file.tell() + 30 + len(name.encode()) + 4) % 64
            info.extra = struct.pack("<HH", 0x1986, filled) + bytes(filled)
            archive.writestr(info, content)
    return file.getvalue()


def some_ply(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Change the header or the rows of a binary PLY file."""
    head, end, rows = data.partition(b"end_header\n")
    if rng.random() < 0.5:
        return some_text(head, rng, [seed.partition(b"end_header\n")[0] for seed in seeds]) + end + rows
    return head + end + some_bytes(rows, rng, [rows]) if rng.random() < 0.9 else some_bytes(data, rng, seeds)


def some_pickle(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Remove, repeat, swap or replace opcodes of a pickle, or change bytes."""
    kind = rng.randrange(5)
    try:
        starts = [place for _, _, place in pickletools.genops(data) if place is not None]
    except Exception:  # what pickletools raises for a pickle that was damaged before
        return some_bytes(data, rng, seeds)
    if kind == 0 or len(starts) < 3:
        return some_bytes(data, rng, seeds)
    first, second = (rng.randrange(len(starts) - 1) for _ in range(2))
    code, other = (data[starts[k] : starts[k + 1]] for k in (first, second))
    before, after = data[: starts[first]], data[starts[first + 1] :]
    if kind == 1:
        return before + after
    if kind == 2:
        return before + other + after
    if kind == 3:
        return before + code * rng.choice((2, 2, 40)) + after
    return before + rng.choice([opcode.code.encode("latin1") for opcode in pickletools.opcodes]) + code[1:] + after


def some_network(data: bytes, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Change the metadata of an ONNX network, or its bytes."""
    import onnx

    if rng.random() < 0.4:
        return some_bytes(data, rng, seeds)
    try:
        network = onnx.load_model_from_string(data)
    except Exception:  # what protobuf raises for a network that was damaged before
        return some_bytes(data, rng, seeds)
    for entry in network.metadata_props:
        value = entry.value if isinstance(entry.value, bytes) else entry.value.encode()  # bytes that are no UTF-8
        entry.value = some_json(value, rng, [value]).decode("utf-8", "replace")
    return network.SerializeToString()


def mutated(data: bytes, mutation: Mutation, rng: Random, seeds: Sequence[bytes]) -> bytes:
    """Apply a mutation one to four times."""
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        data = mutation(data, rng, seeds)
    return data
