"""The command `mimesh rig`: give a mesh a skeleton and skinning weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.options import Hints, Layout, MotionOptions, declared
from .joint_facts import joint_facts, print_joint_facts
from .move import check_joint_outputs, save_found, with_joint_files
from .options import JointOptions, OutputOptions, Without, with_options
from .terminal import Model, Seed, given_path, output_path, progress, refuse_existing, refuse_inputs

if TYPE_CHECKING:
    from ..io.gltf.own_rig import OwnRig


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
    from ..tools.convert import not_kept
    from ..tools.preview import names_beside, rig_picture, save_picture, written_beside
    from .clips import check_suffix

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
    count = len(skeleton.names) if rigged.own is None else _joints_of_skins(rigged.own)
    facts = joint_facts(rigged, target, replaced, count, corrected)
    facts["vertices"] = len(rigged.mesh.vertices)
    facts["report"]["notes"] += [*not_kept(rigged.skeleton.mesh, target, rigged.body), *not_drawn]
    facts["report"]["pictures"] = [*map(str, pictures)]
    then = ("animate", str(target), "walk.bvh") if rigged.body == "human" else ("look", str(target))
    return print_joint_facts(facts, output, then)


def _joints_of_skins(own: OwnRig) -> int:
    """Return how many joints the skins of a file have."""
    return len({joint for skin in own.source.document.gltf["skins"] for joint in skin["joints"]})
