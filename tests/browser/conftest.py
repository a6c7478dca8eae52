"""A headless Chromium for the tests of pages; errors and requests of every page are recorded.

MIMESH_CHROMIUM names the browser; by default one on PATH is used, and without any the tests are skipped.
"""

import contextlib
import io
import os
import shutil

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--force-color-profile=srgb"]
QUIET = ["background-networking", "component-update", "sync", "quic", "default-apps", "extensions"]
OPTIONS = [*SOFTWARE, "--no-first-run", *(f"--disable-{name}" for name in QUIET)]
LOCAL = ("file:", "data:", "blob:", "about:")


def find_browser() -> str:
    """Return the path of Chromium; skip the test if there is none and MIMESH_CHROMIUM is not set."""
    named = os.environ.get("MIMESH_CHROMIUM")
    if named:
        path = shutil.which(named)
        assert path, f"MIMESH_CHROMIUM: expected a browser, found nothing at {named}"
        return path
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip("no Chromium on PATH: apt-get install chromium, or set MIMESH_CHROMIUM to its path")
    return path


@pytest.fixture(scope="session")
def chromium():
    """The browser, controlled by playwright."""
    path = find_browser()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=OPTIONS)
        yield browser
        browser.close()


class Watched:
    """A page with its requests and its errors and warnings."""

    def __init__(self, page):
        self.page = page
        self.requests: list[str] = []
        self.errors: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda message: message.type in ("error", "warning") and self.errors.append(message.text))

    def picture(self, selector: str = ".stage") -> np.ndarray:
        """Take a picture of an element after the next two frames: 8-bit sRGB as integers (h, w, 3)."""
        from PIL import Image

        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        content = self.page.locator(selector).screenshot(animations="disabled")
        return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


WAIT = 120_000
"""Milliseconds that a page may take for anything: tests wait for states, and other work can make a page slow."""


@contextlib.contextmanager
def watching(chromium):
    """Yield a function that opens an address and returns a Watched page; afterwards check their requests and errors."""
    opened = []

    def open_address(address: str, allowed: tuple[str, ...] = LOCAL, script: str = "", **options) -> Watched:
        context = chromium.new_context(**{"viewport": {"width": 720, "height": 420}, **options})
        context.set_default_timeout(WAIT)
        watched = Watched(context.new_page())
        opened.append((watched, context, allowed))
        watched.page.add_init_script(script)
        watched.page.goto(address)
        watched.page.wait_for_selector("html[data-state]")
        return watched

    yield open_address
    for watched, context, allowed in opened:
        forbidden = [url for url in watched.requests if not url.startswith(allowed)]
        context.close()
        assert forbidden == []
        assert watched.errors == []


@pytest.fixture
def watch(chromium):
    """A function that opens an address for one test; see `watching`."""
    with watching(chromium) as open_address:
        yield open_address


@pytest.fixture(scope="module")
def watch_all(chromium):
    """The same for all tests of a file: opening a page takes seconds where there is no graphics card."""
    with watching(chromium) as open_address:
        yield open_address
