"""Rows of reports: figures of every pair, intervals over people, wins, and what warnings are worth."""

import json

import numpy as np
import pytest
from write_results import warnings_count

from mimesh.evaluate.markdown import half_interval, markdown, summary, win_share
from mimesh.evaluate.protocols import QUADRUPED
from mimesh.evaluate.run import evaluate_command, report_text


def figures(pmd, pair="", identity="a", driving="b", **more):
    metrics = {"pmd_e4": pmd, "pmd_public_e4": pmd / 3, "mm": np.sqrt(pmd), "seconds": 0.1}
    return {"pair": pair or str(pmd), "identity": identity, "driving": driving, **metrics, **more}


def row(errors, **more):
    return summary("copy", "seen", [figures(error, **more) for error in errors])


@pytest.mark.slow
def test_a_report_has_the_figures_of_every_pair_their_statistics_and_provenance(tmp_path):
    out, calls = tmp_path / "figures.json", []
    options = {"split": "val", "pairs": 2, "progress": lambda done, total: calls.append((done, total))}
    result = evaluate_command("human-npt", ["copy", "identity"], out, **options)
    assert json.loads(out.read_text()) == result
    assert list(tmp_path.iterdir()) == [out]
    assert calls == [(k + 1, 8) for k in range(8)]
    assert {"seed", "config", "commit", "machine", "date"} <= set(result["provenance"])
    assert "| `copy` |" in markdown(result)
    for line in result["results"]:
        each = line["each"]
        assert {len(column) for column in each.values()} == {2}
        for name in ("pmd_e4", "pmd_public_e4", "mm"):
            np.testing.assert_allclose(line[name], np.mean(each[name]), rtol=1e-2)
            np.testing.assert_allclose(line[f"{name}_median"], np.median(each[name]), rtol=1e-2)
            np.testing.assert_allclose(line[f"{name}_p90"], np.quantile(each[name], 0.9), rtol=1e-2)
    copy, identity = (line for line in result["results"] if line["split"] == "seen")
    assert copy["each"]["pair"] == identity["each"]["pair"], "both methods got the same pairs"
    assert len(set(copy["each"]["pair"])) == 2
    assert win_share(copy, identity) == 1.0, "the driving person's vertices are nearer than the identity at rest"


def test_interval_without_shared_people_is_that_of_independent_pairs():
    errors = np.random.default_rng(1).exponential(3.0, 200)
    identities, drivings = ([f"{role}{k}" for k in range(200)] for role in "ab")
    assert half_interval(errors, identities, drivings) == pytest.approx(1.97 * errors.std() / np.sqrt(200), rel=0.01)


def test_interval_grows_with_the_pairs_that_share_a_person():
    """40 people with errors of their own, measured five times each, are 40 samples and not 200."""
    people = np.repeat(np.random.default_rng(2).exponential(3.0, 40), 5)
    identities, drivings = [f"a{k // 5}" for k in range(200)], [f"b{k}" for k in range(200)]
    independent = half_interval(people, [f"a{k}" for k in range(200)], drivings)
    for groups in ((identities, drivings), (drivings, identities)):
        assert half_interval(people, *groups) == pytest.approx(np.sqrt(5) * independent, rel=0.05)


def test_interval_holds_the_mean_nearly_as_often_as_it_says():
    """14 people who are identities in some pairs and driving in others, with an error of their own in both roles."""
    rng, held = np.random.default_rng(3), 0
    for _ in range(200):
        pairs = np.array([rng.choice(14, 2, replace=False) for _ in range(72)])
        errors = rng.normal(0, 1, 14)[pairs].sum(axis=1) + rng.normal(0, 1, 72)
        held += abs(errors.mean()) <= half_interval(errors, *(list(map(str, role)) for role in pairs.T))
    assert 0.85 <= held / 200 <= 0.98  # the interval over independent pairs: 0.49


def test_win_share_is_over_common_pairs():
    ours = summary("copy", "seen", [figures(1.0, "a"), figures(5.0, "b"), figures(2.0, "c"), {"pair": "d", "why": "-"}])
    theirs = summary("copy", "seen", [figures(2.0, "c"), figures(2.0, "a"), figures(2.0, "b"), figures(9.0, "d")])
    assert win_share(ours, theirs) == pytest.approx(1 / 3)
    assert win_share(theirs, ours) == pytest.approx(1 / 3)
    assert win_share(ours, summary("copy", "seen", [figures(1.0, "e")])) is None
    assert win_share({"method": "copy"}, ours) is None, "a report of before"


def test_warnings_are_counted_for_bad_and_for_good_results():
    seen = [figures(80.0, warned=True, uncertainty=2.5), figures(60.0, warned=False, uncertainty=0.9)]
    unseen = [figures(1.0, warned=True, uncertainty=1.2), figures(20.0, warned=True, uncertainty=3.0)]
    rows = [summary("copy", "seen", seen), summary("copy", "unseen", unseen)]
    assert warnings_count(rows) == {"pairs": 4, "bad": 2, "bad_warned": 1, "good": 1, "good_warned": 1}
    assert warnings_count([row([1.0, 2.0])]) is None


def test_lists_of_a_report_are_on_one_line_and_unchanged():
    report = {"results": [{"each": {"pair": ["a, b", "c\n[d]"], "mm": [1.5, None]}}], "empty": [], "deep": [[1], [2]]}
    text = report_text(report)
    assert json.loads(text) == report
    assert '"mm": [1.5, null]' in text


def test_mime_on_animals_is_described_by_the_network_that_it_opens():
    nothing_measured = [{"why": "left out"}]
    row = summary("mime", "gaits", nothing_measured, QUADRUPED.body)
    assert row["given"] == "trained on our quadruped, which it fits"
    assert "animals" in row["trained"]
    assert summary("mime", "limits", nothing_measured)["given"] == "trained on our body, which it fits"
    assert summary("npt", "gaits", nothing_measured, QUADRUPED.body)["given"] == "trained on our body"
