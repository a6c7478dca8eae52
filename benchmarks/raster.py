"""Time a picture of the shipped body, its parts, and a plain loop over its triangles, in one run.

    python benchmarks/raster.py [-o FILE]

512 x 512 pixels, one core. The loop is the textbook rasteriser: for each triangle it tests all pixels of its bounding
box for coverage and depth, with one sample per pixel, flat grey and without shadows. Times are medians of processor
time.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mimesh.bodies import load_body
from mimesh.evaluate.provenance import commit, libraries, machine
from mimesh.io.atomic import whole_file
from mimesh.view import textures
from mimesh.view.camera import Camera, fit
from mimesh.view.raster import render
from mimesh.view.zbuffer import visible_faces

SIZE = (512, 512)
REPEATS = 9


def main() -> None:
    """Measure, print the report, and write it to a file if one is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    report = {"commit": commit(), "machine": machine(), "libraries": libraries(), **figures()}
    print(json.dumps(report, indent=2))
    if args.output:
        with whole_file(args.output) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")


def figures() -> dict[str, float]:
    """Return milliseconds of pictures, of their parts and of the loop, and the ratios to the loop."""
    mesh = load_body().mesh()
    camera, points, faces = fit(mesh.vertices, SIZE), mesh.vertices, mesh.faces
    shifts = (np.array([0, 2, 1, 3]) + 0.5) / 4
    projected = camera.project(points, SIZE) * [1, 4, 1]
    parts = {
        "picture_ms": lambda: render(points, faces, camera, SIZE),
        "without_shadows_ms": lambda: render(points, faces, camera, SIZE, shadows=False),
        "one_sample_without_shadows_ms": lambda: render(points, faces, camera, SIZE, shadows=False, supersample=1),
        "normals_ms": lambda: textures.creased_normals(points, faces),
        "visible_ms": lambda: visible_faces(projected, faces, SIZE[0], 4 * SIZE[1], shifts),
    }
    found = {name: milliseconds(work) for name, work in parts.items()}
    found["loop_ms"] = milliseconds(lambda: loop(points, faces, camera, SIZE), 3)
    found["loop_over_picture"] = found["loop_ms"] / found["picture_ms"]
    found["loop_over_one_sample"] = found["loop_ms"] / found["one_sample_without_shadows_ms"]
    return {name: round(value, 2) for name, value in found.items()}


def loop(vertices: np.ndarray, faces: np.ndarray, camera: Camera, size: tuple[int, int]) -> np.ndarray:
    """Rasterise one triangle at a time; return the grey value of every pixel."""
    width, height = size
    points = camera.project(vertices, size)
    nearest, grey = np.full((height, width), np.inf), np.ones((height, width))
    for a, b, c in points[faces]:
        low = np.clip(np.floor(np.minimum(np.minimum(a, b), c)[:2]), 0, size).astype(int)
        high = np.clip(np.ceil(np.maximum(np.maximum(a, b), c)[:2]), 0, size).astype(int)
        double_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if (high <= low).any() or double_area == 0:
            continue
        x, y = np.arange(low[0], high[0]) + 0.5 - a[0], (np.arange(low[1], high[1]) + 0.5 - a[1])[:, None]
        v = (x * (c[1] - a[1]) - y * (c[0] - a[0])) / double_area
        w = (y * (b[0] - a[0]) - x * (b[1] - a[1])) / double_area
        depth = a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2])
        block = np.s_[low[1] : high[1], low[0] : high[0]]
        visible = (v >= 0) & (w >= 0) & (v + w <= 1) & (depth < nearest[block])
        nearest[block][visible] = depth[visible]
        grey[block][visible] = 0.5
    return grey


def milliseconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median processor time (ms) of a call, after one call to warm up."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return 1e3 * statistics.median(times)


if __name__ == "__main__":
    main()
