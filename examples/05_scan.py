"""Drive a mesh with scans: noisy points without triangles, a noisy surface, and a surface seen from one side only.

python examples/05_scan.py                    # scans made of the shipped body
python examples/05_scan.py hero.glb scan.ply  # your own
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import mimesh
from mimesh.bodies import character, load_body
from mimesh.evaluate.remesh import half, points
from mimesh.motions import load_motion, motion_clip
from mimesh.view import sheet


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("identity", nargs="?", type=Path, help="the mesh to be moved")
    parser.add_argument("scans", nargs="*", type=Path, help="meshes or point clouds")
    parser.add_argument("-o", "--output", type=Path, default=Path("05_scan"), help="folder")
    options = parser.parse_args(argv)
    identity = mimesh.load_mesh(options.identity) if options.identity else character("slim")
    scans = [mimesh.load_mesh(path) for path in options.scans] or simulated_scans(np.random.default_rng(0))

    shown = [("identity", identity)]
    for scan in scans:
        # The driving mesh needs no triangles. The more points a noisy scan has, the better.
        result = mimesh.transfer(identity, scan)
        path = result.save(options.output / f"{scan.name}.glb")
        print("wrote", path)
        # A note tells when the scan is too incomplete or too noisy for a reliable result.
        for note in result.notes:
            print("note:", note)
        shown += [(scan.name, scan), ("result", result.mesh)]
    picture = options.output / "picture.png"
    sheet.contact_sheet(shown, columns=len(shown), tile=(220, 300)).save(picture)
    print("wrote", picture)


def simulated_scans(rng: np.random.Generator) -> list[mimesh.Mesh]:
    """Return a person with raised arms as 1,500 noisy points, as a noisy surface, and as seen from one side."""
    body = load_body()
    pose = motion_clip(body, None, load_motion("swing")).vertices[45]
    cloud, side = points(body, 1500, rng), half(body, pose, np.random.default_rng(1))
    scans = [
        mimesh.Mesh(cloud.positions(pose), cloud.faces, name="points"),
        mimesh.Mesh(pose, body.faces, name="surface"),
        mimesh.Mesh(side.positions(pose), side.faces, name="one-side"),
    ]
    noise = (0.01, 0.02, 0.0)  # metres
    return [
        dataclasses.replace(scan, vertices=scan.vertices + rng.normal(0, sigma, scan.vertices.shape))
        for scan, sigma in zip(scans, noise, strict=True)
    ]


if __name__ == "__main__":
    main()
