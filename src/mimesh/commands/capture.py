"""The command `mimesh capture`: read the motion of joints out of a clip of surfaces."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .joint_facts import joint_facts, print_joint_facts
from .move import Axis, JointFiles, Joints, NoJoints
from .terminal import (
    Json,
    Large,
    Model,
    NoClobber,
    NoLimits,
    Output,
    Quiet,
    Seed,
    given_path,
    output_path,
    progress,
    refuse_existing,
    refuse_inputs,
)


def capture(
    clip: Annotated[
        Path, typer.Argument(metavar="CLIP", parser=given_path, help="A folder of meshes, GLB, ABC, USD, PC2, NPZ ...")
    ],
    output: Output = None,
    fps: Annotated[float | None, typer.Option(help="Frame rate of CLIP, where its files do not say.")] = None,
    animation: Annotated[str | None, typer.Option(help="Animation of a glTF file: name or number.")] = None,
    start: Annotated[int, typer.Option(help="First frame to take, counted from 0.")] = 0,
    stop: Annotated[int | None, typer.Option(help="Frame to stop before.")] = None,
    step: Annotated[int, typer.Option(help="Take every so many frames.")] = 1,
    smooth: Annotated[float, typer.Option(metavar="SECONDS", help="Average the motion of joints over time.")] = 0.0,
    up: Axis = None,
    front: Axis = None,
    body: Annotated[
        str, typer.Option(help="What CLIP shows: human, quadruped (four-legged animals), or auto: by its shape.")
    ] = "auto",
    joints: Joints = None,
    no_joints: NoJoints = False,
    model: Model = "mime",
    seed: Seed = 0,
    no_clobber: NoClobber = False,
    large: Large = False,
    no_limits: NoLimits = False,
    json: Json = False,
    quiet: Quiet = False,
) -> dict[str, Any]:
    """Read the motion of joints out of the surfaces of CLIP: scans, caches, another character.

    By default the output is CLIP.bvh beside CLIP. A .glb or .fbx has the joints alone, a
    .vrma plays on any VRM. Joints that the file has are taken as they are.
    """
    from ..io import check_writable, load_driving
    from ..pipeline.capturing import JOINT_FILES
    from ..pipeline.capturing import capture as capture_joints
    from ..tools.convert import frames_at
    from .clips import check_suffix

    target = output_path(output, lambda: clip.with_name(f"{clip.stem if clip.is_file() else clip.name}.bvh"))
    refuse_inputs(target, clip)
    check_suffix(target, JOINT_FILES)
    check_writable(target)
    refuse_existing(no_clobber, target)
    corrected = JointFiles.found(clip, clip, joints, None, no_joints, model)
    with progress(f"reading {clip.name}", quiet or json) as advance:
        whole = load_driving(clip, fps=fps, animation=animation, progress=advance)
    with progress("finding joints", quiet or json) as advance:
        captured = capture_joints(
            whole, up=up, front=front, body=body, joints=corrected.identity, start=start, stop=stop, step=step,
            smooth=smooth, seed=seed, model=model, progress=advance,
        )  # fmt: skip
    replaced = target.is_file()
    captured.save(target)
    frames = len(captured.root)
    facts = joint_facts(captured, target, replaced, len(captured.names), corrected.described())
    facts |= {"frames": frames, "fps": captured.fps}
    length = f", {frames_at(frames, captured.fps)}"
    return print_joint_facts(facts, json, quiet, ("animate", "hero.glb", str(target)), length)
