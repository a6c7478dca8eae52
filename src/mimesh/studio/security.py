"""Who may talk to a studio: the browser that was given the token, and no page of another site through it."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "connect-src 'self' data: blob:",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "content-security-policy": POLICY,
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}
CLOSED = "This studio is open to the browser it was started for: use the address that `mimesh studio` printed.\n"
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def new_token() -> str:
    """What opens a studio: 256 random bits."""
    return secrets.token_urlsafe(32)


class AccessControl:
    """Checks every request before the application sees it.

    * The Host header names this machine, so that no name of another site that points here is served (DNS rebinding).
    * The token comes as `?token=` once, which is answered with a cookie, then as that cookie, or as the header
      `x-mimesh-token`.
    * What changes something comes from our own page (Origin), or with the token as a header.
    """

    def __init__(self, app: ASGIApp, token: str, host: str, port: int) -> None:
        self._app, self._token, self._host = app, token, host
        self._cookie = f"mimesh-studio-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        answer = self._refusal(scope)
        await (answer or self._app)(scope, receive, send_guarded)

    def _refusal(self, scope: Scope) -> Response | None:
        """What is answered in place of the application; None lets a request pass."""
        headers, given = Headers(scope=scope), QueryParams(scope["query_string"])
        host = headers.get("host", "")
        if not self._known_host(host):
            return PlainTextResponse("This name is not that of the studio.\n", 421)
        safe = scope["method"] in ("GET", "HEAD")
        if safe and scope["path"] == "/" and self._opens(given.get("token", "")):
            answer = RedirectResponse("/", 303)
            answer.set_cookie(self._cookie, self._token, httponly=True, samesite="strict", path="/")
            return answer
        by_header = self._opens(headers.get("x-mimesh-token", ""))
        if not by_header and not self._opens(self._from_cookie(headers.get("cookie", ""))):
            return PlainTextResponse(CLOSED, 403)
        origin = headers.get("origin")
        if origin is not None and origin != f"http://{host}" and not (safe and origin == "null"):
            return PlainTextResponse("Requests of other sites are not served.\n", 403)
        if not safe and origin is None and not by_header:
            return PlainTextResponse("A change needs the Origin header, or the token as a header.\n", 403)
        return None

    def _known_host(self, host: str) -> bool:
        name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
        name = name.strip("[]").lower()
        if self._host in LOOPBACK:
            return name in LOOPBACK
        return name in (*LOOPBACK, self._host.lower(), socket.gethostname().lower()) or _is_address(name)

    def _opens(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self._token.encode())

    def _from_cookie(self, header: str) -> str:
        try:
            cookie = SimpleCookie(header).get(self._cookie)
        except CookieError:
            return ""
        return cookie.value if cookie else ""


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
