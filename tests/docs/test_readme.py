"""README: its commands exist, its figures are the measured ones; the relative links of all Markdown pages resolve."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from mimesh.__main__ import COMMANDS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s#]*)(?:#([^)\s]+))?\)")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as Sphinx and code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_commands_of_the_readme_exist():
    used = set(re.findall(r"^    (?:\.venv/bin/)?mimesh ([\w-]+)", README, re.MULTILINE))
    assert used
    assert used <= {command.__name__ for command in COMMANDS}
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:^    |`)make (\w+)", README, re.MULTILINE)) <= targets


@pytest.mark.skipif(not (ROOT / "docs" / "results").exists(), reason="a package without its docs")
def test_errors_in_the_readme_are_the_measured_ones():
    report = json.loads((ROOT / "docs" / "results" / "characters.json").read_text(encoding="utf-8"))
    rows = {row["method"]: row["each"]["mm"] for row in report["results"] if row["split"] == "clips" and row["pairs"]}
    moved = [k for k, distance in enumerate(rows["mime"]) if distance is not None]
    assert f"Means are of the {len(moved)} of {len(rows['mime'])} pairs" in README
    measured = {method: np.mean([each[k] for k in moved]) for method, each in rows.items()}
    lines = re.findall(r"^\| ([^|]+) \| ([\d.]+) mm \|$", README, re.MULTILINE)
    assert len(lines) == 4
    for name, figure in lines:
        kinds = {"deformation": "deformation-transfer-13", "the": "identity"}
        method = name.split("`")[1] if "`" in name else kinds[name.split()[0]]
        assert float(figure) == pytest.approx(measured[method], rel=5e-3)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_relative_links_and_pictures_of_a_page_exist(page):
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target, anchor in LINK.findall(text):
        found = page.parent / target if target else page
        assert found.exists(), f"{page.name}: {target}"
        if anchor and found.suffix == ".md":
            assert anchor in anchors(found), f"{page.name}: {target}#{anchor}"
