"""The documentation is built without warnings, its links work, and its generated parts are up to date."""

import json
import re
import shlex
import subprocess
import sys
from contextvars import copy_context
from pathlib import Path

import pytest
from typer.main import get_command

from mimesh.cli import COMMANDS, app, command_name
from mimesh.evaluate.tables import TABLES, paper_table
from mimesh.io import save_mesh
from mimesh.methods.find import MODELS

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
        assert f"## mimesh {command_name(command)}\n" in text
    assert "`--skinned`" in text
    assert "`--driving-front` `AXIS`" in text


def test_tables_are_those_of_the_reports(inserts):
    reports = [json.loads(path.read_text()) for path in sorted((DOCS / "results").glob("*.json"))]
    used = set(re.findall(r"<!-- insert: table (\S+) -->", (DOCS / "two-papers.md").read_text()))
    assert used == set(TABLES)
    assert all(inserts.table(name) == paper_table(name, *reports) for name in used)


def test_every_model_has_a_section(inserts):
    page = (DOCS / "models.md").read_text()
    assert all(f"\n## {name}\n" in page and f"(#{name})" in inserts.models() for name in MODELS)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_marks_of_a_page_have_their_content_and_pictures_exist(page, inserts):
    text = page.read_text(encoding="utf-8")
    assert inserts.written(text) == text, "run scripts/write_inserts.py"
    assert "<!-- insert: " not in inserts.filled(text).replace("<!-- insert: ... -->", "")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    assert all((DOCS / name).is_file() for name in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text))


def command_lines(text: str) -> list[str]:
    """Return the arguments of the mimesh commands in the code of a page: blocks, indented lines and inline."""
    text = text.replace("\\\n", " ")
    blocks = "".join(re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    lines = re.findall(r"^(?:\$ )?mimesh ([a-z].*)$", blocks, re.MULTILINE)
    lines += re.findall(r"^    (?:\.venv/bin/)?mimesh ([a-z].*)$", text, re.MULTILINE)
    return lines + re.findall(r"`mimesh ([a-z][\w-]* [^`\n]+)`", text)


# The log has commands as they were.
@pytest.mark.parametrize("page", [ROOT / "README.md", *(page for page in PAGES if page.stem != "LOG")])
def test_commands_of_a_page_and_their_options_exist(page):
    commands, wrong = get_command(app).commands, []
    for line in command_lines(page.read_text(encoding="utf-8")):
        if "[OPTIONS]" in line:  # the usage of a command
            continue
        name, *arguments = shlex.split(line, comments=True)
        try:
            # What an option sets, such as --no-limits, ends with the copy of the context.
            copy_context().run(commands[name].make_context, name, arguments)
        except Exception as error:
            # In a sentence, a command may stand without its files.
            if type(error).__name__ != "MissingParameter":
                wrong.append(f"{line}: {error!r}")
    assert wrong == []


def test_every_picture_note_and_transcript_is_used():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert all(f"transcript {name} -->" in text for name in json.loads((DOCS / "transcripts.json").read_text()))
    drawn = {name.replace("_", "-") for name in json.loads((DOCS / "trouble.json").read_text())}
    assert {path.stem.removeprefix("trouble-") for path in (DOCS / "images").glob("trouble-*")} == drawn
    assert all(f"(images/trouble-{name}.webp)" in text for name in drawn)


def test_first_transcript_is_the_current_output(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    monkeypatch.chdir(tmp_path)
    import doc_transcripts

    transcripts = json.loads((DOCS / "transcripts.json").read_text(encoding="utf-8"))
    assert {
        name: tuple(command for command, _ in lines) for name, lines in transcripts.items()
    } == doc_transcripts.COMMANDS
    save_mesh(doc_transcripts.hero(), "hero.obj")
    save_mesh(doc_transcripts.step(), "pose.obj")
    for command, output in transcripts["first"]:
        assert doc_transcripts.run_command(command).output == output, "run python scripts/draw_docs.py transcripts"


def test_pictures_are_small():
    assert sum(path.stat().st_size for path in (DOCS / "images").glob("trouble-*")) < 300_000
