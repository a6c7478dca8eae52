"""Reads the extensions of VRM in a glTF file, and reads and writes VRM animations (.vrma), and writes
characters of VRM 1.0 (.vrm).

VRM 0.x is the extension VRM, VRM 1.0 is VRMC_vrm: humanoid bones, expressions, maker and licence. They are untrusted
JSON of any shape: what does not fit is left out. Neither version stores animations in a .vrm: "glTF schema Updates,
Unused Items" of VRMC_vrm 1.0 lists `animations`, and "Savable elements" of VRM 0.0 does not have them.

A .vrma has the extension VRMC_vrm_animation 1.0 and a node for each humanoid bone, in the T-pose where nothing moves
it. Animations rotate the nodes and move the hips. Expressions and the direction of the gaze are nodes of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...bodies.engine_names import SCHEMES
from ...motions.bone_motion import TRUNK, BoneMotion, misplaced_bones
from .document import Document, open_document
from .draft import AccessorCopier
from .scene import DEFAULT_TRS, node_parents, node_properties, world_matrices
from .skinned import joint_animation, joints_draft

ANIMATION = "VRMC_vrm_animation"
"""Extension of VRM animations."""
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
REQUIRED = {joint for joint in VRM_BONES.values() if "Hand" not in joint.removesuffix("Hand")} - VRM_OPTIONAL - {*TRUNK}
"""Joints without which the bones of a file are not used."""
PRESETS = {
    **{"a": "aa", "i": "ih", "u": "ou", "e": "ee", "o": "oh", "joy": "happy", "sorrow": "sad", "fun": "relaxed"},
    **{"blink_l": "blinkLeft", "blink_r": "blinkRight"},
}
"""Preset expression of VRM 1.0 of each preset of VRM 0.x (in lower case) that is called otherwise."""
OVERRIDDEN = {"overrideBlink": {"blink", "blinkLeft", "blinkRight"}, "overrideMouth": {"aa", "ih", "ou", "ee", "oh"}}
"""Expressions that others reduce, by the property that says how (VRM 1.0, expressions.md, Procedural override)."""
PUBLIC_LICENSE = "https://vrm.dev/licenses/1.0/"
"""URL of the VRM Public License, the only `licenseUrl` that VRM 1.0 accepts. By default it allows next to nothing."""
LONGEST = 80
"""Characters of a maker or licence that are kept."""


@dataclass(frozen=True)
class VrmMeta:
    """Who made a character, and what others may do with it: the part of VRM's meta that VRM 1.0 requires."""

    name: str
    authors: tuple[str, ...]
    license: str
    """URL of the licence."""

    def json(self) -> dict[str, Any]:
        """Return VRM's `meta`: `licenseUrl` is always the VRM Public License (meta.md), others go beside it."""
        other = {} if self.license == PUBLIC_LICENSE else {"otherLicenseUrl": self.license}
        return {"name": self.name, "authors": list(self.authors), "licenseUrl": PUBLIC_LICENSE, **other}


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
    return ANIMATION in json_object(document.gltf, "extensions")


def vrm_bones(document: Document) -> dict[str, int]:
    """Read the node of each joint of the shipped body, fingers included, that a VRM file or animation names.

    Empty for other and damaged files.
    """
    extensions, count = json_object(document.gltf, "extensions"), len(document.gltf.get("nodes", []))
    listed: dict[str, Any] = {}
    for name in ("VRMC_vrm", ANIMATION):
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
    extension = json_object(json_object(document.gltf, "extensions"), ANIMATION)
    groups, count = json_object(extension, "expressions"), len(document.gltf.get("nodes", []))
    rows = {name: row for group in ("custom", "preset") for name, row in json_object(groups, group).items()}
    nodes = {name: row.get("node") for name, row in rows.items() if isinstance(row, dict)}
    return {name: node for name, node in nodes.items() if isinstance(node, int) and _is_index(node, count)}


def read_origin(document: Document) -> tuple[str, str]:
    """Read maker and licence: of VRM's meta, of the extras of `asset`, or its copyright; empty if not stated.

    Sketchfab writes author and licence to the extras of `asset`.
    """
    asset, extensions = json_object(document.gltf, "asset"), json_object(document.gltf, "extensions")
    first, old, extras = (
        json_object(json_object(extensions, "VRMC_vrm"), "meta"),
        json_object(json_object(extensions, "VRM"), "meta"),
        json_object(asset, "extras"),
    )
    authors = first.get("authors")
    makers = (
        ", ".join(map(str, authors)) if isinstance(authors, list) else "",
        old.get("author"),
        extras.get("author"),
        asset.get("copyright"),
    )
    licences = (
        first.get("otherLicenseUrl"),
        first.get("licenseUrl"),
        old.get("otherLicenseUrl"),
        old.get("licenseName"),
        extras.get("license"),
    )
    # The first text that is not empty, on one line and cut.
    texts = ([" ".join(value.split()) for value in some if isinstance(value, str)] for some in (makers, licences))
    maker, licence = (next((text[:LONGEST] for text in of_one if text), "") for of_one in texts)
    return maker, licence


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


def write_vrma(motions: Sequence[BoneMotion], path: Path) -> None:
    """Write motions of one skeleton as a VRM animation in GLB format, with an animation for each."""
    first = motions[0]
    draft = joints_draft(first.bones, first.parents, first.rest)
    bones = {bone: {"node": k} for k, bone in enumerate(first.bones)}
    draft.gltf |= {
        "extensionsUsed": [ANIMATION],
        "extensions": {ANIMATION: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}},
        "animations": [
            joint_animation(draft, each.name, each.parents, each.rotation, each.hips, each.fps) for each in motions
        ],
    }
    draft.save(path)


def write_vrm(
    glb: Path,
    bones: Mapping[str, int],
    meta: VrmMeta,
    turn: Float[np.ndarray, "3 3"],
    origin: Float[np.ndarray, " 3"],
    path: Path,
) -> None:
    """Write a glTF file of a person in the T-pose as VRM 1.0, without animations, which VRM has none of.

    Bones that hang on another one than VRM demands (`misplaced_bones`) are moved below that, and stay where they are.

    Args:
        bones: humanoid bone -> node.
        turn: rotation from the axes of the file to y up, +z front, as VRM has them.
        origin: point of the file on the ground below the hips. VRM has it at zero (tpose.md: soles at y = 0, left and
            right symmetric at x = 0).
    """
    from scipy.spatial.transform import Rotation

    document = open_document(glb)
    draft = AccessorCopier(document, whole=True).draft
    gltf = draft.gltf
    gltf.pop("animations", None)
    _move_bones(gltf, document, {VRM_BONES[bone]: node for bone, node in bones.items()})
    humanoid = {"humanBones": {bone: {"node": node} for bone, node in bones.items()}}
    extension = {"specVersion": "1.0", "meta": meta.json(), "humanoid": humanoid}
    gltf["extensionsUsed"] = [*gltf.get("extensionsUsed", []), "VRMC_vrm"]
    gltf["extensions"] = {**gltf.get("extensions", {}), "VRMC_vrm": extension}
    scene = gltf["scenes"][gltf.get("scene", 0)]
    gltf["nodes"].append(
        {
            "name": "axes",
            "rotation": Rotation.from_matrix(turn).as_quat().tolist(),
            "translation": (-turn @ origin).tolist(),
            "children": scene["nodes"],
        }
    )
    scene["nodes"] = [len(gltf["nodes"]) - 1]
    draft.save(path)


def _move_bones(gltf: dict[str, Any], document: Document, joints: Mapping[str, int]) -> None:
    """Move the bones of a copied document that VRM demands elsewhere in the hierarchy, at rest in the same place."""
    nodes, parents, world = gltf["nodes"], node_parents(document), world_matrices(document)
    moved = misplaced_bones(joints, parents)
    for joint, above in moved.items():
        node = joints[joint]
        of_scenes = [(scene, "nodes") for scene in gltf["scenes"] if node in scene.get("nodes", [])]
        for owner, key in [(nodes[parents[node]], "children")] if parents[node] >= 0 else of_scenes:
            owner[key] = [child for child in owner[key] if child != node]
            if not owner[key]:
                del owner[key]
        owner, key = (nodes[above], "children") if above >= 0 else (gltf["scenes"][gltf.get("scene", 0)], "nodes")
        owner[key] = [*owner.get(key, []), node]
        local = world[node] if above < 0 else np.linalg.inv(world[above]) @ world[node]
        kept = {key: value for key, value in nodes[node].items() if key not in ("matrix", *DEFAULT_TRS)}
        placed = node_properties({"matrix": local.T.ravel()})
        nodes[node] = kept | {key: value.tolist() for key, value in placed.items()}
    for skin in gltf.get("skins", []) if moved else ():
        skin.pop("skeleton", None)  # optional, and perhaps no longer above all joints (glTF 2.0, 5.28.2)
