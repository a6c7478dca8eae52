"""The command `mimesh capture`: read the motion of joints out of a clip of surfaces."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..core.options import FrameRange, Hints, MotionOptions
from .joint_facts import joint_facts, print_joint_facts
from .move import with_joint_files
from .options import ClipOptions, JointOptions, OutputOptions, Without, with_options
from .terminal import Model, Seed, given_path, output_path, progress, refuse_existing, refuse_inputs, single


@with_options
def capture(
    clip: Annotated[
        Path, typer.Argument(metavar="CLIP", parser=given_path, help="A folder of meshes, GLB, USD, PC2, NPZ ...")
    ],
    *,
    model: Model = "mime",
    output: Annotated[OutputOptions, Without("open", "preview")],
    taken: Annotated[ClipOptions, Without("body_model")],
    motion: Annotated[MotionOptions, Without("root", "ground", "contacts", "skinned", "influences")],
    hints: Annotated[Hints, Without("driving_up", "driving_front", "driving_joints", "driving_part")],
    joints: Annotated[JointOptions, Without("save_joints", "save_driving_joints")],
    seed: Seed = 0,
) -> dict[str, Any]:
    """Read the motion of joints out of the surfaces of CLIP: scans, caches, another character.

    By default the output is CLIP.bvh beside CLIP. A .glb or .fbx has the joints alone, a
    .vrma plays on any VRM. Joints that the file has are taken as they are.
    """
    from ..motions.retarget import NEEDED
    from ..pipeline.capturing import JOINT_FILES
    from ..pipeline.capturing import capture as capture_joints
    from ..pipeline.read import load_moving
    from ..tools.convert import frames_at
    from .clips import check_suffix

    target = output_path(output.output, lambda: clip.with_name(f"{clip.stem if clip.is_file() else clip.name}.bvh"))
    refuse_inputs(target, clip)
    check_suffix(target, JOINT_FILES)
    refuse_existing(output.no_clobber, target)
    hints, corrected = with_joint_files(hints, clip, None, joints, model)
    with progress(f"reading {clip.name}", output.silent) as advance:
        animation, told = single("--animation", taken.animation), (hints.up, hints.front, hints.body)
        whole = hints.joints is not None  # corrected joints may be in a frame that is not taken
        read = load_moving(clip, slice(None) if whole else taken.slice, told, taken.fps, animation, advance)
    frames = FrameRange(taken.start, taken.stop, taken.step) if whole else FrameRange()
    with progress("finding joints", output.silent) as advance:
        captured = capture_joints(
            read, model, hints=hints, frames=frames, smooth=motion.smooth, seed=seed, progress=advance
        )
    replaced = target.is_file()
    captured.save(target)
    count = len(captured.root)
    facts = joint_facts(captured, target, replaced, len(captured.names), corrected)
    facts |= {"frames": count, "fps": captured.fps}
    length = f", {frames_at(count, captured.fps)}"
    if captured.body != "human":
        then = ("look", str(target))
    else:
        then = ("animate", "hero.glb", str(target if set(captured.names).issuperset(NEEDED) else clip))
    return print_joint_facts(facts, output, then, length)
