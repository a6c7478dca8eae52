"""A mesh without a rig moves as another shape of itself, vertex by vertex, if it is neither a person nor an animal."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rigs
from creatures import BIRD, Boxes, snake

from mimesh import animate
from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.options import Hints, MotionOptions
from mimesh.io import load_clip, load_mesh, save_mesh

GRID = 14


def tube(thick: float = 0.2, length: float = 2.0, bend: float = 0.0, shift: float = 0.0) -> Mesh:
    """Make a tube along z of GRID rings, closed, bent about x by an angle in all, with its front end thicker."""
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    along = np.linspace(0, 1, GRID)
    centre = np.zeros((GRID, 3))
    heading = bend * along
    step = length / (GRID - 1) * np.stack([0 * along, np.sin(heading), np.cos(heading)], axis=1)
    centre[1:] = np.cumsum(step[:-1], axis=0)
    side, up = np.array([1.0, 0, 0]), np.stack([0 * along, np.cos(heading), -np.sin(heading)], axis=1)
    width = thick * (1 + along)[:, None, None]
    ring = np.cos(angles)[None, :, None] * side + np.sin(angles)[None, :, None] * up[:, None]
    vertices = np.concatenate([(centre[:, None] + width * ring).reshape(-1, 3), centre[[0, -1]]])
    faces = []
    for k in range(GRID - 1):
        for a in range(8):
            b = (a + 1) % 8
            one, two, three, four = 8 * k + a, 8 * k + b, 8 * k + 8 + a, 8 * k + 8 + b
            faces += [(one, two, four), (one, four, three)]
    end = 8 * GRID
    faces += [(end, (a + 1) % 8, a) for a in range(8)]
    faces += [(end + 1, end - 8 + a, end - 8 + (a + 1) % 8) for a in range(8)]
    return Mesh(vertices + [0, 0, shift], np.array(faces), name="tube")


def clip_of(meshes: list[Mesh]) -> Clip:
    return Clip(meshes[0], np.stack([mesh.vertices for mesh in meshes]), 30.0)


BENDS = (0.6, 0.0, -0.5, -0.9)
"""Bends of the frames of the driving; the second has the identity's pose."""


def centred(vertices: np.ndarray) -> np.ndarray:
    return vertices - vertices.mean(axis=1, keepdims=True)


def test_the_other_shape_bends_as_much():
    """Measured: 0.009 for a tube of length 2; the still identity is 0.59 away."""
    identity = tube(thick=0.1, length=2.0)
    result = animate(identity, clip_of([tube(bend=bend) for bend in BENDS]), hints=Hints(body="other"))
    assert result.report["reference"]["frame"] == 1
    truth = np.stack([tube(thick=0.1, length=2.0, bend=bend).vertices for bend in BENDS])
    error = np.linalg.norm(centred(result.clip.vertices) - centred(truth), axis=-1).max()
    still = np.linalg.norm(centred(np.stack([identity.vertices] * 4)) - centred(truth), axis=-1).max()
    assert error < 0.03
    assert still > 0.3
    assert any("frame 1" in note for note in result.notes)


def test_the_same_shape_gives_the_clip_back():
    driving = clip_of([tube(bend=bend) for bend in BENDS])
    result = animate(tube(), driving, hints=Hints(body="other"))
    assert np.abs(centred(result.clip.vertices) - centred(driving.vertices)).max() < 1e-4


def test_other_axes_of_the_driving():
    """A driving whose up axis is another gives the same result; one that heads elsewhere heads there in the result."""
    meshes = [tube(bend=bend) for bend in BENDS]
    z_up, aside = np.array([[[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]])
    plain, up, heading = (
        animate(
            tube(thick=0.1),
            clip_of([Mesh(mesh.vertices @ turn.T, mesh.faces) for mesh in meshes]),
            hints=Hints(body="other", up="+y", front="+z"),
        ).clip.vertices
        for turn in (np.eye(3), z_up, aside)
    )
    assert np.abs(centred(up) - centred(plain)).max() < 1e-4
    assert np.abs(centred(heading) - centred(plain) @ aside.T).max() < 1e-4


@pytest.mark.slow
def test_through_the_command_line_and_by_itself(tmp_path, capsys):
    """A folder of .obj, a tube is neither a person nor an animal: no --body is needed."""
    save_mesh(tube(thick=0.1), tmp_path / "thin.obj")
    (tmp_path / "frames").mkdir()
    for t, bend in enumerate(BENDS):
        save_mesh(tube(bend=bend), tmp_path / "frames" / f"f{t:02d}.obj")
    out = tmp_path / "out.glb"
    command = [
        "animate",
        str(tmp_path / "thin.obj"),
        str(tmp_path / "frames"),
        "-o",
        str(out),
        "--no-preview",
        "--json",
    ]
    assert run([*command, "--fps", "30"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["report"]["reference"]["frame"] == 1
    assert facts["report"]["driving"]["up_from"] == "identity"
    assert len(load_clip(out)) == len(BENDS)


@pytest.mark.slow
def test_a_person_is_still_taken_for_one(tmp_path):
    """Two shapes of the shipped body have one mesh too, but the network of people moves them."""
    person = load_mesh(rigs.character(tmp_path / "a.glb", 1, faces=3000))
    other = load_mesh(rigs.character(tmp_path / "b.glb", 2, faces=3000))
    frames = np.stack([other.vertices, other.vertices])
    plain = Mesh(person.vertices, person.faces, name="person")
    result = animate(plain, Clip(Mesh(other.vertices, other.faces, name="other"), frames, 30.0))
    assert "reference" not in result.report
    assert result.skeleton is not None


def test_what_cannot_be_driven_is_refused(tmp_path, capsys):
    bird, worm = Boxes.of(BIRD).mesh, Boxes.of(snake(4)).mesh
    with pytest.raises(InputError, match="rigs in both files, or two shapes of one mesh, found neither"):
        animate(bird, clip_of([worm, worm]), hints=Hints(body="other"))
    with pytest.raises(InputError, match=r"give it with reference=..."):
        animate(tube(), clip_of([tube(bend=0.5)]), hints=Hints(body="other"))
    with pytest.raises(InputError, match=r"^smooth:"):
        animate(tube(), clip_of([tube(), tube(bend=0.5)]), hints=Hints(body="other"), motion=MotionOptions(smooth=0.1))
    save_mesh(bird, tmp_path / "bird.obj")
    save_mesh(worm, tmp_path / "worm.obj")
    command = ["transfer", str(tmp_path / "bird.obj"), str(tmp_path / "worm.obj"), "--body", "other"]
    assert run([*command, "-o", str(tmp_path / "out.obj")]) == 2
    assert "-m deformation-transfer" in capsys.readouterr().err
