"""Meshes in the layouts of FAUST and of DFAUST's folders are read with their vertices in order."""

from __future__ import annotations

import numpy as np
import pytest

from mimesh.bodies import load_body
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


def test_registrations_of_faust_are_read_and_those_in_one_folder_are_a_clip(tmp_path):
    for k in range(3):
        write_faust(tmp_path / f"tr_reg_{k:03d}.ply", BODY.vertices + k, BODY.faces)
    mesh = load_mesh(tmp_path / "tr_reg_000.ply")
    np.testing.assert_allclose(mesh.vertices, BODY.vertices, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, BODY.faces)
    np.testing.assert_allclose(load_clip(tmp_path).vertices, [BODY.vertices + k for k in range(3)], atol=1e-5)


@pytest.mark.parametrize("first", [0, 1])
def test_exported_frames_of_dfaust_are_a_clip(first, tmp_path):
    moved = [BODY.vertices + 0.1 * k for k in range(2)]
    for k, vertices in enumerate(moved):
        lines = [f"v {x:f} {y:f} {z:f}\n" for x, y, z in vertices]
        lines += [f"f {a} {b} {c}\n" for a, b, c in BODY.faces + 1]
        (tmp_path / f"{k + first:05d}.obj").write_text("".join(lines))
    clip = load_clip(tmp_path, fps=60.0)
    np.testing.assert_allclose(clip.vertices, moved, atol=1e-5)
    np.testing.assert_array_equal(clip.mesh.faces, BODY.faces)
