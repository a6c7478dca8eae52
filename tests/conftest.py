"""Shared fixtures: see `zoo.py` for the tiny meshes every algorithm is run over."""

import threading

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


@pytest.fixture(scope="module")
def kept():
    """Keep what mime finds on a mesh for the other tests of a file: it changes no result (test_kept_results.py)."""
    from mimesh.mime.kept_results import keep_results

    keep_results()
    yield
    keep_results(False)


@pytest.fixture
def in_process(monkeypatch):
    """Have native decoders read sound files without a child process (`support/in_process.py`)."""
    from in_process import run_here

    monkeypatch.setattr("mimesh.io.child_process._run", run_here)


@pytest.fixture(scope="module")
def studio():
    """A studio in this process: its address, its token and its session."""
    from mimesh.studio import make_server, make_session, open_socket
    from mimesh.studio.security import new_token

    session, token = make_session([], 64 * 2**20), new_token()
    listening = open_socket("127.0.0.1", 0)
    port = listening.getsockname()[1]
    server = make_server(session, token, "127.0.0.1", port)
    thread = threading.Thread(target=server.run, args=([listening],))
    thread.start()
    yield f"http://127.0.0.1:{port}", token, session
    server.should_exit = True
    thread.join(10)
    listening.close()
    session.close()
    assert not thread.is_alive()
