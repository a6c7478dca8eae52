"""Write the meshes and clips of a protocol as files, named like the public NPT data: id<person>_<pose>.obj."""

from __future__ import annotations

import dataclasses
import itertools
import zlib
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from ..core.frame_buffer import Progress, counted
from ..core.mesh import Clip, Mesh
from ..io import save_clip, save_mesh
from ..io.formats import FRAME_SUFFIXES
from .body_models import OnBodyModel, on_body_model, training_files
from .clip_protocols import ClipPair
from .listed_pairs import ListedPairs
from .pairs import Pair
from .protocols import HUMAN_NPT, SPLITS, HumanNpt, Protocol
from .run import find_protocol
from .triples import SUFFIX, write_list

CLIP_SUFFIX = ".npz"
"""Format of clips, unless they are written as folders of frames: it keeps every digit, and the frame rate."""


def generate_command(
    protocol: str,
    out: Path,
    split: str = "test",
    pairs: int = 0,
    progress: Progress | None = None,
    data: Path | None = None,
    frames_as: str | None = None,
    body_model: Path | None = None,
) -> dict[str, int]:
    """Write the meshes of a split (`mimesh generate`) and return the number of files.

    Each kind of pair gets a list `<split>-<kind>.txt` with one line "identity driving truth" per pair, the heights of
    the identities (`triples`), and a folder with these meshes; kinds without known true results are left out. Driving
    and truth of a protocol of clips are clips. Vertices are in the body's order in all of them, as in the public data:
    shuffle before use. The split `train` of human-npt is the table of 16 people x 400 poses; with a body model that of
    clips-aniformer is 16 people x all motions, as `<person>/<motion>.npz`. Files of `train` that exist are kept, so
    that a stopped run goes on; `kept` counts them.

    Args:
        pairs: number of pairs of each kind, of `train` of poses of each person; 0 for the protocol's own.
        data: folder of a protocol that reads one.
        frames_as: ".obj" or ".ply" writes each clip as a folder of frames; None: as CLIP_SUFFIX.
        body_model: file of a body model whose people, or animals, are taken instead of the shipped ones.

    Raises:
        InputError: no such protocol or split, missing data, or `train` of another protocol than human-npt.
    """
    chosen = on_body_model(protocol, body_model, data) if body_model else find_protocol(protocol, data)
    if isinstance(chosen, ListedPairs):
        raise InputError(f"{protocol}: expected a protocol by its name, found a list or a folder; name one")
    if split not in SPLITS:
        raise InputError(f"{split}: expected a split ({', '.join(SPLITS)}), found another; check the name")
    if frames_as not in (None, *FRAME_SUFFIXES):
        raise InputError(f"--frames-as: expected {' or '.join(FRAME_SUFFIXES)}, found {frames_as}; choose one of them")
    if split == "train":
        return _write_training(chosen, out, pairs, progress)
    chosen.check(split)
    counts = {kind: chosen.count(kind, pairs, split) for kind in chosen.kinds if _has_truth(chosen, split, kind)}
    done = 0
    for kind, count in counts.items():
        triples, heights, written = [], {}, {}
        for i in range(count):
            pair = chosen.unshuffled_pair(split, kind, i, chosen.rng(split, kind, i))
            triples.append(_write_pair(pair, out / f"{split}-{kind}", frames_as, written))
            heights[triples[-1][0]] = pair.height
            done += 1
            if progress is not None:
                progress(done, sum(counts.values()))
        write_list(out / f"{split}-{kind}{SUFFIX}", triples, heights)
    folders = [out / f"{split}-{kind}" for kind in counts]
    return {"files": sum(path.is_file() for folder in folders for path in folder.rglob("*")) + 2 * len(counts)}


def _has_truth(protocol: Protocol, split: str, kind: str) -> bool:
    """Return whether the true results of a kind are known, as the first pair says: all pairs of a kind agree."""
    return protocol.unshuffled_pair(split, kind, 0, protocol.rng(split, kind, 0)).truth_known


def _write_pair(pair: Pair, folder: Path, frames_as: str | None, written: dict[str, int]) -> tuple[str, str, str]:
    """Write identity, driving mesh or clip, and truth of a pair and return their names relative to the list.

    `written` has a checksum of what each file of the folder holds, by its name, and is added to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth = Mesh(pair.truth, pair.identity.faces, name=pair.truth_name)
    parts: tuple[Mesh | Clip, ...] = (pair.identity, pair.driving, truth)
    if isinstance(pair, ClipPair):
        parts = (pair.identity, pair.clip, dataclasses.replace(pair.clip, mesh=truth, vertices=pair.truth_frames))
    identity, driving, true = (f"{folder.name}/{_write(part, folder, frames_as, written)}" for part in parts)
    return identity, driving, true


def _write(part: Mesh | Clip, folder: Path, frames_as: str | None, written: dict[str, int]) -> str:
    """Write a mesh or a clip under its own name, with a number behind it where that is another's; return the name."""
    mesh = part.mesh if isinstance(part, Clip) else part
    # A point cloud has no faces and so cannot be written as OBJ; PLY stores both.
    suffix = ".obj" if len(mesh.faces) else ".ply"
    if isinstance(part, Clip):
        suffix = CLIP_SUFFIX if frames_as is None else ""
    content = zlib.crc32(np.asarray(part.vertices).tobytes())
    names = (f"{mesh.name}{f'-{k}' if k > 1 else ''}{suffix}" for k in itertools.count(1))
    name = next(name for name in names if written.setdefault(name, content) == content)
    if isinstance(part, Clip):
        if frames_as is not None:
            (folder / name).mkdir(exist_ok=True)  # names of takes have dots, which would be taken for a suffix
        save_clip(part, folder / name, suffix=frames_as)
    else:
        save_mesh(part, folder / name)
    return name


def _write_training(protocol: Protocol, out: Path, count: int, progress: Progress | None) -> dict[str, int]:
    """Write every training person in every training pose or motion, or the first `count`; files that exist are kept."""
    known = isinstance(protocol, OnBodyModel) or protocol.name == HUMAN_NPT.name
    if not (known and isinstance(protocol, HumanNpt)):
        raise InputError(
            f"{protocol.name}: expected {HUMAN_NPT.name} for the split train, or another with --body-model, found a "
            "test set without training data; choose val or test"
        )
    contents, kept = training_files(protocol, count), 0
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
