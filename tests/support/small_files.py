"""Small sound files of every format that is read, written by code into a folder."""

from __future__ import annotations

import dataclasses
import pickle
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path

import fbx_samples
import gltf_samples
import hostile
import nasty
import numpy as np
import smpl_files
import zoo
from motion_files import Z_UP, write_amass, write_bvh

from mimesh.bodies import load_body
from mimesh.core.joint_corrections import JointCorrections
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import save_clip, save_mesh
from mimesh.io.joint_file import save_corrections
from mimesh.motions.clips import load_motion
from mimesh.motions.motion import window

MTL = "newmtl Brick\nKd 0.8 0.2 0.1\nmap_Kd -s 1 1 1 looks.png\nnewmtl Plaster\nKd 1 1 1\nd 0.5\nPr 0.25\n"


@cache
def small_clip() -> Clip:
    """Three frames of a grid with texture coordinates, colours and two parts."""
    mesh, rng = zoo.grid(3), np.random.default_rng(0)
    half = len(mesh.faces) // 2
    parts = (
        Part("front", 0, half, Material("red wool", (1.0, 0.0, 0.0, 1.0), gltf_samples.png())),
        Part("back", half, len(mesh.faces), Material("b")),
    )
    colors = rng.random((len(mesh.vertices), 4)).round(2)
    mesh = dataclasses.replace(mesh, parts=parts, corner_uv=mesh.vertices[mesh.faces][..., :2], vertex_colors=colors)
    return Clip(mesh, mesh.vertices + rng.normal(0.0, 0.01, (3, *mesh.vertices.shape)), 24.0)


def meshes(suffix: str, texts: dict[str, bytes]) -> Callable[[Path], None]:
    """Write the small mesh, a plain one and texts."""

    def write(folder: Path) -> None:
        save_mesh(small_clip().mesh, folder / f"own{suffix}")
        save_mesh(zoo.two_parts(), folder / f"parts{suffix}")
        for number, text in enumerate(texts.values()):
            (folder / f"t{number}{suffix}").write_bytes(text)

    return write


def clips(suffix: str) -> Callable[[Path], None]:
    """Write the small clip, and point clouds that move."""

    def write(folder: Path) -> None:
        save_clip(small_clip(), folder / f"own{suffix}")
        save_clip(Clip(zoo.point_cloud(), np.stack([zoo.point_cloud().vertices] * 2)), folder / f"cloud{suffix}")

    return write


def obj(folder: Path) -> None:
    meshes(".obj", hostile.OBJ)(folder)
    (folder / "looks.obj").write_bytes(nasty.NASTY_OBJ)
    (folder / "looks.mtl").write_text(MTL)
    (folder / "looks.png").write_bytes(gltf_samples.png())


def ply(folder: Path) -> None:
    meshes(".ply", hostile.PLY)(folder)
    head = "ply\nformat binary_big_endian 1.0\nelement vertex 4\nproperty double x\nproperty double y\n"
    head += "property double z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    faces = b"".join(struct.pack(">B3i", 3, *face) for face in ((0, 1, 2), (0, 2, 3)))
    (folder / "big.ply").write_bytes(head.encode() + np.eye(4, 3).astype(">f8").tobytes() + faces)


def npz(folder: Path) -> None:
    clips(".npz")(folder)
    vertices = small_clip().vertices
    np.savez(folder / "quads.npz", v=vertices[0].astype(np.float32), f=np.array([[0, 1, 4, 3]]), fps=25)
    np.savez_compressed(folder / "points.npz", points=vertices)


def moving_box() -> gltf_samples.Sample:
    """A box below a turning node, with a strip of morph targets: linear, stepped, spline and weight channels."""
    sample = gltf_samples.hero()
    times = sample.accessor([0.0, 0.05, 0.1])
    rng = np.random.default_rng(0)
    turns = np.array([[0, 0, 0, 1], [0, 0, 0.6, 0.8], [0.6, 0, 0, 0.8]])
    samplers = [
        {"input": times, "output": sample.accessor((turns * 32767).round(), "i2", normalized=True)},
        {"input": times, "output": sample.accessor(rng.normal(size=(9, 3))), "interpolation": "CUBICSPLINE"},
        {"input": times, "output": sample.accessor(np.ones((3, 3))), "interpolation": "STEP"},
        {"input": times, "output": sample.accessor(rng.random(6).reshape(-1, 1))},
        {"input": times, "output": sample.sparse(turns)},
    ]
    targets = [(1, "rotation"), (2, "translation"), (2, "scale"), (4, "weights"), (0, "rotation")]
    channels = [{"sampler": k, "target": {"node": n, "path": path}} for k, (n, path) in enumerate(targets)]
    sample.gltf["animations"].append({"name": "all", "samplers": samplers, "channels": channels})
    return sample


def glb(folder: Path) -> None:
    gltf_samples.hero().glb(folder / "hero.glb")
    gltf_samples.props().glb(folder / "props.glb")
    moving_box().glb(folder / "moving.glb")
    save_clip(small_clip(), folder / "clip.glb")


def gltf(folder: Path) -> None:
    gltf_samples.hero().text(folder / "hero.gltf")
    moving_box().text(folder / "moving.gltf")


def compressed(folder: Path) -> None:
    import compressed_files

    plain = gltf_samples.props().glb(folder / "plain").rename(folder / "plain.bin")
    compressed_files.meshopt_glb(plain, folder / "meshopt.glb")
    compressed_files.draco_glb(plain, folder / "draco.glb")


def vrm(folder: Path) -> None:
    import vrm_files

    smile = {"morphTargetBinds": [{"node": 4, "index": 0, "weight": 1.0}]}
    bones = {"hips": 1, "spine": 2}
    for version, expression in ((0, {"binds": [{"mesh": 0, "index": 0, "weight": 100}]}), (1, smile)):
        sample = gltf_samples.hero()
        sample.gltf |= vrm_files.extensions(version, bones, {"happy": expression})
        sample.glb(folder / f"v{version}.vrm")


def vrma(folder: Path) -> None:
    import vrm_files

    rest = vrm_files.bone_positions(vrm_files.plain_vrm("+z")[0])
    vrm_files.vrma(folder / "a.vrma", rest, frames=3, expressions={"happy": np.arange(3) / 2})


def bvh(folder: Path) -> None:
    body, motion = load_body(), window(load_motion("walk"), 0.0, 0.09)
    write_bvh(folder / "walk.bvh", body, motion)
    write_bvh(folder / "other.bvh", body, motion, rest="a", axes=Z_UP, scale=100.0, order="XYZ")


def amass(folder: Path) -> None:
    body, motion = load_body(), window(load_motion("walk"), 0.0, 0.09)
    path = write_amass(folder / "walk.npz", body, motion, Z_UP, joints=22, mocap_framerate=30.0, betas=np.zeros(10))
    with np.load(path) as arrays:
        poses, trans = arrays["poses"], arrays["trans"]
    np.savez(folder / "split.npz", root_orient=poses[:, :3], pose_body=poses[:, 3:66], trans=trans)


def joints(folder: Path) -> None:
    places = {"Hips": [0, 1, 0], "Head": [0, 1.7, 0.02], "LeftLeg": [0.1, 0.5, 0.02]}
    save_corrections(JointCorrections.of(places, mesh="hero.glb", vertices=5310), folder / "hero.joints.json")


def markers(folder: Path) -> None:
    (folder / "a.txt").write_text("# identity driving\n0 3\n1 2 # nose\n\n17 4\n")


def body_model(folder: Path) -> None:
    for protocol in (0, 2, 4):
        smpl_files.write_model(folder / f"p{protocol}.pkl", smpl_files.small_arrays(), protocol)
    smpl_files.write_model(folder / "old.pkl", smpl_files.small_arrays(), 1, chumpy=True)


def body_archive(folder: Path) -> None:
    smpl_files.write_model(folder / "a.npz", smpl_files.small_arrays())


def poses(folder: Path) -> None:
    """Recordings of a tiny body model."""
    rng = np.random.default_rng(0)
    entries = {"pose": rng.normal(size=15), "betas": rng.normal(size=3), "trans": rng.normal(size=3)}
    for protocol in (0, 2, 4):
        (folder / f"p{protocol}.pkl").write_bytes(pickle.dumps(entries, protocol))


def network(folder: Path) -> None:
    import networks

    networks.write_network(folder / "npt.onnx")
    networks.write_sequence_network(folder / "aniformer.onnx")
    networks.write_mime_network(folder / "mime.onnx")


def usd(suffix: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        import usd_stages

        save_clip(small_clip(), folder / f"clip{suffix}")
        if suffix == ".usdz":
            return
        stage = usd_stages.new_stage(folder / f"skinned{suffix}")
        usd_stages.set_times(stage, 0, 2)
        mesh, _ = usd_stages.add_skinned_cube(stage)
        usd_stages.bind(mesh.GetPrim(), usd_stages.add_material(stage, "/world/paint", (1, 0, 0), "red.png"))
        usd_stages.add_cube(stage)
        stage.GetRootLayer().Save()

    return write


def fbx(binary: bool) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        file = fbx_samples.arm(root=fbx_samples.rotation([0, 90, 0]))
        fbx_samples.material(file, 400, "red", [1, 0, 0])
        layer = fbx_samples.stack(file, 500, "swing", 0.1)
        fbx_samples.curve(file, 510, layer, 203, "Lcl Rotation", "d|X", [0, 0.1], [0, 40])
        channel = fbx_samples.blend_shape(file, 600, "bulge", {0: [0.1, 0, 0], 3: [0, 0.1, 0]}, 50.0)
        fbx_samples.curve(file, 520, layer, channel, "DeformPercent", "d|DeformPercent", [0, 0.1], [0, 100])
        path = folder / "arm.fbx"
        file.save(path)
        if binary:
            path.write_bytes(fbx_samples.as_binary(path.read_text()))

    return write
