"""USD stages are read prim by prim and time code by time code, in world coordinates."""

from __future__ import annotations

import numpy as np
import pytest
import usd_stages as stages
import zoo
from pxr import Gf, Usd, UsdGeom, UsdShade

from mimesh.core.errors import InputError
from mimesh.core.geometry import face_normals
from mimesh.io import load_clip, load_mesh

pytestmark = pytest.mark.usefixtures("in_process")

CUBE = zoo.cube().vertices


def volume(mesh) -> float:
    """Return six times the enclosed volume; negative for faces that point inwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum())


def test_polygons_become_fans_and_transforms_nest(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    UsdGeom.Xform(stage.GetPrimAtPath("/world")).AddTranslateOp().Set((0, 0, 5))
    cube = stages.add_cube(stage, polygons=[*stages.QUADS[:-1], (1, 5, 7), (1, 7, 3), (0, 1)])
    cube.AddRotateYOp().Set(90)
    cube.AddScaleOp().Set((2, 1, 1))
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    x, y, z = CUBE.T
    np.testing.assert_allclose(mesh.vertices, np.stack([z, y, 5 - 2 * x], axis=1), atol=1e-12)
    assert volume(mesh) == pytest.approx(12)
    assert mesh.source.sizes.tolist() == [4, 4, 4, 4, 4, 3, 3]
    assert [(part.name, part.start, part.stop) for part in mesh.parts] == [("cube", 0, 12)]


@pytest.mark.parametrize(
    ("hand", "scale"),
    [
        ("rightHanded", (1, -1, 1)),
        ("rightHanded", (-2, -2, -2)),
        ("leftHanded", (1, 1, 1)),
        ("leftHanded", (-1, 1, -1)),
        ("leftHanded", (-2, -2, -2)),
    ],
)
def test_faces_point_outwards_under_mirroring_and_left_hand_orientation(hand, scale, tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    polygons = stages.QUADS if hand == "rightHanded" else [polygon[::-1] for polygon in stages.QUADS]
    cube = stages.add_cube(stage, polygons=polygons)
    cube.CreateOrientationAttr(hand)
    cube.AddScaleOp().Set(scale)
    cube.CreateNormalsAttr(stages.vectors(face_normals(CUBE, zoo.cube().faces)[::2]))
    cube.SetNormalsInterpolation("uniform")
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    assert volume(mesh) == pytest.approx(6 * abs(np.prod(scale)))
    flat = face_normals(mesh.vertices, mesh.faces)
    np.testing.assert_allclose(mesh.corner_normals, np.repeat(flat[:, None], 3, axis=1), atol=1e-7)


def test_only_visible_meshes_are_read(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    for name in ("hidden", "proxy", "guide", "inactive", "render"):
        UsdGeom.Xform.Define(stage, f"/world/{name}")
        stages.add_cube(stage, f"/world/{name}/cube").AddTranslateOp().Set((len(name), 0, 0))
    UsdGeom.Imageable(stage.GetPrimAtPath("/world/hidden")).MakeInvisible()
    for name in ("proxy", "guide", "render"):
        UsdGeom.Imageable(stage.GetPrimAtPath(f"/world/{name}")).CreatePurposeAttr(name)
    stage.GetPrimAtPath("/world/inactive").SetActive(False)
    UsdGeom.PointInstancer.Define(stage, "/world/many")
    stages.add_cube(stage, "/world/many/one")
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    np.testing.assert_allclose(mesh.vertices, CUBE + [6, 0, 0])
    assert mesh.source.notes == ("left out 1 point instancer",)


def test_instances_are_read_with_their_transforms(tmp_path):
    stage = stages.new_stage(tmp_path / "part.usda")
    stages.add_cube(stage)
    stage.Save()
    stage = stages.new_stage(tmp_path / "a.usda")
    for k in range(3):
        instance = UsdGeom.Xform.Define(stage, f"/world/copy{k}")
        instance.AddTranslateOp().Set((2 * k, 0, 0))
        instance.GetPrim().GetReferences().AddReference("./part.usda")
        instance.GetPrim().SetInstanceable(True)
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    np.testing.assert_allclose(mesh.vertices, np.concatenate([CUBE + [2 * k, 0, 0] for k in range(3)]))
    assert len(mesh.parts) == 3


def test_up_axis_and_unit_are_kept(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usdc", up="Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stages.add_cube(stage).AddScaleOp().Set((1, 1, 180))
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usdc")
    np.testing.assert_allclose(mesh.vertices, CUBE * [1, 1, 180])
    assert (mesh.source.up_axis, mesh.source.meters_per_unit) == ("Z", 0.01)


def test_geom_subsets_become_parts_with_materials(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    cube = stages.add_cube(stage)
    api = UsdShade.MaterialBindingAPI.Apply(cube.GetPrim())
    red = stages.add_material(stage, "/world/red", (1, 0, 0))
    blue = stages.add_material(stage, "/world/blue", (0, 0, 1))
    stages.bind(cube.GetPrim(), red)
    subset = api.CreateMaterialBindSubset("lid", [1, 4])
    subset.GetPrim().SetDisplayName("der Deckel")
    stages.bind(subset.GetPrim(), blue)
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    runs = [(part.name, part.start, part.stop, part.material.name, part.material.base_color) for part in mesh.parts]
    assert runs == [("cube", 0, 8, "red", (1, 0, 0, 1)), ("der Deckel", 8, 12, "blue", (0, 0, 1, 1))]
    lid = {frozenset(stages.QUADS[k]) for k in (1, 4)}
    assert {frozenset(mesh.faces[f].tolist() + mesh.faces[f + 1].tolist()) for f in (8, 10)} == lid


@pytest.mark.parametrize("sample", [None, 0.0], ids=["indices", "indices as a time sample"])
@pytest.mark.parametrize("interpolation", ["vertex", "faceVarying"])
def test_uv_primvar_is_the_one_the_texture_reads(interpolation, sample, tmp_path):
    (tmp_path / "skin.png").write_bytes(b"\x89PNG and so on")
    stage = stages.new_stage(tmp_path / "a.usda")
    cube = stages.add_cube(stage)
    stages.bind(cube.GetPrim(), stages.add_material(stage, "/world/m", (1, 0, 0), "./skin.png", "layer2"))
    api = UsdGeom.PrimvarsAPI(cube)
    api.CreatePrimvar("st", stages.Sdf.ValueTypeNames.TexCoord2fArray, "constant").Set([(9, 9)])
    primvar = api.CreatePrimvar("layer2", stages.Sdf.ValueTypeNames.Float2Array, interpolation)
    count = 8 if interpolation == "vertex" else 24
    values = np.random.default_rng(0).random((5, 2)).astype(np.float32)
    index = np.random.default_rng(1).integers(0, 5, count)
    primvar.Set(stages.Vt.Vec2fArray.FromNumpy(values))
    time = Usd.TimeCode.Default() if sample is None else sample
    primvar.SetIndices(stages.Vt.IntArray.FromNumpy(index.astype(np.int32)), time)
    stage.Save()
    mesh = load_mesh(tmp_path / "a.usda")
    expected = values[index]
    if interpolation == "vertex":
        np.testing.assert_array_equal(mesh.corner_uv, expected[mesh.faces])
    else:
        fans = [(4 * k, 4 * k + j, 4 * k + j + 1) for k in range(6) for j in (1, 2)]
        np.testing.assert_array_equal(mesh.corner_uv, expected[np.array(fans)])
    assert mesh.parts[0].material.texture == b"\x89PNG and so on"
    assert mesh.parts[0].material.base_color == (1, 1, 1, 1)


def test_time_samples_of_points_and_transforms_are_combined(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    stages.set_times(stage, 10, 14, 25)
    cube, static_cube = stages.add_cube(stage), stages.add_cube(stage, "/world/still")
    static_cube.AddTranslateOp().Set((0, 0, 9))
    cube.GetPointsAttr().Clear()
    rise = UsdGeom.Xform(stage.GetPrimAtPath("/world")).AddTranslateOp()
    for time in (10, 12, 14):
        cube.GetPointsAttr().Set(stages.vectors(CUBE * time), time)
        rise.Set((0, time**2, 0), time)
    stage.Save()
    clip = load_clip(tmp_path / "a.usda")
    heights = [100, 122, 144, 170, 196]  # linear between samples
    expected = [
        np.concatenate([CUBE * time, CUBE + [0, 0, 9]]) + [0, height, 0]
        for time, height in zip(range(10, 15), heights, strict=True)
    ]
    np.testing.assert_allclose(clip.vertices, expected)
    assert clip.fps == 25
    np.testing.assert_allclose(load_mesh(tmp_path / "a.usda").vertices, expected[0])
    half = load_clip(tmp_path / "a.usda", fps=12.5)
    np.testing.assert_allclose(half.vertices, expected[::2])
    assert len(load_clip(tmp_path / "a.usda", fps=50.0)) == 9


def test_time_range_defaults_to_the_samples_and_a_static_stage_is_one_frame(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    cube = stages.add_cube(stage)
    turn = cube.AddRotateXOp()
    stage.Save()
    assert len(load_clip(tmp_path / "a.usda")) == 1
    turn.Set(0, 3)
    turn.Set(90, 5)
    stage.Save()
    assert len(load_clip(tmp_path / "a.usda")) == 3


def test_skinning_and_blend_shapes_equal_a_naive_implementation(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usdc")
    _, numbers = stages.add_skinned_cube(stage)
    stages.set_times(stage, 0, 2, 30)
    stage.Save()
    clip = load_clip(tmp_path / "a.usdc")
    assert (len(clip), clip.fps) == (3, 30)
    for time in range(3):
        np.testing.assert_allclose(clip.vertices[time], stages.skinned_points(numbers, time), atol=2e-6)
    rest = load_mesh(tmp_path / "a.usdc")
    rested = {**numbers, "angles": [0.0], "amounts": [0.0]}
    np.testing.assert_allclose(rest.vertices, stages.skinned_points(rested, 0), atol=2e-6)
    assert len(rest.source.notes) == 2


def test_topology_change_in_a_later_frame_is_named(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    stages.set_times(stage, 1, 3)
    cube = stages.add_cube(stage)
    cube.GetFaceVertexIndicesAttr().Set([corner for polygon in stages.QUADS for corner in polygon], 1)
    cube.GetFaceVertexIndicesAttr().Set([corner for polygon in stages.QUADS for corner in polygon[::-1]], 3)
    cube.GetPointsAttr().Set(stages.vectors(CUBE), 1)
    cube.GetPointsAttr().Set(stages.vectors(CUBE + 1), 3)
    stage.Save()
    with pytest.raises(InputError, match=r"found other faces in frame 2 of /world/cube"):
        load_clip(tmp_path / "a.usda")
    cube.GetFaceVertexIndicesAttr().ClearAtTime(3)
    cube.GetPointsAttr().Set(stages.vectors(CUBE[:7]), 2)
    stage.Save()
    with pytest.raises(InputError, match=r"found 7 points after 8 in frame 1 of /world/cube"):
        load_clip(tmp_path / "a.usda")


def test_unreadable_stages_are_explained(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    UsdGeom.Camera.Define(stage, "/world/camera")
    stage.Save()
    with pytest.raises(InputError, match=r"found 1 Xform, 1 Camera; export"):
        load_mesh(tmp_path / "a.usda")
    cube = stages.add_cube(stage)
    cube.GetFaceVertexIndicesAttr().Set([*range(23), 8])
    stage.Save()
    with pytest.raises(InputError, match=r"expected points 0\.\.7 in the faces of /world/cube, found 22"):
        load_mesh(tmp_path / "a.usda")
    cube.GetFaceVertexIndicesAttr().Set([0, 1, 2])
    stage.Save()
    with pytest.raises(InputError, match=r"corners \(24\), found 3"):
        load_mesh(tmp_path / "a.usda")
    (tmp_path / "b.usda").write_text("hello")
    with pytest.raises(InputError, match=r"b\.usda: expected a USD stage, found .*not a valid usda"):
        load_mesh(tmp_path / "b.usda")


def test_hole_faces_are_left_out(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    stages.add_cube(stage).CreateHoleIndicesAttr([0, 5])
    stage.Save()
    assert len(load_mesh(tmp_path / "a.usda").faces) == 8


def test_matrix_rotations_are_transposed_from_row_vectors(tmp_path):
    stage = stages.new_stage(tmp_path / "a.usda")
    matrix = np.random.default_rng(5).normal(size=(4, 4))
    matrix[3] = [0, 0, 0, 1]
    stages.add_cube(stage).AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))
    stage.Save()
    np.testing.assert_allclose(load_mesh(tmp_path / "a.usda").vertices, CUBE @ matrix[:3, :3].T + matrix[:3, 3])
