"""Drive several meshes with one clip: other shapes, clothes, proportions and triangles.

python examples/03_one_clip_many_people.py                          # a shipped clip and shipped characters
python examples/03_one_clip_many_people.py walk.glb a.obj b.glb ... # your own clip and meshes
"""

import argparse
from pathlib import Path

import fast_simplification
import numpy as np

import mimesh
from mimesh.bodies import character, load_body
from mimesh.motions import load_motion, motion_clip
from mimesh.view import sheet


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("driving", nargs="?", type=Path, help="a clip")
    parser.add_argument("identities", nargs="*", type=Path, help="meshes to be moved")
    parser.add_argument("--frames", type=int, default=None, help="number of frames to use")
    parser.add_argument("--columns", type=int, default=8, help="frames in a row of the picture")
    parser.add_argument("-o", "--output", type=Path, default=Path("03_one_clip_many_people"), help="folder")
    options = parser.parse_args(argv)
    driving = options.driving and mimesh.load_clip(options.driving)
    driving = driving or motion_clip(load_body(), None, load_motion("turn"))
    identities = [mimesh.load_mesh(path) for path in options.identities] or crowd()

    tile = (150, 200)
    rows = [sheet.strip(driving, options.columns, tile, tint=sheet.DRIVING_TINT)]
    for identity in identities:
        # An identity needs no rig, no correspondence, no particular vertex count and no particular rest pose.
        result = mimesh.animate(identity, driving, frames=mimesh.FrameRange(stop=options.frames))
        path = result.save(options.output / f"{identity.name}.glb")
        print(f"wrote {path}: {len(identity.vertices)} vertices, {sum(result.seconds.values()):.1f} s")
        rows.append(sheet.strip(result.clip, options.columns, tile))
    picture = options.output / "picture.png"
    sheet.stack(rows).save(picture)
    print("wrote", picture)


def crowd() -> list[mimesh.Mesh]:
    """Return four shipped characters, and one of them with a twentieth of its triangles."""
    return [character("heavy"), character("child"), character("dancer"), character("imp"), decimated("heavy", 20)]


def decimated(name: str, factor: int) -> mimesh.Mesh:
    """Return a shipped character with its triangles divided by `factor`; body and clothes become one surface."""
    mesh = character(name)
    points, faces = fast_simplification.simplify(
        mesh.vertices, mesh.faces.astype(np.int32), target_count=len(mesh.faces) // factor
    )
    return mimesh.Mesh(points.astype(float), faces.astype(int), name=f"{name}-decimated")


if __name__ == "__main__":
    main()
