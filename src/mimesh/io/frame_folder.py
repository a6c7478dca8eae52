"""Read and write a clip as a folder of numbered mesh files: walk_0001.obj, walk_0002.obj, ..."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.budgets import check_clip_size
from ..core.errors import InputError, OtherTopologyError
from ..core.frame_buffer import Progress, each_frame, store_frames
from ..core.mesh import Clip, Mesh
from .atomic import whole_folder
from .formats import FORMATS
from .obj import ObjSource, read_obj_points

OTHER_FRAMES = {".glb", *(suffix for suffix, format in FORMATS.items() if format.one_mesh)}
"""Formats whose numbered meshes would be mistaken for a second series beside the frames that are written."""
_NUMBER = re.compile(r"\d+")


def read_sequence(
    folder: Path, fps: float, suffixes: Collection[str], read: Callable[[Path], Mesh], progress: Progress | None = None
) -> Clip:
    """Read the numbered meshes of a folder as one clip, in the order of their numbers.

    Files of other kinds, hidden files and files without a number are ignored. Of several series (another suffix or
    another name around the number) the longest is read. Later OBJ frames that differ only in their points are read by a
    fast path. Vertices of an STL that touch in one frame alone give it another topology.

    Raises:
        OtherTopologyError: a frame of another topology.
        InputError: no numbered meshes, or two series of equal length.
    """
    paths = find_frames(folder, suffixes)
    first = read(paths[0])
    check_clip_size(len(paths), len(first.vertices), folder)
    advice = "export all frames from one mesh, or give the folder to animate or capture, which take scans"
    later = (read_frame(path, first, paths[0], read, advice) for path in paths[1:])
    frames = itertools.chain([first.vertices], later)
    return Clip(first, store_frames(frames, len(paths), len(first.vertices), progress=progress), fps)


def find_frames(folder: Path, suffixes: Collection[str]) -> list[Path]:
    """Find the longest series of numbered meshes with one name and suffix, in natural order (2 before 10)."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.is_file()]
    visible = [path for path in files if not path.name.startswith(".")]
    series = Counter(_series(path) for path in visible if _NUMBER.search(path.stem))
    ranked = series.most_common(2)
    if not ranked:
        known = f"(one of {' '.join(sorted(suffixes))})"
        found = f"{len(visible)} meshes without a number; number the files {known}"
        if not visible:
            found = f"no mesh in the folder {known}; check the path"
        raise InputError(f"{folder}: expected numbered meshes such as 0001.obj, found {found}")
    if len(ranked) == 2 and ranked[0][1] == ranked[1][1]:
        both = " and ".join(name for name, _ in ranked)
        raise InputError(
            f"{folder}: expected one series of numbered meshes, found {both} with {ranked[0][1]} each; "
            "move one of them to another folder"
        )
    # All numbers in the name are compared, so that shot2_0001 comes after shot1_0002.
    chosen = [path for path in visible if _NUMBER.search(path.stem) and _series(path) == ranked[0][0]]
    return sorted(chosen, key=lambda path: ([int(digits) for digits in _NUMBER.findall(path.stem)], path.name))


def write_sequence(
    clip: Clip,
    folder: Path,
    suffix: str,
    write: Callable[[Mesh, Path], None],
    read: Callable[[Path], Mesh],
    progress: Progress | None = None,
) -> None:
    """Write each frame as a mesh file 0000, 0001, ... of the given suffix.

    `write` writes PLY frames. OBJ frames are the file that the mesh was read from with other points. Where that was no
    OBJ, `write` writes the first frame and `read` reads it, so that all frames share its materials. Frames of these
    names are overwritten, other files stay.

    Raises:
        InputError: the folder has numbered meshes that would be mistaken for further frames.
    """
    names = [f"{t:0{max(4, len(str(len(clip) - 1)))}d}{suffix}" for t in range(len(clip))]
    _check_other_frames(folder, names, suffix)
    with whole_folder(folder) as temporary:
        mesh = clip.mesh
        if suffix == ".obj" and not isinstance(mesh.source, ObjSource):
            # Reading the first frame gives a source that writes the other frames without formatting faces again.
            write(mesh.with_vertices(clip.vertices[0]), temporary / names[0])
            mesh = read(temporary / names[0])
        write_frame = mesh.source.write if isinstance(mesh.source, ObjSource) and suffix == ".obj" else write
        for name, vertices in zip(names, each_frame(clip.vertices, progress), strict=True):
            write_frame(mesh.with_vertices(vertices), temporary / name)


def _check_other_frames(folder: Path, names: list[str], suffix: str) -> None:
    """Raise InputError where a folder has numbered meshes that `read_sequence` would mix up with frames `names`."""
    numbered = [path.name for path in folder.glob(f"*{suffix}") if _NUMBER.search(path.stem)] if folder.is_dir() else []
    stale = set(numbered) - set(names)
    if stale:
        raise InputError(
            f"{folder}: expected a folder without other numbered {suffix} files, found {min(stale)}; "
            "choose a new folder or delete the old frames"
        )
    stems = {Path(name).stem for name in names}
    twins = [path.name for path in folder.glob("*") if path.suffix in OTHER_FRAMES - {suffix} and path.stem in stems]
    if twins:
        raise InputError(
            f"{folder}: expected a folder without frames in another format, found {min(twins)}; "
            "choose a new folder or delete the old frames"
        )
    files = {path.name for path in folder.glob("*")}
    meshes = [name for name in files if Path(name).suffix.lower() in OTHER_FRAMES | {suffix}]
    if meshes and not files & set(names):  # a folder of meshes, which frames among them would spoil
        raise InputError(f"{folder}: expected a new folder for frames, found {min(meshes)} in it; choose another name")


def _series(path: Path) -> str:
    """Return the name of a file with its numbers replaced, equal for all files of one series."""
    return _NUMBER.sub("#", path.stem) + path.suffix.lower()


def read_frame(
    path: Path,
    first: Mesh,
    first_path: Path,
    read: Callable[[Path], Mesh],
    advice: str = "export all frames from one mesh",
) -> Float[np.ndarray, "V 3"]:
    """Read the vertices of a mesh that has the topology of a first one, by the format's fast path where possible.

    Raises:
        OtherTopologyError: its topology differs from that of the first frame.
        InputError: the frame cannot be read.
    """
    points = read_obj_points(path, first.source) if isinstance(first.source, ObjSource) else None
    if points is not None and np.isfinite(points).all():
        return points
    mesh = read(path)
    if len(mesh.vertices) != len(first.vertices) or not np.array_equal(mesh.faces, first.faces):
        raise OtherTopologyError(
            f"{path}: expected the topology of {first_path.name} ({len(first.vertices)} vertices, {len(first.faces)} "
            f"triangles), found {len(mesh.vertices)} vertices and {len(mesh.faces)} triangles"
            f"{' in another order' if mesh.faces.shape == first.faces.shape else ''}; {advice}"
        )
    return mesh.vertices
