"""README: length, commands, figures; and the relative links of all Markdown pages."""

import json
import re
from pathlib import Path

import pytest

from mimesh.cli import COMMANDS, command_name

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s#]*)(?:#([^)\s]+))?\)")
COLUMNS = (("characters", "table6"), ("characters", "clips"), ("human-wide", "limits"), ("human-npt", "unseen"))
"""Protocol and kind of each column of the table of errors."""


def reports() -> dict[tuple[str, str, str], dict]:
    """Return the measured rows by protocol, kind and method."""
    files = [json.loads(path.read_text()) for path in (ROOT / "docs" / "results").glob("*.json")]
    return {(file["protocol"], row["split"], row["method"]): row for file in files for row in file["results"]}


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as Sphinx and code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_readme_has_at_most_150_lines():
    assert len(README.splitlines()) <= 150


def test_commands_of_the_readme_exist():
    used = set(re.findall(r"^    (?:\.venv/bin/)?mimesh ([\w-]+)", README, re.MULTILINE))
    assert used
    assert used <= {command_name(command) for command in COMMANDS}
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:^    |`)make (\w+)", README, re.MULTILINE)) <= targets


@pytest.mark.skipif(not (ROOT / "docs" / "results").exists(), reason="a package without its docs")
def test_errors_in_the_readme_are_the_measured_ones():
    measured = reports()
    lines = re.findall(r"^\| ([^|]+) \|((?:[^|]* mm,|[^|]*not [a-z]+ \|)[^\n]+)\|$", README, re.MULTILINE)
    assert len(lines) == 5
    for name, cells in lines:
        method = name.split("`")[1] if "`" in name else "deformation-transfer-13"
        for (protocol, kind), cell in zip(COLUMNS, cells.split("|"), strict=True):
            row = measured.get((protocol, kind, method), {})
            if "pmd_e4" not in row:
                assert cell.strip() in ("not possible", "not measured")
                continue
            values = [row[key] for key in ("mm", "pmd_e4", "pmd_e4_median")]
            mm, mean, median = (f"{value:.0f}" if value >= 999.5 else f"{value:.3g}" for value in values)
            assert cell.strip() == f"{mm} mm, {mean} ({median})"


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_relative_links_of_a_page_resolve(page):
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target, anchor in LINK.findall(text):
        found = page.parent / target if target else page
        assert found.exists(), f"{page.name}: {target}"
        if anchor and found.suffix == ".md":
            made = set(re.findall(r"insert: (\w+)", found.read_text(encoding="utf-8")))
            assert anchor in anchors(found) or "commands" in made, f"{page.name}: {target}#{anchor}"
