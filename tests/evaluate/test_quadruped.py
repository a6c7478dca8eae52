"""Protocol quadruped: exact truths, poses and shapes by split and number."""

import json

import numpy as np
import pytest
from animals import BODY

from mimesh.bodies.body_model import LANDMARKS
from mimesh.cli import run
from mimesh.evaluate.measure import measure
from mimesh.evaluate.quadruped import QUADRUPED
from mimesh.evaluate.run import find_protocol
from mimesh.evaluate.summary import summary

KINDS = QUADRUPED.kinds


@pytest.mark.parametrize("kind", KINDS)
def test_pairs_are_a_pure_function_of_split_kind_and_number(kind):
    one, again, next_one, elsewhere = (
        QUADRUPED.pair(split, kind, i) for split, i in (("val", 1), ("val", 1), ("val", 2), ("test", 1))
    )
    np.testing.assert_array_equal(one.truth, again.truth)
    np.testing.assert_array_equal(one.identity.vertices, again.identity.vertices)
    np.testing.assert_array_equal(one.driving.vertices, again.driving.vertices)
    for other in (next_one, elsewhere):
        assert np.abs(other.driving.vertices - one.driving.vertices).max() > 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_truths_are_animals_in_other_poses_and_shapes(kind):
    for i in range(4):
        pair = QUADRUPED.unshuffled_pair("val", kind, i, QUADRUPED.rng("val", kind, i))
        assert pair.truth.shape == pair.identity.vertices.shape == BODY.vertices.shape
        assert np.isfinite(pair.truth).all()
        assert pair.height == pytest.approx(np.ptp(pair.identity.vertices[:, 1]), rel=0.5)
        moved = np.linalg.norm(pair.truth - pair.identity.vertices, axis=1)
        assert moved.mean() > 0.02 * pair.height
        # Edges are nearly as long in the truth as at rest, and not those of the driving animal.
        edges = BODY.faces[:, :2]
        lengths = {
            name: np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)
            for name, vertices in (
                ("truth", pair.truth), ("identity", pair.identity.vertices), ("driving", pair.driving.vertices)
            )
        }  # fmt: skip
        stretched = {name: np.abs(np.log(lengths["truth"] / lengths[name])) for name in ("identity", "driving")}
        assert np.median(stretched["identity"]) < 0.05
        assert np.median(stretched["driving"]) > 2 * np.median(stretched["identity"])


def test_driving_animals_have_headings_to_both_sides():
    nose, tail = BODY.joint("Head"), BODY.joint("Tail1")
    angles = []
    for i in range(12):
        pair = QUADRUPED.unshuffled_pair("val", "usual", i, QUADRUPED.rng("val", "usual", i))
        ends = [pair.driving.vertices[BODY.weights[:, j] > 0.5].mean(axis=0) for j in (nose, tail)]
        front = ends[0] - ends[1]
        angles.append(np.degrees(np.arctan2(front[0], front[2])))
    assert min(angles) < -10
    assert max(angles) > 10
    assert np.abs(angles).max() < QUADRUPED.heading + 25  # necks turn too


def test_markers_are_the_landmarks_of_both_animals():
    pair = QUADRUPED.pair("val", "limits", 0)
    assert pair.markers is not None
    assert pair.markers.shape == (len(LANDMARKS), 2)
    plain = QUADRUPED.unshuffled_pair("val", "limits", 0, QUADRUPED.rng("val", "limits", 0))
    assert plain.markers is not None
    for shuffled, own in zip(pair.markers.T, plain.markers.T, strict=True):
        assert len(set(shuffled)) == len(set(own)) == len(LANDMARKS)
    np.testing.assert_array_equal(
        pair.identity.vertices[pair.markers[:, 0]], plain.identity.vertices[plain.markers[:, 0]]
    )
    np.testing.assert_array_equal(
        pair.driving.vertices[pair.markers[:, 1]], plain.driving.vertices[plain.markers[:, 1]]
    )


def test_the_protocol_is_found_by_name_and_deformation_transfer_solves_it():
    """Deformation transfer gets the driving animal at rest, which no other method has."""
    protocol = find_protocol("quadruped")
    assert protocol is QUADRUPED
    pair = protocol.pair("val", "gaits", 0)
    assert measure(pair, "deformation-transfer-13")["pmd_e4"] < 0.5 * measure(pair, "identity")["pmd_e4"]


def test_mime_on_animals_is_described_by_the_network_that_it_opens():
    nothing_measured = [{"why": "left out"}]
    row = summary("mime", "gaits", nothing_measured, QUADRUPED.body)
    assert row["given"] == "trained on our quadruped, which it fits"
    assert "animals" in row["trained"]
    assert summary("mime", "limits", nothing_measured)["given"] == "trained on our body, which it fits"
    assert summary("npt", "gaits", nothing_measured, QUADRUPED.body)["given"] == "trained on our body"


@pytest.mark.slow
def test_the_command_says_that_mime_was_trained_on_the_quadruped(tmp_path, capsys):
    """`mime` opens the network of animals for them, so its training is that one's."""
    report = tmp_path / "report.json"
    assert run(["evaluate", "quadruped", "-m", "mime", "--split", "val", "--pairs", "1", "-o", str(report)]) == 0
    assert "our body" not in capsys.readouterr().out
    for row in json.loads(report.read_text())["results"]:
        assert row["given"] == "trained on our quadruped, which it fits"
        assert "animals" in row["trained"]
