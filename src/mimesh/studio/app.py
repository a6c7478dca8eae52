"""The studio's routes: the page, its state, uploads, options, meshes for the stage, and exports.

Whatever goes wrong is answered as {"error": one line}: 404 nothing of that name, 409 no longer wanted, 413 too large,
422 the input is wrong, 500 a bug of ours.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from ..core.errors import InputError
from .jobs import Cancelled, words
from .session import Session
from .state import described, scene
from .uploads import TooLarge, Upload, called, clip, meshes

PATIENCE = 20.0
"""Seconds that a question for the state may wait for a change."""
LOOKS = 0.02
"""Seconds between two looks at whether there is one."""
LARGEST = 2**16
"""Bytes of a request that is not a file."""
DEMO = {"what": "both", "character": "dancer", "motion": "jump"}
PAGE = "studio.html"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
SERVED = (PAGE, "player.js", "studio.js", "studio.css")

Handler = Callable[[Request], Awaitable[Response]]


def make_app(desk: Session, closing: Callable[[], bool]) -> Starlette:
    """The application, to be put behind a Guard; `closing` says whether the server ends."""
    routes = Routes(desk, closing)
    table: list[tuple[str, str, Handler]] = [
        ("GET", "/", routes.page),
        ("GET", "/static/{name}", routes.page),
        ("GET", "/api/state", routes.state),
        ("POST", "/api/uploads", routes.begin_upload),
        ("PUT", "/api/uploads/{number:int}", routes.receive),
        ("POST", "/api/uploads/{number:int}/{role}", routes.end_upload),
        ("DELETE", "/api/uploads/{number:int}", routes.give_up),
        ("POST", "/api/demo", routes.demo),
        ("POST", "/api/options", routes.options),
        ("POST", "/api/meshes/{number:int}", routes.change),
        ("DELETE", "/api/meshes/{number:int}", routes.remove),
        ("POST", "/api/meshes/{number:int}/pose", routes.pose),
        ("POST", "/api/meshes/{number:int}/stop", routes.stop),
        ("GET", "/api/scene", routes.scene),
        ("POST", "/api/exports", routes.export),
        ("GET", "/api/exports/{number:int}", routes.fetch),
        ("DELETE", "/api/exports/{number:int}", routes.remove_export),
    ]
    return Starlette(
        routes=[Route(path, _in_words(handler), methods=[method]) for method, path, handler in table],
        exception_handlers={404: _nothing_there, 405: _nothing_there},
    )


class Routes:
    """What is done for each request."""

    def __init__(self, desk: Session, closing: Callable[[], bool]) -> None:
        self._desk, self._closing = desk, closing

    async def _unless_closing(self, future: Awaitable[Any]) -> Any:
        """What a future gives; Dropped as soon as the server ends, which then need not wait for it."""
        waiting = asyncio.ensure_future(future)
        while not waiting.done():
            if self._closing():
                raise Cancelled
            await asyncio.wait([waiting], timeout=LOOKS)
        return waiting.result()

    async def _in_thread(self, work: Callable[..., Any], *args: Any) -> Any:
        """What a function gives that takes its time; its thread does not keep the server from ending."""
        future: Future = Future()

        def done() -> None:
            try:
                future.set_result(work(*args))
            except Exception as error:
                future.set_exception(error)

        threading.Thread(target=done, daemon=True).start()
        return await self._unless_closing(asyncio.wrap_future(future))

    async def page(self, request: Request) -> Response:
        name = request.path_params.get("name", PAGE)
        if name not in SERVED:
            raise LookupError(name)
        file = resources.files("mimesh.player") / "web" / name
        return Response(file.read_bytes(), media_type=TYPES[Path(name).suffix])

    async def state(self, request: Request) -> Response:
        """Everything the page shows, once its version is another than `?since=`."""
        since = request.query_params.get("since", "")
        waited = 0.0
        while str(self._desk.version) == since and waited < PATIENCE and not self._closing():
            await asyncio.sleep(LOOKS)
            waited += LOOKS
        return JSONResponse(described(self._desk))

    async def begin_upload(self, request: Request) -> Response:
        return JSONResponse({"upload": self._desk.workplace.new_upload().number})

    async def receive(self, request: Request) -> Response:
        """One file of an upload, as it is, under `?name=`."""
        upload = self._desk.workplace.upload(request.path_params["number"])
        path = self._desk.workplace.place(upload, request.query_params.get("name", ""))
        size = await _stored(self._desk, upload, path, request)
        return JSONResponse({"name": path.name, "bytes": size})

    async def end_upload(self, request: Request) -> Response:
        """All files are there: what they are for is `identity` or `driving`."""
        number, role = request.path_params["number"], request.path_params["role"]
        if role not in ("identity", "driving"):
            raise LookupError(role)
        upload = self._desk.workplace.upload(number)
        try:
            added = await self._in_thread(_laid, self._desk, upload, role)
        except InputError:
            self._desk.workplace.remove_upload(number)
            raise
        return JSONResponse({"meshes": added})

    async def give_up(self, request: Request) -> Response:
        number = request.path_params["number"]
        if self._desk.uses(number):
            raise InputError(f"upload {number}: expected one that is not on the desk, found it there; remove the mesh")
        self._desk.workplace.remove_upload(number)
        return JSONResponse({})

    async def demo(self, request: Request) -> Response:
        from ..bodies.characters import CHARACTERS
        from ..motions import load_motion

        given = await _json(request)
        what, name, motion = (str(given.get(key, usual)) for key, usual in DEMO.items())
        if name not in CHARACTERS:
            raise InputError(f"character: expected one of {', '.join(CHARACTERS)}, found {name[:60]!r}; choose one")
        await self._in_thread(load_motion, motion)
        self._desk.use_demo(what, name, motion)
        return JSONResponse({})

    async def options(self, request: Request) -> Response:
        self._desk.set_options(await _json(request))
        return JSONResponse({})

    async def change(self, request: Request) -> Response:
        self._desk.set_item(request.path_params["number"], await _json(request))
        return JSONResponse({})

    async def remove(self, request: Request) -> Response:
        self._desk.remove(request.path_params["number"])
        return JSONResponse({})

    async def stop(self, request: Request) -> Response:
        self._desk.stop(request.path_params["number"])
        return JSONResponse({})

    async def pose(self, request: Request) -> Response:
        """Positions of a mesh in one frame, (V, 3) little-endian float32."""
        frame = (await _json(request)).get("frame", 0)
        if isinstance(frame, bool) or not isinstance(frame, int):
            raise InputError(f"frame: expected a whole number, found {frame!r}; give one")
        vertices = await self._unless_closing(
            asyncio.wrap_future(self._desk.pose(request.path_params["number"], frame))
        )
        return Response(np.asarray(vertices, "<f4").tobytes(), media_type="application/octet-stream")

    async def scene(self, request: Request) -> Response:
        """What the stage shows, packed for the player."""
        return JSONResponse(await self._in_thread(scene, self._desk))

    async def export(self, request: Request) -> Response:
        given = await _json(request)
        shapes, numbers = given.get("blendshapes"), given.get("meshes") or []
        if shapes is not None and (isinstance(shapes, bool) or not isinstance(shapes, int) or shapes < 1):
            raise InputError(f"blend shapes: expected a whole number, 1 or more, found {shapes!r}; give one")
        if not isinstance(numbers, list) or not all(isinstance(number, int) for number in numbers):
            raise InputError("meshes: expected numbers of meshes, found something else; reload the page")
        suffix, skinned = str(given.get("suffix", ".glb")), given.get("skinned") is True
        return JSONResponse({"export": self._desk.export(suffix, numbers, skinned, shapes)})

    async def fetch(self, request: Request) -> Response:
        export = self._desk.exports.get(request.path_params["number"])
        if export is None or export.path is None:
            raise LookupError("export")
        return FileResponse(export.path, filename=export.path.name, media_type="application/octet-stream")

    async def remove_export(self, request: Request) -> Response:
        self._desk.remove_export(request.path_params["number"])
        return JSONResponse({})


def _in_words(handler: Handler) -> Handler:
    """What a handler raises, answered as it is said in the module's docstring."""

    async def answer(request: Request) -> Response:
        try:
            return await handler(request)
        except TooLarge as error:
            return JSONResponse({"error": words(error)}, 413)
        except InputError as error:
            return JSONResponse({"error": words(error)}, 422)
        except Cancelled:
            return JSONResponse({"error": "no longer wanted"}, 409)
        except LookupError:
            return JSONResponse({"error": "nothing of that name is here"}, 404)

    return answer


async def _nothing_there(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": "nothing of that name is here"}, 404)


def _laid(desk: Session, upload: Upload, role: str) -> list[int]:
    """Unpack an upload if need be, and lay it on the desk."""
    for archive in [path for path in upload.files if path.suffix.lower() == ".zip"]:
        desk.workplace.unzip(upload, archive)
    if not upload.files:
        raise InputError("upload: expected a file, found none; choose one")
    if role == "identity":
        return desk.add_identities(meshes(upload.files), upload.number)
    path = clip(upload.files)
    return [desk.set_driving(path, called(path, upload), upload.number)]


async def _stored(desk: Session, upload: Upload, path: Path, request: Request) -> int:
    """Write the body of a request to a file, counted; nothing is left of one that is too large or breaks off."""
    size = whole = 0
    try:
        announced = request.headers.get("content-length", "")
        desk.workplace.check(path, int(announced) if announced.isdigit() else 0)
        with path.open("xb") as file:
            async for chunk in request.stream():
                desk.workplace.count(upload, path, size, len(chunk))
                size += len(chunk)
                file.write(chunk)
        whole = 1
    except ClientDisconnect as error:
        raise InputError(f"{path.name}: expected the whole file, found that it broke off; send it again") from error
    finally:
        if not whole:
            desk.workplace.remove_file(upload, path, size)
    return size


async def _json(request: Request) -> dict[str, Any]:
    """A small JSON object."""
    import json

    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > LARGEST:
            raise TooLarge(f"request: expected {LARGEST} bytes or fewer, found more; send less")
    try:
        given = json.loads(body or b"{}")
    except (ValueError, RecursionError) as error:
        raise InputError(f"request: expected JSON, found '{error}'; send an object") from error
    if not isinstance(given, dict):
        raise InputError("request: expected a JSON object, found something else; send an object")
    return given
