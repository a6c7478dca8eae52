"""Protocol quadruped: exact truths, poses and shapes by split and number."""

import numpy as np
import pytest
from animals import BODY
from matrix import matrix

from mimesh.evaluate.measure import measure
from mimesh.evaluate.protocols import QUADRUPED
from mimesh.evaluate.run import find_protocol
from mimesh.evaluate.summary import summary

KINDS = QUADRUPED.kinds


@matrix("kind", KINDS, quick=KINDS[:1])
def test_pairs_are_a_pure_function_of_split_kind_and_number(kind):
    one, again, next_one, elsewhere = (
        QUADRUPED.pair(split, kind, i) for split, i in (("val", 1), ("val", 1), ("val", 2), ("test", 1))
    )
    np.testing.assert_array_equal(one.truth, again.truth)
    np.testing.assert_array_equal(one.identity.vertices, again.identity.vertices)
    np.testing.assert_array_equal(one.driving.vertices, again.driving.vertices)
    for other in (next_one, elsewhere):
        assert np.abs(other.driving.vertices - one.driving.vertices).max() > 0.01


@matrix("kind", KINDS, quick=KINDS[:1])
def test_truths_are_animals_in_other_poses_and_shapes(kind):
    for i in range(2):
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


@pytest.mark.slow
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
