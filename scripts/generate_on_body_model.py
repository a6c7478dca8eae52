"""Write the papers' data on a body model that you have a licence of: people of SMPL or animals of SMAL, as files.

`human-npt` is 16 people in 400 poses of Table 6, and pairs of new people; `clips-aniformer` 16 people in all motions of
a folder of AMASS (as `<person>/<motion>.npz`), and a pair for each of them; `quadruped` animals in random poses. Files
are named as those of `mimesh generate`. Seeds are those of the protocols of the shipped body, so that all who have the
model get the same files. Coefficients of shapes are standard deviations, as the models of SMPL's family have them.

    python scripts/generate_on_body_model.py human-npt SMPL_NEUTRAL.pkl --split train -o smpl-train
    python scripts/generate_on_body_model.py clips-aniformer SMPLH_NEUTRAL.npz --data DFaust_67 -o clips-test
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mimesh.bodies.sampling import TABLE_6, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.bodies.smpl_model import SmplModel, load_smpl_model
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.core.npz_archive import archive_names
from mimesh.evaluate.clip_protocols import FRAMES, ClipPair
from mimesh.evaluate.generate import Content, training_meshes, write_split, write_training
from mimesh.evaluate.pairs import Pair, Person, Pose, human
from mimesh.evaluate.protocols import SPLITS, HumanNpt
from mimesh.motions.amass import is_amass
from mimesh.motions.smpl_clip import HUMAN_MODELS, fitted_pose, recorded_clip

COMPONENTS = 10
"""Shape coefficients of a person; of those of larger models the others are zero."""
ANIMAL_POSES = 0.2
"""Standard deviation (radians) of each coordinate of an animal's joint rotations. Chosen by hand: models of animals
differ in joints and axes, so there is no table of ranges, and much larger angles fold the legs into the body."""
LARGEST = 2.5
"""Standard deviations at which they are clipped, as shapes are."""


def main() -> None:
    """Write the files of a split and print their number."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("protocol", help="human-npt, clips-aniformer or quadruped.")
    parser.add_argument("model", type=Path, help="Body model (.pkl, .npz).")
    parser.add_argument("-o", "--output", type=Path, required=True, help="Folder to write.")
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--pairs", type=int, default=0, help="Pairs of each kind; of train poses of each person.")
    parser.add_argument("--data", type=Path, help="Folder of the motions of clips-aniformer.")
    args = parser.parse_args()
    if args.pairs < 0:
        parser.error(f"--pairs: expected 0 or more, found {args.pairs}")
    protocol = on_body_model(args.protocol, args.model, args.data)
    print(f"{args.output}: {write(protocol, args.output, args.split, args.pairs)['files']} files")


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
        first = Pair(
            still, clip.mesh, truth.vertices[0].astype(np.float64), self.height(identity), truth_name=truth.mesh.name,
            groups=(identity.label, take.stem),
        )  # fmt: skip
        return ClipPair.of(first, clip, truth.vertices, clip.vertices)

    def count(self, kind: str, requested: int = 0, split: str = "test") -> int:
        """Return the number of pairs: the requested number, or one for each take."""
        return requested or len(self.takes)


def write(protocol: OnBodyModel, out: Path, split: str, pairs: int = 0) -> dict[str, int]:
    """Write the files of a split and return their number."""
    if split == "train":
        return write_training(training_files(protocol, pairs), out)
    return write_split(protocol, out, split, pairs)


def training_files(protocol: OnBodyModel, count: int) -> dict[str, Content]:
    """List the training data of a protocol: name of each file and how its content is made.

    Args:
        count: number of poses, or motions, of each person; 0 for all.
    """
    if not isinstance(protocol, TakesOnBodyModel):
        return training_meshes(protocol, count)
    takes, clip = protocol.takes[: count or None], protocol.clip
    people = [protocol.person("train", i) for i in range(protocol.people)]
    return {f"{p.label}/{t.stem}.npz": lambda p=p, t=t: clip(p, t) for p in people for t in takes}


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
        raise InputError(f"{name}: expected human-npt, clips-aniformer or quadruped, found another; choose one of them")
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
            f"clips-aniformer: expected a folder of AMASS motions, found {folder or 'none'}; give it with --data"
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


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
