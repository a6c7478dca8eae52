"""New USD files round trip, and a file that was read is written again with only its points changed."""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import numpy as np
import pytest
import usd_stages as stages
import zoo
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils

from mimesh.core.errors import InputError
from mimesh.core.geometry import face_normals, vertex_normals
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
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


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("smooth", [True, False])
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


@pytest.mark.parametrize("make", zoo.ZOO)
def test_new_mesh_round_trips(make, tmp_path):
    mesh = make()
    save_mesh(mesh, tmp_path / "a.usdc")
    reread = load_mesh(tmp_path / "a.usdc")
    np.testing.assert_array_equal(reread.vertices, mesh.vertices.astype(np.float32))
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    assert len(load_clip(tmp_path / "a.usdc")) == 1


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
    """Write a stage with a mesh under two transforms, and with prims and attributes that mimesh does not read."""
    path.parent.mkdir(exist_ok=True)
    (path.parent / "skin.png").write_bytes(PNG)
    stage = stages.new_stage(path, up="Z")
    stage.GetRootLayer().customLayerData = {"shot": "12b"}
    UsdGeom.Xform(stage.GetPrimAtPath("/world")).AddRotateXOp().Set(30)
    cube = stages.add_cube(stage)
    cube.AddScaleOp().Set((-3, 1, 2))
    cube.CreateNormalsAttr(stages.vectors(np.repeat(face_normals(zoo.cube().vertices, zoo.cube().faces)[::2], 4, 0)))
    cube.SetNormalsInterpolation("faceVarying")
    cube.CreateExtentAttr(stages.vectors(np.array([[0, 0, 0], [1, 1, 1]])))
    cube.GetPrim().CreateAttribute("userProperties:mood", Sdf.ValueTypeNames.String).Set("happy")
    stages.bind(cube.GetPrim(), stages.add_material(stage, "/world/m", (1, 0, 0), "./skin.png"))
    stage.DefinePrim("/world/odd", "NobodyKnowsThisType").SetCustomDataByKey("a", 1)
    UsdGeom.Camera.Define(stage, "/world/camera").AddTranslateOp().Set((1, 2, 3))
    stage.Save()
    return path


def untouched_properties(path: Path) -> dict[str, str]:
    """Return all properties of a stage that writing must not change."""
    found = {}
    stage = Usd.Stage.Open(str(path))
    for prim in stage.Traverse():
        for prop in prim.GetProperties():
            if prop.GetName() not in ("points", "normals", "extent", "inputs:file"):
                value = prop.Get() if isinstance(prop, Usd.Attribute) else prop.GetTargets()
                found[f"{prop.GetPath()}"] = f"{prim.GetTypeName()} {value} {prop.GetAllMetadata()}"
    return found


@pytest.mark.slow
@pytest.mark.parametrize("before", SUFFIXES)
@pytest.mark.parametrize("after", SUFFIXES)
def test_moved_mesh_changes_only_points_normals_and_extent(before, after, tmp_path):
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
    np.testing.assert_allclose(reread.corner_normals, moved.corner_normals, atol=1e-6)
    assert reread.parts == mesh.parts
    assert untouched_properties(tmp_path / "out" / f"b{after}") == untouched_properties(path)
    stage = Usd.Stage.Open(str(tmp_path / "out" / f"b{after}"))
    assert stage.GetRootLayer().customLayerData["shot"] == "12b"
    cube = UsdGeom.Mesh(stage.GetPrimAtPath("/world/cube"))
    points = np.array(cube.GetPointsAttr().Get())
    np.testing.assert_array_equal(np.array(cube.GetExtentAttr().Get()), [points.min(0), points.max(0)])
    assert path.read_bytes() == content


def test_written_points_are_constant_over_time(tmp_path):
    """Time samples, animated transforms, joints, blend shapes and velocities no longer move the points."""
    stage = stages.new_stage(tmp_path / "a.usda")
    stages.set_times(stage, 0, 2)
    body, _ = stages.add_skinned_cube(stage)
    stages.add_cube(stage).GetPointsAttr().Set(stages.vectors(zoo.cube().vertices * 2), 1)
    swing = UsdGeom.Xform.Define(stage, "/world/swing")
    swing.AddRotateZOp().Set(-40, 0)
    swing.GetOrderedXformOps()[0].Set(50, 2)
    stages.add_cube(stage, "/world/swing/cube").AddScaleOp().Set((1, -1, 1))
    body.CreateVelocitiesAttr(stages.vectors(np.ones((8, 3))))
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    moved = mesh.with_vertices(bend(mesh.vertices))
    save_mesh(moved, tmp_path / "b.usda")
    reread = load_clip(tmp_path / "b.usda")
    assert len(reread) == 1
    np.testing.assert_allclose(reread.vertices[0], moved.vertices, atol=1e-5)
    np.testing.assert_array_equal(reread.mesh.faces, mesh.faces)
    stage = Usd.Stage.Open(str(tmp_path / "b.usda"))
    cubes = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    for time in range(3):
        frames = UsdGeom.XformCache(time)
        found = [
            np.c_[np.array(c.GetPointsAttr().Get(time)), np.ones(8)]
            @ np.array(frames.GetLocalToWorldTransform(c.GetPrim()))
            for c in cubes
        ]
        np.testing.assert_allclose(np.concatenate(found)[:, :3], moved.vertices, atol=1e-5)
    assert stage.GetPrimAtPath("/world/character/skeleton").IsA(UsdSkel.Skeleton)
    assert not UsdGeom.Mesh(stage.GetPrimAtPath("/world/character/mesh")).GetVelocitiesAttr().Get()


def test_animation_of_sublayers_is_removed(tmp_path):
    """Time samples come from a referenced file in another folder, and from a sublayer."""
    (tmp_path / "parts").mkdir()
    stage = stages.new_stage(tmp_path / "parts" / "a.usdc")
    cube = stages.add_cube(stage)
    rise = cube.AddTranslateOp()
    for time in (1, 2):
        cube.GetPointsAttr().Set(stages.vectors(zoo.cube().vertices * time), time)
        rise.Set((0, 0, time), time)
    stage.Save()
    stage = stages.new_stage(tmp_path / "shot.usda")
    stages.set_times(stage, 1, 2)
    stage.GetPrimAtPath("/world").GetReferences().AddReference("./parts/a.usdc")
    stage.Save()
    top = Sdf.Layer.CreateNew(str(tmp_path / "top.usda"))
    top.subLayerPaths.append("./shot.usda")
    top.Save()
    for name in ("shot.usda", "top.usda"):
        assert len(load_clip(tmp_path / name, fps=24.0)) == 2
        mesh = load_mesh(tmp_path / name)
        moved = mesh.with_vertices(bend(mesh.vertices))
        for after in ("b.usda", "b.usdz"):
            save_mesh(moved, tmp_path / "out" / after)
            reread = load_clip(tmp_path / "out" / after)
            np.testing.assert_allclose(reread.vertices, moved.vertices[None], atol=1e-6)


def test_instances_become_separate_prims(tmp_path):
    stage = stages.new_stage(tmp_path / "part.usda")
    UsdGeom.Xform.Define(stage, "/world/inner")
    stages.add_cube(stage, "/world/inner/cube")
    stage.GetPrimAtPath("/world/inner").SetInstanceable(True)
    stage.Save()
    stage = stages.new_stage(tmp_path / "a.usda")
    for k in range(2):
        one = UsdGeom.Xform.Define(stage, f"/world/copy{k}")
        one.AddTranslateOp().Set((2 * k, 0, 0))
        one.GetPrim().GetReferences().AddReference("./part.usda")
        one.GetPrim().SetInstanceable(True)
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    moved = mesh.with_vertices(bend(mesh.vertices))
    save_mesh(moved, tmp_path / "elsewhere" / "b.usda")
    np.testing.assert_allclose(load_mesh(tmp_path / "elsewhere" / "b.usda").vertices, moved.vertices, atol=1e-6)
    np.testing.assert_allclose(load_mesh(tmp_path / "part.usda").vertices, zoo.cube().vertices)


def test_singular_or_imprecise_transforms_are_replaced(tmp_path):
    for number, change in enumerate([(1, 0, 1), (1e-20, 1, 1)]):
        stage = stages.new_stage(tmp_path / f"{number}.usda")
        stages.add_cube(stage).AddScaleOp().Set(change)
        stage.Save()
        mesh = load_mesh(tmp_path / f"{number}.usda")
        moved = mesh.with_vertices(bend(zoo.cube().vertices))
        save_mesh(moved, tmp_path / "b.usda")
        np.testing.assert_allclose(load_mesh(tmp_path / "b.usda").vertices, moved.vertices, atol=1e-6)


def test_packages_are_aligned_and_keep_their_files(tmp_path):
    path = character(tmp_path / "a.usda")
    UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(path)), str(tmp_path / "a.usdz"))
    mesh = load_mesh(tmp_path / "a.usdz")
    save_mesh(mesh.with_vertices(bend(mesh.vertices)), tmp_path / "b.usdz")
    content = (tmp_path / "b.usdz").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.usdz") as old, zipfile.ZipFile(tmp_path / "b.usdz") as new:
        assert new.namelist() == old.namelist()
        for entry in new.infolist():
            names, extra = (int.from_bytes(content[entry.header_offset + k :][:2], "little") for k in (26, 28))
            assert (entry.header_offset + 30 + names + extra) % 64 == 0
            assert entry.compress_type == zipfile.ZIP_STORED


def test_missing_source_file_is_explained(tmp_path):
    mesh = load_mesh(character(tmp_path / "a.usda"))
    (tmp_path / "a.usda").unlink()
    with pytest.raises(InputError, match=r"a\.usda: expected the file that was read, found none"):
        save_mesh(mesh, tmp_path / "b.usda")
    stage = stages.new_stage(tmp_path / "a.usda")
    stages.add_cube(stage, "/world/other")
    stage.Save()
    with pytest.raises(InputError, match=r"a\.usda: expected the mesh /world/cube that was read, found none"):
        save_mesh(mesh, tmp_path / "b.usda")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.usda", "skin.png"]


def test_written_materials_are_valid_preview_surfaces(tmp_path):
    save_mesh(full_mesh(), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    materials = [UsdShade.Material(prim) for prim in stage.Traverse() if prim.IsA(UsdShade.Material)]
    assert [material.GetPrim().GetDisplayName() for material in materials] == ["Haut é", "Haut ü"]
    assert len({material.GetPrim().GetName() for material in materials}) == 2
    assert all(m.ComputeSurfaceSource()[0].GetShaderId() == "UsdPreviewSurface" for m in materials)


@pytest.mark.parametrize("suffix", [".glb", ".abc"])
def test_z_up_stage_in_centimetres_is_exported_y_up_in_metres(suffix, tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda", up="Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stages.add_cube(stage)
    stage.GetRootLayer().Save()
    mesh = load_mesh(tmp_path / "a.usda")
    frames = np.stack([mesh.vertices, mesh.vertices * [1.0, 2.0, 3.0]])
    save_clip(Clip(mesh, frames), tmp_path / f"b{suffix}")
    x, y, z = np.moveaxis(frames, -1, 0) * 0.01
    np.testing.assert_allclose(load_clip(tmp_path / f"b{suffix}").vertices[:, :8], np.stack([x, z, -y], -1), atol=1e-8)
