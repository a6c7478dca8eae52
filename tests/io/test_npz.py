"""NumPy archives: meshes and clips, alternative array names, and no pickled objects."""

from __future__ import annotations

import struct
import zipfile

import numpy as np
import pytest
import zoo
from nasty import bend

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_clip_round_trip_is_exact(dtype, tmp_path):
    mesh = zoo.cube()
    frames = np.stack([mesh.vertices, bend(mesh.vertices)]).astype(dtype)
    save_clip(Clip(mesh, frames, 12.5), tmp_path / "a.npz")
    reread = load_clip(tmp_path / "a.npz")
    np.testing.assert_array_equal(reread.vertices, frames)
    np.testing.assert_array_equal(reread.mesh.faces, mesh.faces)
    assert (reread.fps, reread.vertices.dtype) == (12.5, dtype)
    assert load_clip(tmp_path / "a.npz", fps=60.0).fps == 60


@pytest.mark.parametrize(
    ("vertices", "faces"), [("vertices", "faces"), ("v", "f"), ("verts", "triangles"), ("points", "faces")]
)
def test_alternative_array_names_are_read(vertices, faces, tmp_path):
    mesh = zoo.cube()
    np.savez(tmp_path / "a.npz", **{vertices: mesh.vertices, faces: mesh.faces.astype(np.uint16)})
    reread = load_mesh(tmp_path / "a.npz")
    np.testing.assert_array_equal(reread.vertices, mesh.vertices)
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    assert load_clip(tmp_path / "a.npz").vertices.shape == (1, 8, 3)
    assert load_clip(tmp_path / "a.npz").fps == 30


def test_a_rate_may_be_an_array_of_one_number_and_a_wrong_one_is_named(tmp_path):
    points = np.stack([zoo.cube().vertices] * 2)
    for rate in (np.array([12.5]), np.array([[12.5]], np.float32), "12.5"):
        np.savez(tmp_path / "a.npz", vertices=points, fps=rate)
        assert load_clip(tmp_path / "a.npz").fps == 12.5
    for rate, found in ((np.array([30.0, 30.0]), r"float64 \(2,\)"), ("fast", "'fast'")):
        np.savez(tmp_path / "a.npz", vertices=points, fps=rate)
        with pytest.raises(InputError, match=rf"expected a positive frame rate, found {found}; save one as fps"):
            load_clip(tmp_path / "a.npz")
        assert load_clip(tmp_path / "a.npz", fps=24.0).fps == 24


def test_quads_become_triangles(tmp_path):
    np.savez(tmp_path / "a.npz", vertices=zoo.grid(2).vertices, faces=np.array([[0, 2, 3, 1]]))
    np.testing.assert_array_equal(load_mesh(tmp_path / "a.npz").faces, [[0, 2, 3], [0, 3, 1]])


def test_moved_integer_points_become_floats(tmp_path):
    mesh = zoo.cube()
    np.savez(tmp_path / "a.npz", vertices=(10 * mesh.vertices).astype(np.int16), faces=mesh.faces)
    moved = bend(load_mesh(tmp_path / "a.npz").vertices)
    save_mesh(load_mesh(tmp_path / "a.npz").with_vertices(moved), tmp_path / "b.npz")
    np.testing.assert_array_equal(load_mesh(tmp_path / "b.npz").vertices, moved)


def test_people_seen_in_images_stand_where_the_camera_sees_them(tmp_path):
    cube = zoo.cube()
    seen = np.stack([cube.vertices, cube.vertices + [0, 0.5, 0]]).astype(np.float32)
    offset = np.array([[0.25, 1.0, 4.0], [0.5, 1.0, 4.0]], np.float32)
    for name, k in (("clip", slice(None)), ("frames/0", 0), ("frames/1", 1)):
        (tmp_path / "frames").mkdir(exist_ok=True)
        np.savez(tmp_path / f"{name}.npz", pred_vertices=seen[k], pred_cam_t=offset[k], faces=cube.faces)
    for clip in (load_clip(tmp_path / "clip.npz"), load_clip(tmp_path / "frames")):
        np.testing.assert_allclose(clip.vertices, seen + offset[:, None], atol=1e-6)
        assert clip.mesh.up == "-y"
    mesh = load_mesh(tmp_path / "frames/1.npz")
    save_mesh(mesh.with_vertices(mesh.vertices + 1), tmp_path / "moved.npz")
    np.testing.assert_allclose(load_mesh(tmp_path / "moved.npz").vertices, seen[1] + offset[1] + 1, atol=1e-6)
    np.savez(tmp_path / "a.npz", pred_vertices=seen)
    with pytest.raises(InputError, match=r"expected faces beside 'pred_vertices', found none; save them, too"):
        load_clip(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", pred_vertices=seen, pred_cam_t=offset[0], faces=cube.faces)
    with pytest.raises(InputError, match=r"'pred_cam_t' to be numbers of shape \(2, 3\), found float32 \(3,\)"):
        load_clip(tmp_path / "b.npz")


def test_pickled_arrays_are_never_loaded(tmp_path):
    np.savez(tmp_path / "a.npz", vertices=np.array([[0, 0, None]], dtype=object))
    with pytest.raises(InputError, match="expected a NumPy archive of plain arrays"):
        load_mesh(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        (
            {"positions": np.zeros((3, 3))},
            "expected an array called vertices, v, verts, points, pred_vertices, found 'positions'",
        ),
        ({"vertices": np.zeros((3, 4))}, r"found float64 \(3, 4\)"),
        ({"vertices": np.zeros((3, 3), complex)}, r"found complex128 \(3, 3\)"),
        ({"vertices": np.eye(3), "faces": np.eye(3)}, r"expected faces to be whole numbers .* found float64 \(3, 3\)"),
        ({"vertices": np.eye(3), "faces": np.array([0, 1, 2])}, r"found int64 \(3,\)"),
        ({"vertices": np.stack([np.eye(3)] * 2)}, "found a clip of 2 frames"),
    ],
)
def test_invalid_arrays_are_explained(arrays, message, tmp_path):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match=message):
        load_mesh(tmp_path / "a.npz")


def test_clip_without_frames_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", vertices=np.zeros((0, 4, 3)))
    with pytest.raises(InputError, match="expected at least one frame, found none"):
        load_clip(tmp_path / "a.npz")


def test_arrays_of_python_2_are_read_without_a_warning(tmp_path):
    """Their headers have whole numbers such as 3L, of which NumPy warns."""
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (1L, 4L, 3L), }\n"
    data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + np.eye(4, 3, dtype="<f4").tobytes()
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("vertices.npy", data)
    np.testing.assert_array_equal(load_clip(tmp_path / "a.npz").vertices, np.eye(4, 3)[None])
