"""Pipes and devices as inputs are refused, and never waited for."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest
import zoo
from matrix import matrix

from mimesh.cli import run
from mimesh.io import save_mesh

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes in folders")
SUFFIXES = (".obj", ".glb", ".bvh", ".npz", ".usda", ".fbx", ".pc2")


@pytest.fixture
def files(tmp_path):
    save_mesh(zoo.cube(), tmp_path / "a.obj")
    for suffix in (*SUFFIXES, ".csv", ".yaml", ".txt", ".onnx", ".json"):
        os.mkfifo(tmp_path / f"pipe{suffix}")
    return tmp_path


@pytest.fixture(autouse=True)
def deadline():
    """Fail where a pipe is waited for."""

    def fail(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@matrix(
    "words",
    [
        *(("look", f"pipe{suffix}") for suffix in SUFFIXES),
        ("transfer", "pipe.obj", "a.obj"),
        ("transfer", "a.obj", "pipe.obj"),
        ("animate", "a.obj", "pipe.bvh"),
        ("convert", "pipe.glb", "b.obj"),
        ("render", "pipe.obj", "-o", "b.png"),
        ("batch", "pipe.csv"),
        ("train", "npt", "--config", "pipe.yaml"),
        ("transfer", "a.obj", "a.obj", "-o", "b.obj", "-m", "deformation-transfer", "--markers", "pipe.txt"),
        ("transfer", "a.obj", "a.obj", "-o", "b.obj", "-m", "pipe.onnx"),
        ("transfer", "a.obj", "a.obj", "-o", "b.obj", "--joints", "pipe.json"),
        ("look", "/dev/zero"),
    ],
    quick=lambda words: words[0] != "train",  # which loads PyTorch
    ids=" ".join,
)
def test_a_pipe_is_refused(words, files, monkeypatch, capsys):
    monkeypatch.chdir(files)
    assert run(list(words)) == 2
    error = capsys.readouterr().err
    assert ": expected a" in error
    assert "found a pipe or a device; save what comes from it as a file first" in error


def test_stdin_may_be_a_file_but_not_a_pipe(files):
    command = [sys.executable, "-m", "mimesh", "look", "/dev/stdin"]
    done = subprocess.run(command, input=b"v 0 0 0\n", capture_output=True, timeout=60)
    assert (done.returncode, b"found a pipe or a device" in done.stderr) == (2, True)
