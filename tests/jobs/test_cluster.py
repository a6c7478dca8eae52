"""Jobs on a Ray cluster of two machines, one of which is lost half-way: every job is done once."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest
import zoo

from mimesh.__main__ import run
from mimesh.io import save_mesh
from mimesh.jobs.run import MOST_TASKS, BatchTask, chunks
from mimesh.jobs.table import BatchJob

RAY = importlib.util.find_spec("ray") is not None
PROGRAM = """
import json, os, sys
from pathlib import Path

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
from ray.cluster_utils import Cluster
import mimesh

cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
times, killed = {}, False

def report(done, total, job, outcome):
    global killed
    if job is not None:
        times[job.output] = Path(job.output).stat().st_mtime_ns
    if done >= total // 3 and not killed:
        killed = True
        cluster.remove_node(nodes[0], allow_graceful=False)

result = mimesh.batch("ids", "poses", "out/{identity}/{driving}.obj", command="transfer", options={"model": "copy"},
                      cluster=cluster.address, report=report)
written = {path: Path(path).stat().st_mtime_ns for path in times}
print(json.dumps({"counts": result.counts, "killed": killed, "once": written == times, "outputs": len(times)}))
cluster.shutdown()
"""


@pytest.mark.skipif(not RAY, reason="needs the extra cluster")
def test_every_job_is_done_once_though_a_machine_is_lost(tmp_path):
    for k in range(6):
        save_mesh(zoo.cube(), tmp_path / "ids" / f"{k}.obj")
    for k in range(8):
        save_mesh(zoo.cube(), tmp_path / "poses" / f"p{k}.ply")
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    facts = json.loads(done.stdout.splitlines()[-1])
    assert facts["counts"]["done"] + facts["counts"]["done before"] == 48
    assert facts["killed"]
    assert facts["once"]
    assert facts["outputs"] == 48
    assert len(list((tmp_path / "out").rglob("*.obj"))) == 48
    assert (tmp_path / "out" / "batch.png").exists()


@pytest.mark.skipif(RAY, reason="the extra cluster is installed")
def test_without_ray_the_extra_is_named(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    save_mesh(zoo.cube(), Path("a.obj"))
    command = ["batch", "a.obj", "a.obj", "-o", "out/{number}.obj", "--transfer", "-m", "copy", "--cluster", "local"]
    assert run(command) == 2
    assert "pip install 'mimesh[cluster]'" in capfd.readouterr().err


def test_tasks_have_one_identity_and_few_jobs():
    identities = ["a"] * 20 + ["b"] * 3 + ["a"]
    jobs = [BatchJob("row", "transfer", identity, "pose.obj", "out.obj") for identity in identities]
    found = chunks({number: BatchTask(job, "", draw=False) for number, job in enumerate(jobs)})
    assert sorted(number for numbers in found for number in numbers) == list(range(24))
    assert all(len({identities[k] for k in numbers}) == 1 and len(numbers) <= MOST_TASKS for numbers in found)
