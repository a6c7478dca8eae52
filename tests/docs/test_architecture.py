"""docs/architecture.md: its tree of files agrees with the files of the repository."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.md"
FOLDERS = ("src", "scripts", "benchmarks", "blender", "docs")
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="a package without its docs")


def tree(text: str) -> list[Path]:
    """Parse the tree between the marks: two spaces per level, folders end in a slash, a description follows."""
    block = re.search(r"<!-- tree:begin -->\s*```text\n(.*?)```\s*<!-- tree:end -->", text, re.DOTALL)
    assert block is not None
    paths, stack = [], []
    for line in block[1].splitlines():
        name = line.split()[0]
        depth = (len(line) - len(line.lstrip())) // 2
        stack = [*stack[:depth], name]
        paths.append(Path("".join(stack)))
    return paths


def test_tree_is_parsed_by_indentation():
    text = "<!-- tree:begin -->\n```text\na/b/   what\n  c.py  this\n  d/\n    e.py\nf.py\n```\n<!-- tree:end -->"
    assert tree(text) == [Path(p) for p in ("a/b", "a/b/c.py", "a/b/d", "a/b/d/e.py", "f.py")]


def test_every_path_of_the_tree_exists():
    paths = tree(PAGE.read_text(encoding="utf-8"))
    assert len(set(paths)) == len(paths)
    assert [str(path) for path in paths if not (ROOT / path).exists()] == []


def test_every_source_file_is_in_the_tree():
    paths = set(tree(PAGE.read_text(encoding="utf-8")))
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".md")]
    assert [str(path) for path in files if path.relative_to(ROOT) not in paths and "_build" not in path.parts] == []
