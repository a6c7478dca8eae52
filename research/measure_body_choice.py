"""Measure how often `mime` takes people for people and four-legged animals for animals by their shapes alone.

    python research/measure_body_choice.py POOL [--split val] [-o benchmarks/body_choice.json]

Every character of a pool's split is shown at rest and in one frame of each of its clips (at most FRAMES), without its
rig: with y up, as files of most formats say, and with no axes at all.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from mimesh.bodies.character_pool import PoolCharacter, read_pool
from mimesh.core.mesh import Mesh
from mimesh.evaluate.run import provenance
from mimesh.io.atomic import whole_file
from mimesh.methods.find import NETWORK_OF_BODY, find_mime
from mimesh.mime.model import Mime
from mimesh.pipeline.look import Subject, look

FRAMES = 3
"""Most clips of which a frame is taken."""


def main() -> None:
    """Print and write the share of meshes whose body is recognised."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pool", type=Path)
    parser.add_argument("--split", default="val")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/body_choice.json"))
    args = parser.parse_args()
    mime = find_mime("mime")
    rows = []
    for body in NETWORK_OF_BODY:
        meshes = [
            mesh
            for character in read_pool(args.pool, args.split, body=body).characters
            for mesh in shown(character, np.random.default_rng(0))
        ]
        for up in ("+y", None):
            found = {mesh.name: recognised(mime, mesh, up) for mesh in meshes}
            wrong = [name for name, (taken, _) in found.items() if taken != body]
            turned = [name for name, (taken, front) in found.items() if taken == body == "quadruped" and front != "+z"]
            rows.append({"body": body, "up": up, "meshes": len(meshes), "wrong": wrong, "turned": turned})
            print(f"{body}, up {up}: {len(meshes) - len(wrong)} of {len(meshes)}; wrong: {', '.join(wrong) or 'none'}")
            print(f"  animals with a wrong front: {', '.join(turned) or 'none'}")
    report = {"provenance": provenance({"split": args.split, "frames": FRAMES}), "results": rows}
    with whole_file(args.output) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n")


def shown(character: PoolCharacter, rng: np.random.Generator) -> list[Mesh]:
    """Make the meshes of a character: at rest, and in frames of its clips."""
    rest = character.rig.mesh
    meshes = [Mesh(rest.vertices, rest.faces, name=f"{character.meta.file} rest")]
    for clip in list(character.clips)[:FRAMES]:
        transforms = character.clip_transforms(clip, int(rng.integers(len(character.clips[clip]))))
        meshes.append(Mesh(character.rig.skinned(transforms), rest.faces, name=f"{character.meta.file} {clip}"))
    return meshes


def recognised(mime: Mime, mesh: Mesh, up: str | None) -> tuple[str, str]:
    """Return the body that a mesh is taken for, and the front of that."""
    found = look(mime, Subject(mesh, (up, None)), None, quick=True)
    return found.body, found.norm.front


if __name__ == "__main__":
    main()
