"""Damaged files of native libraries give a mesh, a clip or one line, within limits, and this process goes on."""

from __future__ import annotations

import dataclasses
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest
from zoo import grid

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import load_clip, load_mesh, save_clip

SUFFIXES = {".usda": "pxr", ".usdc": "pxr", ".usdz": "pxr", ".abc": "alembic3d"}
"""Formats, and the library of each."""
SECONDS = 10
MEMORY = 2 * 2**30
"""Bytes of resident memory."""


def sound_file(path: Path) -> bytes:
    """Write a clip of six frames with a material, and return the bytes of the file."""
    mesh = grid(6)
    part = Part("cloth", 0, len(mesh.faces), Material("red wool", (1.0, 0.0, 0.0, 1.0)))
    noise = np.random.default_rng(0).normal(0.0, 0.01, (6, *mesh.vertices.shape))
    save_clip(Clip(dataclasses.replace(mesh, parts=(part,)), mesh.vertices + noise, 24.0), path)
    return path.read_bytes()


def mutated(content: bytes, seed: int) -> bytes:
    """Damage a file: some bytes changed, a run of equal bytes, a part cut out, or the end cut off."""
    rng, data = np.random.default_rng(seed), bytearray(content)
    kind = seed % 4
    start = int(rng.integers(len(data)))
    length = int(rng.integers(1, 64))
    if kind == 0:
        for place in rng.integers(len(data), size=rng.integers(1, 9)).tolist():
            data[place] ^= int(rng.integers(1, 256))
    elif kind == 1:
        data[start : start + length] = bytes([int(rng.choice([0, 0x7F, 0xFF]))]) * length
    elif kind == 2:
        del data[start : start + length]
    else:
        del data[start:]
    return bytes(data)


def outcome(path: Path) -> str:
    """Read a file within the limits; returns what was found. Other exceptions than InputError fail the test."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        clip = load_clip(path)
        assert np.isfinite(clip.vertices).all()
        found = "clip"
    except InputError as error:
        found = str(error)
        assert "\n" not in found
        assert str(path) in found
        assert len(found) < 2000
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < SECONDS
    # Of the largest child so far, which may be that of another test; a child also counts what this process had when it
    # started the child, which can be more than MEMORY after other tests.
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert after.ru_maxrss == before.ru_maxrss or after.ru_maxrss <= max(MEMORY / 1024, own)
    return found


@pytest.fixture(params=SUFFIXES)
def sound(request, tmp_path) -> tuple[Path, bytes]:
    """A path of each format, and the bytes of a sound file."""
    pytest.importorskip(SUFFIXES[request.param])
    path = tmp_path / f"a{request.param}"
    return path, sound_file(path)


def check_mutations(path: Path, content: bytes, seeds: range) -> None:
    assert outcome(path) == "clip"
    found = set()
    for seed in seeds:
        path.write_bytes(mutated(content, seed))
        found.add(outcome(path))
    assert found - {"clip"}  # some of it was damage


@pytest.mark.slow
def test_some_mutations_are_read_or_refused(sound):
    check_mutations(*sound, range(6))


@pytest.mark.slow
def test_many_mutations_are_read_or_refused(sound):
    check_mutations(*sound, range(6, 106))


USDA = """#usda 1.0
({head})
def Mesh "{name}" {{
 point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
 point3f[] points.timeSamples = {{ 0: [(0, 0, 0), (1, 0, 0), (0, 1, 0)], 10: [(0, 0, 0), (1, 0, 0), (0, 2, 0)] }}
 int[] faceVertexCounts = [{counts}]
 int[] faceVertexIndices = [0, 1, 2]
}}
"""
SOUND = {"head": "endTimeCode = 10\nstartTimeCode = 0", "name": "m", "counts": "3"}
STAGES = {
    "no UTF-8": (SOUND | {"name": "m\udcff"}, "text that is no UTF-8|expected a USD stage"),
    "huge counts": (SOUND | {"counts": "2147483645"}, "found 3; the file is damaged"),
    "no time codes a second": (
        SOUND | {"head": SOUND["head"] + "\ntimeCodesPerSecond = 0"},
        "time codes a second, found 0",
    ),
    "endless": (SOUND | {"head": "endTimeCode = 100000000\nstartTimeCode = 0"}, "at most 3600 s"),
    "a long name": (SOUND | {"counts": "4", "name": "m" * 10**6}, "as its faces have corners|damaged"),
}


@pytest.mark.parametrize("name", STAGES)
def test_damage_of_usd_is_named(name, tmp_path):
    pytest.importorskip("pxr")
    values, expected = STAGES[name]
    path = tmp_path / "a.usda"
    path.write_bytes(USDA.format(**SOUND).encode())
    assert outcome(path) == "clip"
    path.write_bytes(USDA.format(**values).encode(errors="surrogateescape"))
    found = outcome(path)
    assert any(part in found for part in expected.split("|"))


def test_name_that_is_no_utf8_in_alembic(tmp_path):
    pytest.importorskip("alembic3d")
    content = sound_file(tmp_path / "a.abc")
    assert b"red wool" in content
    (tmp_path / "a.abc").write_bytes(content.replace(b"red wool", b"red w\x80ol"))
    assert "text that is no UTF-8" in outcome(tmp_path / "a.abc")


@pytest.mark.parametrize("suffix", [".usdz", ".npz"])
def test_checksums_of_packages_are_checked(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    if suffix == ".usdz":
        pytest.importorskip("pxr")
        content = bytearray(sound_file(path))
    else:
        np.savez(path, vertices=np.stack([grid().vertices] * 3), faces=grid().faces)
        content = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as package:
        first = package.infolist()[0]
        assert first.compress_type == zipfile.ZIP_STORED
    # The last bit of a number near the end of the first file: all formats still make sense of it.
    place = content.index(b"PK", first.header_offset + first.file_size) - 8 if suffix == ".npz" else None
    if place is None:
        place = content.index(b"PXR-USDC") + 200
    content[place] ^= 1
    path.write_bytes(content)
    for read in (load_clip, load_mesh) if suffix == ".usdz" else (load_clip,):
        with pytest.raises(InputError, match=r"checksum|CRC"):
            read(path)
