"""The command `mimesh rig`: give a mesh a skeleton and skinning weights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .joint_facts import joint_facts, print_joint_facts
from .move import Axis, JointFiles, Joints, Names, NoJoints, Rest, SaveJoints, check_joint_outputs
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
    one_of,
    output_path,
    progress,
    refuse_existing,
    refuse_inputs,
)

if TYPE_CHECKING:
    from ..pipeline.rigging import RiggedMesh


def rig(
    file: Annotated[Path, typer.Argument(metavar="FILE", parser=given_path, help="The mesh: GLB, OBJ, PLY, FBX ...")],
    output: Output = None,
    names: Names = "own",
    root_bone: Annotated[bool, typer.Option("--root-bone", help="Add a bone on the ground above the hips.")] = False,
    rest: Rest = "file",
    author: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Who made FILE, several times for several (.vrm).")
    ] = None,
    license: Annotated[
        str | None, typer.Option(metavar="URL", help="Its licence, such as https://vrm.dev/licenses/1.0/ (.vrm).")
    ] = None,
    up: Axis = None,
    front: Axis = None,
    body: Annotated[
        str,
        typer.Option(help="What it is: human, quadruped (four-legged animals), or auto: by rig or shape."),
    ] = "auto",
    replace: Annotated[
        str,
        typer.Option(
            "--rig",
            help="own: keep the rig of FILE, if it has any; mimesh: find joints on its surface.",
            autocompletion=one_of("rig"),
        ),
    ] = "own",
    joints: Joints = None,
    no_joints: NoJoints = False,
    save_joints: SaveJoints = None,
    fingers: Annotated[
        bool,
        typer.Option("--fingers/--no-fingers", help="Add joints of fingers to hands that show them."),
    ] = True,
    model: Model = "mime",
    preview: Annotated[
        bool, typer.Option("--preview/--no-preview", help="Write a picture with the bones beside the output.")
    ] = True,
    seed: Seed = 0,
    no_clobber: NoClobber = False,
    large: Large = False,
    no_limits: NoLimits = False,
    json: Json = False,
    quiet: Quiet = False,
) -> dict[str, Any]:
    """Give the mesh FILE a skeleton and skinning weights.

    By default the output is FILE-rigged.glb beside FILE. Joints are found on people and four-legged animals in any
    pose; --names mixamo, --rest T gives the bones and the pose that programs for motions expect. A .vrm is VRM 1.0: a
    person in the T-pose, with --author and --license.
    """
    from ..io import check_writable, load_mesh
    from ..io.atomic import together
    from ..pipeline.rigging import BONES
    from ..pipeline.rigging import rig as find_rig
    from ..pipeline.vrm import vrm_meta
    from ..tools.convert import not_kept
    from ..tools.inspect import metres_note
    from ..tools.preview import names_beside, rig_picture, save_picture
    from .clips import check_suffix

    target = output_path(output, lambda: file.with_name(f"{file.stem}-rigged.glb"))
    picture = names_beside(target)[0] if preview else None
    for written in filter(None, (target, picture)):
        refuse_inputs(written, file)
    check_suffix(target, BONES)
    check_joint_outputs((save_joints, None), model, file, target)
    if target.suffix.lower() == ".vrm" != file.suffix.lower():
        vrm_meta(file.stem, author, license, target)
    check_writable(target)
    refuse_existing(no_clobber, target, picture, save_joints)
    corrected = JointFiles.found(file, file, joints, None, no_joints, model)
    with progress("finding joints", quiet or json):
        rigged = find_rig(
            load_mesh(file), up=up, front=front, body=body, rig=replace, joints=corrected.identity,
            fingers=fingers, seed=seed, model=model,
        )  # fmt: skip
    replaced = target.is_file()
    with together():
        rigged.save(target, names=names, root_bone=root_bone, rest=rest, author=author, license=license)
        _save_joints(rigged, file, save_joints)
        if picture is not None:
            save_picture(rig_picture(rigged), picture)
    facts = joint_facts(rigged, target, replaced, len(rigged.skeleton.names), corrected.described())
    facts["vertices"] = len(rigged.mesh.vertices)
    facts["report"]["notes"] += [*not_kept(rigged.mesh, target), *metres_note(rigged.mesh, target)]
    facts["report"]["pictures"] = [] if picture is None else [str(picture)]
    return print_joint_facts(facts, json, quiet, ("animate", str(target), "walk.bvh"))


def _save_joints(rigged: RiggedMesh, file: Path, path: Path | None) -> None:
    """Write the joints that were found to a file, to be edited."""
    from ..core.joint_corrections import JointCorrections
    from ..io.joint_file import save_corrections

    if path is not None:
        save_corrections(JointCorrections(rigged.joints, 0, file.name, len(rigged.mesh.vertices)), path)
