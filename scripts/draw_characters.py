"""Draw characters of a pool in six actions: a sheet to look at every one of them, and the sheet of the documentation.

    python scripts/draw_characters.py POOL [-o characters.webp] [--split val] [--packs kenney ...] [--model mime]

Each row is a character at rest and in a walk, a run, a punch, a dance, a sit and a roll; the first row is the shipped
body, which every character imitates. Each picture is one transfer, given nothing but the two meshes and their axes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gallery_motions
import numpy as np
from PIL import Image

from mimesh import Mesh, transfer
from mimesh.bodies import RiggedBody, load_body
from mimesh.bodies.character_pool import PoolCharacter, read_pool
from mimesh.evaluate.character_poses import body_poses
from mimesh.io.atomic import whole_file
from mimesh.render.camera import fit
from mimesh.render.raster import render_mesh
from mimesh.render.sheet import DRIVING_TINT, captioned, page

TILE = (220, 264)
"""Pixels of one picture without its caption."""
CLIPS = {
    "walk": ("qchar_basecharacter", "Walk", 0.3),
    "run": ("qchar_basecharacter", "Run", 0.3),
    "punch": ("qchar_basecharacter", "Punch", 0.45),
    "roll": ("qchar_basecharacter", "Roll", 0.4),
}
"""Character of the training split, clip, and the frame's place in it from 0 to 1."""


def main() -> None:
    """Draw one row per character and write the sheet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("characters.webp"))
    parser.add_argument("--split", choices=("train", "val"), default="val")
    parser.add_argument("--packs", nargs="+", help="of all packs, if none is named")
    parser.add_argument("--model", default="mime")
    args = parser.parse_args()
    driving = actions(args.pool, load_body())
    tiles = [tile(mesh, name, DRIVING_TINT) for name, mesh in {"driving": load_body().mesh(), **driving}.items()]
    for character in read_pool(args.pool, args.split).characters:
        if not args.packs or character.meta.pack in args.packs:
            tiles += row(character, driving, args.model)
            print(character.meta.file, flush=True)
    with whole_file(args.output) as temporary:
        page(tiles, 1 + len(driving)).save(temporary, format="WEBP", quality=82, method=6)


def actions(pool: Path, body: RiggedBody) -> dict[str, Mesh]:
    """Pose the shipped body as in each action, in the order of the columns."""
    characters = {character.meta.file: character for character in read_pool(pool, "train").characters}
    poses = {name: clip_pose(characters[file], clip, place) for name, (file, clip, place) in CLIPS.items()}
    dance = gallery_motions.dance(body)
    poses |= {"dance": dance.rotmat[len(dance) // 3], "sit": gallery_motions.sitting(body)}
    names = ("walk", "run", "punch", "dance", "sit", "roll")
    mean = np.zeros(len(body.components))
    return {name: body.mesh(body.posed(mean, poses[name])) for name in names}


def clip_pose(character: PoolCharacter, clip: str, place: float) -> np.ndarray:
    """Return the rotations (J, 3, 3) of the shipped body's joints in a frame of a character's clip."""
    frame = round(place * (len(character.clips[clip]) - 1))
    return body_poses(character, character.transforms_of_frames(clip, np.array([frame])))[0]


def row(character: PoolCharacter, driving: dict[str, Mesh], model: str) -> list[Image.Image]:
    """Draw a character at rest and in each action, with the uncertainty that was reported."""
    identity = character.rig.mesh
    tiles = [tile(identity, character.meta.file)]
    for name, mesh in driving.items():
        result = transfer(identity, mesh, model, up="+y", front="+z", driving_up="+y", driving_front="+z")
        uncertainty = max(result.report[side].get("uncertainty", 0.0) for side in ("identity", "driving"))
        tiles.append(tile(result.mesh, f"{name} (uncertain)" if uncertainty > 1 else name))
    return tiles


def tile(mesh: Mesh, label: str, tint: tuple[float, float, float] | None = None) -> Image.Image:
    """Draw a mesh with its caption."""
    return captioned(render_mesh(mesh, TILE, fit(mesh.vertices, TILE), tint=tint), label)


if __name__ == "__main__":
    main()
