"""Axes by the model that has to read a mesh: mended where it hardly knows it, left alone otherwise."""

import dataclasses

import numpy as np
import pytest
from people import person

from mimesh.core.normalization import Normalization
from mimesh.methods.confidence import Confidence
from mimesh.methods.find import find_method
from mimesh.pipeline.run import reorient

MESH = person(0, pose=3)
MIME = find_method("mime")
LOST = Confidence(40.0, 2.0, {})


def wrong(mesh, up, front):
    return dataclasses.replace(Normalization.fit(mesh, up, front), detected=True)


@pytest.mark.parametrize("axes", [("-y", "+z"), ("-y", "+x"), ("+z", "+y"), ("+x", "-z")])
def test_wrong_axes_are_mended(axes):
    found = reorient(MIME, MESH, wrong(MESH, *axes), (None, None), LOST)
    assert (found.up, found.front) == ("+y", "+z")
    assert found.unsure


def test_what_the_user_says_stands():
    asked = Normalization.fit(MESH, "-y", "+z")
    assert reorient(MIME, MESH, asked, ("-y", "+z"), LOST) is asked
    half = reorient(MIME, MESH, wrong(MESH, "-y", "+x"), ("-y", None), LOST)
    assert half.up == "-y"


def test_what_the_model_knows_stands():
    frame = wrong(MESH, "-y", "+z")
    assert reorient(MIME, MESH, frame, (None, None), Confidence(2.0, 0.5, {})) is frame


def test_what_no_axes_make_better_stands():
    cloud = dataclasses.replace(MESH, vertices=np.random.default_rng(0).normal(size=MESH.vertices.shape))
    frame = Normalization.fit(cloud)
    _, hips = MIME.quick_predict(cloud)
    assert np.allclose(hips @ hips.T, np.eye(3), atol=1e-5)
    assert reorient(MIME, cloud, frame, (None, None), Confidence(40.0, 0.5, {})) is frame
