"""Shared fixtures: see `zoo.py` for the tiny meshes every algorithm is run over."""

import pytest


@pytest.fixture(scope="session")
def model(tmp_path_factory) -> str:
    """Write a tiny network of the kind of mime; its predictions mean nothing."""
    pytest.importorskip("onnx")
    from networks import write_mime_network

    return str(write_mime_network(tmp_path_factory.mktemp("network") / "mime.onnx"))


@pytest.fixture(autouse=True)
def no_progress_lines(monkeypatch):
    """Keep the lines that tell the progress of slow commands away: how many there are depends on the machine."""
    monkeypatch.setattr("mimesh.commands.terminal.LINE_SECONDS", 3600.0)
