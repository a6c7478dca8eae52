"""Write the meshes and clips of a protocol as files, named like the public NPT data: id<person>_<pose>.obj.

`scripts/generate_on_body_model.py` writes those of a body model that the user has a licence of.
"""

from __future__ import annotations

import dataclasses
import itertools
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from ..core.frame_buffer import Progress, counted
from ..core.mesh import Clip, Mesh
from ..io import save_clip, save_mesh
from .clip_protocols import ClipPair
from .listed_pairs import SUFFIX, ListedPairs, write_list
from .protocols import HUMAN_NPT, SPLITS, HumanNpt, Protocol
from .run import find_protocol

CLIP_SUFFIX = ".npz"
"""Format of clips: it keeps every digit, and the frame rate."""
Content = Callable[[], Mesh | Clip]
"""Makes what is written to a file."""


def generate_command(
    protocol: str,
    out: Path,
    split: str = "test",
    pairs: int = 0,
    progress: Progress | None = None,
    data: Path | None = None,
) -> dict[str, int]:
    """Do what `mimesh generate` does: write the meshes of a split (`write_split`), and return the number of files.

    Raises:
        InputError: no such protocol or split, missing data, or `train` of another protocol than human-npt.
    """
    chosen = find_protocol(protocol, data)
    if isinstance(chosen, ListedPairs):
        raise InputError(f"{protocol}: expected a protocol by its name, found a list or a folder; name one")
    if split not in SPLITS:
        raise InputError(f"{split}: expected a split ({', '.join(SPLITS)}), found another; check the name")
    if split != "train":
        return write_split(chosen, out, split, pairs, progress)
    if not isinstance(chosen, HumanNpt) or chosen.name != HUMAN_NPT.name:
        raise InputError(
            f"{chosen.name}: expected {HUMAN_NPT.name} for the split train, found a test set without training data; "
            "choose val or test"
        )
    return write_training(training_meshes(chosen, pairs), out, progress)


def write_split(
    chosen: Protocol, out: Path, split: str, pairs: int = 0, progress: Progress | None = None
) -> dict[str, int]:
    """Write the meshes of `val` or `test` and return the number of files.

    Each kind of pair gets a list `<split>-<kind>.txt` with one line "identity driving truth" per pair, the heights of
    the identities, and a folder with these meshes; kinds without known true results are left out. Driving and truth of
    a protocol of clips are clips. Vertices are in the body's order in all of them, as in the public data:
    shuffle before use.

    Args:
        pairs: number of pairs of each kind; 0 for the protocol's own.
    """
    chosen.check(split)
    # The first pair of a kind says whether true results are known: all pairs of a kind agree.
    first = {kind: chosen.unshuffled_pair(split, kind, 0, chosen.rng(split, kind, 0)) for kind in chosen.kinds}
    counts = {kind: chosen.count(kind, pairs, split) for kind in chosen.kinds if first[kind].truth_known}
    done = 0
    for kind, count in counts.items():
        triples, heights, written = [], {}, {}
        for i in range(count):
            pair = chosen.unshuffled_pair(split, kind, i, chosen.rng(split, kind, i))
            folder = out / f"{split}-{kind}"
            folder.mkdir(parents=True, exist_ok=True)
            truth = Mesh(pair.truth, pair.identity.faces, name=pair.truth_name)
            parts: tuple[Mesh | Clip, ...] = (pair.identity, pair.driving, truth)
            if isinstance(pair, ClipPair):
                frames = dataclasses.replace(pair.clip, mesh=truth, vertices=pair.truth_frames)
                parts = (pair.identity, pair.clip, frames)
            identity, driving, true = (f"{folder.name}/{_write(part, folder, written)}" for part in parts)
            triples.append((identity, driving, true))
            heights[triples[-1][0]] = pair.height
            done += 1
            if progress is not None:
                progress(done, sum(counts.values()))
        write_list(out / f"{split}-{kind}{SUFFIX}", triples, heights)
    folders = [out / f"{split}-{kind}" for kind in counts]
    return {"files": sum(path.is_file() for folder in folders for path in folder.rglob("*")) + 2 * len(counts)}


def _write(part: Mesh | Clip, folder: Path, written: dict[str, int]) -> str:
    """Write a mesh or a clip under its own name, with a number behind it where that is another's; return the name."""
    mesh = part.mesh if isinstance(part, Clip) else part
    # A point cloud has no faces and so cannot be written as OBJ; PLY stores both.
    suffix = CLIP_SUFFIX if isinstance(part, Clip) else ".obj" if len(mesh.faces) else ".ply"
    content = zlib.crc32(np.asarray(part.vertices).tobytes())
    names = (f"{mesh.name}{f'-{k}' if k > 1 else ''}{suffix}" for k in itertools.count(1))
    name = next(name for name in names if written.setdefault(name, content) == content)
    if isinstance(part, Clip):
        save_clip(part, folder / name)
    else:
        save_mesh(part, folder / name)
    return name


def training_meshes(protocol: HumanNpt, count: int) -> dict[str, Content]:
    """List the training meshes of a protocol: name of each file and how its content is made.

    Args:
        count: number of poses of each person; 0 for all.
    """
    people = [protocol.person("train", i) for i in range(protocol.people)]
    poses = [protocol.pose("train", i) for i in range(min(count, protocol.poses) or protocol.poses)]
    return {f"id{p.label}_{q.label}.obj": lambda p=p, q=q: p.posed_mesh(q) for p in people for q in poses}


def write_training(contents: dict[str, Content], out: Path, progress: Progress | None = None) -> dict[str, int]:
    """Write the files that are not there yet, so that a stopped run goes on; `kept` counts the others."""
    kept = 0
    for name, make in counted(contents.items(), len(contents), progress):
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            kept += 1
        elif isinstance(content := make(), Clip):
            save_clip(content, path)
        else:
            save_mesh(content, path)
    return {"files": len(contents), "kept": kept}
