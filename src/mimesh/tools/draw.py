"""Draw files as pictures, movies and pages: `mimesh render`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import InputError
from ..core.frame_buffer import Progress, counted
from ..core.mesh import Clip, cut_clip
from ..core.options import FrameRange, RenderOptions
from ..io import check_writable, load_clip
from ..io.formats import PICTURES
from ..view import heat, movie, sheet
from ..view.movie import MOVIES
from ..view.pack import Panel
from ..view.page import write_player
from ..view.shading import BACKGROUND
from .preview import save_picture

if TYPE_CHECKING:
    from PIL import Image

PAGE = ".html"
NOT_FOR_PAGES = ("view", "size", "width", "clay", "labels", "background")
"""Options of pictures and movies that pages have not: on a page the viewer chooses them."""
ALL_FRAMES = FrameRange()
TURN, TURN_RATE = 60, 20.0
"""Frames of a full turn, and frames a second."""
BACKGROUNDS = {"paper": BACKGROUND, "white": (1.0, 1.0, 1.0), "dark": (0.12, 0.125, 0.135), "none": None}


def kind_of(options: RenderOptions, output: Path, clips: Sequence[Clip]) -> str:
    """Return what to draw: contact sheet, strip, heat map, movie, turning movie, heat movie or page."""
    if output.suffix.lower() == PAGE:
        return "page"
    moving = any(len(clip) > 1 for clip in clips)
    if output.suffix.lower() in MOVIES:
        kinds = {"--turntable": "turning movie", "--truth": "heat movie"}
        default = "movie" if moving else "turning movie"
    else:
        kinds = {"--sheet": "contact sheet", "--strip": "strip", "--truth": "heat map"}
        default = "strip" if moving else "contact sheet"
    return next((kinds[flag] for flag in _flags(options)), default)


def check_options(options: RenderOptions, output: Path) -> None:
    """Check that the suffix can be drawn and that no options exclude each other or the suffix."""
    suffix, kinds = output.suffix.lower(), _flags(options)
    if suffix not in (*PICTURES, *MOVIES, PAGE):
        known = ".png, .jpg, .webp, .gif, .mp4 or .html"
        raise InputError(f"{output}: expected {known}, found '{suffix}'; rename it")
    check_writable(output)
    if len(kinds) > 1:
        raise InputError(f"render: expected one kind of picture, found {' and '.join(kinds)}; choose one")
    if options.track and (suffix not in MOVIES or options.turntable):
        found = f"'{suffix}'" if suffix not in MOVIES else "--turntable"
        raise InputError(f"{output}: expected a movie of a clip with --track, found {found}; leave it out")
    if options.turntable and suffix not in MOVIES:
        raise InputError(
            f"{output}: expected a movie ({' '.join(MOVIES)}) for --turntable, found '{suffix}'; rename it"
        )
    if (options.sheet or options.strip) and suffix not in PICTURES:
        raise InputError(f"{output}: expected a picture (.png or .jpg) for {kinds[0]}, found '{suffix}'; rename it")
    if suffix == PAGE:
        for field in dataclasses.fields(options):
            if field.name in NOT_FOR_PAGES and getattr(options, field.name) != field.default:
                option = "--no-labels" if field.name == "labels" else f"--{field.name}"
                raise InputError(f"{output}: expected no {option} with a page, found it; leave it out")
    elif background_of(options.background) is None and suffix != ".png":
        raise InputError(f"{output}: expected a .png for --background none, found '{suffix}'; rename it")


def _flags(options: RenderOptions) -> list[str]:
    flags = {"--sheet": options.sheet, "--strip": options.strip, "--turntable": options.turntable}
    flags["--truth"] = options.truth is not None
    return [name for name, on in flags.items() if on]


def _look(options: RenderOptions) -> dict[str, Any]:
    look = {name: getattr(options, name) for name in ("view", "up", "front", "labels")}
    return {**look, "background": background_of(options.background)}


def background_of(name: str) -> sheet.Color:
    """Return the sRGB colour (0..1) of a name in BACKGROUNDS or of #rrggbb; None for "none"."""
    if name in BACKGROUNDS:
        return BACKGROUNDS[name]
    digits = name.removeprefix("#")
    if len(digits) != 6 or not set(digits.lower()) <= set("0123456789abcdef"):
        raise InputError(f"--background: expected {', '.join(BACKGROUNDS)} or #rrggbb, found {name}; name one of them")
    red, green, blue = (int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4))
    return red, green, blue


def draw(
    options: RenderOptions,
    names: Sequence[str],
    clips: Sequence[Clip],
    output: Path,
    cut: FrameRange = ALL_FRAMES,
    progress: Progress | None = None,
) -> str:
    """Write a picture, movie or page of clips (a mesh is a clip of one frame), and return its kind.

    `cut` are the frames of their files that the clips have: those of a truth that moves are chosen alike.
    """
    check_options(options, output)
    kind = kind_of(options, output, clips)
    if kind == "page":
        _write_page(options, names, clips, output, cut)
    elif kind in ("movie", "turning movie", "heat movie"):
        frames, count, rate = _movie(kind, options, names, clips, cut)
        movie.save_movie(counted(frames, count, progress), output, rate)
    else:
        save_picture(_picture(kind, options, names, clips, cut), output)
    return kind


def _write_page(
    options: RenderOptions, names: Sequence[str], clips: Sequence[Clip], output: Path, cut: FrameRange
) -> None:
    """Write a page that plays the files side by side; with a truth it shows the errors of the last one."""
    up, front = options.up, options.front
    panels = [Panel("mesh", clip, name, up, front) for name, clip in zip(names, clips, strict=True)]
    if options.truth is not None:
        truth = _truth(options.truth, cut, clips[-1].fps * cut.step)
        counts = len(clips[-1].mesh.vertices), len(truth.mesh.vertices)
        if counts[0] != counts[1]:
            raise InputError(
                f"{options.truth}: expected the truth to have {counts[0]} vertices, found {counts[1]}; "
                "give one of the same mesh"
            )
        panels[-1] = Panel("result", clips[-1], names[-1], up, front)
        panels.append(Panel("truth", truth, options.truth.name, up, front))
    write_player(output, panels, title=output.stem)


def _movie(kind, options, names, clips, cut) -> tuple[Iterator[Image.Image], int, float]:
    if kind == "turning movie":
        look = {name: value for name, value in _look(options).items() if name != "labels"}
        mesh = _first_frame(_single(names, clips))
        return movie.turntable_frames(mesh, TURN, options.tile(1.0), clay=options.clay, **look), TURN, TURN_RATE
    rate = clips[0].fps
    if kind == "heat movie":
        clip = _single(names, clips)
        return _heat(options, clip, cut), len(clip), rate
    labels = names if len(clips) > 1 else [""]
    named = list(zip(labels, clips, strict=True))
    frames = movie.clip_frames(named, options.tile(1.0), clay=options.clay, track=options.track, **_look(options))
    return frames, max(round(clip.seconds * rate) for clip in clips), rate


def _picture(kind, options, names, clips, cut) -> Image.Image:
    look = {**_look(options), "clay": options.clay}
    if kind == "strip":
        return sheet.stack([sheet.strip(clip, 8, options.tile(0.75), **look) for clip in clips])
    if kind == "heat map":
        return next(_heat(options, _single(names, clips), cut))
    items = [(name, _first_frame(clip)) for name, clip in zip(names, clips, strict=True)]
    return sheet.contact_sheet(items, tile=options.tile(5 / 6), **look)


def _heat(options: RenderOptions, clip: Clip, cut: FrameRange) -> Iterator[Image.Image]:
    assert options.truth is not None
    truth = _truth(options.truth, cut)
    frames = np.asarray(truth.vertices if len(truth) > 1 else truth.mesh.vertices[None])
    return heat.heat_frames(clip, frames, options.tile(5 / 6), track=options.track, **_look(options))


def _truth(path: Path, cut: FrameRange, fps: float | None = None) -> Clip:
    """Load the truth and cut it as the clips are; a truth of one frame is used for all frames."""
    truth = load_clip(path, fps=fps)
    return cut_clip(truth, cut.start, cut.stop, cut.step) if len(truth) > 1 else truth


def _first_frame(clip: Clip):
    return clip.mesh if len(clip) == 1 else clip.mesh.with_vertices(clip.vertices[0].astype(np.float64))


def _single(names: Sequence[str], clips: Sequence[Clip]) -> Clip:
    if len(clips) != 1:
        raise InputError(f"render: expected one file for this picture, found {len(names)}; draw them one by one")
    return clips[0]
