"""What newcomers pass by mistake raises InputError, in the words of Python; old names of arguments still work."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from grouped_options import grouped

import mimesh
from mimesh.core.arguments import as_faces, as_vertices, public
from mimesh.core.errors import naming_options, option

CUBE = zoo.cube()
V, F = CUBE.vertices, CUBE.faces
CLIP = mimesh.Clip(CUBE, np.stack([V, V + 1.0]))
RESULT = mimesh.Result(CUBE, "copy", mimesh.transfer(CUBE, CUBE, "copy").seconds, {})  # type: ignore[typeddict-item]
MOVING = mimesh.animate(CUBE, CLIP, "copy")
SESSION = mimesh.prepare(CUBE, CUBE, "copy")
COLOURS = np.zeros((len(V), 3), np.uint8)


class OnDevice:
    """A tensor on a GPU, which NumPy cannot read."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Refuse as PyTorch does."""
        raise TypeError("can't convert cuda:0 device type tensor to numpy")


class Halves:
    """A method that a newcomer forgets to make an object of."""

    rough, name = False, "halves"

    def prepare(self, identity: mimesh.Mesh, driving: mimesh.Clip) -> Any:
        """Never reached."""


def _mesh(vertices: Any, *more: Any, **options: Any) -> Callable[[], Any]:
    return lambda: mimesh.Mesh(vertices, *more, **options)


def _transfer(*given: Any, **options: Any) -> Callable[[], Any]:
    return lambda: mimesh.transfer(*given, **grouped(**options))


def _animate(*given: Any, **options: Any) -> Callable[[], Any]:
    return lambda: mimesh.animate(*given, **grouped(**options))


MISTAKES: dict[str, tuple[Callable[[], Any], str]] = {
    "a hint of another kind": (lambda: mimesh.Hints(up=1), "up: expected"),  # type: ignore[arg-type]
    "transposed vertices": (_mesh(V.T, F), "give vertices.T"),
    "flat vertices": (_mesh(V[:, :2], F), "expected shape (V, 3)"),
    "frames as vertices": (_mesh(CLIP.vertices, F), "mimesh.Clip(mesh, frames)"),
    "a path as vertices": (_mesh("hero.glb", F), "expected an array, found 'hero.glb'"),
    "vertices of text": (_mesh(V.astype(str), F), "expected real numbers"),
    "complex vertices": (_mesh(V * 1j, F), "expected real numbers"),
    "rows of different lengths": (_mesh([[0, 0, 0], [1, 0]], F), "give rows of one length"),
    "a tensor on a GPU": (_mesh(OnDevice(), F), "tensor.detach().cpu().numpy()"),
    "vertices with a mask": (_mesh(np.ma.masked_greater(V, 0.0), F), "found one with a mask"),
    "faces None": (_mesh(V, None), "leave it out for a point cloud"),
    "quads": (_mesh(V, F[:, [0, 1, 2, 0]]), "split quads into triangles"),
    "mixed polygons": (_mesh(V, [[0, 1, 2], [0, 1, 2, 3]]), "give rows of one length"),
    "transposed faces": (_mesh(V, F.T), "give faces.T"),
    "faces in one row": (_mesh(V, F.ravel()), "give faces.reshape(-1, 3)"),
    "faces of halves": (_mesh(V, F + 0.5), "expected whole numbers, found float64"),
    "an infinite face": (_mesh(V, [[0, 1, np.inf]]), "found NaN or infinity"),
    "normals as name": (_mesh(V, F, V), "Mesh.name: expected text"),
    "pixels as texture coordinates": (_mesh(V, F, corner_uv=np.full((len(F), 3, 2), 512)), "expected floats of shape"),
    "texture coordinates of vertices": (_mesh(V, F, corner_uv=V[:, :2]), "uv[faces]"),
    "bytes as colours": (_mesh(V, F, vertex_colors=COLOURS), "divide bytes by 255"),
    "transposed new vertices": (lambda: CUBE.with_vertices(V.T), "vertices: expected shape (V, 3)"),
    "vertices of another mesh": (lambda: CUBE.with_vertices(V[:3]), "expected the shape"),
    "a clip of a path": (lambda: mimesh.Clip("hero.glb", V[None]), "expected a Mesh, found 'hero.glb'"),  # type: ignore[arg-type]
    "a clip of one frame": (lambda: mimesh.Clip(CUBE, V), "Clip.still(mesh)"),
    "transposed frames": (lambda: mimesh.Clip(CUBE, CLIP.vertices.transpose(0, 2, 1)), "transpose(0, 2, 1)"),
    "frames second": (lambda: mimesh.Clip(CUBE, CLIP.vertices.transpose(1, 0, 2)), "transpose(1, 0, 2)"),
    "frames of another mesh": (lambda: mimesh.Clip(CUBE, CLIP.vertices[:, :4]), "one topology for the whole clip"),
    "a rate of text": (lambda: mimesh.Clip(CUBE, CLIP.vertices, "24"), "Clip.fps: expected a number"),  # type: ignore[arg-type]
    "still of a clip": (lambda: mimesh.Clip.still(CLIP), "expected a Mesh, found a Clip"),  # type: ignore[arg-type]
    "faces from 1": (_transfer(mimesh.Mesh(V, F + 1), CUBE, "copy"), "vertices count from 0"),
    "NaN": (_transfer(mimesh.Mesh(V * np.nan, F), CUBE, "copy"), "expected finite coordinates"),
    "an array as identity": (_transfer(V, CUBE), "mimesh.Mesh(vertices, faces)"),
    "a list as driving": (_transfer(CUBE, V.tolist()), "driving: expected a Mesh or a path, found a list"),
    "a clip as identity": (_transfer(CLIP, CUBE), "clip.mesh.with_vertices(clip.vertices[0]) is one frame"),
    "a clip as pose": (_transfer(CUBE, CLIP), "animate takes whole clips"),
    "a result as driving": (_transfer(CUBE, RESULT), "give its mesh"),
    "bytes as path": (_transfer(b"hero.glb", CUBE), "expected a Mesh or a path"),
    "None as driving": (_transfer(CUBE, None), "driving: expected a Mesh or a path, found None"),
    "a path without a file": (_transfer("missing.glb", CUBE), "missing.glb: expected a file"),
    "an unknown model": (_transfer(CUBE, CUBE, "mine"), "model: expected one of copy"),
    "a misspelled model": (_transfer(CUBE, CUBE, "mimme"), "did you mean mime?"),
    "a number as model": (_transfer(CUBE, CUBE, 3), "model: expected a name"),
    "a class as model": (_transfer(CUBE, CUBE, Halves), "give Halves()"),
    "an unknown axis": (_transfer(CUBE, CUBE, "copy", up="w"), "up: expected one of"),
    "an unknown axis of hints": (lambda: mimesh.Hints(driving_up="q"), "driving_up: expected one of"),
    "an axis of a number": (_transfer(CUBE, CUBE, "copy", front=1), "front: expected text or None, found 1"),
    "one axis twice": (_transfer(CUBE, CUBE, "copy", up="+y", front="-y"), 'up="+y" front="-y"'),
    "half an ensemble": (_transfer(CUBE, CUBE, "npt", ensemble=1.5), "ensemble: expected a whole number"),
    "no ensemble": (_transfer(CUBE, CUBE, "npt", ensemble=0), "ensemble: expected 1 or more"),
    "a seed of text": (_transfer(CUBE, CUBE, seed="0"), "seed: expected a whole number"),
    "refine of text": (_transfer(CUBE, CUBE, "copy", refine="yes"), "refine: expected True or False or None"),
    "an unknown body": (_transfer(CUBE, CUBE, body="dog"), "body: expected one of"),
    "an unknown rig": (_transfer(CUBE, CUBE, rig="mine"), "rig: expected one of"),
    "joints in a list": (_transfer(CUBE, CUBE, joints=[[0, 0, 0]]), "joints: expected a dictionary"),
    "joints of text": (_transfer(CUBE, CUBE, joints={"Head": "top"}), "joints: expected three finite numbers"),
    "markers of halves": (_transfer(CUBE, CUBE, "deformation-transfer", markers=[[0.5, 1]]), "markers: expected whole"),
    "no reference": (_transfer(CUBE, CUBE, "deformation-transfer"), "with reference=..."),
    "a mesh as clip": (_animate(CUBE, CUBE), "mimesh.Clip.still(mesh)"),
    "frames as clip": (_animate(CUBE, CLIP.vertices), "mimesh.Clip(mesh, vertices)"),
    "a rate of text for a file": (_animate(CUBE, CLIP, "copy", fps="24"), "fps: expected a number or None, found '24'"),
    "a negative rate": (_animate(CUBE, CLIP, "copy", fps=-1), "expected a frame rate from 0.001 to 10,000"),
    "no step": (_animate(CUBE, CLIP, "copy", step=0), "step: expected 1 or more"),
    "a start in seconds": (_animate(CUBE, CLIP, "copy", start=0.5), "start: expected a whole number"),
    "a start after the end": (_animate(CUBE, CLIP, "copy", start=9), "expected start and stop within its 2 frames"),
    "an animation of arrays": (_animate(CUBE, CLIP, animation="walk"), "animation: expected the path of a file"),
    "an unknown root": (_animate(CUBE, CLIP, root="stay"), "root: expected one of scale, keep, drop"),
    "ground of text": (_animate(CUBE, CLIP, ground="no"), "ground: expected True or False"),
    "negative smoothing": (_animate(CUBE, CLIP, smooth=-1), "smooth: expected seconds"),
    "smoothing of hours": (_animate(CUBE, CLIP, smooth=1e5), "smooth: expected seconds from 0 to 10"),
    "joints of copy": (_animate(CUBE, CLIP, "copy", skinned=True), "skinned: expected a model with joints"),
    "progress that is none": (_animate(CUBE, CLIP, "copy", progress=True), "progress: expected a function"),
    "a clip as frame": (lambda: SESSION.pose(CLIP), "give clip.vertices[t]"),  # type: ignore[arg-type]
    "a transposed frame": (lambda: SESSION.pose(V.T), "give frame.T"),
    "several frames": (lambda: SESSION.pose(CLIP.vertices), "give one frame at a time"),
    "None as frame": (lambda: SESSION.pose(None), "expected vertices of shape"),  # type: ignore[arg-type]
    "a number as path": (lambda: mimesh.load_mesh(3), "path: expected a path, found 3"),  # type: ignore[arg-type]
    "a mesh as path": (lambda: mimesh.load_mesh(CUBE), "path: expected a path, found a Mesh"),  # type: ignore[arg-type]
    "a rate of text for a clip": (lambda: mimesh.load_clip("a.npz", fps="24"), "fps: expected a number"),  # type: ignore[arg-type]
    "an animation of a clip": (lambda: mimesh.load_clip("a.npz", animation=0), "with animation=..."),
    "frames as a list": (lambda: mimesh.load_clip("a.npz", frames=[0, 1]), "frames: expected a slice"),  # type: ignore[arg-type]
    "path and mesh swapped": (lambda: mimesh.save_mesh("a.obj", CUBE), "it comes first, then its path"),  # type: ignore[arg-type]
    "a clip for save_mesh": (lambda: mimesh.save_mesh(CLIP, "a.obj"), "save_clip writes"),  # type: ignore[arg-type]
    "a mesh for save_clip": (lambda: mimesh.save_clip(CUBE, "a.npz"), "save_mesh writes a mesh"),  # type: ignore[arg-type]
    "no suffix": (lambda: mimesh.save_mesh(CUBE, "a"), "found no suffix"),
    "an unknown suffix": (lambda: mimesh.save_mesh(CUBE, "a.max"), "expected an output in one of"),
    "saved faces from 1": (lambda: mimesh.save_mesh(mimesh.Mesh(V, F + 1), "a.obj"), "vertices count from 0"),
    "no frames": (lambda: mimesh.save_clip(mimesh.Clip(CUBE, CLIP.vertices[:0]), "a.npz"), "expected at least one"),
    "NaN in a frame": (
        lambda: mimesh.save_clip(mimesh.Clip(CUBE, np.stack([V, V * np.nan])), "a.npz"),
        "NaN or infinity in frame 1",
    ),
    "advice for no rate": (
        lambda: mimesh.save_clip(mimesh.Clip(CUBE, CLIP.vertices, 0), "a.npz"),
        "replace(clip, fps=",
    ),
    "no rate": (lambda: mimesh.save_clip(mimesh.Clip(CUBE, CLIP.vertices, 0), "a.npz"), "expected a frame rate"),
    "one result for save_skinned": (lambda: mimesh.save_skinned(MOVING, "a.glb"), "give [result]"),  # type: ignore[arg-type]
    "a pose for save_skinned": (lambda: mimesh.save_skinned([RESULT], "a.glb"), "expected those of animate"),  # type: ignore[list-item]
    "no joints to save": (lambda: mimesh.save_skinned([MOVING], "a.glb"), "expected a model with joints"),
    "unknown bone names": (lambda: MOVING.save_skinned("a.glb", names="maya"), "names: expected one of own"),
    "bone names as layout": (
        lambda: mimesh.save_skinned([MOVING], "a.glb", layout="unreal"),
        "layout: expected mimesh.Layout(...), found 'unreal'",
    ),  # type: ignore[arg-type]
    "None as path to save to": (lambda: MOVING.save(None), "path: expected a path, found None"),  # type: ignore[arg-type]
    "jobs that are paths": (lambda: mimesh.batch(["a.obj"]), "expected dictionaries"),  # type: ignore[list-item]
    "one job alone": (lambda: mimesh.batch({"identity": "a"}), "expected a list of dictionaries"),  # type: ignore[arg-type]
    "options as text": (lambda: mimesh.batch("a", "b", "c.obj", options="stop 5"), "options: expected a dictionary"),  # type: ignore[arg-type]
    "no workers": (lambda: mimesh.batch("a", "b", "c.obj", workers=0), "workers: expected 1 or more"),
    "no output": (lambda: mimesh.batch("a", "b"), "output: expected a pattern"),
}
"""Mistake -> the call, and a part of what the message says."""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory) -> dict[str, tuple[str, str]]:
    """Run all mistakes in a process of its own: here jaxtyping checks arrays before our code does."""
    command = [sys.executable, __file__]
    folders = [str(Path(mimesh.__file__).parents[1]), str(Path(__file__).parent / "support")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    done = subprocess.run(command, env=environment, cwd=tmp_path_factory.mktemp("run"), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return {name: (kind, message) for name, kind, message in map(json.loads, done.stdout.splitlines())}


@pytest.mark.slow
@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_raises_an_error_that_names_no_option(name, outcomes):
    kind, message = outcomes[name]
    assert kind == "InputError", message
    assert MISTAKES[name][1] in message
    assert not re.search(r"(?<![\w-])(--[a-z]|-[mo]\b)", message)


def test_arguments_that_a_function_lacks_are_refused_by_python():
    with pytest.raises(TypeError, match="unexpected keyword argument 'frnt'"):
        mimesh.transfer(CUBE, CUBE, frnt="+z")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"missing .*argument"):
        mimesh.transfer(CUBE)  # type: ignore[call-arg]


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
    assert any("give up=... and front=..." in note for note in mimesh.transfer(slab, CUBE, "copy").notes)
    with naming_options():
        assert any("give --up and --front" in note for note in mimesh.transfer(slab, CUBE, "copy").notes)


@pytest.mark.parametrize(
    ("named", "python", "command_line"),
    [
        (("driving_up",), "driving_up", "--driving-up"),
        (("driving_up", "+z"), 'driving_up="+z"', "--driving-up +z"),
        (("start", 1), "start=1", "--start 1"),
        (("reference", ...), "reference=...", "--reference"),
        (("model", "mime"), 'model="mime"', "-m mime"),
        (("model",), "model", "--model"),
        (("ground", False), "ground=False", "--no-ground"),
    ],
)
def test_options_are_named_as_the_front_end_has_them(named, python, command_line):
    assert option(*named) == python
    with naming_options():
        assert option(*named) == command_line
    with naming_options(lambda name, value: f"<{name}>"):
        assert option(*named) == f"<{named[0]}>"


def test_kinds_that_are_not_known_are_left_to_the_function():
    @public
    def twice(value: int | complex) -> complex:
        return 2 * value

    assert twice(1j) == 2j


def outcome(call: Callable[[], Any]) -> tuple[str, str]:
    """Return the name of the exception that a call raises ("" for none), and its message."""
    try:
        call()
    except Exception as error:
        return type(error).__name__, str(error)
    return "", ""


def check_conversions() -> None:
    """Check that what can be converted without loss is, and that a float32 mesh can be used."""
    mesh = mimesh.Mesh(V.tolist(), F.astype(float).tolist())
    assert mimesh.Clip(mesh, [V.tolist(), V.tolist()], 24).vertices.shape == (2, len(V), 3)
    assert mimesh.Mesh(V.astype(np.float32), F.astype(np.uint8)).faces.dtype == np.int64
    single = mesh.with_vertices(V.astype(np.float32))
    assert mimesh.transfer(single, single, "copy").vertices.shape == V.shape
    assert mimesh.Clip(mesh, V[None], np.array(24)).fps == 24.0  # as archives of NumPy hold it
    assert mimesh.Mesh(V, F, corner_uv=[[[0, 0], [1, 0], [0, 1]]] * len(F)).corner_uv.dtype == np.float64


if __name__ == "__main__":  # run by `outcomes`
    check_conversions()
    Path("a.npz").write_bytes(b"PK")
    for mistake, (wrong, _) in MISTAKES.items():
        print(json.dumps([mistake, *outcome(wrong)]))
