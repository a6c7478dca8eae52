"""Textures of a page: each once, as its file has it, or smaller where there is no room for that."""

from __future__ import annotations

import io
from typing import Any

from .stream import text

JPEG_QUALITY = 86
SMALLEST = 256
"""Pixels; sides of textures are not halved below it."""


class Pictures:
    """Collects the textures of the panels, each once."""

    def __init__(self) -> None:
        self._contents: list[bytes] = []

    def number(self, content: bytes | None) -> int | None:
        """The place of a texture among all; None where there is none."""
        if content is None:
            return None
        if content not in self._contents:
            self._contents.append(content)
        return self._contents.index(content)

    def packed(self, room: int, left_out: list[str]) -> list[dict[str, Any]]:
        """All textures in about `room` letters, large ones halved again and again; words about that in `left_out`."""
        contents = list(self._contents)
        while 4 / 3 * sum(map(len, contents)) > room:
            largest = max(range(len(contents)), key=lambda k: len(contents[k]))
            smaller = _halved(contents[largest])
            if len(smaller) >= len(contents[largest]):
                break
            contents[largest] = smaller
        if contents != self._contents:
            left_out.append("textures are shown smaller than they are, to keep this page small")
        return [{"type": _kind(content), "data": text(content)} for content in contents]


def _kind(content: bytes) -> str:
    return "image/png" if content.startswith(b"\x89PNG") else "image/jpeg"


def _halved(content: bytes) -> bytes:
    """A picture of half the width and height, as JPEG; the players paint no transparency."""
    from PIL import Image

    with Image.open(io.BytesIO(content)) as image:
        size = [max(side // 2, min(side, SMALLEST)) for side in image.size]
        written = io.BytesIO()
        image.convert("RGB").resize((size[0], size[1])).save(written, "JPEG", quality=JPEG_QUALITY)
    return written.getvalue()
