"""AniFormer's figures with our people and methods: a row a method, frames of one clip from left to right."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.mesh import Clip, Mesh
from ..io import load_mesh
from ..pipeline import animate
from .clip_measure import as_known, moved_clip
from .clip_protocols import CLIPS_ANIFORMER, FRAMES, ClipPair, clips_aniformer
from .protocols import shaken
from .tiles import Tile, folder_of_people

SHOWN = np.linspace(2, FRAMES - 3, 5).round().astype(int)
"""Frames that are drawn."""


def clips_compared(models: tuple[str, ...], count: int, data: Path | None, *, kind: str) -> Iterator[list[Tile]]:
    """Identity and driving, a result for each model, truth (Fig. 3 and 4)."""
    for i in range(count):
        yield from _trial(clips_aniformer(data).pair("test", kind, 5 * i), models)


def clips_noisy(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """More noise on the driving clip in each pair of rows, drawn anew in every frame (last row of Fig. 5)."""
    for percent in range(min(count, 6)):
        trial = CLIPS_ANIFORMER.pair("test", "procedural", 0)
        rng = CLIPS_ANIFORMER.rng("test", "procedural", 0)
        frames = np.stack([shaken(frame, percent / 100, rng) for frame in trial.clip.vertices])
        mesh = Mesh(frames[0], trial.driving.faces, name=f"noise {percent} %")
        noisy = dataclasses.replace(trial, driving=mesh, clip=Clip(mesh, frames, trial.clip.fps))
        yield from [*_trial(noisy, models)][:-1]


def others_in_motion(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Identities from other makers, of any vertex count, moved as one of our people (Fig. 5)."""
    for i, path in enumerate(folder_of_people(data)[:count]):
        clip = CLIPS_ANIFORMER.pair("test", "procedural", i).clip
        yield _frames("driving", clip.vertices, clip.mesh.faces)
        identity = load_mesh(path)
        for model in models:
            result = animate(identity, clip, model, driving_up="+y", driving_front="+z")
            tiles = [Tile(model, result.clip.mesh.with_vertices(result.clip.vertices[t])) for t in SHOWN]
            yield [Tile(path.stem, identity), *tiles]


def _trial(trial: ClipPair, models: tuple[str, ...]) -> Iterator[list[Tile]]:
    identity, faces = Tile("identity", trial.identity), trial.identity.faces
    yield [identity, *_frames(trial.driving.name, trial.clip.vertices, trial.driving.faces)]
    for model in models:
        known = as_known(trial, model)
        yield [Tile(model, known.identity), *_frames(model, moved_clip(known, model), known.identity.faces)]
    yield [identity, *_frames("truth", trial.truth_frames, faces)]


def _frames(label: str, frames: Float[np.ndarray, "T V 3"], faces: Int[np.ndarray, "F 3"]) -> list[Tile]:
    return [Tile(f"{label}, frame {t}", Mesh(frames[t].astype(np.float64), faces)) for t in SHOWN]
