"""Damage that native libraries do not name, or not see, is named in one line; test_damaged_at_random has more of it."""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import numpy as np
import pytest
from matrix import matrix
from zoo import grid

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import load_clip, save_clip


def sound_file(path: Path) -> bytes:
    """Write a clip of six frames with a material, and return the bytes of the file."""
    mesh = grid(6)
    part = Part("cloth", 0, len(mesh.faces), Material("red wool", (1.0, 0.0, 0.0, 1.0)))
    noise = np.random.default_rng(0).normal(0.0, 0.01, (6, *mesh.vertices.shape))
    save_clip(Clip(dataclasses.replace(mesh, parts=(part,)), mesh.vertices + noise, 24.0), path)
    return path.read_bytes()


def refusal(path: Path) -> str:
    """Return the line that says why a clip is not read."""
    with pytest.raises(InputError) as caught:
        load_clip(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    assert len(message) < 2000
    return message


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


@pytest.mark.slow
@matrix("name", STAGES, quick=["no UTF-8", "huge counts"])
def test_damage_of_usd_is_named(name, tmp_path):
    pytest.importorskip("pxr")
    values, expected = STAGES[name]
    path = tmp_path / "a.usda"
    path.write_bytes(USDA.format(**values).encode(errors="surrogateescape"))
    found = refusal(path)
    assert any(part in found for part in expected.split("|"))


@pytest.mark.slow
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
    with pytest.raises(InputError, match=r"checksum|CRC"):
        load_clip(path)
