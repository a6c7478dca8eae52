"""The command `mimesh studio`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ..core.printable import say
from .terminal import Json, Model, Quiet, print_json, require

LOOPBACK = ("127.0.0.1", "::1", "localhost")


def studio(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]...", help="Meshes to move and, last of several, what to imitate; .onnx models."),
    ] = None,
    model: Model = "mime",
    port: Annotated[int, typer.Option(help="Where to listen; by default a port that is free.", min=0, max=65535)] = 0,
    host: Annotated[str, typer.Option(help="Another address than this machine's own: others can then reach it.")] = (
        "127.0.0.1"
    ),
    limit: Annotated[int, typer.Option(metavar="MIB", help="Size of a file that may be dropped.", min=1)] = 512,
    opened: Annotated[bool, typer.Option("--open/--no-open", help="Show the page in the browser.")] = True,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Move meshes on a page of this machine: drop files, choose a model, watch, export.

    Ends with Ctrl-C and leaves nothing behind; FILEs are read and never changed. The address it prints opens it.
    """
    require("viewer", "starlette", "uvicorn")
    from ..studio import serve

    if host not in LOOPBACK:
        say(
            f"warning: others in the network of {host} can reach this studio, and read what passes; whoever has the "
            "address below can use it",
            error=True,
        )

    def announce(address: str) -> None:
        if json:
            print_json({"address": address})
        else:
            say(f"studio: {address}", *([] if quiet else ["Ctrl-C ends it"]))
        sys.stdout.flush()

    serve(
        files or [],
        host=host,
        port=port,
        limit=limit * 2**20,
        model=model,
        open_browser=opened,
        report_address=announce,
    )
