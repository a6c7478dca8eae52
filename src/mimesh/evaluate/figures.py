"""The figures of both papers with our people and methods: one page each. NPT's have a row a trial."""

from __future__ import annotations

import colorsys
import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh
from ..io import load_mesh
from ..pipeline import animate, transfer
from .clip_protocols import CLIPS_ANIFORMER, FRAMES, ClipPair, clips_aniformer
from .cross_body import SUFFIXES
from .measure import on_supported_vertices, result_vertices, result_frames
from .pairs import Pair, shuffle_vertices
from .protocols import HUMAN_NPT, HUMAN_WIDE, NOISE, with_noise
from .run import check_method

if TYPE_CHECKING:
    from PIL import Image

NPT_ABLATIONS = ("npt-concat1", "npt-no-spadain", "npt-no-edge", "npt-equal")

ANIFORMER_ABLATIONS = ("aniformer-regression", "aniformer-plain", "aniformer-motion", "aniformer-appearance", "aniformer-equal")


TILE = (300, 360)


SHOWN_FRAMES = np.linspace(2, FRAMES - 3, 5).round().astype(int)
"""Frames that are drawn."""


class Tile(NamedTuple):
    """One mesh of a page; `colors` a vertex instead of its materials."""

    label: str
    mesh: Mesh
    colors: Float[np.ndarray, "V 3"] | None = None


class Figure(NamedTuple):
    """What a figure shows and how its rows are made from the models, a number of rows and a folder of meshes."""

    title: str
    rows: Callable[[tuple[str, ...], int, Path | None], Iterator[list[Tile]]]
    models: tuple[str, ...]
    count: int


def figure_command(
    name: str,
    out: Path,
    models: tuple[str, ...] = (),
    rows: int = 0,
    data: Path | None = None,
    progress: Progress | None = None,
) -> int:
    """What `mimesh figure` does: draw a figure of the paper into a picture; gives how many rows it has."""
    from ..render.sheet import stack
    from ..tools.preview import save_picture

    if name not in FIGURES:
        raise InputError(f"{name}: expected a figure ({', '.join(FIGURES)}), found another; check the name")
    figure = FIGURES[name]
    for model in models or figure.models:
        check_method(model)
    count, pages = rows or figure.count, []
    for tiles in figure.rows(models or figure.models, count, data):
        pages.append(draw_row(tiles))
        if progress is not None:
            progress(len(pages), max(count, len(pages)))
    save_picture(stack(pages), out)
    return len(pages)


def comparison_rows(
    models: tuple[str, ...], count: int, data: Path | None, *, protocol=HUMAN_NPT, kind: str
) -> Iterator[list[Tile]]:
    """Identity, driving, a result for each model, truth."""
    for i in range(count):
        yield _trial(protocol.pair("test", kind, i), models)


def vertex_order_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """One pair again and again, its vertices shuffled anew in each row and coloured by their number (Fig. 8, 15)."""
    pair = HUMAN_NPT.unshuffled_pair("test", "unseen", 0, HUMAN_NPT.rng("test", "unseen", 0))
    for i in range(count):
        again = shuffle_vertices(pair, np.random.default_rng(i)) if i else pair
        results = [(model, dataclasses.replace(again.identity, vertices=result_vertices(again, model))) for model in models]
        shown = [("identity", again.identity), ("driving", again.driving), *results]
        yield [Tile(label, mesh, vertex_index_colors(len(mesh.vertices))) for label, mesh in shown]


def noisy(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """More noise on the driving vertices in each row (Fig. 12, 16)."""
    for percent in range(min(count, 6)):
        kind = f"noise-{percent}"
        rng = NOISE.rng("test", "noise-0", 0)
        pair = NOISE.unshuffled_pair("test", "noise-0", 0, rng)
        identity, driving, *others = _trial(NOISE.noisy(pair, percent / 100, rng), models)
        yield [identity, driving._replace(label=f"driving, {kind.replace('-', ' ')} %"), *others]


def foreign_identity_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Identities from other makers in poses of our people (Fig. 10, 17, 18)."""
    for i, path in enumerate(folder_of_people(data)[:count]):
        driving = HUMAN_WIDE.pair("test", "clips", i).driving
        identity = load_mesh(path)
        for model in models:
            result = transfer(identity, driving, model, driving_up="+y", driving_front="+z")
            yield [Tile(path.stem, identity), Tile("driving", driving), Tile(model, result.mesh)]


def foreign_driving_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Poses from other makers on our people (Fig. 11)."""
    for i, path in enumerate(folder_of_people(data)[:count]):
        identity = HUMAN_WIDE.pair("test", "clips", i).identity
        driving = load_mesh(path)
        results = [Tile(m, transfer(identity, driving, m, up="+y", front="+z").mesh) for m in models]
        yield [Tile("identity", identity), Tile(path.stem, driving), *results]


def vertex_index_colors(count: int) -> Float[np.ndarray, "V 3"]:
    """A rainbow over vertex numbers, linear RGB in 0..1."""
    return np.array([colorsys.hsv_to_rgb(0.8 * k / count, 0.65, 0.85) for k in range(count)])


def clip_comparison_rows(models: tuple[str, ...], count: int, data: Path | None, *, kind: str) -> Iterator[list[Tile]]:
    """Identity and driving, a result for each model, truth (Fig. 3 and 4)."""
    for i in range(count):
        yield from _clip_trial(clips_aniformer(data).pair("test", kind, 5 * i), models)


def clip_noise_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """More noise on the driving clip in each pair of rows, drawn anew in every frame (last row of Fig. 5)."""
    for percent in range(min(count, 6)):
        trial = CLIPS_ANIFORMER.pair("test", "procedural", 0)
        rng = CLIPS_ANIFORMER.rng("test", "procedural", 0)
        frames = np.stack([with_noise(frame, percent / 100, rng) for frame in trial.clip.vertices])
        mesh = Mesh(frames[0], trial.driving.faces, name=f"noise {percent} %")
        noisy = dataclasses.replace(trial, driving=mesh, clip=Clip(mesh, frames, trial.clip.fps))
        yield from [*_clip_trial(noisy, models)][:-1]


def foreign_clip_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Identities from other makers, of any vertex count, moved as one of our people (Fig. 5)."""
    for i, path in enumerate(folder_of_people(data)[:count]):
        clip = CLIPS_ANIFORMER.pair("test", "procedural", i).clip
        yield _frames("driving", clip.vertices, clip.mesh.faces)
        identity = load_mesh(path)
        for model in models:
            result = animate(identity, clip, model, driving_up="+y", driving_front="+z")
            tiles = [Tile(model, result.clip.mesh.with_vertices(result.clip.vertices[t])) for t in SHOWN_FRAMES]
            yield [Tile(path.stem, identity), *tiles]


DT = ("deformation-transfer-5", "deformation-transfer-13")
FIGURES = {
    "npt-6": Figure("seen poses, beside deformation transfer", partial(comparison_rows, kind="seen"), (*DT, "npt"), 4),
    "npt-7": Figure("unseen poses, beside deformation transfer", partial(comparison_rows, kind="unseen"), (*DT, "npt"), 4),
    "npt-8": Figure("vertex order as colour", vertex_order_rows, ("npt",), 2),
    "npt-9": Figure("ablations", partial(comparison_rows, kind="unseen"), NPT_ABLATIONS, 3),
    "npt-10": Figure("identities from other makers (--data)", foreign_identity_rows, ("npt",), 3),
    "npt-11": Figure("poses from other makers (--data)", foreign_driving_rows, ("npt",), 3),
    "npt-12": Figure("noise, beside deformation transfer", noisy, ("deformation-transfer-13", "npt"), 4),
    "npt-13": Figure("other baselines", partial(comparison_rows, kind="unseen"), ("skeleton", "npt-maxpool", "npt"), 4),
    "npt-15": Figure("more vertex orders", vertex_order_rows, ("npt",), 5),
    "npt-16": Figure("more noise", noisy, ("npt",), 6),
    "npt-17": Figure("more identities from other makers (--data)", foreign_identity_rows, ("npt",), 12),
    "npt-19": Figure("more seen poses", partial(comparison_rows, kind="seen"), ("npt",), 8),
    "npt-20": Figure("more unseen poses", partial(comparison_rows, kind="unseen"), ("npt",), 8),
    "aniformer-3": Figure(
        "unseen motions, beside methods that go frame by frame (--data)",
        partial(clip_comparison_rows, kind="unseen"),
        ("npt-frames", "limp", "aniformer-equal"),
        1,
    ),
    "aniformer-4": Figure("ablations in motion (--data)", partial(clip_comparison_rows, kind="unseen"), ANIFORMER_ABLATIONS, 1),
    "aniformer-5": Figure("identities from other makers in motion (--data)", foreign_clip_rows, ("aniformer-equal",), 3),
    "aniformer-noise": Figure("noise on the driving clip", clip_noise_rows, ("aniformer-equal",), 3),
}
"""NPT's figures 14 (animals) and 18 (a registered data set) wait for their data; 17 takes any folder of people. The
last row of AniFormer's figure 5, noise, is a figure of its own."""


def draw_row(tiles: list[Tile]) -> Image.Image:
    """One row of a page."""
    from ..render.camera import fit
    from ..render.raster import render, render_mesh
    from ..render.sheet import captioned, page

    pictures = []
    for tile in tiles:
        camera = fit(tile.mesh.vertices, TILE, "three-quarter")
        if tile.colors is None:
            picture = render_mesh(tile.mesh, TILE, camera)
        else:
            picture = render(tile.mesh.vertices, tile.mesh.faces, camera, TILE, tile.colors)
        pictures.append(captioned(picture, tile.label))
    return page(pictures, len(pictures))


def folder_of_people(data: Path | None) -> list[Path]:
    """Mesh files of a folder.

    Raises:
        InputError: no folder given, or none with meshes.
    """
    if data is None or not data.is_dir():
        raise InputError(f"--data: expected a folder of people in {', '.join(SUFFIXES)} files, found {data}; give one")
    paths = sorted(path for path in data.iterdir() if path.suffix.lower() in (*SUFFIXES, ".obj", ".ply"))
    if not paths:
        raise InputError(f"{data}: expected meshes of people, found none; give another folder with --data")
    return paths


def _trial(pair: Pair, models: tuple[str, ...]) -> list[Tile]:
    identity, faces = pair.identity, pair.identity.faces
    results = [Tile(model, Mesh(result_vertices(pair, model), faces)) for model in models]
    return [Tile("identity", identity), Tile("driving", pair.driving), *results, Tile("truth", Mesh(pair.truth, faces))]


def _clip_trial(trial: ClipPair, models: tuple[str, ...]) -> Iterator[list[Tile]]:
    identity, faces = Tile("identity", trial.identity), trial.identity.faces
    yield [identity, *_frames(trial.driving.name, trial.clip.vertices, trial.driving.faces)]
    for model in models:
        known = on_supported_vertices(trial, model)
        yield [Tile(model, known.identity), *_frames(model, result_frames(known, model), known.identity.faces)]
    yield [identity, *_frames("truth", trial.truth_frames, faces)]


def _frames(label: str, frames: Float[np.ndarray, "T V 3"], faces: Int[np.ndarray, "F 3"]) -> list[Tile]:
    return [Tile(f"{label}, frame {t}", Mesh(frames[t].astype(np.float64), faces)) for t in SHOWN_FRAMES]
