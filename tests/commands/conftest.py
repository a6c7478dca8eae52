"""Pictures of the commands are small here: what is in them is tested in tests/render and tests/tools."""

import pytest


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr("mimesh.tools.preview.TILE", (60, 72))
