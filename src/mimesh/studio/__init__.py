"""`mimesh studio`: a page on this machine on which meshes are moved, served until Ctrl-C.

Everything a page asks for happens in one temporary folder; files that are named on the command line are read in place.
"""

from __future__ import annotations

import contextlib
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path

import uvicorn

from ..core.errors import InputError
from ..methods.base import SkinnedMethod
from ..methods.find import find_method
from .app import make_app
from .security import AccessControl, new_token
from .session import Session
from .state import STUDIO_MODELS
from .uploads import UploadFolder

IN_ALL = 4
"""Uploads may take so many times the limit of one."""
PATIENCE = 1
"""Seconds that requests are given to end when the studio does."""


def serve(
    files: list[Path],
    *,
    host: str,
    port: int,
    limit: int,
    model: str,
    opened: bool,
    said: Callable[[str], None],
) -> None:
    """Serve a studio until it is told to end; nothing of it is left then.

    Args:
        files: meshes to move and, if there are several, last what to imitate; .onnx files are models.
        port: 0 takes a free one.
        limit: bytes of an uploaded file.
        opened: show the page in the browser.
        said: is told the address.

    Raises:
        InputError: a file or model that cannot be used, or a port that cannot be had.
    """
    desk, token = make_desk(files, limit, model), new_token()
    # Ctrl-C is how a studio ends; uvicorn raises it again after it has ended well.
    with contextlib.closing(desk), _listening(host, port) as listening, contextlib.suppress(KeyboardInterrupt):
        port = listening.getsockname()[1]
        address = f"http://{_shown_host(host)}:{port}/?token={token}"
        said(address)
        if opened:
            webbrowser.open(address)
        server = make_server(desk, token, host, port)
        server.run(sockets=[listening])


def make_server(desk: Session, token: str, host: str, port: int) -> uvicorn.Server:
    """What serves a desk to whoever has the token."""

    def closing() -> bool:
        return server.should_exit

    server = uvicorn.Server(
        uvicorn.Config(
            AccessControl(make_app(desk, closing), token, host, port),
            log_level="error",
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=PATIENCE,
        )
    )
    return server


def make_desk(files: list[Path], limit: int, model: str = "mime") -> Session:
    """A desk with these files on it, and their models to be chosen; see `serve`.

    Raises:
        InputError: a file that is not there, or a model that is none.
    """
    for file in files:
        if not file.exists():
            raise InputError(f"{file}: expected a file or folder, found nothing of that name; check the path")
    own = [str(file) for file in files if file.suffix == ".onnx"]
    models = tuple(dict.fromkeys((*STUDIO_MODELS, *own, model)))
    chosen = [name for name in models if name not in STUDIO_MODELS]
    jointed = tuple(name for name in chosen if isinstance(find_method(name), SkinnedMethod))
    given = [file for file in files if file.suffix != ".onnx"]
    desk = Session(UploadFolder(limit, IN_ALL * limit), models, model, jointed)
    with contextlib.ExitStack() as undo:
        undo.callback(desk.close)
        if len(given) > 1 or (given and given[0].is_dir()):
            driving = given.pop()
            desk.set_driving(driving, driving.resolve().name)
        if given:
            desk.add_identities(given)
        undo.pop_all()
    return desk


def _listening(host: str, port: int) -> socket.socket:
    """A socket that listens, so that the port is known before the server runs."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
        listening.listen()
    except OSError as error:
        listening.close()
        raise InputError(
            f"--host {host} --port {port}: expected a free port of this machine, found '{error.strerror}'; "
            "choose another, or leave both out"
        ) from error
    return listening


def _shown_host(host: str) -> str:
    if host in ("0.0.0.0", "::"):
        return "127.0.0.1" if host == "0.0.0.0" else "[::1]"
    return f"[{host}]" if ":" in host else host
