"""Apply motion capture to a mesh without a skeleton: a BVH file in, GLB files out, for games and other uses.

python examples/02_motion_capture.py                     # a shipped character and a shipped capture
python examples/02_motion_capture.py hero.glb dance.bvh  # your own
"""

import argparse
from pathlib import Path

import mimesh
from mimesh.bodies import character, load_body
from mimesh.io import save_bvh, save_mesh
from mimesh.motions import load_motion


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("identity", nargs="?", type=Path, help="the mesh to be moved")
    parser.add_argument("motion", nargs="?", type=Path, help="a .bvh file, or any clip that mimesh reads")
    parser.add_argument("--frames", type=int, default=None, help="number of frames to use")
    parser.add_argument("-o", "--output", type=Path, default=Path("02_motion_capture"), help="folder")
    options = parser.parse_args(argv)
    identity, motion = options.identity, options.motion
    if identity is None:
        identity = options.output / "identity.glb"
        save_mesh(character("dancer"), identity)
    if motion is None:
        motion = save_bvh(load_motion("jump"), load_body(), options.output / "jump.bvh")

    # A motion file has joints and no mesh, so the shipped body is animated by it. Every second frame is enough here.
    result = mimesh.animate(identity, motion, frames=mimesh.FrameRange(stop=options.frames, step=2))

    # The same animation in two forms. Joints, weights and joint rotations: small files, supported by game engines.
    skinned = result.save_skinned(options.output / "skinned.glb")
    # One morph target per frame: exact for any deformation, and independent of a skeleton.
    morph = result.save(options.output / "morph.glb")
    for path in (skinned, morph):
        print(f"wrote {path}: {path.stat().st_size / 2**20:.2f} MiB")
    difference = skinned.deviations[0]["skinned_deviation"]
    print(f"largest difference between the two: {100 * difference:.2f} % of the size")

    # The joints are also available in Python.
    skeleton = result.skeleton
    print(f"{len(skeleton.names)} joints: {', '.join(skeleton.names[:6])} ...")


if __name__ == "__main__":
    main()
