"""New USD files round trip, also those of meshes that were read from USD."""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import numpy as np
import pytest
import usd_stages as stages
import zoo
from matrix import matrix
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt

from mimesh.core.geometry import face_normals, vertex_normals
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh

pytestmark = pytest.mark.usefixtures("in_process")

PNG = b"\x89PNG and so on"


def bend(vertices: np.ndarray, time: float = 0.7) -> np.ndarray:
    """Rotate, bend, scale and translate points."""
    cosine, sine = np.cos(time), np.sin(time)
    turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    return (1.5 * vertices + 0.2 * np.sin(2 * vertices[:, ::-1] + time)) @ turn.T + [0, time, 2]


def full_mesh(smooth: bool = True) -> Mesh:
    """Build a cube with normals, UVs, parts and materials, under names that are not legal prim names."""
    mesh = zoo.cube()
    flat = np.repeat(face_normals(mesh.vertices, mesh.faces)[:, None], 3, axis=1)
    normals = vertex_normals(mesh.vertices, mesh.faces)[mesh.faces] if smooth else flat
    uv = np.random.default_rng(0).random((12, 3, 2)).astype(np.float32).astype(np.float64)
    skin = Material("Haut é", (1.0, 0.5, 0.25, 1.0), PNG)
    glass = Material("Haut ü", (0.0, 1.0, 0.5, 0.5))
    parts = (Part("1 Kopf", 0, 4, skin), Part("手", 4, 6), Part("足", 6, 10, glass), Part("手", 10, 12, skin))
    return dataclasses.replace(mesh, name="Körper 1", corner_normals=normals, corner_uv=uv, parts=parts)


@matrix(
    ("suffix", "smooth"), [(".usdc", True), (".usda", False), (".usdz", True), (".usd", False)], quick=[(".usdc", True)]
)
def test_new_clip_round_trips(suffix, smooth, tmp_path):
    mesh = full_mesh(smooth)
    frames = np.stack([bend(mesh.vertices, 0.1 * k) for k in range(40)])
    save_clip(Clip(mesh, frames, 23.976), tmp_path / f"my clip{suffix}")
    clip = load_clip(tmp_path / f"my clip{suffix}")
    np.testing.assert_allclose(clip.vertices, frames, rtol=1e-6, atol=1e-6)
    assert clip.fps == pytest.approx(23.976)
    np.testing.assert_array_equal(clip.mesh.faces, mesh.faces)
    np.testing.assert_array_equal(clip.mesh.corner_uv, mesh.corner_uv)
    np.testing.assert_allclose(clip.mesh.corner_normals, mesh.with_vertices(frames[0]).corner_normals, atol=1e-6)
    assert clip.mesh.parts == mesh.parts
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {f"my clip{suffix}"} | ({"my clip_textures"} if suffix != ".usdz" else set())
    resampled = load_clip(tmp_path / f"my clip{suffix}", fps=1.0)
    np.testing.assert_allclose(resampled.vertices[1], 0.024 * frames[23] + 0.976 * frames[24], atol=1e-5)


def test_normals_rotate_and_the_extent_bounds_each_frame(tmp_path):
    mesh = full_mesh(smooth=False)
    frames = np.stack([bend(mesh.vertices, 0.5 * k) for k in range(4)])
    save_clip(Clip(mesh, frames), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    prim = UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("K__rper_1"))
    for k, frame in enumerate(frames):
        expected = mesh.with_vertices(frame).corner_normals
        np.testing.assert_allclose(np.array(prim.GetNormalsAttr().Get(k)), expected.reshape(-1, 3), atol=1e-6)
        np.testing.assert_allclose(np.array(prim.GetExtentAttr().Get(k)), [frame.min(0), frame.max(0)], atol=1e-5)
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1.0)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetFramesPerSecond()) == (0, 3, 30)


def test_polygons_of_a_file_are_kept_in_a_clip(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda", up="Z")
    stages.add_cube(stage, polygons=[*stages.QUADS[:-1], (1, 5, 7), (1, 7, 3)]).CreateOrientationAttr("leftHanded")
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    save_clip(Clip(mesh, np.stack([mesh.vertices, bend(mesh.vertices)])), tmp_path / "b.usdc")
    reread = load_mesh(tmp_path / "b.usdc")
    np.testing.assert_array_equal(reread.source.sizes, [4, 4, 4, 4, 4, 3, 3])
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    assert reread.source.up_axis == "Z"


def test_textures_of_other_files_are_not_overwritten(tmp_path):
    (tmp_path / "a_textures").mkdir()
    (tmp_path / "a_textures" / "Haut___.png").write_bytes(b"mine")
    for _ in range(2):
        save_mesh(full_mesh(), tmp_path / "a.usdc")
    assert (tmp_path / "a_textures" / "Haut___.png").read_bytes() == b"mine"
    assert sorted(path.name for path in (tmp_path / "a_textures").iterdir()) == ["Haut___-2.png", "Haut___.png"]
    assert load_mesh(tmp_path / "a.usdc").parts[0].material.texture == PNG


def character(path: Path) -> Path:
    """Write a stage with a textured mesh under two transforms, and with prims that mimesh does not read."""
    path.parent.mkdir(exist_ok=True)
    (path.parent / "skin.png").write_bytes(PNG)
    stage = stages.new_stage(path, up="Z")
    UsdGeom.Xform(stage.GetPrimAtPath("/world")).AddRotateXOp().Set(30)
    cube = stages.add_cube(stage)
    cube.AddScaleOp().Set((-3, 1, 2))
    cube.CreateNormalsAttr(stages.vectors(np.repeat(face_normals(zoo.cube().vertices, zoo.cube().faces)[::2], 4, 0)))
    cube.SetNormalsInterpolation("faceVarying")
    uv = UsdGeom.PrimvarsAPI(cube).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    uv.Set(Vt.Vec2fArray.FromNumpy(np.random.default_rng(1).random((24, 2)).astype(np.float32)))
    stages.bind(cube.GetPrim(), stages.add_material(stage, "/world/m", (1, 0, 0), "./skin.png"))
    UsdGeom.Camera.Define(stage, "/world/camera").AddTranslateOp().Set((1, 2, 3))
    stage.Save()
    return path


@matrix(
    ("before", "after"),
    [(".usda", ".usdc"), (".usdc", ".usdz"), (".usdz", ".usda"), (".usd", ".usd")],
    quick=[(".usda", ".usdc")],
)
def test_moved_mesh_keeps_what_was_read(before, after, tmp_path):
    path = character(tmp_path / "in" / f"a{'.usda' if before == '.usdz' else before}")
    if before == ".usdz":
        UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(path)), str(path.with_suffix(".usdz")))
        path.unlink()
        path = path.with_suffix(".usdz")
    content = path.read_bytes()
    mesh = load_mesh(path)
    moved = mesh.with_vertices(bend(mesh.vertices))
    save_mesh(moved, tmp_path / "out" / f"b{after}")
    reread = load_mesh(tmp_path / "out" / f"b{after}")
    np.testing.assert_allclose(reread.vertices, moved.vertices, atol=1e-6)
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    np.testing.assert_array_equal(reread.source.sizes, mesh.source.sizes)
    np.testing.assert_allclose(reread.corner_normals, moved.corner_normals, atol=1e-6)
    np.testing.assert_array_equal(reread.corner_uv, mesh.corner_uv)
    assert reread.parts == mesh.parts
    assert reread.parts[0].material.texture == PNG
    assert reread.source.details == mesh.source.details
    assert path.read_bytes() == content


def test_posed_character_is_written_without_skin_and_animation(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    stages.set_times(stage, 0, 2)
    stages.add_skinned_cube(stage)
    for time in (1, 2):
        stages.add_cube(stage).GetPointsAttr().Set(stages.vectors(zoo.cube().vertices * time), time)
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    assert mesh.source.notes == (
        "dropped the skin or blend shapes of 1 of 2 meshes",
        "dropped the animation of 2 of 2 meshes",
    )
    moved = mesh.with_vertices(bend(mesh.vertices))
    save_mesh(moved, tmp_path / "b.usda")
    reread = load_clip(tmp_path / "b.usda")
    assert len(reread) == 1
    np.testing.assert_allclose(reread.vertices[0], moved.vertices, atol=1e-5)
    np.testing.assert_array_equal(reread.mesh.faces, mesh.faces)
    assert [part.name for part in reread.mesh.parts] == [part.name for part in mesh.parts]


def test_files_of_packages_are_aligned(tmp_path):
    save_mesh(full_mesh(), tmp_path / "b.usdz")
    content = (tmp_path / "b.usdz").read_bytes()
    with zipfile.ZipFile(tmp_path / "b.usdz") as package:
        assert package.namelist() == ["b.usdc", "textures/Haut___.png"]
        for entry in package.infolist():
            names, extra = (int.from_bytes(content[entry.header_offset + k :][:2], "little") for k in (26, 28))
            assert (entry.header_offset + 30 + names + extra) % 64 == 0
            assert entry.compress_type == zipfile.ZIP_STORED


def test_written_materials_are_valid_preview_surfaces(tmp_path):
    save_mesh(full_mesh(), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    materials = [UsdShade.Material(prim) for prim in stage.Traverse() if prim.IsA(UsdShade.Material)]
    assert [material.GetPrim().GetDisplayName() for material in materials] == ["Haut é", "Haut ü"]
    assert len({material.GetPrim().GetName() for material in materials}) == 2
    assert all(m.ComputeSurfaceSource()[0].GetShaderId() == "UsdPreviewSurface" for m in materials)


def test_z_up_stage_in_centimetres_is_exported_y_up_in_metres(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda", up="Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stages.add_cube(stage)
    stage.GetRootLayer().Save()
    mesh = load_mesh(tmp_path / "a.usda")
    frames = np.stack([mesh.vertices, mesh.vertices * [1.0, 2.0, 3.0]])
    save_clip(Clip(mesh, frames), tmp_path / "b.glb")
    x, y, z = np.moveaxis(frames, -1, 0) * 0.01
    np.testing.assert_allclose(load_clip(tmp_path / "b.glb").vertices[:, :8], np.stack([x, z, -y], -1), atol=1e-8)
