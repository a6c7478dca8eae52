"""Vertex colours: read from every format that has them, converted, and written in that format's encoding."""

from __future__ import annotations

import dataclasses

import gltf_samples as samples
import numpy as np
import pytest
import trimesh
import zoo
from gltf_reference import json_of

from mimesh.core.mesh import Clip, permute_vertices
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.io.colors import linear_rgba, srgb_rgba, with_alpha


def encoded(linear: float) -> float:
    """One value of the sRGB curve, as its standard has it."""
    return 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055


def painted(alpha: bool = True):
    """A cube whose colours are bytes once they are sRGB-encoded."""
    values = np.random.default_rng(0).integers(0, 256, (8, 4)) / 255
    values[:, 3] = values[:, 3] if alpha else 1.0
    return dataclasses.replace(zoo.cube(), vertex_colors=linear_rgba(values))


def test_srgb_encoding_is_that_of_the_standard_and_inverts():
    values = np.linspace(0, 1, 256).repeat(4).reshape(-1, 4)
    linear = linear_rgba(values)
    assert np.allclose(srgb_rgba(linear), values, atol=1e-12)
    assert np.allclose([encoded(float(v)) for v in linear[:, 0]], values[:, 0], atol=1e-6)
    assert np.array_equal(linear[:, 3], values[:, 3])
    assert np.array_equal(linear_rgba(values[:, :3])[:, 3], np.ones(256))


@pytest.mark.parametrize(
    "steps", [["ply"], ["glb"], ["gltf", "ply"], ["ply", "glb", "ply"], ["obj"], ["obj", "glb", "ply"]]
)
def test_colours_survive_conversion_between_formats(steps, tmp_path):
    mesh = first = painted(alpha="obj" not in steps)
    for number, suffix in enumerate(steps):
        save_mesh(mesh, tmp_path / f"{number}.{suffix}")
        mesh = load_mesh(tmp_path / f"{number}.{suffix}")
    index = [np.flatnonzero((mesh.vertices == v).all(axis=1))[0] for v in first.vertices]
    assert np.allclose(mesh.vertex_colors[index], first.vertex_colors, atol=2e-6)


def test_byte_colours_round_trip_exactly(tmp_path):
    mesh = painted()
    save_mesh(mesh, tmp_path / "a.ply")
    save_mesh(load_mesh(tmp_path / "a.ply"), tmp_path / "b.glb")
    save_mesh(dataclasses.replace(load_mesh(tmp_path / "b.glb"), source=None), tmp_path / "c.ply")
    colors = [trimesh.load(tmp_path / name, process=False).visual.vertex_colors for name in ("a.ply", "c.ply")]
    points = [trimesh.load(tmp_path / name, process=False).vertices for name in ("a.ply", "c.ply")]
    for vertex, color in zip(*(points[0], colors[0]), strict=True):
        same = (points[1] == vertex).all(axis=1)
        assert (colors[1][same] == color).all()
    assert np.array_equal(colors[0], np.round(255 * srgb_rgba(mesh.vertex_colors)))


def test_glb_stores_linear_colours_on_a_white_material(tmp_path):
    save_mesh(painted(), tmp_path / "a.glb")
    gltf = json_of(tmp_path / "a.glb")
    assert gltf["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] == [1, 1, 1, 1]
    accessor = gltf["accessors"][gltf["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    assert (accessor["type"], accessor["componentType"]) == ("VEC4", 5126)


def test_missing_colours_are_white_and_values_above_one_are_bytes(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0 255 0 51\nv 1 0 0\nv 0 1 0 0 255 0 # a note\nv 0 0 1 1.0\nf 1 2 3 4\n")
    colors = load_mesh(tmp_path / "a.obj").vertex_colors
    assert np.allclose(srgb_rgba(colors), [[1, 0, 0.2, 1], [1, 1, 1, 1], [0, 1, 0, 1], [1, 1, 1, 1]])


@pytest.mark.parametrize(("kind", "full"), [("double", 1.0), ("ushort", 65535), ("uchar", 255)])
def test_ply_colours_of_every_width(kind, full, tmp_path):
    rows = "".join(f"{x} {y} 0 {full:g} 0 {full / 5:g}\n" for x, y in ((0, 0), (1, 0), (0, 1)))
    kinds = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    (tmp_path / "a.ply").write_text(header + kinds + "end_header\n" + rows)
    assert np.allclose(srgb_rgba(load_mesh(tmp_path / "a.ply").vertex_colors), [[1, 0, 0.2, 1]] * 3)


def test_gltf_colours_are_read_where_primitives_have_them(tmp_path):
    sample = samples.hero()
    mesh = load_mesh(sample.glb(tmp_path / "a.glb"))
    stored = np.frombuffer(sample.data, np.uint8)
    entry = sample.gltf["accessors"][sample.gltf["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = sample.gltf["bufferViews"][entry["bufferView"]]
    rows = stored[view["byteOffset"] :][: view["byteLength"]].reshape(24, 4)[:, :3] / 255
    run = next(run for run in mesh.source.rest.vertex_ranges if run.stop - run.start == 24)
    assert np.allclose(mesh.vertex_colors[run.start : run.stop, :3], rows)
    others = np.delete(mesh.vertex_colors, np.arange(run.start, run.stop), axis=0)
    assert np.array_equal(others, np.ones_like(others))


def test_colours_follow_a_permutation_of_vertices():
    mesh, order = painted(), np.random.default_rng(1).permutation(8)
    assert np.array_equal(permute_vertices(mesh, order).vertex_colors, mesh.vertex_colors[order])
    assert np.array_equal(mesh.with_vertices(mesh.vertices + 1).vertex_colors, mesh.vertex_colors)


@pytest.mark.parametrize("name", ["clip.glb", "frames"])
def test_clips_keep_colours(name, tmp_path):
    mesh = painted(alpha=False)
    save_clip(Clip(mesh, np.stack([mesh.vertices, mesh.vertices + 1])), tmp_path / name)
    colors = load_clip(tmp_path / name).mesh.vertex_colors
    rows = [{tuple(row) for row in np.round(values, 5)} for values in (colors, mesh.vertex_colors)]
    assert rows[0] == rows[1]


def test_nan_colours_become_zero_and_large_ones_are_clipped():
    odd = np.array([[np.nan, np.inf, -np.inf, np.nan], [2.0, -1.0, 0.0, np.inf]])
    assert np.array_equal(linear_rgba(odd), [[0, 1, 0, 0], [1, 0, 0, 1]])
    assert np.array_equal(with_alpha(odd[:, :3]), [[0, 1, 0, 1], [1, 0, 0, 1]])
