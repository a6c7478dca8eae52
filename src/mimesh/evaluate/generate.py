"""Write the meshes and clips of a protocol as files, named like the public NPT data: id<person>_<pose>.obj.

With `--body-model` they are those of a body model that the user has a licence of and gives as a file. Seeds are those
of the protocols of the shipped body, so that all who have the model get the same files. Coefficients of shapes are
standard deviations, as the models of SMPL's family have them.
"""

from __future__ import annotations

import dataclasses
import itertools
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..bodies.sampling import TABLE_6, rotvec_to_rotmat, sample_pose, sample_shape
from ..bodies.smpl_model import SmplModel, load_smpl_model
from ..core.errors import InputError
from ..core.frame_buffer import Progress, counted
from ..core.mesh import Clip, Mesh
from ..core.npz_archive import archive_names
from ..io import save_clip, save_mesh
from ..motions.amass import is_amass
from ..motions.smpl_clip import HUMAN_MODELS, fitted_pose, recorded_clip
from .clip_protocols import FRAMES, ClipPair
from .listed_pairs import SUFFIX, ListedPairs, write_list
from .pairs import Pair, Person, Pose, human
from .protocols import HUMAN_NPT, SPLITS, HumanNpt, Protocol
from .run import find_protocol

CLIP_SUFFIX = ".npz"
"""Format of clips: it keeps every digit, and the frame rate."""


def generate_command(
    protocol: str,
    out: Path,
    split: str = "test",
    pairs: int = 0,
    progress: Progress | None = None,
    data: Path | None = None,
    body_model: Path | None = None,
) -> dict[str, int]:
    """Write the meshes of a split (`mimesh generate`) and return the number of files.

    Each kind of pair gets a list `<split>-<kind>.txt` with one line "identity driving truth" per pair, the heights of
    the identities, and a folder with these meshes; kinds without known true results are left out. Driving and truth of
    a protocol of clips are clips. Vertices are in the body's order in all of them, as in the public data:
    shuffle before use. The split `train` of human-npt is the table of 16 people x 400 poses; with a body model that of
    clips-aniformer is 16 people x all motions, as `<person>/<motion>.npz`. Files of `train` that exist are kept, so
    that a stopped run goes on; `kept` counts them.

    Args:
        pairs: number of pairs of each kind, of `train` of poses of each person; 0 for the protocol's own.
        data: folder of a protocol that reads one.
        body_model: file of a body model whose people, or animals, are taken instead of the shipped ones.

    Raises:
        InputError: no such protocol or split, missing data, or `train` of another protocol than human-npt.
    """
    chosen = on_body_model(protocol, body_model, data) if body_model else find_protocol(protocol, data)
    if isinstance(chosen, ListedPairs):
        raise InputError(f"{protocol}: expected a protocol by its name, found a list or a folder; name one")
    if split not in SPLITS:
        raise InputError(f"{split}: expected a split ({', '.join(SPLITS)}), found another; check the name")
    if split == "train":
        return _write_training(chosen, out, pairs, progress)
    chosen.check(split)
    counts = {kind: chosen.count(kind, pairs, split) for kind in chosen.kinds if _has_truth(chosen, split, kind)}
    done = 0
    for kind, count in counts.items():
        triples, heights, written = [], {}, {}
        for i in range(count):
            pair = chosen.unshuffled_pair(split, kind, i, chosen.rng(split, kind, i))
            triples.append(_write_pair(pair, out / f"{split}-{kind}", written))
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


def _write_pair(pair: Pair, folder: Path, written: dict[str, int]) -> tuple[str, str, str]:
    """Write identity, driving mesh or clip, and truth of a pair and return their names relative to the list.

    `written` has a checksum of what each file of the folder holds, by its name, and is added to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth = Mesh(pair.truth, pair.identity.faces, name=pair.truth_name)
    parts: tuple[Mesh | Clip, ...] = (pair.identity, pair.driving, truth)
    if isinstance(pair, ClipPair):
        parts = (pair.identity, pair.clip, dataclasses.replace(pair.clip, mesh=truth, vertices=pair.truth_frames))
    identity, driving, true = (f"{folder.name}/{_write(part, folder, written)}" for part in parts)
    return identity, driving, true


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


COMPONENTS = 10
"""Shape coefficients of a person; of those of larger models the others are zero."""
ANIMAL_POSES = 0.2
"""Standard deviation (radians) of each coordinate of an animal's joint rotations. Chosen by hand: models of animals
differ in joints and axes, so there is no table of ranges, and much larger angles fold the legs into the body."""
LARGEST = 2.5
"""Standard deviations at which they are clipped, as shapes are."""
Content = Callable[[], Mesh | Clip]
"""Makes what is written to a file."""


@dataclass(frozen=True, eq=False)
class OnBodyModel(HumanNpt):
    """`human-npt` with people of a body model in the same poses of Table 6; of an animal's model, in random poses."""

    model: SmplModel = field(kw_only=True)

    def person(self, split: str, i: int) -> Person:
        """Return person, or animal, `i`."""
        shape = sample_shape(human(), self.seed(split), i, self.spread)[:COMPONENTS]
        return Person(self.model, shape[: len(self.model.components)], str(i))

    def pose(self, split: str, i: int) -> Pose:
        """Return pose `i`: joints of Table 6 in its order, which is SMPL's, or the joints of an animal but the root."""
        joints = len(self.model.parents)
        if joints in HUMAN_MODELS:
            rotvec = sample_pose(human(), self.seed(split), i)[[human().joint(name) for name in TABLE_6]]
            rotvec = fitted_pose(rotvec[None], joints)[0][0]
        else:
            rng = np.random.default_rng([self.seed(split), i])
            rotvec = ANIMAL_POSES * np.clip(rng.standard_normal((joints, 3)), -LARGEST, LARGEST)
            rotvec[0] = 0.0
        return Pose(rotvec_to_rotmat(rotvec), str(i))

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        pair = super().unshuffled_pair(split, kind, i, rng)
        # Those of `make_pair` are of the shipped body.
        return dataclasses.replace(pair, markers=None, height=self.height(self.person(split, int(pair.groups[0]))))

    def height(self, person: Person) -> float:
        """Return the extent along y at rest, in the unit of the model."""
        return float(np.ptp(person.body.shaped(person.shape)[0][:, 1]))


@dataclass(frozen=True, eq=False)
class TakesOnBodyModel(OnBodyModel):
    """`clips-aniformer` of recorded motions (AMASS) and people of a body model: AniFormer, section 4.

    As in the paper a motion is 30 evenly spaced frames of its take, and the truth is another person in it.
    """

    takes: tuple[Path, ...] = field(kw_only=True)

    def clip(self, person: Person, take: Path) -> Clip:
        """Return a person in a recorded motion, named like the meshes."""
        clip, _ = recorded_clip(take, self.model, count=FRAMES, betas=person.shape)
        return dataclasses.replace(clip, mesh=dataclasses.replace(clip.mesh, name=f"id{person.label}_{take.stem}"))

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> ClipPair:
        """Generate trial `i`: a new person in a pose of Table 6, and another new person in a motion."""
        identity, driving = (self.person(split, int(k)) for k in rng.choice(self.new_people, 2, replace=False))
        take = self.takes[i % len(self.takes)]
        clip, truth = (self.clip(person, take) for person in (driving, identity))
        still = identity.posed_mesh(self.pose("train", int(rng.integers(self.poses))))
        return ClipPair(
            still, clip.mesh, truth.vertices[0].astype(np.float64), self.height(identity), truth_name=truth.mesh.name,
            groups=(identity.label, take.stem), clip=clip, truth_frames=truth.vertices,
            aligned_frames=clip.vertices,
        )  # fmt: skip

    def count(self, kind: str, requested: int = 0, split: str = "test") -> int:
        """Return the number of pairs: the requested number, or one for each take."""
        return requested or len(self.takes)


def training_files(protocol: HumanNpt, count: int) -> dict[str, Content]:
    """List the training data of a protocol: name of each file and how its content is made.

    Args:
        count: number of poses, or motions, of each person; 0 for all.
    """
    people = [protocol.person("train", i) for i in range(protocol.people)]
    if isinstance(protocol, TakesOnBodyModel):
        takes, clip = protocol.takes[: count or None], protocol.clip
        return {f"{p.label}/{t.stem}.npz": lambda p=p, t=t: clip(p, t) for p in people for t in takes}
    poses = [protocol.pose("train", i) for i in range(min(count, protocol.poses) or protocol.poses)]
    return {f"id{p.label}_{q.label}.obj": lambda p=p, q=q: p.posed_mesh(q) for p in people for q in poses}


def on_body_model(name: str, path: Path, data: Path | None = None) -> OnBodyModel:
    """Return a protocol on a body model.

    Args:
        name: human-npt or clips-aniformer for models of people, quadruped for those of animals.
        path: of the model.
        data: folder of the motions of clips-aniformer.

    Raises:
        InputError: another protocol, a model of the other kind, or no motions.
    """
    if name not in ("human-npt", "quadruped", "clips-aniformer"):
        raise InputError(
            f"--body-model {path}: expected it with human-npt, clips-aniformer or quadruped, found {name}; leave it out"
        )
    model = load_smpl_model(path)
    joints, people = len(model.parents), ", ".join(map(str, HUMAN_MODELS))
    if (joints in HUMAN_MODELS) == (name == "quadruped"):
        other = "human-npt" if name == "quadruped" else "quadruped"
        raise InputError(
            f"{path}: expected a model of {'animals' if name == 'quadruped' else 'people'} for {name}, found {joints} "
            f"joints (those of people have {people}); take {other}"
        )
    if name != "clips-aniformer":
        return OnBodyModel(name, 1, ("seen", "unseen"), pairs=72, spread=1.0, model=model)
    return TakesOnBodyModel(name, 1, ("takes",), pairs=0, spread=1.0, model=model, takes=_find_takes(data))


def _find_takes(folder: Path | None) -> tuple[Path, ...]:
    """Find the motions of a folder in the layout of AMASS, which has other archives beside them.

    Raises:
        InputError: no folder, no motion, or two of one name.
    """
    if folder is None or not folder.is_dir():
        raise InputError(
            "clips-aniformer: expected a folder of AMASS motions for --body-model, found "
            f"{folder or 'none'}; give it with --data"
        )
    takes = [path for path in sorted(folder.rglob("*.npz")) if is_amass(archive_names(path))]
    if not takes:
        raise InputError(f"{folder}: expected AMASS motions (.npz with poses), found none; check the path")
    twins = {take.stem: take for take in takes}
    for take in takes:
        if twins[take.stem] != take:
            raise InputError(
                f"{take}: expected motions with names of their own, found {twins[take.stem]} too; rename one"
            )
    return tuple(takes)
