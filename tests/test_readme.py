"""The README's file map is complete, and its commands are ones that exist."""

import re
from pathlib import Path

import pytest

from mimesh.cli import COMMANDS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
FILES = [p for folder in ("src", "scripts", "benchmarks", "docs") for p in (ROOT / folder).rglob("*")]
SOURCES = sorted(p for p in FILES if p.suffix in (".py", ".md") and p.name != "__init__.py")


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_the_file_map_names_it(path):
    assert f"`{path.name}`" in README


def test_its_commands_exist():
    used = set(re.findall(r"^    mimesh (\w+)", README, re.MULTILINE))
    assert used
    assert used <= {command.__name__ for command in COMMANDS}
