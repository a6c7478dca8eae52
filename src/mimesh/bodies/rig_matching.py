"""Match the joints of two rigs of any creatures, by their names and by their chains, and move one as the other moves.

Nothing is known of the anatomy. A rig is cut into chains of joints that have one joint below them; trunks go on where
fins or legs hang on them. Chains of two rigs are compared by side, place, direction, length, names and by what they
hang on, and assigned one to one so that the sum of the costs is smallest. Joints of matched chains of equal numbers
correspond in order, others by arc length. Frame of a creature: y up, facing +z, the left side is +x.

Rotations are counted from rest, in the world's axes. A joint at the top of a chain turns, relative to the joint that
the chain hangs on, as its counterpart does; what has none turns with what it hangs on. So poses are relative to rest,
where those of people and four-legged animals are absolute: the rests of other creatures have nothing in common that
could be calibrated.

M_j(t) is the linear map of joint j since rest. Joint j of the identity follows joint d of the driving, and the nearest
matched joint a above j follows c: then M_j = M_a C (M_c^-1 M_d) C^T. C takes the axes of bending of the driving's chain
to those of the identity's (`chain_turn`).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from ..core.geometry import nearest_rotation, rotation_between
from ..core.normalization import bbox_centre
from ..core.rig import descendants, homogeneous
from .character_limbs import moves_vertices
from .joint_names import ancestors, name_words, parents_first
from .skinned_character import SkinnedCharacter

# Lengths are in units of half the diagonal of the bounding box. All figures were chosen by eye on creatures of the
# split `train` of a pool (docs/log/animals.md).
BESIDE = 0.08
"""A chain is one of a side, not of the middle, from this distance of its mean from the plane between the sides on."""
LOOSE = 0.35
"""A joint below one that moves nothing itself belongs to the limb that ends nearer than this share of its distance from
that joint: the foot of a leg that is moved by inverse kinematics."""
UNLIKE = 1.4
"""Cost from which on two chains do not correspond."""
STRAY = 0.02
"""Length below which a chain has no direction."""
NAMES = 0.5
"""Cost of names that have no word in common; half of it where one of the two chains has names that say nothing."""
OTHER_SIDE, OFF_MIDDLE = 2.0, 0.3
"""Cost of chains of different sides, and of one at a side and one in the middle."""
HANGING = 0.2
"""Cost of chains that hang on chains that do not correspond; as much is gained where they do."""
ROUNDS = 4
"""Number of assignments, of which each knows what the chains of the one before hang on."""


@dataclass(frozen=True, eq=False)
class Chain:
    """Joints of which each is the only one below the one before, or the one in which a trunk goes on."""

    joints: tuple[int, ...]
    points: Float[np.ndarray, "P 3"]
    """The joints and the end of the last one, from the centre of the creature."""
    side: int
    """1 left, -1 right, 0 in the middle."""
    words: frozenset[str]
    """Words of the joints' names that say something."""
    share: float
    """Share of the surface that the joints carry."""
    depth: int
    """Number of chains above it."""
    above: int
    """Index of the chain that it hangs on; -1 for none."""
    hook: int
    """Joint that it hangs on; -1 for none."""

    @cached_property
    def lengths(self) -> Float[np.ndarray, " N"]:
        """Length from each joint to the next, or to the end."""
        return np.linalg.norm(np.diff(self.points, axis=0), axis=1)

    @cached_property
    def direction(self) -> Float[np.ndarray, " 3"]:
        """Unit vector from the first joint to the end; zero if these are at one place."""
        step = self.points[-1] - self.points[0]
        return step / np.linalg.norm(step) if np.linalg.norm(step) > STRAY else np.zeros(3)


@dataclass(frozen=True, eq=False)
class Creature:
    """A rig with its chains, y up and facing +z."""

    rig: SkinnedCharacter

    @cached_property
    def moving(self) -> Bool[np.ndarray, " J"]:
        """Whether a joint or one below it moves vertices: handles of the animator do not count."""
        return moves_vertices(self.rig)

    @cached_property
    def influence(self) -> Float[np.ndarray, "V J"]:
        """Weight of each joint on each vertex."""
        return self.rig.joint_weights()

    @cached_property
    def size(self) -> float:
        """Half the diagonal of the bounding box."""
        return float(np.linalg.norm(np.ptp(self.rig.mesh.vertices, axis=0))) / 2 or 1.0

    @cached_property
    def centre(self) -> Float[np.ndarray, " 3"]:
        """Centre of the bounding box."""
        return bbox_centre(self.rig.mesh.vertices)

    @cached_property
    def share(self) -> Float[np.ndarray, " J"]:
        """Share of the surface that each joint carries, by vertices."""
        return self.influence.mean(axis=0)

    @cached_property
    def places(self) -> Float[np.ndarray, "J 3"]:
        """Position of each joint from the centre."""
        return (self.rig.joints - self.centre) / self.size

    @cached_property
    def ends(self) -> Float[np.ndarray, "J 3"]:
        """End of each joint: the mean of the joints below it, or the far side of the surface that it carries."""
        ends = self.places.copy()
        for j in range(len(ends)):
            below = [k for k, parent in enumerate(self.rig.parents) if parent == j and self.moving[k] == self.moving[j]]
            below = below or [k for k, parent in enumerate(self.rig.parents) if parent == j]
            if below:
                ends[j] = self.places[below].mean(axis=0)
            elif self.share[j] > 0:
                weight = self.influence[:, j] / self.influence[:, j].sum()
                middle = (weight @ self.rig.mesh.vertices - self.centre) / self.size
                ends[j] = self.places[j] + 2 * (middle - self.places[j])
        return ends

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """Parent of each joint; feet that are moved by inverse kinematics are below the ends of their legs.

        These may come after them, where other parents come before their children.
        """
        parents = list(self.rig.parents)
        leaves = [
            j for j in range(len(parents)) if self.share[j] > 0 and not any(self.moving[k] for k in self._below(j))
        ]
        loose = [j for j in leaves if parents[j] >= 0 and self.share[parents[j]] == 0]
        for foot in loose:
            ends = [j for j in leaves if j not in loose and self._sided(j) * self._sided(foot) >= 0]
            if not ends:
                continue
            near = [np.linalg.norm(self.ends[j] - self.places[foot]) for j in ends]
            reach = np.linalg.norm(self.places[foot] - self.places[parents[foot]])
            if min(near) < LOOSE * reach:
                parents[foot] = ends[int(np.argmin(near))]
        return tuple(parents)

    @cached_property
    def chains(self) -> tuple[Chain, ...]:
        """Cut the rig into chains, each after the one that it hangs on."""
        below: dict[int, list[int]] = {}
        for j, parent in enumerate(self.parents):
            if self.moving[j]:
                below.setdefault(parent, []).append(j)
        found: list[Chain] = []
        open_ends = [(j, -1, 0) for j in below.get(-1, [])]
        while open_ends:
            top, above, depth = open_ends.pop(0)
            joints = [top]
            while (after := self._next(joints[-1], below)) is not None:
                joints.append(after)
            open_ends += [(k, len(found), depth + 1) for j in joints for k in below.get(j, []) if k not in joints]
            found.append(self._chain(joints, depth, above))
        return tuple(found)

    def _next(self, joint: int, below: dict[int, list[int]]) -> int | None:
        """Find the joint in which a chain goes on: the only one below, or in the middle the only one in the middle.

        A root that several parts hang on, or that moves nothing itself, turns them all and is no part of one.
        """
        after = below.get(joint, [])
        if self.parents[joint] < 0 and (len(after) != 1 or self.share[joint] == 0):
            return None
        if len(after) != 1:
            after = [k for k in after if self._sided(k) == 0] if self._sided(joint) == 0 else []
        return after[0] if len(after) == 1 else None

    def _sided(self, joint: int) -> int:
        """Tell the side of a joint: by its name, or by the mean of its ends."""
        named = name_words(self.rig.joint_names[joint])[0]
        if named:
            return named
        return _side_of(float(self.places[joint, 0] + self.ends[joint, 0]) / 2)

    def _chain(self, joints: list[int], depth: int, above: int) -> Chain:
        words = frozenset(word for j in joints for word in name_words(self.rig.joint_names[j])[1])
        points = np.concatenate([self.places[joints], self.ends[joints[-1:]]])
        sides = [name_words(self.rig.joint_names[j])[0] for j in joints]
        x = points[:, 0].mean()
        side = next((side for side in sides if side), _side_of(float(x)))
        share = float(self.share[joints].sum())
        return Chain(tuple(joints), points, side, words, share, depth, above, self.parents[joints[0]])

    def _below(self, joint: int) -> list[int]:
        return [k for k, parent in enumerate(self.rig.parents) if parent == joint]


def _side_of(x: float) -> int:
    return (x > BESIDE) - (x < -BESIDE)


@dataclass(frozen=True, eq=False)
class RigMatch:
    """Which joints of a driving each joint of an identity follows."""

    follows: Float[np.ndarray, "J D"]
    """Share of each joint of the driving, rows sum to 1; zero for joints without a counterpart."""
    pairs: tuple[tuple[int, int], ...]
    """Matched chains."""
    covered: tuple[float, float]
    """Share of the surface of identity and driving that matched joints carry."""
    chain_agreement: float
    """How alike the matched chains are, from 0 to 1, in the mean over the surface."""
    name_agreement: float | None
    """Share of words that their names have in common; None where too few names say anything."""

    @property
    def confidence(self) -> float:
        """From 0 to 1: the agreement of the chains times the geometric mean of the shares that they carry."""
        return self.chain_agreement * float(np.sqrt(np.prod(self.covered)))


def match_rigs(identity: Creature, driving: Creature) -> RigMatch:
    """Match the joints of two creatures."""
    from scipy.optimize import linear_sum_assignment

    mine, theirs = identity.chains, driving.chains
    costs = np.array([[chain_cost(u, v) for v in theirs] for u in mine]).reshape(len(mine), len(theirs))
    pairs: dict[int, int] = {}
    for _ in range(ROUNDS):
        # Chains are assigned one to one, so that the sum of the costs is smallest; one without a match costs UNLIKE.
        # Costs change where chains hang on chains that correspond or do not.
        more = np.zeros((len(mine), len(theirs)))
        for k, a in enumerate(mine):
            for n, b in enumerate(theirs):
                if a.above in pairs and b.above >= 0:
                    more[k, n] = -HANGING if pairs[a.above] == b.above else HANGING
        hung = costs + more
        rows, columns = linear_sum_assignment(np.minimum(hung - UNLIKE, 0.0))
        pairs = {u: v for u, v in zip(rows.tolist(), columns.tolist(), strict=True) if hung[u, v] < UNLIKE}
    follows = np.zeros((len(identity.parents), len(driving.parents)))
    for u, v in pairs.items():
        follows[np.ix_(mine[u].joints, theirs[v].joints)] = chain_shares(mine[u], theirs[v])
    weight = np.array([mine[u].share + theirs[v].share for u, v in pairs.items()])
    agreement = np.array([1 - costs[u, v] / (UNLIKE + HANGING) for u, v in pairs.items()])
    named = [(u, v) for u, v in pairs.items() if mine[u].words and theirs[v].words]
    of_named = sum(mine[u].share + theirs[v].share for u, v in named)
    common = sum((mine[u].share + theirs[v].share) * shared_words(mine[u].words, theirs[v].words) for u, v in named)
    return RigMatch(
        follows,
        tuple(pairs.items()),
        (float(identity.share[follows.any(axis=1)].sum()), float(driving.share[follows.any(axis=0)].sum())),
        float(weight @ agreement / weight.sum()) if weight.sum() > 0 else 0.0,
        float(common / of_named) if of_named > 0 else None,
    )


def chain_cost(u: Chain, v: Chain) -> float:
    """Compare two chains: 0 for equal ones with names, and more the more they differ."""
    place = float(np.linalg.norm(u.points[0] - v.points[0]) + 0.5 * np.linalg.norm(u.points[-1] - v.points[-1]))
    lengths = u.lengths.sum(), v.lengths.sum()
    turned = 0.2 * (1 - float(u.direction @ v.direction)) if min(lengths) > STRAY else 0.0
    longer = 0.2 * abs(np.log((lengths[0] + 0.05) / (lengths[1] + 0.05)))
    larger = 0.1 * abs(np.log((u.share + 0.02) / (v.share + 0.02)))
    sides = OTHER_SIDE * (u.side * v.side < 0) + OFF_MIDDLE * ((u.side == 0) != (v.side == 0))
    names = NAMES * (1 - shared_words(u.words, v.words)) if u.words and v.words else NAMES / 2
    bare = OFF_MIDDLE * ((u.share > 0) != (v.share > 0))
    return place + turned + float(longer + larger) + sides + names + bare + 0.1 * abs(u.depth - v.depth)


def shared_words(u: Collection[str], v: Collection[str]) -> float:
    """Return the share of the words of two sets that both have, over those of the smaller one."""
    return len(set(u) & set(v)) / max(min(len(u), len(v)), 1)


def chain_shares(u: Chain, v: Chain) -> Float[np.ndarray, "N M"]:
    """Tell which joints of one chain those of another one follow: in order, or by arc length if their numbers differ.

    A joint moves what is between it and the next one. By arc length it follows the joints that move the same part of
    the other chain, each by its share of that part.
    """
    if len(u.joints) == len(v.joints):
        return np.eye(len(u.joints))
    bounds = [np.concatenate([[0.0], np.cumsum(np.maximum(chain.lengths, 1e-9))]) for chain in (u, v)]
    (low, high), (other_low, other_high) = ((b[:-1] / b[-1], b[1:] / b[-1]) for b in bounds)
    overlap = np.minimum(high[:, None], other_high) - np.maximum(low[:, None], other_low)
    shares = np.maximum(overlap, 0.0)
    return shares / shares.sum(axis=1, keepdims=True)


FRONT = frozenset({"head", "mouth", "jaw", "nose", "snout", "eye", "eyebrow", "beak", "tongue", "face", "antenna"})
BACK = frozenset({"tail", "abdomen"})
"""Words of joints in front and at the back of a creature."""
SIDES_APART, AHEAD = 0.05, 0.2
"""Distance of left joints from right ones, and of a head from the centre, from which on they say where the front is."""
MOST_OF_IT = 0.6
"""Share of the surface from which on joints called head or tail are the whole creature."""


def named_front(rig: SkinnedCharacter) -> str | None:
    """Find where a creature faces by the names of its joints: by sides, else by what is in front; None if they say
    nothing.
    """
    creature = Creature(rig)
    words = [name_words(name) for name in rig.joint_names]
    left, right = (
        [j for j, (of_joint, _) in enumerate(words) if of_joint == side and creature.moving[j]] for side in (1, -1)
    )
    if left and right:
        across = creature.places[left].mean(axis=0) - creature.places[right].mean(axis=0)
        if np.linalg.norm(across[[0, 2]]) > SIDES_APART:
            return _axis(np.array([-across[2], across[0]]))
    front, back = (
        [j for j, (_, of_joint) in enumerate(words) if group.intersection(of_joint) and creature.moving[j]]
        for group in (FRONT, BACK)
    )
    for chosen, sign in ((front, 1), (back, -1)):
        if chosen and creature.share[chosen].sum() < MOST_OF_IT:
            ahead = sign * np.mean([(creature.places[j] + creature.ends[j]) / 2 for j in chosen], axis=0)[[0, 2]]
            if np.linalg.norm(ahead) > AHEAD:
                return _axis(ahead)
    return None


def _axis(direction: Float[np.ndarray, " 2"]) -> str:
    k = int(np.abs(direction).argmax())
    return ("-" if direction[k] < 0 else "+") + "xz"[k]


ROOTS = {"scale": None, "keep": 1.0, "drop": 0.0}
"""Scale of the way over the ground for each choice of `--root`; None: the ratio of the sizes."""
OPPOSITE = -0.5
"""Cosine of the angle (120 degrees) between chains from which on their axes of bending are not turned."""


@dataclass(frozen=True, eq=False)
class CreatureMotion:
    """How the joints of a rig move since rest, y up and +z front, in the unit of its file."""

    linear: Float[np.ndarray, "T J 3 3"]
    """Rotation of each joint since rest, with the stretch that animated scales give it."""
    positions: Float[np.ndarray, "T J 3"]

    def transforms(self, rest: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "T J 4 4"]:
        """Compute the transform of points that each joint moves, from rest to every frame.

        Args:
            rest: positions of the joints at rest.
        """
        return homogeneous(self.linear, self.positions - (self.linear @ rest[..., None])[..., 0])


def moved_creature(
    identity: Creature, driving: Creature, match: RigMatch, motion: CreatureMotion, root: str = "scale"
) -> CreatureMotion:
    """Compute the motion of the identity's joints.

    Args:
        motion: of the driving.
        root: a key of ROOTS. Other displacements than that over the ground are scaled by the ratio of the sizes.
    """
    rest, count = identity.rig.joints, len(identity.parents)
    scale = identity.size / driving.size
    parents = _hung(identity, match)
    pairs = [(identity.chains[u], driving.chains[v]) for u, v in match.pairs]
    turn = {joint: chain_turn(u, v) for u, v in pairs for joint in u.joints}
    if (across := ROOTS[root]) is not None:
        carried = {j: driving.share[descendants([j], driving.parents)].sum() for j in _roots(driving.parents)}
        main = max(carried, key=lambda j: carried[j])
        way = (motion.positions[:, main] - driving.rig.joints[main]) * [1, 0, 1]
        motion = CreatureMotion(motion.linear, motion.positions + (across / scale - 1) * way[:, None])
    linear = np.tile(np.eye(3), (len(motion.linear), count, 1, 1))
    positions = np.tile(rest, (len(motion.linear), 1, 1))
    for joint in parents_first(parents):
        above = parents[joint]
        known = next((j for j in ancestors(parents, joint)[1:] if match.follows[j].any()), None)
        shift = np.zeros((len(linear), 3))
        if match.follows[joint].any():
            linear[:, joint] = _turned(match, motion, linear, joint, known, turn.get(joint, np.eye(3)))
            other = np.flatnonzero(match.follows[joint] == 1)
            if len(other):
                # How far it is from where its parent takes it, in the parent's frame: roots and parts that slide.
                j, hook = int(other[0]), driving.parents[other[0]]
                hook = int(match.follows[known].argmax()) if hook < 0 and known is not None else hook
                at = driving.rig.joints[j] - (driving.rig.joints[hook] if hook >= 0 else 0.0)
                slid = motion.positions[:, j] - (motion.positions[:, hook] if hook >= 0 else 0.0)
                if hook >= 0:
                    slid = (np.linalg.pinv(motion.linear[:, hook]) @ slid[..., None])[..., 0]
                shift = scale * (slid - at)
        elif above >= 0:
            linear[:, joint] = linear[:, above]
        offset = rest[joint] - (rest[above] if above >= 0 else 0.0) + shift
        positions[:, joint] = (
            offset if above < 0 else positions[:, above] + (linear[:, above] @ offset[..., None])[..., 0]
        )
    return CreatureMotion(linear, positions)


def chain_turn(u: Chain, v: Chain) -> Float[np.ndarray, "3 3"]:
    """Return the smallest rotation from the direction of the driving's chain v to that of the identity's u.

    Limbs and tails bend across themselves, wherever they point at rest. Necks and trunks turn about the world's axes,
    and so do chains that do not hang on anything.
    """
    limbs = (u.side != 0 and v.side != 0) or max(u.direction[2], v.direction[2]) < 0
    pointing = u.direction.any() and v.direction.any() and u.direction @ v.direction > OPPOSITE
    if min(u.hook, v.hook) < 0 or not limbs or not pointing:
        return np.eye(3)
    return rotation_between(v.direction, u.direction)


def _turned(
    match: RigMatch,
    motion: CreatureMotion,
    linear: Float[np.ndarray, "T J 3 3"],
    joint: int,
    known: int | None,
    turn: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "T 3 3"]:
    """Compute the linear map M of a matched joint; `known` is the nearest matched joint above it."""
    shares = match.follows[joint]
    used = np.flatnonzero(shares)
    blended = np.einsum("d,tdkl->tkl", shares[used], motion.linear[:, used])
    if len(used) > 1:  # of several joints the mean rotation; their stretches are of other parts
        blended = nearest_rotation(blended)
    if known is None:
        return blended
    above = np.einsum("d,tdkl->tkl", match.follows[known], motion.linear)
    if (match.follows[known] > 0).sum() > 1:
        above = nearest_rotation(above)
    return linear[:, known] @ turn @ np.linalg.pinv(above) @ blended @ turn.T


def _hung(identity: Creature, match: RigMatch) -> tuple[int, ...]:
    """Return the parents of the identity's joints; roots of parts without a match go with the topmost matched joint."""
    parents, known = list(identity.parents), {*np.flatnonzero(match.follows.any(axis=1)).tolist()}
    main = next((j for j in parents_first(parents) if j in known), None)
    for j in _roots(identity.parents):
        part = descendants([j], identity.parents)
        if main is not None and identity.moving[j] and known.isdisjoint(part):
            parents[j] = main
    return tuple(parents)


def _roots(parents: tuple[int, ...]) -> list[int]:
    return [j for j, parent in enumerate(parents) if parent < 0]
