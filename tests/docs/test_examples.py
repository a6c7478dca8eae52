"""Every example runs on small inputs, writes the files that it names, and is on the page of first steps."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import json
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from networks import write_network
from people import person, walk

from mimesh.bodies.animals import animal
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.motions.animal_clips import gait_clip

pytestmark = pytest.mark.usefixtures("kept")

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def example(name: str):
    """Import an example; its file name begins with a number, so `import` cannot."""
    path = next(path for path in EXAMPLES if path.stem.endswith(name))
    spec = importlib.util.spec_from_file_location(f"example_{name}", path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their own module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def ran(tmp_path, monkeypatch, capsys):
    """A function that runs an example in an empty folder and returns its output folder and what it printed."""
    monkeypatch.chdir(tmp_path)

    def run(name: str, *argv: str) -> tuple[Path, str]:
        example(name).main(list(argv))
        (folder,) = (path for path in tmp_path.iterdir() if path.name.endswith(name))
        text = capsys.readouterr().out
        assert {path.split(":")[0] for path in re.findall(r"wrote (\S+)", text)} <= {
            str(path.relative_to(tmp_path)) for path in folder.rglob("*")
        }
        return folder, text

    return run


@pytest.mark.slow
def test_first_transfer(ran):
    folder, text = ran("first_transfer")
    assert len(load_mesh(folder / "result.glb").vertices) == 9564
    assert (folder / "picture.png").stat().st_size > 10_000
    assert "note:" not in text


def test_first_transfer_of_own_files(ran, tmp_path):
    save_mesh(person(0), tmp_path / "a.obj")
    save_mesh(person(1, 2), tmp_path / "b.ply")
    folder, _ = ran("first_transfer", "a.obj", "b.ply")
    assert (folder / "result.obj").exists()


@pytest.mark.slow
def test_motion_capture(ran):
    folder, _ = ran("motion_capture", "--frames", "5")
    skinned, morph = (load_clip(folder / f"{name}.glb", fps=15.0) for name in ("skinned", "morph"))
    assert len(skinned) == len(morph) == 3
    assert (folder / "skinned.glb").stat().st_size < (folder / "morph.glb").stat().st_size


@pytest.mark.slow
def test_one_clip_many_people(ran, tmp_path):
    save_clip(walk(frames=2), tmp_path / "walk.glb")
    for k in range(2):
        save_mesh(person(k), tmp_path / f"{k}.obj")
    folder, _ = ran("one_clip_many_people", "walk.glb", "0.obj", "1.obj", "--columns", "2")
    assert len(list(folder.glob("*.glb"))) == 2
    names = [mesh.name for mesh in example("one_clip_many_people").crowd()]
    assert names == ["heavy", "child", "dancer", "imp", "heavy-decimated"]


@pytest.mark.slow
def test_compare_models(ran):
    folder, text = ran("compare_models", "--models", "copy", "mime")
    errors = {line.split()[0]: float(line.split()[1]) for line in text.splitlines() if line[:4] in ("copy", "mime")}
    assert errors["mime"] < errors["copy"] / 10
    assert {path.name for path in folder.iterdir()} == {"copy.png", "mime.png", "pair.png"}


@pytest.mark.slow
def test_scan(ran, tmp_path):
    scans = example("scan").simulated_scans(np.random.default_rng(0))
    assert [scan.name for scan in scans] == ["points", "surface", "one-side"]
    save_mesh(scans[0], tmp_path / "points.ply")
    save_mesh(person(0), tmp_path / "person.obj")
    folder, text = ran("scan", "person.obj", "points.ply")
    assert (folder / "points.glb").exists()
    assert "note:" not in text


@pytest.mark.slow
def test_your_own_method(ran, monkeypatch):
    monkeypatch.setitem(PROTOCOLS, "human-npt", dataclasses.replace(PROTOCOLS["human-npt"], kinds=("unseen",)))
    folder, _ = ran("your_own_method", "--pairs", "1", "--beside", "copy")
    table = json.loads((folder / "table.json").read_text())
    assert table["mime twice"]["unseen"] < table["copy"]["unseen"] / 10


@pytest.mark.slow
def test_train_your_own(ran, tmp_path, monkeypatch):
    """All but the export, which takes half a minute and is tested with `learn.export`."""
    pytest.importorskip("torch")
    from mimesh.learn import export

    def exported(weights: Path, network: Path) -> None:
        assert weights.is_file()
        write_network(network)
        network.with_suffix(".json").write_text("{}")

    monkeypatch.setattr(export, "export_command", exported)
    save_mesh(person(0), tmp_path / "a.obj")
    save_mesh(person(1, 2), tmp_path / "b.obj")
    folder, _ = ran("train_your_own", "a.obj", "b.obj", "--minutes", "0.02")
    assert len(load_mesh(folder / "result.glb").vertices) == len(person(0).vertices)


@pytest.mark.slow
def test_batch_is_continued_and_lists_unusable_files(ran, tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "broken.obj").write_text("v 1 2\n")
    save_mesh(person(0), tmp_path / "meshes" / "a.obj")
    for k in range(2):
        save_clip(walk(k, frames=1), tmp_path / "clips" / f"{k}.npz")
    folder, text = ran("batch", "meshes", "clips", "--workers", "1")
    states = [line.split(",")[5] for line in (folder / "batch.csv").read_text().splitlines()[1:]]
    assert states == ["done", "done", "failed", "failed"]
    assert "broken.obj: " in text
    before = (folder / "a-0.glb").stat().st_mtime_ns
    (folder / "a-1.glb").unlink()
    _, text = ran("batch", "meshes", "clips", "--workers", "1")
    assert "4 pairs, 1 of them before, 2 failed" in text
    assert (folder / "a-1.glb").exists()
    assert (folder / "a-0.glb").stat().st_mtime_ns == before
    meshes, motions = example("batch").write_shipped_inputs(tmp_path)
    assert (len(list(meshes.iterdir())), len(list(motions.iterdir()))) == (3, 2)


@pytest.mark.slow
def test_animals(ran):
    folder, text = ran("animals", "--frames", "3")
    assert len(load_clip(folder / "result.glb", fps=30.0)) == 3
    assert "taken for: quadruped" in text
    assert text.count("confidence") == 2
    assert "feet on the ground slide" in text


@pytest.mark.slow
def test_animals_of_own_files(ran, tmp_path):
    save_mesh(animal("cat"), tmp_path / "cat.ply")
    save_clip(gait_clip("dog", "walk", seconds=0.2, fps=10.0), tmp_path / "dog.glb")
    folder, text = ran("animals", "cat.ply", "dog.glb")
    assert len(load_clip(folder / "result.glb", fps=10.0)) == 2
    assert (folder / "beside.webp").stat().st_size > 1000
    assert "identity: up +y, front +z" in text


@pytest.mark.slow
def test_live(ran, tmp_path):
    """Sender and receiver in one process, on any free port; every frame is posed."""
    save_mesh(person(0), tmp_path / "hero.obj")
    save_clip(walk(frames=5), tmp_path / "walk.npz")
    folder, text = ran("live", "hero.obj", "walk.npz", "--port", "0", "--seconds", "0.5")
    assert "30 frames" in text
    moved = load_mesh(folder / "last.glb")
    assert np.abs(moved.vertices - person(0).vertices).max() > 0.1


@pytest.mark.slow
def test_own_arrays(ran, tmp_path):
    mesh, clip = person(0), walk(frames=3)
    arrays = {"vertices": mesh.vertices, "faces": mesh.faces, "fps": 30.0}
    np.savez(tmp_path / "a.npz", driving_vertices=clip.vertices, driving_faces=clip.mesh.faces, **arrays)
    folder, text = ran("own_arrays", "a.npz", "--frames", "2")
    with np.load(folder / "moved.npz") as moved:
        assert moved["vertices"].shape == (2, len(mesh.vertices), 3)
        assert moved["joints"].shape == (len(moved["names"]), 2, 3)
        assert "Hips" in moved["names"]
    assert "confidence 0." in text
    assert example("own_arrays").shipped_arrays()["driving_vertices"].ndim == 3


@pytest.mark.slow
def test_own_arrays_that_cannot_be_used(tmp_path):
    mesh = person(0)
    np.savez(
        tmp_path / "a.npz",
        vertices=mesh.vertices.T,
        faces=mesh.faces,
        driving_vertices=mesh.vertices[None],
        driving_faces=mesh.faces,
        fps=1,
    )
    command = [sys.executable, example("own_arrays").__file__, "a.npz"]  # here jaxtyping would find it first
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == f"Mesh.vertices: expected shape (V, 3), found {mesh.vertices.T.shape}; give vertices.T\n"


@pytest.mark.slow
@pytest.mark.parametrize("content", [b"\x02\0\0\0" + bytes(24), b"GET / HTTP/1.1"])
def test_live_frames_of_another_mesh_are_left_out(tmp_path, capsys, content):
    """A sender whose mesh has another number of vertices, and one that speaks another protocol."""
    module, clip = example("live"), walk(frames=1)
    expected = pytest.raises(SystemExit, match="expected frames of at most")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        with socket.create_connection(listening.getsockname()) as sender:
            sender.sendall(content)
        with expected if content.startswith(b"GET") else contextlib.nullcontext():
            module.receive(person(0), clip, listening, tmp_path)
            assert "left out: walk: expected vertices of shape" in capsys.readouterr().out


def test_every_example_is_on_the_page():
    page = (ROOT / "docs" / "first-steps.md").read_text()
    assert [path.name for path in EXAMPLES if f"`{path.name}`" not in page] == []
