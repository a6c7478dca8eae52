"""Programs that use the library pass mypy --strict and pyright: batch, own arrays, live loop."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mimesh

ROOT = Path(__file__).parents[2]
TYPED = [str(ROOT / "examples" / name) for name in ("08_batch.py", "10_live.py", "11_own_arrays.py")]
WRONG = """import mimesh
result = mimesh.transfer("a.obj", "b.obj")
result.report["identity"]["confidenc"]
mimesh.transfer("a.obj", "b.obj", drivign_up="+y")
mimesh.animate("a.obj", mimesh.load_mesh("b.obj"))
"""
"""A misspelled key, a misspelled argument, and a mesh where a clip is wanted, a line each from the third on.

What a wrong call returns is unknown to pyright, so the key is of a right one."""
COMMANDS = {
    "mypy": ("--strict", "--follow-imports=silent", "--no-incremental"),
    "pyright": ("--pythonpath", sys.executable),
}


def check(checker: str, folder: Path, *files: str) -> subprocess.CompletedProcess[str]:
    """Run a type checker as a program's author does, in a folder of its own; only these files are reported."""
    if importlib.util.find_spec(checker) is None:
        pytest.skip(f"{checker} is not installed")
    source = str(ROOT / "src")
    environment = {**os.environ, "MYPYPATH": source, "PYTHONPATH": source}
    (folder / "pyrightconfig.json").write_text(f'{{"extraPaths": ["{source}"]}}')
    command = [sys.executable, "-m", checker, *COMMANDS[checker], *files]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_the_package_says_that_it_is_typed():
    assert (Path(mimesh.__file__).parent / "py.typed").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("checker", COMMANDS)
def test_examples_are_typed_and_wrong_programs_are_found(checker, tmp_path):
    (tmp_path / "wrong.py").write_text(WRONG)
    done = check(checker, tmp_path, "wrong.py", *TYPED)
    assert done.returncode == 1, done.stdout + done.stderr
    errors = re.findall(r"(\w+\.py):(\d+)(?::\d+)?[ :-]+error", done.stdout)
    assert {(name, int(line)) for name, line in errors} == {("wrong.py", line) for line in (3, 4, 5)}, done.stdout
