"""Structure of the package: no cycles, unique class names, nothing heavy at import; layers are `lint-imports`'."""

import ast
from collections import Counter
from pathlib import Path

import grimp
import pytest

import mimesh

ROOT = Path(mimesh.__file__).parent
CHECKOUT = Path(__file__).parents[1]
GUARDS = ("TYPE_CHECKING", "typing.TYPE_CHECKING")
IMPORTERS = ("import_module", "__import__", "importorskip")
FILES = sorted(ROOT.rglob("*.py"))


def skipped_nodes(tree: ast.Module) -> set[ast.AST]:
    """Everything inside `if TYPE_CHECKING:`, which never runs."""
    guards = (node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) in GUARDS)
    return {inner for guard in guards for statement in guard.body for inner in ast.walk(statement)}


def test_the_package_imports_nothing_and_no_modules_import_each_other_in_a_circle():
    graph = grimp.build_graph("mimesh", exclude_type_checking_imports=True, cache_dir=None)
    waiting = {module: graph.find_modules_directly_imported_by(module) - {"mimesh"} for module in graph.modules}
    assert not waiting["mimesh"]
    while free := {module for module, others in waiting.items() if not others & waiting.keys()}:
        waiting = {module: others for module, others in waiting.items() if module not in free}
    assert sorted(waiting) == []


def test_the_package_lists_its_public_names():
    """Modules are loaded when a name is asked for, so without `__dir__` nothing would be listed."""
    assert {*mimesh.__all__, "__version__"} <= set(dir(mimesh))


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


def imports_onnxruntime(source: str) -> bool:
    """Whether a file imports onnxruntime when it runs, by a statement or by a function; type checkers may."""
    tree = ast.parse(source)
    skipped = skipped_nodes(tree)
    for node in ast.walk(tree):
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


@pytest.mark.parametrize("folder", ["src", "scripts", "research", "benchmarks", "blender", "examples", "docs", "tests"])
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


def test_the_oldest_numpy_will_do():
    """Arrays have no `mT` before NumPy 2, and Blender 4.5 has NumPy 1.26; tensors have it."""
    for path in FILES:
        names = {node.attr for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Attribute)}
        assert "mT" not in names or "learn" in path.relative_to(ROOT).parts, path
