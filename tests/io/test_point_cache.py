"""PC2, MDD and NPY: points round trip exactly with the mesh beside them; damaged or unrelated files are refused."""

import struct
import zipfile

import numpy as np
import pytest
import zoo
from nasty import bend

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh

SUFFIXES = (".pc2", ".mdd", ".npy")


def clip(frames: int = 5, fps: float = 24.0) -> Clip:
    mesh = zoo.cube()
    points = np.stack([mesh.vertices + t * bend(mesh.vertices) / 7 for t in range(frames)]).astype(np.float32)
    return Clip(mesh, points, fps)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_points_and_faces_round_trip(suffix, tmp_path):
    save_clip(clip(), tmp_path / f"walk{suffix}")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["walk.obj", f"walk{suffix}"])
    reread = load_clip(tmp_path / f"walk{suffix}", fps=None)
    np.testing.assert_array_equal(reread.vertices, clip().vertices)
    np.testing.assert_array_equal(reread.mesh.faces, clip().mesh.faces)
    assert (reread.fps, reread.vertices.dtype) == (24.0 if suffix == ".mdd" else 30.0, np.float32)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_cache_without_a_mesh_is_a_point_cloud_and_no_mesh_of_several_frames(suffix, tmp_path):
    save_clip(clip(1), tmp_path / f"a{suffix}")
    (tmp_path / "a.obj").unlink()
    mesh = load_mesh(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(mesh.vertices, clip().vertices[0])
    assert len(mesh.faces) == 0
    save_clip(clip(), tmp_path / f"b{suffix}")
    with pytest.raises(InputError, match="expected one mesh, found a clip of 5 frames"):
        load_mesh(tmp_path / f"b{suffix}")


def test_mesh_of_another_vertex_count_is_refused(tmp_path):
    save_mesh(zoo.grid(2), tmp_path / "a.obj")
    with pytest.raises(InputError, match=r"expected a\.obj to be the mesh it belongs to"):
        save_clip(clip(), tmp_path / "a.pc2")
    save_clip(clip(), tmp_path / "b.pc2")
    (tmp_path / "b.pc2").rename(tmp_path / "a.pc2")
    with pytest.raises(InputError, match=r"as many points as a\.obj has vertices"):
        load_clip(tmp_path / "a.pc2")


def test_existing_mesh_is_not_overwritten(tmp_path):
    save_mesh(clip().mesh, tmp_path / "a.obj")
    text = (tmp_path / "a.obj").read_text() + "# mine\n"
    (tmp_path / "a.obj").write_text(text)
    save_clip(clip(), tmp_path / "a.mdd")
    assert (tmp_path / "a.obj").read_text() == text


def test_mdd_is_resampled_at_another_rate(tmp_path):
    save_clip(clip(fps=10.0), tmp_path / "a.mdd")
    reread = load_clip(tmp_path / "a.mdd", fps=20.0)
    frames = clip().vertices.astype(float)
    assert (len(reread), reread.fps) == (9, 20.0)
    np.testing.assert_allclose(reread.vertices[::2], frames, atol=1e-6)
    np.testing.assert_allclose(reread.vertices[1::2], (frames[1:] + frames[:-1]) / 2, atol=1e-6)


def test_written_bytes_are_those_of_the_formats(tmp_path):
    save_clip(clip(2), tmp_path / "a.pc2")
    save_clip(clip(2), tmp_path / "a.mdd")
    pc2, mdd = ((tmp_path / f"a{suffix}").read_bytes() for suffix in (".pc2", ".mdd"))
    assert struct.unpack_from("<12siiffi", pc2) == (b"POINTCACHE2\0", 1, 8, 0.0, 1.0, 2)
    assert struct.unpack_from(">iiff", mdd) == (2, 8, 0.0, np.float32(1 / 24))
    assert pc2[32:] == clip(2).vertices.astype("<f4").tobytes()
    assert mdd[16:] == clip(2).vertices.astype(">f4").tobytes()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_truncated_caches_are_refused(suffix, tmp_path):
    save_clip(clip(), tmp_path / f"a{suffix}")
    data = (tmp_path / f"a{suffix}").read_bytes()
    for size in (1, 7, 20, 100, len(data) - 1):
        (tmp_path / f"a{suffix}").write_bytes(data[:size])
        with pytest.raises(InputError, match="expected"):
            load_clip(tmp_path / f"a{suffix}")


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((2, 3, 4)), r"found float64 \(2, 3, 4\)"),
        (np.zeros((4, 3), int), "expected floating-point numbers, found int64"),
        (np.array([{}], object), "expected a plain NumPy array"),
        (np.zeros((0, 4, 3)), "expected at least one frame"),
    ],
)
def test_arrays_of_other_kinds_are_refused(array, message, tmp_path):
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    with pytest.raises(InputError, match=message):
        load_clip(tmp_path / "a.npy")


def test_fortran_order_and_a_single_frame_are_read(tmp_path):
    points = clip().vertices
    np.save(tmp_path / "a.npy", np.asfortranarray(points))
    np.testing.assert_array_equal(load_clip(tmp_path / "a.npy").vertices, points)
    np.save(tmp_path / "a.npy", points[0].astype(">f8"))
    np.testing.assert_array_equal(load_mesh(tmp_path / "a.npy").vertices, points[0])


@pytest.mark.parametrize("suffix", [".pc2", ".mdd"])
def test_signalling_nan_is_refused_without_a_warning(suffix, tmp_path):
    """The conversion of such a number to another precision is an invalid operation."""
    path = tmp_path / f"a{suffix}"
    save_clip(clip(2), path)
    content = path.read_bytes()
    path.write_bytes(content[:-4] + (b"\x01\x00\xa0\x7f" if suffix == ".pc2" else b"\x7f\xa0\x00\x01"))
    for fps in (None, 20.0):
        with pytest.raises(InputError, match="expected finite coordinates, found NaN or infinity"):
            load_clip(path, fps=fps)


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_arrays_of_python_2_are_read_without_a_warning(suffix, tmp_path):
    """Their headers have whole numbers such as 3L, of which NumPy warns."""
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (1L, 4L, 3L), }\n"
    data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + np.eye(4, 3, dtype="<f4").tobytes()
    path = tmp_path / f"a{suffix}"
    if suffix == ".npy":
        path.write_bytes(data)
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("vertices.npy", data)
    np.testing.assert_array_equal(load_clip(path).vertices, np.eye(4, 3)[None])
