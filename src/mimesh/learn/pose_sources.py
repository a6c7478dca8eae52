"""What the poses of training bodies are drawn from, for each shipped body."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody, quadruped
from ..bodies.contacts import contact_bank
from ..bodies.joint_ranges import ranges_of
from ..bodies.sampling import limits_rotvec, lowered_arms
from ..motions import mirror, pose_bank
from ..motions.clips import split_windows
from ..motions.gaits import quadruped_poses, quadruped_takes
from ..motions.motion import rotmat_to_rotvec


class PoseSources(NamedTuple):
    """Rotation vectors (radians) of J joints."""

    usual: Float[np.ndarray, "2 J 3"]
    """Lowest and highest of everyday poses: those of NPT's Table 6 for people."""
    limits: Float[np.ndarray, "2 J 3"]
    """Lowest and highest that joints allow."""
    frames: Float[np.ndarray, "N J 3"]
    """Frames of motions."""
    resting: Float[np.ndarray, "J 3"]
    """A pose that bodies are modelled in between rest and it: people with lowered arms, animals with a lowered head."""
    postures: Float[np.ndarray, "R J 3"]
    """Ways in which animals stand, of which a share of one is added to every pose but those within the joint limits;
    empty for people."""
    contact_shapes: Float[np.ndarray, "M K"]
    """Shape coefficients of bodies whose limbs touch each other."""
    contact_poses: Float[np.ndarray, "M J 3"]
    """Their poses; both are empty for bodies that have none."""


def pose_sources(body: RiggedBody) -> PoseSources:
    """Load what poses of a shipped body are drawn from."""
    usual, limits = (limits_rotvec(body, table) for table in ranges_of(body))
    if body.name == "quadruped":
        nobody = np.zeros((0, len(body.components))), np.zeros((0, *body.joints.shape))
        frames, resting = quadruped_poses(body, "train"), quadruped.lowered_head(body)
        return PoseSources(usual, limits, frames, resting, quadruped.postures(body), *nobody)
    return PoseSources(
        usual, limits, pose_bank("train"), lowered_arms(body), np.zeros((0, *body.joints.shape)), *contact_bank()
    )


def training_takes(body: RiggedBody) -> list[Float[np.ndarray, "T J 3"]]:
    """Load the motions that windows of a shipped body are cut from, 30 frames a second, as rotation vectors (radians).

    Of people they are the captures and their mirror images, of animals gaits and ways into postures and back.
    """
    if body.name == "quadruped":
        return quadruped_takes(body, "train", fps=30.0)
    takes = [motion for take in split_windows("train") for motion in (take, mirror(take))]
    return [rotmat_to_rotvec(motion.rotmat) for motion in takes]
