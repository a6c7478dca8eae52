"""Quick fits for tests of what does not depend on how near a result is."""

import pytest


@pytest.fixture
def quick_fits(monkeypatch):
    """Have `skeleton` fit few points, without restarts."""
    monkeypatch.setattr("mimesh.methods.skeleton.POINTS", 1000)
    monkeypatch.setattr("mimesh.bodies.chamfer_fit.GOOD_ERROR", 1.0)
