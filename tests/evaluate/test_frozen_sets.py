"""Frozen sets: checksums see every change of a pair, and all stored sets are still the same."""

import dataclasses
import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from freeze_sets import INEXACT, freeze
from matrix import matrix

from mimesh.evaluate.characters import characters
from mimesh.evaluate.clip_protocols import CLIPS_ANIFORMER, CLIPS_ORDERED, ClipPair
from mimesh.evaluate.frozen_sets import (
    FIRST,
    frozen_sets,
    pair_checksum,
    role,
    set_checksum,
)
from mimesh.evaluate.protocols import HUMAN_NPT, PROTOCOLS

STORED = frozen_sets()
WITHOUT_FILES = {name: protocol for name, protocol in PROTOCOLS.items() if name not in INEXACT}
WITHOUT_FILES |= {"clips-aniformer": CLIPS_ANIFORMER, "clips-ordered": CLIPS_ORDERED}
GENERATED = [key for key in STORED if key[0] in WITHOUT_FILES]
IN_FULL = [("noise", "test", "noise-2"), ("cross-topology", "val", "points")]
"""Sets that are generated as a whole, of the others the first pairs."""
FOLDERS = {
    "characters": ("MIMESH_CHARACTERS", characters),
}
"""Environment variables that name folders of files, and the protocols that read them."""


@cache
def checksum(key, i):
    name, split, kind = key
    return pair_checksum(WITHOUT_FILES[name].pair(split, kind, i))


@matrix("key", GENERATED, quick=[key for key in GENERATED if key[1] == "test"], ids="/".join)
def test_the_first_pair_of_a_generated_set_is_the_frozen_one(key):
    """Results of two installations are comparable only if both generate the same meshes with any library versions."""
    (name, split, kind), stored = key, STORED[key]
    protocol = WITHOUT_FILES[name]
    assert stored.version == protocol.version
    assert stored.pairs == protocol.count(kind, 0, split)
    assert stored.compare([checksum(key, 0)]) == ("same" if stored.pairs == 1 else "part")
    assert stored.compare(["00000000"]) == stored.compare([]) == "other"


@pytest.mark.slow
@pytest.mark.parametrize("key", GENERATED, ids="/".join)
def test_generated_sets_are_the_frozen_ones(key):
    stored = STORED[key]
    count = stored.pairs if key in IN_FULL else FIRST
    checksums = [checksum(key, i) for i in range(count)]
    assert stored.compare(checksums) == ("same" if count == stored.pairs else "part")
    assert stored.compare([*checksums[:-1], "00000000"]) == "other"
    assert stored.compare([*checksums, *["00000000"] * stored.pairs]) == "other"


@pytest.mark.parametrize("name", FOLDERS)
def test_sets_of_files_are_the_frozen_ones(name):
    """All pairs, where an environment variable names the folder of the files."""
    variable, find = FOLDERS[name]
    if variable not in os.environ:
        pytest.skip(f"{variable} names no folder")
    protocol = find(Path(os.environ[variable]))
    for split in ("val", "test"):
        for kind in protocol.kinds:
            assert freeze(protocol, split, kind) == STORED[name, split, kind]


def test_every_set_of_every_protocol_is_stored():
    protocols = (*PROTOCOLS.values(), CLIPS_ANIFORMER, CLIPS_ORDERED)
    expected = {(p.name, split, kind) for p in protocols for split in ("val", "test") for kind in p.kinds}
    assert expected <= STORED.keys()
    for key, stored in STORED.items():
        assert key == (stored.protocol, stored.split, stored.kind)
        assert stored.role == role(*key)
        assert (stored.checksum is None) == (stored.protocol in INEXACT)
        assert len(stored.first) == (0 if stored.checksum is None else FIRST)


def test_what_was_looked_at_is_no_test_set():
    roles = {key: stored.role for key, stored in STORED.items()}
    assert {value for (_, split, _), value in roles.items() if split == "val"} == {"development"}
    assert all(roles["noise", "test", kind] == "development" for kind in ("holes", "cropped", "half"))
    assert roles["noise", "test", "noise-2"] == roles["clips-aniformer", "test", "unseen"] == "test"
    assert role("cross-body", "test", "limits") == "development"


def arrays_of(pair):
    """Each array of a pair, as a function that returns the pair with one number of that array changed."""

    def with_change(field, change):
        return dataclasses.replace(pair, **{field: change(getattr(pair, field))})

    def in_mesh(name, amount):
        def change(mesh):
            return dataclasses.replace(mesh, **{name: nudged(getattr(mesh, name), amount)})

        return change

    def in_array(amount):
        return lambda array: nudged(array, amount)

    for field in ("identity", "driving"):
        yield with_change(field, in_mesh("vertices", 3e-5))
        yield with_change(field, lambda mesh: dataclasses.replace(mesh, faces=np.roll(mesh.faces, 1, axis=0)))
    for field in dataclasses.fields(pair):
        if isinstance(getattr(pair, field.name), np.ndarray):
            yield with_change(field.name, in_array(1 if field.name == "markers" else 3e-5))
    if isinstance(pair, ClipPair):
        yield with_change("clip", lambda clip: dataclasses.replace(clip, vertices=nudged(clip.vertices, 3e-5)))


def nudged(array, amount):
    """The array with its last number increased."""
    changed = np.array(array)
    changed.flat[-1] += amount
    return changed


@pytest.mark.parametrize("trial", [(HUMAN_NPT, "seen", 9), (CLIPS_ANIFORMER, "procedural", 12)], ids=["pair", "clip"])
def test_checksum_sees_a_change_of_any_array(trial):
    protocol, kind, arrays = trial
    pair = protocol.pair("val", kind, 0)
    if isinstance(pair, ClipPair):
        clip = dataclasses.replace(pair.clip, vertices=pair.clip.vertices[:2])
        few = {"truth_frames": pair.truth_frames[:2], "aligned_frames": pair.aligned_frames[:2]}
        pair = dataclasses.replace(pair, clip=clip, **few)
    checksum = pair_checksum(pair)
    changed = list(arrays_of(pair))
    assert len(changed) == arrays
    assert len({checksum, *map(pair_checksum, changed)}) == arrays + 1
    assert len(checksum) == 8


def test_checksum_does_not_see_the_last_digits():
    """The same shift by 1e-12 m, as another library may round, in all coordinates but those on an edge of rounding."""
    pair = HUMAN_NPT.pair("val", "seen", 0)
    whole = np.round(pair.truth / 1e-5) * 1e-5
    rounded = dataclasses.replace(pair, truth=whole)
    assert pair_checksum(dataclasses.replace(pair, truth=whole + 1e-12)) == pair_checksum(rounded)
    assert pair_checksum(pair) == pair_checksum(HUMAN_NPT.pair("val", "seen", 0))
    assert set_checksum(["00000001", "00000002"]) != set_checksum(["00000002", "00000001"])
