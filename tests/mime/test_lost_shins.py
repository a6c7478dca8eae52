"""A shin on the other knee is found where it was predicted on the other leg; legs that are right stay."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.core.geometry import face_normals
from mimesh.core.surface_points import at_barycentric, sample_surface
from mimesh.mime.body_fit import SurfaceSample, fit_body
from mimesh.mime.misread import lost_shin

BODY = load_body()
LEGS = [f"{side}{bone}" for side in ("Left", "Right") for bone in ("Leg", "Foot")]


def sitting(across):
    """World rotations and positions of the joints of a person who sits, and a sample of the surface.

    The right ankle lies on the left knee if the leg lies `across`, else both feet are on the floor.
    """
    pose = np.tile(np.eye(3), (len(BODY.parents), 1, 1))
    for side in ("Left", "Right"):
        turned = across and side == "Right"
        euler = [-95, 60, -20] if turned else [-90, 0, 0]
        pose[BODY.joint(f"{side}UpLeg")] = Rotation.from_euler("xzy", euler, degrees=True).as_matrix()
        knee = 100 if turned else 90
        pose[BODY.joint(f"{side}Leg")] = Rotation.from_euler("x", knee, degrees=True).as_matrix()
    vertices = BODY.posed(0 * sample_shape(BODY, 0, 0), pose)
    face, barycentric = sample_surface(vertices, BODY.faces, 4096, np.random.default_rng(0))
    surface = SurfaceSample(
        at_barycentric(vertices, BODY.faces, face, barycentric), face_normals(vertices, BODY.faces)[face]
    )
    return placed(pose), surface, pose


def placed(pose):
    rotation, offset = BODY.skinning_transforms(BODY.joints, pose)
    return rotation, offset + (rotation @ BODY.joints[..., None])[..., 0]


def test_a_shin_that_was_predicted_on_the_other_leg_is_found():
    (rotation, joints), surface, pose = sitting(across=True)
    left, right, thigh = (BODY.joint(name) for name in ("LeftLeg", "RightLeg", "RightUpLeg"))
    pose[right] = rotation[thigh].T @ rotation[left]
    wrong = fit_body(surface, *placed(pose))
    foot = BODY.joint("RightFoot")
    assert np.linalg.norm(wrong.joints[foot] - joints[foot]) > 0.3
    found = lost_shin(surface, wrong)
    assert found is not None
    np.testing.assert_allclose(found.positions, joints[[BODY.joint(name) for name in LEGS]], atol=0.02)


@pytest.mark.parametrize("across", [False, True])
def test_legs_that_are_right_stay(across):
    true, surface, _ = sitting(across)
    assert lost_shin(surface, fit_body(surface, *true)) is None
