"""USD stages for tests, written directly with the USD library."""

from __future__ import annotations

import numpy as np
import zoo
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
"""The faces of `zoo.cube` as quads, counter-clockwise seen from outside."""


def new_stage(path, up: str = "Y") -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/world").GetPrim())
    return stage


def vectors(values: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def add_cube(stage: Usd.Stage, path: str = "/world/cube", polygons=QUADS) -> UsdGeom.Mesh:
    """Add `zoo.cube` as a Mesh prim of quads, or of other polygons."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(vectors(zoo.cube().vertices))
    mesh.CreateFaceVertexCountsAttr([len(polygon) for polygon in polygons])
    mesh.CreateFaceVertexIndicesAttr([corner for polygon in polygons for corner in polygon])
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


def set_times(stage: Usd.Stage, start: float, stop: float, codes: float = 24.0) -> None:
    stage.SetStartTimeCode(start)
    stage.SetEndTimeCode(stop)
    stage.SetTimeCodesPerSecond(codes)


def add_material(stage: Usd.Stage, path: str, color, file: str | None = None, varname: str = "st") -> UsdShade.Material:
    """Add a UsdPreviewSurface connected through the material's interface inputs; with a texture if `file` is given."""
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/shader")
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    public = material.CreateInput("paint", Sdf.ValueTypeNames.Color3f)
    public.Set(Gf.Vec3f(*color))
    diffuse = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    diffuse.ConnectToSource(public)
    if file is not None:
        image, reader = UsdShade.Shader.Define(stage, f"{path}/image"), UsdShade.Shader.Define(stage, f"{path}/uv")
        image.CreateIdAttr("UsdUVTexture")
        image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(file))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.Token).Set(varname)
        image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        diffuse.ConnectToSource(image.ConnectableAPI(), "rgb")
    return material


def bind(prim: Usd.Prim, material: UsdShade.Material) -> None:
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def add_skinned_cube(stage: Usd.Stage) -> tuple[UsdGeom.Mesh, dict]:
    """Add a cube with two joints and a blend shape, animated over three time codes; return it and its parameters."""
    rng = np.random.default_rng(3)
    root = UsdSkel.Root.Define(stage, "/world/character")
    root.AddTranslateOp().Set((3.0, -1.0, 2.0))
    root.AddScaleOp().Set((2.0, 2.0, 2.0))
    skeleton = UsdSkel.Skeleton.Define(stage, "/world/character/skeleton")
    skeleton.AddRotateZOp().Set(30.0)
    skeleton.CreateJointsAttr(["hip", "hip/knee"])
    bind_matrices = np.stack([np.eye(4), np.eye(4)])
    bind_matrices[1, :3, 3] = [0.2, 0.5, 0.1]
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(m.T.tolist()) for m in bind_matrices])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(m.T.tolist()) for m in bind_matrices])
    animation = UsdSkel.Animation.Define(stage, "/world/character/skeleton/swing")
    animation.CreateJointsAttr(["hip", "hip/knee"])
    animation.CreateBlendShapesAttr(["bulge"])
    numbers = {"bind": bind_matrices, "angles": [0.3, 0.9, 1.4], "amounts": [0.0, 0.5, 1.0]}
    for time in range(3):
        half = numbers["angles"][time] / 2
        rotation = Gf.Quatf(float(np.cos(half)), 0.0, 0.0, float(np.sin(half)))
        animation.CreateTranslationsAttr().Set([(0.1 * time, 0, 0), (0.2, 0.5, 0.1)], time)
        animation.CreateRotationsAttr().Set([Gf.Quatf(1.0), rotation], time)
        animation.CreateScalesAttr().Set([(1, 1, 1), (1, 1, 1)], time)
        animation.CreateBlendShapeWeightsAttr().Set([numbers["amounts"][time]], time)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    mesh = add_cube(stage, "/world/character/mesh")
    mesh.AddTranslateOp().Set((50.0, 0.0, 0.0))  # no effect: UsdSkel places a skinned mesh by its skeleton's transform
    numbers["weights"] = rng.random((8, 2)).astype(np.float32)
    numbers["weights"] /= numbers["weights"].sum(axis=1, keepdims=True)
    numbers["offsets"] = rng.normal(size=(3, 3)).astype(np.float32)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * 8)
    binding.CreateJointWeightsPrimvar(False, 2).Set(numbers["weights"].ravel().tolist())
    shape = UsdSkel.BlendShape.Define(stage, "/world/character/mesh/bulge")
    shape.CreateOffsetsAttr(vectors(numbers["offsets"]))
    shape.CreatePointIndicesAttr([1, 4, 6])
    binding.CreateBlendShapesAttr(["bulge"])
    binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
    return mesh, numbers


def skinned_points(numbers: dict, time: int) -> np.ndarray:
    """Compute the world positions of the skinned cube at a time code, joint by joint and vertex by vertex."""
    points = zoo.cube().vertices.copy()
    points[[1, 4, 6]] += numbers["amounts"][time] * numbers["offsets"]
    hip, knee = np.eye(4), np.eye(4)
    hip[0, 3] = 0.1 * time
    cosine, sine = np.cos(numbers["angles"][time]), np.sin(numbers["angles"][time])
    knee[:3, :3] = [[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]
    knee[:3, 3] = [0.2, 0.5, 0.1]
    joint_transforms = [hip @ np.linalg.inv(numbers["bind"][0]), hip @ knee @ np.linalg.inv(numbers["bind"][1])]
    cosine, sine = np.cos(np.radians(30)), np.sin(np.radians(30))
    T_world_skeleton = np.eye(4)
    T_world_skeleton[:3, :3] = 2 * np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    T_world_skeleton[:3, 3] = [3, -1, 2]
    result = []
    for point, weights in zip(points, numbers["weights"], strict=True):
        blended = sum(weight * T for weight, T in zip(weights, joint_transforms, strict=True))
        result.append((T_world_skeleton @ blended @ [*point, 1.0])[:3])
    return np.array(result)
