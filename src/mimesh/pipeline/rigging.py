"""`mimesh.rig`: give a mesh a skeleton and skinning weights, or tell that its file has them.

The mesh is looked at as by `animate`, alone and once: the joints of its file if these are sound, else those that `mime`
finds on its surface.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

import numpy as np
from jaxtyping import Float

from ..bodies.engine_names import SCHEMES
from ..bodies.engine_rig import engine_rig
from ..bodies.joint_names import without_fingers
from ..core.animated_rig import INFLUENCES, AnimatedRig
from ..core.arguments import public
from ..core.errors import InputError, option
from ..core.mesh import Clip, Mesh, far_note
from ..core.options import Hints, Layout, check_influences
from ..io import joints_file
from ..io.beside import missing_images, missing_images_notes
from ..io.formats import JOINTED
from ..io.gltf.own_animation import own_pose, write_own_rig
from ..io.gltf.own_rig import OwnRig
from ..io.gltf.skinned import write_gltf_rig
from ..methods.find import find_mime
from ..mime.model import Mime
from .joint_route import FoundCharacter, found_character, rigs_alone
from .known import Known
from .look import normalised
from .parts import find_part
from .placed import check_identity, with_up
from .read import read_mesh
from .report import RigReport, facing, facing_note, fingered_hands
from .result import Timer
from .skinned import check_own_layout
from .vrm import save_as_vrm

NO_HINTS = Hints()


@dataclass(frozen=True, eq=False)
class RiggedMesh:
    """A mesh with a skeleton, at rest; made by `mimesh.rig`.

    Example:
        >>> rigged.body, rigged.source, len(rigged.skeleton.names)
        ('human', 'found', 46)
    """

    mesh: Mesh
    """The mesh, as it was given."""
    skeleton: AnimatedRig
    """Joints and skinning weights in the axes, unit and position of the file; its one frame is the rest pose. Of a
    file's own rig it has the joints that move with the hips."""
    body: str
    """Shipped body whose joints they are: "human" or "quadruped"."""
    source: Literal["file", "found", "corrected"]
    """Where the joints are from: the file, its surface, or its surface with joints that the user has corrected."""
    report: RigReport
    """Axes of the mesh, its fingers, and how certainly joints were found: its "confidence" is from 0 to 1."""
    seconds: Timer
    """Wall time in seconds of the steps: load, prepare, write."""
    notes: tuple[str, ...] = ()
    """Lines for the user: what may be wrong, and what to do."""
    found: FoundCharacter | None = field(default=None, repr=False)
    """What `mimesh.retarget` moves."""

    @property
    def own(self) -> OwnRig | None:
        """The rig of the file, where that is kept."""
        return None if self.found is None else self.found.rigs.identity

    @property
    def joints(self) -> dict[str, Float[np.ndarray, " 3"]]:
        """Joint -> position (3,), in axes, unit and position of the file.

        Those of fingers are left out: all others can be corrected and passed to `rig`.

        Example:
            >>> rigged.joints["LeftLeg"].shape
            (3,)
        """
        roles = self.skeleton.person or {name: j for j, name in enumerate(self.skeleton.names)}
        return without_fingers({name: self.skeleton.rig.joints[j] for name, j in roles.items()})

    @public
    def save(
        self,
        path: str | Path,
        *,
        names: str = "own",
        root_bone: bool = False,
        rest: str = "file",
        author: str | Sequence[str] | None = None,
        license: str | None = None,
        influences: int = INFLUENCES,
    ) -> Path:
        """Write the mesh with its bones, without an animation: .glb, .gltf, .vrm, or .fbx where Blender is installed.

        The rig of a file is kept as it is, with all of its contents; only its bones may get other names. A .vrm is
        VRM 1.0: a person in the T-pose, y up, +z front, and in metres where the file names its unit.

        Args:
            path: the file.
            names: names and hierarchy of the bones, as in "mixamo", "unreal", "vrm", "godot", "rigify"; "own" keeps
                them.
            root_bone: add a bone on the ground above the hips.
            rest: pose that mesh and bones are bound in: that of the "file", "T" or "A".
            author: who made the character, or several who did; a .vrm needs it.
            license: URL of the licence, which a .vrm needs. Any but that of the VRM Public License,
                https://vrm.dev/licenses/1.0/, is written beside that one, as VRM demands.
            influences: weights a vertex of joints that were found: 4, or 8 for engines that read so many (not .vrm).

        Returns:
            The path.

        Raises:
            InputError: another format, no such names or pose, what a .vrm cannot be, or a path that cannot be written
                to.

        Example:
            >>> path = rigged.save("hero-rigged.glb", names="mixamo", rest="T")
        """
        check_influences(influences)
        layout = Layout(names, root_bone, rest)
        if Path(path).suffix.lower() not in JOINTED:
            found = f"found '{Path(path).suffix}'"
            raise InputError(f"{path}: expected one of {' '.join(JOINTED)} for bones, {found}; rename it")
        if (author or license) and Path(path).suffix.lower() != ".vrm":
            raise InputError(f"{path}: expected a .vrm for {option('author')} and {option('license')}, found none")
        if influences != INFLUENCES and Path(path).suffix.lower() == ".vrm":
            raise InputError(f"{path}: expected 4 weights a vertex in a .vrm, found {influences}; write a .glb")
        self._check_layout(layout)
        with self.seconds.step("write"):
            if Path(path).suffix.lower() == ".vrm":
                save_as_vrm(self, layout, author, license, Path(path))
            elif self.own is not None:
                check_own_layout(self.own.person, layout, self.mesh.name)
                with joints_file(path, animated=False) as temporary:
                    write_own_rig(own_pose(self.own, self.mesh.name, layout), temporary)
            else:
                with joints_file(path, animated=False) as temporary:
                    write_gltf_rig(dataclasses.replace(self.laid_out(layout), influences=influences), temporary)
        return Path(path)

    def laid_out(self, layout: Layout) -> AnimatedRig:
        """Return `skeleton` with the bone names, the root bone and the rest pose of a layout, its mesh in that pose.

        Args:
            layout: names and arrangement of the bones; its frame rate is not used.

        Raises:
            InputError: names or a pose of people, for an animal.

        Example:
            >>> rigged.laid_out(mimesh.Layout("mixamo")).names[0]
            'mixamorig:Hips'
        """
        self._check_layout(layout)
        up, front = self.report["up"], self.report["front"]
        laid_out = engine_rig(self.skeleton, layout.names, layout.root_bone, layout.rest, up=up, front=front)
        rest = laid_out.rig
        return dataclasses.replace(laid_out, rotation=rest.rotation[None], root=rest.joints[:1], positions=None)

    def _check_layout(self, layout: Layout) -> None:
        """Raise InputError for names or a pose of people, where this is an animal."""
        if self.body != "human" and (SCHEMES[layout.names].bones or layout.rest != "file"):
            asked = f"{option('names')}, {option('rest')}"
            raise InputError(f"{asked}: expected a person, found a four-legged animal; leave the options out")


@public
def rig(
    mesh: Mesh | str | Path, model: str = "mime", *, hints: Hints = NO_HINTS, fingers: bool = True, seed: int = 0
) -> RiggedMesh:
    """Give a mesh a skeleton and skinning weights: those of its file if it has any, else found on its surface.

    Args:
        mesh: the mesh, or its path: a person or a four-legged animal in any pose.
        model: "mime", or the path of an .onnx file that was trained as `mime` is.
        hints: axes, body and joints of the mesh, where they are known; with `rig` "mimesh" the rig of its file is
            replaced.
        fingers: add joints of the fingers to hands on whose surface they are found; else fingers move with the hand.
        seed: seed of all random choices.

    Returns:
        The mesh with its skeleton; `save` writes it.

    Raises:
        InputError: a file, an axis, the body or the joints cannot be used.
        RefusedMeshError: the mesh looks neither like a person nor like a four-legged animal; `hints.body` insists.

    Example:
        >>> rigged = mimesh.rig("hero.obj")
        >>> path = rigged.save("hero-rigged.glb")
    """
    timer = Timer()
    hints.check_single()
    with timer.step("load"):
        mesh = read_mesh(mesh, "mesh")
    check_identity(mesh)
    known = Known.of(hints, Clip.still(mesh))
    with timer.step("prepare"):
        return _rigged(mesh, find_mime(model, seed), known, fingers, timer)


def _rigged(mesh: Mesh, mime: Mime, known: Known, fingers: bool, timer: Timer) -> RiggedMesh:
    """Look at a mesh and find its joints, and those of its fingers if these are wanted."""
    whole, part = mesh, find_part(mesh, known.parts[0])
    if part is not None:
        mesh, known = part.mesh, dataclasses.replace(known, corrections=known.corrections.of_part(None))
    rigs = rigs_alone(mime, mesh, Clip.still(mesh), known)
    subject = rigs.subjects(mesh, mesh, known.axes)[0]
    seen, plain, norm = found_character(mime, subject, known.asked_body, rigs, known.corrections)
    character = plain
    if fingers and rigs.humanoid is None:
        character = mime.of_body(seen.body).with_all_fingers(plain, normalised(mesh, norm))
    report = facing(norm)
    notes = facing_note(norm, mesh.name, "front") + rigs.notes
    if rigs.humanoid is not None:
        report["up_from"] = "joints" if known.axes[0] is None else "given"
        notes += (f"{mesh.name} has a rig, which is kept; {option('rig', 'mimesh')} replaces it",)
    elif character.confidence is not None:
        report |= character.confidence.facts()
        notes = character.confidence.notes(mesh.name, alone=True) + notes
    notes += missing_images_notes(missing_images(mesh)) + (() if part is None else part.notes) + far_note(whole)
    source = "file" if rigs.humanoid is not None else "corrected" if known.corrections.given else "found"
    shown, rest, roles = with_up(mesh, norm), character.rig_of_file(norm), character.roles
    if rigs.humanoid is not None:
        shown = shown.with_vertices(rigs.humanoid.character.mesh.vertices)
    at_rest = rest, rest.rotation[None], rest.joints[:1]
    skeleton = AnimatedRig(shown, character.joints, character.parents, *at_rest, roles, group=character.shared)
    return RiggedMesh(
        whole,
        skeleton if part is None else part.rig(skeleton),
        seen.body,
        source,
        cast(RigReport, report | {"fingers": fingered_hands(character.roles)}),
        timer,
        notes,
        FoundCharacter(character, plain, norm, rigs, part),
    )
