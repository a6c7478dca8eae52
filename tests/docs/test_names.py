"""What scripts, examples, benchmarks and pages take from mimesh is there: most of them are run by hand alone."""

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


def unknown(source: str) -> list[str]:
    """Names that a file takes from a module of ours, by import or as an attribute, and that it has not."""
    tree, modules, wrong = ast.parse(source), {}, []
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
                found = taken(node.module, alias.name)
                wrong += [f"{node.module}.{alias.name}"] if found is None else []
                if isinstance(found, ModuleType):
                    modules[alias.asname or alias.name] = found
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            module = modules[node.value.id]
            wrong += [] if hasattr(module, node.attr) else [f"{module.__name__}.{node.attr}"]
    return wrong


def taken(module: str, name: str) -> object:
    """A module's attribute or the module below it; None where there is neither."""
    owner = importlib.import_module(module)
    if not hasattr(owner, name) and hasattr(owner, "__path__") and importlib.util.find_spec(f"{module}.{name}"):
        return importlib.import_module(f"{module}.{name}")
    return getattr(owner, name, None)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_names_of_a_script_are_there(path):
    assert unknown(path.read_text(encoding="utf-8")) == []


def test_names_of_the_notebook_are_there():
    cells = json.loads((ROOT / "examples" / "mimesh.ipynb").read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert unknown("\n".join(code)) == []


def test_names_of_the_reference_are_there():
    names = re.findall(r"auto(?:function|class):: (mimesh[\w.]*)\.(\w+)", (ROOT / "docs" / "api.md").read_text())
    assert len(names) > 20
    assert [name for name in names if taken(*name) is None] == []


def test_a_name_that_has_moved_is_found():
    assert unknown(
        "from mimesh.render import sheet\nsheet.heat_map()\nfrom mimesh.render.sheet import page, nothing"
    ) == [
        "mimesh.render.sheet.nothing",
        "mimesh.render.sheet.heat_map",
    ]
