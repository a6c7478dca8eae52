"""The report of research/check_calibration.py on the axes of limbs shows T-poses and A-poses."""

import dataclasses

import numpy as np
import pytest
from check_calibration import calibration_report

from mimesh.bodies.character_limbs import Limb


@pytest.mark.parametrize("degrees", [0, 45])
def test_calibration_shows_the_pose_of_the_file(degrees):
    """A T-pose and an A-pose."""
    figure = prisms()
    rest = turned(figure, LeftArm=(0, 0, -degrees), RightArm=(0, 0, degrees))
    turn = np.radians(degrees)
    direction = np.array([np.cos(turn), -np.sin(turn), 0])
    limbs = dict(figure.limbs)
    for side in ("Left", "Right"):
        mirror = direction * ([1, 1, 1] if side == "Left" else [-1, 1, 1])
        shoulder = limbs[f"{side}Arm"].start
        elbow, wrist = shoulder + 0.3 * mirror, shoulder + 0.6 * mirror
        limbs[f"{side}Arm"] = Limb(limbs[f"{side}Arm"].joint, shoulder, elbow)
        limbs[f"{side}ForeArm"] = Limb(limbs[f"{side}ForeArm"].joint, elbow, wrist)
    rig = dataclasses.replace(figure.character, mesh=dataclasses.replace(figure.character.mesh, vertices=rest))
    report = calibration_report(rig, limbs)
    assert [report[name] for name in report if name.startswith("below")] == pytest.approx([degrees] * 4, abs=1e-6)
    straight = [report[name] for name in report if name.split()[0] in ("joint", "mirror", "down", "up", "front")]
    np.testing.assert_allclose(straight, 0, atol=1e-5)
