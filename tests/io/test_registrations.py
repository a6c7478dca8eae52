"""Meshes in the layouts of FAUST, DFAUST's folders and MG-dataset are read with their vertices in order."""

from __future__ import annotations

import numpy as np
import pytest
from matrix import matrix

from mimesh.bodies import load_body
from mimesh.cli import run
from mimesh.evaluate.remesh import subdivided
from mimesh.io import load_clip, load_mesh

BODY = load_body()


def write_faust(path, vertices: np.ndarray, faces: np.ndarray):
    """FAUST's tr_reg_000.ply: binary little-endian, float positions, lists of uchar and int."""
    head = (
        "ply\nformat binary_little_endian 1.0\ncomment VCGLIB generated\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    path.write_bytes(head.encode() + vertices.astype("<f4").tobytes() + rows.tobytes())
    return path


def write_mg(path, vertices: np.ndarray, faces: np.ndarray):
    """MG-dataset's smpl_registered.obj: texture coordinates, and faces that name both."""
    corners = faces.reshape(-1) + 1
    with path.open("w") as file:
        file.write("mtllib smpl_registered.mtl\nusemtl material_0\n")
        file.writelines(f"v {x:.8f} {y:.8f} {z:.8f}\n" for x, y, z in vertices)
        file.writelines(f"vt {u:.6f} {v:.6f}\n" for u, v in np.random.default_rng(0).random((len(corners), 2)))
        for k in range(0, len(corners), 3):
            file.write("f " + " ".join(f"{corners[c]}/{c + 1}" for c in range(k, k + 3)) + "\n")
    return path


def test_a_registration_of_faust_is_read(tmp_path, capsys):
    path = write_faust(tmp_path / "tr_reg_000.ply", BODY.vertices, BODY.faces)
    mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.vertices, BODY.vertices, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, BODY.faces)
    assert run(["look", str(path)]) == 0
    assert "6,890" in capsys.readouterr().out


def test_registrations_of_faust_in_one_folder_are_a_clip(tmp_path):
    for k in range(3):
        write_faust(tmp_path / f"tr_reg_{k:03d}.ply", BODY.vertices + k, BODY.faces)
    clip = load_clip(tmp_path)
    np.testing.assert_allclose(clip.vertices, [BODY.vertices + k for k in range(3)], atol=1e-5)


@pytest.mark.slow
def test_a_registration_of_mg_is_read(tmp_path, capsys):
    vertices, faces = subdivided().positions(BODY.vertices), subdivided().faces
    assert (len(vertices), len(faces)) == (27554, 4 * 13776)
    path = write_mg(tmp_path / "smpl_registered.obj", vertices, faces)
    mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.vertices, vertices, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, faces)
    assert mesh.corner_uv is not None
    assert run(["convert", str(path), str(tmp_path / "out.ply")]) == 0
    np.testing.assert_allclose(load_mesh(tmp_path / "out.ply").vertices, vertices, atol=1e-5)


@matrix("first", [0, 1], quick=[1])
def test_exported_frames_of_dfaust_are_a_clip(first, tmp_path):
    moved = [BODY.vertices + 0.1 * k for k in range(12)]
    for k, vertices in enumerate(moved):
        lines = [f"v {x:f} {y:f} {z:f}\n" for x, y, z in vertices]
        lines += [f"f {a} {b} {c}\n" for a, b, c in BODY.faces + 1]
        (tmp_path / f"{k + first:05d}.obj").write_text("".join(lines))
    clip = load_clip(tmp_path, fps=60.0)
    np.testing.assert_allclose(clip.vertices, moved, atol=1e-5)
    np.testing.assert_array_equal(clip.mesh.faces, BODY.faces)
