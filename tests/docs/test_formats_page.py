"""The page of formats is the generated one and has every format."""

import importlib.util
from pathlib import Path

import pytest

from mimesh.io.formats import CLIP_READERS, CLIP_WRITERS, MESH_READERS, MESH_WRITERS
from mimesh.render.movie import MOVIES

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "write_formats.py"
pytestmark = pytest.mark.skipif(not SCRIPT.exists(), reason="a package without its scripts")


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("write_formats", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_page_in_the_docs_is_the_generated_one(script):
    assert (ROOT / "docs" / "formats.md").read_text() == script.formats_page(ROOT)


def test_every_format_is_on_the_page(script):
    named = {suffix: row for formats, row in script.ROWS.items() for suffix in formats.split()}
    assert {suffix for suffix, (read, _) in named.items() if read} == {*MESH_READERS, *CLIP_READERS}
    assert {suffix for suffix, (_, written) in named.items() if written} - {".vrm", ".vrma"} == {
        *MESH_WRITERS,
        *CLIP_WRITERS,
        *MOVIES,
    }
