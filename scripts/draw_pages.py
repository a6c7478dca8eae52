"""Make the pictures of the player and of the studio that the quick start shows: docs/images/player.webp, studio.webp.

    python scripts/draw_pages.py [--browser PATH]

Needs Chromium, playwright (`[dev]`) and the studio (`[viewer]`); half a minute. What is seen is what a user gets: the
page of `mimesh demo`, and a studio with three of the cast and the demo's motion.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

from mimesh.bodies.characters import character
from mimesh.io import save_mesh
from mimesh.io.atomic import whole_file
from mimesh.tools.demo import run_demo

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SIZE = {"width": 1280, "height": 720}
SHARPER = 2
"""Pixels drawn for each one kept, along a side: pages drawn in software, as here, do not smooth edges by themselves."""
MOMENT = 0.5
"""Of the clip, where it is stopped: in mid-air."""
CHARACTERS = ("slim", "child", "heavy")
OPTIONS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking")
ALL_MOVED = f"() => document.querySelectorAll('#identities .row[data-state=done]').length === {len(CHARACTERS)}"
STOP = f"""() => {{
  mimesh.controls.seek(mimesh.stage.duration * {MOMENT});
  mimesh.stage.software = false;
  mimesh.stage.resized();
}}"""
"""Both pages have `mimesh`; to seek stops the clip. Then drawn once as by a graphics card, all pixels of the screen."""


def main() -> None:
    """Both pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--browser", default=os.environ.get("MIMESH_CHROMIUM", "chromium"))
    browser = shutil.which(parser.parse_args().browser)
    if browser is None:
        raise SystemExit("--browser: expected a Chromium, found none; install one or name its path")
    with tempfile.TemporaryDirectory() as folder:
        demo = Path(folder) / "demo"
        page = Path(run_demo(demo)["player"])
        save(screenshot(browser, page.as_uri(), "html[data-state=ready]"), "player")
        files = [demo.parent / f"{name}.glb" for name in CHARACTERS]
        for name, path in zip(CHARACTERS, files, strict=True):
            save_mesh(character(name), path)
        motion = (demo / "driving.glb").rename(demo.parent / "jump.glb")
        with studio([*files, motion]) as address:
            save(screenshot(browser, address, "html[data-state=ready]", ALL_MOVED), "studio")


@contextmanager
def studio(files: list[Path]) -> Iterator[str]:
    """A studio with these files; yields its address."""
    command = [sys.executable, "-m", "mimesh", "studio", "--no-open", "--quiet", *map(str, files)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1]
    finally:
        process.terminate()
        process.wait()


def screenshot(browser: str, address: str, seen: str, true: str = "() => true") -> Image.Image:
    """What a page shows in the middle of its clip, once `seen` is there and `true` holds, at the size of SIZE."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, args=list(OPTIONS))
        page = chromium.new_page(viewport=SIZE, color_scheme="light", device_scale_factor=SHARPER)
        page.goto(address)
        page.wait_for_selector(seen, timeout=60_000)
        page.wait_for_function(true, timeout=60_000)
        page.wait_for_timeout(1500)
        page.evaluate(STOP)
        page.wait_for_timeout(1500)
        content = page.screenshot()
        chromium.close()
    picture = Image.open(io.BytesIO(content)).convert("RGB")
    return picture.resize((SIZE["width"], SIZE["height"]), Image.Resampling.LANCZOS)


def save(image: Image.Image, name: str) -> None:
    """Write a WebP into docs/images."""
    path = IMAGES / f"{name}.webp"
    with whole_file(path) as temporary:
        image.save(temporary, format="WEBP", quality=84, method=6)
    print(f"{path}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
