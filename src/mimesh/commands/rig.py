"""The command `mimesh rig`: give a mesh a skeleton and skinning weights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.options import Hints, Layout
from ..core.printable import say
from .move import check_joint_outputs, save_found, with_joint_files
from .options import JointOptions, OutputOptions, Without, with_options
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
)

if TYPE_CHECKING:
    from ..pipeline.rigging import RiggedMesh


@with_options
def rig(
    file: Annotated[Path, typer.Argument(metavar="FILE", parser=given_path, help="The mesh: GLB, OBJ, PLY, FBX ...")],
    *,
    model: Model = "mime",
    output: Annotated[OutputOptions, Without("open")],
    layout: Annotated[Layout, Without("fps")],
    hints: Annotated[Hints, Without("driving_up", "driving_front", "driving_joints")],
    joints: Annotated[JointOptions, Without("save_driving_joints")],
    seed: Seed = 0,
) -> dict[str, Any]:
    """Give the mesh FILE a skeleton and skinning weights.

    By default the output is FILE-rigged.glb beside FILE. Joints are found on people and four-legged animals in any
    pose; --names mixamo, --rest T gives the bones and the pose that programs for motions expect.
    """
    from ..io import load_mesh
    from ..io.atomic import together
    from ..pipeline.rigging import BONES
    from ..pipeline.rigging import rig as find_rig
    from ..tools.preview import names_beside, rig_picture, save_picture
    from .clips import check_suffix

    target = output_path(output.output, lambda: file.with_name(f"{file.stem}-rigged.glb"))
    picture = names_beside(target)[0] if output.preview else None
    for written in filter(None, (target, picture)):
        refuse_inputs(written, file)
    check_suffix(target, BONES)
    check_joint_outputs(joints, model, file, target)
    refuse_existing(output.no_clobber, target, picture, joints.save_joints)
    hints, corrected = with_joint_files(hints, file, None, joints, model)
    with progress("finding joints", output.silent):
        rigged = find_rig(load_mesh(file), model, hints=hints, seed=seed)
    replaced = target.is_file()
    with together():
        rigged.save(target, names=layout.names, root_bone=layout.root_bone, rest=layout.rest)
        save_found(rigged.joints, joints.save_joints, file, rigged.mesh)
        if picture is not None:
            save_picture(rig_picture(rigged), picture)
    facts = _facts(rigged, target, replaced, picture, corrected)
    if output.json:
        print_json(facts)
    elif not output.quiet:
        _print_summary(facts)
    return facts


def _facts(
    rigged: RiggedMesh, output: Path, replaced: bool, picture: Path | None, joints: tuple[str, ...]
) -> dict[str, Any]:
    """Return the facts about a rig and its file, with all notes."""
    from ..tools.convert import not_kept

    return {
        "output": str(output),
        "replaced": replaced,
        "body": rigged.body,
        "source": rigged.source,
        "joints": len(rigged.skeleton.names),
        "vertices": len(rigged.mesh.vertices),
        "seconds": {step: round(value, 4) for step, value in rigged.seconds.items()},
        "report": {
            **rigged.report,
            "corrected": list(joints),
            "notes": [*rigged.notes, *not_kept(rigged.mesh, output)],
            "pictures": [] if picture is None else [str(picture)],
        },
    }


def _print_summary(facts: dict[str, Any]) -> None:
    """Print the output, how certain the joints are, notes, the picture and a next step."""
    from ..pipeline.look import KINDS

    report, seconds = facts["report"], sum(facts["seconds"].values())
    kind = KINDS[facts["body"]]
    sure = f", confidence {report['confidence']:.2f}" if "confidence" in report else ""
    where = {"file": "of the file", "found": "found", "corrected": "found with corrections"}[facts["source"]]
    replaced = " (replaced)" if facts["replaced"] else ""
    say(f"{facts['output']}{replaced}: {facts['joints']} joints of {kind}, {where}{sure}, {seconds:.1f} s")
    for line in report["corrected"]:
        say(f"joints: {line}")
    for note in report["notes"]:
        say(f"note: {note}")
    for path in report["pictures"]:
        say(f"picture: {path}")
    print_next("animate", facts["output"], "walk.bvh")
