"""Files of every format, damaged at random, are read or clearly refused: some hundred of each, always the same ones."""

from __future__ import annotations

import resource
import shutil
import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import hostile
import numpy as np
import pytest
import small_files
from damage import Change, some_bytes, some_glb, some_json, some_text, some_zip
from fork_server import ForkServer
from matrix import matrix

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh
from mimesh.io import child_process, list_animations, load_clip, load_mesh, load_recorded_clip
from mimesh.io.joint_file import load_corrections
from mimesh.io.text import load_markers
from mimesh.methods.onnx_models import load_network
from mimesh.pipeline.gltf_rigs import rig_facts

CASES = {"bvh": 40, "amass": 40, "vrma": 30, "onnx": 100}
"""Cases of the slower readers; the limit is a number of cases, so that every machine reads the same."""
OTHERS, NATIVE = 120, 40
"""Cases of other readers, and of those in children."""
SECONDS = 10.0
"""Processor time that a case may take."""
LONGEST_REFUSAL = 2000
"""Characters."""
SERVER = ForkServer()


@pytest.fixture(scope="module", autouse=True)
def forked():
    """Have native decoders run in children that are forked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(child_process, "_run", SERVER.run)
        yield
    SERVER.close()


def read_rig(path: Path) -> Mesh:
    """Read a mesh, and its rig as the methods take it."""
    mesh = load_mesh(path)
    rig_facts(mesh)
    return mesh


def read_last_animation(path: Path) -> Clip | Mesh:
    names = list_animations(path)
    return load_clip(path, animation=names[-1]) if names else load_mesh(path)


def read_resampled(path: Path) -> Clip:
    return load_clip(path, fps=20.0)


def read_poses(path: Path) -> Clip:
    """Read recorded poses with a sound body model."""
    return load_recorded_clip(path, sound_files("body-npz") / "a.npz")[0]


Write, Reads = Callable[[Path], None], tuple[Callable[[Path], Any], ...]
MESHES, CLIPS = (load_mesh, load_clip), (load_clip, read_resampled)
BOTH, SCENES = (load_mesh, *CLIPS), (load_mesh, load_clip, read_rig, read_last_animation)
TARGETS: dict[str, tuple[str, Write, Change, Reads]] = {
    "obj": (".obj", small_files.obj, some_text, MESHES),
    "ply": (".ply", small_files.ply, some_text, MESHES),
    "stl": (".stl", small_files.meshes(".stl", hostile.STL), some_text, MESHES),
    "npz": (".npz", small_files.npz, some_zip, BOTH),
    "pc2": (".pc2", small_files.clips(".pc2"), some_bytes, CLIPS),
    "glb": (".glb", small_files.glb, some_glb, SCENES),
    "gltf": (".gltf", small_files.gltf, some_json, SCENES),
    "vrm": (".vrm", small_files.vrm, some_glb, SCENES),
    "vrma": (".vrma", small_files.vrma, some_glb, MESHES),
    "bvh": (".bvh", small_files.bvh, some_text, BOTH),
    "joints": (".json", small_files.joints, some_json, (load_corrections,)),
    "markers": (".txt", small_files.markers, some_text, (load_markers,)),
    "body-pkl": (".pkl", small_files.body_model, some_bytes, MESHES),
    "body-npz": (".npz", small_files.body_archive, some_zip, MESHES),
    "poses-pkl": (".pkl", small_files.poses, some_bytes, (read_poses,)),
    "amass": (".npz", small_files.amass, some_zip, (*BOTH, read_poses)),
    "onnx": (".onnx", small_files.network, some_bytes, (lambda path: load_network(path, name=path.stem),)),
    "gltf-packed": (".glb", small_files.compressed, some_glb, MESHES),
    "usda": (".usda", small_files.usd(".usda"), some_text, BOTH),
    "usdc": (".usdc", small_files.usd(".usdc"), some_bytes, BOTH),
    "usdz": (".usdz", small_files.usd(".usdz"), some_zip, BOTH),
    "fbx-text": (".fbx", small_files.fbx(binary=False), some_text, SCENES),
    "fbx-binary": (".fbx", small_files.fbx(binary=True), some_bytes, SCENES),
}
"""Reader -> suffix, what writes sound files, how they are damaged, and the functions that take turns to read them."""
NEEDS = {
    "onnx": "onnx", "gltf-packed": "meshopt", "usda": "pxr", "usdc": "pxr", "usdz": "pxr",
    "fbx-text": "ufbx", "fbx-binary": "ufbx",
}  # fmt: skip
"""Reader -> package without which there is none."""
IN_CHILDREN = NEEDS.keys() - {"onnx"}
"""Readers whose library decodes each file in a guarded process of its own."""
FOLDERS: dict[str, Path] = {}


@pytest.fixture(scope="module", autouse=True)
def scratch(tmp_path_factory):
    FOLDERS["sound"] = tmp_path_factory.mktemp("sound")


@cache
def sound_files(name: str) -> Path:
    """Return a folder with the sound files of a reader."""
    folder = FOLDERS["sound"] / name
    folder.mkdir()
    TARGETS[name][1](folder)
    return folder


def write_case(name: str, number: int, folder: Path) -> Path:
    """Write a case: a sound file with those beside it, of which one is damaged one to four times."""
    suffix, _, change, _ = TARGETS[name]
    rng, sound = Random(f"{name} {number}"), sound_files(name)
    main = rng.choice(sorted(sound.glob(f"*{suffix}")))
    beside = [path for path in sorted(sound.glob(f"{main.name.split('.')[0]}.*")) if path != main]
    for path in (main, *beside):
        shutil.copy(path, folder)
    chosen = rng.choice(beside) if beside and rng.random() < 0.4 else main
    data = chosen.read_bytes()
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = (change if chosen == main else some_text)(data, rng)
    (folder / chosen.name).write_bytes(data)
    return folder / main.name


def check_result(result: Any) -> None:
    """Check that what was read is sound."""
    if isinstance(result, Clip):
        assert 0 < result.fps < np.inf
        assert all(np.isfinite(frame).all() for frame in result.vertices)
        result = result.mesh
    if not isinstance(result, Mesh):
        return
    assert len(result.vertices)
    assert np.isfinite(result.vertices).all()
    assert not len(result.faces) or 0 <= result.faces.min() <= result.faces.max() < len(result.vertices)
    sizes = {"corner_uv": len(result.faces), "corner_normals": len(result.faces), "vertex_colors": len(result.vertices)}
    for name, size in sizes.items():
        values = getattr(result, name)
        assert values is None or (len(values) == size and np.isfinite(values).all()), name
    assert all(0 <= part.start <= part.stop <= len(result.faces) for part in result.parts)


def check_refusal(error: InputError, folder: Path) -> None:
    """Check that a refusal is one line that names the file and what was found, before memory has run out."""
    message = str(error)
    assert all(word in message for word in ("expected ", "found ", str(folder)))
    assert "\n" not in message
    assert len(message) < LONGEST_REFUSAL
    cause: BaseException | None = error
    while cause := cause.__cause__ or cause.__context__:
        assert not isinstance(cause, MemoryError)


def processor_time() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime + SERVER.seconds


@matrix("name", TARGETS, quick=["ply", "pc2"])
def test_damaged_files_are_read_or_refused(name, tmp_path):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    suffix, _, _, reads = TARGETS[name]
    for path in sorted(sound_files(name).glob(f"*{suffix}")):
        check_result((load_clip if load_clip in reads else reads[0])(path))
    kinds = Counter()
    for number in range(CASES.get(name, NATIVE if name in IN_CHILDREN else OTHERS)):
        folder = tmp_path / f"case{number}"  # libraries of native formats know layers by their path
        folder.mkdir()
        path, begin = write_case(name, number, folder), processor_time()
        try:
            check_result(reads[number % len(reads)](path))
            kinds["accepted"] += 1
        except InputError as error:
            check_refusal(error, folder)
            kinds["refused"] += 1
        assert processor_time() - begin < SECONDS, folder
        shutil.rmtree(folder)
    assert min(kinds["accepted"], kinds["refused"]) > 2, kinds
