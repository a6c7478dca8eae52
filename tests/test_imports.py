"""Structure of the package: no cycles, unique class names, nothing heavy at import; layers are `lint-imports`'."""

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

import mimesh

ROOT = Path(mimesh.__file__).parent
GUARDS = ("TYPE_CHECKING", "typing.TYPE_CHECKING")
FILES = sorted(ROOT.rglob("*.py"))


def skipped_nodes(tree: ast.Module) -> set[ast.AST]:
    """Everything inside `if TYPE_CHECKING:`, which never runs."""
    guards = (node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) in GUARDS)
    return {inner for guard in guards for statement in guard.body for inner in ast.walk(statement)}


@cache
def modules() -> dict[str, Path]:
    """Module name below `mimesh` -> its file; "" is the package itself."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix("__init__").rstrip("."): path
        for path in FILES
    }


@cache
def imports_of(module: str) -> frozenset[str]:
    """Modules of ours that one imports when it runs, at load or inside a function."""
    path = modules()[module]
    package = module.split(".") if path.name == "__init__.py" and module else module.split(".")[:-1]
    tree = ast.parse(path.read_text())
    skipped, found = skipped_nodes(tree), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node not in skipped:
            if node.level:
                base = [*package[: len(package) + 1 - node.level], *(node.module or "").split(".")]
            elif (node.module or "").split(".")[0] == "mimesh":
                base = node.module.split(".")[1:]
            else:
                continue
            owner = ".".join(part for part in base if part)
            names = (f"{owner}.{alias.name}".lstrip(".") for alias in node.names)
            found |= {name if name in modules() else owner for name in names}
        elif isinstance(node, ast.Import) and node not in skipped:
            names = {alias.name.removeprefix("mimesh.") for alias in node.names if alias.name.startswith("mimesh.")}
            found |= names
    return frozenset(found - {module})


def test_no_modules_import_each_other_in_a_circle():
    waiting = {module: set(imports_of(module)) - {""} for module in modules()}
    while free := {module for module, others in waiting.items() if not others & waiting.keys()}:
        waiting = {module: others for module, others in waiting.items() if module not in free}
    assert sorted(waiting) == []


def test_no_public_class_name_is_defined_twice():
    names = Counter(
        node.name
        for path in FILES
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert [name for name, count in names.items() if count > 1] == []


@pytest.mark.parametrize("name", ["MimeMethod", "NPTMethod", "AniFormerMethod", "LIMPMethod"])
def test_no_model_is_named_outside_the_methods(name):
    """The pipeline, the studio and the tools treat all methods alike."""
    found = {path.relative_to(ROOT).parts[0] for path in FILES if name in path.read_text()}
    assert found == {"methods"}


def test_importing_the_package_loads_nothing_heavy():
    import subprocess
    import sys

    code = "import sys, mimesh; print(sorted({'numpy', 'scipy', 'torch', 'onnxruntime', 'PIL'} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_the_oldest_numpy_will_do():
    """Arrays have no `mT` before NumPy 2, and Blender 4.5 has NumPy 1.26; tensors have it."""
    for path in FILES:
        names = {node.attr for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Attribute)}
        assert "mT" not in names or "learn" in path.relative_to(ROOT).parts, path
