"""Animated glTF: what a client shows at time k / fps is frame k, for files of others and for meshes from elsewhere."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import gltf_samples as samples
import numpy as np
import pytest
import zoo
from gltf_twin import Twin

from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.io.gltf import read_gltf, write_gltf, write_gltf_clip


def frames_of(vertices: np.ndarray, count: int = 5) -> np.ndarray:
    """A rising, turning, bending motion that begins away from the rest shape."""
    frames = []
    for time in np.linspace(0.3, 1.5, count):
        cosine, sine = np.cos(time), np.sin(time)
        turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        frames.append((vertices + 0.2 * np.sin(2 * vertices[:, ::-1] + time)) @ turn.T + [0, time, 0])
    return np.stack(frames)


def clip_of(mesh: Mesh, count: int = 5) -> Clip:
    return Clip(mesh, frames_of(mesh.vertices, count), fps=24.0)


def dressed_cube() -> Mesh:
    """A cube from elsewhere with everything: parts (two of one material), uv seams, hard edges, a loose vertex."""
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
def test_own_file_plays_the_clip(name, tmp_path):
    clip = clip_of(read_gltf(getattr(samples, name)().glb(tmp_path / "a.glb")))
    write_gltf_clip(clip, tmp_path / "b.glb")
    twin, scale = Twin(tmp_path / "b.glb"), np.ptp(clip.vertices)
    for span in clip.mesh.source.rest.vertex_ranges:
        for primitive in span.primitives:
            for k, frame in enumerate(clip.vertices):
                shown = twin.points(span.node, primitive, twin.weights_at(span.node, k / clip.fps))
                np.testing.assert_allclose(shown, frame[span.start : span.stop], atol=1e-6 * scale)
            between = twin.points(span.node, primitive, twin.weights_at(span.node, 2.25 / clip.fps))
            expected = 0.75 * clip.vertices[2] + 0.25 * clip.vertices[3]
            np.testing.assert_allclose(between, expected[span.start : span.stop], atol=1e-6 * scale)


def test_normals_play_too(tmp_path):
    clip = clip_of(read_gltf(samples.hero().glb(tmp_path / "a.glb")))
    write_gltf_clip(clip, tmp_path / "b.glb")
    twin = Twin(tmp_path / "b.glb")
    for k, frame in enumerate(clip.vertices):
        corner_normals = clip.mesh.with_vertices(frame).corner_normals
        for (node, primitive), (start, stop) in clip.mesh.source.rest.faces.items():
            shown = twin.normals(node, primitive, twin.weights_at(node, k / clip.fps))
            first = next(span.start for span in clip.mesh.source.rest.vertex_ranges if span.node == node)
            corners = shown[clip.mesh.faces[start:stop] - first]
            np.testing.assert_allclose(corners, corner_normals[start:stop], atol=1e-5)


@pytest.mark.parametrize("name", ["hero", "props"])
def test_the_rest_of_the_file_is_that_of_the_still(name, tmp_path):
    """Frame 0 written as a mesh, and nothing but targets, weights, one animation on top of it."""
    mesh = read_gltf(getattr(samples, name)().glb(tmp_path / "a.glb"))
    clip = clip_of(mesh)
    write_gltf_clip(clip, tmp_path / "b.glb")
    write_gltf_clip(Clip(mesh, clip.vertices[:1]), tmp_path / "c.glb")
    moving, still = Twin(tmp_path / "b.glb"), Twin(tmp_path / "c.glb")
    for key in ("nodes", "materials", "images", "textures", "scenes", "cameras"):
        assert getattr(moving.file, key) == getattr(still.file, key)
    assert still.file.animations == []
    assert [a.name for a in moving.file.animations] == ["a"]
    for mesh_moving, mesh_still in zip(moving.file.meshes, still.file.meshes, strict=True):
        for one, other in zip(mesh_moving.primitives, mesh_still.primitives, strict=True):
            assert vars(one.attributes) == vars(other.attributes)
            assert (one.indices, one.material) == (other.indices, other.material)
            assert not other.targets
    np.testing.assert_allclose(read_gltf(tmp_path / "c.glb").vertices, clip.vertices[0], atol=1e-5)


def test_all_primitives_of_a_mesh_have_one_number_of_targets(tmp_path):
    """Lines and points of a moving mesh too, and the file's own targets are gone."""
    path = samples.hero().glb(tmp_path / "a.glb")
    write_gltf_clip(clip_of(read_gltf(path)), tmp_path / "b.glb")
    twin = Twin(tmp_path / "b.glb")
    for mesh in twin.file.meshes:
        assert [len(primitive.targets) for primitive in mesh.primitives] == [4] * len(mesh.primitives)
        assert mesh.weights == [0, 0, 0, 0]
        assert mesh.extras["targetNames"] == ["frame 1", "frame 2", "frame 3", "frame 4"]
    assert twin.file.meshes[0].extras["lod"] == 0
    dust = twin.points(3, 3, twin.weights_at(3, 3 / 24))
    np.testing.assert_allclose(dust, Twin(path).points(3, 3), atol=3e-6)


def test_at_a_key_one_target_is_active_and_between_keys_two(tmp_path):
    clip = clip_of(zoo.cube(), 7)
    write_gltf_clip(clip, tmp_path / "b.glb")
    twin = Twin(tmp_path / "b.glb")
    for k in range(7):
        assert twin.weights_at(0, k / 24) == pytest.approx(np.eye(7)[k, 1:].tolist(), abs=1e-6)
    assert np.count_nonzero(twin.weights_at(0, 3.5 / 24)) == 2
    accessor = twin.file.accessors[twin.file.animations[0].samplers[0].input]
    assert (accessor.min, accessor.max) == ([0.0], pytest.approx([6 / 24]))


@pytest.mark.parametrize("make", [dressed_cube, *zoo.ZOO], ids=lambda make: make.__name__)
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_mesh_from_elsewhere_plays_the_clip(make, suffix, tmp_path):
    mesh = make()
    clip = clip_of(mesh)
    write_gltf_clip(clip, tmp_path / f"b{suffix}")
    twin = Twin(tmp_path / f"b{suffix}")
    assert twin.file.animations[0].name == mesh.name
    count = len(twin.file.meshes[0].primitives)
    for k, frame in enumerate(clip.vertices):
        turned = mesh.with_vertices(frame)
        points = [twin.points(0, p, twin.weights_at(0, k / 24)) for p in range(count)]
        wanted, shown = frame[mesh.faces], np.zeros((0, 3, 3))
        if len(mesh.faces):
            shown = np.concatenate([points[p][twin.indices(0, p)] for p in range(count)]).reshape(-1, 3, 3)
        np.testing.assert_allclose(shown, wanted, atol=2e-6)
        np.testing.assert_allclose(
            np.unique(np.concatenate(points).round(4), axis=0), np.unique(frame.round(4), axis=0)
        )
        if mesh.corner_normals is not None:
            normals = [twin.normals(0, p, twin.weights_at(0, k / 24))[twin.indices(0, p)] for p in range(count)]
            np.testing.assert_allclose(np.concatenate(normals).reshape(-1, 3, 3), turned.corner_normals, atol=1e-5)


def test_frames_of_float32_are_exact_where_floats_are(tmp_path):
    mesh = zoo.grid()
    frames = np.round(frames_of(mesh.vertices) * 64).astype(np.float32) / 64
    write_gltf_clip(Clip(mesh, frames), tmp_path / "b.glb")
    twin = Twin(tmp_path / "b.glb")
    for k in range(len(frames)):
        np.testing.assert_array_equal(twin.points(0, 0, np.eye(5)[k, 1:].tolist()), frames[k])


@pytest.mark.parametrize("make", zoo.ZOO)
def test_still_without_seams_comes_back_vertex_for_vertex(make, tmp_path):
    mesh = make()
    write_gltf(mesh, tmp_path / "b.glb")
    again = read_gltf(tmp_path / "b.glb")
    np.testing.assert_allclose(again.vertices, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    assert again.parts == () or [part.name for part in again.parts] == [mesh.name]


def test_still_with_seams_comes_back_corner_for_corner(tmp_path):
    mesh = dressed_cube()
    write_gltf(mesh, tmp_path / "b.glb")
    again = read_gltf(tmp_path / "b.glb")
    np.testing.assert_allclose(again.vertices[again.faces], mesh.vertices[mesh.faces], atol=1e-6)
    np.testing.assert_allclose(again.corner_uv, mesh.corner_uv, atol=1e-6)
    np.testing.assert_allclose(again.corner_normals, mesh.corner_normals, atol=1e-6)
    assert [(part.start, part.stop) for part in again.parts] == [(0, 4), (4, 6), (6, 12)]
    red, bare, again_red = (part.material for part in again.parts)
    assert (red, again_red, bare) == (mesh.parts[0].material, red, None)
    assert len(Twin(tmp_path / "b.glb").file.images) == 1
    assert any(np.allclose(vertex, [0.5, 0.5, 2.0]) for vertex in again.vertices)  # the loose one too


def test_texture_without_uv_is_left_out(tmp_path: Path):
    mesh = dataclasses.replace(dressed_cube(), corner_uv=None)
    write_gltf(mesh, tmp_path / "b.glb")
    file = Twin(tmp_path / "b.glb").file
    assert (file.images, file.textures, file.materials[0].pbrMetallicRoughness.baseColorTexture) == ([], [], None)


def test_many_vertices_get_wide_indices(tmp_path):
    mesh = zoo.grid(300)
    write_gltf(mesh, tmp_path / "b.glb")
    again = read_gltf(tmp_path / "b.glb")
    np.testing.assert_array_equal(again.faces, mesh.faces)
    file = Twin(tmp_path / "b.glb").file
    assert file.accessors[file.meshes[0].primitives[0].indices].componentType == 5125
