"""One HTML file that plays meshes and clips side by side: offline, in any browser, with all that it needs inside."""

from __future__ import annotations

import html
import json
import os
import tempfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..core.errors import InputError
from ..core.mesh import Clip
from ..io import save_clip, save_mesh
from ..io.atomic import whole_file, writing
from ..pipeline.result import ClipResult, Result
from .encoding import LEVEL, text
from .pack import BUDGET, Shown, pack_scene

NOTEBOOK = 3 * 2**20
"""Bytes of a page in a notebook."""
LARGEST = 32 * 2**20
"""Bytes from which on a file is not tried to be put into a page."""
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
    # Names of files may hold bytes that are no text.
    plain = html.escape(title).encode("ascii", "xmlcharrefreplace").decode("ascii")
    return PAGE.format(title=plain, style=style, scene=embedded(scene), script=script)


def write_player(path: str | Path, shown: Sequence[Shown], **options: Any) -> Path:
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


def write_result(
    result: Result | ClipResult, path: Path, download: Download | None = None, title: str | None = None
) -> Path:
    """Write the page of a result: identity, driving and result, with the model and the notes of its report.

    Its title is the name of the path up to the first dot, unless another is given.

    Raises:
        InputError: the result does not know its identity and driving, or the path cannot be written.
    """
    shown = result_panels(result)
    if shown is None:
        raise InputError(
            f"{path}: expected a result of transfer or animate, found one without its inputs; run it again"
        )
    return write_player(path, shown, title=title or path.name.split(".")[0], download=download, **_words(result))


def notebook_frame(result: Result | ClipResult) -> str | None:
    """The page of a result as a frame for notebooks, small so that they stay light; None where it knows no inputs."""
    shown = result_panels(result)
    if shown is None:
        return None
    page = player_page(shown, title=shown[0].clip.mesh.name, budget=NOTEBOOK, **_words(result))
    style = "width:100%;height:520px;border:0;border-radius:12px"
    return f'<iframe srcdoc="{html.escape(page)}" style="{style}" title="mimesh player"></iframe>'


def result_panels(result: Result | ClipResult) -> list[Shown] | None:
    """Identity, driving and result as panels, each seen from the front that the report names; None without inputs."""
    if result.identity is None or result.driving is None:
        return None
    own, theirs = ({key: result.report[which][key] for key in ("up", "front")} for which in ("identity", "driving"))
    driving = result.driving if isinstance(result.driving, Clip) else Clip.still(result.driving)
    moved = Clip.still(result.mesh) if isinstance(result, Result) else result.clip
    return [
        Shown("identity", Clip.still(result.identity), **own),
        Shown("driving", driving, **theirs),
        Shown("result", moved, **own),
    ]


def download_of(result: Result | ClipResult, output: Path) -> Download:
    """The result for the page's button: the .glb that was written, else one made of it, else a link to the output."""
    frames = 1 if isinstance(result, Result) else len(result.clip)
    if output.suffix.lower() == ".glb":
        content = output.read_bytes() if output.stat().st_size <= LARGEST else None
        return Download(output.name, content)
    mesh = result.mesh if isinstance(result, Result) else result.clip.mesh
    if frames * mesh.vertices.size * 4 > LARGEST:
        return Download(output.name, None)
    return Download(f"{output.stem}.glb", _made(result))


def _made(result: Result | ClipResult) -> bytes:
    """The bytes of a new .glb of a result."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.glb"
        if isinstance(result, Result):
            save_mesh(result.mesh, path)
        else:
            save_clip(result.clip, path)
        return path.read_bytes()


def _words(result: Result | ClipResult) -> dict[str, Any]:
    return {"model": result.model, "notes": result.notes}


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
