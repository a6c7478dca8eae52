"""Small sound files of every format that is read, from which damaged ones are made: written by code, none is copied."""

from __future__ import annotations

import dataclasses
import struct
import tempfile
import zipfile
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
from fuzz_mutations import packed_zip
from gltf_samples import Sample
from motion_files import Z_UP, write_amass, write_bvh

from mimesh.bodies import load_body
from mimesh.bodies.engine_names import SCHEMES
from mimesh.core.joint_corrections import JointCorrections
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.io import save_clip, save_mesh
from mimesh.io.joint_file import save_corrections
from mimesh.motions.clips import load_motion
from mimesh.motions.motion import window

MTL = b"""newmtl Brick
Kd 0.8 0.2 0.1
map_Kd -s 1 1 1 looks.png
newmtl Plaster
Kd 1 1 1
d 0.5
Pr 0.25
"""


@dataclasses.dataclass(frozen=True)
class Seed:
    """A sound file and those beside it, by name."""

    main: str
    files: dict[str, bytes]

    @property
    def content(self) -> bytes:
        return self.files[self.main]


def seeds_of(write: Callable[[Path], None], suffix: str) -> list[Seed]:
    """Run a function that writes files into a folder; those of the suffix are seeds, others of their name go along."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        files = {path.name: _content(path) for path in sorted(Path(folder).iterdir()) if path.is_file()}
    mains = [name for name in files if name.endswith(suffix)]
    beside = {main: {name for name in files if name.split(".")[0] == main.split(".")[0]} for main in mains}
    return [Seed(main, {name: files[name] for name in (main, *sorted(beside[main] - {main}))}) for main in mains]


def _content(path: Path) -> bytes:
    """Read a file; archives are packed again, as they hold the time at which they were made."""
    if path.suffix not in (".npz", ".usdz"):
        return path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
        return packed_zip(members, archive.infolist()[0].compress_type)


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


def obj(folder: Path) -> None:
    texts = {**hostile.OBJ, "nasty": nasty.NASTY_OBJ, "sheets": nasty.SHEETS_SHARED_NORMALS}
    for number, text in enumerate(texts.values()):
        (folder / f"t{number}.obj").write_bytes(text)
    looks = nasty.NASTY_OBJ.replace(b"mtllib looks.mtl", b"mtllib looks.mtl\nmtllib looks.obj.mtl")
    (folder / "looks.obj").write_bytes(looks)
    (folder / "looks.mtl").write_bytes(MTL)
    (folder / "looks.png").write_bytes(gltf_samples.png())
    save_mesh(small_clip().mesh, folder / "own.obj")


def ply_text(folder: Path) -> None:
    for number, text in enumerate(hostile.PLY.values()):
        (folder / f"t{number}.ply").write_bytes(text)


def ply_binary(folder: Path) -> None:
    save_mesh(small_clip().mesh, folder / "own.ply")
    save_mesh(zoo.point_cloud(), folder / "cloud.ply")
    head = b"ply\nformat binary_%b_endian 1.0\nelement vertex 4\nproperty %b x\nproperty %b y\nproperty %b z\n"
    head += b"property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\n"
    head += b"property list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    for order, sign, kind, code in ((b"little", "<", b"float", "f"), (b"big", ">", b"double", "d")):
        rows = b"".join(struct.pack(f"{sign}3{code}3B", *xyz, 9, 200, 7) for xyz in np.eye(4, 3).tolist())
        faces = b"".join(struct.pack(f"{sign}B3iB6f", 3, *f, 6, *range(6)) for f in ((0, 1, 2), (0, 2, 3)))
        (folder / f"{order.decode()}.ply").write_bytes(head % (order, kind, kind, kind) + rows + faces)


def off(folder: Path) -> None:
    for number, text in enumerate(hostile.OFF.values()):
        (folder / f"t{number}.off").write_bytes(text)
    save_mesh(small_clip().mesh, folder / "own.off")


def stl_text(folder: Path) -> None:
    for number, text in enumerate(hostile.STL.values()):
        (folder / f"t{number}.stl").write_bytes(text)


def stl_binary(folder: Path) -> None:
    save_mesh(zoo.cube(), folder / "own.stl")
    save_mesh(zoo.tetrahedron(), folder / "small.stl")


def npz(folder: Path) -> None:
    clip = small_clip()
    save_mesh(clip.mesh, folder / "mesh.npz")
    save_clip(clip, folder / "clip.npz")
    np.savez(folder / "quads.npz", v=clip.vertices[0].astype(np.float32), f=np.array([[0, 1, 4, 3]]), fps=25)
    np.savez_compressed(folder / "points.npz", points=clip.vertices)


def cache_of(suffix: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        save_clip(small_clip(), folder / f"own{suffix}")
        save_clip(Clip(zoo.point_cloud(), np.stack([zoo.point_cloud().vertices] * 2)), folder / f"cloud{suffix}")
        (folder / "cloud.obj").unlink(missing_ok=True)
        if suffix == ".npy":
            np.save(folder / "rows.npy", np.asfortranarray(np.eye(4, 3)))

    return write


def moving_box() -> Sample:
    """A box below a turning node, with a strip of morph targets: linear, stepped, spline and weight channels."""
    sample = gltf_samples.hero()
    gltf = sample.gltf
    times = sample.accessor([0.0, 0.05, 0.1])
    rng = np.random.default_rng(0)
    spline = rng.normal(size=(9, 3))
    turns = np.array([[0, 0, 0, 1], [0, 0, 0.6, 0.8], [0.6, 0, 0, 0.8]]) * 32767
    samplers = [
        {"input": times, "output": sample.accessor(turns.round(), "i2", normalized=True)},
        {"input": times, "output": sample.accessor(spline), "interpolation": "CUBICSPLINE"},
        {"input": times, "output": sample.accessor(np.ones((3, 3))), "interpolation": "STEP"},
        {"input": times, "output": sample.accessor(rng.random(6).reshape(-1, 1))},
        {"input": times, "output": sample.sparse([[0, 0, 0, 0], [0, 0, 0, 1], [0, 0.6, 0, 0.8]])},
    ]
    targets = [(1, "rotation"), (2, "translation"), (2, "scale"), (4, "weights"), (0, "rotation")]
    channels = [{"sampler": k, "target": {"node": n, "path": path}} for k, (n, path) in enumerate(targets)]
    gltf["animations"].append({"name": "all", "samplers": samplers, "channels": channels})
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

    plain = gltf_samples.props().glb(folder / "plain")
    plain = plain.rename(folder / "plain.glb")
    compressed_files.meshopt_glb(plain, folder / "meshopt.glb")
    compressed_files.draco_glb(plain, folder / "draco.glb")
    plain.unlink()


@cache
def bone_positions() -> dict[str, np.ndarray]:
    """Positions of VRM's bones in the shipped body at rest, without fingers."""
    body, bones = load_body(), SCHEMES["vrm"].bones
    return {bones[name]: joint for name, joint in zip(body.joint_names, body.joints, strict=True) if name in bones}


def vrm(folder: Path) -> None:
    """Characters with a box at each bone, one of VRM 1.0 and one of 0.x."""
    import vrm_files

    rest = bone_positions()
    bones = list(rest)
    for version in (0, 1):
        sample = Sample()
        positions, _, _, faces = gltf_samples.box(0.03)
        points = np.concatenate([positions + rest[bone] for bone in bones])
        triangles = np.concatenate([faces + len(positions) * k for k in range(len(bones))])
        joints = np.repeat(np.eye(len(bones), 1) * 0 + np.arange(len(bones))[:, None], len(positions), axis=0)
        attributes = {
            "POSITION": sample.accessor(points),
            "JOINTS_0": sample.accessor(np.pad(joints, ((0, 0), (0, 3))), "u1"),
            "WEIGHTS_0": sample.accessor(np.tile([1.0, 0, 0, 0], (len(points), 1))),
        }
        targets = [{"POSITION": sample.sparse(np.eye(len(points), 3) * 0.01)}]
        primitive = {"attributes": attributes, "indices": sample.indices(triangles), "targets": targets}
        nodes = []
        for bone in bones:
            above = vrm_files.nearest(bone, rest)
            step = rest[bone] - (rest[above] if above else 0)
            children = [k for k, child in enumerate(bones) if vrm_files.nearest(child, rest) == bone]
            nodes.append({"name": bone, "translation": step.tolist(), **({"children": children} if children else {})})
        bind = np.tile(np.eye(4), (len(bones), 1, 1))
        bind[:, :3, 3] = [-rest[bone] for bone in bones]
        sample.gltf |= {
            "scene": 0,
            "scenes": [{"nodes": [bones.index("hips"), len(bones)]}],
            "nodes": [*nodes, {"name": "body", "mesh": 0, "skin": 0}],
            "meshes": [{"primitives": [primitive], "extras": {"targetNames": ["smile"]}}],
            "skins": [
                {
                    "joints": list(range(len(bones))),
                    "inverseBindMatrices": sample.accessor(np.swapaxes(bind, 1, 2).reshape(-1, 16)),
                }
            ],
        }
        smile = {"morphTargetBinds": [{"node": len(bones), "index": 0, "weight": 1.0}]}
        smile = smile if version else {"binds": [{"mesh": 0, "index": 0, "weight": 100}]}
        sample.gltf |= vrm_files.extensions(version, {bone: k for k, bone in enumerate(bones)}, {"happy": smile})
        sample.glb(folder / f"v{version}.vrm")


def vrma(folder: Path) -> None:
    import vrm_files

    vrm_files.vrma(folder / "a.vrma", bone_positions(), frames=3, expressions={"happy": np.arange(3) / 2})


def bvh(folder: Path) -> None:
    body, motion = load_body(), window(load_motion("walk"), 0.0, 0.09)
    write_bvh(folder / "walk.bvh", body, motion)
    write_bvh(folder / "other.bvh", body, motion, rest="a", axes=Z_UP, scale=100.0, order="XYZ")


def amass(folder: Path) -> None:
    body, motion = load_body(), window(load_motion("walk"), 0.0, 0.09)
    write_amass(folder / "walk.npz", body, motion, Z_UP, joints=22, mocap_framerate=30.0, betas=np.zeros(10))
    path = write_amass(folder / "x.npz", body, motion, Z_UP, joints=22)
    with np.load(path) as arrays:
        poses = arrays["poses"]
        np.savez(folder / "split.npz", root_orient=poses[:, :3], pose_body=poses[:, 3:66], trans=arrays["trans"])
    path.unlink()


def joints(folder: Path) -> None:
    places = {"Hips": [0, 1, 0], "Head": [0, 1.7, 0.02], "LeftLeg": [0.1, 0.5, 0.02]}
    save_corrections(JointCorrections.of(places, mesh="hero.glb", vertices=5310), folder / "hero.joints.json")


def markers(folder: Path) -> None:
    (folder / "a.txt").write_text("# identity driving\n0 3\n1 2 # nose\n\n17 4\n")


def hdf5(folder: Path) -> None:
    clip = small_clip()
    plain, packed = {"50002_jump": clip.vertices}, {"chunks": (9, 3, 1), "compression": "gzip", "shuffle": True}
    smpl_files.write_dfaust(folder / "a.hdf5", plain, clip.mesh.faces)
    smpl_files.write_dfaust(folder / "b.hdf5", {"x": clip.vertices, "y": clip.vertices}, clip.mesh.faces, **packed)


def body_model(folder: Path) -> None:
    arrays = smpl_files.small_arrays()
    for protocol in (0, 2, 4):
        smpl_files.write_model(folder / f"p{protocol}.pkl", arrays, protocol)
    smpl_files.write_model(folder / "old.pkl", arrays, 1, chumpy=True)


def body_archive(folder: Path) -> None:
    smpl_files.write_model(folder / "a.npz", smpl_files.small_arrays())


def poses(folder: Path) -> None:
    """Recordings of a tiny body model."""
    import pickle

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


def alembic(folder: Path) -> None:
    save_clip(small_clip(), folder / "clip.abc")
    still: Mesh = zoo.two_parts()
    save_mesh(still, folder / "still.abc")


def fbx(folder: Path, binary: bool) -> None:
    file = fbx_samples.arm(root=fbx_samples.rotation([0, 90, 0]))
    fbx_samples.material(file, 400, "red", [1, 0, 0])
    layer = fbx_samples.stack(file, 500, "swing", 0.1)
    fbx_samples.curve(file, 510, layer, 203, "Lcl Rotation", "d|X", [0, 0.1], [0, 40])
    channel = fbx_samples.blend_shape(file, 600, "bulge", {0: [0.1, 0, 0], 3: [0, 0.1, 0]}, 50.0)
    fbx_samples.curve(file, 520, layer, channel, "DeformPercent", "d|DeformPercent", [0, 0.1], [0, 100])
    file.save(folder / "arm.fbx")
    plain = fbx_samples.FbxFile(unit=100.0, up=2)
    points, polygons = fbx_samples.arm_points()
    fbx_samples.geometry(plain, 100, points, polygons)
    plain.model(200, "skin", "Mesh", 0)
    plain.link(100, 200)
    plain.save(folder / "plain.fbx")
    for path in folder.glob("*.fbx") if binary else ():
        path.write_bytes(fbx_samples.as_binary(path.read_text()))
