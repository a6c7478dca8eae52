"""Motions of any rigged creature on another one's joints, whose match is known (`bodies.rig_matching`).

Rotations are counted from rest, in the world's axes after both creatures have been turned to y up, +z front. A joint at
the top of a chain turns, relative to the joint that the chain hangs on, as its counterpart does; what has none turns
with what it hangs on. So poses are relative to rest, where those of people and four-legged animals are absolute: the
rests of other creatures have nothing in common that could be calibrated.

M_j(t) is the linear map of joint j since rest. Joint j of the identity follows joint d of the driving, and the nearest
matched joint a above j follows c: then M_j = M_a C (M_c^-1 M_d) C^T. C takes the axes of bending of the driving's chain
to those of the identity's (`chain_turn`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..bodies.joint_names import ancestors
from ..bodies.rig_matching import Chain, Creature, RigMatch
from ..core.geometry import nearest_rotation
from ..core.rig import descendants
from .rest_calibration import rotation_between

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
        transforms = np.tile(np.eye(4), (*self.positions.shape[:2], 1, 1))
        transforms[..., :3, :3] = self.linear
        transforms[..., :3, 3] = self.positions - (self.linear @ rest[..., None])[..., 0]
        return transforms


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
    motion = _along(motion, driving, ROOTS[root], scale)
    linear = np.tile(np.eye(3), (len(motion.linear), count, 1, 1))
    positions = np.tile(rest, (len(motion.linear), 1, 1))
    for joint in _parents_first(parents):
        above = parents[joint]
        known = next((j for j in ancestors(parents, joint)[1:] if match.follows[j].any()), None)
        shift = np.zeros((len(linear), 3))
        if match.follows[joint].any():
            linear[:, joint] = _turned(match, motion, linear, joint, known, turn.get(joint, np.eye(3)))
            other = np.flatnonzero(match.follows[joint] == 1)
            if len(other):
                start = None if known is None else int(match.follows[known].argmax())
                shift = scale * _slide(driving, motion, int(other[0]), start)
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


def _slide(driving: Creature, motion: CreatureMotion, joint: int, start: int | None) -> Float[np.ndarray, "T 3"]:
    """Return how far a joint is from where its parent takes it, in the parent's frame: roots and parts that slide.

    `start` stands for the parent of a joint without one; None: the world.
    """
    above = driving.parents[joint]
    above = start if above < 0 else above
    rest = driving.rig.joints
    if above is None:
        return motion.positions[:, joint] - rest[joint]
    step = motion.positions[:, joint] - motion.positions[:, above]
    return (np.linalg.pinv(motion.linear[:, above]) @ step[..., None])[..., 0] - (rest[joint] - rest[above])


def _along(motion: CreatureMotion, driving: Creature, across: float | None, scale: float) -> CreatureMotion:
    """Change the way over the ground of a driving so that `scale` makes it `across` times as long; None: leave it."""
    if across is None:
        return motion
    carried = {j: driving.share[descendants([j], driving.parents)].sum() for j in _roots(driving.parents)}
    main = max(carried, key=lambda j: carried[j])
    way = (motion.positions[:, main] - driving.rig.joints[main]) * [1, 0, 1]
    return CreatureMotion(motion.linear, motion.positions + (across / scale - 1) * way[:, None])


def _hung(identity: Creature, match: RigMatch) -> tuple[int, ...]:
    """Return the parents of the identity's joints; roots of parts without a match go with the main joint."""
    parents, main = list(identity.parents), match.main
    for j in _roots(identity.parents):
        part = descendants([j], identity.parents)
        if main is not None and identity.moving[j] and not match.follows[part].any():
            parents[j] = main
    return tuple(parents)


def _roots(parents: tuple[int, ...]) -> list[int]:
    return [j for j, parent in enumerate(parents) if parent < 0]


def _parents_first(parents: tuple[int, ...]) -> list[int]:
    """Order joints so that each is after its parent."""
    return sorted(range(len(parents)), key=lambda j: len(ancestors(parents, j)))
