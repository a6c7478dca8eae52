"""Write the meshes of a protocol as files, named like the public NPT data: id<person>_<pose>.obj."""

from __future__ import annotations

from pathlib import Path

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.mesh import Mesh
from ..io import save_mesh
from ..io.atomic import whole_file
from .clip_protocols import ClipsAniformer
from .protocols import HUMAN_NPT, SPLITS, HumanNpt, Protocol
from .run import find_protocol


def generate_command(
    protocol: str,
    out: Path,
    split: str = "test",
    pairs: int = 0,
    progress: Progress | None = None,
    data: Path | None = None,
) -> dict[str, int]:
    """Write the meshes of a split (`mimesh generate`) and return the number of files.

    Each kind of pair gets a list `<split>-<kind>.txt` with one line "identity pose truth" per pair, and a folder
    with these meshes; kinds without known true results are left out. Vertices are in the body's order in all of them,
    as in the public data: shuffle before use.
    The split `train` of human-npt is the table of 16 people x 400 poses.

    Args:
        pairs: number of pairs of each kind; 0 for the protocol's own.
        data: folder of a protocol that reads one.

    Raises:
        InputError: no such protocol or split, a protocol of clips, or `train` of another protocol than human-npt.
    """
    chosen = find_protocol(protocol, data)
    if isinstance(chosen, ClipsAniformer):
        raise InputError(f"{protocol}: expected a protocol of meshes, found one of clips; choose another")
    if split not in SPLITS:
        raise InputError(f"{split}: expected a split ({', '.join(SPLITS)}), found another; check the name")
    if split == "train":
        return {"files": _write_table(chosen, out, progress)}
    kinds = [kind for kind in chosen.kinds if _has_truth(chosen, split, kind)]
    count, files = pairs or chosen.pairs, 0
    for number, kind in enumerate(kinds):
        lines = []
        for i in range(count):
            names = _write_pair(chosen, split, kind, i, out)
            lines.append(" ".join(names))
            files += len(names)
            if progress is not None:
                progress(number * count + i + 1, len(kinds) * count)
        with whole_file(out / f"{split}-{kind}.txt") as temporary:
            temporary.write_text("\n".join(lines) + "\n")
    return {"files": files + len(kinds)}


def _has_truth(protocol: Protocol, split: str, kind: str) -> bool:
    """Return whether the true results of a kind are known, as the first pair says: all pairs of a kind agree."""
    return protocol.unshuffled_pair(split, kind, 0, protocol.rng(split, kind, 0)).truth_known


def _write_pair(protocol: Protocol, split: str, kind: str, i: int, out: Path) -> list[str]:
    """Write identity, driving mesh and truth of a pair and return their paths relative to `out`."""
    pair = protocol.unshuffled_pair(split, kind, i, protocol.rng(split, kind, i))
    truth = Mesh(pair.truth, pair.identity.faces, name=pair.truth_name)
    folder = out / f"{split}-{kind}"
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for mesh in (pair.identity, pair.driving, truth):
        # A point cloud has no faces and so cannot be written as OBJ; PLY stores both.
        path = folder / f"{mesh.name}{'.obj' if len(mesh.faces) else '.ply'}"
        save_mesh(mesh, path)
        names.append(f"{folder.name}/{path.name}")
    return names


def _write_table(protocol: Protocol, out: Path, progress: Progress | None) -> int:
    """Write every training person in every training pose and return the number of files."""
    if not isinstance(protocol, HumanNpt) or protocol.name != HUMAN_NPT.name:
        raise InputError(
            f"{protocol.name}: expected {HUMAN_NPT.name} for the split train, found a test set without training data; "
            "choose val or test"
        )
    out.mkdir(parents=True, exist_ok=True)
    people = [protocol.person("train", i) for i in range(protocol.people)]
    poses = [protocol.pose("train", i) for i in range(protocol.poses)]
    total = len(people) * len(poses)
    for k in range(total):
        mesh = people[k // len(poses)].posed_mesh(poses[k % len(poses)])
        save_mesh(mesh, out / f"{mesh.name}.obj")
        if progress is not None:
            progress(k + 1, total)
    return total
