"""Writes the input files of the gallery's commands: characters, motions and scans, made from shipped data only."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
from gallery_motions import dance, faced, handstand
from gallery_stage import FPS

from mimesh.bodies import CHARACTERS, RiggedBody, character, load_body
from mimesh.bodies.animals import animal, animal_body
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose
from mimesh.core.geometry import closest_on_mesh
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.evaluate import remesh
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.io import save_bvh, save_clip, save_mesh
from mimesh.motions import load_motion, motion_clip, resample, spline_motion, walk_motion
from mimesh.motions.animal_clips import gait_clip

DRIVING_SHAPE = np.array((0.8, -0.6, -0.4, 0.7))
"""Shape coefficients of the driving person."""
ANIMAL_FACES = {"cow": 6000, "cat": 5000, "dog": 4000, "horse": 5500, "rhino": 7000}
"""Animals to move, and their numbers of triangles; the shipped quadruped has 13,776."""
DRIVING_FACES = 9000


def write_inputs(folder: Path) -> None:
    """Write all input files, and overwrite existing ones."""
    folder.mkdir(parents=True, exist_ok=True)
    body = load_body()
    for name in CHARACTERS:
        save_mesh(character(name), folder / f"{name}.glb")
    motions = {
        "jump": resample(load_motion("jump"), FPS),
        "dance": dance(body, fps=FPS),
        "walk": faced(walk_motion(body, 3, 26, seconds=2.6, fps=FPS)),
        "lunge": faced(spline_motion(body, 3, 1, seconds=2.4, fps=FPS)),
    }
    for name, motion in motions.items():
        save_bvh(motion, body, folder / f"{name}.bvh")
    jump = motion_clip(body, DRIVING_SHAPE, motions["jump"])
    save_clip(noisy(jump, 0.02), folder / "noisy.glb")
    save_clip(remeshed(jump, remesh.points(body, 1500, np.random.default_rng(0))), folder / "points", suffix=".ply")
    save_clip(remeshed(jump, remesh.retriangulated()), folder / "retriangulated.glb")
    save_mesh(low_poly("heavy", 1000), folder / "low-poly.glb")
    write_poses(body, folder)
    write_animals(folder)


def write_poses(body: RiggedBody, folder: Path) -> None:
    """Write single meshes: hard poses, a scan from one side, a handstand, and a pair of a test set with its truth."""
    for i in range(3):
        pose = rotvec_to_rotmat(sample_pose(body, 5, i, JOINT_LIMITS))
        save_mesh(body.mesh(body.posed(DRIVING_SHAPE, pose)), folder / f"pose-{i}.obj")
    upright = rotvec_to_rotmat(sample_pose(body, 5, 1, JOINT_LIMITS))
    points = body.posed(DRIVING_SHAPE, upright)
    half = remesh.half(body, points, np.random.default_rng(1))
    save_mesh(Mesh(half.positions(points), half.faces), folder / "half-scan.ply")
    save_mesh(body.mesh(body.posed(DRIVING_SHAPE, handstand(body))), folder / "handstand.obj")
    protocol = PROTOCOLS["human-npt"]
    pair = protocol.unshuffled_pair("test", "unseen", 4, protocol.rng("test", "unseen", 4))
    for name, mesh in (("stander", pair.identity), ("poser", pair.driving)):
        save_mesh(mesh, folder / f"{name}.obj")
    save_mesh(pair.identity.with_vertices(pair.truth), folder / "truth.obj")


def write_animals(folder: Path) -> None:
    """Write animals and gaits without rigs, each with triangles of its own."""
    for name, faces in ANIMAL_FACES.items():
        save_mesh(retriangulated_animal(animal(name), name, faces), folder / f"{name}.glb")
    gaits = {  # two cycles of each; the gallop at half its speed
        "gallop": dataclasses.replace(gait_clip("horse", "gallop", 4, seconds=27 / (2 * FPS), fps=2 * FPS), fps=FPS),
        "dog-walk": gait_clip("dog", "walk", 2, seconds=26 / FPS, fps=FPS),
    }
    for name, clip in gaits.items():
        frames = [
            retriangulated_animal(clip.mesh.with_vertices(frame), clip.mesh.name.split("-")[0], DRIVING_FACES)
            for frame in clip.vertices
        ]
        vertices = np.stack([frame.vertices for frame in frames])
        save_clip(Clip(dataclasses.replace(frames[0], name=name), vertices, clip.fps), folder / f"{name}.glb")


def noisy(clip: Clip, sigma: float) -> Clip:
    """Add normal noise to every vertex of every frame; `sigma` is relative to half the height."""
    rng, half_height = np.random.default_rng(0), np.ptp(clip.mesh.vertices[:, 1]) / 2
    return dataclasses.replace(clip, vertices=clip.vertices + rng.normal(0, sigma * half_height, clip.vertices.shape))


def remeshed(clip: Clip, meshing: remesh.Remesh) -> Clip:
    """Return a clip of the body with the vertices and triangles of a remeshing."""
    vertices = np.stack([meshing.positions(frame) for frame in clip.vertices])
    return Clip(Mesh(vertices[0], meshing.faces), vertices, clip.fps)


def retriangulated_animal(mesh: Mesh, name: str, faces: int) -> Mesh:
    """Return a shipped animal in any pose with about `faces` triangles of its own, and other vertices."""
    meshing = animal_meshing(name, faces)
    part = dataclasses.replace(mesh.parts[0], stop=len(meshing.faces))
    return Mesh(meshing.positions(mesh.vertices), meshing.faces, name=mesh.name, parts=(part,))


@cache
def animal_meshing(name: str, faces: int) -> remesh.Remesh:
    """Simplify a shipped animal and project the new vertices onto its surface."""
    import fast_simplification

    body = animal_body(name)
    points, triangles, *_ = fast_simplification.simplify(body.vertices, body.faces.astype(np.int32), target_count=faces)
    face, barycentric, _ = closest_on_mesh(points.astype(np.float64), body.vertices, body.faces)
    return remesh.Remesh(triangles.astype(np.int64), body.faces[face], barycentric)


def low_poly(name: str, faces: int) -> Mesh:
    """Return the skin of a shipped character (without clothes and hair), decimated to `faces` triangles."""
    import fast_simplification

    # The skin comes first in the vertices and triangles of a character.
    body, mesh = load_body(), character(name)
    vertices, triangles = mesh.vertices[: len(body.vertices)], mesh.faces[: len(body.faces)].astype(np.int32)
    points, triangles, *_ = fast_simplification.simplify(vertices, triangles, target_count=faces)
    part = Part("skin", 0, len(triangles), Material("skin", (0.38, 0.30, 0.52, 1.0)))
    return Mesh(points.astype(np.float64), triangles.astype(np.int64), name="low-poly", parts=(part,))
