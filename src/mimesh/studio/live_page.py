"""A page in the browser that shows the frames of a live session as they are made, served on this machine only.

The page is the player with one pose in each panel (`web/player/live.js`). It asks for the newest frame again and again;
frames that come faster than it draws are skipped, and nothing is stored but the newest.
"""

from __future__ import annotations

import asyncio
import html
import threading
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from ..core.errors import InputError
from ..core.mesh import Clip
from ..pipeline.live import LiveSession
from ..view.pack import Panel, pack_scene
from ..view.page import embed_json
from . import open_socket, page_address, quiet_server
from .app import web_file
from .security import AccessControl, new_token

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="/static/player.css">
</head>
<body>
<div id="mimesh"></div>
<script type="application/json" id="mimesh-scene">{scene}</script>
<script src="/static/player.js"></script>
</body>
</html>
"""
SERVED = ("player.js", "player.css")
"""Files of the web bundle that are served."""
UNLIMITED = 2**40
"""Size of a scene in bytes that nothing is left out for: a frame of the stream has all vertices."""
POLL_SECONDS = 0.004
"""Seconds between two checks for a new frame: a quarter of a frame at 60 Hz."""
TIMEOUT = 10.0
"""Seconds after which a request is answered without a frame."""


@dataclass(frozen=True)
class StreamFrame:
    """Vertices of all panels in one frame, as they are sent."""

    number: int
    content: bytes


class LivePage:
    """The page of a session. It is served until `close`, or the end of the `with` block."""

    def __init__(self, session: LiveSession, *, host: str = "127.0.0.1", port: int = 0) -> None:
        """Start to serve; `address` is that of the page.

        Args:
            session: whose identity and driving mesh are shown.
            host: address of this machine to listen on. The default admits this machine only; others admit everybody
                on that network who has the address of the page.
            port: 0 for any free one.

        Raises:
            InputError: the port is not available.
        """
        self._shapes = session.driving.vertices.shape, session.identity.vertices.shape
        self._newest: StreamFrame | None = None
        self._page = _page(session)
        token, listening = new_token(), open_socket(host, port)
        port = listening.getsockname()[1]
        self.address = page_address(host, port, token)
        self._server = quiet_server(AccessControl(self._application(), token, host, port))
        self._thread = threading.Thread(target=self._server.run, args=([listening],), daemon=True)
        self._thread.start()
        while not self._server.started and self._thread.is_alive():
            time.sleep(POLL_SECONDS)

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def show(self, driving: Float[np.ndarray, "U 3"], result: Float[np.ndarray, "V 3"]) -> None:
        """Make this the frame that the page shows; returns at once.

        Args:
            driving: vertices of the driving mesh, in its file's coordinates.
            result: vertices that the session has made of them.

        Raises:
            InputError: another number of vertices than the session's.
        """
        if (found := (np.shape(driving), np.shape(result))) != self._shapes:
            raise InputError(f"page: expected vertices of shapes {self._shapes}, found {found}; start a page for these")
        content = b"".join(np.asarray(points, "<f4").tobytes() for points in (driving, result))
        number = 1 if self._newest is None else self._newest.number + 1
        self._newest = StreamFrame(number, content)

    def close(self) -> None:
        """Stop serving."""
        self._server.should_exit = True
        self._thread.join()

    def _application(self) -> Starlette:
        routes = [Route("/", self._serve_page), Route("/static/{name}", _file), Route("/frame", self._serve_frame)]
        return Starlette(routes=routes)

    async def _serve_page(self, request: Request) -> Response:
        return HTMLResponse(self._page)

    async def _serve_frame(self, request: Request) -> Response:
        """Answer with the newest frame as soon as its number is another than `?after=`; 204 if there is none."""
        after, until = request.query_params.get("after", ""), time.monotonic() + TIMEOUT
        while not self._server.should_exit and time.monotonic() < until:
            newest = self._newest
            if newest is not None and str(newest.number) != after:
                headers = {"x-frame": str(newest.number)}
                return Response(newest.content, media_type="application/octet-stream", headers=headers)
            await asyncio.sleep(POLL_SECONDS)
        return Response(status_code=204)


def _page(session: LiveSession) -> str:
    """Build the page with the first frame that the session was prepared with, in which both meshes have one pose."""
    posed = session.identity.with_vertices(session.pose(session.driving))
    axes: list[dict[str, Any]] = [
        {key: session.report[which][key] for key in ("up", "front")} for which in ("driving", "identity")
    ]
    panels = [
        Panel("driving", Clip.still(session.driving), **axes[0]),
        Panel("result", Clip.still(posed), **axes[1]),
    ]
    title = f"{session.driving.name} moves {session.identity.name}"
    scene = pack_scene(panels, title=title, model=session.model, notes=session.notes, budget=UNLIMITED)
    escaped = html.escape(title).encode("ascii", "xmlcharrefreplace").decode("ascii")
    return PAGE.format(title=escaped, scene=embed_json({**scene, "live": "/frame"}))


async def _file(request: Request) -> Response:
    name = request.path_params["name"]
    return web_file(name) if name in SERVED else Response(status_code=404)
