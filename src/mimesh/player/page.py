"""One HTML file that plays meshes and clips side by side: offline, in any browser, with all that it needs inside."""

from __future__ import annotations

import html
import json
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..core.errors import InputError
from ..io.atomic import whole_file, writing
from .encoding import LEVEL, text
from .pack import BUDGET, Panel, pack_scene

NOTEBOOK = 3 * 2**20
"""Bytes of a page in a notebook."""
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="mimesh">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
</head>
<body>
<div id="mimesh">
<noscript><p class="refusal">This page draws with JavaScript, which is switched off here.</p></noscript>
</div>
<script type="application/json" id="mimesh-scene">{scene}</script>
<script>{script}</script>
</body>
</html>
"""


@dataclass(frozen=True)
class Download:
    """What the page's button gives: a file's bytes where they fit, else a link to the file beside the page."""

    name: str
    content: bytes | None
    """None: link to it."""


def player_page(
    shown: Sequence[Panel],
    *,
    title: str,
    model: str = "",
    notes: Sequence[str] = (),
    download: Download | None = None,
    budget: int = BUDGET,
) -> str:
    """The page as text; same input, same text. See `pack_scene` for what `budget` (bytes of the page) does.

    Raises:
        InputError: no panel, or a role that is none.
    """
    script, style = web_file("player.js"), web_file("player.css")
    room = budget - len(script) - len(style) - len(PAGE)
    given = _download(download, room // 2)
    scene = pack_scene(shown, title=title, model=model, notes=notes, budget=room - len(given.get("data") or ""))
    scene["download"] = given or None
    # Names of files may hold bytes that are no text.
    plain = html.escape(title).encode("ascii", "xmlcharrefreplace").decode("ascii")
    return PAGE.format(title=plain, style=style, scene=embedded(scene), script=script)


def write_player(path: str | Path, shown: Sequence[Panel], **options: Any) -> Path:
    """Write `player_page` into a file, whole or not at all.

    Raises:
        InputError: as `player_page`, a name that does not end in .html, or a path that cannot be written.
    """
    if Path(path).suffix.lower() != ".html":
        found = Path(path).suffix
        raise InputError(f"{path}: expected a name that ends in .html, found '{found}'; name the page so")
    page = player_page(shown, **options)
    with writing(Path(path)), whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return Path(path)


def notebook_frame(shown: Sequence[Panel], **options: Any) -> str:
    """A page as an `iframe` for notebooks, of at most NOTEBOOK bytes."""
    page = player_page(shown, title=shown[0].clip.mesh.name, budget=NOTEBOOK, **options)
    style = "width:100%;height:520px;border:0;border-radius:12px"
    return f'<iframe srcdoc="{html.escape(page)}" style="{style}" title="mimesh player"></iframe>'


def embedded(value: Any) -> str:
    """JSON that may stand in a script element: nothing in it can end the element or open a comment."""
    return json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def web_file(name: str) -> str:
    """A file of the built web pages."""
    return (files("mimesh.player") / "web" / name).read_text(encoding="utf-8")


def _download(download: Download | None, room: int) -> dict[str, Any]:
    if download is None:
        return {}
    name = os.path.basename(download.name)
    if download.content is not None:
        data = text(zlib.compress(download.content, LEVEL))
        if len(data) <= room:
            return {"name": name, "bytes": len(download.content), "data": data}
    return {"name": name, "href": quote(os.fsencode(name))}
