"""PC2: points round trip exactly with the mesh beside them; damaged or unrelated files are refused."""

import struct

import numpy as np
import pytest
import zoo
from nasty import bend

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh


def clip(frames: int = 5, fps: float = 24.0) -> Clip:
    mesh = zoo.cube()
    points = np.stack([mesh.vertices + t * bend(mesh.vertices) / 7 for t in range(frames)]).astype(np.float32)
    return Clip(mesh, points, fps)


def test_points_and_faces_round_trip(tmp_path):
    save_clip(clip(), tmp_path / "walk.pc2")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["walk.obj", "walk.pc2"])
    reread = load_clip(tmp_path / "walk.pc2", fps=None)
    np.testing.assert_array_equal(reread.vertices, clip().vertices)
    np.testing.assert_array_equal(reread.mesh.faces, clip().mesh.faces)
    assert (reread.fps, reread.vertices.dtype) == (30.0, np.float32)


def test_cache_without_a_mesh_is_a_point_cloud_and_no_mesh_of_several_frames(tmp_path):
    save_clip(clip(1), tmp_path / "a.pc2")
    (tmp_path / "a.obj").unlink()
    mesh = load_mesh(tmp_path / "a.pc2")
    np.testing.assert_array_equal(mesh.vertices, clip().vertices[0])
    assert len(mesh.faces) == 0
    save_clip(clip(), tmp_path / "b.pc2")
    with pytest.raises(InputError, match="expected one mesh, found a clip of 5 frames"):
        load_mesh(tmp_path / "b.pc2")


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
    save_clip(clip(), tmp_path / "a.pc2")
    assert (tmp_path / "a.obj").read_text() == text


def test_written_bytes_are_those_of_the_format(tmp_path):
    save_clip(clip(2), tmp_path / "a.pc2")
    pc2 = (tmp_path / "a.pc2").read_bytes()
    assert struct.unpack_from("<12siiffi", pc2) == (b"POINTCACHE2\0", 1, 8, 0.0, 1.0, 2)
    assert pc2[32:] == clip(2).vertices.astype("<f4").tobytes()


def test_samples_are_the_frames_of_their_step_apart(tmp_path):
    save_clip(clip(), tmp_path / "a.pc2")
    data = (tmp_path / "a.pc2").read_bytes()
    for step, rate in ((2.0, 15.0), (0.5, 60.0)):
        (tmp_path / "a.pc2").write_bytes(data[:24] + struct.pack("<f", step) + data[28:])
        np.testing.assert_array_equal(load_clip(tmp_path / "a.pc2").vertices, clip().vertices)
        assert load_clip(tmp_path / "a.pc2").fps == rate
        assert load_clip(tmp_path / "a.pc2", fps=24.0).fps == 24
    for step in (0.0, -1.0, np.nan):
        (tmp_path / "a.pc2").write_bytes(data[:24] + struct.pack("<f", step) + data[28:])
        with pytest.raises(InputError, match=f"expected a positive sample rate, found {step:g}; export it again"):
            load_clip(tmp_path / "a.pc2")


def test_truncated_caches_are_refused(tmp_path):
    save_clip(clip(), tmp_path / "a.pc2")
    data = (tmp_path / "a.pc2").read_bytes()
    for size in (1, 7, 20, 100, len(data) - 1):
        (tmp_path / "a.pc2").write_bytes(data[:size])
        with pytest.raises(InputError, match="expected"):
            load_clip(tmp_path / "a.pc2")


def test_signalling_nan_is_refused_without_a_warning(tmp_path):
    """The conversion of such a number to another precision is an invalid operation."""
    path = tmp_path / "a.pc2"
    save_clip(clip(2), path)
    content = path.read_bytes()
    path.write_bytes(content[:-4] + b"\x01\x00\xa0\x7f")
    for fps in (None, 20.0):
        with pytest.raises(InputError, match="expected finite coordinates, found NaN or infinity"):
            load_clip(path, fps=fps)
