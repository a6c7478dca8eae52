"""Where the bytes of a glTF file come from: the file, others beside it, data: URIs; large ones are paged in."""

from __future__ import annotations

import base64
import binascii
import mmap
import re
import tempfile
from pathlib import Path
from urllib.parse import unquote

from ...core.errors import InputError
from ...core.frame_buffer import LARGE
from ..beside import is_there

BASE64_BLOCK = 2**22
"""Characters that are decoded at once; a multiple of four."""


class MappedFiles:
    """The large files behind a document, mapped, so that what is not being read takes no memory."""

    def __init__(self) -> None:
        self.maps: list[mmap.mmap] = []
        self.cut: dict[str, memoryview] = {}
        """Large data: URIs that were taken out of the text, by what stands there instead."""

    def release_pages(self) -> None:
        """Give back the memory that has been read; the bytes stay."""
        for mapped in self.maps:
            if hasattr(mapped, "madvise"):
                mapped.madvise(mmap.MADV_DONTNEED)

    def read(self, path: Path) -> memoryview:
        """The bytes of a file."""
        if path.stat().st_size < LARGE:
            return memoryview(path.read_bytes())
        with path.open("rb") as file:
            return self._map(file.fileno())

    def fetch(self, uri: str, path: Path) -> bytes | memoryview | None:
        """The bytes behind a URI in the file `path`; None when there is no such file (the net is not asked)."""
        if uri in self.cut:
            return self.cut[uri]
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except binascii.Error as error:
                raise InputError(
                    f"{path}: expected base64 data in a data: URI, found {error}; export it again"
                ) from error
        for name in (unquote(uri), uri):  # some exporters write names as they are
            if uri and is_there(path.parent / name):
                return self.read(path.parent / name)
        return None

    def extract_large_uris(self, text: memoryview) -> bytes:
        """The JSON of a .gltf file, its large data: URIs decoded and replaced by short names."""
        kept, end = [], 0
        for found in re.finditer(rb'"data:[^",]*;base64,([A-Za-z0-9+/]{%d,}={0,2})"' % LARGE, text):
            name = f"data:{len(self.cut)}"
            self.cut[name] = self._decoded(text[found.start(1) : found.end(1)])
            kept += [text[end : found.start()], f'"{name}"'.encode()]
            end = found.end()
        return b"".join([*kept, text[end:]])

    def _decoded(self, characters: memoryview) -> memoryview:
        with tempfile.TemporaryFile() as file:
            for start in range(0, len(characters), BASE64_BLOCK):
                file.write(base64.b64decode(characters[start : start + BASE64_BLOCK]))
                self.release_pages()
            file.flush()
            return self._map(file.fileno())

    def _map(self, descriptor: int) -> memoryview:
        self.maps.append(mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ))
        return memoryview(self.maps[-1])
