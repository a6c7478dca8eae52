"""Reads the extensions of VRM in a glTF file: humanoid bones, expressions, and what a VRM animation (.vrma) animates.

VRM 0.x is the extension VRM, VRM 1.0 is VRMC_vrm, and VRMC_vrm_animation 1.0 is that of .vrma files. They are untrusted
JSON of any shape: what does not fit is left out.

Neither version stores animations in a .vrm: "glTF schema Updates, Unused Items" of VRMC_vrm 1.0 lists `animations`, and
"Savable elements" of VRM 0.0 does not have them. VRMC_vrm_animation is for separate files.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...bodies.engine_names import SCHEMES
from .document import Document

VRM_BONES = {bone: joint for joint, bone in SCHEMES["vrm"].bones.items()}
"""Joint of the shipped body, or of a finger, of each humanoid bone of VRM 1.0; a shorter trunk is read otherwise."""
OLD_THUMBS = {
    f"{side}Thumb{bone}": f"{side.capitalize()}HandThumb{k}"
    for side in ("left", "right")
    for k, bone in enumerate(("Proximal", "Intermediate", "Distal"), 1)
}
"""Bones of the thumb in VRM 0.x. VRM 1.0 calls them Metacarpal, Proximal and Distal."""
VRM_OPTIONAL = {"Neck", *(f"{side}{part}" for side in ("Left", "Right") for part in ("Shoulder", "ToeBase"))}
"""Joints, besides those of trunk and fingers, that a VRM file need not name."""
VRM_TRUNK = ("spine", "chest", "upperChest")
"""Bones of the trunk from the hips up. The last ones of a shorter trunk are the shipped body's last ones."""
TRUNK = ("LowerBack", "Spine", "Spine1")
REQUIRED = {joint for joint in VRM_BONES.values() if "Hand" not in joint.removesuffix("Hand")} - VRM_OPTIONAL - {*TRUNK}
"""Joints without which the bones of a file are not used."""
PRESETS = {
    **{"a": "aa", "i": "ih", "u": "ou", "e": "ee", "o": "oh", "joy": "happy", "sorrow": "sad", "fun": "relaxed"},
    **{"blink_l": "blinkLeft", "blink_r": "blinkRight"},
}
"""Preset expression of VRM 1.0 of each preset of VRM 0.x (in lower case) that is called otherwise."""
OVERRIDDEN = {
    "overrideBlink": {"blink", "blinkLeft", "blinkRight"},
    "overrideMouth": {"aa", "ih", "ou", "ee", "oh"},
}
"""Expressions that others reduce, by the property that says how (VRM 1.0, expressions.md, Procedural override)."""


@dataclass(frozen=True)
class Expression:
    """An expression of a VRM file: weights of morph targets."""

    binds: tuple[tuple[int, int, float], ...]
    """Node, morph target of its mesh, and weight of that at the full expression."""
    binary: bool
    """Whether there is nothing between no and the full expression."""
    overrides: dict[str, str]
    """Key of OVERRIDDEN -> "block" or "blend"."""


def vrm_version(document: Document) -> int | None:
    """Return 0 or 1 for a VRM file, None for others."""
    extensions = json_object(document.gltf, "extensions")
    return 1 if "VRMC_vrm" in extensions else 0 if "VRM" in extensions else None


def is_vrm_animation(document: Document) -> bool:
    """Return whether a file has the extension of VRM animations."""
    return "VRMC_vrm_animation" in json_object(document.gltf, "extensions")


def vrm_bones(document: Document) -> dict[str, int]:
    """Read the node of each joint of the shipped body, fingers included, that a VRM file or animation names.

    Empty for other and damaged files.
    """
    extensions, count = json_object(document.gltf, "extensions"), len(document.gltf.get("nodes", []))
    listed: dict[str, Any] = {}
    for name in ("VRMC_vrm", "VRMC_vrm_animation"):
        bones = json_object(json_object(json_object(extensions, name), "humanoid"), "humanBones")
        listed = {bone: json_object(bones, bone).get("node") for bone in bones} | listed
    rows = json_object(json_object(extensions, "VRM"), "humanoid").get("humanBones")
    for row in rows if isinstance(rows, list) else []:
        if isinstance(row, dict):
            listed.setdefault(str(row.get("bone")), row.get("node"))
    nodes = {name: node for name, node in listed.items() if _is_index(node, count)}
    trunk = [name for name in VRM_TRUNK if name in nodes]
    joints = VRM_BONES | dict(zip(trunk, TRUNK[len(TRUNK) - len(trunk) :], strict=True))
    if vrm_version(document) == 0:
        joints |= OLD_THUMBS
    found = {joints[name]: node for name, node in nodes.items() if name in joints}
    return found if found.keys() >= REQUIRED else {}


def vrm_expressions(document: Document) -> dict[str, Expression]:
    """Read the expressions of a VRM file by their names; presets have those of VRM 1.0."""
    extensions = json_object(document.gltf, "extensions")
    groups = json_object(json_object(extensions, "VRMC_vrm"), "expressions")
    found = {}
    for group in ("custom", "preset"):
        rows = json_object(groups, group)
        found |= {name: _expression(document, json_object(rows, name), "morphTargetBinds", 1.0) for name in rows}
    rows = json_object(json_object(extensions, "VRM"), "blendShapeMaster").get("blendShapeGroups")
    for row in rows if isinstance(rows, list) else []:
        if isinstance(row, dict):
            preset = str(row.get("presetName", "unknown")).lower()
            name = str(row.get("name")) if preset == "unknown" else PRESETS.get(preset, preset)
            found.setdefault(name, _expression(document, row, "binds", 100.0))  # weights up to 100
    return found


def animated_expressions(document: Document) -> dict[str, int]:
    """Read the node whose translation along x is the weight of each expression that a VRM animation has."""
    extension = json_object(json_object(document.gltf, "extensions"), "VRMC_vrm_animation")
    groups, count = json_object(extension, "expressions"), len(document.gltf.get("nodes", []))
    rows = {name: row for group in ("custom", "preset") for name, row in json_object(groups, group).items()}
    nodes = {name: row.get("node") for name, row in rows.items() if isinstance(row, dict)}
    return {name: node for name, node in nodes.items() if isinstance(node, int) and _is_index(node, count)}


def json_object(value: Any, key: str) -> dict[str, Any]:
    """Return an entry of a JSON object that is an object itself, else an empty one."""
    found = value.get(key) if isinstance(value, dict) else None
    return found if isinstance(found, dict) else {}


def _expression(document: Document, entry: dict[str, Any], key: str, full: float) -> Expression:
    """Read an expression, whose binds are under `key`; binds of VRM 0.x name a mesh, which several nodes may show."""
    nodes = document.gltf.get("nodes", [])
    rows = entry.get(key)
    binds = []
    for row in rows if isinstance(rows, list) else []:
        if not isinstance(row, dict):
            continue
        shown = [row.get("node")]
        if "mesh" in row:
            shown = [number for number, node in enumerate(nodes) if node.get("mesh") == row["mesh"]]
        index, weight = row.get("index"), row.get("weight", full)
        if isinstance(index, int) and index >= 0 and isinstance(weight, (int, float)):
            binds += [(node, index, weight / full) for node in shown if _is_index(node, len(nodes))]
    overrides = {key: entry[key] for key in OVERRIDDEN if entry.get(key) in ("block", "blend")}
    return Expression(tuple(binds), entry.get("isBinary") is True, overrides)


def _is_index(value: Any, count: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count
