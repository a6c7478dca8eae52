"""Small hostile files: each is refused with one line, at once and before memory is allocated."""

from __future__ import annotations

import io
import json
import struct
import threading
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

import mimesh.io.gltf  # noqa: F401 (imported before memory is traced)
from mimesh.__main__ import run
from mimesh.core import budgets
from mimesh.core.budgets import FRAMES, VERTICES, no_limits
from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh

MEMORY = 300 << 20
"""Bytes that a refusal may allocate at most; most allocate less than one thousandth."""
SECONDS = 10.0
"""CPU time of reading a file twice; most take less than one thousandth."""
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4").tobytes()
CORNERS = np.array([0, 1, 2, 0, 2, 3], "<u2").tobytes()


def array(shape: str, dtype: str = "<f4", data: bytes = b"") -> bytes:
    """Make a .npy file whose header has any text as its shape."""
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def archive(**arrays: bytes) -> bytes:
    """Make a compressed .npz file."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as target:
        for name, content in arrays.items():
            target.writestr(f"{name}.npy", content)
    return file.getvalue()


def zeros_archive(blocks: int) -> bytes:
    """Make a .npz file of so many blocks of 4 MiB of zeros, without holding them in memory."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as target, target.open("vertices.npy", "w") as member:
        member.write(array(f"({blocks * 349525}, 3)"))
        for _ in range(blocks):
            member.write(bytes(1 << 22))
    return file.getvalue()


def glb(nodes: list[dict], **changes) -> bytes:
    """Make a .glb of a tetrahedron without a base, with any nodes and other entries."""
    gltf = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 60}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": nodes,
    }
    text = json.dumps(gltf | changes).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", 60, 0x004E4942) + POINTS + CORNERS
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def sparse(count: int) -> bytes:
    """Make a .glb whose positions are so many zeros, of which four are replaced."""
    values = {"count": 4, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 0}}
    positions = {"componentType": 5126, "count": count, "type": "VEC3", "sparse": values}
    corners = {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}
    return glb([{"mesh": 0}], accessors=[positions, corners])


def chain(depth: int) -> bytes:
    """Make a .glb of nodes one below the other."""
    return glb([*({"children": [k + 1]} for k in range(depth - 1)), {"mesh": 0}], scenes=[{"nodes": [0]}])


def shown(times: int) -> bytes:
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    return glb([{"mesh": 0}] * (times // 100), meshes=[{"primitives": [primitive] * 100}])


def morphed(targets: int) -> bytes:
    """Make a .glb of morph targets of a million vertices each, all zeros."""
    zeros = {"componentType": 5126, "count": 1_000_000, "type": "VEC3"}
    primitive = {"attributes": {"POSITION": 0}, "targets": [{"POSITION": 0}] * targets}
    return glb([{"mesh": 0}], accessors=[zeros], meshes=[{"primitives": [primitive]}])


def ply(elements: str, body: bytes) -> bytes:
    return f"ply\nformat binary_little_endian 1.0\n{elements}end_header\n".encode() + body


XYZ = "property float x\nproperty float y\nproperty float z\n"


def bvh(joints: str, frames: int, frame_time: str = "0.04", channels: str = "1 Xrotation", rows: str = "") -> bytes:
    head = f"HIERARCHY\nROOT Hips\n{{\nOFFSET 0 0 0\nCHANNELS {channels}\n{joints}}}\n"
    return (head + f"MOTION\nFrames: {frames}\nFrame Time: {frame_time}\n" + (rows or "0\n" * frames)).encode()


def pc2(points: int, frames: int) -> bytes:
    return struct.pack("<12siiffi", b"POINTCACHE2\0", 1, points, 0.0, 1.0, frames)


def obj(faces: str) -> bytes:
    return f"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n{faces}\n".encode()


TRIANGLE = np.eye(3, dtype="<f4").tobytes()
REFUSED = {
    # Claims of more than the file has.
    "claim.npz": (lambda: archive(vertices=array("(1700000000, 3)")), "bytes for an array"),
    "claim clip.npz": (lambda: archive(vertices=array("(1700, 1000, 3)")), "bytes for an array"),
    "rows.ply": (lambda: ply(f"element vertex 4000000000\n{XYZ}", bytes(99)), "cut short"),
    "sparse.glb": (lambda: sparse(80_000_000), "at most 10,000,000 vertices"),
    "sparse small.glb": (lambda: sparse(9_000_000), "at most 4,000,000 values without data"),
    # Archives that unpack to far more than their size.
    "zeros.npz": (lambda: zeros_archive(33), "bytes when it is unpacked"),
    # Frames without vertices, and vertices without frames.
    "empty.npz": (lambda: archive(vertices=array("(100000000000, 0, 3)")), "found (100,000|a clip of)"),
    "empty.pc2": (lambda: pc2(0, 2**31 - 1), "at least one frame with points"),
    "no frame.pc2": (lambda: pc2(2**31 - 1, 0), "at least one frame with points"),
    # More of something than any file has.
    "deep.glb": (lambda: chain(1_100), "at most 1,000 joints or nodes one below the other"),
    "nodes.glb": (lambda: chain(20_100), "at most 20,000 joints or nodes"),
    "shown.glb": (lambda: shown(6_000), "at most 5,000 parts of meshes"),
    "morphed.glb": (lambda: morphed(200), "at most 100,000,000 vertices in all morph targets"),
    "polygon.obj": (lambda: obj("f" + " 1 2 3" * 10_000), "at most 20,000 corners of one polygon"),
    "polygon.ply": (
        lambda: ply(
            f"element vertex 3\n{XYZ}element face 1\nproperty list int uchar vertex_indices\n",
            TRIANGLE + struct.pack("<i", 30_000) + bytes([0, 1, 2]) * 10_000,
        ),
        "at most 20,000 corners of one polygon",
    ),
    "elements.ply": (
        lambda: ply(
            f"element vertex 3\n{XYZ}" + "element a 2\nproperty list uchar uchar b\n" * 600,
            TRIANGLE + b"\x01\x01\x02\x01\x01" * 600,
        ),
        "at most 1,000 elements",
    ),
    "deep.bvh": (lambda: bvh("JOINT a\n{\nOFFSET 0 0 0\n" * 1_200 + "}\n" * 1_200, 2), "one below the other"),
    "joints.bvh": (lambda: bvh("JOINT a\n{\nOFFSET 0 0 0\n}\n" * 4_100, 1_000), "joints in all frames together"),
    "motion.npz": (
        lambda: archive(
            poses=array("(300000, 66)", "|i1", bytes(19_800_000)), trans=array("(300000, 3)", "|i1", bytes(900_000))
        ),
        "joints in all frames together",
    ),
    # Headers and numbers that no program writes.
    "header.npz": (
        lambda: archive(vertices=b"\x93NUMPY\x03\x00" + struct.pack("<I", 2**32 - 1) + bytes(60)),
        "a header of 4294967295 bytes",
    ),
    "large.npz": (lambda: archive(vertices=array(f"(0, {10**30}, 3)")), "archive of plain arrays|far more"),
    "index.obj": (lambda: obj("f 1 2 30000000000000000000"), "in line 5"),
    "digits.obj": (lambda: obj("f 1 2 " + "3" * 5_000), "in line 5"),
    "rate.bvh": (lambda: bvh("", 2, frame_time="1e-320"), "a frame time of"),
    "channels.bvh": (lambda: bvh("", 2, channels="0", rows="\n"), "joints with channels"),
    # Values that no format of single precision has.
    "large uv.obj": (lambda: obj("vt 1e300 0\nf 1/1 2/1 3/1"), "expected texture coordinates that are finite"),
    "large normal.obj": (lambda: obj("vn 1e200 0 1\nf 1//1 2//1 3//1"), "expected normals that are finite"),
}


@pytest.fixture(params=REFUSED)
def hostile(request, tmp_path) -> tuple[Path, str]:
    make, message = REFUSED[request.param]
    path = tmp_path / request.param
    path.write_bytes(make())
    assert path.stat().st_size < 2 << 20
    return path, message


def test_hostile_files_are_refused_at_once(hostile):
    path, message = hostile
    begin = time.process_time()
    for load in (load_mesh, load_clip):
        with pytest.raises(InputError, match=message) as caught:
            load(path)
        assert str(caught.value).startswith(f"{path}: expected ")
    assert time.process_time() - begin < SECONDS


@pytest.mark.slow
def test_hostile_files_are_refused_in_little_memory(hostile):
    path, message = hostile
    tracemalloc.start()  # makes Python many times slower, so time is measured without
    try:
        for load in (load_mesh, load_clip):
            with pytest.raises(InputError, match=message):
                load(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < MEMORY


@pytest.mark.parametrize(
    ("command", "name"),
    [("look", "motion.npz"), ("convert", "sparse.glb"), ("transfer", "index.obj"), ("animate", "empty.npz")],
)
def test_commands_refuse_them_with_one_line(command, name, tmp_path, capsys):
    path, good = tmp_path / name, tmp_path / "good.obj"
    path.write_bytes(REFUSED[name][0]())
    good.write_bytes(obj("f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4"))
    arguments = {
        "look": [path],
        "convert": [path, tmp_path / "out.glb"],
        "transfer": [good, path, "-m", "copy", "-o", tmp_path / "out.obj"],
        "animate": [good, path, "-m", "copy", "-o", tmp_path / "out.glb"],
    }[command]
    assert run([command, *map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.err.startswith(f"mimesh: {path}: expected ")
    assert not list(tmp_path.glob("out*"))


def test_no_limits_reads_what_is_refused_otherwise(tmp_path, capsys):
    (tmp_path / "a.obj").write_bytes(obj("f" + " 1 2 3" * 7_000))
    command = ["convert", str(tmp_path / "a.obj"), str(tmp_path / "b.ply")]
    assert run(command) == 2
    assert "add --no-limits" in capsys.readouterr().err
    assert run([*command, "--no-limits"]) == 0
    with no_limits():
        assert len(load_mesh(tmp_path / "a.obj").vertices) == 4
    # Neither the command nor the block has an effect afterwards.
    with pytest.raises(InputError, match=r"with mimesh\.no_limits"):
        load_mesh(tmp_path / "a.obj")


def test_limits_are_lifted_for_one_thread_alone():
    """The studio reads files of several users in threads: what one caller lifts must stay in place for others."""
    errors = []

    def check() -> None:
        try:
            VERTICES.check(VERTICES.largest + 1, "other")
        except InputError as error:
            errors.append(error)

    with no_limits():
        check()
        assert not errors
        thread = threading.Thread(target=check)
        thread.start()
        thread.join()
    assert len(errors) == 1
    check()
    assert len(errors) == 2


def test_budgets_leave_room_for_large_files():
    """3 million vertices, and 10,000 frames of a character of 100,000 vertices, 300 joints and 20 blend shapes."""
    VERTICES.check(3_000_000, "a")
    budgets.FACES.check(6_000_000, "a")
    budgets.check_clip_size(10_000, 100_000, "a")
    budgets.POSED_JOINTS.check(10_000 * 300, "a")
    budgets.MORPHED.check(20 * 100_000, "a")
    # Clips that are written as one morph target a frame have 24 bytes for each vertex, and a weight for each pair.
    budgets.MORPHED.check(10_000 * 20_000, "a", size=24 * 10_000 * 20_000)
    budgets.KEYS.check(10_000 * 10_000, "a", size=24 * 10_000 * 20_000)


def test_larger_files_may_have_more():
    budget = budgets.Budget("things", 100, 0.5)
    budget.check(100, "a")
    budget.check(150, "a", size=300)
    with pytest.raises(InputError, match="at most 150 things, found 151"):
        budget.check(151, "a", size=300)


def test_counts_of_any_length_are_printed_in_short():
    with pytest.raises(InputError, match="found far more") as caught:
        FRAMES.check(10**5_000, "a")
    assert len(str(caught.value)) < 200


def test_long_continued_line_is_read_in_linear_time(tmp_path):
    (tmp_path / "a.obj").write_bytes(obj("f 1 2 " + "\\\n" * 300_000 + "3"))
    begin = time.process_time()
    assert len(load_mesh(tmp_path / "a.obj").faces) == 1
    assert time.process_time() - begin < SECONDS
