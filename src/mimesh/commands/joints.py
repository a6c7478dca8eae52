"""The commands `mimesh rig` and `mimesh capture`: find joints on a mesh, or in all frames of a clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.options import FrameRange, Hints, Layout, MotionOptions, declared
from ..core.printable import say
from .joint_files import check_joint_outputs, save_found, with_joint_files
from .options import ClipOptions, JointOptions, OutputOptions, Without, with_options
from .outputs import check_suffix
from .terminal import (
    Model,
    Seed,
    given_path,
    output_path,
    print_json,
    print_next,
    progress,
    refuse_existing,
    refuse_inputs,
    single,
)

if TYPE_CHECKING:
    from ..pipeline.capturing import CapturedClip
    from ..pipeline.rigging import RiggedMesh


@dataclass(frozen=True)
class RigOptions:
    """What a rig has, and who made the mesh."""

    author: list[str] | None = declared(None, "Who made FILE, several times for several (.vrm).", metavar="NAME")
    license: str | None = declared(None, "Its licence, such as https://vrm.dev/licenses/1.0/ (.vrm).", metavar="URL")
    fingers: bool = declared(True, "Add joints of fingers to hands that show them.", name="--fingers/--no-fingers")


@with_options
def rig(
    file: Annotated[Path, typer.Argument(metavar="FILE", parser=given_path, help="The mesh: GLB, OBJ, PLY, FBX ...")],
    *,
    model: Model = "mime",
    output: Annotated[OutputOptions, Without("open")],
    layout: Annotated[Layout, Without("fps")],
    options: RigOptions,
    weights: Annotated[MotionOptions, Without("root", "ground", "contacts", "smooth", "skinned")],
    hints: Annotated[Hints, Without("driving_up", "driving_front", "driving_joints", "driving_part")],
    joints: Annotated[JointOptions, Without("save_driving_joints")],
    seed: Seed = 0,
) -> dict[str, Any]:
    """Give the mesh FILE a skeleton and skinning weights.

    By default the output is FILE-rigged.glb beside FILE. Joints are found on people and four-legged animals in any
    pose; --names mixamo, --rest T gives the bones and the pose that programs for motions expect. A .vrm is VRM 1.0: a
    person in the T-pose, with --author and --license.
    """
    from ..io import load_mesh
    from ..io.atomic import together
    from ..io.formats import JOINTED
    from ..pipeline.rigging import rig as find_rig
    from ..pipeline.vrm import vrm_meta, written_skeleton
    from ..tools.notes import not_kept
    from ..tools.preview import names_beside, rig_picture, save_picture, written_beside

    target = output_path(output.output, lambda: file.with_name(f"{file.stem}-rigged.glb"))
    picture = names_beside(target)[0] if output.preview else None
    for path in filter(None, (target, picture)):
        refuse_inputs(path, file)
    check_suffix(target, JOINTED)
    check_joint_outputs(joints, model, file, target)
    if target.suffix.lower() == ".vrm" != file.suffix.lower():
        vrm_meta(file.stem, options.author, options.license, target)
    refuse_existing(output.no_clobber, target, picture, joints.save_joints)
    hints, corrected = with_joint_files(hints, file, None, joints, model)
    with progress("finding joints", output.silent):
        rigged = find_rig(load_mesh(file), model, hints=hints, fingers=options.fingers, seed=seed)
    replaced = target.is_file()
    made_by = {"author": options.author, "license": options.license}
    with together():
        bones = {"names": layout.names, "root_bone": layout.root_bone, "rest": layout.rest}
        rigged.save(target, **bones, **made_by, influences=weights.influences)
        save_found(rigged.joints, joints.save_joints, file, rigged.mesh)
    pictures, not_drawn = (), ()
    skeleton = written_skeleton(rigged, layout, target)
    if picture is not None:
        pictures, not_drawn = written_beside(
            picture, lambda: save_picture(rig_picture(skeleton, rigged.report), picture)
        )
    count = len(skeleton.names)
    if rigged.own is not None:  # those of rigid pieces are nodes
        skins = rigged.own.source.document.gltf.get("skins", ())
        count = len({joint for skin in skins for joint in skin["joints"]}) or count
    notes = (*not_kept(rigged.skeleton.mesh, target, rigged.body), *not_drawn)
    facts = _facts(rigged, target, replaced, count, corrected, notes)
    facts["vertices"] = len(rigged.mesh.vertices)
    facts["report"]["pictures"] = [*map(str, pictures)]
    then = ("animate", str(target), "walk.bvh") if rigged.body == "human" else ("look", str(target))
    return _printed(facts, output, then)


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
    from ..tools.notes import frames_at

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
    facts = _facts(captured, target, replaced, len(captured.names), corrected) | {"frames": count, "fps": captured.fps}
    if captured.body != "human":
        then = ("look", str(target))
    else:
        then = ("animate", "hero.glb", str(target if set(captured.names).issuperset(NEEDED) else clip))
    return _printed(facts, output, then, f", {frames_at(count, captured.fps)}")


SOURCES = {"file": "of the file", "found": "found", "corrected": "found with corrections"}
"""Where joints are from -> what the summary says."""


def _facts(
    made: RiggedMesh | CapturedClip,
    output: Path,
    replaced: bool,
    joints: int,
    corrected: Sequence[str],
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the facts that both commands have in common; docs/commands.md lists all keys.

    Args:
        replaced: whether a file of this name was there.
        corrected: a line for each file of corrected joints.
    """
    return {
        "output": str(output),
        "replaced": replaced,
        "body": made.body,
        "source": "file" if "confidence" not in made.report else "corrected" if corrected else "found",
        "joints": joints,
        "seconds": {step: round(value, 4) for step, value in made.seconds.items()},
        "report": {**made.report, "corrected": list(corrected), "notes": [*made.notes, *notes]},
    }


def _printed(facts: dict[str, Any], output: OutputOptions, then: Sequence[str], length: str = "") -> dict[str, Any]:
    """Print facts as JSON or as a summary with a next command, and return them; `length` is that of a clip."""
    if output.json:
        print_json(facts)
    elif not output.quiet:
        from ..pipeline.look import KINDS

        report = facts["report"]
        sure = f", confidence {report['confidence']:.2f}" if "confidence" in report else ""
        replaced = " (replaced)" if facts["replaced"] else ""
        about = f"{facts['joints']} joints of {KINDS[facts['body']]}, {SOURCES[facts['source']]}{sure}{length}"
        say(f"{facts['output']}{replaced}: {about}, {sum(facts['seconds'].values()):.1f} s")
        for kind, key in (("joints", "corrected"), ("note", "notes"), ("picture", "pictures")):
            for line in report.get(key, ()):
                say(f"{kind}: {line}")
        print_next(*then)
    return facts
