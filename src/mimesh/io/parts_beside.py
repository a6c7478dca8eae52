"""List the files that a mesh or clip consists of besides its own: libraries, buffers, layers, the mesh of a cache."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import unquote

from .beside import find_beside
from .formats import CACHE, FRAME_SUFFIXES
from .obj import library_names

USD_LAYERS = (".usd", ".usda", ".usdc", ".usdz")


def parts_beside(path: Path) -> list[Path]:
    """List the files beside a mesh or clip that its geometry, materials or layers are in; textures are left out.

    A layer of USD may name any other, so all in its folder are listed. A file that cannot be read has none.
    """
    folder, suffix = path.parent, path.suffix.lower()
    if suffix == ".obj":
        lines = [line for line in path.read_bytes().splitlines() if line.lstrip().startswith(b"mtllib")]
        names = library_names(lines, range(len(lines)), folder)
    elif suffix == ".gltf":
        try:
            uris = [buffer.get("uri", "data:") for buffer in json.loads(path.read_bytes())["buffers"]]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return []
        found = [find_beside(folder, (unquote(uri), uri)) for uri in uris if not uri.startswith("data:")]
        names = [name for name in found if name]
    elif suffix == CACHE:
        names = [path.stem + other for other in FRAME_SUFFIXES]
    elif suffix in USD_LAYERS:
        names = [file.name for file in folder.glob("*") if file.suffix.lower() in USD_LAYERS and file != path]
    else:
        return []
    return sorted(folder / name for name in names)
