"""Textures: read whatever their kind, and packed for a page, each once, smaller where there is no room for it."""

from __future__ import annotations

import functools
import io
from typing import TYPE_CHECKING, Any

from ..render.textures import decode_image
from .encoding import text

if TYPE_CHECKING:
    pass

JPEG_QUALITY = 86
SMALLEST = 256
"""Pixels; sides of textures are not halved below it."""


class TextureStore:
    """Collects the textures of the panels, each once; those that are damaged are left out, and counted."""

    def __init__(self) -> None:
        self._contents: list[bytes] = []
        self._damaged: list[bytes] = []

    def number(self, content: bytes | None) -> int | None:
        """The place of a texture among all; None where there is none that can be shown."""
        if content is None or content in self._damaged:
            return None
        if content not in self._contents:
            if not _readable(content):
                self._damaged.append(content)
                return None
            self._contents.append(content)
        return self._contents.index(content)

    def packed(self, room: int, left_out: list[str]) -> list[dict[str, Any]]:
        """All textures in about `room` letters, large ones halved again and again; words about that in `left_out`."""
        contents = list(self._contents)
        if self._damaged:
            left_out.append(f"textures that cannot be read are left out: {len(self._damaged)}")
        while 4 / 3 * sum(map(len, contents)) > room:
            largest = max(range(len(contents)), key=lambda k: len(contents[k]))
            smaller = _halved(contents[largest])
            if len(smaller) >= len(contents[largest]):
                break
            contents[largest] = smaller
        if contents != self._contents:
            left_out.append("textures are shown smaller than they are, to keep this page small")
        return [{"type": _kind(content), "data": text(content)} for content in contents]


@functools.lru_cache(maxsize=16)  # the studio packs the same textures for every result
def _readable(content: bytes) -> bool:
    return decode_image(content) is not None


def _kind(content: bytes) -> str:
    return "image/png" if content.startswith(b"\x89PNG") else "image/jpeg"


def _halved(content: bytes) -> bytes:
    """A picture of half the width and height, as JPEG; the players paint no transparency."""
    image, written = decode_image(content), io.BytesIO()
    assert image is not None
    size = [max(side // 2, min(side, SMALLEST)) for side in image.size]
    image.resize((size[0], size[1])).save(written, "JPEG", quality=JPEG_QUALITY)
    return written.getvalue()
