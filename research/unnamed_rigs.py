"""Find the joints of characters whose names are hidden, and compare them with those that the names say."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from character_write import write_character
from retargets import FPS

from mimesh.bodies.character_pool import PoolCharacter
from mimesh.bodies.joint_names import without_fingers
from mimesh.core.errors import InputError
from mimesh.io import load_mesh
from mimesh.io.gltf.own_rig import read_own_rig
from mimesh.methods.find import find_mime
from mimesh.pipeline.look import joint_finder

LIMBS = ("Arm", "Leg", "Hand", "Foot")
"""Parts of the names of limb joints."""
KEYS = ("characters", "refused", "all limbs", "joints", "found")
"""Figures of `summarise_matches`: "all limbs" counts characters without a wrong or missing joint of a limb."""


def match_character(character: PoolCharacter, folder: Path) -> dict[str, Any]:
    """Count the joints of a character that are found without names, and list limb joints that are not or wrongly."""
    names = tuple(f"joint_{j}" for j in range(len(character.rig.parents)))
    path = folder / f"{character.meta.file}.glb"
    write_character(
        dataclasses.replace(character, rig=dataclasses.replace(character.rig, joint_names=names)), path, {}, FPS
    )
    expected = without_fingers(character.joints)
    row = {"file": character.meta.file, "pack": character.meta.pack, "split": character.meta.split}
    row |= {"joints": len(expected), "found": 0, "wrong": [], "refused": ""}
    try:
        humanoid = read_own_rig(load_mesh(path), joint_finder(find_mime("mime"), (None, None))).humanoid
    except InputError as error:
        return row | {"refused": str(error)}
    found = {name: names.index(humanoid.character.joint_names[joint]) for name, joint in humanoid.joints.items()}
    right = [name for name, joint in expected.items() if found.get(name) == joint]
    limbs = [name for name in expected if any(part in name for part in LIMBS)]
    return row | {"found": len(right), "wrong": [name for name in limbs if name not in right]}


def summarise_matches(rows: Iterable[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Sum up the figures of the characters of each pack and split that were not refused."""
    table: dict[str, dict[str, int]] = {}
    for row in rows:
        entry = table.setdefault(f"{row['pack']} ({row['split']})", dict.fromkeys(KEYS, 0))
        entry["characters"] += 1
        entry["refused"] += bool(row["refused"])
        if not row["refused"]:
            entry["joints"] += row["joints"]
            entry["found"] += row["found"]
            entry["all limbs"] += not row["wrong"]
    return table
