"""Access control of the studio: requests need the token, and pages of other sites cannot use a browser that has it."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

CONTENT_POLICY = "; ".join(
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
"""Content security policy: the page loads and connects to nothing but the studio itself."""
HEADERS = {
    "content-security-policy": CONTENT_POLICY,
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}
"""Headers of every response."""
FORBIDDEN = "This page is open to the browser it was started for: use the address that was printed, with its token.\n"
LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Host names that mean this machine."""


def new_token() -> str:
    """Make the secret token of a studio: 256 random bits."""
    return secrets.token_urlsafe(32)


class AccessControl:
    """ASGI middleware that checks every request before it reaches the application.

    * The Host header must name this machine: another site's name that resolves to it is refused (DNS rebinding).
    * The token must come as `?token=` once, which sets a cookie, then as that cookie, or as the header
      `x-mimesh-token`. The port is in the cookie's name, since all ports of a host share their cookies.
    * Requests that change something must come from the studio's page (Origin), or with the token as a header (CSRF).
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

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        response = self._early_response(scope)
        await (response or self._app)(scope, receive, send_with_headers)

    def _early_response(self, scope: Scope) -> Response | None:
        """Return a refusal or the redirect that sets the cookie; None to pass the request to the application."""
        headers, query = Headers(scope=scope), QueryParams(scope["query_string"])
        host = headers.get("host", "")
        # DNS rebinding: a page of another site whose name resolves to this machine sends that name.
        if not self._is_own_host(host):
            return PlainTextResponse("This host name is not that of the studio.\n", 421)
        safe = scope["method"] in ("GET", "HEAD")
        # The token leaves the address at once, so that it is not in the history or in screenshots.
        if safe and scope["path"] == "/" and self._is_token(query.get("token", "")):
            response = RedirectResponse("/", 303)
            response.set_cookie(self._cookie, self._token, httponly=True, samesite="strict", path="/")
            return response
        by_header = self._is_token(headers.get("x-mimesh-token", ""))
        if not by_header and not self._is_token(self._from_cookie(headers.get("cookie", ""))):
            return PlainTextResponse(FORBIDDEN, 403)
        # Browsers send Origin with requests of other sites, and with all changes; programs send the token as a header.
        origin = headers.get("origin")
        if origin is not None and origin != f"http://{host}" and not (safe and origin == "null"):
            return PlainTextResponse("Requests from other sites are refused.\n", 403)
        if not safe and origin is None and not by_header:
            return PlainTextResponse("A change needs the Origin header, or the token as a header.\n", 403)
        return None

    def _is_own_host(self, host: str) -> bool:
        # Without the port; an IPv6 address in brackets may come without one.
        name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
        name = name.strip("[]").lower()
        if self._host in LOOPBACK:
            return name in LOOPBACK
        # Reachable by others: any address of this machine may be typed, but no foreign name.
        return name in (*LOOPBACK, self._host.lower(), socket.gethostname().lower()) or _is_address(name)

    def _is_token(self, token: str) -> bool:
        """Compare in constant time, so that response times reveal nothing."""
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
