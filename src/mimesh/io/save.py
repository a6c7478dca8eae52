"""Write meshes, clips and rigs in any format, each whole or not at all.

`save_mesh` writes the identity's original file with other points where the output has its suffix and its source can do
so (`mesh.RewritableSource`: OBJ, glTF). `formats` maps suffixes to the functions of each format.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..core.animated_rig import AnimatedRig
from ..core.arguments import public
from ..core.errors import InputError, NotInstalledError
from ..core.frame_buffer import Progress
from ..core.mesh import (
    Clip,
    Mesh,
    RewritableSource,
    check_frames,
    check_numbers,
    check_single_precision,
    check_timing,
    with_printable_names,
)
from .atomic import scratch_folder, together, whole_file, writing
from .formats import (
    CACHE,
    CLIP_WRITERS,
    FRAME_SUFFIXES,
    JOINTED,
    MESH_WRITERS,
    found_suffix,
    gltf_file,
    in_single_precision,
)
from .load import load_mesh
from .mtl import copy_companions
from .obj import ObjSource

if TYPE_CHECKING:
    from ..bodies import RiggedBody
    from ..motions.bone_motion import BoneMotion
    from ..motions.motion import Motion
    from .gltf.own_animation import OwnAnimation
    from .gltf.vrm import VrmMeta


@public
def save_mesh(mesh: Mesh, path: str | Path) -> None:
    """Write a mesh atomically; an OBJ, glTF or NPZ with the suffix of its own file as that file with other points.

    Polygons, texture coordinates, materials, groups, comments and order are then unchanged, and the material libraries
    and images that it refers to are copied beside it unless files of these names exist. Otherwise a new file is
    written, of polygons where the format has them, else of triangles.

    Args:
        mesh: the mesh; its axes and unit are not changed.
        path: the file; folders that do not exist are made.

    Raises:
        InputError: a format that cannot be written, a path that cannot be written to, or a mesh with coordinates that
            are not finite, with indices of vertices that it does not have, or so far from the origin that nothing of it
            is left in the single precision of the format.

    Example:
        >>> mimesh.save_mesh(mimesh.load_mesh("hero.glb"), "hero.ply")
    """
    check_numbers(mesh, mesh.name)
    path, mesh = Path(path), with_printable_names(mesh)
    if isinstance(mesh.source, RewritableSource) and mesh.source.suffix == path.suffix.lower():
        with writing(path), together():
            with whole_file(path) as temporary:
                mesh.source.write(mesh, temporary)
            _copy_companions(mesh, path.parent)
    else:
        if path.suffix.lower() not in MESH_WRITERS:
            raise InputError(
                f"{path}: expected an output in one of {' '.join(MESH_WRITERS)}, {found_suffix(path)}; name another"
            )
        if in_single_precision(mesh, path):
            check_single_precision(mesh, path)
        writer = MESH_WRITERS[path.suffix.lower()]
        with writing(path), together():
            writer(mesh, path)


@public
def save_clip(clip: Clip, path: str | Path, *, suffix: str | None = None, progress: Progress | None = None) -> None:
    """Write a clip as one file or, for a path without a suffix, as a folder of numbered meshes.

    Args:
        clip: the clip; its axes and unit are not changed.
        path: the file, or a folder; folders that do not exist are made.
        suffix: format of the frames in a folder, .obj or .ply; by default that of the mesh's source, else .obj.
        progress: called with (frames written, frames in all).

    Raises:
        InputError: a format that cannot contain a clip, a path that cannot be written to, or a clip without frames or
            with an impossible frame rate.

    Example:
        >>> mimesh.save_clip(mimesh.load_clip("walk.npz"), "walk.glb")
    """
    check_timing(clip, clip.mesh.name, "give it one: dataclasses.replace(clip, fps=30.0)")
    check_numbers(clip.mesh, clip.mesh.name)
    check_frames(clip, clip.mesh.name)
    path, clip = Path(path), dataclasses.replace(clip, mesh=with_printable_names(clip.mesh))
    if path.is_dir() or not path.suffix:
        _save_folder(clip, path, suffix, progress)
        return
    if path.suffix.lower() not in CLIP_WRITERS:
        raise InputError(
            f"{path}: expected a clip format ({' '.join(CLIP_WRITERS)}) or a folder, found '{path.suffix}'; "
            f"write {path.with_suffix('.glb').name}, or {path.stem} for a folder of one mesh per frame"
        )
    if in_single_precision(clip.mesh, path):
        check_single_precision(clip.mesh, path)
    mesh_path = _mesh_path_of_cache(clip, path) if path.suffix.lower() == CACHE else None
    with writing(path), together():
        CLIP_WRITERS[path.suffix.lower()](clip, path, progress)
        if mesh_path is not None:
            save_mesh(clip.mesh.with_vertices(clip.vertices[0].astype(np.float64)), mesh_path)


def _save_folder(clip: Clip, path: Path, suffix: str | None, progress: Progress | None) -> None:
    """Write a clip as a folder of numbered meshes, with the files that the mesh's source refers to."""
    source_suffix = clip.mesh.source.suffix if clip.mesh.source else ""
    suffix = suffix or (source_suffix if source_suffix in FRAME_SUFFIXES else FRAME_SUFFIXES[0])
    if suffix not in FRAME_SUFFIXES:
        raise InputError(
            f"{path}: expected frames of {' or '.join(FRAME_SUFFIXES)}, found '{suffix}'; choose one of them"
        )
    if path.is_file():
        raise InputError(f"{path}: expected a folder to write frames to, found a file; choose another name")
    with writing(path), together():
        from .frame_folder import write_sequence

        write_sequence(clip, path, suffix, MESH_WRITERS[suffix], load_mesh, progress)
        if source_suffix == suffix:
            _copy_companions(clip.mesh, path)


@contextlib.contextmanager
def joints_file(path: str | Path, animated: bool = True) -> Iterator[Path]:
    """Yield a temporary path for a glTF file with joints, which becomes the file `path` (.fbx by Blender) at the end.

    Args:
        animated: whether the file has an animation, which a .vrm cannot have.
    """
    path = Path(path)
    if animated:
        refuse_vrm(path)
    if path.suffix.lower() not in JOINTED:
        raise InputError(f"{path}: expected .glb, .gltf or .fbx for joints, found '{path.suffix}'; rename it")
    with writing(path), gltf_file(path) as temporary:
        yield temporary


def save_vrma(motions: Sequence[BoneMotion], path: str | Path) -> None:
    """Write motions of the humanoid bones of one skeleton as a VRM animation (.vrma)."""
    from .gltf.vrm import write_vrma

    path = Path(path)
    if path.suffix.lower() != ".vrma":
        raise InputError(f"{path}: expected .vrma for bones alone, found '{path.suffix}'; rename it")
    with writing(path), whole_file(path) as temporary:
        write_vrma(motions, temporary)


def refuse_vrm(path: str | Path) -> None:
    """Raise InputError for an animation in a .vrm: the specifications of VRM have none in it (see `gltf.vrm`)."""
    path = Path(path)
    if path.suffix.lower() == ".vrm":
        raise InputError(
            f"{path}: expected a format for an animation, found .vrm, which holds none by its specification; "
            f"write {path.with_suffix('.vrma').name} (the motion alone) or {path.with_suffix('.glb').name}"
        )


def save_vrm(
    rig: AnimatedRig | OwnAnimation,
    bones: Mapping[str, int],
    meta: VrmMeta,
    turn: Float[np.ndarray, "3 3"],
    origin: Float[np.ndarray, " 3"],
    path: str | Path,
) -> None:
    """Write a person in the T-pose as VRM 1.0: a skinned mesh at rest, or the own file of a mesh in its first frame.

    Args:
        bones: humanoid bone -> joint of the skinned mesh, or node of the file.
        turn: rotation from the axes of the rig to y up, +z front.
        origin: point of the rig on the ground below the hips, which is the origin of the file.
    """
    from .gltf.document import open_document
    from .gltf.own_animation import write_own_pose
    from .gltf.skinned import write_gltf_rig
    from .gltf.vrm import write_vrm

    path = Path(path)
    with writing(path), whole_file(path) as temporary, scratch_folder() as folder:
        glb = folder / "scene.glb"
        if isinstance(rig, AnimatedRig):
            write_gltf_rig(rig, glb)
            nodes = open_document(glb).gltf["skins"][0]["joints"]
            bones = {bone: nodes[joint] for bone, joint in bones.items()}
        else:
            write_own_pose(rig, glb)
        write_vrm(glb, bones, meta, turn, origin, temporary)


def save_whole(source: Path, path: Path, animation: str | None = None) -> None:
    """Write a .glb, .gltf, .vrm or .fbx again as another of these, with its skins, blend shapes and animations.

    Args:
        animation: name or number of the only animation that is kept; None: all are.
    """
    from .gltf.animation import animation_names, find_animation
    from .gltf.document import open_document
    from .gltf.draft import AccessorCopier

    document = open_document(source)
    draft = AccessorCopier(document, whole=True).draft
    if animation is not None:
        number = find_animation(animation_names(document), animation, source)
        draft.gltf["animations"] = [draft.gltf["animations"][number]]
    with writing(path), gltf_file(path) as temporary:
        draft.save(temporary)


def check_writable(path: Path) -> None:
    """Check that what writes a format is installed, before the work is done.

    Raises:
        InputError: an .fbx and no Blender, USD and no usd-core, or an .mp4 and no PyAV.
    """
    suffix = path.suffix.lower()
    if suffix == ".fbx":
        from .fbx.write import find_blender

        find_blender(path)
    elif suffix.startswith(".usd"):
        from .usd import need_library

        need_library(path, "write")
    elif suffix == ".mp4" and importlib.util.find_spec("av") is None:
        raise NotInstalledError(
            f"{path}: expected PyAV to write MP4, found it not installed; pip install 'mimesh[video]', or write a .webp"
        )


def _mesh_path_of_cache(clip: Clip, path: Path) -> Path | None:
    """Return where to write the mesh of a point cache; None where a mesh of its topology exists there already."""
    source_suffix = clip.mesh.source.suffix if clip.mesh.source else ""
    mesh_path = path.with_suffix(source_suffix if source_suffix in FRAME_SUFFIXES else FRAME_SUFFIXES[0])
    if not mesh_path.exists():
        return mesh_path
    existing = load_mesh(mesh_path)
    if len(existing.vertices) != len(clip.mesh.vertices) or not np.array_equal(existing.faces, clip.mesh.faces):
        raise InputError(
            f"{path}: expected {mesh_path.name} to be the mesh it belongs to, found another there; choose another name"
        )
    return None


def _copy_companions(mesh: Mesh, folder: Path) -> None:
    if isinstance(mesh.source, ObjSource):
        copy_companions(mesh.source.companions, mesh.source.path.parent, folder)


ORDER = "ZXY"
"""Order of the rotation channels of every joint: R = R_z R_x R_y, so the last one applies first."""
CENTIMETRES = 100.0
"""File units per metre; most BVH files are in centimetres."""


def save_bvh(motion: Motion, body: RiggedBody, path: str | Path) -> Path:
    """Write a motion on the joints of a body of mean shape, and return the path; y up, centimetres, degrees.

    The rest pose of the file is the body's T-pose. The floor is at the soles of the resting body. Only the root has
    position channels.

    Raises:
        InputError: the motion is for another skeleton, or the path cannot be written to.
    """
    if motion.joint_names != body.joint_names:
        raise InputError(f"{motion.name}: expected a motion of {body.name}, found other joints; retarget it first")
    joints, root = CENTIMETRES * body.joints, CENTIMETRES * (body.joints[0] + motion.root)
    return save_joint_motion(body.joint_names, body.parents, joints, motion.rotmat, root, motion.fps, path)


def save_joint_motion(
    names: tuple[str, ...],
    parents: tuple[int, ...],
    rest: Float[np.ndarray, "J 3"],
    rotmat: Float[np.ndarray, "T J 3 3"],
    root: Float[np.ndarray, "T 3"],
    fps: float,
    path: str | Path,
) -> Path:
    """Write the motion of any skeleton, and return the path; y is up.

    Args:
        parents: index of each joint's parent; -1 for the root, which comes first.
        rest: positions at rest, in the unit of the file.
        rotmat: rotation of each joint in its parent's frame; joints at rest have the axes of the world.
    """
    from scipy.spatial.transform import Rotation

    lines, order, rotations = ["HIERARCHY"], [], " ".join(f"{axis}rotation" for axis in ORDER)

    def offset_line(offset: np.ndarray) -> str:
        return "OFFSET " + " ".join(f"{value:.5f}" for value in offset)

    def add_joint(j: int, indent: str = "") -> None:
        """Append a joint and its descendants to the lines, and their indices, depth first, to `order`."""
        order.append(j)
        parent, children = parents[j], [k for k, other in enumerate(parents) if other == j]
        offset = rest[j] - (rest[parent] if parent >= 0 else 0.0)
        channels = "CHANNELS 3" if parent >= 0 else "CHANNELS 6 Xposition Yposition Zposition"
        lines.extend([f"{indent}{'JOINT' if parent >= 0 else 'ROOT'} {names[j]}", f"{indent}{{"])
        lines.extend([f"{indent}\t{offset_line(offset)}", f"{indent}\t{channels} {rotations}"])
        for child in children:
            add_joint(child, indent + "\t")
        if not children:
            # A leaf needs an end site, which gives its bone a length: half of the parent bone's.
            end = ["End Site", "{", f"\t{offset_line(offset / 2)}", "}"]
            lines.extend(f"{indent}\t{line}" for line in end)
        lines.append(f"{indent}}}")

    add_joint(0)
    angles = Rotation.from_matrix(rotmat[:, order].reshape(-1, 3, 3)).as_euler(ORDER, degrees=True)
    rows = np.concatenate([root, angles.reshape(len(root), -1)], axis=1)
    lines += ["MOTION", f"Frames: {len(root)}", f"Frame Time: {1 / fps:.7f}"]
    lines += [" ".join(f"{value:.5f}" for value in row) for row in rows]
    path = Path(path)
    with writing(path), whole_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="replace", newline="\n")
    return path
