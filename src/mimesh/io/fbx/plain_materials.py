"""Prepare the materials and images of a glTF file for Blender's FBX exporter, which writes plain values only.

Blender's glTF importer builds a network of nodes where vertex colours, a texture or a factor are multiplied, or where a
material is unlit. Its FBX exporter writes neither: such a colour becomes 0.8 grey. So the script that Blender runs gets
colour, opacity and image of each material from here. Blender cuts and numbers names, so that materials and images get
unique short ones for the import.
"""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

from ..gltf.document import Document, image_type, uri_file_name
from ..gltf.draft import Draft
from ..gltf.read import base_color_of, base_texture_of

MATERIAL, IMAGE = "mimesh-material-{}", "mimesh-image-{}"
"""Names of materials and images during the import; Blender keeps up to 63 bytes."""
SUFFIXES = {"image/png": ".png", "image/jpeg": ".jpg", "image/webp": ".webp", "image/ktx2": ".ktx2"}
FORBIDDEN = '<>:"/\\|?*'
"""Characters that file names cannot have on some system."""
LONGEST = 40
"""Characters of an image's name without its suffix."""


def plain_materials(draft: Draft, document: Document) -> dict[str, list[dict[str, Any]]]:
    """Rename the materials and images of a draft, and list what the script is to make of each.

    Returns:
        "materials", each with "key" (its name in the draft), "name", "color" (RGB), "alpha" and "image" (the key of the
        base colour's image, or None); "images", each with "key" and the file name "name".
    """
    images = [{"key": IMAGE.format(number), "name": name} for number, name in enumerate(_image_names(document))]
    materials = []
    for number, entry in enumerate(draft.gltf.get("materials", [])):
        *color, alpha = base_color_of(entry)
        source = _image_of(draft.gltf, base_texture_of(entry))
        materials.append(
            {
                "key": MATERIAL.format(number),
                "name": entry.get("name") or f"material{number}",
                "color": color,
                "alpha": alpha if entry.get("alphaMode", "OPAQUE") == "BLEND" else 1.0,
                "image": None if source is None else images[source]["key"],
            }
        )
        entry["name"] = materials[-1]["key"]
    for entry, image in zip(draft.gltf.get("images", []), images, strict=True):
        entry["name"] = image["key"]
    return {"materials": materials, "images": images}


def _image_of(gltf: dict[str, Any], reference: dict[str, Any]) -> int | None:
    """Return the image of a reference to a texture; that of an extension where the texture has no plain one."""
    if "index" not in reference:
        return None
    texture = gltf["textures"][reference["index"]]
    others = [entry for entry in texture.get("extensions", {}).values() if isinstance(entry, dict)]
    source = next((entry["source"] for entry in (texture, *others) if "source" in entry), None)
    return source if isinstance(source, int) and 0 <= source < len(gltf.get("images", [])) else None


def _image_names(document: Document) -> list[str]:
    """List unique file names of all images, with the suffix of their format."""
    names: list[str] = []
    for number, (image, content) in enumerate(zip(document.gltf.get("images", []), document.images, strict=True)):
        file = uri_file_name(image)
        stem = PurePosixPath(image.get("name") or file).name
        suffix = SUFFIXES.get(image_type(content) or "", "") if content else PurePosixPath(file).suffix
        while PurePosixPath(stem).suffix.lower() in {*SUFFIXES.values(), ".jpeg", ".tga", ".bmp", ".tif", ".tiff"}:
            stem = PurePosixPath(stem).stem
        stem = "".join("_" if c in FORBIDDEN or not c.isprintable() else c for c in stem).strip(" .")[:LONGEST]
        names.append(_unique(stem or f"image{number}", suffix, names))
    return names


def _unique(stem: str, suffix: str, used: list[str]) -> str:
    """Return a file name that none of the others has, also where case does not count."""
    taken, name, number = {other.lower() for other in used}, stem + suffix, 2
    while name.lower() in taken:
        name, number = f"{stem}-{number}{suffix}", number + 1
    return name
