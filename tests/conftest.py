"""Shared fixtures: see `zoo.py` for the tiny meshes every algorithm is run over."""

import pytest


@pytest.fixture(scope="session")
def model(tmp_path_factory) -> str:
    """Write a tiny network of the kind of mime; its predictions mean nothing."""
    pytest.importorskip("onnx")
    from networks import write_mime_network

    return str(write_mime_network(tmp_path_factory.mktemp("network") / "mime.onnx"))
