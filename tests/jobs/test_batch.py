"""`mimesh batch`: many jobs from a table or two folders; checked, resumed, stopped, and with failures."""

from __future__ import annotations

import csv
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import zoo
from networks import write_mime_network
from people import person, walk

import mimesh
from mimesh.__main__ import run
from mimesh.core.budgets import limits_are_lifted
from mimesh.core.mesh import Clip
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.io.gltf.own_rig import has_rig
from mimesh.jobs.run import BatchTask, do_task, fingerprint, record_path, recorded
from mimesh.jobs.table import filled, find_files, option_values, read_jobs


@pytest.fixture
def files(tmp_path: Path, monkeypatch) -> Path:
    """A folder with ids/a.obj and b.obj, poses/p0.ply and p1.ply, and the frames clips/walk and clips/run."""
    monkeypatch.chdir(tmp_path)
    cube = zoo.cube()
    for name in ("a", "b"):
        save_mesh(cube, Path("ids") / f"{name}.obj")
    for k in range(2):
        save_mesh(cube.with_vertices(cube.vertices * [1, 2 + k, 1]), Path("poses") / f"p{k}.ply")
    for name in ("walk", "run"):
        for t in range(3):
            save_mesh(cube.with_vertices(cube.vertices * [1, 1 + t / 4, 1]), Path("clips") / name / f"{t:03}.obj")
    return tmp_path


OUTPUTS = "out/{identity}/{driving}.obj"
POSES = ["batch", "ids", "poses", "-o", OUTPUTS, "--transfer", "-m", "copy", "-w"]
"""Both meshes in both poses by the method `copy`, by so many workers."""


def left(**options: str) -> int:
    """Count the jobs of POSES that the same batch would do now."""
    jobs = read_jobs("ids", "poses", OUTPUTS, {"model": "copy", **options}, "transfer")
    return sum(recorded(BatchTask(job, fingerprint(job))) is None for job in jobs)


def table(*rows: str, header: str = "identity,driving,output,model") -> str:
    Path("jobs.csv").write_text("\n".join((header, *rows)) + "\n")
    return "jobs.csv"


def summary_rows() -> list[dict[str, str]]:
    return list(csv.DictReader(Path("out/batch.csv").read_text().splitlines()))


def everything() -> set[str]:
    return {str(path) for path in Path().rglob("*")}


def test_outputs_with_the_longest_names_get_records_of_their_own(files):
    names = [f"{'x' * 245}{k}" for k in range(2)] + ["ü" * 123, "walk"]
    jobs = [
        read_jobs("ids/a.obj", "poses/p0.ply", f"out/{name}.obj", {"model": "copy"}, "transfer")[0] for name in names
    ]
    assert len({record_path(job) for job in jobs}) == 4
    assert record_path(jobs[3]) == Path("out/.walk.obj.job.json")
    for job in jobs[1:3]:
        task = BatchTask(job, fingerprint(job))
        assert do_task(task)["state"] == "done"
        assert recorded(task) is not None


@pytest.mark.slow
def test_a_failed_job_stops_no_others_and_is_done_when_its_file_is_mended(files, capfd):
    whole = Path("poses/p0.ply").read_bytes()
    Path("poses/p0.ply").write_text("ply\nthis is no mesh\n")
    assert run([*POSES, "1", "--json"]) == 3
    facts = json.loads(capfd.readouterr().out)
    assert [row["state"] for row in facts["each"]] == ["failed", "done", "failed", "done"]
    assert "p0.ply: expected" in facts["each"][0]["error"]
    assert {path.name for path in Path("out").rglob("*.obj")} == {"p1.obj"}
    times = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*.obj")}
    Path("poses/p0.ply").write_bytes(whole)
    assert left() == 2
    assert run([*POSES, "2"]) == 0
    shown = capfd.readouterr()
    assert "4 jobs: 2 done, 2 done before" in shown.out
    assert shown.err.splitlines()[:2] == ["checking all jobs", "4 jobs, 2 done before, workers: 2"]
    assert shown.err.count("s left] ") == 2
    assert {path: path.stat().st_mtime_ns for path in times} == times
    rows = summary_rows()
    assert [(row["identity"], row["driving"], row["output"], row["state"]) for row in rows] == [
        (f"ids/{name}.obj", f"poses/p{k}.ply", f"out/{name}/p{k}.obj", ("done", "done before")[k])
        for name in "ab"
        for k in (0, 1)
    ]
    assert all(float(row["seconds"]) > 0 and row["vertices"] == "8" for row in rows)
    assert all(len(load_mesh(row["output"]).vertices) == 8 for row in rows)
    assert json.loads(Path("out/batch.json").read_text())["counts"]["done before"] == 2
    # Finished jobs are done again when something changes that they depend on.
    assert left() == 0
    os.utime("ids/a.obj")  # another time, but the same contents
    assert left() == 0
    Path("out/b/p0.obj").unlink()
    assert left() == 1
    Path("ids/b.joints.json").write_text("{}")  # read by models with joints
    assert left() == 2
    save_mesh(zoo.cube().with_vertices(zoo.cube().vertices * 3), "ids/a.obj")
    assert left() == 4
    Path("ids/b.joints.json").unlink()
    assert (left(), left(up="+y")) == (3, 4)


@pytest.mark.slow
def test_rows_of_a_table_have_their_own_options_and_the_results_of_single_commands(files):
    rows = ("ids/a.obj;poses/p0.ply;out/a.obj;copy;transfer;;", "ids/b.obj;clips/walk;out/b.glb;;animate;12;yes")
    path = table(*rows, header="identity;driving;output;model;command;fps;preview")
    for again in (False, True):
        result = mimesh.batch(path, options={"model": "copy"}, workers=1, again=again)
        assert result.counts["done"] == 2
    single = ["animate", "ids/b.obj", "clips/walk", "-o", "one.glb", "-m", "copy", "--fps", "12"]
    assert run([*single, "-q", "--no-preview"]) == 0
    assert Path("out/b.glb").read_bytes() == Path("one.glb").read_bytes()
    assert load_clip("out/b.glb").fps == pytest.approx(12)
    assert Path("out/b.preview.html").exists()
    assert not list(Path("out").glob("a.preview*"))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (("ids/a.obj,poses/no.ply,out/1.obj,copy",), "jobs.csv:2: poses/no.ply: expected a file"),
        (("ids/no.obj,poses/p0.ply,out/1.obj,copy",), "jobs.csv:2: ids/no.obj: expected the file of the mesh"),
        (("ids/a.obj,poses/p0.ply,,copy",), "jobs.csv:2: expected a value for output"),
        (("ids/a.obj,poses/p0.ply,out/1.obj,copy,5",), "jobs.csv:2: expected as many values as columns"),
        (("ids/a.obj,poses/p0.ply,out/1.obj,nope",), "jobs.csv:2: --model: expected one of"),
        (("ids/a.obj,poses/p0.ply,out/1.xyz,copy",), "jobs.csv:2: out/1.xyz: expected an output in one of"),
        (("ids/a.obj,poses/p0.ply,ids/b.obj,copy", "ids/b.obj,poses/p0.ply,out/2.obj,copy"), "found ids/b.obj"),
        (("ids/a.obj,poses/p0.ply,ids/a.obj,copy",), "expected an output apart from the inputs"),
        (("ids/a.obj,poses/p0.ply,out/1.obj,copy", "ids/b.obj,poses/p0.ply,out/../out/1.obj,copy"), "jobs.csv:3"),
        (("ids/a.obj,poses/p0.ply,jobs.csv,copy",), "jobs.csv: expected an output in one of"),
        ((), "expected at least one job"),
    ],
)
def test_all_rows_are_checked_before_the_first_starts(files, capfd, rows, message):
    good = "ids/a.obj,poses/p1.ply,out/good.obj,copy"
    path = table(*rows, good) if rows else table()
    before = everything()
    assert run(["batch", path, "--transfer"]) == 2
    assert message in capfd.readouterr().err
    assert everything() == before


NUMBERED = "ids poses -o out/{number}.obj "


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("ids poses", "--output: expected a pattern"),
        ("ids poses -o out/{identity}.obj", "expected an output of its own"),
        ("ids poses -o out/{hero}.obj", "found hero"),
        ("ids poses -o out/{identity.obj", "expected only {identity}"),
        (NUMBERED + "-O colour=red", "expected an option of mimesh transfer"),
        (NUMBERED + "-O refine", "expected NAME=VALUE"),
        (NUMBERED + "-O refine=perhaps", "expected yes or no for refine"),
        (NUMBERED + "-O seed=x", "seed"),
        (NUMBERED + "-O up=w", "--up: expected one of"),
        ("ids poses -o poses/{number}.obj -O reference=no.obj", "no.obj: expected a file"),
        ("ids nothing* -o out/{number}.obj", "nothing*: expected driving files"),
        ("ids/no.obj poses -o out/{number}.obj", "mimesh convert --help` names, found no such file"),
        ("ids", "expected a table of jobs"),
        ("no.csv", "no.csv: expected a table"),
    ],
)
def test_wrong_usage_says_what_to_do(files, capfd, line, message):
    before = everything()
    assert run(["batch", *line.split(), "--transfer", "-m", "copy"]) == 2
    assert message in capfd.readouterr().err
    assert everything() == before


def test_an_output_may_not_lie_in_a_folder_of_frames(files, capfd):
    assert run(["batch", "ids", "clips/*", "-o", "clips/walk/{identity}-{driving}.glb", "-m", "copy"]) == 2
    assert "clips/walk" in capfd.readouterr().err


@pytest.mark.slow
def test_ctrl_c_leaves_complete_files_and_a_summary(files):
    clip = Clip.still(zoo.cube())
    for k in range(60):  # so many that the batch cannot end before the signal
        save_clip(clip, Path("many") / f"{k:03}.npz")
    words = "batch ids many -o out/{identity}/{driving}.glb -m copy"
    command = [sys.executable, "-m", "mimesh", *words.split()]
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)  # a program in the background of a shell may have it ignored
    try:
        child = subprocess.Popen([*command, "-w", "2"], stderr=subprocess.PIPE, text=True, start_new_session=True)
    finally:
        signal.signal(signal.SIGINT, before)
    with child:
        wait_for("[3/120", child)
        child.send_signal(signal.SIGINT)
        rest = child.stderr.read()
    assert child.returncode == 130
    assert rest.splitlines()[-1] == "mimesh: stopped"
    states = Counter(row["state"] for row in summary_rows())
    assert states["not run"] > 0
    assert states["done"] >= 3
    whole = [path for path in Path("out").rglob("*.glb") if not path.name.startswith(".")]
    assert states["done"] <= len(whole) <= states["done"] + 2
    assert all(len(load_mesh(path).vertices) == 8 for path in whole)
    left = [path.name for path in Path("out").rglob(".*") if not path.name.endswith(".job.json")]
    assert left == []
    jobs = read_jobs("ids", "many", "out/{identity}/{driving}.glb", {"model": "copy"}, "animate")
    kept = [recorded(BatchTask(job, fingerprint(job))) for job in jobs]
    assert states["done"] <= len([outcome for outcome in kept if outcome is not None]) <= len(whole)


def test_ctrl_c_prints_what_was_done(files, capfd, monkeypatch):
    def do_one(tasks, outcomes, *rest):
        outcomes[1] = {"state": "done"}
        raise KeyboardInterrupt

    monkeypatch.setattr("mimesh.jobs.run._do_tasks", do_one)
    assert run([*POSES, "1", "--json"]) == 130
    printed = capfd.readouterr()
    facts = json.loads(printed.out)
    assert facts["counts"] == {"done": 1, "done before": 0, "failed": 0, "not run": 3}
    assert facts == json.loads(Path("out/batch.json").read_text())
    assert printed.err == "mimesh: stopped\n"
    with pytest.raises(KeyboardInterrupt) as stopped:
        mimesh.batch("ids", "poses", OUTPUTS, command="transfer", options={"model": "copy"})
    assert stopped.value.result.counts == facts["counts"]


@pytest.mark.slow
def test_files_that_are_in_several_jobs_are_looked_at_once(files, capfd, monkeypatch):
    looked = []
    monkeypatch.setattr("mimesh.jobs.table.check_readable", looked.append)
    assert run(["batch", "ids/*.obj", "poses", "-o", OUTPUTS, "--transfer", "-m", "copy"]) == 0
    assert len(looked) == len(set(looked)) == 4


def test_what_is_not_installed_is_told_once_and_before_the_work(files, capfd, monkeypatch):
    for name in ("a", "b"):
        Path("ids", f"{name}.fbx").write_bytes(b"")
    gltf = {"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}
    Path("ids/c.gltf").write_text(json.dumps(gltf))
    Path("ids/damaged.glb").write_bytes(b"glTF")
    find = importlib.util.find_spec
    missing = ("ufbx", "DracoPy")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name in missing else find(name, *rest))
    before = everything()
    assert run(["batch", "ids/*.[fg]*", "poses", "-o", OUTPUTS, "--transfer", "-m", "copy"]) == 2
    (line,) = capfd.readouterr().err.splitlines()[1:]
    assert line.startswith(
        "mimesh: ids/a.fbx + poses/p0.ply and 3 more: ids/a.fbx: expected ufbx to read FBX, found it"
    )
    assert line.count("expected ufbx") == line.count("expected DracoPy") == 1
    assert "ids/c.gltf + poses/p0.ply and 1 more: ids/c.gltf: expected DracoPy to read Draco, found it not" in line
    assert everything() == before
    monkeypatch.setattr("mimesh.io.save.importlib.util.find_spec", lambda name, *rest: None)
    assert run(["batch", "ids/*.obj", "poses", "-o", "out/{number}.usda", "--transfer", "-m", "copy"]) == 2
    assert "and 3 more: out/1.usda: expected usd-core to write USD" in capfd.readouterr().err


def test_lists_of_paths(files):
    jobs = read_jobs([Path("ids/a.obj"), "ids"], ["poses/p1.ply"], OUTPUTS, {}, "transfer")
    assert [job.files for job in jobs] == [["ids/a.obj", "poses/p1.ply"], ["ids/b.obj", "poses/p1.ply"]]
    jobs = read_jobs(["ids/b.obj", "ids/a.obj"], None, "out/{identity}.glb", {}, "rig")
    assert [job.output for job in jobs] == ["out/b.glb", "out/a.glb"]
    rows = [{"identity": "ids/a.obj", "output": "x.glb"}]
    assert [job.output for job in read_jobs(rows, None, None, {}, "rig")] == ["x.glb"]


@pytest.mark.slow
def test_workers_end_when_the_batch_is_killed(files):
    command = [sys.executable, "-m", "mimesh", "batch", "ids", "clips/*", "-o", "out/{number}.glb", "-m", "copy"]
    with subprocess.Popen([*command, "-w", "1"], stderr=subprocess.PIPE, text=True, start_new_session=True) as child:
        wait_for("[1/4", child)
        child.kill()
    deadline = time.monotonic() + 60
    while _alive(child.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not _alive(child.pid)


def wait_for(start: str, child: subprocess.Popen[str]) -> None:
    """Wait for a line on stderr that begins in some way."""
    assert child.stderr is not None
    lines = iter(child.stderr.readline, "")
    assert any(line.startswith(start) for line in lines)


def _alive(group: int) -> bool:
    """Whether a process of a group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_tables_as_programs_write_them(files):
    Path("jobs.csv").write_bytes(
        b"\xef\xbb\xbfIdentity\tDriving\tOutput\tRoot_Bone\nids/a.obj\tclips/run\tx.glb\tyes\n"
    )
    (job,) = read_jobs("jobs.csv", None, None, {"rest": "T"}, "animate")
    assert (job.identity, job.driving, job.output) == ("ids/a.obj", "clips/run", "x.glb")
    assert dict(job.options) == {"rest": "T", "root-bone": "yes"}


def test_patterns_and_folders(files):
    assert find_files("clips/*", (".bvh",), "clips") == ["clips/run", "clips/walk"]
    assert find_files("ids", (".obj",), "meshes") == ["ids/a.obj", "ids/b.obj"]
    assert find_files("ids/a.obj", (".obj",), "meshes") == ["ids/a.obj"]
    both = {"identity": "x/a.b.obj", "driving": "clips/walk"}
    assert filled("{identity}-{driving}-{number:03}.glb", both, 7) == "a.b-walk-007.glb"


@pytest.mark.slow
def test_meshes_are_rigged_and_clips_captured_and_not_again(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for shape in range(2):
        save_mesh(person(shape), Path("meshes") / f"p{shape}.obj")
    save_clip(walk(frames=4), Path("clips") / "walk.npz")
    rig = ["batch", "meshes", "-o", "out/{identity}.glb", "--rig", "-O", "names=mixamo", "-w", "1"]
    capture = ["batch", "clips", "-o", "out/{driving}.bvh", "--capture", "-w", "1", "--summary", "clips-summary"]
    assert run([*rig, "--json"]) == run([*capture, "-q"]) == 0
    facts = json.loads(capfd.readouterr().out)
    assert facts["counts"]["done"] == 2
    assert all(row["confidence"] > 0.5 and row["vertices"] and not row["driving"] for row in facts["each"])
    assert has_rig(load_mesh("out/p0.glb"))
    assert len(load_clip("out/walk.bvh")) == 4
    assert Path("clips-summary/batch.csv").is_file()
    assert (run(rig), run(capture)) == (0, 0)
    out = capfd.readouterr().out
    assert "2 jobs: 2 done before" in out
    assert "1 jobs: 1 done before" in out
    # A table may have all commands.
    rows = ["rig,meshes/p0.obj,,out/p0-own.glb", "capture,,clips/walk.npz,out/walk.glb"]
    jobs = read_jobs(table(*rows, header="command,identity,driving,output"), None, None, {}, "animate")
    assert [(job.command, job.files, job.name) for job in jobs] == [
        ("rig", ["meshes/p0.obj"], "p0"),
        ("capture", ["clips/walk.npz"], "walk"),
    ]


@pytest.mark.slow
def test_a_pattern_of_the_identity_alone_makes_one_file_of_all_clips(tmp_path, monkeypatch):
    """As a game has its characters: one file, one animation for each motion."""
    pytest.importorskip("onnx")
    monkeypatch.chdir(tmp_path)
    write_mime_network(Path("mime.onnx"))
    save_mesh(person(0), "ids/a.glb")
    save_mesh(person(1), "ids/b.glb")
    save_clip(walk(frames=3, faces=600), "clips/walk.npz")
    save_clip(walk(2, frames=5, faces=600), "clips/run.npz")
    clips = ["clips/run.npz", "clips/walk.npz"]
    jobs = read_jobs("ids", "clips", "out/{identity}.glb", {}, "animate")
    assert [(job.output, job.files) for job in jobs] == [(f"out/{x}.glb", [f"ids/{x}.glb", *clips]) for x in "ab"]
    assert len(read_jobs("ids", "clips", "out/{identity}-{number}.glb", {}, "animate")) == 4
    row = {"identity": "ids/a.glb", "driving": clips, "output": "out/a.glb", "model": "mime.onnx"}
    result = mimesh.batch([row], workers=1)
    assert (result.counts["done"], result.outcomes[0]["frames"]) == (1, 8), result.outcomes
    assert [result.outcomes[0][name] for name in ("identity", "output")] == ["ids/a.glb", "out/a.glb"]
    assert [len(load_clip("out/a.glb", animation=name)) for name in ("run", "walk")] == [5, 3]
    assert summary_rows()[0]["driving"] == "clips/run.npz | clips/walk.npz"

    def is_done() -> bool:
        (job,) = read_jobs([row], None, None, {}, "animate")
        return recorded(BatchTask(job, fingerprint(job))) is not None

    assert is_done()
    save_clip(walk(frames=4, faces=600), "clips/walk.npz")
    assert not is_done()
    row["preview"] = "yes"
    mimesh.batch([row], workers=1)
    assert is_done()
    Path("out/a-walk.preview.html").unlink()
    assert not is_done()
    with pytest.raises(mimesh.InputError, match="expected paths of meshes beside those of drivings, found none"):
        mimesh.batch([], ["poses"], "out/{number}.obj")
    with pytest.raises(mimesh.InputError, match="expected one driving for transfer, found 2"):
        read_jobs([row], None, None, {}, "transfer")


def test_a_job_is_done_again_when_a_file_changes_that_its_input_names(files):
    """Materials, buffers, layers, and the mesh of a point cache, whatever they are called."""
    mesh = zoo.cube()
    Path("shared.mtl").write_text("newmtl red\nKd 1 0 0\n")
    Path("coloured.obj").write_text("mtllib shared.mtl\nusemtl red\n" + Path("ids/a.obj").read_text())
    save_mesh(mesh, "hero.gltf")
    document = json.loads(Path("hero.gltf").read_text())
    (buffer,) = document["buffers"]
    Path("data").mkdir()
    content = Path(buffer["uri"]).read_bytes() if not buffer["uri"].startswith("data:") else b"none"
    Path("data/other name.bin").write_bytes(content)
    buffer["uri"] = "data/other%20name.bin"
    Path("hero.gltf").write_text(json.dumps(document))
    save_clip(load_clip("clips/walk"), "cache.pc2")
    for name in ("scene.usda", "geometry.usda"):
        Path(name).write_text("#usda 1.0\n")
    for path, named in {
        "coloured.obj": "shared.mtl",
        "hero.gltf": "data/other name.bin",
        "cache.pc2": "cache.obj",
        "scene.usda": "geometry.usda",
    }.items():
        (job,) = read_jobs([{"identity": "ids/a.obj", "driving": path, "output": "x.obj"}], None, None, {}, "transfer")
        before = fingerprint(job)
        assert fingerprint(job) == before, path
        with Path(named).open("ab") as file:
            file.write(b"\n# more\n")
        assert fingerprint(job) != before, path


@pytest.mark.slow
@pytest.mark.parametrize("change", ["emptied", "removed", "replaced"])
def test_a_job_is_done_again_when_its_output_is_not_what_it_wrote(files, change):
    assert run([*POSES, "1", "-q"]) == 0
    output, other = Path("out/a/p0.obj"), Path("out/a/p1.obj")
    kept = output.read_bytes()
    if change == "removed":
        output.unlink()
    else:
        output.write_bytes(b"" if change == "emptied" else other.read_bytes())
    assert left() == 1
    assert run([*POSES, "1", "-q"]) == 0
    assert (output.read_bytes(), left()) == (kept, 0)


@pytest.mark.slow
def test_without_clobbering_only_what_others_made_is_kept(files, capfd):
    words = [*POSES, "1", "-q", "-O", "no-clobber=yes"]
    assert run(words) == 0
    assert left(**{"no-clobber": "yes"}) == left() == 0  # it changes no result
    save_mesh(zoo.cube().with_vertices(zoo.cube().vertices * 3), "ids/a.obj")
    Path("out/b/p0.obj").write_text("v 0 0 0\n")  # of someone else
    assert run(words) == 3
    assert Path("out/b/p0.obj").read_text() == "v 0 0 0\n"
    assert np.ptp(load_mesh("out/a/p0.obj").vertices) > 1.5 * np.ptp(load_mesh("out/b/p1.obj").vertices)
    assert [row["state"] for row in summary_rows()] == ["done", "done", "failed", "done before"]


@pytest.mark.parametrize("output", ["ids", ".", "out/"])
def test_an_output_is_no_folder_that_is_there(files, capfd, output):
    """The command would put a file into it, which may be an input."""
    Path("out").mkdir()
    before = everything()
    assert run(["batch", table(f"ids/a.obj,clips/run,{output},copy", "ids/b.obj,clips/run,new.glb,copy")]) == 2
    assert "expected the path of a file, found a folder" in capfd.readouterr().err
    assert everything() == before | {"jobs.csv"}


def test_jobs_may_not_write_the_same_joints(files, capfd):
    rows = [f"ids/{name}.obj,,{name}.glb,all.joints.json" for name in "ab"]
    assert run(["batch", table(*rows, header="identity,driving,output,save-joints"), "--rig"]) == 2
    assert "expected an output of its own, found all.joints.json" in capfd.readouterr().err


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="may read everything")
def test_an_unreadable_input_fails_its_jobs_alone(files):
    Path("ids/b.obj").chmod(0)
    assert run([*POSES, "1", "-q"]) == 3
    assert [row["state"] for row in summary_rows()] == ["done", "done", "failed", "failed"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["ids", "--rig"],
            "expected a pattern for the outputs, found none; give one: -o 'out/{identity}.glb'",
        ),
        (["ids", "clips", "--rig", "-o", "{identity}.glb"], "expected one set of files for rig, found DRIVINGS, too"),
        (["ids", "--rig", "-o", "{driving}.glb"], "expected only {identity}, {number} in the pattern of outputs"),
        (["ids", "--rig", "-o", "{identity}.ply"], "expected an output in one of .fbx .glb .gltf .vrm, found '.ply'"),
        (["ids", "--rig", "--capture"], "expected one command, found --rig and --capture"),
        (["ids", "--rig", "-o", "{identity}.glb", "-O", "root=keep"], "expected an option of mimesh rig, found root"),
        (["ids", "--rig", "-o", "{identity}.glb", "-O", "model=npt"], "expected a model with joints (mime), found npt"),
    ],
)
def test_what_cannot_be_rigged_is_refused_before_any_work(files, words, message, capfd):
    before = everything()
    assert run(["batch", *words]) == 2
    assert message in capfd.readouterr().err
    assert everything() == before


def test_what_options_set_ends_with_the_parsing():
    assert option_values("transfer", (("no-limits", "yes"),))["no_limits"]
    assert not limits_are_lifted()
