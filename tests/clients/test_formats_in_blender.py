"""Every format in Blender: files of mimesh evaluated by Blender in every frame, and files of Blender read by mimesh.

Blender is the module `bpy` in an environment of its own: `make clients` makes one, or MIMESH_BPY names its Python.
Figures go to the file that MIMESH_FORMATS names; the table of docs/formats.md is made of them.
"""

import itertools
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from client_programs import blender
from dressed import dressed_clip
from people import person, walk
from scipy.spatial import cKDTree

import mimesh
from mimesh.evaluate.provenance import commit, libraries
from mimesh.io import load_clip, save_clip, save_mesh
from mimesh.tools.convert import convert

pytestmark = pytest.mark.client
CLIPS = (".glb", ".gltf", ".usd", ".usda", ".usdc", ".usdz", ".pc2", ".obj", ".ply")
MESHES = (".glb", ".gltf", ".usda", ".usdz", ".obj", ".ply", ".stl")
BLENDER_FILES = (
    "scene.glb",
    "separate.gltf",
    "scene.usda",
    "scene.usdc",
    "scene.usdz",
    "obj",
    "ply",
    "fbx.glb",
)
FIGURES: dict[str, dict] = {}
CLOSE = 1e-5
"""Largest error of a position, as a fraction of the mesh's extent."""


def in_blender(vertices):
    """Convert from y up to z up, as Blender's importers do."""
    return np.stack([vertices[..., 0], -vertices[..., 2], vertices[..., 1]], axis=-1)


def clip_distance(found, expected):
    """Return the largest distance between trajectories of corresponding vertices, as a fraction of the extent.

    Vertex orders may differ: each trajectory is compared with the nearest one of the other clip, in both directions.
    """
    assert len(found) == len(expected)
    trajectories = [frames.transpose(1, 0, 2).reshape(frames.shape[1], -1) for frames in (found, expected)]
    largest = 0.0
    for first, second in itertools.permutations(trajectories):
        _, nearest = cKDTree(second).query(first)
        offset = (first - second[nearest]).reshape(len(first), -1, 3)
        largest = max(largest, float(np.linalg.norm(offset, axis=-1).max()))
    return largest / float(np.ptp(expected, axis=(0, 1)).max())


def run(mode, folder):
    python = blender()
    subprocess.run([python, "-I", Path(__file__).with_name("blender_formats.py"), mode, folder], check=True)


@pytest.fixture(scope="module", autouse=True)
def report():
    """Write the figures to a file after the last test."""
    yield
    path = os.environ.get("MIMESH_FORMATS")
    if path and FIGURES:
        made = {"commit": commit(), "client": "Blender 4.5.15 (bpy)", "libraries": libraries()}
        Path(path).write_text(json.dumps({"provenance": made, "formats": FIGURES}, indent=2, sort_keys=True) + "\n")


@pytest.fixture(scope="module")
def mimesh_files(tmp_path_factory):
    """Write `dressed_clip` in every format and evaluate the files in Blender; return the folder and the clip."""
    folder = tmp_path_factory.mktemp("mimesh")
    clip = dressed_clip(folder / "dressed", frames=6, fps=24.0)
    jobs = []
    for suffix in CLIPS:
        if suffix in (".obj", ".ply"):
            save_clip(clip, folder / f"clip{suffix[1:]}", suffix=suffix)
            files = sorted((folder / f"clip{suffix[1:]}").glob(f"*{suffix}"))
            jobs += [{"name": f"clip{suffix}{t}", "path": str(path), "frames": 1} for t, path in enumerate(files)]
        elif suffix == ".pc2":
            save_clip(clip, folder / f"clip{suffix}")
            cache = {"path": str(folder / "clip.obj"), "cache": str(folder / f"clip{suffix}")}
            jobs.append({"name": f"clip{suffix}", "frames": len(clip)} | cache)
        else:
            save_clip(clip, folder / f"clip{suffix}")
            jobs.append({"name": f"clip{suffix}", "path": str(folder / f"clip{suffix}"), "frames": len(clip)})
    for suffix in MESHES:
        save_mesh(clip.mesh, folder / f"mesh{suffix}")
        jobs.append({"name": f"mesh{suffix}", "path": str(folder / f"mesh{suffix}"), "frames": 1})
    moved = mimesh.animate(person(0, faces=2000), walk(1, frames=6, faces=2500))
    moved.save_skinned(folder / "skinned.glb")
    jobs.append({"name": "skinned.glb", "path": str(folder / "skinned.glb"), "frames": 6})
    (folder / "jobs.json").write_text(
        json.dumps([{"fps": 10 if "skinned" in job["name"] else 24} | job for job in jobs])
    )
    run("read", folder)
    return folder, clip


@pytest.fixture(scope="module")
def blender_files(tmp_path_factory):
    """Let Blender write files in every format; return the folder."""
    blender()
    folder = tmp_path_factory.mktemp("blender")
    run("write", folder)
    return folder


def note(suffix, kind, error, dump=None, clip=None):
    """Record a figure, and which features of the file Blender found (`dump`)."""
    figures = FIGURES.setdefault(suffix, {})
    figures[kind] = max(figures.get(kind, 0.0), error)
    if dump is not None:
        figures["keeps"] = {
            "polygons": bool((dump["sizes"] > 3).any()),
            "UVs": len(dump["uv"]) > 0,
            "materials": len(dump["materials"]) >= 2,
            "textures": int(dump["images"]) > 0,
            "colours": int(dump["colors"]) > 0,
        }


@pytest.mark.parametrize("suffix", CLIPS)
def test_blender_reads_every_frame_of_a_clip(suffix, mimesh_files):
    folder, clip = mimesh_files
    if suffix in (".obj", ".ply"):
        dumps = [np.load(folder / f"clip{suffix}{t}.npz") for t in range(len(clip))]
        dump, frames = dumps[0], np.concatenate([one["vertices"] for one in dumps])
    else:
        dump = np.load(folder / f"clip{suffix}.npz")
        frames = dump["vertices"]
    error = clip_distance(frames, in_blender(clip.vertices.astype(np.float64)))
    note(suffix, "clip in Blender", error, None if suffix == ".pc2" else dump, clip)
    assert error <= CLOSE


@pytest.mark.parametrize("suffix", MESHES)
def test_blender_reads_a_mesh(suffix, mimesh_files):
    folder, clip = mimesh_files
    dump = np.load(folder / f"mesh{suffix}.npz")
    error = clip_distance(dump["vertices"], in_blender(clip.mesh.vertices)[None])
    note(suffix, "mesh in Blender", error, dump, clip)
    assert error <= CLOSE


def test_blender_evaluates_skinning_equally(mimesh_files):
    folder, _ = mimesh_files
    expected = load_clip(folder / "skinned.glb", fps=10.0).vertices
    error = clip_distance(np.load(folder / "skinned.glb.npz")["vertices"], in_blender(expected))
    note(".glb", "skin in Blender", error)
    assert error <= 1e-6


@pytest.mark.parametrize("name", BLENDER_FILES)
def test_files_of_blender_are_read_exactly(name, blender_files):
    truth = np.load(blender_files / ("truth_fbx.npz" if name == "fbx.glb" else "truth.npz"))["vertices"]
    clip = load_clip(blender_files / name, fps=24.0)
    found = clip.vertices.astype(np.float64)
    if not name.endswith(("usda", "usdc", "usdz", "ply")):  # those Blender writes z up, as they are
        found = in_blender(found)
    error = clip_distance(found, truth)
    note({"fbx.glb": ".fbx", "obj": ".obj", "ply": ".ply"}.get(name, Path(name).suffix), "Blender's, read", error)
    assert error <= CLOSE


@pytest.mark.parametrize("suffix", [".glb", ".usdc"])
def test_files_of_blender_survive_conversion(suffix, blender_files, tmp_path):
    convert(blender_files / f"scene{suffix}", tmp_path / f"a{suffix}")
    again = load_clip(tmp_path / f"a{suffix}")
    first = load_clip(blender_files / f"scene{suffix}")
    assert again.fps == first.fps
    assert clip_distance(again.vertices.astype(np.float64), first.vertices.astype(np.float64)) <= CLOSE
