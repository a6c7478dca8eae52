"""Who may import whom (ours only): the base nothing but itself, `learn` and `cli` by the command line alone."""

import ast
from pathlib import Path

import pytest

import mimesh

ROOT = Path(mimesh.__file__).parent
CHECKOUT = Path(__file__).parents[1]
GUARDS = ("TYPE_CHECKING", "typing.TYPE_CHECKING")
IMPORTERS = ("import_module", "__import__", "importorskip")
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


def imports_onnxruntime(source: str) -> bool:
    """Whether a file imports onnxruntime when it runs, by a statement or by a function; type checkers may."""
    nodes = list(ast.walk(ast.parse(source)))
    guards = (node for node in nodes if isinstance(node, ast.If) and ast.unparse(node.test) in GUARDS)
    skipped = {inner for guard in guards for statement in guard.body for inner in ast.walk(statement)}
    for node in nodes:
        if node in skipped:
            continue
        names: list[object] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in IMPORTERS:
            names = [argument.value for argument in node.args if isinstance(argument, ast.Constant)]
        if any(str(name).split(".")[0] == "onnxruntime" for name in names):
            return True
    return False


@pytest.mark.parametrize("folder", ["src", "scripts", "benchmarks", "blender", "examples", "docs", "tests"])
def test_one_module_imports_onnxruntime(folder):
    names = {"src": ["mimesh/methods/onnx_runtime.py"], "tests": ["test_privacy.py"]}
    files = sorted((CHECKOUT / folder).rglob("*.py"))
    assert files
    allowed = [CHECKOUT / folder / name for name in names.get(folder, [])]
    assert [path for path in files if imports_onnxruntime(path.read_text())] == allowed


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("def run():\n    import onnxruntime as ort", True),
        ("from onnxruntime.capi import errors", True),
        ("import importlib\nimportlib.import_module('onnxruntime')", True),
        ("pytest.importorskip('onnxruntime')", True),
        ("if TYPE_CHECKING:\n    from onnxruntime import InferenceSession", False),
        ("if TYPE_CHECKING:\n    pass\nelse:\n    import onnxruntime", True),
        ("if not TYPE_CHECKING:\n    import onnxruntime", True),
        ("from .onnx_runtime import import_onnxruntime", False),
    ],
)
def test_an_import_of_onnxruntime_is_found(source, found):
    assert imports_onnxruntime(source) == found


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
