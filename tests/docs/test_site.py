"""The documentation is built without warnings, its links work, its marks are filled, and its commands exist."""

import json
import re
import shlex
import subprocess
import sys
from contextvars import copy_context
from importlib import import_module
from pathlib import Path

import pytest

from mimesh.__main__ import COMMANDS, command_line
from mimesh.evaluate.tables import TABLES
from mimesh.io.formats import CLIP_READERS, CLIP_WRITERS, MESH_READERS, MESH_WRITERS
from mimesh.methods.find import MODELS
from mimesh.view.movie import MOVIES

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
pytestmark = pytest.mark.skipif(not (DOCS / "conf.py").exists(), reason="a package without its docs")


@pytest.fixture(scope="module")
def inserts():
    sys.path.insert(0, str(DOCS / "_ext"))
    import inserts

    yield inserts
    sys.path.remove(str(DOCS / "_ext"))


@pytest.fixture(scope="module")
def commands():
    return command_line().commands


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", str(DOCS), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    return out


@pytest.mark.slow
def test_links_of_the_site_work_and_pages_load_nothing_from_other_hosts(site, inserts):
    import links

    errors, _ = links.check(site)
    assert errors == []


def test_broken_links_are_found(tmp_path, inserts):
    import links

    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="b.html">b</a> <a href="#here">h</a> <a href="#there">t</a>'
        '<script src="https://example.com/x.js"></script> <a href="https://example.com">out</a>'
    )
    errors, outside = links.check(tmp_path)
    assert [line.split("expected ")[1].split(",")[0] for line in errors] == ["b.html", "#there", "to fetch nothing"]
    assert outside == ["https://example.com", "https://example.com/x.js"]


def test_the_reference_has_every_command_and_option(inserts):
    text = inserts.command_reference()
    for command in COMMANDS:
        assert f"## mimesh {command.__name__}\n" in text
    assert "`--skinned`" in text
    assert "`--driving-front` `AXIS`" in text


def test_names_of_the_reference_exist():
    names = re.findall(r"auto(?:function|class):: (mimesh[\w.]*)\.(\w+)", (DOCS / "api.md").read_text())
    assert len(names) > 20
    assert [name for module, name in names if not hasattr(import_module(module), name)] == []


def test_every_table_of_the_papers_is_on_their_page():
    used = set(re.findall(r"<!-- insert: table (\S+) -->", (DOCS / "papers.md").read_text()))
    assert used == set(TABLES)


def test_our_row_fits_the_table_of_found_rigs(inserts):
    head = re.search(r"^\| method \| on \| joints .*$", (DOCS / "comparison.md").read_text(), re.MULTILINE)
    row = inserts.found_rigs().splitlines()[0]
    assert head
    assert row.count(" | ") == head[0].count(" | ")
    assert f"{json.loads((ROOT / 'benchmarks' / 'rigs.json').read_text())['results'][0]['pairs']} people" in row


def test_every_model_has_a_section(inserts):
    page = (DOCS / "models.md").read_text()
    assert all(f"\n## {name}\n" in page and f"(#{name})" in inserts.models() for name in MODELS)


def test_every_format_is_on_the_page():
    rows = re.findall(r"^\| (\.[^|]*) \| ([^|]*) ?\| ([^|]*) ?\|", (DOCS / "formats.md").read_text(), re.MULTILINE)
    read, written = ({suffix for row in rows if row[k].strip() for suffix in row[0].split()} for k in (1, 2))
    assert read == {*MESH_READERS, *CLIP_READERS}
    assert written - {".bvh", ".vrm", ".vrma"} == {*MESH_WRITERS, *CLIP_WRITERS, *MOVIES}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_marks_of_a_page_are_filled(page, inserts):
    filled = inserts.filled(page.read_text(encoding="utf-8"))
    assert "<!-- insert: " not in filled.replace("<!-- insert: ... -->", "")
    assert "<!-- end of insert" not in filled


def command_lines(text: str) -> list[str]:
    """Return the arguments of the mimesh commands in the code of a page: blocks, indented lines and inline."""
    text = text.replace("\\\n", " ")
    blocks = "".join(re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    lines = re.findall(r"^(?:\$ )?mimesh ([a-z].*)$", blocks, re.MULTILINE)
    lines += re.findall(r"^    (?:\.venv/bin/)?mimesh ([a-z].*)$", text, re.MULTILINE)
    return lines + re.findall(r"`mimesh ([a-z][\w-]* [^`\n]+)`", text)


# The log has commands as they were.
@pytest.mark.parametrize("page", [ROOT / "README.md", *(page for page in PAGES if page.stem != "LOG")])
def test_commands_of_a_page_and_their_options_exist(page, commands):
    wrong = []
    for line in command_lines(page.read_text(encoding="utf-8")):
        if "[OPTIONS]" in line:  # the usage of a command
            continue
        name, *arguments = shlex.split(line, comments=True)
        try:
            # What an option sets, such as --no-limits, ends with the copy of the context.
            copy_context().run(commands[name].make_context, name, arguments)
        except Exception as error:
            # In a sentence, a command may stand without its files; --help exits.
            if type(error).__name__ not in ("MissingParameter", "Exit"):
                wrong.append(f"{line}: {error!r}")
    assert wrong == []
