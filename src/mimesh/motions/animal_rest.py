"""How the rest pose of a rigged animal differs from that of the shipped quadruped."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.animal_limbs import LEGS, NECK, TAIL
from ..bodies.character_limbs import SIDES
from .rest_calibration import rotation_between


def rest_directions(
    positions: Mapping[str, Float[np.ndarray, " 3"]], ground: float, body: RiggedBody
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute how joints of legs, neck and tail are turned from the shipped quadruped's rest pose to an animal's.

    A joint's direction is that to the next one of its chain that the animal has, of the last one of a leg to the
    ground. Feet on the ground, the trunk and the head keep the world's axes.

    Args:
        positions: of the joints that the animal has, at rest, y up, facing +z.
        ground: height of the ground.
    """
    chains = [[side + part for part in parts] for side in SIDES for parts in LEGS.values()]
    turned = {}
    for chain in [*chains, [*NECK, "Head"], list(TAIL)]:
        had = [name for name in chain if name in positions]
        theirs, ours = (
            np.array([positions[name] for name in had]).reshape(-1, 3),
            body.joints[[body.joint(name) for name in had]],
        )
        if chain in chains:
            toes = body.joints[body.joint(chain[-1])] * [1, 0, 1]
            theirs, ours = (
                np.concatenate([theirs, theirs[-1:] * [1, 0, 1] + [0, ground, 0]]),
                np.concatenate([ours, [toes]]),
            )
            had = had[:-1] if had[-1] == chain[-1] else had
        for k, name in enumerate(had[: len(theirs) - 1]):
            turned[name] = rotation_between(ours[k + 1] - ours[k], theirs[k + 1] - theirs[k])
        if chain[0] == TAIL[0] and len(had) > 1:
            turned[had[-1]] = turned[had[-2]]
    return turned
