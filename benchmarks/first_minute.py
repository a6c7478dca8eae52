"""From nothing to a person moving on the screen: clone, install, demo, page, each timed, and a picture of the end.

    python benchmarks/first_minute.py [-o FILE] [--picture FILE]

The commit that is checked out is cloned into a temporary folder and installed into an environment of its own, without
pip's cache, so every package is downloaded; how fast that goes is the network's affair. Chromium then opens the page,
and the clock stops when its picture has changed. Needs Chromium, and Playwright of the development install.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from PIL import Image

from mimesh.evaluate.provenance import commit, machine
from mimesh.io.atomic import whole_file

ROOT = Path(__file__).parents[1]
STEPS = {"install": ".venv/.base", "demo": "demo"}
"""Targets of the Makefile; the demo's target alone would do both."""
BROWSER = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking")
SIZE = {"width": 1280, "height": 760}


def main() -> None:
    """Print the times and keep them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--picture", type=Path, help="a screenshot of the page, .webp or .png")
    parser.add_argument("--browser", default=os.environ.get("MIMESH_CHROMIUM", "chromium"))
    args = parser.parse_args()
    report = {"commit": commit(), "machine": machine()} | first_minute(args.browser, args.picture)
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def first_minute(browser: str, picture: Path | None) -> dict:
    """Seconds of every step and of all, and the versions of what ran them."""
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "mimesh"
        seconds = {"clone": timed(["git", "clone", "--quiet", str(ROOT), str(checkout)])}
        clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VENV")}
        for step, target in STEPS.items():
            seconds[step] = timed(["make", "--silent", target], cwd=checkout, env=clean | {"PIP_NO_CACHE_DIR": "1"})
        shown, version = open_page(checkout / "mimesh-demo" / "player.html", browser, picture)
    seconds |= {"page": shown, "all": sum(seconds.values()) + shown}
    return {"browser": version, "seconds": {step: round(value, 1) for step, value in seconds.items()}}


def timed(command: list[str], **options) -> float:
    """Wall time of a command that must succeed."""
    begin = time.perf_counter()
    subprocess.run(command, check=True, **options)
    return time.perf_counter() - begin


def open_page(page: Path, browser: str, picture: Path | None) -> tuple[float, str]:
    """Seconds from starting the browser until what it shows has moved, and the browser's version."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        begin = time.perf_counter()
        chromium = playwright.chromium.launch(executable_path=which(browser), args=list(BROWSER))
        window = chromium.new_page(viewport=SIZE, color_scheme="light")
        window.goto(page.as_uri())
        canvas = window.locator("canvas").first
        first = canvas.screenshot()
        while canvas.screenshot() == first:
            if time.perf_counter() - begin > 60:
                raise TimeoutError(f"{page}: nothing moved for a minute")
        seconds = time.perf_counter() - begin
        if picture:
            window.wait_for_timeout(700)
            with whole_file(picture) as temporary:
                Image.open(io.BytesIO(window.screenshot())).convert("RGB").save(temporary, quality=85)
        return seconds, f"Chromium {chromium.version}"


def which(browser: str) -> str:
    """The browser's file, from its name or path."""
    found = shutil.which(browser)
    if found is None:
        raise SystemExit(f"{browser}: expected a Chromium, found none; install one or name it with --browser")
    return found


if __name__ == "__main__":
    main()
