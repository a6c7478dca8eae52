"""Reads the bytes of a glTF file, of files beside it and of data: URIs; large ones are memory-mapped.

A mapped file takes only the memory of the pages that are being read.
"""

from __future__ import annotations

import base64
import mmap
import re
import tempfile
from pathlib import Path
from urllib.parse import unquote

from ...core.errors import InputError
from ...core.frame_buffer import LARGE
from ..beside import is_there

DECODE_BLOCK = 2**22
"""Base64 characters that are decoded at once; a multiple of four, so that blocks end between bytes."""


class MappedFiles:
    """The files and large data: URIs of one document, memory-mapped from `frame_buffer.LARGE` bytes on."""

    def __init__(self) -> None:
        self.maps: list[mmap.mmap] = []
        """All maps, for `release_pages`; each lives as long as a view of it."""
        self.extracted: dict[str, memoryview] = {}
        """Contents of large data: URIs, by the short URI that replaces each in the JSON."""

    def release_pages(self) -> None:
        """Release the memory of the pages that have been read; the data stays readable."""
        for mapped in self.maps:
            if hasattr(mapped, "madvise"):
                mapped.madvise(mmap.MADV_DONTNEED)

    def read(self, path: Path) -> memoryview:
        """Return the bytes of a file, mapped where it is large."""
        if path.stat().st_size < LARGE:
            return memoryview(path.read_bytes())
        with path.open("rb") as file:
            return self._map(file.fileno())

    def fetch(self, uri: str, path: Path) -> bytes | memoryview | None:
        """Return the bytes behind a URI of the document `path`; None where there is no such file.

        Only data: URIs and files are read; nothing is ever fetched from the network.

        Raises:
            InputError: a data: URI is not valid base64.
        """
        if uri in self.extracted:
            return self.extracted[uri]
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except ValueError as error:  # binascii.Error, or characters that are not ASCII
                raise InputError(
                    f"{path}: expected base64 data in a data: URI, found {error}; export it again"
                ) from error
        for name in (unquote(uri), uri):  # URIs are percent-encoded, but some exporters write names without encoding
            if uri and is_there(path.parent / name):
                return self.read(path.parent / name)
        return None

    def extract_large_uris(self, text: memoryview) -> bytes:
        """Decode the large data: URIs in the text of a .gltf file; returns its JSON with short URIs instead.

        Done before the text is parsed, so that the JSON parser never holds the base64 characters in memory.
        """
        pieces, end = [], 0
        for found in re.finditer(rb'"data:[^",]*;base64,([A-Za-z0-9+/]{%d,}={0,2})"' % LARGE, text):
            uri = f"data:{len(self.extracted)}"
            self.extracted[uri] = self._decode(text[found.start(1) : found.end(1)])
            pieces += [text[end : found.start()], f'"{uri}"'.encode()]
            end = found.end()
        return b"".join([*pieces, text[end:]])

    def _decode(self, characters: memoryview) -> memoryview:
        """Decode base64 into a temporary file, block by block, and map that file."""
        with tempfile.TemporaryFile() as file:
            for start in range(0, len(characters), DECODE_BLOCK):
                file.write(base64.b64decode(characters[start : start + DECODE_BLOCK]))
                self.release_pages()
            file.flush()
            return self._map(file.fileno())

    def _map(self, descriptor: int) -> memoryview:
        self.maps.append(mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ))
        return memoryview(self.maps[-1])
