"""The readers that are fuzzed: seeds, mutation and reading functions of each, and what is checked of a result."""

from __future__ import annotations

import dataclasses
import importlib.util
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Any

import fuzz_mutations as change
import fuzz_seeds as seeds
import numpy as np
from fuzz_mutations import Mutation
from fuzz_seeds import Seed

from mimesh.core.joint_corrections import JointCorrections
from mimesh.core.mesh import Clip, Mesh
from mimesh.io import list_animations, load_clip, load_mesh, load_recorded_clip
from mimesh.io.joint_file import load_corrections
from mimesh.io.markers import load_markers
from mimesh.pipeline.gltf_rigs import rig_facts

Read = Callable[[Path], Any]
LONGEST_REFUSAL = 2000
"""Characters."""


@dataclasses.dataclass(frozen=True)
class Target:
    """A reader."""

    name: str
    suffix: str
    write: Callable[[Path], None]
    """Writes the seeds into a folder."""
    mutation: Mutation
    reads: tuple[Read, ...]
    """Case number n is read with the function n modulo their number."""
    needs: str = ""
    """Package without which there is no such reader."""
    native: bool = False
    """Whether a library decodes it in a child process of its own, whose end is no failure."""

    @property
    def installed(self) -> bool:
        return not self.needs or importlib.util.find_spec(self.needs) is not None

    def seeds(self) -> list[Seed]:
        return seeds.seeds_of(self.write, self.suffix)


def case_of(target: Target, sound: list[Seed], seed: int, number: int) -> Seed:
    """Make one damaged file; number 0 and the following are the seeds themselves, without damage."""
    if number < len(sound):
        return sound[number]
    rng = Random(f"{target.name} {seed} {number}")
    chosen = rng.choice(sound)
    beside = [name for name in chosen.files if name != chosen.main]
    name = rng.choice(beside) if beside and rng.random() < 0.4 else chosen.main
    others = [other.files[name] for other in sound if name in other.files]
    mutation = target.mutation
    if name == chosen.main:
        others = [other.content for other in sound]
    else:
        mutation = change.some_bytes if name.endswith(".png") else change.some_text
    return Seed(chosen.main, {**chosen.files, name: change.mutated(chosen.files[name], mutation, rng, others)})


def problem_of(result: Any) -> str | None:
    """Tell what is wrong with an accepted result; None for a sound one."""
    if isinstance(result, Clip):
        if not 0 < result.fps < np.inf:
            return f"a frame rate of {result.fps}"
        if not all(np.isfinite(frame).all() for frame in result.vertices):
            return "a frame that is not finite"
        if result.headings is not None and not np.isfinite(result.headings).all():
            return "headings that are not finite"
        return _problem_of_mesh(dataclasses.replace(result.mesh, vertices=np.asarray(result.vertices[0], np.float64)))
    if isinstance(result, Mesh):
        return _problem_of_mesh(result)
    if isinstance(result, JointCorrections):
        return None if all(np.isfinite(place).all() for place in result.positions.values()) else "positions"
    if isinstance(result, np.ndarray):
        return None if result.dtype.kind == "i" and result.ndim == 2 and result.min(initial=0) >= 0 else "markers"
    return None


def _problem_of_mesh(mesh: Mesh) -> str | None:
    count, faces = len(mesh.vertices), mesh.faces
    if not count or not np.isfinite(mesh.vertices).all():
        return "vertices that are not finite"
    if len(faces) and not 0 <= faces.min() <= faces.max() < count:
        return "faces out of range"
    sizes = {"corner_uv": len(faces), "corner_normals": len(faces), "vertex_colors": count}
    for name, size in sizes.items():
        values = getattr(mesh, name)
        if values is not None and (len(values) != size or not np.isfinite(values).all()):
            return f"{name} of another size or not finite"
    if any(not 0 <= part.start <= part.stop <= len(faces) for part in mesh.parts):
        return "parts out of range"
    return None


def unclear(message: str, path: Path) -> bool:
    """Whether a refusal is not one line that names the file, what was expected and what was found."""
    words = all(word in message for word in ("expected ", "found ", str(path.parent)))
    return not words or "\n" in message or len(message) > LONGEST_REFUSAL


def read_rig(path: Path) -> Mesh:
    """Read a mesh, and its rig as the methods take it."""
    mesh = load_mesh(path)
    rig_facts(mesh)
    return mesh


def read_last_animation(path: Path) -> Clip | Mesh:
    """Read the last of the animations that are listed."""
    names = list_animations(path)
    return load_clip(path, animation=names[-1]) if names else load_mesh(path)


def read_resampled(path: Path) -> Clip:
    """Read a clip at another frame rate than its own."""
    return load_clip(path, fps=20.0)


def read_one_clip(path: Path) -> Clip:
    """Read the first clip of an HDF5 file."""
    return load_clip(path, animation="0")


def read_poses(path: Path) -> Clip:
    """Read recorded poses with a sound body model."""
    return load_recorded_clip(path, _sound_model())[0]


@cache
def _sound_model() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    seeds.body_archive(folder)
    return folder / "a.npz"


def read_network(path: Path) -> Any:
    """Open a network as `-m X.onnx` does."""
    from mimesh.methods.onnx_models import load_network

    return load_network(path, name=path.stem)


MESHES, CLIPS = (load_mesh, load_clip), (load_clip, read_resampled)
SCENES = (load_mesh, load_clip, read_rig, read_last_animation)
TARGETS = {
    target.name: target
    for target in (
        Target("obj", ".obj", seeds.obj, change.some_text, MESHES),
        Target("ply-text", ".ply", seeds.ply_text, change.some_text, MESHES),
        Target("ply-binary", ".ply", seeds.ply_binary, change.some_ply, MESHES),
        Target("off", ".off", seeds.off, change.some_text, MESHES),
        Target("stl-text", ".stl", seeds.stl_text, change.some_text, MESHES),
        Target("stl-binary", ".stl", seeds.stl_binary, change.some_bytes, MESHES),
        Target("npz", ".npz", seeds.npz, change.some_zip, (load_mesh, load_clip, read_resampled)),
        Target("npy", ".npy", seeds.cache_of(".npy"), change.some_npy, CLIPS),
        Target("pc2", ".pc2", seeds.cache_of(".pc2"), change.some_bytes, CLIPS),
        Target("mdd", ".mdd", seeds.cache_of(".mdd"), change.some_bytes, CLIPS),
        Target("glb", ".glb", seeds.glb, change.some_glb, SCENES),
        Target("gltf", ".gltf", seeds.gltf, change.some_json, SCENES),
        Target("vrm", ".vrm", seeds.vrm, change.some_glb, SCENES),
        Target("vrma", ".vrma", seeds.vrma, change.some_glb, MESHES),
        Target("bvh", ".bvh", seeds.bvh, change.some_text, (load_mesh, load_clip, read_resampled)),
        Target("joints", ".json", seeds.joints, change.some_json, (load_corrections,)),
        Target("markers", ".txt", seeds.markers, change.some_text, (load_markers,)),
        Target("hdf5", ".hdf5", seeds.hdf5, change.some_bytes, (read_one_clip, read_last_animation), "h5py"),
        Target("body-pkl", ".pkl", seeds.body_model, change.some_pickle, MESHES),
        Target("body-npz", ".npz", seeds.body_archive, change.some_zip, MESHES),
        Target("poses-pkl", ".pkl", seeds.poses, change.some_pickle, (read_poses,)),
        Target("amass", ".npz", seeds.amass, change.some_zip, (load_mesh, load_clip, read_resampled, read_poses)),
        Target("onnx", ".onnx", seeds.network, change.some_network, (read_network,), "onnx"),
        Target("gltf-packed", ".glb", seeds.compressed, change.some_glb, MESHES, "meshopt", True),
        Target("usda", ".usda", seeds.usd(".usda"), change.some_text, (load_mesh, *CLIPS), "pxr", True),
        Target("usdc", ".usdc", seeds.usd(".usdc"), change.some_bytes, (load_mesh, *CLIPS), "pxr", True),
        Target("usdz", ".usdz", seeds.usd(".usdz"), change.some_zip, (load_mesh, *CLIPS), "pxr", True),
        Target("alembic", ".abc", seeds.alembic, change.some_bytes, (load_mesh, *CLIPS), "alembic3d", True),
        Target("fbx-text", ".fbx", partial(seeds.fbx, binary=False), change.some_text, SCENES, "ufbx", True),
        Target("fbx-binary", ".fbx", partial(seeds.fbx, binary=True), change.some_bytes, SCENES, "ufbx", True),
    )
}
