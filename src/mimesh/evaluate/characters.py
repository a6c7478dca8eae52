"""`characters`: pairs of rigged characters of several makers, from a pool (`bodies.character_pool`).

Kinds `table6`, `limits` and `clips` are pairs of two characters with one skeleton: the truth is the identity under the
bone rotations of the driving character. The same kinds with `across-` are pairs of different skeletons: they have no
true vertices, and are measured by their limbs. Poses of `table6` and `limits` are drawn like those of `human-wide`.
Frames of `clips` are from the driving character's own clips; characters without any take the shipped captures.

The files say which split a character belongs to. Packs take turns, files are drawn from a pack, so that a pack of many
files counts as much as one of few. Pairs of `across-` are of two packs: all ordered pairs of packs take turns.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_pool import CharacterMeta, Limb, Pool, PoolCharacter, read_pool, transferred_transforms
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.mesh import Mesh
from .character_poses import body_pose, find_character_landmarks, pose_character
from .pairs import Pair, random_orders, reorder_vertices
from .protocols import SPLITS, Wide

ACROSS = "across-"
"""Prefix of the kinds of pairs with different skeletons."""
ACROSS_POSES = 5_000
"""Number of the first pose of these kinds, beyond the poses of the others."""
KINDS = ("table6", "limits", "clips")
Transforms = Float[np.ndarray, "K 4 4"]


@dataclass(frozen=True, eq=False)
class PosedCharacter:
    """A character in a pose, with its vertices in the order of the mesh that methods get."""

    meta: CharacterMeta
    rig: SkinnedCharacter
    limbs: dict[str, Limb]
    transforms: Transforms
    """Transform of each joint from rest to the pose; the last one, of the world, is the identity."""

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Vertices in the pose."""
        return self.rig.skinned(self.transforms)


@dataclass(frozen=True, eq=False, kw_only=True)
class CharacterPair(Pair):
    """A pair of two characters; lengths are in the units of their files, y is up, both face +z at rest.

    Across skeletons `truth` is an estimate: the identity with its limbs in the directions of the driving character's.
    """

    identity_character: PosedCharacter
    """The identity in the pose of its mesh."""
    driving_character: PosedCharacter
    """The driving character in its pose."""


@dataclass(frozen=True)
class Characters(Wide):
    """Pairs of the characters of a pool. Two of three identities are in the rest pose of their file."""

    data: Path = Path()
    """The folder of the pool."""

    def pool(self, split: str) -> Pool:
        """Read the characters of a split, once, and the files that cannot be used with the reasons."""
        return _read_pool(self.data, split)

    def check(self, split: str) -> None:
        """Check that the split has pairs of all kinds.

        Raises:
            InputError: no folder of the format, or too few characters.
        """
        if split not in SPLITS:
            raise InputError(f"{split}: expected a split ({', '.join(SPLITS)}), found another; check the name")
        if not _within(self.data, split) or not _across(self.data, split):
            found = [character.meta.pack for character in self.pool(split).characters]
            counts = ", ".join(f"{found.count(pack)} of {pack}" for pack in dict.fromkeys(found))
            raise InputError(
                f"{self.data}: expected two characters of one skeleton, and two packs with different skeletons, in "
                f"the split {split}, found {counts or 'none'}; add some"
            )

    def left_out(self, split: str) -> dict[str, int]:
        return self.pool(split).refusals()

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> CharacterPair:
        base, across = kind.removeprefix(ACROSS), kind.startswith(ACROSS)
        identity, driving = self.draw_characters(split, kind, i, rng)
        number = ACROSS_POSES + i if across else i
        rest, rest_label = np.tile(np.eye(4), (len(identity.rig.parents) + 1, 1, 1)), "rest"
        if rng.random() >= 2 / 3:
            pose = self.sample_rest_pose(split, base, number, rng)
            rest, rest_label = pose_character(identity, pose.rotmat), pose.label
        transforms, label = self.draw_pose(driving, split, base, number, rng)
        make = _make_across_pair if across else _make_pair
        return make(identity, driving, rest, transforms, (rest_label, label))

    def pair(self, split: str, kind: str, i: int) -> CharacterPair:
        """Generate pair `i` with the vertices of both meshes shuffled, and the weights of both characters with them."""
        rng = self.rng(split, kind, i)
        pair = self.unshuffled_pair(split, kind, i, rng)
        orders = random_orders(pair, rng)
        shuffled = reorder_vertices(pair, *orders)
        assert isinstance(shuffled, CharacterPair)
        return dataclasses.replace(
            shuffled,
            identity_character=_permuted(pair.identity_character, orders[0]),
            driving_character=_permuted(pair.driving_character, orders[1]),
        )

    def draw_characters(
        self, split: str, kind: str, i: int, rng: np.random.Generator
    ) -> tuple[PoolCharacter, PoolCharacter]:
        """Draw the identity and the driving character of pair `i`."""
        if kind.startswith(ACROSS):
            choices = _across(self.data, split)
            identities, others = choices[i % len(choices)]
            identity = identities[rng.integers(len(identities))]
            partners = [other for other in others if other.rig.skeleton != identity.rig.skeleton]
        else:
            choices = _within(self.data, split)
            identities = choices[i % len(choices)]
            identity = identities[rng.integers(len(identities))]
            partners = [c for c in identities if c is not identity and c.rig.skeleton == identity.rig.skeleton]
        return identity, partners[rng.integers(len(partners))]

    def draw_pose(
        self, driving: PoolCharacter, split: str, kind: str, number: int, rng: np.random.Generator
    ) -> tuple[Transforms, str]:
        """Draw a pose of the driving character, as transforms of its joints from rest, and its name."""
        if kind == "clips" and driving.clips:
            name = list(driving.clips)[rng.integers(len(driving.clips))]
            frame = int(rng.integers(len(driving.clips[name])))
            return driving.clip_transforms(name, frame), f"{name.replace('/', '-')}{frame}"
        pose = self.sample_driving_pose(split, kind, number, rng)
        return pose_character(driving, pose.rotmat), pose.label


def characters(data: str | Path) -> Characters:
    """Return the protocol for a pool of characters; `check` tells whether a split can be generated."""
    return Characters("characters", 1, (*KINDS, *(ACROSS + kind for kind in KINDS)), pairs=36, spread=0.0,
                      data=Path(data))  # fmt: skip


@cache
def _read_pool(data: Path, split: str) -> Pool:
    return read_pool(data, split)


def _packs(data: Path, split: str) -> dict[str, list[PoolCharacter]]:
    """Group the characters of a split by pack, sorted by name."""
    packs: dict[str, list[PoolCharacter]] = {}
    for character in sorted(_read_pool(data, split).characters, key=lambda c: (c.meta.pack, c.meta.file)):
        packs.setdefault(character.meta.pack, []).append(character)
    return packs


@cache
def _within(data: Path, split: str) -> list[list[PoolCharacter]]:
    """List, for each pack that has any, the characters whose skeleton others of the pack have too."""
    shared = []
    for pack in _packs(data, split).values():
        skeletons = [character.rig.skeleton for character in pack]
        shared.append([c for c in pack if skeletons.count(c.rig.skeleton) > 1])
    return [pack for pack in shared if pack]


@cache
def _across(data: Path, split: str) -> list[tuple[list[PoolCharacter], list[PoolCharacter]]]:
    """List the ordered pairs of packs, of which each identity has a partner with another skeleton."""
    packs = _packs(data, split)
    choices = []
    for first, identities in packs.items():
        for second, others in packs.items():
            usable = [c for c in identities if any(other.rig.skeleton != c.rig.skeleton for other in others)]
            if first != second and usable:
                choices.append((usable, others))
    return choices


def _make_pair(identity, driving, rest, transforms, labels) -> CharacterPair:
    """Make a pair of one skeleton, whose truth is the identity under the bone rotations of the driving character.

    The baseline `copy` needs a true correspondence, which exists only if both characters have the same triangles.
    """
    size = identity.leg / driving.leg
    truth = identity.rig.skinned(transferred_transforms(driving.rig, identity.rig, transforms, size))
    reference = driving.rig.skinned(transferred_transforms(identity.rig, driving.rig, rest, 1 / size))
    pair = _pair(identity, driving, rest, transforms, labels, truth, truth_known=True)
    same_topology = np.array_equal(identity.rig.mesh.faces, driving.rig.mesh.faces)
    markers = np.stack([find_character_landmarks(identity), find_character_landmarks(driving)], axis=1)
    markers[(markers < 0).any(axis=1), 1] = -1
    return dataclasses.replace(
        pair,
        aligned=pair.driving.vertices if same_topology else None,
        aligned_reference=reference if same_topology else None,
        reference=reference,
        markers=markers,
    )


def _make_across_pair(identity, driving, rest, transforms, labels) -> CharacterPair:
    """Make a pair of two skeletons; its `truth` is an estimate, see `CharacterPair.truth_known`."""
    # From what the driving mesh shows, not from the pose drawn: an arm of one joint has lost the bend of the elbow.
    estimate = identity.rig.skinned(pose_character(identity, body_pose(driving, transforms)))
    return _pair(identity, driving, rest, transforms, labels, estimate, truth_known=False)


def _pair(identity, driving, rest, transforms, labels, truth, truth_known) -> CharacterPair:
    identity_posed, driving_posed = (
        PosedCharacter(character.meta, character.rig, character.limbs, pose)
        for character, pose in ((identity, rest), (driving, transforms))
    )
    height = float(np.ptp(identity.rig.mesh.vertices[:, 1]))
    return CharacterPair(
        identity=_mesh(identity_posed, labels[0]),
        driving=_mesh(driving_posed, labels[1]),
        truth=truth,
        height=height,
        metres=1.7 / height,
        truth_name=f"{identity.meta.file}_{labels[1]}",
        groups=(_group(identity.meta), _group(driving.meta)),
        identity_character=identity_posed,
        driving_character=driving_posed,
        truth_known=truth_known,
    )


def _group(meta: CharacterMeta) -> str:
    """Return maker, pack and file of a character, for reports."""
    return f"{meta.maker}: {meta.pack}: {meta.file}"


def _mesh(posed: PosedCharacter, label: str) -> Mesh:
    mesh = posed.rig.mesh
    return dataclasses.replace(mesh, vertices=posed.vertices, name=f"{mesh.name}_{label}")


def _permuted(posed: PosedCharacter, order: Int[np.ndarray, " V"]) -> PosedCharacter:
    return dataclasses.replace(posed, rig=posed.rig.permuted(order))
