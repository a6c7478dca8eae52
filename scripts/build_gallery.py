"""Make docs/gallery.md and its pictures: write the inputs, run all commands of the page, and draw their results.

python scripts/build_gallery.py              # all of it, a few minutes; the files stay in gallery/
python scripts/build_gallery.py --inputs     # only the input files of the commands
python scripts/build_gallery.py dancer noise # some entries only; the page is not changed
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
README_PICTURE = ROOT / "docs" / "images" / "moving.webp"
README_CHARACTERS = (("imp", -2.5, 0.45), ("dancer", -1.35, -0.4), ("heavy", 1.3, -0.4), ("runner", 2.55, 0.35))
"""Characters of the first picture of the README, and their positions: metres to the left, metres towards the viewer."""
QUALITY, README_QUALITY = 70, 82
"""WebP quality (0 to 100) of the movies of the page, and of stills and the first picture of the README."""
HEAD = """# Gallery

Made by `make gallery`, which runs the commands below. To run them yourself, write their input files into
`gallery/inputs/` with `python scripts/build_gallery.py --inputs`, and change to `gallery/`. Every command also writes a
picture and a page next to its result. The driving mesh is blue; captions name it.

People, clothes and animals are the shipped bodies', the jump is from the CMU Motion Capture Database
(mocap.cs.cmu.edu), the other motions are generated. Pictures are not retouched. The last example fails.
"""


def main() -> None:
    """Make the inputs, then the chosen entries, then the page."""
    parser = argparse.ArgumentParser(description="Make the gallery.")
    parser.add_argument("names", nargs="*", help="entries to make, or 'moving'; all and the page by default")
    parser.add_argument("--inputs", action="store_true", help="only write the input files of the commands")
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
    """Run the commands of an entry and draw its picture."""
    for command in entry.commands:
        execute(command, folder)
    path = PICTURES / f"{entry.name}.webp"
    save(entry.draw(folder), path)
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1024:.0f} KiB")


def execute(command: str, folder: Path) -> None:
    """Run a command of the page in the gallery's folder, without its own preview."""
    with contextlib.chdir(folder):
        if code := run([*shlex.split(command)[1:], "--no-preview", "--quiet"]):
            raise SystemExit(f"{command}: exit code {code}")


def save(picture: Picture, path: Path, quality: int = QUALITY) -> None:
    """Write frames as a looping WebP, or one image as a still; with a lower quality than `save_movie`."""
    images, fps = ([picture], 1.0) if isinstance(picture, Image.Image) else picture
    first, *others = images
    with whole_file(path) as temporary:
        movie = {"save_all": True, "append_images": others, "duration": round(1000 / fps), "loop": 0} if others else {}
        first.save(temporary, quality=quality if others else README_QUALITY, method=6, **movie)


def make_moving(folder: Path) -> None:
    """Make the first picture of the README: four identities at rest, and below them the same driven by one person."""
    for name, *_ in README_CHARACTERS:
        execute(f"mimesh animate inputs/{name}.glb inputs/dance.bvh -o {name}-dance.glb", folder)
    names = [name for name, *_ in README_CHARACTERS]
    rest = [Panel(f"inputs/{name}.glb", "", place=(1.35 * k - 2.0, 0.0)) for k, name in enumerate(names)]
    (above, *_), _ = on_one_floor(folder, rest, (900, 190), (0.0, 5.0))
    dancers = [Panel(f"{name}-dance.glb", "", place=(x, z)) for name, x, z in README_CHARACTERS]
    frames, fps = on_one_floor(folder, [Panel("inputs/dance.bvh", "", True, (0.0, 1.1)), *dancers], (900, 340))
    below = "four meshes standing still, and the same driven by one person (blue)"
    pictures = [sheet.captioned(np.asarray(sheet.stack([above, frame])), below) for frame in frames]
    save((pictures, fps), README_PICTURE, README_QUALITY)
    print(f"{README_PICTURE.relative_to(ROOT)}: {README_PICTURE.stat().st_size / 1024:.0f} KiB")


def page(folder: Path) -> str:
    """Return the text of docs/gallery.md."""
    sizes = [(folder / f"runner-{kind}.glb").stat().st_size / 2**20 for kind in ("dance", "morphs")]
    size = f"{sizes[0]:.1f} MiB instead of {sizes[1]:.1f} MiB"
    parts = [HEAD]
    for entry in ENTRIES:
        commands = "\n".join(f"    {command}" for command in entry.commands)
        picture = f"![{entry.title}](gallery/{entry.name}.webp)"
        parts.append(f"## {entry.title}\n\n{picture}\n\n{entry.sentence.format(size=size)}\n\n{commands}\n")
    return "\n".join(parts)


if __name__ == "__main__":
    main()
