"""Clips of animals of named species in gaits, for the papers' figures of animals."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..bodies.animals import ANIMALS
from ..bodies.quadruped import posture
from ..bodies.sampling import rotvec_to_rotmat
from ..core.mesh import Clip
from ..motions.gaits import SEEDS, gait_rotations
from ..motions.motion import Motion, rotmat_to_rotvec
from ..motions.procedural import planted
from .clip_protocols import FPS, FRAMES, ClipPair, make_clip_pair, shuffle_clip_vertices
from .pairs import Person, Pose
from .quadruped import quadruped


def species_clip(identity: str, driving: str, gait: str, number: int = 0) -> ClipPair:
    """Make a trial: an animal of a species, which stands, and one of another in a gait; vertices are shuffled.

    Args:
        identity: a species of `bodies.animals.ANIMALS`.
        driving: another one.
        gait: a key of `motions.gaits.GAITS`.
        number: chooses among random gaits of that kind, which no network is trained on.
    """
    body = quadruped()
    pose = rotmat_to_rotvec(gait_rotations(body, gait, SEEDS["test"], number, FRAMES / FPS, FPS)) + posture(
        body, driving
    )
    rotmat = rotvec_to_rotmat(pose)
    motion = Motion(gait, body.joint_names, rotmat, planted(body, rotmat), FPS)
    target, actor = (Person(body, np.array(ANIMALS[name].shape), name) for name in (identity, driving))
    trial = make_clip_pair(target, actor, Pose(rotvec_to_rotmat(posture(body, identity)), "standing"), motion)
    mesh = dataclasses.replace(trial.driving, name=f"{driving}, {gait}")
    trial = dataclasses.replace(trial, driving=mesh, clip=Clip(mesh, trial.clip.vertices, FPS))
    return shuffle_clip_vertices(trial, np.random.default_rng(number))
