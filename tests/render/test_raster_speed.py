"""A picture takes less time than a plain loop over its triangles, which does far less, measured side by side."""

import sys
from pathlib import Path

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.render.camera import fit
from mimesh.render.raster import render

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import raster as benchmark

SIZE = (512, 512)


@pytest.mark.slow
def test_rendering_is_faster_than_a_loop_over_triangles():
    """4 to 6 times as fast when measured; the bound leaves room for type checks and busy machines."""
    mesh = load_body().mesh()
    camera = fit(mesh.vertices, SIZE)
    ours = benchmark.milliseconds(lambda: render(mesh.vertices, mesh.faces, camera, SIZE), 3)
    plain = benchmark.milliseconds(lambda: benchmark.loop(mesh.vertices, mesh.faces, camera, SIZE), 1)
    assert plain > 1.3 * ours


@pytest.mark.slow
def test_the_loop_draws_the_same_silhouette():
    mesh = load_body().mesh()
    camera = fit(mesh.vertices, SIZE)
    covered = benchmark.loop(mesh.vertices, mesh.faces, camera, SIZE) < 1
    picture = render(mesh.vertices, mesh.faces, camera, SIZE, supersample=1, shadows=False, background=None)
    assert (covered != (picture[..., 3] > 0)).mean() < 1e-4
    assert np.count_nonzero(covered) > 20_000
