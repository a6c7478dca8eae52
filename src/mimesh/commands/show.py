"""`mimesh look` and `mimesh render`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .terminal import Json, Quiet, print_json, print_next, progress, refuse_inputs

if TYPE_CHECKING:
    from ..mesh import Clip

Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Meshes, clips or folders of numbered meshes.")]


def look(files: Files, json: Json = False) -> None:
    """Tell what mesh files hold and what may spoil a transfer."""
    from ..look import look as examine
    from ..mesh import InputError

    facts, errors = {}, []
    for path in files:
        try:
            facts[path] = examine(path)
        except InputError as error:
            errors.append(error)
    if json:
        if errors:
            raise errors[0]
        print_json({"files": [fact.as_dict() for fact in facts.values()]})
        return
    for fact in facts.values():
        print(fact.text(), end="\n\n" if len(files) > 1 else "\n")
    for error in errors[:-1]:
        print(f"mimesh: {error}", file=sys.stderr)
    if errors:
        raise errors[-1]
    print_next("render", *files, "-o", "sheet.png")


def render(
    files: Files,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="A picture (.png .jpg), movie (.webp .gif) or page (.html).")
    ],
    strip: Annotated[bool, typer.Option("--strip", help="Frames of each clip side by side.")] = False,
    turntable: Annotated[bool, typer.Option("--turntable", help="One mesh from all sides.")] = False,
    truth: Annotated[
        Path | None, typer.Option(help="Heat map of the distance to this mesh; a page takes a clip too.")
    ] = None,
    view: Annotated[str, typer.Option(help="three-quarter, front, side, left, right, back or top.")] = "three-quarter",
    size: Annotated[int, typer.Option(help="Height of one picture in pixels.", min=32, max=4096)] = 480,
    clay: Annotated[bool, typer.Option("--clay", help="Leave materials and textures out.")] = False,
    up: Annotated[str, typer.Option(help="Axis away from the floor: x, y, z, -x, -y, -z.")] = "y",
    front: Annotated[str | None, typer.Option(help="Axis that faces the front.")] = None,
    fps: Annotated[float | None, typer.Option(help="Frame rate, where the files do not say.")] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draw meshes: sheet, strip, turntable, heat map or movie."""
    from ..io import load_clip

    page = output.suffix.lower() == ".html"
    mode = "page" if page else _mode(output, strip, turntable, truth)
    refuse_inputs(output, *files, *([truth] if truth else []))
    clips = [load_clip(path, fps=fps) for path in files]
    names = [path.name for path in files]
    look_from = {"view": view, "up": up, "front": front}
    if page:
        _write_page(names, clips, truth, output, up, front)
    elif mode in ("movie", "turning movie"):
        with progress("frames", quiet or json) as advance:
            _draw_movie(mode, names, clips, output, size, {**look_from, "clay": clay}, advance)
    else:
        from ..preview import save_picture

        save_picture(_draw_picture(mode, names, clips, truth, size, look_from, clay), output)
    if json:
        print_json({"output": str(output), "kind": mode, "files": [str(path) for path in files]})
    elif not quiet:
        print(f"{output}: {mode} of {', '.join(names)}")
        print_next("look", *files)


def _mode(output: Path, strip: bool, turntable: bool, truth: Path | None) -> str:
    """What to draw, from the suffix and the flags.

    Raises:
        InputError: a suffix that is not drawn, or flags that exclude each other.
    """
    from ..mesh import InputError

    wanted = [name for name, on in (("strip", strip), ("turntable", turntable), ("heat map", truth is not None)) if on]
    suffix = output.suffix.lower()
    if suffix not in (".png", ".jpg", ".jpeg", ".webp", ".gif"):
        raise InputError(f"{output}: expected .png, .jpg, .webp, .gif or .html, found '{suffix}'; name another with -o")
    if len(wanted) > 1:
        raise InputError(
            f"render: expected one of --strip, --turntable, --truth, found {' and '.join(wanted)}; choose one"
        )
    if suffix in (".webp", ".gif"):
        if wanted in (["strip"], ["heat map"]):
            raise InputError(
                f"{output}: expected a picture (.png or .jpg) for a {wanted[0]}, found '{suffix}'; rename it"
            )
        return "turning movie" if turntable else "movie"
    return wanted[0] if wanted else "contact sheet"


def _draw_movie(
    mode: str, names: list[str], clips: list[Clip], output: Path, size: int, options: dict, advance
) -> None:
    from ..view.movie import clip_frames, save_movie, turntable_frames

    tile = (size, size)
    if mode == "turning movie":
        count, rate = 60, 20.0
        frames = turntable_frames(_only(names, clips).mesh, count, tile, **options)
    else:
        rate = clips[0].fps
        count = max(round(clip.seconds * rate) for clip in clips)
        labels = names if len(clips) > 1 else [""]
        frames = clip_frames(list(zip(labels, clips, strict=True)), tile, **options)
    save_movie(_counted(frames, count, advance), output, rate)


def _write_page(
    names: list[str], clips: list[Clip], truth: Path | None, output: Path, up: str, front: str | None
) -> None:
    """A page that plays the files side by side; with a truth, the last of them is measured against it."""
    from ..io import load_clip
    from ..view.player import write_player
    from ..view.scene import Shown

    shown = [Shown("mesh", clip, name, up, front) for name, clip in zip(names, clips, strict=True)]
    if truth is not None:
        last, right = clips[-1], load_clip(truth, fps=clips[-1].fps)
        _alike(last, right, truth)
        shown[-1] = Shown("result", last, names[-1], up, front)
        shown.append(Shown("truth", right, truth.name, up, front))
    write_player(output, shown, title=output.stem)


def _alike(clip: Clip, truth: Clip, path: Path) -> None:
    """Raise InputError where a truth has other vertices than the clip that it is the truth of."""
    from ..mesh import InputError

    wanted, found = len(clip.mesh.vertices), len(truth.mesh.vertices)
    if wanted != found:
        raise InputError(
            f"{path}: expected the truth to have {wanted} vertices, found {found}; give one of the same mesh"
        )


def _draw_picture(
    mode: str, names: list[str], clips: list[Clip], truth: Path | None, size: int, look_from: dict, clay: bool
):
    from ..view import sheet

    if mode == "strip":
        return sheet.stack([sheet.strip(clip, 8, (size * 3 // 4, size), **look_from) for clip in clips])
    if mode == "turntable":
        return sheet.turntable(_only(names, clips).mesh, 8, (size, size), clay=clay, **look_from)
    if mode == "heat map":
        from ..io import load_mesh

        assert truth is not None
        tile = (size, size * 6 // 5)
        return sheet.heat_map(_only(names, clips).mesh, load_mesh(truth), tile=tile, view=look_from["view"])
    items = [(name, clip.mesh) for name, clip in zip(names, clips, strict=True)]
    return sheet.contact_sheet(items, tile=(size * 5 // 6, size), clay=clay, **look_from)


def _only(names: list[str], clips: list[Clip]) -> Clip:
    from ..mesh import InputError

    if len(clips) != 1:
        raise InputError(f"render: expected one file for this picture, found {len(names)}; draw them one by one")
    return clips[0]


def _counted(frames, count: int, advance):
    for done, frame in enumerate(frames, 1):
        yield frame
        if advance is not None:
            advance(done, count)
