"""What newcomers pass by mistake raises InputError, in the words of Python; old names of arguments still work."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import mistakes
import numpy as np
import pytest
from mistakes import CLIP, CUBE, MISTAKES, MOVING

import mimesh
from mimesh.core.arguments import for_caller, public
from mimesh.core.array_inputs import as_faces, as_vertices
from mimesh.core.errors import command_line_words


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory) -> dict[str, tuple[str, str]]:
    """Run all mistakes in a process of its own: here jaxtyping checks arrays before our code does."""
    command = [sys.executable, str(Path(mistakes.__file__))]
    folders = [str(Path(mimesh.__file__).parents[1]), str(Path(mistakes.__file__).parent)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    done = subprocess.run(command, env=environment, cwd=tmp_path_factory.mktemp("run"), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return {name: (kind, message) for name, kind, message in map(json.loads, done.stdout.splitlines()[:-1])}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_raises_an_error_that_names_no_option(name, outcomes):
    kind, message = outcomes[name]
    assert kind in ("InputError", "ArgumentError"), message
    assert MISTAKES[name][1] in message
    assert not re.search(r"(?<![\w-])(--[a-z]|-[mo]\b)", message)


def test_a_call_that_python_refuses_is_a_type_error_too():
    with pytest.raises(TypeError, match="did you mean front"):
        mimesh.transfer(CUBE, CUBE, frnt="+z")  # type: ignore[call-arg]


def test_lists_and_other_numbers_are_converted():
    assert as_vertices(CUBE.vertices.tolist()).dtype == as_vertices(CUBE.vertices.astype(np.int32)).dtype == np.float64
    for faces in (CUBE.faces.tolist(), CUBE.faces.astype(float), CUBE.faces.astype(np.uint32)):
        assert as_faces(faces).dtype == np.int64
        assert (as_faces(faces) == CUBE.faces).all()
    assert mimesh.Mesh(CUBE.vertices).faces.shape == as_faces([]).shape == (0, 3)


def test_meshes_clips_and_results_are_shown_without_their_arrays():
    assert repr(CUBE) == f"Mesh({CUBE.name!r}, {len(CUBE.vertices)} vertices, {len(CUBE.faces)} faces)"
    assert repr(CLIP) == f"Clip({CUBE.name!r}, 2 frames at 30 fps, {len(CUBE.vertices)} vertices)"
    assert "array(" not in repr(MOVING)


def test_arrays_that_can_be_used_are_not_copied():
    vertices = CUBE.vertices.astype(np.float32)
    mesh = mimesh.Mesh(vertices, CUBE.faces)
    assert mesh.vertices is vertices
    assert mesh.faces is CUBE.faces


def test_notes_name_arguments():
    slab = CUBE.with_vertices(CUBE.vertices * [1.0, 1.0, 1.01])
    assert any("give front=..." in note for note in mimesh.transfer(slab, CUBE, "copy").notes)
    with command_line_words():
        assert any("give --front" in note for note in mimesh.transfer(slab, CUBE, "copy").notes)


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("--root: expected one of", "root: expected one of"),
        ("a--up.obj and --upper", "a--up.obj and --upper"),
        ("give --driving-up +z if the file is wrong", 'give driving_up="+z" if the file is wrong'),
        ("--rig mimesh --body human finds", 'rig="mimesh" body="human" finds'),
        ("-m deformation-transfer or --reference", 'model="deformation-transfer" or reference'),
        ("give one with --reference", "give one with reference=..."),
        ("a pose?): --start 1 leaves it out", "a pose?): start=1 leaves it out"),
        ("animals are moved by -m mime", 'animals are moved by model="mime"'),
        ("mimesh convert IN OUT --body-model SMPL.pkl", 'load_recorded_clip(path, body_model="SMPL.pkl")'),
        ("add --no-limits (Python: with mimesh.no_limits()) if", "call this inside `with mimesh.no_limits():` if"),
    ],
)  # fmt: skip
def test_options_in_messages_become_arguments(message, expected):
    assert for_caller(message) == expected
    with command_line_words():
        assert for_caller(message) == message


def test_kinds_that_are_not_known_are_left_to_the_function():
    @public()
    def twice(value: int | complex) -> complex:
        return 2 * value

    assert twice(1j) == 2j
