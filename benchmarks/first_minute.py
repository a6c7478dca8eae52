"""Time the first use: clone, install, demo, and the demo's page in a browser until its animation moves.

    python benchmarks/first_minute.py [-o FILE] [--picture FILE]

The current commit is cloned into a temporary folder and installed into a new environment without pip's cache, so the
time includes all downloads and depends on the network. Chromium then opens the page, and timing ends when the picture
of the canvas has changed. Needs Chromium, and Playwright from the development install.
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
"""Step -> target of the Makefile. The target of the demo would also install; separate targets give separate times."""
BROWSER = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking")
SIZE = {"width": 1280, "height": 760}


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
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
    """Run all steps; return the seconds of each step and of all, and the browser's version."""
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "mimesh"
        seconds = {"clone": timed(["git", "clone", "--quiet", str(ROOT), str(checkout)])}
        environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VENV")}
        for step, target in STEPS.items():
            seconds[step] = timed(
                ["make", "--silent", target], cwd=checkout, env=environment | {"PIP_NO_CACHE_DIR": "1"}
            )
        shown, version = open_page(checkout / "mimesh-demo" / "player.html", browser, picture)
    seconds |= {"page": shown, "all": sum(seconds.values()) + shown}
    return {"browser": version, "seconds": {step: round(value, 1) for step, value in seconds.items()}}


def timed(command: list[str], **options) -> float:
    """Run a command that must succeed and return its wall time in seconds."""
    begin = time.perf_counter()
    subprocess.run(command, check=True, **options)
    return time.perf_counter() - begin


def open_page(page: Path, browser: str, picture: Path | None) -> tuple[float, str]:
    """Return the seconds from the start of the browser until its canvas changes, and the browser's version."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        begin = time.perf_counter()
        chromium = playwright.chromium.launch(executable_path=find_browser(browser), args=list(BROWSER))
        window = chromium.new_page(viewport={"width": SIZE["width"], "height": SIZE["height"]}, color_scheme="light")
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


def find_browser(browser: str) -> str:
    """Return the path of the browser from its name or path."""
    found = shutil.which(browser)
    if found is None:
        raise SystemExit(f"{browser}: expected a Chromium, found none; install one or name it with --browser")
    return found


if __name__ == "__main__":
    main()
