"""`mimesh look` and `mimesh render`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .terminal import Animation, BlendShapes, Json, Quiet, print_json, print_next, progress, refuse_inputs

if TYPE_CHECKING:
    from ..core.mesh import Clip

Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Meshes, clips or folders of numbered meshes.")]


def look(files: Files, json: Json = False) -> None:
    """Tell what mesh files hold and what may spoil a transfer."""
    from ..core.errors import InputError
    from ..tools.inspect import inspect_file as examine

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
        Path, typer.Option("--output", "-o", help="A picture (.png .jpg), a movie (.webp .gif .mp4) or a page (.html).")
    ],
    sheet: Annotated[bool, typer.Option("--sheet", help="Each file once, in rows.")] = False,
    strip: Annotated[bool, typer.Option("--strip", help="Frames of each clip side by side.")] = False,
    turntable: Annotated[bool, typer.Option("--turntable", help="One mesh from all sides.")] = False,
    truth: Annotated[
        Path | None, typer.Option(help="Heat map of the distance to this mesh or clip, in mm if files are in metres.")
    ] = None,
    stretch: Annotated[
        Path | None, typer.Option(metavar="REFERENCE", help="Heat map of how edges differ in length from this mesh's.")
    ] = None,
    animation: Animation = None,
    start: Annotated[int, typer.Option(help="First frame to take, counted from 0.")] = 0,
    stop: Annotated[int | None, typer.Option(help="Frame to stop before.")] = None,
    step: Annotated[int, typer.Option(help="Take every so many frames.")] = 1,
    track: Annotated[bool, typer.Option("--track", help="In movies, the camera goes along.")] = False,
    view: Annotated[str, typer.Option(help="three-quarter, front, side, left, right, back or top.")] = "three-quarter",
    size: Annotated[int, typer.Option(help="Height of one picture in pixels.", min=32, max=4096)] = 480,
    width: Annotated[int | None, typer.Option(help="Width of one picture in pixels.", min=32, max=4096)] = None,
    background: Annotated[str, typer.Option(help="paper, white, dark, none (.png) or #rrggbb.")] = "paper",
    labels: Annotated[bool, typer.Option("--labels/--no-labels", help="Captions below pictures.")] = True,
    clay: Annotated[bool, typer.Option("--clay", help="Leave materials and textures out.")] = False,
    up: Annotated[str, typer.Option(help="Axis away from the floor: x, y, z, -x, -y, -z.")] = "y",
    front: Annotated[str | None, typer.Option(help="Axis that faces the front.")] = None,
    fps: Annotated[float | None, typer.Option(help="Frame rate, where the files do not say.")] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draw meshes and clips: sheet, strip, turntable, heat map, movie or a page to play with.

    By default meshes become a sheet, or a movie that turns; clips become strips, or a movie that plays.
    """
    from ..tools.draw import RenderOptions, draw

    wanted = RenderOptions(
        *(sheet, strip, turntable, truth, stretch, view, size, width, clay, up, front, track, labels, background),
        cut=(start, stop, step),
    )
    wanted.check(output)
    refuse_inputs(output, *files, truth, stretch)
    clips = _cut(files, fps, animation, start, stop, step)
    names = [path.name for path in files]
    with progress("frames", quiet or json) as advance:
        kind = draw(wanted, names, clips, output, advance)
    if json:
        print_json({"output": str(output), "kind": kind, "files": [str(path) for path in files]})
    elif not quiet:
        print(f"{output}: {kind} of {', '.join(names)}")
        print_next("look", *files)


def _cut(
    files: list[Path], fps: float | None, animation: str | None, start: int, stop: int | None, step: int
) -> list[Clip]:
    """The clips, each cut alike; a file of one mesh stays whole beside one that moves."""
    from ..core.mesh import cut_clip
    from ..io import load_clip

    clips = [load_clip(path, fps, animation) for path in files]
    alone = all(len(clip) == 1 for clip in clips)
    return [cut_clip(clip, start, stop, step) if len(clip) > 1 or alone else clip for clip in clips]


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A mesh, a clip, a motion or a folder of meshes.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Its suffix is the format; without one, a folder.")],
    fps: Annotated[float | None, typer.Option(help="Of IN, where it does not say; else to sample it at.")] = None,
    animation: Animation = None,
    frame: Annotated[int | None, typer.Option(help="This frame alone, counted from 0.")] = None,
    start: Annotated[int, typer.Option(help="First frame to take, counted from 0.")] = 0,
    stop: Annotated[int | None, typer.Option(help="Frame to stop before.")] = None,
    step: Annotated[int, typer.Option(help="Take every so many frames.")] = 1,
    frames_as: Annotated[str | None, typer.Option(metavar="SUFFIX", help="In a folder: obj or ply.")] = None,
    blendshapes: BlendShapes = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a mesh or clip in another format.

    What moves stays moving where OUT can; .gif, .webp and .mp4 are pictures of it. Formats: see docs/formats.md.
    """
    from ..render.movie import MOVIES
    from ..tools.convert import convert as run
    from ..tools.convert import frames_at

    refuse_inputs(target, source)
    with progress("frames", quiet or json) as advance:
        done = run(
            source,
            target,
            fps=fps,
            animation=animation,
            frame=frame,
            start=start,
            stop=stop,
            step=step,
            frames_as=None if frames_as is None else "." + frames_as.lstrip("."),
            blendshapes=blendshapes,
            progress=advance,
        )
    facts = {"output": str(target), "vertices": done.vertices, "frames": done.frames, "fps": done.fps}
    if json:
        print_json({**facts, "notes": list(done.notes)})
    elif not quiet:
        length = "" if done.fps is None else f", {frames_at(done.frames, done.fps)}"
        print(f"{target}: {done.vertices} vertices{length}")
        print("".join(f"note: {note}\n" for note in done.notes), end="")
        if target.suffix.lower() not in MOVIES:
            print_next("look", target)
