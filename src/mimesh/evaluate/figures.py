"""Draw the figures of both papers with the shipped body and our methods, each as one picture of rows of meshes."""

from __future__ import annotations

import colorsys
import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..bodies.animals import ANIMALS
from ..bodies.quadruped import posture
from ..bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape
from ..core.errors import InputError, did_you_mean
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh, permute_vertices
from ..core.options import Hints
from ..io import load_mesh
from ..methods.find import check_weights, how_to_make, missing_weights
from ..motions.gaits import SEEDS, gait_rotations
from ..motions.motion import Motion, rotmat_to_rotvec
from ..motions.procedural import planted
from ..pipeline import animate, transfer
from .clip_protocols import CLIPS_ANIFORMER, CLIPS_ORDERED, FPS, FRAMES, ClipPair, make_clip_pair
from .cross_body import SUFFIXES
from .measure import on_supported_vertices, run_on_clip, run_on_pair
from .pairs import Pair, Person, Pose, human
from .protocols import HUMAN_NPT, NOISE, quadruped, with_noise
from .run import check_method

if TYPE_CHECKING:
    from PIL import Image

NPT_ABLATIONS = ("npt-concat1", "npt-no-spadain", "npt-no-edge", "npt-equal", "npt-full")
ANIFORMER_ABLATIONS = (
    "aniformer-ordered-vanilla",
    "aniformer-ordered-plain",
    "aniformer-ordered-motion",
    "aniformer-ordered-appearance",
    "aniformer-ordered-equal",
    "aniformer-ordered-mixed",
)
TILE = (300, 360)
"""Width and height (pixels) of the picture of one mesh."""
ANIMAL_GAITS = ("gallop", "walk", "bound")
"""Gaits of figures of animals, one after another."""
SHOWN_FRAMES = np.linspace(2, FRAMES - 3, 5).round().astype(int)
"""Frames of a clip that are drawn: five, evenly spaced. Each is the middle of a window of three that a method gets."""


class Tile(NamedTuple):
    """One mesh of a picture and its caption."""

    label: str
    mesh: Mesh | None
    """None: an empty tile."""
    colors: Float[np.ndarray, "V 3"] | None = None
    """Colours of the vertices (linear RGB in 0..1) instead of the mesh's materials."""


EMPTY = Tile("", None)


class Figure(NamedTuple):
    """A figure of a paper."""

    title: str
    rows: Callable[[tuple[str, ...], int, Path | None], Iterator[list[Tile]]]
    """Makes the rows from the models, the number of rows and a folder of people's meshes (`--data`)."""
    models: tuple[str, ...]
    """Models that are drawn unless others are given."""
    row_count: int
    """Number of rows unless another is given."""
    needs_people: bool = False
    """Whether it shows meshes of a folder (`--data`)."""


def figure_command(
    name: str,
    out: Path,
    models: tuple[str, ...] = (),
    rows: int = 0,
    data: Path | None = None,
    progress: Progress | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> int:
    """Draw a figure of a paper into a picture (`mimesh figure`) and return its number of rows.

    Args:
        models: drawn instead of the figure's own, of which those without weights are left out.
        note: told which are left out, and how to make them, before anything is drawn.

    Raises:
        InputError: no such figure or model, or no folder of people where the figure needs one.
    """
    from ..tools.preview import save_picture
    from ..view.sheet import stack

    if name not in FIGURES:
        close = did_you_mean(name, FIGURES) or "; check the name"
        raise InputError(f"{name}: expected a figure ({', '.join(FIGURES)}), found another{close}")
    figure = FIGURES[name]
    if figure.needs_people:
        mesh_files(data)
    if not models:
        models, text = models_with_weights(name, figure.models)
        if text:
            note(text)
    for model in models:
        check_method(model)
    count, pages = rows or figure.row_count, []
    for tiles in figure.rows(models, count, data):
        pages.append(draw_row(tiles))
        if progress is not None:
            progress(len(pages), max(count, len(pages)))
    save_picture(stack(pages), out)
    return len(pages)


def models_with_weights(name: str, models: tuple[str, ...]) -> tuple[tuple[str, ...], str]:
    """Return those of a figure's models that have weights here, and a note on the others: how to make them.

    Raises:
        InputError: none has.
    """
    missing = missing_weights(*models)
    if not missing:
        return models, ""
    if len(missing) == len(models):
        check_weights(*missing)
    return (
        tuple(model for model in models if model not in missing),
        f"{name}: leaves out models whose weights are not here; make {how_to_make(missing)}",
    )


def comparison_rows(models: tuple[str, ...], count: int, data: Path | None, *, kind: str) -> Iterator[list[Tile]]:
    """Make one row per pair of human-npt: identity, driving, a result of each model, truth."""
    for i in range(count):
        yield _pair_row(HUMAN_NPT.pair("test", kind, i), models)


def vertex_order_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make rows of one pair with another vertex order in each row, coloured by vertex index (NPT Fig. 8, 15)."""
    pair = HUMAN_NPT.unshuffled_pair("test", "unseen", 0, HUMAN_NPT.rng("test", "unseen", 0))
    for i in range(count):
        ordered = pair.shuffled(np.random.default_rng(i)) if i else pair
        tiles = _pair_row(ordered, models)[:-1]  # without the truth
        yield [tile._replace(colors=vertex_index_colors(len(tile.mesh.vertices))) for tile in tiles if tile.mesh]


def noise_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make rows of one pair with 1 % more noise on the driving vertices in each row (NPT Fig. 12, 16)."""
    for percent in range(min(count, 6)):
        # The same generator state in every row: the noise grows but keeps its pattern.
        rng = NOISE.rng("test", "noise-0", 0)
        pair = NOISE.unshuffled_pair("test", "noise-0", 0, rng)
        identity, driving, *others = _pair_row(NOISE.noisy_pair(pair, percent / 100, rng), models)
        yield [identity, driving._replace(label=f"driving, noise {percent} %"), *others]


def foreign_identity_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make rows of identities from a folder in seen poses of the shipped body (NPT Fig. 10, 17, 18)."""
    for i, path in enumerate(mesh_files(data)[:count]):
        driving = HUMAN_NPT.pair("test", "seen", i).driving
        identity = load_mesh(path)
        for model in models:
            result = transfer(identity, driving, model, hints=Hints(driving_up="+y", driving_front="+z"))
            yield [Tile(path.stem, identity), Tile("driving", driving), Tile(model, result.mesh)]


def foreign_driving_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make rows of driving meshes from a folder, applied to people of the shipped body (NPT Fig. 11)."""
    for i, path in enumerate(mesh_files(data)[:count]):
        identity = HUMAN_NPT.pair("test", "seen", i).identity
        driving = load_mesh(path)
        results = [Tile(m, transfer(identity, driving, m, hints=Hints(up="+y", front="+z")).mesh) for m in models]
        yield [Tile("identity", identity), Tile(path.stem, driving), *results]


def vertex_index_colors(count: int) -> Float[np.ndarray, "V 3"]:
    """Return a rainbow over vertex indices, linear RGB in 0..1."""
    return np.array([colorsys.hsv_to_rgb(0.8 * k / count, 0.65, 0.85) for k in range(count)])


def influence_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make rows of one person with other shapes, in other poses, in other vertex orders; no results (NPT Fig. 3)."""
    body, seed = human(), HUMAN_NPT.seed("test")
    shapes = [sample_shape(body, seed, i, HUMAN_NPT.spread) for i in range(4)]
    poses = [np.zeros_like(sample_pose(body, seed, 0)), *(sample_pose(body, seed, i) for i in range(3))]
    for name in ("shape", "pose", "vertex order")[:count]:
        tiles = []
        for k in range(4):
            shape, pose = shapes[k if name == "shape" else 0], poses[k if name == "pose" else 0]
            mesh, colors = Mesh(body.posed(shape, rotvec_to_rotmat(pose)), body.faces), None
            if name == "vertex order":
                order = np.random.default_rng(k).permutation(len(mesh.vertices))
                mesh = permute_vertices(mesh, order) if k else mesh
                colors = vertex_index_colors(len(mesh.vertices))
            tiles.append(Tile(f"{name} {k + 1}", mesh, colors))
        yield tiles


def one_clip_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make a row of a driving clip, then rows of other identities that get its motion (AniFormer Fig. 1).

    The identities are the targets whose shapes are the furthest from the driving person's.
    """
    protocol, body = CLIPS_ORDERED, human()
    shape = sample_shape(body, protocol.seed("train"), 0, protocol.spread)
    driving, motion = Person(body, shape, str(protocol.targets)), protocol.motion("test", "unseen", 0)
    targets = sorted(
        (protocol.target("test", i) for i in range(protocol.targets)),
        key=lambda target: -float(np.linalg.norm(target[0].shape - shape)),
    )
    for i, (identity, rest) in enumerate(targets[:count]):
        rows = [*_clip_rows(make_clip_pair(identity, driving, rest, motion), models)][:-1]  # without the truth
        yield from rows if i == 0 else rows[1:]


def clip_comparison_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make the rows of clips in one vertex order: driving, a result of each model, truth (AniFormer Fig. 3, 4)."""
    for i in range(count):
        yield from _clip_rows(CLIPS_ORDERED.pair("test", "unseen", i), models)


def clip_noise_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make rows of one clip with 1 % more noise in each group of rows (AniFormer Fig. 5, last row).

    The noise is independent in every frame.
    """
    for percent in range(min(count, 6)):
        trial = CLIPS_ORDERED.pair("test", "unseen", 0)
        rng = CLIPS_ORDERED.rng("test", "unseen", 0)
        frames = np.stack([with_noise(frame, percent / 100, rng) for frame in trial.clip.vertices])
        mesh = Mesh(frames[0], trial.driving.faces)
        noisy = dataclasses.replace(trial, driving=mesh, clip=Clip(mesh, frames, trial.clip.fps))
        yield from [*_clip_rows(noisy, models, f"noise {percent} %")][:-1]  # without the row of the truth


def foreign_clip_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make rows of identities from a folder, driven by clips of the shipped body (AniFormer Fig. 5)."""
    for i, path in enumerate(mesh_files(data)[:count]):
        trial = CLIPS_ANIFORMER.pair("test", "procedural", i)
        assert isinstance(trial, ClipPair)
        clip = trial.clip
        yield [EMPTY, *_frame_tiles("driving", clip.vertices, clip.mesh.faces)]
        identity = load_mesh(path)
        for model in models:
            result = animate(identity, clip, model, hints=Hints(driving_up="+y", driving_front="+z")).clip
            frames = [(t, result.mesh.with_vertices(result.vertices[t])) for t in SHOWN_FRAMES]
            yield [Tile(path.stem, identity), *(Tile(f"{model}, frame {t}", mesh) for t, mesh in frames)]


def animal_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make one row for each of some gaits: a horse in the pose of a camel (NPT Fig. 14)."""
    for i in range(count):
        pair = species_clip("horse", "camel", ANIMAL_GAITS[i % len(ANIMAL_GAITS)], i).frame(0)
        identity, driving, *others = _pair_row(pair, models)
        yield [identity._replace(label="horse"), driving._replace(label=pair.driving.name), *others]


def animal_clip_rows(models: tuple[str, ...], count: int, data: Path | None) -> Iterator[list[Tile]]:
    """Make the rows of clips: a lion with gaits of a horse (AniFormer Fig. 5, row 3)."""
    for i in range(count):
        trial = species_clip("lion", "horse", ANIMAL_GAITS[i % len(ANIMAL_GAITS)], i)
        yield from _clip_rows(trial, models, trial.driving.name)


seen_rows, unseen_rows = (partial(comparison_rows, kind=kind) for kind in ("seen", "unseen"))
SPARSE_DT = ("deformation-transfer-5", "deformation-transfer-13")
FIGURES = {
    "npt-3": Figure("shape, pose and vertex order", influence_rows, (), 3),
    "npt-6": Figure("seen poses, beside deformation transfer", seen_rows, (*SPARSE_DT, "npt-full"), 4),
    "npt-7": Figure("unseen poses, beside deformation transfer", unseen_rows, (*SPARSE_DT, "npt-full"), 4),
    "npt-8": Figure("vertex order as colour", vertex_order_rows, ("npt-full",), 2),
    "npt-9": Figure("ablations", unseen_rows, NPT_ABLATIONS, 3),
    "npt-10": Figure("identities from other makers", foreign_identity_rows, ("npt-full",), 3, needs_people=True),
    "npt-11": Figure("poses from other makers", foreign_driving_rows, ("npt-full",), 3, needs_people=True),
    "npt-12": Figure("noise, beside deformation transfer", noise_rows, ("deformation-transfer-13", "npt-full"), 4),
    "npt-13": Figure("other baselines", unseen_rows, ("skeleton", "npt-maxpool", "npt-full"), 4),
    "npt-14": Figure("a horse in poses of a camel", animal_rows, ("npt-maxpool-quadruped", "npt-quadruped"), 3),
    "npt-15": Figure("more vertex orders", vertex_order_rows, ("npt-full",), 5),
    "npt-16": Figure("more noise", noise_rows, ("npt-full",), 6),
    "npt-17": Figure("more identities from other makers", foreign_identity_rows, ("npt-full",), 12, needs_people=True),
    "npt-19": Figure("more seen poses", seen_rows, ("npt-full",), 8),
    "npt-20": Figure("more unseen poses", unseen_rows, ("npt-full",), 8),
    "aniformer-1": Figure("one clip, several identities", one_clip_rows, ("aniformer-ordered-mixed",), 2),
    "aniformer-3": Figure(
        "unseen motions, beside methods that go frame by frame",
        clip_comparison_rows,
        ("npt-ordered-mixed", "limp", "aniformer-ordered-mixed"),
        1,
    ),
    "aniformer-4": Figure("ablations in motion", clip_comparison_rows, ANIFORMER_ABLATIONS, 1),
    "aniformer-5": Figure(
        "identities from other makers in motion", foreign_clip_rows, ("aniformer",), 3, needs_people=True
    ),
    "aniformer-animals": Figure("a lion with a horse's gaits", animal_clip_rows, ("aniformer-quadruped",), 1),
    "aniformer-noise": Figure("noise on the driving clip", clip_noise_rows, ("aniformer-ordered-mixed",), 3),
}
"""Name -> figure. NPT's figure 18 (a registered data set) is missing, because there are no data for it here; 17 takes
any folder of people. Rows 3 (animals) and 4 (noise) of AniFormer's figure 5 are separate figures. Networks are those of
the papers' width; identities of other makers have another vertex order than the clips, so that they are moved by the
shipped `aniformer`, which pairs vertices at random. Animals are of the shipped quadruped, in place of the papers' data
sets."""


def draw_row(tiles: list[Tile]) -> Image.Image:
    """Render a row of tiles side by side, with captions."""
    from PIL import Image

    from ..view.camera import fit
    from ..view.raster import render, render_mesh
    from ..view.sheet import captioned, page

    pictures = []
    for tile in tiles:
        if tile.mesh is None:
            pictures.append(None)
            continue
        camera = fit(tile.mesh.vertices, TILE, "three-quarter")
        if tile.colors is None:
            picture = render_mesh(tile.mesh, TILE, camera)
        else:
            picture = render(tile.mesh.vertices, tile.mesh.faces, camera, TILE, tile.colors)
        pictures.append(captioned(picture, tile.label))
    example = next(picture for picture in pictures if picture is not None)
    empty = Image.new(example.mode, example.size, example.getpixel((0, 0)))
    return page([picture or empty for picture in pictures], len(pictures))


def mesh_files(data: Path | None) -> list[Path]:
    """List the mesh files of a folder and of those in it, sorted by name.

    Raises:
        InputError: no folder given, or one without meshes.
    """
    suffixes = (*SUFFIXES, ".obj", ".ply")
    if data is None or not data.is_dir():
        found = "none" if data is None else data
        raise InputError(f"--data: expected a folder of people in {', '.join(suffixes)} files, found {found}; give one")
    paths = sorted(path for path in data.rglob("*") if path.suffix.lower() in suffixes)
    if not paths:
        raise InputError(f"{data}: expected meshes of people, found none; give another folder with --data")
    return paths


def _pair_row(pair: Pair, models: tuple[str, ...]) -> list[Tile]:
    identity, faces = pair.identity, pair.identity.faces
    results = [Tile(model, Mesh(run_on_pair(pair, model).vertices, faces)) for model in models]
    return [Tile("identity", identity), Tile("driving", pair.driving), *results, Tile("truth", Mesh(pair.truth, faces))]


def _clip_rows(trial: ClipPair, models: tuple[str, ...], driving: str = "driving") -> Iterator[list[Tile]]:
    """Make the rows of a clip, frame below frame: driving, a result of each model beside the identity, truth."""
    yield [EMPTY, *_frame_tiles(driving, trial.clip.vertices, trial.driving.faces)]
    for model in models:
        supported = on_supported_vertices(trial, model)
        faces_of_model = supported.identity.faces
        frames = [run_on_clip(_window(supported, int(t)), model).vertices[1] for t in SHOWN_FRAMES]
        tiles = [
            Tile(f"{model}, frame {t}", Mesh(frame.astype(np.float64), faces_of_model))
            for t, frame in zip(SHOWN_FRAMES, frames, strict=True)
        ]
        yield [Tile("identity", supported.identity), *tiles]
    yield [EMPTY, *_frame_tiles("truth", trial.truth_frames, trial.identity.faces)]


def _window(trial: ClipPair, t: int) -> ClipPair:
    """Return frames t - 1 to t + 1: of networks of full width all others would take minutes, and are not drawn."""
    kept = slice(t - 1, t + 2)
    clip = dataclasses.replace(trial.clip, vertices=trial.clip.vertices[kept])
    aligned = None if trial.aligned_frames is None else trial.aligned_frames[kept]
    return dataclasses.replace(trial, clip=clip, truth_frames=trial.truth_frames[kept], aligned_frames=aligned)


def _frame_tiles(label: str, frames: Float[np.ndarray, "T V 3"], faces: Int[np.ndarray, "F 3"]) -> list[Tile]:
    return [Tile(f"{label}, frame {t}", Mesh(frames[t].astype(np.float64), faces)) for t in SHOWN_FRAMES]


def species_clip(identity: str, driving: str, gait: str, number: int = 0) -> ClipPair:
    """Make a trial: an animal of a species, which stands, and one of another in a gait; vertices are shuffled.

    Args:
        identity: a species of `bodies.animals.ANIMALS`.
        driving: another one.
        gait: a key of `motions.gaits.GAITS`.
        number: chooses among random gaits of that kind, which no network is trained on.
    """
    body = quadruped()
    pose = rotmat_to_rotvec(gait_rotations(body, gait, SEEDS["test"], number, FRAMES / FPS, FPS)) + posture(
        body, driving
    )
    rotmat = rotvec_to_rotmat(pose)
    motion = Motion(gait, body.joint_names, rotmat, planted(body, rotmat), FPS)
    target, actor = (Person(body, np.array(ANIMALS[name].shape), name) for name in (identity, driving))
    trial = make_clip_pair(target, actor, Pose(rotvec_to_rotmat(posture(body, identity)), "standing"), motion)
    mesh = dataclasses.replace(trial.driving, name=f"{driving}, {gait}")
    trial = dataclasses.replace(trial, driving=mesh, clip=Clip(mesh, trial.clip.vertices, FPS))
    return trial.shuffled(np.random.default_rng(number))
