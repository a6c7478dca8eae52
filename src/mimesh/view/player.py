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
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from ..io.atomic import whole_file, writing
from ..mesh import Clip, Mesh
from .scene import BUDGET, Shown, pack_scene
from .stream import LEVEL, text

if TYPE_CHECKING:
    from ..result import ClipResult, Result

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
<div id="mimesh"><noscript><p class="refusal">This page draws with JavaScript, which is switched off here.</p></noscript>
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
    shown: Sequence[Shown],
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
    return PAGE.format(title=html.escape(title), style=style, scene=embedded(scene), script=script)


def write_player(path: str | Path, shown: Sequence[Shown], **options: Any) -> Path:
    """Write `player_page` into a file, whole or not at all."""
    page = player_page(shown, **options)
    with writing(Path(path)), whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return Path(path)


def result_panels(identity: Mesh, driving: Mesh | Clip, result: Result | ClipResult) -> list[Shown]:
    """Identity, driving and result as panels, each seen from the front that the report names."""
    own = {key: result.report["identity"][key] for key in ("up", "front")}
    theirs = {key: result.report["driving"][key] for key in ("up", "front")}
    played = driving if isinstance(driving, Clip) else Clip.still(driving)
    moved = getattr(result, "clip", None) or Clip.still(result.mesh)  # pyright: ignore[reportAttributeAccessIssue]
    return [
        Shown("identity", Clip.still(identity), **own),
        Shown("driving", played, **theirs),
        Shown("result", moved, name=f"{identity.name}, moved", **own),
    ]


def embedded(value: Any) -> str:
    """JSON that may stand in a script element: nothing in it can end the element or open a comment."""
    return json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def web_file(name: str) -> str:
    """A file of the built web pages."""
    return (files("mimesh.view") / "web" / name).read_text(encoding="utf-8")


def _download(download: Download | None, room: int) -> dict[str, Any]:
    if download is None:
        return {}
    name = os.path.basename(download.name)
    if download.content is not None:
        data = text(zlib.compress(download.content, LEVEL))
        if len(data) <= room:
            return {"name": name, "bytes": len(download.content), "data": data}
    return {"name": name, "href": quote(name)}
