"""Reads what a glTF or VRM file says about itself: maker, licence, and the humanoid bones of VRM.

VRM 0 is the extension VRM, VRM 1 is VRMC_vrm. Sketchfab writes author and licence to the extras of `asset`. Extensions
are untrusted JSON of any shape.
"""

from __future__ import annotations

from typing import Any

from .document import Document

VRM_BONES = {
    "hips": "Hips",
    "neck": "Neck",
    "head": "Head",
    **{
        f"{side.lower()}{bone}": f"{side}{joint}"
        for side in ("Left", "Right")
        for bone, joint in {
            "Shoulder": "Shoulder",
            "UpperArm": "Arm",
            "LowerArm": "ForeArm",
            "Hand": "Hand",
            "UpperLeg": "UpLeg",
            "LowerLeg": "Leg",
            "Foot": "Foot",
            "Toes": "ToeBase",
        }.items()
    },
}
"""Joint of the shipped body of each humanoid bone of VRM; those of the trunk are in VRM_TRUNK."""
VRM_OPTIONAL = {"Neck", *(f"{side}{part}" for side in ("Left", "Right") for part in ("Shoulder", "ToeBase"))}
"""Joints that a VRM file need not name."""
VRM_TRUNK = ("spine", "chest", "upperChest")
"""Bones of the trunk from the hips up. The last ones of a shorter trunk are the shipped body's last ones."""
TRUNK = ("LowerBack", "Spine", "Spine1")
LONGEST = 80
"""Characters of a maker or licence that are kept."""


def vrm_version(document: Document) -> int | None:
    """Return 0 or 1 for a VRM file, None for others."""
    extensions = _entry(document.gltf, "extensions")
    return 1 if "VRMC_vrm" in extensions else 0 if "VRM" in extensions else None


def vrm_bones(document: Document) -> dict[str, int]:
    """Read the node of each joint of the shipped body that a VRM file names; empty for other and damaged files."""
    extensions, count = _entry(document.gltf, "extensions"), len(document.gltf.get("nodes", []))
    bones = _entry(_entry(extensions, "VRMC_vrm"), "humanoid").get("humanBones")
    listed = {name: _entry(bones, name).get("node") for name in bones} if isinstance(bones, dict) else {}
    rows = _entry(_entry(extensions, "VRM"), "humanoid").get("humanBones")
    for row in rows if isinstance(rows, list) else []:
        if isinstance(row, dict):
            listed.setdefault(str(row.get("bone")), row.get("node"))
    nodes = {name: node for name, node in listed.items() if isinstance(node, int) and 0 <= node < count}
    trunk = [name for name in VRM_TRUNK if name in nodes]
    joints = {**VRM_BONES, **dict(zip(trunk, TRUNK[len(TRUNK) - len(trunk) :], strict=True))}
    found = {joints[name]: node for name, node in nodes.items() if name in joints}
    return found if found.keys() >= set(VRM_BONES.values()) - VRM_OPTIONAL else {}


def read_origin(document: Document) -> tuple[str, str]:
    """Read maker and licence: of VRM's meta, of the extras of `asset`, or its copyright; empty if not stated."""
    asset, extensions = _entry(document.gltf, "asset"), _entry(document.gltf, "extensions")
    first, old, extras = (
        _entry(_entry(extensions, "VRMC_vrm"), "meta"),
        _entry(_entry(extensions, "VRM"), "meta"),
        _entry(asset, "extras"),
    )
    authors = first.get("authors")
    makers = (
        ", ".join(map(str, authors)) if isinstance(authors, list) else "",
        old.get("author"),
        extras.get("author"),
        asset.get("copyright"),
    )
    licences = (first.get("licenseUrl"), old.get("otherLicenseUrl"), old.get("licenseName"), extras.get("license"))
    return _first_text(makers), _first_text(licences)


def _entry(value: Any, key: str) -> dict[str, Any]:
    """Return an entry of a JSON object that is an object itself, else an empty one."""
    found = value.get(key) if isinstance(value, dict) else None
    return found if isinstance(found, dict) else {}


def _first_text(values: tuple[object, ...]) -> str:
    """Return the first value that is a text and not empty, on one line and cut."""
    texts = (" ".join(value.split()) for value in values if isinstance(value, str))
    return next((text[:LONGEST] for text in texts if text), "")
