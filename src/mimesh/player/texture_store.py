"""Textures of a page: each is stored once, and reduced in size if they exceed their share of the budget."""

from __future__ import annotations

import functools
import io
from typing import Any

from ..render.textures import decode_image
from .encoding import to_base64

JPEG_QUALITY = 86
"""Of reduced textures, 1 to 95 (Pillow)."""
SMALLEST = 256
"""Pixels of a side below which textures are not reduced."""


class TextureStore:
    """Collects the textures of the panels, each once; damaged ones are left out and counted."""

    def __init__(self) -> None:
        self._contents: list[bytes] = []
        self._damaged: list[bytes] = []

    def index(self, content: bytes | None) -> int | None:
        """Add a texture, unless it is there, and return its index; None without a texture or if it is damaged."""
        if content is None or content in self._damaged:
            return None
        if content not in self._contents:
            if not _readable(content):
                self._damaged.append(content)
                return None
            self._contents.append(content)
        return self._contents.index(content)

    def pack(self, budget: int, left_out: list[str]) -> list[dict[str, Any]]:
        """Encode all textures in about `budget` characters.

        The largest is halved until all fit or none gets smaller; a message about that is appended to `left_out`.
        """
        contents = list(self._contents)
        if self._damaged:
            left_out.append(f"textures that cannot be read are left out: {len(self._damaged)}")
        # Base64 takes 4 characters for 3 bytes.
        while 4 / 3 * sum(map(len, contents)) > budget:
            largest = max(range(len(contents)), key=lambda k: len(contents[k]))
            smaller = _halve(contents[largest])
            if len(smaller) >= len(contents[largest]):
                break
            contents[largest] = smaller
        if contents != self._contents:
            left_out.append("textures are shown smaller than they are, to keep this page small")
        return [{"type": _media_type(content), "data": to_base64(content)} for content in contents]


@functools.lru_cache(maxsize=16)  # the studio packs the same textures for every result
def _readable(content: bytes) -> bool:
    return decode_image(content) is not None


def _media_type(content: bytes) -> str:
    return "image/png" if content.startswith(b"\x89PNG") else "image/jpeg"


def _halve(content: bytes) -> bytes:
    """Reduce a picture to half its width and height, as JPEG; the player draws no transparency."""
    image, written = decode_image(content), io.BytesIO()
    assert image is not None
    size = [max(side // 2, min(side, SMALLEST)) for side in image.size]
    image.resize((size[0], size[1])).save(written, "JPEG", quality=JPEG_QUALITY)
    return written.getvalue()
