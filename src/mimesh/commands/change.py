"""`mimesh convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .terminal import Animation, BlendShapes, Json, Quiet, print_json, print_next, progress, refuse_inputs


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
    from ..tools.convert import MOVIES, frames_at
    from ..tools.convert import convert as run

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
