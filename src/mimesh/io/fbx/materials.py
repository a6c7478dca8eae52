"""Write the materials of an FBX scene into a glTF draft: base colour, its texture, and roughness.

A texture is embedded in the FBX file, or a file beside it. Images that glTF does not have (TGA, BMP, TIFF) become PNG.
"""

from __future__ import annotations

import io
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

from ..beside import is_there
from ..gltf.document import image_type
from ..gltf.draft import Draft
from .elements import items, matrix, own

ROUGHNESS = 0.9
"""Roughness of materials that state none, as in other files that this package writes."""
MOST_PIXELS = 2**28
"""Pixels of the largest image that is converted."""
REPEAT, CLAMP_TO_EDGE = 10497, 33071
"""Values of `wrapS` and `wrapT` (glTF 2.0, 5.26 Sampler)."""


class MaterialWriter:
    """Adds each material, texture and image of a scene once."""

    def __init__(self, draft: Draft, path: Path) -> None:
        self.draft = draft
        self.path = path
        self.missing: list[str] = []
        """Names of the images that do not exist or that cannot be read."""
        self._materials: dict[int, int] = {}
        self._textures: dict[int, int | None] = {}
        self._images: dict[bytes, int] = {}

    def add(self, material: Any, uv_names: list[str]) -> int:
        """Add a material for a mesh with given names of its sets of texture coordinates; returns its index."""
        key = material.typed_id
        if key not in self._materials:
            entries = self.draft.gltf.setdefault("materials", [])
            entries.append(self._entry(material, uv_names))
            self._materials[key] = len(entries) - 1
        return self._materials[key]

    def _entry(self, material: Any, uv_names: list[str]) -> dict[str, Any]:
        """Return the JSON of a material."""
        maps = own(material.pbr)
        base, factor, opacity = own(maps.base_color), own(maps.base_factor), own(maps.opacity)
        roughness, metalness = own(maps.roughness), own(maps.metalness)
        texture = own(base.texture) if base.texture_enabled else None
        reference = None if texture is None else self._reference(texture, uv_names)
        strength = factor.value_vec4.x if factor.has_value else 1.0
        # In FBX a texture replaces the colour, in glTF it multiplies it.
        color = [1.0] * 3 if texture is not None else [_share(value * strength) for value in base.value_vec4[:3]]
        # Exporters write 0 where they mean nothing; a material that nobody sees is not one.
        alpha = _share(opacity.value_vec4.x) if opacity.has_value and opacity.value_vec4.x > 0 else 1.0
        surface: dict[str, Any] = {
            "baseColorFactor": [*color, alpha],
            "metallicFactor": _share(metalness.value_vec4.x) if metalness.has_value else 0.0,
            "roughnessFactor": _share(roughness.value_vec4.x) if roughness.has_value else ROUGHNESS,
        }
        if reference is not None:
            surface["baseColorTexture"] = reference
        entry = {"name": material.name, "pbrMetallicRoughness": surface, "doubleSided": True}
        return entry | ({"alphaMode": "BLEND"} if alpha < 1 else {})

    def _reference(self, texture: Any, uv_names: list[str]) -> dict[str, Any] | None:
        """Return the JSON of a reference to a texture; None where its image is not there."""
        if texture.typed_id not in self._textures:
            self._textures[texture.typed_id] = self._add_texture(texture)
        index = self._textures[texture.typed_id]
        if index is None:
            return None
        uv_set = uv_names.index(texture.uv_set) if texture.uv_set in uv_names else 0
        reference: dict[str, Any] = {"index": index} | ({"texCoord": uv_set} if uv_set else {})
        if texture.has_uv_transform:
            self.draft.gltf["extensionsUsed"] = ["KHR_texture_transform"]
            reference["extensions"] = {"KHR_texture_transform": uv_transform(matrix(texture.uv_to_texture))}
        return reference

    def _add_texture(self, texture: Any) -> int | None:
        """Add a texture with its image and sampler; returns its index, or None where the image is not there."""
        files = [texture, *items(texture.file_textures)]
        content = next((found for file in files if (found := self._image(file)) is not None), None)
        paths = [file.relative_filename or file.absolute_filename for file in files]
        name = next((PureWindowsPath(path).name for path in paths if path), texture.name)
        if content is None:
            self.missing.append(name)
            return None
        gltf = self.draft.gltf
        images, samplers, textures = (gltf.setdefault(key, []) for key in ("images", "samplers", "textures"))
        if content not in self._images:
            self._images[content] = len(images)
            view = self.draft.add_view(content)
            images.append({"name": PureWindowsPath(name).stem, "bufferView": view, "mimeType": image_type(content)})
        wraps = [CLAMP_TO_EDGE if int(wrap) else REPEAT for wrap in (texture.wrap_u, texture.wrap_v)]
        sampler = dict(zip(("wrapS", "wrapT"), wraps, strict=True))
        if sampler not in samplers:
            samplers.append(sampler)
        textures.append({"source": self._images[content], "sampler": samplers.index(sampler)})
        return len(textures) - 1

    def _image(self, texture: Any) -> bytes | None:
        """Return the image of a texture as PNG or JPEG: the embedded one, else a file beside the FBX file."""
        if texture.content:
            return as_png(texture.content)
        names = [PureWindowsPath(name) for name in (texture.relative_filename, texture.absolute_filename) if name]
        folder = self.path.parent
        places = [folder / names[0].as_posix()] if names and not names[0].drive and not names[0].root else []
        # ".fbm" is where Autodesk's library unpacks embedded files.
        for name in names:
            places += [folder / inner / name.name for inner in ("", f"{self.path.stem}.fbm", "textures", "Textures")]
        found = next((place for place in places if is_there(place)), None)
        return None if found is None else as_png(found.read_bytes())


def uv_transform(uv_to_texture: np.ndarray) -> dict[str, Any]:
    """Return the properties of KHR_texture_transform for an affine map of texture coordinates with v up.

    With v' = 1 - v on both sides the map u -> A u + b becomes F (A F u + b) with F u = D u + (0, 1), D = diag(1, -1).
    The extension's matrix is [[sx cos, sy sin], [-sx sin, sy cos]].
    """
    linear, offset = uv_to_texture[:2, :2], uv_to_texture[:2, 3]
    flip, one = np.diag([1.0, -1.0]), np.array([0.0, 1.0])
    turned = flip @ linear @ flip
    shifted = flip @ (linear @ one + offset) + one
    scale_u = float(np.hypot(*turned[:, 0]))
    scale_v = float(np.linalg.det(turned) / scale_u) if scale_u else 0.0
    rotation = float(np.arctan2(-turned[1, 0], turned[0, 0]))
    return {"offset": shifted.tolist(), "rotation": rotation, "scale": [scale_u, scale_v]}


def as_png(content: bytes) -> bytes | None:
    """Return an image as it is if glTF has its format, PNG or JPEG, else as PNG; None where it cannot be read."""
    if image_type(content) in ("image/png", "image/jpeg"):
        return content
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content)) as image:
            if image.width * image.height > MOST_PIXELS:
                return None
            written = io.BytesIO()
            image.convert("RGBA" if "A" in image.getbands() else "RGB").save(written, "PNG")
            return written.getvalue()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None  # what Pillow raises on images that it does not know, or that are damaged


def _share(value: float) -> float:
    """Clamp to 0..1."""
    return float(min(max(value, 0.0), 1.0)) if np.isfinite(value) else 1.0
