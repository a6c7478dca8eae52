"""Notes on what a file that is written does not keep, and on what was taken of a file that was read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import option
from ..core.mesh import Mesh, RewritableSource
from ..core.normalization import clear_up
from ..core.printable import shell_line
from ..io.formats import CACHE, FORMATS, JOINTED, MORPHED, MOTIONS
from ..io.polygons import smooth_normals
from ..io.timing import DEFAULT_FPS, ON_GRID, frame_count

if TYPE_CHECKING:
    from ..io.gltf.own_animation import OwnAnimation

LARGE = 256 * 2**20
"""Bytes of a clip from which on a note says how to make it smaller."""
PERSON = (1.4, 2.1)
"""Longest side (metres) of a standing person, arms spread or not: smallest and largest."""
FIGURE = (0.3, 4.0)
"""Size (metres) of figures of people: dwarfs and giants of games."""
ANIMAL = {"m": 10.0, "cm": 500.0, "mm": 5000.0}
"""Unit -> longest side of an animal in it, at most."""
UNITS = (("m", 1.0), ("dm", 0.1), ("cm", 0.01), ("mm", 0.001), ("inch", 0.0254))
"""Names of units, and their length in metres."""
NOTED_LIMITING = 0.02
"""Distance over the mesh's size from which on a note tells the effect of four weights a vertex: that of 10 of 12
characters of the pool (train and val) is below, 0.002 to 0.013; means over all vertices are below 0.001 for all."""
NOTED_DEVIATION = 1e-3
"""Distance over the mesh's size of a skinned file's vertex from its frame, from which on a note tells it."""
DEVIATION_CAUSES = {
    "rest": ": the mesh is bound in another pose than the file's; that of the file is exact",
    "fingers": ": fingers that only other clips move follow the hand",
    "weights": ": files of joints have few weights a vertex",
}
"""What a note says about the `deviation_cause` of a report."""


def not_kept(mesh: Mesh, path: Path, body: str | None = None) -> tuple[str, ...]:
    """Return notes on what the format of a path changes of a mesh: its axes, its unit, and attributes that are lost.

    Args:
        body: what the mesh is known to be, see `Hints.body`.
    """
    suffix = path.suffix.lower()
    if isinstance(mesh.source, RewritableSource) and mesh.source.suffix == suffix:
        return ()
    turned = _turned_note(mesh, path) + (() if body == "other" else _metres_note(mesh, path, body))
    materials = {part.material for part in mesh.parts}
    is_image = len(materials) == 1 and any(material and material.texture for material in materials)
    has = {
        "materials": any(part.material for part in mesh.parts),
        "materials besides one image": any(materials) and not is_image,
        "normals of hard edges": mesh.corner_normals is not None and smooth_normals(mesh) is None,
        "texture coordinates": mesh.corner_uv is not None,
        "normals": mesh.corner_normals is not None,
        "vertex colours": mesh.vertex_colors is not None,
    }
    lacks = FORMATS[suffix].lacks if suffix in FORMATS else ()  # movies and folders of frames are none
    missing = [name for name in lacks if has[name]]
    if not missing:
        return turned
    return (*turned, f"{suffix} files as written here hold no {' or '.join(missing)}: left out of {path.name}")


def _turned_note(mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Return a note that a mesh is written turned to y up; files that state their axes (USD) are no surprise."""
    turned = mesh.up not in (None, "+y") and not hasattr(mesh.source, "up_axis")
    if not turned or path.suffix.lower() not in JOINTED:
        return ()
    return (f"{mesh.name} has up {mesh.up}: {path.name} is turned to +y, which its format has up",)


def _metres_note(mesh: Mesh, path: Path, body: str | None) -> tuple[str, ...]:
    """Return a note on a person of no person's size in a format in metres, unless the mesh's own file has a unit.

    The same of animals, of many sizes: only centimetres and millimetres are told. Sizes that fit no unit are told of
    what is known to be a person.

    glTF files are in metres, too, whatever they should be in: only a .vrm, which is a person, gets a note on them. USD
    states a unit, which is the metre where the mesh's own file has none.
    """
    suffix, own = path.suffix.lower(), getattr(mesh.source, "suffix", "")
    in_metres = suffix in JOINTED or suffix.startswith(".usd")
    if not in_metres or hasattr(mesh.source, "meters_per_unit") or (own in JOINTED and suffix != ".vrm"):
        return ()
    animal = body == "quadruped"
    sides = np.ptp(mesh.vertices, axis=0)  # of a person who stands the height: floors are wider
    longest = float(sides.max() if animal or mesh.up is None else sides["xyz".index(mesh.up[-1])])
    unit = unit_guess(longest) if not animal else next((u for u, sizes in ANIMAL.items() if longest < sizes), None)
    if unit is None and body == "human" and not FIGURE[0] <= longest <= FIGURE[1]:
        return (f"{mesh.name} measures {longest:.4g}, which {path.name} has in metres: no person's size; scale it",)
    if unit in (None, "m"):
        return ()
    kind = "an animal" if animal else "a person"
    return (
        f"{mesh.name} measures {longest:.4g}, which {path.name} has in metres: {kind}, if its unit is {unit}; "
        f"scale by {dict(UNITS)[unit]:g} on import",
    )


def unit_guess(longest: float) -> str | None:
    """Return the unit in which the longest side is a person's height; the ranges of two units do not overlap."""
    return next((unit for unit, metres in UNITS if PERSON[0] <= longest * metres <= PERSON[1]), None)


def lying_note(mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Return a note that a figure lies in a format with y up, as far as its shape tells."""
    if mesh.up is not None or path.suffix.lower() not in JOINTED or not len(mesh.faces):
        return ()
    up = clear_up(mesh)
    if up in (None, "+y"):
        return ()
    return (f"{path.name} has y up, its shape looks like up {up}: {option('up', up)} turns it",)


def skinned_note(report: Mapping[str, Any]) -> tuple[str, ...]:
    """Return notes on how far the vertices of a skinned file are from those that all weights and joints would give."""
    limited, written = (report.get(f"{key}_deviation") or 0.0 for key in ("influence", "skinned"))
    notes = ()
    if limited >= NOTED_LIMITING:
        notes += (
            f"the few weights a vertex that files of joints have move a vertex by up to {limited:.2g} of the mesh's "
            "size; --influences 8 keeps more, --morphs writes frames of all weights",
        )
    if written >= NOTED_DEVIATION:
        cause = DEVIATION_CAUSES.get(report.get("deviation_cause", ""), "")
        notes += (f"a vertex of the file is up to {written:.2g} of the mesh's size from its frame{cause}",)
    return notes


def hierarchy_note(own: OwnAnimation | None, scheme: str, name: str) -> tuple[str, ...]:
    """Return a note on bones of an identity's own rig that hang on others than in a humanoid, if a scheme renames them.

    Args:
        own: the motion on the bones of the identity's file; None: other bones are written.
    """
    if own is None or scheme == "own":
        return ()
    from ..io.gltf.scene import node_parents
    from ..motions.bone_motion import misplaced_bones

    misplaced = misplaced_bones(own.joints, node_parents(own.source.document))
    if not misplaced:
        return ()
    return (
        f"{name}: in the hierarchy of its rig {', '.join(misplaced)} are below other bones than in a humanoid; "
        "programs that map a humanoid by its hierarchy may refuse it, or turn these wrongly; "
        f"{option('rig', 'mimesh')} writes joints of a humanoid's hierarchy",
    )


def posed_vrm_note(path: Path) -> tuple[str, ...]:
    """Return a note that a .vrm in a pose is not what programs expect: VRM demands a T-pose at rest (tpose.md)."""
    if path.suffix.lower() != ".vrm":
        return ()
    return (f"{path.name} rests in the pose, programs that animate a .vrm expect a T-pose: write a .glb for a pose",)


def size_note(path: Path) -> tuple[str, ...]:
    """Return a note on how to make a clip smaller, if its file is large."""
    if not path.is_file() or (size := path.stat().st_size) < LARGE:
        return ()
    joints = ", and --skinned writes joints instead of frames" if path.suffix.lower() in MORPHED else ""
    return (f"{path.name} has {size / 2**20:,.0f} MiB: --step takes fewer frames{joints}",)


def rate_note(fps: float, path: Path) -> tuple[str, ...]:
    """Return a note that a format has no frame rate, unless the rate is the one that is assumed by default."""
    suffix = path.suffix.lower()
    if (suffix and suffix != CACHE) or fps == DEFAULT_FPS:
        return ()
    return (f"{suffix or 'folders of'} files have no frame rate: read {path.name} with --fps {fps:g}",)


def resampled_note(frames: int, fps: float, output_fps: float | None) -> tuple[str, ...]:
    """Return a note that a file has another frame rate than the frames that are written; None keeps theirs."""
    if output_fps is None or output_fps == fps:
        return ()
    seconds = (frames - 1) / fps
    lost = seconds - (frame_count(seconds, output_fps) - 1) / output_fps
    cut = f": its last {lost:.2g} s, less than a frame, are left out" * (lost * output_fps > ON_GRID)
    return (f"sampled from {frames_at(frames, fps)}{cut}",)


def frames_at(frames: int, fps: float) -> str:
    """Return the length of a clip in words."""
    return f"{frames} {'frame' if frames == 1 else 'frames'} at {fps:g} per second"


def has_joints_alone(path: Path) -> bool:
    """Return whether a file of one mesh is read as mimesh's own body."""
    if path.suffix.lower() != ".npz":
        return path.suffix.lower() in MOTIONS
    from ..motions.on_body import is_motion_file

    return is_motion_file(path)


def own_body_note(path: Path) -> tuple[str, ...]:
    """Return a note if a file of one mesh is read as mimesh's own body."""
    if not has_joints_alone(path):
        return ()
    return (f"{path.name} has joints and no mesh: mimesh's own body in its first frame is taken",)


def taken_pose_note(mesh: Mesh, path: Path) -> tuple[str, ...]:
    """Return a note on which pose a single mesh was read in, if its file moves."""
    if note := own_body_note(path):
        return note
    if getattr(mesh.source, "animations", ()):
        command = shell_line("mimesh", "convert", path.name, "pose.obj", "--frame", "N")
        return (f"{path.name} has an animation: its mesh at rest is taken; for another pose, {command}",)
    return ()
