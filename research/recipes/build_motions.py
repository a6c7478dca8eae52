"""Build src/mimesh/motions/cmu.npz from the CMU takes 01_01 and 01_03 in BVH.

The files come with the Debian package `assimp-testmodels` (folder BVH). The data used in this project was obtained from
mocap.cs.cmu.edu; the database was created with funding from NSF EIA-0196217.

    python research/recipes/build_motions.py FOLDER_WITH_BVH [-o src/mimesh/motions/cmu.npz]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mimesh.bodies import load_body
from mimesh.motions.bvh import load_bvh
from mimesh.motions.clips import QUANTUM, TAKES
from mimesh.motions.motion import resample, rotmat_to_rotvec
from mimesh.motions.retarget import retarget_skeleton


def main() -> None:
    """Retarget both takes to the human body at 30 frames a second and store them in 16 bits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("src/mimesh/motions/cmu.npz"))
    args = parser.parse_args()
    body = load_body()
    arrays = {"joint_names": np.array(body.joint_names)}
    for take in TAKES:
        motion = resample(
            retarget_skeleton(load_bvh(args.folder / f"{take.removeprefix('cmu_')}.bvh"), body, take), 30.0
        )
        arrays[f"{take}_rotvec"] = np.round(rotmat_to_rotvec(motion.rotmat) / QUANTUM).astype(np.int16)
        arrays[f"{take}_root"] = motion.root.astype(np.float32)
        print(f"{take}: {len(motion)} frames, {motion.seconds:.1f} s")
    np.savez_compressed(args.output, **arrays)  # pyright: ignore[reportArgumentType]
    print(f"{args.output}: {args.output.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
