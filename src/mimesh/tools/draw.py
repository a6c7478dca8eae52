"""What `mimesh render` does: which picture or movie suits the files, and how it is drawn."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.errors import InputError
from ..core.frame_buffer import Progress, counted
from ..core.mesh import Clip, cut_clip
from ..io import load_clip
from ..player.pack import Panel
from ..player.page import write_player
from ..render import heat, movie, sheet
from ..render.movie import MOVIES
from ..render.shading import BACKGROUND
from .preview import save_picture

if TYPE_CHECKING:
    from PIL import Image

PICTURES = (".png", ".jpg", ".jpeg")
PAGE = ".html"
FIXED = ("view", "size", "width", "clay", "labels", "background")
"""Options that pictures and movies have, and pages not: whoever looks at them chooses."""
TURN, TURN_RATE = 60, 20.0
"""Frames of a full turn, and how many of them there are in a second."""
PAPERS = {"paper": BACKGROUND, "white": (1.0, 1.0, 1.0), "dark": (0.12, 0.125, 0.135), "none": None}


@dataclass(frozen=True)
class RenderOptions:
    """The options of `mimesh render`."""

    sheet: bool = False
    strip: bool = False
    turntable: bool = False
    truth: Path | None = None
    stretch: Path | None = None
    view: str = "three-quarter"
    size: int = 480
    """Height of one picture in pixels."""
    width: int | None = None
    """Its width; None leaves it to the kind of picture."""
    clay: bool = False
    up: str = "y"
    front: str | None = None
    track: bool = False
    labels: bool = True
    background: str = "paper"
    cut: tuple[int, int | None, int] = (0, None, 1)
    """First frame, frame to stop before, and step: of a truth that moves, as the clips have been cut."""

    def kind(self, output: Path, clips: Sequence[Clip]) -> str:
        """What to draw: contact sheet, strip, turntable, heat map, movie, turning movie, heat movie or page."""
        if output.suffix.lower() == PAGE:
            return "page"
        moving = any(len(clip) > 1 for clip in clips)
        if output.suffix.lower() in MOVIES:
            kinds = {"--turntable": "turning movie", "--truth": "heat movie", "--stretch": "heat movie"}
            default = "movie" if moving else "turning movie"
        else:
            kinds = {"--sheet": "contact sheet", "--strip": "strip", "--turntable": "turntable"}
            kinds |= {"--truth": "heat map", "--stretch": "heat map"}
            default = "strip" if moving else "contact sheet"
        return next((kinds[flag] for flag in self._flags()), default)

    def check(self, output: Path) -> None:
        """Refuse a suffix that is not drawn, and options that exclude each other or the suffix.

        Raises:
            InputError: says which.
        """
        suffix, given = output.suffix.lower(), self._flags()
        if suffix not in (*PICTURES, *MOVIES, PAGE):
            known = ".png, .jpg, .webp, .gif, .mp4 or .html"
            raise InputError(f"{output}: expected {known}, found '{suffix}'; name another with -o")
        if len(given) > 1:
            raise InputError(f"render: expected one kind of picture, found {' and '.join(given)}; choose one")
        if self.track and (suffix not in MOVIES or self.turntable):
            found = f"'{suffix}'" if suffix not in MOVIES else "--turntable"
            raise InputError(f"{output}: expected a movie of a clip with --track, found {found}; leave it out")
        none = {PAGE: ("--sheet", "--strip", "--turntable", "--stretch")}.get(suffix, ("--sheet", "--strip"))
        if suffix not in PICTURES and given and given[0] in none:
            raise InputError(f"{output}: expected a picture (.png or .jpg) for {given[0]}, found '{suffix}'; rename it")
        if suffix == PAGE:
            self._check_page(output)
        elif background_of(self.background) is None and suffix != ".png":
            raise InputError(f"{output}: expected a .png for --background none, found '{suffix}'; rename it")

    def _check_page(self, output: Path) -> None:
        for field in dataclasses.fields(self):
            if field.name in FIXED and getattr(self, field.name) != field.default:
                option = "--no-labels" if field.name == "labels" else f"--{field.name}"
                raise InputError(f"{output}: expected no {option} with a page, found it; leave it out")

    def _flags(self) -> list[str]:
        """Kinds of picture that are asked for, by the name of their option."""
        flags = {"--sheet": self.sheet, "--strip": self.strip, "--turntable": self.turntable}
        flags |= {"--truth": self.truth is not None, "--stretch": self.stretch is not None}
        return [name for name, on in flags.items() if on]

    @property
    def look(self) -> dict:
        """What every kind of picture is told."""
        return {
            "view": self.view,
            "up": self.up,
            "front": self.front,
            "labels": self.labels,
            "background": background_of(self.background),
        }

    def tile(self, aspect: float) -> tuple[int, int]:
        """Width and height of one picture that would have this ratio of them."""
        return self.width or round(self.size * aspect), self.size


def background_of(name: str) -> sheet.Color:
    """sRGB in 0..1 of a name in PAPERS or of #rrggbb; None for none.

    Raises:
        InputError: neither.
    """
    if name in PAPERS:
        return PAPERS[name]
    digits = name.removeprefix("#")
    if len(digits) != 6 or not set(digits.lower()) <= set("0123456789abcdef"):
        raise InputError(f"--background: expected {', '.join(PAPERS)} or #rrggbb, found {name}; name one of them")
    red, green, blue = (int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4))
    return red, green, blue


def draw(
    wanted: RenderOptions, names: Sequence[str], clips: Sequence[Clip], output: Path, progress: Progress | None = None
) -> str:
    """Write a picture, movie or page of clips (a mesh is one of one frame), and return what kind it is.

    Raises:
        InputError: as `Wanted.check`, several files where one is drawn, or a place that cannot be written to.
    """
    wanted.check(output)
    kind = wanted.kind(output, clips)
    if kind == "page":
        _write_page(wanted, names, clips, output)
    elif kind in ("movie", "turning movie", "heat movie"):
        frames, count, rate = _movie(kind, wanted, names, clips)
        movie.save_movie(counted(frames, count, progress), output, rate)
    else:
        save_picture(_picture(kind, wanted, names, clips), output)
    return kind


def _write_page(wanted: RenderOptions, names: Sequence[str], clips: Sequence[Clip], output: Path) -> None:
    """A page that plays the files side by side; with a truth, the last of them is measured against it."""
    up, front = wanted.up, wanted.front
    shown = [Panel("mesh", clip, name, up, front) for name, clip in zip(names, clips, strict=True)]
    if wanted.truth is not None:
        truth = _truth(wanted, wanted.truth, clips[-1].fps * wanted.cut[2])
        counts = len(clips[-1].mesh.vertices), len(truth.mesh.vertices)
        if counts[0] != counts[1]:
            raise InputError(
                f"{wanted.truth}: expected the truth to have {counts[0]} vertices, found {counts[1]}; "
                "give one of the same mesh"
            )
        shown[-1] = Panel("result", clips[-1], names[-1], up, front)
        shown.append(Panel("truth", truth, wanted.truth.name, up, front))
    write_player(output, shown, title=output.stem)


def _movie(kind, wanted, names, clips) -> tuple[Iterator[Image.Image], int, float]:
    """Pictures, how many there are, and how many of them make a second."""
    if kind == "turning movie":
        options = {name: value for name, value in wanted.look.items() if name != "labels"}
        mesh = _first_frame(_only(names, clips))
        return movie.turntable_frames(mesh, TURN, wanted.tile(1.0), clay=wanted.clay, **options), TURN, TURN_RATE
    rate = clips[0].fps
    if kind == "heat movie":
        clip = _only(names, clips)
        return _heat(wanted, clip), len(clip), rate
    labels = names if len(clips) > 1 else [""]
    named = list(zip(labels, clips, strict=True))
    frames = movie.clip_frames(named, wanted.tile(1.0), clay=wanted.clay, track=wanted.track, **wanted.look)
    return frames, max(round(clip.seconds * rate) for clip in clips), rate


def _picture(kind, wanted, names, clips) -> Image.Image:
    options = {**wanted.look, "clay": wanted.clay}
    if kind == "strip":
        return sheet.stack([sheet.strip(clip, 8, wanted.tile(0.75), **options) for clip in clips])
    if kind == "turntable":
        return sheet.turntable(_first_frame(_only(names, clips)), 8, wanted.tile(1.0), **options)
    if kind == "heat map":
        return next(_heat(wanted, _only(names, clips)))
    items = [(name, _first_frame(clip)) for name, clip in zip(names, clips, strict=True)]
    return sheet.contact_sheet(items, tile=wanted.tile(5 / 6), **options)


def _heat(wanted: RenderOptions, clip: Clip) -> Iterator[Image.Image]:
    if wanted.truth is not None:
        truth = _truth(wanted, wanted.truth)
        points = truth.vertices if len(truth) > 1 else truth.mesh.vertices
        measure, unit = heat.distance_to(clip, np.asarray(points)), "mm"
    else:
        assert wanted.stretch is not None
        measure, unit = heat.stretch_of(clip, load_clip(wanted.stretch).mesh.vertices), "%"
    return heat.heat_frames(clip, measure, unit, wanted.tile(5 / 6), track=wanted.track, **wanted.look)


def _truth(wanted: RenderOptions, path: Path, fps: float | None = None) -> Clip:
    """The truth, cut as the clips are; a truth of one frame is that of all."""
    truth = load_clip(path, fps=fps)
    return cut_clip(truth, *wanted.cut) if len(truth) > 1 else truth


def _first_frame(clip: Clip):
    """The mesh at rest where nothing moves, else as it stands in the first frame."""
    return clip.mesh if len(clip) == 1 else clip.mesh.with_vertices(clip.vertices[0].astype(np.float64))


def _only(names: Sequence[str], clips: Sequence[Clip]) -> Clip:
    if len(clips) != 1:
        raise InputError(f"render: expected one file for this picture, found {len(names)}; draw them one by one")
    return clips[0]
