"""Detected axes are corrected if the model does not recognise the mesh, and kept otherwise."""

import dataclasses

import numpy as np
import pytest
import trimesh
from matrix import matrix
from people import person
from scipy.spatial import KDTree

from mimesh.core.mesh import Mesh
from mimesh.core.normalization import Normalization
from mimesh.methods.find import find_mime
from mimesh.mime.model import FittedJoints, Mime
from mimesh.pipeline.look import coarse_mesh, reorient
from mimesh.rigs.confidence import Confidence

MESH = person(0, pose=3)
MIME = find_mime("mime")
AXES = [("-y", "+z"), ("-y", "+x"), ("+z", "+y"), ("+x", "-z")]
NOT_RECOGNISED = Confidence(40.0, 2.0, {})


def detected_norm(mesh, up, front):
    return dataclasses.replace(Normalization.fit(mesh, up, front), detected=True)


@matrix(("up", "front"), AXES, quick=AXES[:1])
def test_wrong_axes_are_corrected(up, front):
    corrected = reorient(MIME, MESH, detected_norm(MESH, up, front), (None, None), NOT_RECOGNISED)
    assert (corrected.up, corrected.front) == ("+y", "+z")
    assert corrected.unsure


def test_axes_of_the_user_are_kept():
    given = Normalization.fit(MESH, "-y", "+z")
    assert reorient(MIME, MESH, given, ("-y", "+z"), NOT_RECOGNISED) is given
    partly_given = reorient(MIME, MESH, detected_norm(MESH, "-y", "+x"), ("-y", None), NOT_RECOGNISED)
    assert partly_given.up == "-y"


def test_axes_of_a_recognised_mesh_are_kept():
    norm = detected_norm(MESH, "-y", "+z")
    assert reorient(MIME, MESH, norm, (None, None), Confidence(2.0, 0.5, {})) is norm


HEAD = int(MESH.vertices[:, 1].argmax())


@pytest.mark.parametrize(
    ("upside_down", "upright", "up"),
    [(2e-3, 1e-3, "+y"), (5e-4, 1e-3, "-y"), (0.05, 1e-3, "+y"), (0.05, 0.01, "-y")],
)
def test_of_orientations_that_are_about_as_decided_the_one_of_the_nearest_shape_wins(
    upside_down, upright, up, monkeypatch
):
    """Upside down the prediction is the most decided. The fitted body has a mismatch (m) in both orientations.

    What would be refused as it is (0.05) must look like the body in another orientation, not only fit better.
    """

    def quick_predict(_, mesh):
        height = mesh.vertices[HEAD, 1]
        return (0.9 if height > 0.5 else 0.8 if height < -0.5 else 2.0), np.eye(3)

    def fit_body(_, mesh):
        distance = upright if mesh.vertices[HEAD, 1] > 0.5 else upside_down
        return FittedJoints(np.eye(3)[None], np.zeros((1, 3)), Confidence(20.0, 0.85, {}, fit_distance=distance))

    monkeypatch.setattr(Mime, "quick_predict", quick_predict)
    monkeypatch.setattr(Mime, "fit", fit_body)
    doubtful = dataclasses.replace(NOT_RECOGNISED, fit_distance=upside_down)
    assert reorient(MIME, MESH, detected_norm(MESH, "-y", "+z"), (None, None), doubtful).up == up


@pytest.mark.slow
def test_a_coarse_surface_of_a_dense_mesh_is_looked_at():
    """Of more than 30,000 vertices some thousand, not farther from the surface than a cell; others are as they are."""
    vertices, faces = MESH.vertices, MESH.faces
    for _ in range(4):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    dense = Mesh(vertices, faces)
    coarse = coarse_mesh(dense)
    assert coarse_mesh(MESH) is MESH
    assert len(coarse.vertices) < len(dense.vertices) / 3
    assert KDTree(coarse.vertices).query(vertices)[0].max() < 0.1 * np.ptp(vertices[:, 1])
    fitted, (rig, confidence) = MIME.fit(MESH), MIME.predict_rig(MESH)
    assert fitted.confidence == confidence
    assert (fitted.joints == rig.joints).all()


def test_axes_are_kept_where_no_others_are_better(monkeypatch):
    """With almost the same entropy in all orientations."""
    monkeypatch.setattr(Mime, "quick_predict", lambda _, mesh: (1.0 + 0.01 * float(mesh.vertices[0, 1]), np.eye(3)))
    norm = detected_norm(MESH, "-y", "+z")
    assert reorient(MIME, MESH, norm, (None, None), Confidence(40.0, 0.5, {})) is norm


def test_quick_predictions_have_the_axes_of_the_hips():
    _, hips = MIME.quick_predict(MESH)
    assert np.allclose(hips @ hips.T, np.eye(3), atol=1e-5)
