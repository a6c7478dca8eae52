"""Options that the front ends share: what is known of the meshes, how they move, how a model works, what is written.

Each option is declared once, here: its name, kind, default, values and help. The command line makes its options of
these classes, batches their columns; Python takes the classes. Nothing heavy is imported, because `mimesh --help` and
shells that complete values wait for this module.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import InputError, did_you_mean, option

if TYPE_CHECKING:
    from .joint_corrections import JointCorrections
    from .mesh import Mesh

T = TypeVar("T")
LONGEST_SMOOTHING = 10.0
"""Seconds."""
AXES = ("up", "front", "driving_up", "driving_front")
"""Hints that are axes."""
AXIS = "x, y, z, -x, -y or -z, instead of the one found."
GIVEN = "by default the .joints.json beside it (mime)."
"""Where corrected joints are looked for."""


def declared(default: T, help: str, values: tuple[str, ...] = (), **command: Any) -> T:
    """Declare an option: its default, its help, the texts that it may be, and how the command line differs.

    Args:
        command: `name` of the option, `kind` of its value, and other arguments of `typer.Option`.
    """
    return dataclasses.field(default=default, metadata={"help": help, "values": values, **command})  # type: ignore


def options(cls: type[T]) -> type[T]:
    """Make a dataclass one of options: arguments are checked, and wrong ones raise InputError."""
    made, signature = cls.__init__, inspect.signature(cls.__init__)
    values = {field.name: field.metadata["values"] for field in dataclasses.fields(cls)}  # type: ignore

    @functools.wraps(made)
    def __init__(self: Any, *args: Any, **given: Any) -> None:
        from .arguments import check_call

        check_call(signature, (self, *args), given)
        made(self, *args, **given)
        for name, allowed in values.items():
            check_value(name, getattr(self, name), allowed)

    cls.__init__ = __init__
    return cls


def check_value(name: str, value: object, allowed: tuple[str, ...]) -> None:
    """Raise InputError for a text that an option may not be; it may be any if `allowed` is empty."""
    if allowed and isinstance(value, str) and value not in allowed:
        close = did_you_mean(value, allowed) or "; choose one of them"
        raise InputError(f"{option(name)}: expected one of {', '.join(allowed)}, found {value!r}{close}")


def values_of(cls: type, name: str) -> tuple[str, ...]:
    """Return the texts that an option may be."""
    return next(field.metadata["values"] for field in dataclasses.fields(cls) if field.name == name)


@options
@dataclass(frozen=True, eq=False)
class Hints:
    """What is known of the identity and of the driving, instead of what is found.

    Example:
        >>> mimesh.Hints(up="+z", body="human").body
        'human'
    """

    up: str | None = declared(None, AXIS, metavar="AXIS")
    """The identity's axis away from the ground ("+y", "-z"); detected from its shape by default."""
    front: str | None = declared(None, AXIS, metavar="AXIS")
    """The identity's axis to its front; detected by default."""
    driving_up: str | None = declared(None, AXIS, metavar="AXIS")
    """As `up`, of the driving."""
    driving_front: str | None = declared(None, AXIS, metavar="AXIS")
    """As `front`, of the driving."""
    rig: Any = declared(
        "own", "own: keep the bones of the file, if it has any; mimesh: find joints (both mime).", ("own", "mimesh"),
        kind=str,
    )  # fmt: skip
    """"own": an identity with a sound rig in its file moves on its own bones (mime only); "mimesh": joints are found on
    its surface, and its skin is dropped. A program that has the identity's bones passes the rig that
    `pipeline.bone_rigs.rig_of_bones` makes of them; their motion is the result's `skeleton`."""
    body: str = declared(
        "auto", "What it is: human, quadruped (four-legged animals), other, or auto: by rig or shape (mime).",
        ("auto", "human", "quadruped", "other"),
    )  # fmt: skip
    """What both meshes are: "human", "quadruped" (four-legged animals), "other" (creatures and things whose rigs are
    matched with each other), or "auto", found by their rigs or shapes (mime only)."""
    joints: JointCorrections | Mapping[str, Any] | str | Path | None = declared(
        None, f"Joints picked by hand; {GIVEN}", kind=Path | None, metavar="FILE"
    )
    """Positions of some of the identity's joints, where the model finds them wrongly (mime only): joint -> (x, y, z) in
    the axes and unit of its file, or the path of a .joints.json (docs/formats.md). The names are the keys of
    `Result.joints`."""
    driving_joints: JointCorrections | Mapping[str, Any] | str | Path | None = declared(
        None, f"The same of DRIVING; {GIVEN}", kind=Path | None, metavar="FILE"
    )
    """The same of the driving, of a clip in its first frame or in the frame that a file of them names."""

    part: str | None = declared(None, "Part of the mesh that is meant: an object, a group, a node.", metavar="NAME")
    """Name of the part of the identity that is meant, in a file with other people or things: an object, a group, or a
    node with all that is below it. A mesh with a skin stands for its character: all that the same joints move. All
    else stays where it is. By default all, or in a file with the rig of a character what joints carry."""
    driving_part: str | None = declared(None, "The same of DRIVING.", metavar="NAME")
    """The same of the driving; all else is not looked at."""

    def __post_init__(self) -> None:
        """Raise InputError for an axis that is none."""
        given = {name: axis for name, axis in zip(AXES, self.axes, strict=True) if axis is not None}
        if given:
            from .normalization import parse_axis

            for name, axis in given.items():
                parse_axis(axis, option(name))

    @property
    def axes(self) -> tuple[str | None, str | None, str | None, str | None]:
        """Up and front of the identity, up and front of the driving; None is detected."""
        return self.up, self.front, self.driving_up, self.driving_front

    def check_single(self) -> None:
        """Check that there is no hint on a driving, where there is one mesh or clip.

        Raises:
            InputError: there is one.

        Example:
            >>> mimesh.Hints(up="+y").check_single()
        """
        for name in ("driving_up", "driving_front", "driving_joints", "driving_part"):
            if getattr(self, name) is not None:
                raise InputError(f"{name}: expected hints on one mesh or clip, found this; leave `driving_` out")


@options
@dataclass(frozen=True)
class FrameRange:
    """Which frames of a clip are taken, and their rate.

    Example:
        >>> mimesh.FrameRange(stop=60, step=2).slice
        slice(0, 60, 2)
    """

    start: int = declared(0, "First frame to take, counted from 0.")
    """First frame to take, counted from 0."""
    stop: int | None = declared(None, "Frame to stop before.")
    """Frame to stop before; None takes all."""
    step: int = declared(1, "Take every so many frames.")
    """Take every `step`-th frame; the result then has the rate fps / step, so that its speed is the clip's."""
    fps: float | None = declared(None, "Frames a second: files with times are sampled at it, others are played at it.")
    """Frames a second: files with times are sampled at it and keep their duration, others are played at it."""

    def __post_init__(self) -> None:
        """Raise InputError if frames are counted from the end."""
        for name, frame in (("start", self.start), ("stop", self.stop)):
            if frame is not None and frame < 0:
                raise InputError(
                    f"{option(name)}: expected a frame counted from 0, found {frame}; count from the first"
                )

    @property
    def slice(self) -> slice:
        """The frames that are taken."""
        return slice(self.start, self.stop, self.step)


@options
@dataclass(frozen=True)
class MotionOptions:
    """How joints move. A model without joints refuses what needs them, but `ground` and `contacts`, which do nothing.

    Example:
        >>> mimesh.MotionOptions(root="drop").root
        'drop'
    """

    root: str = declared(
        "scale", "How far the result goes: scale (as its legs make it); keep (as DRIVING), drop (in place; both mime).",
        ("scale", "keep", "drop"),
    )  # fmt: skip
    """Displacement over the ground: "scale", the driving's scaled by leg length; "keep", the driving's; "drop",
    none."""
    ground: bool = declared(
        True, "Plant soles where DRIVING's stand, by root path and legs (mime).", name="--ground/--no-ground"
    )
    """Plant soles where the driving's stand, by the root path and the legs. They slide as far as the driving's do, in
    units of the identity's size. With `root` "keep" only the legs are corrected, with "drop" only heights. Has no
    effect on a single pose, nor with a model without joints."""
    smooth: float = declared(0.0, "Average the motion of joints over time (mime).", metavar="SECONDS")
    """Standard deviation (seconds) of a Gaussian filter over rotations and root positions."""
    skinned: bool | None = declared(
        False, "Write joints (.glb, .gltf, .fbx; the default of mime) also of a single pose.", name="--skinned",
        kind=bool,
    )  # fmt: skip
    """Move each vertex by its largest weights only, so that the frames are those of the file that `save_skinned`
    writes, and raise an error at once if the model has no joints. How far vertices are then from where all weights
    take them, over the mesh's size, is in the report ("influence_deviation"). None does so for clips of more than one
    frame, if the model has joints."""
    influences: int = declared(
        4, "Weights a vertex of joints found: 4, or 8 where the engine reads so many (mime).", metavar="N"
    )
    """Weights a vertex of joints that were found, in files: 4, which all readers of glTF support, or 8, of which four
    are in a second set of attributes. A file's own rig keeps its weights."""
    contacts: bool = declared(
        True,
        "Keep hands where DRIVING's touch its body, and arms out of the own (mime).",
        name="--contacts/--no-contacts",
    )
    """Move arms so that hands touch the own body, and each other, where the driving's do, whatever the girth, and are
    not inside it where the driving's are not. Of people alone; has no effect with a model without joints."""

    def __post_init__(self) -> None:
        """Raise InputError if a time or a number of weights is not allowed."""
        check_influences(self.influences)
        if not 0 <= self.smooth <= LONGEST_SMOOTHING:
            found = f"expected seconds from 0 to {LONGEST_SMOOTHING:g}, found {self.smooth:g}"
            raise InputError(f"{option('smooth')}: {found}; try 0.05")

    @property
    def changes_motion(self) -> bool:
        """Whether the result differs from the driving's motion on the same skeleton."""
        return self.root != "scale" or self.smooth > 0

    def refuse_without_joints(self, model: str) -> None:
        """Check that no value needs joints, which a model has not.

        Args:
            model: its name.

        Raises:
            InputError: one does.

        Example:
            >>> mimesh.MotionOptions(ground=False).refuse_without_joints("npt")
        """
        for field in dataclasses.fields(self):
            if field.name not in ("ground", "contacts") and getattr(self, field.name) not in (field.default, None):
                raise needs_joints(field.name, model)


def check_influences(count: int) -> None:
    """Raise InputError for another number of weights a vertex than files of joints may have."""
    if count not in (4, 8):
        raise InputError(f"{option('influences')}: expected 4 or 8 weights a vertex, found {count}; choose one of them")


def needs_joints(name: str, model: str) -> InputError:
    """Return the error of an option that needs a model with joints."""
    found = f"{option(name)}: expected a model with joints (mime), found {model}"
    return InputError(f"{found}; choose another with {option('model', ...)}")


@options
@dataclass(frozen=True, eq=False)
class ModelOptions:
    """Options of a model that is given by a name or a path; those of `npt` and others that move vertices but `seed`.

    Example:
        >>> mimesh.ModelOptions(pairing="order").pairing
        'order'
    """

    ensemble: int = declared(1, "Average over this many random pairings (npt, aniformer).")
    """Average over this many random pairings (index-paired networks only)."""
    pairing: str = declared(
        "auto",
        "Pair vertices at random, by order (two shapes of one mesh), or auto: by order "
        "where both have the same triangles (npt, aniformer).",
        ("auto", "random", "order"),
    )
    """Driving vertex of each of the identity's (npt and aniformer only): "random"; "order", that of its own index, of
    two shapes of one mesh; or "auto", by index where both have the same triangles and there is a network for it."""
    refine: bool | None = declared(
        None, "Smooth the result along IDENTITY's surface; by default npt, aniformer.", name="--refine/--no-refine"
    )
    """Smooth the result, keeping the identity's surface details; None leaves it to the model."""
    reference: Mesh | str | Path | None = declared(
        None, "The driving mesh in IDENTITY's pose (deformation-transfer).", kind=Path | None, metavar="MESH"
    )
    """The driving mesh in the identity's pose (deformation transfer only)."""
    markers: Any = declared(
        None, "Lines 'identity driving' of corresponding vertices (deformation-transfer).", kind=Path | None,
        metavar="FILE",
    )  # fmt: skip
    """Pairs (identity vertex, driving vertex) that correspond, or a file of them (deformation transfer only)."""
    seed: int = declared(0, "Seed of everything random.", min=0)
    """Seed of all random choices of the model."""


@options
@dataclass(frozen=True)
class Layout:
    """How the joints of a file are arranged for an engine.

    Example:
        >>> mimesh.Layout("unreal", root_bone=True, fps=30.0).names
        'unreal'
    """

    names: str = declared(
        "own", "Bone names and hierarchy: mixamo, unreal, vrm, godot or rigify; own keeps the names.",
        ("own", "mixamo", "unreal", "vrm", "godot", "rigify"), metavar="SCHEME",
    )  # fmt: skip
    """A scheme of `bodies.engine_names`; "own" keeps the names. Bones of the identity's own rig are renamed where they
    are."""
    root_bone: bool = declared(
        False, "Put the way over the ground on a bone above all others; own rigs get one, or use theirs.",
        name="--root-bone",
    )  # fmt: skip
    """Add a bone on the ground that carries the displacement over it; the hips keep the rest."""
    rest: str = declared(
        "file", "Pose the skeleton is bound in: file, T or A (not with own rigs).", ("file", "T", "A"), metavar="POSE"
    )
    """Pose that mesh and bones are bound in: that of the identity's "file", "T" or "A"; own rigs have the file's."""
    fps: float | None = declared(
        None, "Frame rate of the joints written, sampled from DRIVING's: 30, 60.", name="--output-fps"
    )
    """Frames a second of the file, sampled from the motion's; None keeps its rate."""

    def __post_init__(self) -> None:
        """Raise InputError if a rate is not allowed."""
        if self.fps is not None:
            from .arguments import check_rate

            check_rate(self.fps, option("output_fps"), "give for example 30")


@dataclass(frozen=True)
class RenderOptions:
    """What `mimesh render` draws, and how."""

    sheet: bool = declared(False, "Each file once, in rows.", name="--sheet")
    strip: bool = declared(False, "Frames of each clip side by side.", name="--strip")
    turntable: bool = declared(False, "A movie of one mesh from all sides.", name="--turntable")
    truth: Path | None = declared(None, "Heat map of the distance to this mesh or clip, in mm if files are in metres.")
    track: bool = declared(False, "In movies, the camera goes along.", name="--track")
    view: str = declared("three-quarter", "three-quarter, front, side, left, right, back or top.")
    size: int = declared(480, "Height of one picture in pixels.", min=32, max=4096)
    width: int | None = declared(None, "Width of one picture in pixels.", min=32, max=4096)
    """None leaves it to the kind of picture."""
    background: str = declared("paper", "paper, white, dark, none (.png) or #rrggbb.")
    labels: bool = declared(True, "Captions below pictures.", name="--labels/--no-labels")
    clay: bool = declared(False, "Leave materials and textures out.", name="--clay")
    up: str = declared("y", "Axis away from the floor: x, y, z, -x, -y, -z.")
    front: str | None = declared(None, "Axis that faces the front.")

    def tile(self, aspect: float) -> tuple[int, int]:
        """Return width and height of one picture; `aspect` is their ratio if the width is not given."""
        return self.width or round(self.size * aspect), self.size


@dataclass(frozen=True)
class RecordedRange(FrameRange):
    """Which frames of a clip are taken, and the body model of archives that have none."""

    body_model: Path | None = declared(
        None, "SMPL's, SMPL+H's ... (.pkl .npz): AMASS archives become its surface.", metavar="FILE"
    )
    """File of a body model, with which a file is read as the recorded surface (`load_recorded_clip`)."""


@dataclass(frozen=True)
class ConvertOptions(RecordedRange):
    """Which clip of a file `mimesh convert` reads, which of its frames, and what it writes."""

    animation: str | None = declared(None, "Which animation of a GLB: its name or number.")
    frame: int | None = declared(None, "This frame alone, counted from 0.")
    frames_as: str | None = declared(None, "In a folder: obj or ply.", metavar="SUFFIX")
    morphs: bool = declared(False, "Write a morph target a frame, not bones (.glb, .gltf).", name="--morphs")
    """Write a .glb or .gltf with a morph target for each frame, where IN has bones, which are kept by default."""
    up: str | None = declared(None, "Up axis of IN (OBJ, PLY, STL): formats with y up are written standing.",
        metavar="AXIS")  # fmt: skip
    """Axis of IN away from the ground, where its file defines none: formats that have y up are written standing."""
    betas: str | None = declared(
        None, "Person who moves, with --body-model: numbers with commas, or an .npz.", metavar="B"
    )
    """Shape coefficients of the person who moves, see `parse_betas`; None: of the one recorded."""


@dataclass(frozen=True)
class MeasureOptions:
    """How `mimesh evaluate` measures models."""

    ensemble: int = declared(1, "Average over this many random pairings (NPT).", min=1)
    refine: bool = declared(False, "Smooth results along the identity's surface.", name="--refine")
    height: float | None = declared(
        None, "Lists: a person's height at rest in the files' unit, for millimetres.", metavar="H"
    )
    """Height of the identities of a list at rest, in the unit of its files; see `ListedPairs.height`."""
    fps: float | None = declared(None, "Lists: frames per second of the clips.")
    """Frames per second of the clips of a list; None: those of the files."""


@dataclass(frozen=True)
class TrainingFiles:
    """What the user brings to a training."""

    characters: Path | None = declared(
        None, "Folder of rigged .glb, .gltf, .vrm, .fbx or of a pool to train on.", metavar="DIR"
    )
    clips: Path | None = declared(None, "Folder of .glb, .fbx, .bvh or AMASS motions to train mime on.", metavar="DIR")
    leave_out: list[str] | None = declared(None, "Pack (sub-folder) of --characters that is not used.", metavar="PACK")
    meshes: Path | None = declared(
        None, "Folder of registered meshes (npt) or clips (aniformer) to train on.", metavar="DIR"
    )
    pattern: str = declared("", "How the files of --meshes are named, such as '{person}-{pose}.ply'.")
