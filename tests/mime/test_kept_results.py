"""What mime has found on a mesh is kept for other jobs with the mesh, and changes no result."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from people import person, walk

import mimesh
from mimesh.methods.find import find_model
from mimesh.mime.kept_results import keep_results
from mimesh.mime.model import Mime
from mimesh.mime.prediction import JointNetwork


@pytest.fixture
def predictions(monkeypatch) -> list[int]:
    """Keep results during a test; a list that grows with each prediction of the network."""
    calls: list[int] = []
    predict = JointNetwork.run

    def counted(*args, **options):
        calls.append(1)
        return predict(*args, **options)

    monkeypatch.setattr(JointNetwork, "run", counted)
    keep_results()
    yield calls
    keep_results(False)


def test_kept_results_save_predictions_and_change_nothing(predictions, model):
    """Of a tiny network, which reads meshes as the shipped one does."""
    keep_results(False)
    identity, clip = person(0), walk(frames=3, faces=600)
    alone = mimesh.animate(identity, clip, model)
    assert len(predictions) > 10
    keep_results()
    first = mimesh.animate(identity, clip, model)
    predictions.clear()
    again = mimesh.animate(identity, clip, model)
    assert predictions == []
    for result in (first, again):
        np.testing.assert_array_equal(result.clip.vertices, alone.clip.vertices)
        assert result.report == alone.report


def test_another_mesh_and_another_seed_are_predicted(predictions):
    def method(seed: int) -> Mime:
        found = find_model("mime", seed=seed)
        assert isinstance(found, Mime)
        return found

    mesh = dataclasses.replace(person(0), name="other")
    method(0).quick_predict(mesh)
    predictions.clear()
    method(0).quick_predict(dataclasses.replace(mesh, name="renamed"))
    assert predictions == []
    method(1).quick_predict(mesh)
    method(0).quick_predict(mesh.with_vertices(mesh.vertices * 1.001))
    assert len(predictions) == 2
