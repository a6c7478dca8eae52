"""Species of animals have their proportions; heads are lowered by shares; poses are frames of the takes."""

import numpy as np
import pytest
from animals import BODY

from mimesh.bodies.animals import ANIMALS
from mimesh.bodies.quadruped import LOWERED_HEAD, lowered_head, posture
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.motions.gaits import quadruped_poses, quadruped_takes


def heights(species):
    """Highest points of the back, of the hips and of the head of a species that stands, over that of the hips."""
    vertices = BODY.posed(np.array(ANIMALS[species].shape), rotvec_to_rotmat(posture(BODY, species)))
    parts = {"back": ("Spine2", "Spine3", "Spine4"), "hips": ("Hips",), "head": ("Head",)}
    own = {part: BODY.weights[:, [BODY.joint(name) for name in names]].sum(axis=1) for part, names in parts.items()}
    top = {part: vertices[weight > 0.5, 1].max() for part, weight in own.items()}
    return {part: top[part] / top["hips"] for part in parts}


def test_species_have_their_proportions():
    horse, lion, camel = (heights(species) for species in ("horse", "lion", "camel"))
    assert camel["back"] > 1.1 > 1.06 > max(horse["back"], lion["back"])
    assert lion["head"] < 1.3 < 1.35 < min(horse["head"], camel["head"])


def test_heads_are_lowered_by_shares():
    half = lowered_head(BODY, 0.5)
    moved = [BODY.joint_names[j] for j in np.flatnonzero(half.any(axis=1))]
    assert set(moved) == set(LOWERED_HEAD)
    np.testing.assert_allclose(2 * half, lowered_head(BODY))
    one = lowered_head(BODY, np.array([1.0, 0.0, 0.0]))
    assert np.degrees(one[BODY.joint("Neck1"), 0]) == pytest.approx(LOWERED_HEAD["Neck1"])
    assert np.count_nonzero(one) == 1


@pytest.mark.slow
def test_poses_are_frames_of_the_takes():
    takes = quadruped_takes(BODY, "val", 10.0)
    assert all(len(take) == 20 for take in takes)
    np.testing.assert_array_equal(np.concatenate(takes), quadruped_poses(BODY, "val"))
    # The same motion at another rate.
    fine = quadruped_takes(BODY, "val", 30.0)
    np.testing.assert_allclose(fine[0][::3], takes[0], atol=1e-6)
