"""Arms that are blocks get their joints from their surface; arms with hands, bent ones and thin ones stay."""

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.core.rig import Rig, descendants
from mimesh.mime.misread import with_block_arms

BODY = load_body()
NAMES = tuple(BODY.joint_names)
CHAINS = [[NAMES.index(f"{side}{bone}") for bone in ("Arm", "ForeArm", "Hand")] for side in ("Left", "Right")]
THICK, LONG = 0.2, 0.5


def tube(start, end, half):
    """Points of the surface of a round tube along x, and of its far end; `half` gives the radius at a share of it."""
    along, angle = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 2 * np.pi, 24, endpoint=False))
    radius = half(along)
    sides = np.stack([start + (end - start) * along, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return sides.reshape(-1, 3)


def figure(half, bend=0.0):
    """Rig of a person whose arms, at x of 0.3 to 0.8, are read with joints too near to the trunk, and the points."""
    joints = BODY.joints.copy()
    points, weights = [tube(-0.2, 0.2, lambda along: 0.3 + 0 * along)], [0]
    for sign, chain in zip((1, -1), CHAINS, strict=True):
        joints[chain] = [[sign * 0.25, 0.02, 0.05], [sign * 0.4, 0.02, 0.05], [sign * 0.55, 0.02 + bend, 0.05]]
        points.append(tube(sign * 0.3, sign * (0.3 + LONG), half))
        weights.append(chain[0])
    of = np.repeat(np.eye(len(NAMES))[weights], [len(part) for part in points], axis=0)
    return Rig(np.tile(np.eye(3), (len(NAMES), 1, 1)), joints, of), np.concatenate(points)


def placed(half, bend=0.0):
    rig, points = figure(half, bend)
    return rig, with_block_arms(rig, points, points, NAMES, tuple(BODY.parents)), points


def test_arms_of_blocks_have_shoulder_elbow_and_wrist_on_their_axis():
    rig, found, points = placed(lambda along: THICK / 1.2 + 0 * along)
    wrist = LONG - 0.5 * THICK / 1.2
    for sign, chain in zip((1, -1), CHAINS, strict=True):
        at = sign * (0.3 + np.array([0.0, wrist / 2, wrist]))
        expected = np.stack([at, 0 * at, 0 * at], axis=1)
        # The start is where 2 % of the points are before it.
        np.testing.assert_allclose(found.joints[chain], expected, atol=0.015)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1, atol=1e-9)
    left = points[:, 0] > 0.3
    assert found.weights[left & (points[:, 0] < 0.35)][:, CHAINS[0][0]].min() > 0.9
    assert found.weights[left & (points[:, 0] > 0.79)][:, CHAINS[0][2]].min() > 0.5
    np.testing.assert_array_equal(
        found.weights[points[:, 0] < 0.2].argmax(axis=1) == 0, points[points[:, 0] < 0.2][:, 0] > -0.3
    )
    fingers = descendants([CHAINS[0][2]], BODY.parents)
    assert len(fingers) > 1
    assert found.joints[fingers][:, 0].max() < 0.3 + LONG + 0.01
    assert np.abs(found.joints[NAMES.index("Head")] - rig.joints[NAMES.index("Head")]).max() < 1e-9


@pytest.mark.parametrize(
    ("half", "bend"),
    [
        (lambda along: THICK / 4 + 0 * along, 0.0),  # thin
        (lambda along: THICK / 1.2 * (1 - 0.7 * along), 0.0),  # thinner towards the hand
        (lambda along: THICK / 1.2 + 0 * along, 0.2),  # bent
    ],
)
def test_other_arms_stay(half, bend):
    rig, found, _ = placed(half, bend)
    assert found is rig
