"""Find the joints of a rigged four-legged animal of any maker: which joint of the shipped quadruped each one is.

Names of animal rigs say little (Bone.014, BackUpLeg.L), so joints are found by where they are and what they move: feet
are the parts of the surface near the ground, legs the chains of joints above them, the trunk what the legs hang on.
Only heads and tails are looked for by name first. Character frame: y up, facing +z, the left side is +x.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.errors import InputError
from ..core.rig import descendants
from .character_limbs import SIDES, moves_vertices
from .joint_names import ancestors
from .skinned_character import SkinnedCharacter

LEGS = {"front": ("UpperArm", "Forearm", "Hand", "Fingers"), "hind": ("Thigh", "Shin", "Foot", "Toes")}
"""Joints of a foreleg and of a hind leg without their side, from the top."""
USUAL_PLACES = {"UpperArm": (0.0, 0.4, 0.76, 0.9), "Thigh": (0.0, 0.4, 0.72, 0.9)}
"""Places of a leg's joints along it, from its top to the ground. Elbows and knees of real animals are at 0.3, but many
legs have two bones, which meet in the middle."""
MOST_OF_IT = 0.6
"""A joint that moves a larger share of the surface is not that of a head."""
NECK, TAIL = ("Neck1", "Neck2", "Neck3"), tuple(f"Tail{k}" for k in range(1, 7))
TRUNK = {"Spine1": 0.18, "Spine2": 0.33, "Spine3": 0.42, "Spine4": 0.49, "Chest": 0.74}
"""Joints of the trunk and their places between hips and shoulders in the shipped quadruped."""
SHOULDER_BLADE = ("scapula", "clavicle", "shoulderblade", "shoulder_blade")
"""Parts of names of shoulder blades. A `shoulder` is an upper arm as often."""
GROUND = 0.12
"""Share of the height from the ground up in which the surface is that of feet. Chosen by eye, as all figures here."""
APART = 0.15
"""Smallest distance of forefeet from hind feet, in heights: nearer ones are heels and toes of two feet."""
BESIDE = 0.3
"""A joint is one of a leg, not of the trunk, from this share of the foot's distance from the middle on."""
LOOSE_FOOT = 0.1
"""A chain that begins lower than this share of the height is that of a foot alone: a handle of the animator that the
leg follows."""
OTHER_FEET = 0.4
"""Largest share of the feet that other joints carry than those of four legs and their trunk: sheep of a pool have
0.33, spiders 0.5."""
SAME_PLACE = 0.06
"""Distance seen from the side, in lengths of the leg, below which one of two joints of a leg is only a helper."""


def name_animal_joints(rig: SkinnedCharacter, path: object) -> dict[str, int]:
    """Find the joint of each joint of the shipped quadruped that an animal has.

    Args:
        path: of the file, for messages.
    """
    return _AnimalRig(rig, path).named()


def named_tail(rig: SkinnedCharacter) -> list[int]:
    """List the joints whose names say that they are of a tail."""
    return [j for j, name in enumerate(rig.joint_names) if "tail" in name.lower()]


@dataclass(frozen=True, eq=False)
class _AnimalRig:
    """A rig and what its joints move."""

    rig: SkinnedCharacter
    path: object

    @cached_property
    def influence(self) -> Float[np.ndarray, "V J"]:
        """Weight of each joint on each vertex."""
        return self.rig.joint_weights()

    @cached_property
    def moving(self) -> Bool[np.ndarray, " J"]:
        """Whether a joint or one below it moves vertices."""
        return moves_vertices(self.rig)

    @cached_property
    def low(self) -> float:
        return float(self.rig.mesh.vertices[:, 1].min())

    @cached_property
    def height(self) -> float:
        return float(np.ptp(self.rig.mesh.vertices[:, 1]))

    @cached_property
    def feet(self) -> dict[tuple[str, str], Int[np.ndarray, " N"]]:
        """Vertices of the feet, by side and pair of legs."""
        vertices = self.rig.mesh.vertices
        near = vertices[:, 1] < self.low + GROUND * self.height
        if not near.any():  # a flat mesh has no height
            raise InputError(f"{self.path}: expected four feet on the ground, found a flat mesh; is it an animal?")
        middle = (vertices[near, 0].min() + vertices[near, 0].max()) / 2
        offset = vertices[:, 0] - middle
        near &= np.abs(offset) >= BESIDE * np.quantile(np.abs(offset[near]), 0.9)  # a tail may lie on the ground
        split = (vertices[near, 2].min() + vertices[near, 2].max()) / 2
        found = {}
        for pair, of_pair in (("front", vertices[:, 2] > split), ("hind", vertices[:, 2] <= split)):
            for side, of_side in zip(SIDES, (offset > 0, offset < 0), strict=True):
                found[side, pair] = np.flatnonzero(near & of_pair & of_side)
                if not len(found[side, pair]):
                    raise InputError(
                        f"{self.path}: expected four feet on the ground, found none {side.lower()} {pair}; "
                        "stand the animal upright, facing +z"
                    )
        front, hind = (np.mean([vertices[found[side, pair], 2].mean() for side in SIDES]) for pair in LEGS)
        if front - hind < APART * self.height:
            raise InputError(f"{self.path}: expected forefeet before hind feet, found two feet; is it a person?")
        return found

    @cached_property
    def middle(self) -> float:
        """Coordinate x of the plane between left and right."""
        left, right = (
            np.mean([self.rig.mesh.vertices[self.feet[side, pair], 0].mean() for pair in LEGS]) for side in SIDES
        )
        return float((left + right) / 2)

    def named(self) -> dict[str, int]:
        rig, parents = self.rig, self.rig.parents
        legs, tops = self._legs()
        found = {}
        for (side, pair), leg in legs.items():
            found |= {side + part: joint for part, joint in self._leg_names(leg, LEGS[pair]).items()}
        hind, front = (self._shared([tops[side, pair] for side in SIDES]) for pair in ("hind", "front"))
        found["Hips"] = hind
        start, stop = (
            float(np.mean([rig.joints[legs[side, pair][0], 2] for side in SIDES])) for pair in ("hind", "front")
        )
        head = self._head({joint for leg in legs.values() for joint in leg}, stop)
        chain = [] if head is None else ancestors(parents, head)
        trunk = [j for j in ancestors(parents, front) if j != hind and j not in ancestors(parents, hind)]
        above = [j for j in chain if j not in trunk and j not in ancestors(parents, hind)][1:]
        # Of two joints or more between trunk and head, the last one is of the neck, wherever it is.
        low = above[len(above) > 1 :]
        before_legs = [j for j in low if rig.joints[j, 2] <= stop + 0.1 * (stop - start)] if not trunk else []
        for joint in [*trunk, *before_legs]:
            share = (rig.joints[joint, 2] - start) / max(stop - start, 1e-9)
            found.setdefault(min(TRUNK, key=lambda name: abs(TRUNK[name] - share)), joint)
        neck = [j for j in above if j not in before_legs][::-1]
        spread = [neck[0], neck[len(neck) // 2], neck[-1]] if len(neck) > 2 else neck
        found |= dict(zip(NECK, spread, strict=False))
        if head is not None:
            found["Head"] = head
        tail = self._tail(set(found.values()), start)
        places = np.unique(np.linspace(0, len(TAIL), len(tail), endpoint=False).astype(int))
        picked = [tail[k] for k in np.linspace(0, len(tail), len(places), endpoint=False).astype(int)]
        return found | {TAIL[place]: joint for place, joint in zip(places, picked, strict=True)}

    def _legs(self) -> tuple[dict[tuple[str, str], list[int]], dict[tuple[str, str], int]]:
        """Find the joints of each leg from the top, without helpers, and its first joint, which may be a helper."""
        owners = {key: int(self.influence[feet].sum(axis=0).argmax()) for key, feet in self.feet.items()}
        if len(set(owners.values())) < len(owners):
            raise InputError(f"{self.path}: expected a joint in each of four feet, found one for two; rig the legs")
        legs, tops = {}, {}
        for key, foot in owners.items():
            others = {j for other in owners.values() if other != foot for j in ancestors(self.rig.parents, other)}
            chain = self._chain(foot, others)
            if not chain:
                raise InputError(
                    f"{self.path}: expected a joint in each of four feet, found one of the trunk in one; rig the legs"
                )
            if self.rig.joints[chain[0], 1] < self.low + LOOSE_FOOT * self.height:
                chain = [*self._leg_above(chain[0], others.union(owners.values(), chain)), *chain]
            tops[key] = chain[0]
            # Joints at the top that are beside the next one, as seen from the side, are left out.
            length = max(self.rig.joints[chain[0], 1] - self.low, 1e-9)
            while len(chain) > 1 and self._apart(*chain[:2]) < SAME_PLACE * length:
                chain = chain[1:]
            legs[key] = chain
        self._check_four([*tops.values(), *owners.values()])
        return legs, tops

    def _apart(self, first: int, second: int) -> float:
        return float(np.linalg.norm((self.rig.joints[second] - self.rig.joints[first])[1:]))

    def _check_four(self, tops: list[int]) -> None:
        feet, parents = np.concatenate(list(self.feet.values())), self.rig.parents
        # Sloppy weights of the trunk on feet do not count.
        known = {*descendants(tops, parents), *(joint for top in tops for joint in ancestors(parents, top))}
        apart = 1 - self.influence[feet][:, sorted(known)].sum() / len(feet)
        if apart > OTHER_FEET:
            raise InputError(
                f"{self.path}: expected four legs, found {apart:.0%} of the feet on other joints; has it more of them?"
            )

    def _chain(self, foot: int, others: set[int]) -> list[int]:
        """List the joints of a leg from its foot's joint up, in order from the top."""
        reach = BESIDE * abs(self.rig.joints[foot, 0] - self.middle)
        chain = []
        for joint in ancestors(self.rig.parents, foot):
            if joint in others or abs(self.rig.joints[joint, 0] - self.middle) < reach:
                break
            chain.append(joint)
        return chain[::-1]

    def _leg_above(self, foot: int, others: set[int]) -> list[int]:
        """Find the leg that a foot's handle belongs to: the chain whose lowest joint is nearest to it."""
        joints, moving = self.rig.joints, self.moving
        side = np.sign(joints[foot, 0] - self.middle)
        beside = side * (joints[:, 0] - self.middle) > BESIDE * abs(joints[foot, 0] - self.middle)
        higher = joints[:, 1] > joints[foot, 1]
        own = [int(j) for j in np.flatnonzero(beside & higher & moving) if j not in others]
        if not own:
            return []
        lowest = min(own, key=lambda j: float(np.linalg.norm(joints[j] - joints[foot])))
        return self._chain(lowest, others)

    def _leg_names(self, chain: list[int], parts: tuple[str, ...]) -> dict[str, int]:
        blade = {}
        if parts == LEGS["front"]:  # it may begin with a shoulder blade: by its name, or as there is one joint too many
            named = any(word in self.rig.joint_names[chain[0]].lower() for word in SHOULDER_BLADE)
            if len(chain) > len(parts) or (len(chain) > 1 and named):
                blade, chain = {"Scapula": chain[0]}, chain[1:]
        points = self.rig.joints[chain]
        points = np.concatenate([points, points[-1:] * [1, 0, 1] + [0, self.low, 0]])
        along = np.cumsum([0.0, *np.linalg.norm(np.diff(points, axis=0), axis=1)])
        along = along[:-1] / max(along[-1], 1e-9)
        usual = np.array(USUAL_PLACES[parts[0]])
        count = min(len(chain), len(parts))
        pairings = (
            (rows, columns)
            for rows in combinations(range(1, len(chain)), count - 1)
            for columns in combinations(range(1, len(parts)), count - 1)
        )
        rows, columns = min(pairings, key=lambda p: float(np.square(along[list(p[0])] - usual[list(p[1])]).sum()))
        found = {parts[0]: chain[0], **{parts[c]: chain[r] for r, c in zip(rows, columns, strict=True)}}
        if parts[2] in found and parts[1] not in found:  # a leg that bends once bends at the elbow or the knee
            found[parts[1]] = found.pop(parts[2])
        return blade | found

    def _shared(self, joints: list[int]) -> int:
        second = ancestors(self.rig.parents, joints[1])
        shared = [j for j in ancestors(self.rig.parents, joints[0]) if j in second]
        if not shared:
            raise InputError(f"{self.path}: expected legs that hang on one joint, found separate ones; join them")
        return shared[0]

    def _carried(self, joint: int) -> Float[np.ndarray, " 3"]:
        weight = self.influence[:, joint]
        return weight @ self.rig.mesh.vertices / max(weight.sum(), 1e-9)

    def _head(self, legs: set[int], front: float) -> int | None:
        """Find the joint of the head: by its name, or the one that moves the foremost part before the forelegs."""
        count = len(self.rig.parents)
        of_trunk = {j for joint in legs for j in ancestors(self.rig.parents, joint)}
        share = self.influence.mean(axis=0)
        tail = named_tail(self.rig)
        free = [j for j in range(count) if 0 < share[j] < MOST_OF_IT and j not in of_trunk and j not in tail]
        named = [j for j in free if "head" in self.rig.joint_names[j].lower()]
        width = np.ptp(self.rig.mesh.vertices[:, 0])
        place = {j: self._carried(j) for j in free}
        middle = [j for j in free if abs(place[j][0] - self.middle) < 0.1 * width and place[j][2] > front]
        return named[0] if named else max(middle, key=lambda j: place[j][2], default=None)

    def _tail(self, others: set[int], hind: float) -> list[int]:
        """Find the joints of the tail from its root: by name, or a chain of two or more behind the hind legs."""
        parents = self.rig.parents
        weighted = [j for j in range(len(parents)) if self.influence[:, j].any() and j not in others]
        if named := [j for j in named_tail(self.rig) if j in weighted]:
            return named
        behind = [
            j
            for j in weighted
            if self._carried(j)[2] < hind and abs(self.rig.joints[j, 0] - self.middle) < 0.05 * self.height
        ]
        chains = [[j for j in ancestors(parents, leaf) if j in behind][::-1] for leaf in behind]
        longest = max(chains, key=len, default=[])
        return longest if len(longest) > 1 else []
