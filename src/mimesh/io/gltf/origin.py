"""Reads what a glTF or VRM file says about its maker and licence.

VRM 0 is the extension VRM, VRM 1 is VRMC_vrm. Sketchfab writes author and licence to the extras of `asset`.
"""

from __future__ import annotations

from .document import Document
from .vrm import json_object

LONGEST = 80
"""Characters of a maker or licence that are kept."""


def read_origin(document: Document) -> tuple[str, str]:
    """Read maker and licence: of VRM's meta, of the extras of `asset`, or its copyright; empty if not stated."""
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
    licences = (first.get("licenseUrl"), old.get("otherLicenseUrl"), old.get("licenseName"), extras.get("license"))
    return _first_text(makers), _first_text(licences)


def _first_text(values: tuple[object, ...]) -> str:
    """Return the first value that is a text and not empty, on one line and cut."""
    texts = (" ".join(value.split()) for value in values if isinstance(value, str))
    return next((text[:LONGEST] for text in texts if text), "")
