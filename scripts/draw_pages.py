"""Make the screenshots of the pages: docs/images/player.webp, studio.webp, studio-joints.webp.

    python scripts/draw_pages.py [--browser PATH]

Needs Chromium, playwright (`[dev]`) and the studio (`[viewer]`), and half a minute. The screenshots show the page of
`mimesh demo`, a studio with three of the shipped characters and the motion of the demo, and one with its joints shown.
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
SUPERSAMPLING = 2
"""Pixels rendered per pixel of the picture, along each side: software rendering does not smooth edges by itself."""
STOP_AT = 0.5
"""Fraction of the clip at which it is stopped: the jump is in mid-air."""
CHARACTERS = ("slim", "child", "heavy")
CHROMIUM_OPTIONS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
)
ALL_DONE = f"() => document.querySelectorAll('#identities .row[data-state=done]').length === {len(CHARACTERS)}"
STOP = f"""() => {{
  mimesh.controls.seek(mimesh.stage.duration * {STOP_AT});
  mimesh.stage.software = false;
  mimesh.stage.resized();
}}"""
"""Script that stops the clip: seeking pauses it. Then the scene is rendered once at the full resolution of the screen,
as with a graphics card. Both pages define `mimesh`."""


SHOW_JOINTS = """async () => {
  document.querySelector("[data-name=joints]").click();
  while (!document.querySelector("svg.joints circle")) await new Promise((done) => setTimeout(done, 100));
  mimesh.stage.software = false;
  mimesh.stage.resized();
  mimesh.joints.select("identity", "LeftLeg");
}"""
"""Script that shows the joints in the first frame and selects one."""


def main() -> None:
    """Make all pictures."""
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
            save(screenshot(browser, address, "html[data-state=ready]", ALL_DONE), "studio")
        with studio([files[0], motion]) as address:
            save(screenshot(browser, address, "#identities .row[data-state=done]", stop=SHOW_JOINTS), "studio-joints")


@contextmanager
def studio(files: list[Path]) -> Iterator[str]:
    """Run a studio with these files and yield its address."""
    command = [sys.executable, "-m", "mimesh", "studio", "--no-open", "--quiet", *map(str, files)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1]
    finally:
        process.terminate()
        process.wait()


def screenshot(
    browser: str, address: str, selector: str, condition: str = "() => true", stop: str = STOP
) -> Image.Image:
    """Take a screenshot of a page, of the size SIZE, after the script `stop`: in the middle of its clip.

    It waits until `selector` matches an element and the JavaScript function `condition` returns true.
    """
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, args=list(CHROMIUM_OPTIONS))
        page = chromium.new_page(
            viewport={"width": SIZE["width"], "height": SIZE["height"]},
            color_scheme="light",
            device_scale_factor=SUPERSAMPLING,
        )
        page.goto(address)
        page.wait_for_selector(selector, timeout=60_000)
        page.wait_for_function(condition, timeout=60_000)
        page.wait_for_timeout(1500)
        page.evaluate(stop)
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
