"""Make docs/gallery.md and its pictures: write the inputs, run every command that the page shows, draw what came out.

python scripts/build_gallery.py              # all of it, a few minutes; the files stay in gallery/
python scripts/build_gallery.py --inputs     # only what the commands read
python scripts/build_gallery.py dancer noise # some entries; the page is left as it is
"""

from __future__ import annotations

import argparse
import contextlib
import shlex
from pathlib import Path

import numpy as np
from gallery_entries import ENTRIES, Entry, Picture
from gallery_inputs import write_inputs
from gallery_stage import Panel, on_one_floor
from PIL import Image

from mimesh.cli import run
from mimesh.io.atomic import whole_file
from mimesh.render import sheet

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "gallery.md"
PICTURES = ROOT / "docs" / "gallery"
MOVING = ROOT / "docs" / "images" / "moving.webp"
CHORUS = (("imp", -2.5, 0.45), ("dancer", -1.35, -0.4), ("heavy", 1.3, -0.4), ("runner", 2.55, 0.35))
"""Characters of the first picture of the README, and their positions (metres to the left, towards the viewer)."""
QUALITY, BEST = 70, 82
"""Quality of the movies of the page, and of the first picture of the README; 0 to 100."""
HEAD = """# Gallery

Made by `make gallery`, which runs the commands below. To run them yourself, write their input files into
`gallery/inputs/` with `python scripts/build_gallery.py --inputs`, and change to `gallery/`. Every command also writes a
picture and a page next to its result. The driving mesh is blue; captions name it.

People and clothes are the shipped body's, the jump is from the CMU Motion Capture Database (mocap.cs.cmu.edu), the
other motions are generated. Pictures are not retouched. The last example fails.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the gallery.")
    parser.add_argument("names", nargs="*", help="entries to make, or 'moving'; all and the page by default")
    parser.add_argument("--inputs", action="store_true", help="only write what the commands read")
    parser.add_argument("--folder", type=Path, default=ROOT / "gallery", help="where the commands run")
    options = parser.parse_args()
    known = ["moving", *(entry.name for entry in ENTRIES)]
    if unknown := set(options.names) - set(known):
        parser.error(f"expected names among {', '.join(known)}, found {', '.join(sorted(unknown))}")
    write_inputs(options.folder / "inputs")
    if options.inputs:
        return
    chosen = options.names or known
    for entry in ENTRIES:
        if entry.name in chosen:
            make(entry, options.folder)
    if "moving" in chosen:
        make_moving(options.folder)
    if not options.names:
        with whole_file(PAGE) as temporary:
            temporary.write_text(page(options.folder))


def make(entry: Entry, folder: Path) -> None:
    """Run an entry's commands and draw it."""
    for command in entry.commands:
        execute(command, folder)
    path = PICTURES / f"{entry.name}.webp"
    save(entry.draw(folder), path)
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1024:.0f} KiB")


def execute(command: str, folder: Path) -> None:
    """Run a command of the page in the gallery's folder, without the pictures it would write itself."""
    with contextlib.chdir(folder):
        if code := run([*shlex.split(command)[1:], "--no-preview", "--quiet"]):
            raise SystemExit(f"{command}: exit code {code}")


def save(picture: Picture, path: Path, quality: int = QUALITY) -> None:
    """Write frames as an endless movie, one image as a still; a little coarser than `save_movie` does, for the page."""
    images, fps = ([picture], 1.0) if isinstance(picture, Image.Image) else picture
    first, *others = images
    with whole_file(path) as temporary:
        movie = {"save_all": True, "append_images": others, "duration": round(1000 / fps), "loop": 0} if others else {}
        first.save(temporary, quality=quality if others else BEST, method=6, **movie)


def make_moving(folder: Path) -> None:
    """The first picture of the README: identities at rest, and below them the same, animated from one person."""
    for name, *_ in CHORUS:
        execute(f"mimesh animate inputs/{name}.glb inputs/dance.bvh -o {name}-dance.glb", folder)
    rest = [Panel(f"inputs/{who[0]}.glb", "", place=(1.35 * k - 2.0, 0.0)) for k, who in enumerate(CHORUS)]
    (above, *_), _ = on_one_floor(folder, rest, (900, 190), (0.0, 5.0))
    dancers = [Panel(f"{name}-dance.glb", "", place=(x, z)) for name, x, z in CHORUS]
    frames, fps = on_one_floor(folder, [Panel("inputs/dance.bvh", "", True, (0.0, 1.1)), *dancers], (900, 340))
    below = "four meshes standing still, and the same driven by one person (blue)"
    save(([sheet.captioned(np.asarray(sheet.stack([above, frame])), below) for frame in frames], fps), MOVING, BEST)
    print(f"{MOVING.relative_to(ROOT)}: {MOVING.stat().st_size / 1024:.0f} KiB")


def page(folder: Path) -> str:
    """The text of docs/gallery.md."""
    sizes = [(folder / f"runner-{kind}.glb").stat().st_size / 2**20 for kind in ("skinned", "dance")]
    size = f"{sizes[0]:.1f} MiB instead of {sizes[1]:.1f} MiB"
    parts = [HEAD]
    for entry in ENTRIES:
        commands = "\n".join(f"    {command}" for command in entry.commands)
        picture = f"![{entry.title}](gallery/{entry.name}.webp)"
        parts.append(f"## {entry.title}\n\n{picture}\n\n{entry.sentence.format(size=size)}\n\n{commands}\n")
    return "\n".join(parts)


if __name__ == "__main__":
    main()
