"""`mimesh studio`: a local web page for moving meshes, served until Ctrl-C.

Uploads and exports are in one temporary folder; files of the command line are read in place and never changed.
"""

from __future__ import annotations

import contextlib
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path

import uvicorn

from ..core.errors import InputError
from ..methods.find import moves_joints
from .app import make_app
from .security import AccessControl, new_token
from .session import Session
from .state import STUDIO_MODELS
from .uploads import UploadFolder

TOTAL_FACTOR = 4
"""Limit of all uploads together, as a multiple of the limit of one file."""
SHUTDOWN_SECONDS = 1
"""Time that running requests have to finish when the studio ends."""


def serve(
    files: list[Path],
    *,
    host: str,
    port: int,
    limit: int,
    model: str,
    open_browser: bool,
    report_address: Callable[[str], None],
) -> None:
    """Serve a studio until it is interrupted; its temporary files are deleted then.

    Args:
        files: meshes to move; the last of several is the driving clip. Files ending in .onnx are models.
        port: 0 for any free one.
        limit: largest size of an uploaded file in bytes.
        report_address: called with the address, token included, once the port is open.

    Raises:
        InputError: a file or model that cannot be used, or a port that is not available.
    """
    session, token = make_session(files, limit, model), new_token()
    # Ctrl-C is how a studio ends; uvicorn raises it again after it has ended well.
    with contextlib.closing(session), open_socket(host, port) as listening, contextlib.suppress(KeyboardInterrupt):
        port = listening.getsockname()[1]
        address = page_address(host, port, token)
        report_address(address)
        if open_browser:
            webbrowser.open(address)
        server = make_server(session, token, host, port)
        server.run(sockets=[listening])


def make_server(session: Session, token: str, host: str, port: int) -> uvicorn.Server:
    """Build the web server of a session; the token is needed to use it."""

    def is_closing() -> bool:
        return server.should_exit

    app = AccessControl(make_app(session, is_closing), token, host, port)
    quiet = {"log_level": "error", "access_log": False, "server_header": False}
    server = uvicorn.Server(uvicorn.Config(app, timeout_graceful_shutdown=SHUTDOWN_SECONDS, **quiet))
    return server


def make_session(files: list[Path], limit: int, model: str = "mime") -> Session:
    """Start a session with files, models among them, as `serve` takes them."""
    for file in files:
        if not file.exists():
            raise InputError(f"{file}: expected a file or folder, found nothing of that name; check the path")
    onnx_models = [str(file) for file in files if file.suffix == ".onnx"]
    models = tuple(dict.fromkeys((*STUDIO_MODELS, *onnx_models, model)))
    other_models = [name for name in models if name not in STUDIO_MODELS]
    skinned_models = tuple(name for name in other_models if moves_joints(name))
    meshes = [file for file in files if file.suffix != ".onnx"]
    session = Session(UploadFolder(limit, TOTAL_FACTOR * limit), models, model, skinned_models)
    with contextlib.ExitStack() as undo:
        undo.callback(session.close)
        if len(meshes) > 1 or (meshes and meshes[0].is_dir()):
            driving = meshes.pop()
            session.set_driving(driving, driving.resolve().name)
        if meshes:
            session.add_identities(meshes)
        undo.pop_all()
    return session


def open_socket(host: str, port: int) -> socket.socket:
    """Open a listening socket, so that the port is known and works before its address is printed."""
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


def page_address(host: str, port: int, token: str) -> str:
    """Return the address of a page with its token: this machine's own for wildcard addresses, IPv6 in brackets."""
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1" if host == "0.0.0.0" else "::1"
    name = f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/?token={token}"
