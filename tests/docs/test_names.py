"""Names that scripts, examples, benchmarks and pages import from mimesh exist. Most of these are only run by hand."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("scripts", "examples", "benchmarks", "docs/_ext")
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).glob("*.py"))
OPTIONAL = "mimesh.learn"
"""Needs PyTorch, so its names are not checked."""


def missing_names(source: str) -> list[str]:
    """List the names that a file uses from our modules, by import or as an attribute, and that do not exist."""
    tree, modules, missing = ast.parse(source), {}, []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "mimesh" and not alias.name.startswith(OPTIONAL):
                    modules[alias.asname or "mimesh"] = importlib.import_module(
                        alias.name if alias.asname else "mimesh"
                    )
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "mimesh":
            if node.module.startswith(OPTIONAL):
                continue
            for alias in node.names:
                found = look_up(node.module, alias.name)
                missing += [f"{node.module}.{alias.name}"] if found is None else []
                if isinstance(found, ModuleType):
                    modules[alias.asname or alias.name] = found
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            module = modules[node.value.id]
            missing += [] if hasattr(module, node.attr) else [f"{module.__name__}.{node.attr}"]
    return missing


def look_up(module: str, name: str) -> object:
    """Return a module's attribute or submodule; None if there is neither."""
    owner = importlib.import_module(module)
    if not hasattr(owner, name) and hasattr(owner, "__path__") and importlib.util.find_spec(f"{module}.{name}"):
        return importlib.import_module(f"{module}.{name}")
    return getattr(owner, name, None)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_names_of_a_script_exist(path):
    assert missing_names(path.read_text(encoding="utf-8")) == []


def test_names_of_the_notebook_exist():
    cells = json.loads((ROOT / "examples" / "mimesh.ipynb").read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert missing_names("\n".join(code)) == []


def test_names_of_the_reference_exist():
    names = re.findall(r"auto(?:function|class):: (mimesh[\w.]*)\.(\w+)", (ROOT / "docs" / "api.md").read_text())
    assert len(names) > 20
    assert [name for name in names if look_up(*name) is None] == []


def test_missing_names_are_found():
    assert missing_names(
        "from mimesh.render import sheet\nsheet.heat_map()\nfrom mimesh.render.sheet import page, nothing"
    ) == [
        "mimesh.render.sheet.nothing",
        "mimesh.render.sheet.heat_map",
    ]
