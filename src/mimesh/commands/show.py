"""The commands `mimesh look`, `mimesh render`, `mimesh convert` and `mimesh studio`."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.options import ConvertOptions, FrameRange, RenderOptions
from ..core.printable import say
from . import terminal
from .options import ClipOptions, OutputOptions, Without, with_options

if TYPE_CHECKING:
    from ..core.mesh import Clip

Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Meshes, clips or folders of numbered meshes.")]


def look(files: Files, no_limits: terminal.NoLimits = False, json: terminal.Json = False) -> None:
    """Show what mesh files contain, and problems that may spoil a transfer."""
    from ..core.errors import InputError
    from ..tools.inspect import inspect_file

    facts, errors = {}, []
    with terminal.progress("reading", json) as advance:
        for done, path in enumerate(files, start=1):
            try:
                facts[path] = inspect_file(path)
            except InputError as error:
                errors.append(error)
            if advance is not None:
                advance(done, len(files))
    if json:
        if errors:
            raise errors[0]
        terminal.print_json({"files": [fact.as_dict() for fact in facts.values()]})
        return
    for fact in facts.values():
        say(*fact.text().split("\n"), *([""] if len(files) > 1 else []))
    for error in errors[:-1]:
        say(f"mimesh: {error}", error=True)
    if errors:
        raise errors[-1]
    axes, *others = {fact.axes for fact in facts.values()}
    turned = () if others or axes in (None, ("+y", "+z")) else (f"--up={axes[0]}", f"--front={axes[1]}")
    terminal.print_next("render", *files, "-o", "sheet.png", *turned)


@with_options
def render(
    files: Files,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="A picture (.png .jpg), a movie (.webp .gif .mp4) or a page (.html).")
    ],
    options: RenderOptions,
    taken: Annotated[ClipOptions, Without("body_model")],
    printed: Annotated[OutputOptions, Without("output", "preview", "open")],
) -> None:
    """Draw meshes and clips: sheet, strip, heat map, movie or a page to play with.

    By default meshes become a sheet, or a movie that turns; clips become strips, or a movie that plays.
    """
    from ..tools.draw import check_options, draw

    check_options(options, output)
    terminal.refuse_existing(printed.no_clobber, output)
    terminal.refuse_inputs(output, *files, options.truth)
    with terminal.progress("reading", printed.silent):
        clips = _cut(files, terminal.single("--animation", taken.animation), taken)
    names = [path.name for path in files]
    if len(set(names)) < len(names):  # out/knight/run.glb and out/mage/run.glb
        names = [str(Path(*path.parts[-2:])) for path in files]
    with terminal.progress("frames", printed.silent) as advance:
        kind = draw(options, names, clips, output, taken, advance)
    if printed.json:
        terminal.print_json({"output": str(output), "kind": kind, "files": [str(path) for path in files]})
    elif not printed.quiet:
        say(f"{output}: {kind} of {', '.join(names)}")
        terminal.print_next("look", *files)


def _cut(files: list[Path], animation: str | None, taken: FrameRange) -> list[Clip]:
    """Load clips and cut all of them alike; a file of one mesh is not cut if another file moves."""
    from ..core.mesh import cut_clip
    from ..io import load_clip

    clips = [load_clip(path, fps=taken.fps, animation=animation) for path in files]
    still = all(len(clip) == 1 for clip in clips)
    return [cut_clip(clip, taken.start, taken.stop, taken.step) if len(clip) > 1 or still else clip for clip in clips]


@with_options
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A mesh, a clip, a motion or a folder of meshes.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Its suffix is the format; without one, a folder.")],
    options: Annotated[ConvertOptions, Without("animation")],
    taken: Annotated[ClipOptions, Without("start", "stop", "step", "fps", "body_model")],
    printed: Annotated[OutputOptions, Without("output", "preview", "open")],
) -> None:
    """Write a mesh or clip in another format.

    Clips stay clips where the format of OUT allows; .gif, .webp and .mp4 are movies. Formats: see docs/formats.md.
    """
    from ..tools.convert import convert as convert_file
    from ..tools.notes import frames_at
    from ..view.movie import MOVIES

    terminal.refuse_existing(printed.no_clobber, target)
    terminal.refuse_inputs(target, source, options.body_model)
    options = dataclasses.replace(options, animation=terminal.single("--animation", taken.animation))
    with terminal.progress("frames", printed.silent) as advance:
        written = convert_file(source, target, options, advance)
    facts = {"output": str(target), "vertices": written.vertices, "frames": written.frames, "fps": written.fps}
    if printed.json:
        terminal.print_json({**facts, "notes": list(written.notes)})
    elif not printed.quiet:
        length = "" if written.fps is None else f", {frames_at(written.frames, written.fps)}"
        say(f"{target}: {written.vertices} vertices{length}")
        for note in written.notes:
            say(f"note: {note}")
        if target.suffix.lower() not in MOVIES:
            terminal.print_next("look", target)


def studio(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]...", help="Meshes to move and, last of several, what to imitate; .onnx models."),
    ] = None,
    model: terminal.Model = "mime",
    port: Annotated[int, typer.Option(help="Where to listen; by default a port that is free.", min=0, max=65535)] = 0,
    host: Annotated[str, typer.Option(help="Another address than this machine's own: others can then reach it.")] = (
        "127.0.0.1"
    ),
    limit: Annotated[int, typer.Option(metavar="MIB", help="Size of a file that may be dropped.", min=1)] = 512,
    opened: Annotated[bool, typer.Option("--open/--no-open", help="Show the page in the browser.")] = True,
    json: terminal.Json = False,
    quiet: terminal.Quiet = False,
) -> None:
    """Move meshes on a page of this machine: drop files, choose a model, watch, export.

    Ends with Ctrl-C and leaves nothing behind; FILEs are read and never changed. The address it prints opens it.
    """
    terminal.require("viewer", "starlette", "uvicorn")
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
            terminal.print_json({"address": address})
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
