"""Clips of shipped animals in gaits and postures, for demos and the studio: feet stand, or are in the air.

The poses of a gait are those of `gaits.py`, which networks are trained and measured on. Here the order of the feet and
the shares of a cycle that they stand are those of running animals, the root goes straight on at one speed, and each leg
is corrected so that its foot stays where it stands. Angles as in `gaits.py`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies import RiggedBody
from ..bodies.anatomy import QUADRUPED
from ..bodies.animals import ANIMALS, animal, animal_body, standing
from ..core.errors import InputError
from ..core.foot_planting import move_ankle
from ..core.geometry import smooth_step
from ..core.mesh import Clip
from ..core.rig import descendants, local_rotations
from .gaits import LEGS, SEEDS, Gait, Style, gait_pose, posture_rotations
from .procedural import planted

RUNS = {
    "walk": Gait((0.0, 0.25, 0.5, 0.75), 0.65, (0.7, 1.3), (12, 20)),
    "pace": Gait((0.0, 0.0, 0.5, 0.5), 0.52, (1.2, 2.0), (14, 22)),
    "trot": Gait((0.0, 0.5, 0.5, 0.0), 0.42, (1.3, 2.2), (14, 22)),
    "canter": Gait((0.0, 0.3, 0.3, 0.55), 0.36, (1.5, 2.2), (16, 24), 8.0),
    "gallop": Gait((0.0, 0.4, 0.12, 0.54), 0.26, (2.0, 3.0), (20, 27), 14.0),
    "bound": Gait((0.0, 0.45, 0.0, 0.45), 0.28, (1.6, 2.6), (20, 27), 20.0),
}
"""Gaits of clips; phases are those of LEGS, after Hildebrand (1977, 1989). All but walk and pace have times without a
foot on the ground: twice a cycle in a trot and a bound, once in a canter and a gallop, with the legs gathered, after
which the hind feet land one after the other and then the forefeet. Legs swing as far as they reach the ground."""
ANIMAL_MOTIONS = {
    "dog walk": ("dog", "walk", 2),
    "camel pace": ("camel", "pace", 0),
    "dog trot": ("dog", "trot", 0),
    "horse canter": ("horse", "canter", 0),
    "horse gallop": ("horse", "gallop", 4),
    "cat bound": ("cat", "bound", 0),
    "dog sits": ("dog", "sit", 0),
    "lion lies": ("lion", "lie", 0),
    "cow eats": ("cow", "eat", 0),
    "cat stretches": ("cat", "stretch", 0),
}
"""Name of a motion for demos -> species of ANIMALS, key of RUNS or POSTURES, and number of the random motion."""
DEMO_FRAMES = 36
"""Frames of these motions."""
FINER = 8
"""Steps to a frame in which the path of a posture is computed."""
STEPS = 240
"""Steps of a cycle in which the path and the corrections of the legs are computed."""
HARMONICS = 2
"""The height of the root is a Fourier series of this order over a cycle: a smooth path through the air, too."""
CLEARANCE = 0.06
"""Least height (metres of the body) of a foot half-way through the air."""
SOLE = 0.01
"""Vertices of a foot up to this height over its lowest one (metres of the body), standing, are its sole."""


def gait_clip(name: str, gait: str, index: int = 0, *, seconds: float = 2.0, fps: float = 30.0) -> Clip:
    """Make a clip of a shipped animal in a gait or posture that no network was trained on: metres, y up, towards +z.

    Args:
        name: a key of `bodies.animals.ANIMALS`.
        gait: a key of RUNS or POSTURES.
        index: chooses among random motions of that kind.
    """
    body, size = animal_body(name), ANIMALS[name].size
    if gait in RUNS:
        style = random_style(gait, index)
        cycle = style.start + style.pace * np.arange(max(round(seconds * fps), 1)) / fps
        rotmat, root = run(body, RUNS[gait], style, standing(body, name), cycle)
    else:
        rotmat = posture_rotations(body, gait, SEEDS["test"], index, seconds, fps * FINER) @ standing(body, name)
        rotmat, root = rotmat[::FINER], planted(body, rotmat)[::FINER]
    vertices = size * body.posed(np.zeros(0), rotmat, root)
    return Clip(dataclasses.replace(animal(name), name=f"{name}-{gait}"), vertices, float(fps))


def animal_clip(name: str) -> Clip:
    """Make the clip of one of ANIMAL_MOTIONS: gaits at 30 frames a second, postures at 15.

    Raises:
        InputError: no such motion.
    """
    if name not in ANIMAL_MOTIONS:
        raise InputError(
            f"{name}: expected a motion of an animal ({', '.join(ANIMAL_MOTIONS)}), found another name; use one of them"
        )
    species, motion, index = ANIMAL_MOTIONS[name]
    fps = 30.0 if motion in RUNS else 15.0
    return gait_clip(species, motion, index, seconds=DEMO_FRAMES / fps, fps=fps)


def random_style(gait: str, index: int) -> Style:
    """Draw pace, stride, lift and bearing of a motion."""
    rng = np.random.default_rng(np.random.SeedSequence([SEEDS["test"], index, 4, list(RUNS).index(gait)]))
    return Style.draw(RUNS[gait], (-5.0, 30.0), rng)


def run(
    body: RiggedBody, gait: Gait, style: Style, stand: Float[np.ndarray, "J 3 3"], cycle: Float[np.ndarray, " T"]
) -> tuple[Float[np.ndarray, "T J 3 3"], Float[np.ndarray, "T 3"]]:
    """Compute joint rotations and the root's path (metres of the body) of an animal whose feet stand still on y = 0.

    What a leg has to be corrected by is computed in one cycle; between two stands it fades.

    Args:
        stand: rotations with which the animal stands.
        cycle: where in its cycles the gait is, in each frame.
    """
    phase = (np.arange(STEPS)[:, None] / STEPS - gait.phases) % 1.0
    stands = phase < gait.duty
    rotmat = gait_pose(body, gait, style, np.arange(STEPS) / STEPS, not gait.back) @ stand
    # With the root at rest: the mean of each sole over the ground, and its lowest height.
    standing_height, soles = body.posed(np.zeros(0), stand)[:, 1], []
    for _, _, ankle in _leg_joints(body):
        foot = np.flatnonzero(body.weights[:, descendants([ankle], body.parents)[1:]].sum(axis=1) > 0.5)
        sole = foot[standing_height[foot] < standing_height[foot].min() + SOLE]
        part = body.part(foot).posed(np.zeros(0), rotmat, np.zeros((len(rotmat), 3)))
        place = part[:, np.isin(foot, sole)].mean(axis=1)
        place[:, 1] = part[..., 1].min(axis=1)
        soles.append(place)
    soles = np.stack(soles, axis=1)
    mean = np.where(stands[..., None], soles, 0.0).sum(axis=0) / stands.sum(axis=0)[:, None]
    # One speed for all feet: how far those that stand go back, over the share of the cycle in which they do.
    later = phase - gait.duty / 2
    distance = -float((np.where(stands, later * (soles[..., 2] - mean[:, 2]), 0.0)).sum() / (stands * later**2).sum())
    height = _root_height(soles[..., 1], stands, phase / gait.duty)
    error = np.stack([mean[:, 0] - soles[..., 0], -soles[..., 1] - height[:, None], mean[:, 2] - soles[..., 2]], -1)
    error[..., 2] -= distance * later
    air = ((phase - gait.duty) / (1 - gait.duty)).clip(0, 1)
    # Corrections of standing feet stay; in the air they fade from that of the last stand to that of the next one.
    faded = error.copy()
    for k in range(error.shape[1]):
        swings: Int[np.ndarray, " S"] = np.flatnonzero(phase[:, k] >= gait.duty)
        last = error[np.where(phase[:, k] < gait.duty, phase[:, k], -1).argmax(), k]
        first = error[phase[:, k].argmin(), k]
        away, back = 1 - smooth_step(air[swings, k], (0.0, 0.5)), smooth_step(air[swings, k], (0.5, 1.0))
        faded[swings, k] = away[:, None] * last + back[:, None] * first
    error = faded
    missing = CLEARANCE * style.lift * np.sin(np.pi * air) - soles[..., 1] - height[:, None] - error[..., 1]
    error[..., 1] += np.where(stands, 0.0, missing.clip(min=0))
    rotmat = gait_pose(body, gait, style, cycle, not gait.back) @ stand
    at = np.arange(STEPS) / STEPS
    for k, joints in enumerate(_leg_joints(body)):
        offset = np.stack([np.interp(cycle, at, error[:, k, axis], period=1.0) for axis in range(3)], axis=1)
        world, displaced = body.skinning_transforms(body.joints, rotmat)
        positions = (world @ body.joints[..., None])[..., 0] + displaced
        rotmat = local_rotations(move_ankle(world, positions, joints, offset, body.parents), body.parents)
    root = np.stack([0.0 * cycle, np.interp(cycle, at, height, period=1.0), distance * (cycle - cycle[0])], axis=1)
    return rotmat, root


def _leg_joints(body: RiggedBody) -> list[tuple[int, ...]]:
    of_leg = {("Right" if leg[0].startswith("Right") else "Left", "Thigh" in leg[0]): leg for leg in QUADRUPED.legs}
    sides = [("Right" if leg.startswith("Right") else "Left", leg.endswith("Hind")) for leg in LEGS]
    return [tuple(body.joint(joint) for joint in of_leg[side]) for side in sides]


def _root_height(
    soles: Float[np.ndarray, "T L"], stands: Bool[np.ndarray, "T L"], share: Float[np.ndarray, "T L"]
) -> Float[np.ndarray, " T"]:
    """Fit the height of the root over a cycle to what the standing feet need, in the middle of their stands most.

    Args:
        soles: their heights with the root at rest.
        share: how far each foot is in its stand, from 0 to 1.
    """
    at = 2 * np.pi * np.arange(len(soles)) / len(soles)
    waves = [np.ones_like(at), *(f(k * at) for k in range(1, HARMONICS + 1) for f in (np.cos, np.sin))]
    basis = np.stack(waves, axis=1)
    weight = np.where(stands, np.sin(np.pi * share.clip(0, 1)) ** 2, 0.0)
    total = weight.sum(axis=1)
    small = 0.02 * total.mean() * len(at) * np.diag([0.0] + [1.0] * 2 * HARMONICS)
    return basis @ np.linalg.solve(basis.T @ (total[:, None] * basis) + small, -basis.T @ (weight * soles).sum(axis=1))
