"""The page of a studio as a browser sees it, without a browser and without a network."""

from typing import Any

from starlette.testclient import TestClient

from mimesh.studio.app import make_app
from mimesh.studio.security import AccessControl

TOKEN, PORT = "secret", 8123
HOST = f"127.0.0.1:{PORT}"


def studio_client(session: Any, entered: bool = True) -> TestClient:
    """Return a browser for a session, to be used in a `with` block; `entered` gives it the cookie."""
    app = AccessControl(make_app(session, lambda: False), TOKEN, "127.0.0.1", PORT)
    client = TestClient(app, base_url=f"http://{HOST}", headers={"origin": f"http://{HOST}"} if entered else {})
    if entered:
        assert client.get(f"/?token={TOKEN}").status_code == 200
    return client
