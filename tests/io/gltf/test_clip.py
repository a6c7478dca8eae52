"""Clips as morph targets: at time k / fps a client shows frame k, for meshes with and without a glTF source."""

from __future__ import annotations

import dataclasses

import gltf_samples as samples
import numpy as np
import pytest
import zoo
from gltf_reference import ReferenceReader

from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.io.gltf import read_gltf, write_gltf, write_gltf_clip


def frames_of(vertices: np.ndarray, count: int = 5) -> np.ndarray:
    """A motion that translates, rotates and bends, and whose first frame is not the rest shape."""
    frames = []
    for time in np.linspace(0.3, 1.5, count):
        cosine, sine = np.cos(time), np.sin(time)
        rotation = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        frames.append((vertices + 0.2 * np.sin(2 * vertices[:, ::-1] + time)) @ rotation.T + [0, time, 0])
    return np.stack(frames)


def clip_of(mesh: Mesh, count: int = 5) -> Clip:
    return Clip(mesh, frames_of(mesh.vertices, count), fps=24.0)


def full_featured_cube() -> Mesh:
    """A cube without a source: parts (two of one material), uv seams, hard edges, a vertex without faces."""
    cube = zoo.cube()
    red, plain = Material("red", (1.0, 0.0, 0.0, 0.5), samples.png()), Material("plain", (0.1, 0.2, 0.3, 1.0))
    corners = cube.vertices[cube.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return dataclasses.replace(
        cube,
        vertices=np.concatenate([cube.vertices, [[0.5, 0.5, 2.0]]]),
        corner_uv=np.random.default_rng(0).integers(0, 3, (12, 3, 2)) / 2,
        corner_normals=np.repeat(normals[:, None], 3, axis=1),
        parts=(Part("a", 0, 4, red), Part("b", 4, 4, plain), Part("c", 4, 6, None), Part("d", 6, 12, red)),
    )


@pytest.mark.parametrize("name", ["hero", "props"])
def test_clip_of_a_gltf_source_plays_in_its_own_file(name, tmp_path):
    clip = clip_of(read_gltf(getattr(samples, name)().glb(tmp_path / "a.glb")), 4)
    write_gltf_clip(clip, tmp_path / "b.glb")
    reference, scale = ReferenceReader(tmp_path / "b.glb"), np.ptp(clip.vertices)
    for span in clip.mesh.source.rest.vertex_ranges:
        for primitive in span.primitives:
            for k, frame in enumerate(clip.vertices):
                shown = reference.points(span.node, primitive, reference.weights_at(span.node, k / clip.fps))
                np.testing.assert_allclose(shown, frame[span.start : span.stop], atol=1e-6 * scale)
            between = reference.points(span.node, primitive, reference.weights_at(span.node, 2.25 / clip.fps))
            expected = 0.75 * clip.vertices[2] + 0.25 * clip.vertices[3]
            np.testing.assert_allclose(between, expected[span.start : span.stop], atol=1e-6 * scale)
    for k, frame in enumerate(clip.vertices):
        corner_normals = clip.mesh.with_vertices(frame).corner_normals
        for (node, primitive), (start, stop) in clip.mesh.source.rest.faces.items():
            if reference.attribute(node, primitive, "NORMAL") is None:
                continue
            shown = reference.normals(node, primitive, reference.weights_at(node, k / clip.fps))
            first = next(span.start for span in clip.mesh.source.rest.vertex_ranges if span.node == node)
            corners = shown[clip.mesh.faces[start:stop] - first]
            np.testing.assert_allclose(corners, corner_normals[start:stop], atol=1e-5)


def test_clip_gives_all_primitives_of_a_mesh_the_same_number_of_targets(tmp_path):
    """Lines and points of an animated mesh have targets too, and the source file's targets are dropped."""
    path = samples.hero().glb(tmp_path / "a.glb")
    write_gltf_clip(clip_of(read_gltf(path)), tmp_path / "b.glb")
    reference = ReferenceReader(tmp_path / "b.glb")
    for mesh in reference.file.meshes:
        assert [len(primitive.targets) for primitive in mesh.primitives] == [4] * len(mesh.primitives)
        assert mesh.weights == [0, 0, 0, 0]
        assert mesh.extras["targetNames"] == ["frame 1", "frame 2", "frame 3", "frame 4"]
    assert reference.file.meshes[0].extras["lod"] == 0
    loose_points = reference.points(3, 3, reference.weights_at(3, 3 / 24))
    np.testing.assert_allclose(loose_points, ReferenceReader(path).points(3, 3), atol=3e-6)


def test_clip_has_one_active_target_at_keys_and_two_between(tmp_path):
    clip = clip_of(zoo.cube(), 7)
    write_gltf_clip(clip, tmp_path / "b.glb")
    reference = ReferenceReader(tmp_path / "b.glb")
    for k in range(7):
        assert reference.weights_at(0, k / 24) == pytest.approx(np.eye(7)[k, 1:].tolist(), abs=1e-6)
    assert np.count_nonzero(reference.weights_at(0, 3.5 / 24)) == 2
    accessor = reference.file.accessors[reference.file.animations[0].samplers[0].input]
    assert (accessor.min, accessor.max) == ([0.0], pytest.approx([6 / 24]))


@pytest.mark.parametrize("make", [full_featured_cube, *zoo.ZOO])
def test_clip_of_a_mesh_without_source_plays_in_a_new_file(make, tmp_path):
    mesh = make()
    clip = clip_of(mesh, 3)
    path = tmp_path / ("b.gltf" if make is full_featured_cube else "b.glb")
    write_gltf_clip(clip, path)
    reference = ReferenceReader(path)
    assert reference.file.animations[0].name == mesh.name
    count = len(reference.file.meshes[0].primitives)
    for k, frame in enumerate(clip.vertices):
        moved = mesh.with_vertices(frame)
        points = [reference.points(0, p, reference.weights_at(0, k / 24)) for p in range(count)]
        expected, shown = frame[mesh.faces], np.zeros((0, 3, 3))
        if len(mesh.faces):
            shown = np.concatenate([points[p][reference.indices(0, p)] for p in range(count)]).reshape(-1, 3, 3)
        np.testing.assert_allclose(shown, expected, atol=2e-6)
        np.testing.assert_allclose(
            np.unique(np.concatenate(points).round(4), axis=0), np.unique(frame.round(4), axis=0)
        )
        if mesh.corner_normals is not None:
            normals = [
                reference.normals(0, p, reference.weights_at(0, k / 24))[reference.indices(0, p)] for p in range(count)
            ]
            np.testing.assert_allclose(np.concatenate(normals).reshape(-1, 3, 3), moved.corner_normals, atol=1e-5)


def test_clip_frames_exact_in_float32_stay_exact(tmp_path):
    mesh = zoo.grid()
    frames = np.round(frames_of(mesh.vertices) * 64).astype(np.float32) / 64
    write_gltf_clip(Clip(mesh, frames), tmp_path / "b.glb")
    reference = ReferenceReader(tmp_path / "b.glb")
    for k in range(len(frames)):
        np.testing.assert_array_equal(reference.points(0, 0, np.eye(5)[k, 1:].tolist()), frames[k])


def test_mesh_with_seams_keeps_its_corners_when_written_and_read(tmp_path):
    mesh = full_featured_cube()
    write_gltf(mesh, tmp_path / "b.glb")
    loaded = read_gltf(tmp_path / "b.glb")
    np.testing.assert_allclose(loaded.vertices[loaded.faces], mesh.vertices[mesh.faces], atol=1e-6)
    np.testing.assert_allclose(loaded.corner_uv, mesh.corner_uv, atol=1e-6)
    np.testing.assert_allclose(loaded.corner_normals, mesh.corner_normals, atol=1e-6)
    assert [(part.start, part.stop) for part in loaded.parts] == [(0, 4), (4, 6), (6, 12)]
    red, bare, again_red = (part.material for part in loaded.parts)
    assert (red, again_red, bare) == (mesh.parts[0].material, red, None)
    assert len(ReferenceReader(tmp_path / "b.glb").file.images) == 1
    assert any(np.allclose(vertex, [0.5, 0.5, 2.0]) for vertex in loaded.vertices)  # the vertex without faces too
    write_gltf(dataclasses.replace(mesh, corner_uv=None), tmp_path / "b.glb")
    file = ReferenceReader(tmp_path / "b.glb").file  # textures of a mesh without uv are not written
    assert (file.images, file.textures, file.materials[0].pbrMetallicRoughness.baseColorTexture) == ([], [], None)


@pytest.mark.parametrize(("count", "component"), [(65535, 5123), (65536, 5125)])
def test_mesh_of_many_vertices_gets_32_bit_indices(count, component, tmp_path):
    """The largest value of a type, 65535, is no index."""
    points = np.stack([np.arange(count), np.arange(count) % 2, np.zeros(count)], axis=1)
    mesh = Mesh(points, np.array([[0, 1, 2], [count - 3, count - 2, count - 1]]))
    write_gltf(mesh, tmp_path / "b.glb")
    np.testing.assert_array_equal(read_gltf(tmp_path / "b.glb").faces, mesh.faces)
    file = ReferenceReader(tmp_path / "b.glb").file
    assert file.accessors[file.meshes[0].primitives[0].indices].componentType == component
