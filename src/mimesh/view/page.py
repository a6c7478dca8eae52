"""Writes one HTML file that plays meshes and clips side by side, in any browser and without a network."""

from __future__ import annotations

import base64
import hashlib
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
from .encoding import LEVEL, to_base64
from .pack import ANY_LENGTH, BUDGET, MotionLimits, Panel, pack_scene

NOTEBOOK_BUDGET = 3 * 2**20
"""Size of a page in a notebook in bytes; notebooks store it in every output."""
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="mimesh">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
</head>
<body>
<div id="mimesh">
<noscript><p class="refusal">This page needs JavaScript, which is switched off in this browser.</p></noscript>
</div>
<script type="application/json" id="mimesh-scene">{scene}</script>
<script>{script}</script>
</body>
</html>
"""
POLICY = (
    "default-src 'none'",
    "script-src {script}",
    "style-src {style}",
    "img-src data: blob:",
    "base-uri 'none'",
    "form-action 'none'",
)
"""Content security policy of the page: it runs its own script alone, and loads and sends nothing."""


@dataclass(frozen=True)
class Download:
    """The file of the page's download button: embedded if it fits, else a link to the file beside the page."""

    name: str
    content: bytes | None
    """None for a link."""


def player_page(
    panels: Sequence[Panel],
    *,
    title: str,
    model: str = "",
    notes: Sequence[str] = (),
    download: Download | None = None,
    budget: int = BUDGET,
    motion: MotionLimits = ANY_LENGTH,
) -> str:
    """Build the page as HTML text; same input, same text.

    Args:
        model: name of the model, shown beside the title.
        notes: messages shown below the panels.
        download: a file that the page offers; it may take half of the budget.
        budget: size of the page in bytes; see `pack_scene` for what is reduced.
    """
    script, style = web_file("player.js"), web_file("player.css")
    # What the page itself leaves: script and style take about 0.6 MB.
    available = budget - len(script) - len(style) - len(PAGE)
    packed_download = _pack_download(download, available // 2)
    scene_budget = available - len(packed_download.get("data") or "")
    scene = pack_scene(panels, title=title, model=model, notes=notes, budget=scene_budget, motion=motion)
    scene["download"] = packed_download or None
    # File names may contain bytes that are not valid text (surrogate escapes).
    escaped_title = html.escape(title).encode("ascii", "xmlcharrefreplace").decode("ascii")
    policy = "; ".join(POLICY).format(script=_source_hash(script), style=_source_hash(style))
    # Without `<`, nothing in the JSON can end its script element or open a comment.
    packed = json.dumps(scene, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return PAGE.format(policy=policy, title=escaped_title, style=style, scene=packed, script=script)


def write_player(path: str | Path, panels: Sequence[Panel], **options: Any) -> Path:
    """Write `player_page` to a file, completely or not at all."""
    if Path(path).suffix.lower() != ".html":
        found = Path(path).suffix
        raise InputError(f"{path}: expected a name that ends in .html, found '{found}'; name the page so")
    page = player_page(panels, **options)
    with writing(Path(path)), whole_file(path) as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")
    return Path(path)


def notebook_frame(panels: Sequence[Panel], **options: Any) -> str:
    """Build a page as an `iframe` for notebooks, of at most NOTEBOOK_BUDGET bytes."""
    page = player_page(panels, title=panels[0].clip.mesh.name, budget=NOTEBOOK_BUDGET, **options)
    style = "width:100%;height:520px;border:0;border-radius:12px"
    return f'<iframe srcdoc="{html.escape(page)}" style="{style}" title="mimesh player"></iframe>'


def web_file(name: str) -> str:
    """Read a file of the web bundle."""
    return (files("mimesh.view") / "web" / name).read_text(encoding="utf-8")


def _source_hash(text: str) -> str:
    """Return the source of a policy that admits the inline script or style of this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _pack_download(download: Download | None, budget: int) -> dict[str, Any]:
    """Pack the file in at most `budget` characters, else a link to it; empty without one."""
    if download is None:
        return {}
    name = os.path.basename(download.name)
    if download.content is not None:
        data = to_base64(zlib.compress(download.content, LEVEL))
        if len(data) <= budget:
            return {"name": name, "bytes": len(download.content), "data": data}
    return {"name": name, "href": quote(os.fsencode(name))}
