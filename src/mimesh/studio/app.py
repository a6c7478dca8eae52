"""The HTTP routes of the studio: the page, its state, uploads, options, meshes for the stage, and exports.

Errors are answered as {"error": one line}: 404 not found, 409 cancelled by a newer request, 413 too large, 422 invalid
input, 500 a bug.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from ..core.animated_rig import INFLUENCES
from ..core.errors import InputError, naming_options
from ..core.options import Layout, check_influences, check_value
from ..io.joint_file import SUFFIX
from .exports import NEEDED, Order
from .items import field_name, parse_rate
from .jobs import Cancelled, error_line
from .operations import describe_file
from .session import Session
from .state import KeptScene, describe
from .uploads import TooLarge, Upload, clip_name, find_clip, find_meshes

STATE_TIMEOUT = 20.0
"""Seconds after which a request for the state is answered without a change (long polling)."""
POLL_SECONDS = 0.02
"""Seconds between two checks for a change, or for the end of the server."""
MAX_JSON = 2**16
"""Largest size in bytes of a request that is not a file."""
DEMO = {"what": "both", "character": "dancer", "motion": "jump"}
"""Defaults of a request for the demo."""
PAGE = "studio.html"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
SERVED = (PAGE, "player.js", "studio.js", "studio.css")
"""Files of the web bundle that are served."""

Answer = Response | dict[str, Any] | None
"""Of a handler; values are sent as JSON, and None as an empty object."""
Handler = Callable[[Request], Awaitable[Answer]]


def make_app(session: Session, is_closing: Callable[[], bool]) -> Starlette:
    """Build the application, to be wrapped in AccessControl; `is_closing` returns whether the server is ending."""
    routes = Routes(session, is_closing)
    table: list[tuple[str, str, Handler]] = [
        ("GET", "/", routes.page),
        ("GET", "/static/{name}", routes.page),
        ("GET", "/api/state", routes.state),
        ("POST", "/api/uploads", routes.begin_upload),
        ("PUT", "/api/uploads/{number:int}", routes.receive_file),
        ("POST", "/api/uploads/{number:int}/{role}", routes.end_upload),
        ("DELETE", "/api/uploads/{number:int}", routes.discard_upload),
        ("POST", "/api/demo", routes.use_demo),
        ("POST", "/api/options", routes.set_options),
        ("POST", "/api/meshes/{number:int}", routes.change_item),
        ("DELETE", "/api/meshes/{number:int}", routes.remove_item),
        ("POST", "/api/meshes/{number:int}/pose", routes.pose),
        ("POST", "/api/meshes/{number:int}/stop", routes.stop),
        ("GET", "/api/meshes/{number:int}/joints", routes.joints),
        ("POST", "/api/meshes/{number:int}/joints", routes.set_joints),
        ("GET", "/api/meshes/{number:int}/joints.json", routes.download_joints),
        ("GET", "/api/scene", routes.scene),
        ("POST", "/api/exports", routes.begin_export),
        ("GET", "/api/exports/{number:int}", routes.download_export),
        ("DELETE", "/api/exports/{number:int}", routes.remove_export),
    ]
    return Starlette(
        routes=[Route(path, _with_errors(handler), methods=[method]) for method, path, handler in table],
        exception_handlers={404: _not_found, 405: _not_found},
    )


class Routes:
    """The handlers of all requests."""

    def __init__(self, session: Session, is_closing: Callable[[], bool]) -> None:
        self._session, self._is_closing = session, is_closing
        self._scene = KeptScene(session)

    async def _unless_closing(self, future: Awaitable[Any]) -> Any:
        """Await a future, but raise Cancelled once the server is ending, so that it need not wait for long work."""
        task = asyncio.ensure_future(future)
        while not task.done():
            if self._is_closing():
                raise Cancelled
            await asyncio.wait([task], timeout=POLL_SECONDS)
        return task.result()

    async def _in_thread(self, work: Callable[..., Any], *args: Any) -> Any:
        """Run a slow function in a daemon thread, which does not keep the server from ending."""
        future: Future = Future()

        def run() -> None:
            try:
                with naming_options(field_name):
                    future.set_result(work(*args))
            except Exception as error:
                future.set_exception(error)

        threading.Thread(target=run, daemon=True).start()
        return await self._unless_closing(asyncio.wrap_future(future))

    async def page(self, request: Request) -> Response:
        """Serve the page or one of its files."""
        name = request.path_params.get("name", PAGE)
        if name not in SERVED:
            raise LookupError(name)
        return web_file(name)

    async def state(self, request: Request) -> dict[str, Any]:
        """Send everything the page shows, once its version differs from `?since=`."""
        known_version = request.query_params.get("since", "")
        waited = 0.0
        # Long polling: the request is answered when something has changed, or after the timeout.
        while str(self._session.version) == known_version and waited < STATE_TIMEOUT and not self._is_closing():
            await asyncio.sleep(POLL_SECONDS)
            waited += POLL_SECONDS
        return describe(self._session)

    async def begin_upload(self, request: Request) -> dict[str, Any]:
        """Create a folder for files that belong together; answers its number."""
        return {"upload": self._session.uploads.new_upload().number}

    async def receive_file(self, request: Request) -> dict[str, Any]:
        """Receive one file of an upload, the request's body, under the name `?name=`."""
        upload = self._session.uploads.upload(request.path_params["number"])
        path = self._session.uploads.add_file(upload, request.query_params.get("name", ""))
        size = await _store_body(self._session, upload, path, request)
        return {"name": path.name, "bytes": size}

    async def end_upload(self, request: Request) -> dict[str, Any]:
        """Use the files of a complete upload as meshes to move (`identity`) or as the driving clip (`driving`)."""
        number, role = request.path_params["number"], request.path_params["role"]
        if role not in ("identity", "driving"):
            raise LookupError(role)
        upload = self._session.uploads.upload(number)
        try:
            added = await self._in_thread(_use_upload, self._session, upload, role)
        except InputError:
            self._session.uploads.remove_upload(number)
            raise
        return {"meshes": added}

    async def discard_upload(self, request: Request) -> None:
        """Delete an upload that failed."""
        number = request.path_params["number"]
        if self._session.uses(number):
            raise InputError(f"upload {number}: expected one that no mesh uses, found one in use; remove the mesh")
        self._session.uploads.remove_upload(number)

    async def use_demo(self, request: Request) -> None:
        """Load a shipped character or animal, a shipped motion of people or animals, or both."""
        from ..bodies.animals import ANIMALS
        from ..bodies.characters import CHARACTERS
        from ..motions import load_motion
        from ..motions.animal_clips import ANIMAL_MOTIONS

        body = await _json(request)
        what, name, motion = (str(body.get(key, default)) for key, default in DEMO.items())
        known = (*CHARACTERS, *ANIMALS)
        if name not in known:
            raise InputError(f"character: expected one of {', '.join(known)}, found {name[:60]!r}; choose one")
        if motion not in ANIMAL_MOTIONS:
            await self._in_thread(load_motion, motion)  # raises InputError for an unknown motion
        self._session.use_demo(what, name, motion)

    async def set_options(self, request: Request) -> None:
        self._session.set_options(await _json(request))

    async def change_item(self, request: Request) -> None:
        self._session.set_item(request.path_params["number"], await _json(request))

    async def remove_item(self, request: Request) -> None:
        self._session.remove(request.path_params["number"])

    async def stop(self, request: Request) -> None:
        self._session.stop(request.path_params["number"])

    async def pose(self, request: Request) -> Response:
        """Send the positions of a mesh in one frame, (V, 3) little-endian float32; nothing (204) if there are none.

        It was cancelled by a newer request, or because the mesh has been removed, perhaps by another page; or the mesh
        is refused, which its row says. Browsers log every response above 400 as an error, and these are none.
        """
        frame = (await _json(request)).get("frame", 0)
        if isinstance(frame, bool) or not isinstance(frame, int):
            raise InputError(f"frame: expected a whole number, found {frame!r}; give one")
        try:
            pose = self._session.pose(request.path_params["number"], frame)
            vertices = await self._unless_closing(asyncio.wrap_future(pose))
        except (Cancelled, InputError):
            return Response(status_code=204)
        return Response(np.asarray(vertices, "<f4").tobytes(), media_type="application/octet-stream")

    async def joints(self, request: Request) -> Answer:
        """Send the joints found on a mesh and on the driving clip; nothing (204) if it was cancelled."""
        try:
            found = self._session.joints(request.path_params["number"])
            return await self._unless_closing(asyncio.wrap_future(found))
        except Cancelled:
            return Response(status_code=204)

    async def set_joints(self, request: Request) -> None:
        """Replace the corrected joints of a mesh or the driving clip by the positions `joints`."""
        self._session.set_joints(request.path_params["number"], (await _json(request)).get("joints"))

    async def download_joints(self, request: Request) -> Response:
        """Send the side file with the corrected joints of a mesh or the driving clip."""
        item = self._session.item(request.path_params["number"])
        name = quote(f"{Path(item.name).stem}{SUFFIX}")
        headers = {"content-disposition": f"attachment; filename*=UTF-8''{name}"}
        return JSONResponse(describe_file(item), headers=headers)

    async def scene(self, request: Request) -> Response:
        """Send what the stage shows, packed for the player."""
        return Response(await self._in_thread(self._scene.encoded), media_type="application/json")

    async def begin_export(self, request: Request) -> dict[str, Any]:
        """Start to write results, rigs or the motion in a format; answers the number of the export."""
        body = await _json(request)
        numbers = body.get("meshes") or []
        if not isinstance(numbers, list) or not all(isinstance(number, int) for number in numbers):
            raise InputError("meshes: expected numbers of meshes, found something else; reload the page")
        what, suffix = str(body.get("what", "result")), str(body.get("suffix", ".glb"))
        check_value("what", what, tuple(NEEDED))
        names, rest = (str(body.get(key, default)) for key, default in (("names", "own"), ("rest", "file")))
        layout = Layout(names, body.get("root_bone") is True, rest, parse_rate(body.get("fps")))
        made_by = {key: str(body.get(key) or "").strip() or None for key in ("author", "license")}
        skinned, influences = body.get("skinned") is True, body.get("influences", INFLUENCES)
        check_influences(influences)
        order = Order(what=what, suffix=suffix, skinned=skinned, influences=influences, layout=layout, **made_by)
        return {"export": self._session.export(order, numbers)}

    async def download_export(self, request: Request) -> Response:
        export = self._session.exports.get(request.path_params["number"])
        if export is None or export.path is None:
            raise LookupError("export")
        return FileResponse(export.path, filename=export.path.name, media_type="application/octet-stream")

    async def remove_export(self, request: Request) -> None:
        self._session.remove_export(request.path_params["number"])


def _with_errors(handler: Handler) -> Callable[[Request], Awaitable[Response]]:
    """Wrap a handler: what it returns becomes a response, and errors those of the module's docstring."""

    async def answer(request: Request) -> Response:
        try:
            with naming_options(field_name):
                answered = await handler(request)
            return answered if isinstance(answered, Response) else JSONResponse(answered or {})
        except TooLarge as error:
            return JSONResponse({"error": error_line(error)}, 413)
        except InputError as error:
            return JSONResponse({"error": error_line(error)}, 422)
        except Cancelled:
            return JSONResponse({"error": "cancelled by a newer request"}, 409)
        except LookupError:
            return JSONResponse({"error": "nothing of that name was found"}, 404)

    return answer


def web_file(name: str) -> Response:
    """Send a file of the web bundle."""
    file = resources.files("mimesh.view") / "web" / name
    return Response(file.read_bytes(), media_type=TYPES[Path(name).suffix])


async def _not_found(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": "nothing of that name was found"}, 404)


def _use_upload(session: Session, upload: Upload, role: str) -> list[int]:
    if not upload.files:
        raise InputError("upload: expected a file, found none; choose one")
    if role == "identity":
        return session.add_identities(find_meshes(upload.files), upload.number)
    path = find_clip(upload.files)
    return [session.set_driving(path, clip_name(path, upload), upload.number)]


async def _store_body(session: Session, upload: Upload, path: Path, request: Request) -> int:
    """Write the body of a request to a file and return its size; deleted if it is too large or incomplete."""
    size, complete = 0, False
    try:
        with path.open("xb") as file:
            async for chunk in request.stream():
                session.uploads.count(upload, path, size, len(chunk))
                size += len(chunk)
                file.write(chunk)
        complete = True
    except ClientDisconnect as error:
        raise InputError(
            f"{path.name}: expected the whole file, found that the transfer was interrupted; send it again"
        ) from error
    finally:
        if not complete:
            session.uploads.remove_file(upload, path, size)
    return size


async def _json(request: Request) -> dict[str, Any]:
    """Parse the body of a request as a JSON object of at most MAX_JSON bytes."""
    import json

    # Read in chunks, so that a body without a length cannot fill the memory.
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_JSON:
            raise TooLarge(f"request: expected {MAX_JSON} bytes or fewer, found more; send less")
    try:
        value = json.loads(body or b"{}")
    except (ValueError, RecursionError) as error:
        raise InputError(f"request: expected JSON, found '{error}'; send an object") from error
    if not isinstance(value, dict):
        raise InputError("request: expected a JSON object, found something else; send an object")
    return value
