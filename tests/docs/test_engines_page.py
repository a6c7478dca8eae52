"""The table of bone names in docs/characters.md is that of the code."""

from pathlib import Path

import pytest

from mimesh.bodies.engine_names import SCHEMES

PAGE = Path(__file__).parents[2] / "docs" / "characters.md"
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.read_text().split("### What is written")[1].split("\n###")[0].splitlines()
    if line.startswith("|") and "---" not in line
]
COLUMNS = [column.strip("`") for column in ROWS[0]]


@pytest.mark.parametrize("row", ROWS[2:], ids=lambda row: row[0])
def test_rows_are_those_of_the_schemes(row):
    cells = dict(zip(COLUMNS, row, strict=True))
    for name, scheme in SCHEMES.items():
        if scheme.bones:
            assert cells[name] == scheme.bones.get(cells["ours"], "").removeprefix("mixamorig:")


def test_roots_are_those_of_the_schemes():
    roots = dict(zip(COLUMNS, ROWS[1], strict=True))
    for name, scheme in SCHEMES.items():
        if scheme.bones:
            assert roots[name].replace("`", "").rstrip("*") == scheme.root
            assert roots[name].endswith("*") != scheme.has_root
