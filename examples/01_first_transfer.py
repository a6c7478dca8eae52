"""A first transfer: one mesh takes the pose of another.

python examples/01_first_transfer.py                    # a shipped character and a shipped pose
python examples/01_first_transfer.py hero.glb pose.obj  # your own
"""

import argparse
from pathlib import Path

import mimesh
from mimesh.bodies import character, load_body
from mimesh.motions import load_motion, motion_clip
from mimesh.view import sheet


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("identity", nargs="?", type=Path, help="the mesh to be moved")
    parser.add_argument("driving", nargs="?", type=Path, help="the mesh in the wanted pose")
    parser.add_argument("-o", "--output", type=Path, default=Path("01_first_transfer"), help="folder")
    options = parser.parse_args(argv)

    # transfer() takes paths or meshes. A mesh read from a file keeps a reference to that file.
    identity = mimesh.load_mesh(options.identity) if options.identity else character("runner")
    driving = mimesh.load_mesh(options.driving) if options.driving else crouching()

    result = mimesh.transfer(identity, driving)

    # With the identity's suffix, the result is its own file with moved points; all other formats are possible too.
    suffix = options.identity.suffix if options.identity else ".glb"
    print("wrote", result.save(options.output / f"result{suffix}"))
    picture = options.output / "picture.png"
    sheet.transfer_sheet(identity, driving, result.mesh).save(picture)
    print("wrote", picture)

    # The report says how far edges were stretched and how certain the reading of both meshes is; notes are for users.
    print(f"{len(result.vertices)} vertices in {sum(result.seconds.values()):.2f} s by {result.model}")
    print(f"99 % of edges are at most {result.report['edge_stretch_p99']:.2f} times as long as before")
    for note in result.notes:
        print("note:", note)


def crouching() -> mimesh.Mesh:
    """Return the shipped body in a crouch, before it jumps."""
    clip = motion_clip(load_body(), None, load_motion("jump"))
    return clip.mesh.with_vertices(clip.vertices[18])


if __name__ == "__main__":
    main()
