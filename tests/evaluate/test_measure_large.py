"""scripts/measure_large.py: its inputs have the wanted sizes, its exponents are slopes, a small case runs."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import zoo

from mimesh.core.geometry import border_edges, face_areas

SCRIPT = Path(__file__).parents[2] / "scripts" / "measure_large.py"


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(SCRIPT))


@pytest.mark.parametrize("count", [9, 26, 27, 3000])
def test_a_subdivided_surface_has_the_wanted_vertices_and_the_same_area(script, count):
    cube = zoo.cube()
    vertices, faces = script["subdivided"](cube.vertices, cube.faces, count)
    assert len(vertices) == count
    assert face_areas(vertices, faces).sum() == pytest.approx(6)
    assert len(border_edges(faces)) == 0
    assert face_areas(vertices, faces).min() > 0


def test_frames_go_forwards_and_backwards(script):
    cube = zoo.cube()
    clip = script["frames_of"](cube, np.arange(4.0)[:, None, None] + cube.vertices, 9)
    assert (clip.vertices[:, 0, 0] - cube.vertices[0, 0]).tolist() == [0, 1, 2, 3, 2, 1, 0, 1, 2]


def test_exponents_are_slopes(script):
    rows = {str(size): {"seconds": {"all": 3e-4 * size**1.5, "read": 0.0}, "peak_mib": 100} for size in (10, 100, 1000)}
    assert script["exponents"]({"mime": rows, "parts": {"500": rows["10"]}}) == {"mime": {"all": 1.5, "peak_mib": 0.0}}


@pytest.mark.parametrize(("power", "linear"), [(1.0, True), (1.2, False)])
def test_growth_tells_whether_time_is_linear_and_memory_flat(script, power, linear):
    rows = {str(n): {"seconds": {"all": 1e-5 * n**power}, "own_mib": 5e-3 * n**0.5} for n in (100_000, 300_000)}
    still = {str(n): {"seconds": {"all": 4.0 + 0.01 * n}, "own_mib": 400} for n in (100, 1000, 10_000)}
    found = script["growth"]({"mime": rows, "animate": still, "copy": rows})
    assert set(found) == {"mime", "animate"}
    assert found["mime"]["exponent"] == found["mime"]["exponent_largest"] == pytest.approx(power)
    assert (found["mime"]["linear"], found["mime"]["memory_flat"]) == (linear, False)
    assert found["mime"]["missing"] == [1_000_000, 3_000_000]
    assert found["animate"]["memory_flat"]
    assert found["animate"]["missing"] == []
    # The constant part hides growth in the fit over all sizes, less between the largest ones.
    assert found["animate"]["exponent"] < found["animate"]["exponent_largest"] <= 1


@pytest.mark.slow
def test_a_case_is_measured_in_a_process_of_its_own(tmp_path):
    output = tmp_path / "large.json"
    command = [sys.executable, str(SCRIPT), "-o", str(output), "--cases", "copy", "--vertices", "7000"]
    subprocess.run(command, check=True, capture_output=True)
    report = json.loads(output.read_text())
    figures = report["cases"]["copy"]["7000"]
    assert figures["vertices"] == 7000
    seconds = figures["seconds"]
    parts = sum(seconds[step] for step in ("read", "moved", "write", "preview"))
    assert seconds["all"] == pytest.approx(parts, abs=0.03)
    assert parts > 0
    assert 50 < figures["peak_mib"] < 4000
    assert 10 < figures["own_mib"] <= figures["peak_mib"]
