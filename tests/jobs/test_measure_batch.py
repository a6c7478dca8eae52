"""benchmarks/batch.py: the growth of a worker's memory is the slope after the first tenth of the jobs."""

import runpy
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "batch.py"


@pytest.fixture(scope="module")
def memory_over_time():
    return runpy.run_path(str(BENCHMARK))["memory_over_time"]


def test_growth_is_a_slope_and_leaves_out_the_start(memory_over_time):
    growing = memory_over_time([10.0] * 20 + [70.0 + 0.05 * k for k in range(180)])
    assert growing["memory_mib_in_1000_jobs"] == pytest.approx(50)
    assert growing["memory_mib"][0] == 10
    assert len(growing["memory_mib"]) == 10
    assert memory_over_time([70.0] * 200)["memory_mib_in_1000_jobs"] == pytest.approx(0, abs=1e-6)


def test_few_jobs_have_a_memory_each(memory_over_time):
    assert memory_over_time([70.0, 71.0])["memory_mib"] == [70.0, 71.0]
