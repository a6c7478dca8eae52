"""The commands `mimesh look`, `mimesh render`, `mimesh convert` and `mimesh studio`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.printable import say
from .terminal import (
    Animation,
    BlendShapes,
    BodyModel,
    Json,
    Large,
    Model,
    NoClobber,
    NoLimits,
    Quiet,
    print_json,
    print_next,
    progress,
    refuse_existing,
    refuse_inputs,
    require,
    single,
)

if TYPE_CHECKING:
    from ..core.mesh import Clip

Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Meshes, clips or folders of numbered meshes.")]


def look(files: Files, no_limits: NoLimits = False, json: Json = False) -> None:
    """Show what mesh files contain, and problems that may spoil a transfer."""
    from ..core.errors import InputError
    from ..tools.inspect import inspect_file

    facts, errors = {}, []
    for path in files:
        try:
            facts[path] = inspect_file(path)
        except InputError as error:
            errors.append(error)
    if json:
        if errors:
            raise errors[0]
        print_json({"files": [fact.as_dict() for fact in facts.values()]})
        return
    for fact in facts.values():
        say(*fact.text().split("\n"), *([""] if len(files) > 1 else []))
    for error in errors[:-1]:
        say(f"mimesh: {error}", error=True)
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
    no_clobber: NoClobber = False,
    no_limits: NoLimits = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draw meshes and clips: sheet, strip, turntable, heat map, movie or a page to play with.

    By default meshes become a sheet, or a movie that turns; clips become strips, or a movie that plays.
    """
    from ..tools.draw import RenderOptions, draw

    options = RenderOptions(
        *(sheet, strip, turntable, truth, stretch, view, size, width, clay, up, front, track, labels, background),
        cut=(start, stop, step),
    )
    options.check(output)
    refuse_existing(no_clobber, output)
    refuse_inputs(output, *files, truth, stretch)
    clips = _cut(files, fps, single("--animation", animation), start, stop, step)
    names = [path.name for path in files]
    with progress("frames", quiet or json) as advance:
        kind = draw(options, names, clips, output, advance)
    if json:
        print_json({"output": str(output), "kind": kind, "files": [str(path) for path in files]})
    elif not quiet:
        say(f"{output}: {kind} of {', '.join(names)}")
        print_next("look", *files)


def _cut(
    files: list[Path], fps: float | None, animation: str | None, start: int, stop: int | None, step: int
) -> list[Clip]:
    """Load clips and cut all of them alike; a file of one mesh is not cut if another file moves."""
    from ..core.mesh import cut_clip
    from ..io import load_clip

    clips = [load_clip(path, fps=fps, animation=animation) for path in files]
    still = all(len(clip) == 1 for clip in clips)
    return [cut_clip(clip, start, stop, step) if len(clip) > 1 or still else clip for clip in clips]


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A mesh, a clip, a motion or a folder of meshes.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Its suffix is the format; without one, a folder.")],
    fps: Annotated[float | None, typer.Option(help="Of IN, where it does not say; else to sample it at.")] = None,
    animation: Animation = None,
    frame: Annotated[int | None, typer.Option(help="This frame alone, counted from 0.")] = None,
    frames: Annotated[int | None, typer.Option(help="So many frames, evenly spread from first to last.", min=1)] = None,
    start: Annotated[int, typer.Option(help="First frame to take, counted from 0.")] = 0,
    stop: Annotated[int | None, typer.Option(help="Frame to stop before.")] = None,
    step: Annotated[int, typer.Option(help="Take every so many frames.")] = 1,
    frames_as: Annotated[str | None, typer.Option(metavar="SUFFIX", help="In a folder: obj or ply.")] = None,
    blendshapes: BlendShapes = None,
    body_model: BodyModel = None,
    betas: Annotated[
        str | None,
        typer.Option(help="Person who moves, with --body-model: numbers with commas, or an .npz.", metavar="B"),
    ] = None,
    no_clobber: NoClobber = False,
    large: Large = False,
    no_limits: NoLimits = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a mesh or clip in another format.

    Clips stay clips where the format of OUT allows; .gif, .webp and .mp4 are movies. Formats: see docs/formats.md.
    """
    from ..render.movie import MOVIES
    from ..tools.convert import convert as convert_file
    from ..tools.convert import frames_at

    refuse_existing(no_clobber, target)
    refuse_inputs(target, source, body_model)
    with progress("frames", quiet or json) as advance:
        written = convert_file(
            source,
            target,
            fps=fps,
            animation=single("--animation", animation),
            frame=frame,
            frames=frames,
            start=start,
            stop=stop,
            step=step,
            frames_as=None if frames_as is None else "." + frames_as.lstrip("."),
            blendshapes=blendshapes,
            body_model=body_model,
            betas=betas,
            progress=advance,
        )
    facts = {"output": str(target), "vertices": written.vertices, "frames": written.frames, "fps": written.fps}
    if json:
        print_json({**facts, "notes": list(written.notes)})
    elif not quiet:
        length = "" if written.fps is None else f", {frames_at(written.frames, written.fps)}"
        say(f"{target}: {written.vertices} vertices{length}")
        for note in written.notes:
            say(f"note: {note}")
        if target.suffix.lower() not in MOVIES:
            print_next("look", target)


def studio(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]...", help="Meshes to move and, last of several, what to imitate; .onnx models."),
    ] = None,
    model: Model = "mime",
    port: Annotated[int, typer.Option(help="Where to listen; by default a port that is free.", min=0, max=65535)] = 0,
    host: Annotated[str, typer.Option(help="Another address than this machine's own: others can then reach it.")] = (
        "127.0.0.1"
    ),
    limit: Annotated[int, typer.Option(metavar="MIB", help="Size of a file that may be dropped.", min=1)] = 512,
    opened: Annotated[bool, typer.Option("--open/--no-open", help="Show the page in the browser.")] = True,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Move meshes on a page of this machine: drop files, choose a model, watch, export.

    Ends with Ctrl-C and leaves nothing behind; FILEs are read and never changed. The address it prints opens it.
    """
    require("viewer", "starlette", "uvicorn")
    from ..studio import serve
    from ..studio.security import LOOPBACK

    if host not in LOOPBACK:
        say(
            f"warning: others in the network of {host} can reach this studio, and read what passes; whoever has the "
            "address below can use it",
            error=True,
        )

    def announce(address: str) -> None:
        if json:
            print_json({"address": address})
        else:
            say(f"studio: {address}", *([] if quiet else ["Ctrl-C ends it"]))
        sys.stdout.flush()

    serve(
        files or [],
        host=host,
        port=port,
        limit=limit * 2**20,
        model=model,
        open_browser=opened,
        report_address=announce,
    )
