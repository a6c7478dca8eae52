"""Who may import whom (ours only): the base nothing but itself, `learn` and `cli` by the command line alone."""

import ast
from pathlib import Path

import pytest

import mimesh

ROOT = Path(mimesh.__file__).parent
CLI = {"cli", "commands", "__main__"}
BASE = {"archive", "mesh", "geometry", "frame", "paging", "rig", "track"}
ALLOWED = {name: BASE for name in BASE} | {"bodies": BASE | {"bodies"}, "motions": BASE | {"motions", "bodies"}}
ALLOWED |= {"io": BASE | {"io", "motions", "bodies"}}
FILES = sorted(ROOT.rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Our top-level modules that a file imports, anywhere in it."""
    package, found = ["mimesh", *path.relative_to(ROOT).parent.parts], set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            stem = package[: len(package) + 1 - node.level] if node.level else []
            whole = [*stem, *(node.module or "").split(".")] if node.module else stem
            found |= {".".join([*whole, alias.name]) for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name.split(".")[1] for name in found if name.startswith("mimesh.")}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_one_way(path):
    home = path.relative_to(ROOT).parts[0].removesuffix(".py")
    ours = imported(path)
    assert not ours & CLI or home in CLI
    assert "learn" not in ours or home in CLI | {"learn"}
    if home in ALLOWED:
        assert ours <= ALLOWED[home] | {"__version__"}


def test_importing_the_package_loads_nothing_heavy():
    import subprocess
    import sys

    code = "import sys, mimesh; print(sorted({'numpy', 'scipy', 'torch', 'onnxruntime', 'PIL'} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_the_oldest_numpy_will_do(path):
    """Arrays have no `mT` before NumPy 2, and Blender 4.5 has NumPy 1.26; tensors have it."""
    names = {node.attr for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Attribute)}
    assert "mT" not in names or "learn" in path.relative_to(ROOT).parts
