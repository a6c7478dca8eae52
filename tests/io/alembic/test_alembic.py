"""Alembic archives: written ones round trip, and archives as other programs write them are read correctly."""

from __future__ import annotations

import dataclasses

import alembic3d
import imath
import numpy as np
import pytest
import zoo
from alembic3d import Abc, AbcGeom
from fork_server import ForkServer
from nasty import CUBE_SHARED_NORMALS, bend, rotation

from mimesh.core.errors import InputError
from mimesh.core.geometry import face_vectors, vertex_normals
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import child_process, load_clip, load_mesh, save_clip, save_mesh
from mimesh.io.polygons import polygon_sizes

pytestmark = pytest.mark.usefixtures("in_process")

TimeSampling = alembic3d.AbcCoreAbstract.TimeSampling
CUBE_QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def wave(vertices: np.ndarray, count: int) -> np.ndarray:
    frames = np.stack([(1 - t) * vertices + t * bend(vertices) for t in np.linspace(0, 1, count)])
    return frames.astype(np.float32).astype(np.float64)


def full_clip() -> Clip:
    """Build a moving cube with texture coordinates, normals, parts and materials."""
    cube = zoo.cube()
    uv = np.random.default_rng(0).random((12, 3, 2)).astype(np.float32).astype(np.float64)
    flat = face_vectors(cube.vertices, cube.faces)
    normals = np.repeat(flat[:, None] / np.linalg.norm(flat, axis=1)[:, None, None], 3, axis=1)
    parts = (Part("skin", 0, 4, Material("skin")), Part("Stoff é/2", 4, 12, Material("Stoff é_2")))
    mesh = dataclasses.replace(cube, corner_uv=uv, corner_normals=normals, parts=parts)
    return Clip(mesh, wave(cube.vertices, 7), 24.0)


# Helpers that write archives with features that `write_alembic_clip` does not write.
def times(seconds: list[float]) -> TimeSampling:
    stored = alembic3d.AbcCoreAbstract.TimeVector()
    for second in seconds:
        stored.append(second)
    kinds = alembic3d.AbcCoreAbstract
    return TimeSampling(kinds.TimeSamplingType(kinds.AcyclicFlag.kAcyclic), stored)


def rate(fps: float, start: float = 0.0) -> TimeSampling:
    return TimeSampling(1.0 / fps, start)


def timed(parent, sampling: TimeSampling | None) -> Abc.Argument:
    return Abc.Argument(parent.getArchive().addTimeSampling(sampling or rate(24)))


def add_transform(parent, name: str, matrices, sampling=None, inherits: bool = True):
    transform = AbcGeom.OXform(parent, name, timed(parent, sampling))
    for matrix in matrices:
        sample = AbcGeom.XformSample()
        sample.setMatrix(imath.M44d(*np.asarray(matrix, float).T.ravel()))
        sample.setInheritsXforms(inherits)
        transform.getSchema().set(sample)
    return transform


def add_mesh(parent, name: str, frames, polygons, sampling=None, kind=AbcGeom.OPolyMesh, sample_type=None):
    shape = kind(parent, name, timed(parent, sampling))
    for vertices in frames:
        shape.getSchema().set(polygon_sample(vertices, polygons, sample_type or AbcGeom.OPolyMeshSchemaSample))
    return shape


def polygon_sample(vertices, polygons, sample_type=AbcGeom.OPolyMeshSchemaSample):
    """Polygons that run counter-clockwise become Alembic's."""
    corners = np.array([vertex for polygon in polygons for vertex in polygon[::-1]], np.int32)
    sizes = np.array([len(polygon) for polygon in polygons], np.int32)
    points = imath.V3fArrayFromBuffer(np.ascontiguousarray(vertices, np.float32))
    return sample_type(points, imath.IntArrayFromBuffer(corners), imath.IntArrayFromBuffer(sizes))


def matrix(linear=None, shift=(0.0, 0.0, 0.0)) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = np.eye(3) if linear is None else linear
    result[:3, 3] = shift
    return result


def moved(vertices: np.ndarray, T: np.ndarray) -> np.ndarray:
    return vertices @ T[:3, :3].T + T[:3, 3]


def test_clip_round_trips_with_uv_normals_and_face_sets(tmp_path):
    clip = full_clip()
    save_clip(clip, tmp_path / "kleid é.abc")
    reread = load_clip(tmp_path / "kleid é.abc")
    assert (reread.fps, len(reread), reread.mesh.name) == (24.0, 7, "kleid é")
    np.testing.assert_array_equal(reread.vertices, clip.vertices)
    np.testing.assert_array_equal(reread.mesh.faces, clip.mesh.faces)
    np.testing.assert_array_equal(reread.mesh.corner_uv, clip.mesh.corner_uv)
    np.testing.assert_allclose(reread.mesh.corner_normals, clip.mesh.corner_normals, atol=1e-6)
    assert [(part.name, part.start, part.stop) for part in reread.mesh.parts] == [("skin", 0, 4), ("Stoff é_2", 4, 12)]
    assert [part.material for part in reread.mesh.parts] == [part.material for part in clip.mesh.parts]
    schema = AbcGeom.IPolyMesh(shape_of(tmp_path / "kleid é.abc"), Abc.WrapExistingFlag.kWrapExisting).getSchema()
    assert str(schema.getTopologyVariance()) == "kHomogenousTopology"
    assert [schema.getTimeSampling().getSampleTime(k) for k in (0, 6)] == [0.0, 0.25]
    box = schema.getSelfBoundsProperty().getValue(Abc.ISampleSelector(0.25))
    np.testing.assert_allclose([list(box.min()), list(box.max())], [clip.vertices[6].min(0), clip.vertices[6].max(0)])
    corners = np.asarray(schema.getFaceIndicesProperty().getValue()).reshape(-1, 3)
    np.testing.assert_array_equal(corners[:, ::-1], clip.mesh.faces)  # clockwise


def test_materials_of_equal_name_stay_separate(tmp_path):
    red, green = (Material("skin", color) for color in ((1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)))
    parts = (Part("a", 0, 2, red), Part("b", 2, 6, green), Part("skin", 6, 10), Part("c", 10, 12, red))
    save_mesh(dataclasses.replace(zoo.cube(), parts=parts), tmp_path / "a.abc")
    reread = load_mesh(tmp_path / "a.abc")
    assert [(part.name, part.stop - part.start) for part in reread.parts] == [("skin", 4), ("skin_2", 4), ("skin_3", 4)]


def test_normals_rotate_with_the_surface(tmp_path):
    clip = full_clip()
    turn = np.stack([clip.mesh.vertices, clip.mesh.vertices @ rotation().T])
    save_clip(dataclasses.replace(clip, vertices=turn), tmp_path / "a.abc")
    shape = AbcGeom.IPolyMesh(shape_of(tmp_path / "a.abc"), Abc.WrapExistingFlag.kWrapExisting).getSchema()
    normals = shape.getNormalsParam().getExpandedValue(Abc.ISampleSelector(1 / 24.0)).getVals()
    corners = np.asarray(normals).reshape(-1, 3, 3)[:, ::-1]
    np.testing.assert_allclose(corners, clip.mesh.corner_normals @ rotation().T, atol=1e-6)


def shape_of(path):
    return Abc.IArchive(str(path)).getTop().children[0].children[0]


def test_static_clips_keep_their_frames(tmp_path):
    save_clip(Clip(zoo.cube(), np.repeat(zoo.cube().vertices[None], 5, axis=0), 12.0), tmp_path / "a.abc")
    assert (len(load_clip(tmp_path / "a.abc")), load_clip(tmp_path / "a.abc").fps) == (5, 12.0)


def test_polygons_of_a_file_are_kept(tmp_path):
    (tmp_path / "cube.obj").write_bytes(CUBE_SHARED_NORMALS)
    mesh = load_mesh(tmp_path / "cube.obj")
    assert (polygon_sizes(mesh) == 4).all()
    save_mesh(mesh, tmp_path / "a.abc")
    reread = load_mesh(tmp_path / "a.abc")
    np.testing.assert_array_equal(polygon_sizes(reread), polygon_sizes(mesh))
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    np.testing.assert_allclose(reread.corner_normals, mesh.corner_normals, atol=1e-6)
    save_mesh(reread.with_vertices(bend(reread.vertices)), tmp_path / "b.abc")
    np.testing.assert_array_equal(polygon_sizes(load_mesh(tmp_path / "b.abc")), polygon_sizes(mesh))


def test_polygons_of_any_size_become_fans(tmp_path):
    around = np.linspace(0, 2 * np.pi, 8)[:7]
    vertices = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    add_mesh(archive.getTop(), "disc", [vertices], [(0, 1, 2, 3, 4), (4, 5), (4, 5, 6), (0, 4, 6)])
    del archive
    mesh = load_mesh(tmp_path / "a.abc")
    assert (face_vectors(mesh.vertices, mesh.faces)[:, 2] > 0).all()
    assert (polygon_sizes(mesh).tolist(), len(mesh.faces)) == ([5, 3, 3], 5)


def test_nested_and_animated_transforms_are_applied(tmp_path):
    turns = [matrix(rotation(), (t, 0, 0)) for t in range(3)]
    scale = matrix(np.diag([2.0, 3.0, 0.5]), (0, 1, 0))
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    outer = add_transform(archive.getTop(), "outer", turns)
    inner = add_transform(outer, "inner", [scale])
    add_mesh(inner, "innerShape", wave(zoo.cube().vertices, 3), CUBE_QUADS)
    add_mesh(add_transform(outer, "free", [scale], inherits=False), "freeShape", [zoo.cube().vertices], CUBE_QUADS)
    del archive, outer, inner
    clip = load_clip(tmp_path / "a.abc")
    assert [part.name for part in clip.mesh.parts] == ["inner", "free"]
    for t, local in enumerate(wave(zoo.cube().vertices, 3)):
        np.testing.assert_allclose(clip.vertices[t, :8], moved(local, turns[t] @ scale), atol=1e-6)
        np.testing.assert_allclose(clip.vertices[t, 8:], moved(zoo.cube().vertices, scale), atol=1e-6)
    np.testing.assert_array_equal(clip.mesh.vertices, clip.vertices[0])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_faces_point_outward_under_mirrors(side, tmp_path):
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    mirror = matrix(rotation() @ np.diag([side, 1.0, 2.0]))
    add_mesh(add_transform(archive.getTop(), "a", [mirror]), "aShape", [zoo.cube().vertices], CUBE_QUADS)
    del archive
    mesh = load_mesh(tmp_path / "a.abc")
    outward = mesh.vertices - mesh.vertices.mean(axis=0)
    assert (np.einsum("vi,vi->v", vertex_normals(mesh.vertices, mesh.faces), outward) > 0).all()


def test_normals_follow_transforms(tmp_path):
    clip = full_clip()
    save_mesh(clip.mesh, tmp_path / "plain.abc")
    stretch = matrix(rotation() @ np.diag([-1.0, 3.0, 0.5]))
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    shape = AbcGeom.OPolyMesh(add_transform(archive.getTop(), "a", [stretch]), "aShape")
    sample = polygon_sample(clip.mesh.vertices, clip.mesh.faces.tolist())
    values = imath.V3fArrayFromBuffer(clip.mesh.corner_normals[:, ::-1].reshape(-1, 3).astype(np.float32))
    sample.setNormals(AbcGeom.ON3fGeomParamSample(values, AbcGeom.GeometryScope.kFacevaryingScope))
    shape.getSchema().set(sample)
    del archive, shape, sample
    mesh = load_mesh(tmp_path / "a.abc")
    flat = face_vectors(mesh.vertices, mesh.faces)
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    np.testing.assert_allclose(mesh.corner_normals, np.repeat(flat[:, None], 3, axis=1), atol=1e-6)


def test_uv_per_vertex_are_read_and_unfit_values_dropped_with_a_note(tmp_path):
    for name, count in (("vertex", 8), ("odd", 5)):
        archive = Abc.OArchive(str(tmp_path / f"{name}.abc"))
        shape = AbcGeom.OPolyMesh(archive.getTop(), "cube")
        sample = polygon_sample(zoo.cube().vertices, CUBE_QUADS)
        uv = imath.V2fArrayFromBuffer(np.arange(2.0 * count).astype(np.float32).reshape(-1, 2))
        sample.setUVs(AbcGeom.OV2fGeomParamSample(uv, AbcGeom.GeometryScope.kVertexScope))
        shape.getSchema().set(sample)
        del archive, shape, sample
    mesh = load_mesh(tmp_path / "vertex.abc")
    np.testing.assert_array_equal(mesh.corner_uv, np.arange(16.0).reshape(-1, 2)[mesh.faces])
    assert load_mesh(tmp_path / "odd.abc").corner_uv is None
    assert load_mesh(tmp_path / "odd.abc").source.notes == ("dropped 'uv' of cube: not one for each corner or vertex",)


def test_only_visible_meshes_are_read(tmp_path):
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    hidden = add_transform(archive.getTop(), "hidden", [np.eye(4)])
    AbcGeom.CreateVisibilityProperty(hidden, 0).setValue(0)
    add_mesh(hidden, "below", [zoo.grid().vertices], zoo.grid().faces.tolist())
    shown = add_mesh(hidden, "shown", [zoo.cube().vertices], CUBE_QUADS)
    AbcGeom.CreateVisibilityProperty(shown, 0).setValue(1)
    AbcGeom.OCamera(archive.getTop(), "camera")
    subdivided = add_mesh(
        archive.getTop(), "sub", [zoo.cube().vertices + 5], CUBE_QUADS, None, AbcGeom.OSubD, AbcGeom.OSubDSchemaSample
    )
    del archive, hidden, shown, subdivided
    mesh = load_mesh(tmp_path / "a.abc")
    assert [part.name for part in mesh.parts] == ["shown", "sub"]
    assert mesh.source.notes[1] == "dropped a hidden mesh, a camera of the archive"
    np.testing.assert_array_equal(mesh.vertices, np.concatenate([zoo.cube().vertices, zoo.cube().vertices + 5]))


def test_time_samplings_may_differ_and_start_anywhere(tmp_path):
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    slide = [matrix(shift=(t, 0, 0)) for t in range(5)]
    add_mesh(add_transform(archive.getTop(), "a", slide, rate(24, 1 / 24)), "aShape", [zoo.cube().vertices], CUBE_QUADS)
    rise = [zoo.cube().vertices + [0, t, 0] for t in (0, 4)]
    add_mesh(archive.getTop(), "b", rise, CUBE_QUADS, rate(6, 1 / 24))
    del archive
    clip = load_clip(tmp_path / "a.abc")
    assert (len(clip), clip.fps) == (5, 24.0)
    np.testing.assert_allclose(clip.vertices[:, 0], [[t, 0, 0] for t in range(5)], atol=1e-6)
    np.testing.assert_allclose(clip.vertices[:, 8], [[0, t, 0] for t in range(5)], atol=1e-6)


def test_uneven_samples_are_resampled(tmp_path):
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    keys = [0, 1, 4, 6, 7]
    frames = [zoo.cube().vertices + [k, 0, 0] for k in keys]
    add_mesh(archive.getTop(), "a", frames, CUBE_QUADS, times([0.5 + k / 25 for k in keys]))
    del archive
    clip = load_clip(tmp_path / "a.abc")
    assert (len(clip), clip.fps) == (8, 25.0)
    np.testing.assert_allclose(clip.vertices[:, 0, 0], np.arange(8), atol=1e-5)
    twice = load_clip(tmp_path / "a.abc", fps=50.0)
    np.testing.assert_allclose(twice.vertices[:, 0, 0], np.arange(15) / 2, atol=1e-5)


def test_transforms_are_interpolated_by_rotation(tmp_path):
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    turn = [matrix(2 * np.eye(3)), matrix(2 * quarter)]
    add_mesh(add_transform(archive.getTop(), "a", turn, rate(10)), "aShape", [zoo.cube().vertices], CUBE_QUADS)
    del archive
    half = load_clip(tmp_path / "a.abc", fps=20.0).vertices[1]
    eighth = np.sqrt(0.5) * np.array([[1.0, -1, 0], [1, 1, 0], [0, 0, np.sqrt(2)]])
    np.testing.assert_allclose(half, zoo.cube().vertices @ (2 * eighth).T, atol=1e-6)


@pytest.mark.parametrize("change", ["faces", "points"])
def test_changing_topology_names_the_frame(change, tmp_path):
    archive = Abc.OArchive(str(tmp_path / "a.abc"))
    shape = add_mesh(archive.getTop(), "fluid", wave(zoo.cube().vertices, 3), CUBE_QUADS)
    if change == "faces":
        shape.getSchema().set(polygon_sample(zoo.cube().vertices, [*CUBE_QUADS[1:], CUBE_QUADS[0]]))
    else:
        shape.getSchema().set(polygon_sample(zoo.grid().vertices, CUBE_QUADS))
    del archive, shape
    assert len(load_mesh(tmp_path / "a.abc").faces) == 12
    with pytest.raises(InputError, match="expected one topology in all frames, found another in frame 3 of 'fluid'"):
        load_clip(tmp_path / "a.abc")


def test_progress_is_reported(tmp_path):
    calls = []
    save_clip(full_clip(), tmp_path / "a.abc", progress=lambda done, count: calls.append((done, count)))
    assert calls == [(k, 7) for k in range(1, 8)]
    calls.clear()
    load_clip(tmp_path / "a.abc", progress=lambda done, count: calls.append((done, count)))
    # The frames are read in another process, which is looked at from time to time.
    assert calls == sorted(set(calls))
    assert calls[-1] == (7, 7)


@pytest.mark.slow
def test_truncated_archives_are_refused_without_a_crash(tmp_path, monkeypatch):
    server = ForkServer()
    monkeypatch.setattr(child_process, "_run", server.run)
    save_clip(full_clip(), tmp_path / "whole.abc")
    data = (tmp_path / "whole.abc").read_bytes()
    half = len(data) // 2
    contents = [data[:length] for length in (1, 6, 16, 100, half, len(data) - 1)]
    contents += [data[:5] + b"\0" + data[6:], data[:half] + bytes(len(data) - half)]  # not finished, zeroed
    for number, content in enumerate(contents):
        path = tmp_path / f"{number}.abc"
        path.write_bytes(content)
        with pytest.raises(InputError) as caught:
            load_clip(path)
        assert str(caught.value).startswith(f"{path}: expected ")
    server.close()


def test_other_kinds_of_files_and_archives_without_meshes_are_explained(tmp_path):
    for head, words in ((b"\x89HDF\r\n\x1a\n", "older HDF5"), (b"solid cube", "begins b'solid'")):
        (tmp_path / "a.abc").write_bytes(head + bytes(100))
        with pytest.raises(InputError, match=words):
            load_mesh(tmp_path / "a.abc")
    archive = Abc.OArchive(str(tmp_path / "b.abc"))
    AbcGeom.OCamera(archive.getTop(), "camera")
    del archive
    with pytest.raises(InputError, match="expected an archive with visible meshes, found a camera"):
        load_mesh(tmp_path / "b.abc")
