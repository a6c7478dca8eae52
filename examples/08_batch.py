"""Animate all meshes of a folder with all clips of another: resumable, with a manifest of results and their reports.

python examples/08_batch.py                             # three shipped characters x two shipped motions
python examples/08_batch.py characters/ motions/ -o out # your own folders; repeat the command to continue
"""

import argparse
import functools
import json
from pathlib import Path

import mimesh
from mimesh.bodies import character, load_body
from mimesh.io import clip_suffixes, mesh_suffixes, save_bvh, save_mesh
from mimesh.motions import load_motion


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("identities", nargs="?", type=Path, help="a folder of meshes")
    parser.add_argument("clips", nargs="?", type=Path, help="a folder of clips and motions")
    parser.add_argument("--frames", type=int, default=None, help="number of frames to use of each clip")
    parser.add_argument("-o", "--output", type=Path, default=Path("08_batch"), help="folder")
    options = parser.parse_args(argv)
    if options.clips is None:
        options.identities, options.clips = write_shipped_inputs(options.output / "inputs")
    meshes = files(options.identities, mesh_suffixes())
    clips = files(options.clips, (*clip_suffixes(), ".bvh"))

    # The manifest has one line for every pair that was tried; these pairs are skipped when the script is run again.
    manifest = options.output / "manifest.jsonl"
    manifest.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in manifest.read_text().splitlines()] if manifest.exists() else []
    tried = {(line["identity"], line["clip"]) for line in lines}
    with manifest.open("a") as log:
        for clip in clips:
            for mesh in [mesh for mesh in meshes if (mesh.name, clip.name) not in tried]:
                line = {"identity": mesh.name, "clip": clip.name, **animate_pair(mesh, clip, options)}
                log.write(json.dumps(line) + "\n")
                log.flush()
                print(line.get("output") or f"{mesh.name} + {clip.name}: {line['why']}")
    print(f"wrote {manifest}: {len(meshes) * len(clips)} pairs, {len(tried)} of them before")


@functools.lru_cache(maxsize=1)
def load(clip: Path) -> mimesh.Clip:
    """Read a clip; the last one is cached, because all meshes are animated with one clip before the next."""
    return mimesh.load_clip(clip)


def animate_pair(mesh: Path, clip: Path, options: argparse.Namespace) -> dict:
    """Write one result and return its line of the manifest; an unusable file gives a line with the reason."""
    output = options.output / f"{mesh.stem}-{clip.stem}.glb"
    try:
        result = mimesh.animate(mesh, load(clip), stop=options.frames)
    except mimesh.InputError as error:
        return {"why": str(error)}
    result.save_skinned(output)
    seconds = round(sum(result.seconds.values()), 2)
    return {"output": str(output), "seconds": seconds, "notes": result.notes, "report": result.report}


def files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes)


def write_shipped_inputs(folder: Path) -> tuple[Path, Path]:
    """Write three shipped characters and two shipped motions, and return their folders."""
    for name in ("heavy", "dancer", "imp"):
        save_mesh(character(name), folder / "characters" / f"{name}.glb")
    for name in ("jump", "turn"):
        save_bvh(load_motion(name), load_body(), folder / "motions" / f"{name}.bvh")
    return folder / "characters", folder / "motions"


if __name__ == "__main__":
    main()
