"""Structure of the package: no cycles, unique class names, nothing heavy at import; layers are `lint-imports`'."""

import os
import re
import runpy
import subprocess
import sys
from collections import Counter
from importlib import metadata
from pathlib import Path

import grimp
import pytest
from packaging.requirements import Requirement
from people import person

import mimesh
from mimesh.core.threads import LINEAR_ALGEBRA
from mimesh.io import save_mesh

ROOT = Path(mimesh.__file__).parent
CHECKOUT = Path(__file__).parents[1]
FILES = sorted(ROOT.rglob("*.py"))


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
    names = Counter(name for path in FILES for name in re.findall(r"(?m)^class ([A-Za-z]\w*)", path.read_text()))
    assert [name for name, count in names.items() if count > 1] == []


@pytest.mark.parametrize("name", ["NPTMethod", "AniFormerMethod"])
def test_no_network_of_the_papers_is_named_outside_the_methods(name):
    """The pipeline, the studio and the tools treat all methods that move vertices alike."""
    found = {path.relative_to(ROOT).parts[0] for path in FILES if name in path.read_text()}
    assert found == {"methods"}


def imports_onnxruntime(source: str) -> bool:
    """Whether a file imports onnxruntime when it runs, by a statement or by a function; type checkers may."""
    running = re.sub(r"(?m)^if TYPE_CHECKING:\n(?:    .*\n?|\n)+", "", source)
    by_function = r"(import_module|__import__|importorskip)\(['\"]onnxruntime\b"
    return re.search(rf"(?m)^ *(import|from) onnxruntime\b|{by_function}", running) is not None


@pytest.mark.parametrize("folder", ["src", "scripts", "research", "benchmarks", "blender", "examples", "docs", "tests"])
def test_one_module_imports_onnxruntime(folder):
    names = {"src": ["mimesh/methods/onnx_runtime.py"], "tests": ["test_imports.py", "test_privacy.py"]}
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
    code = "import sys, mimesh; print(sorted({'numpy', 'scipy', 'torch', 'onnxruntime', 'PIL'} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


MODULES = 104
"""Most modules of mimesh that a transfer between two OBJ files loads: a reader, a route and a network of a paper are
imported by what uses them."""
CALL = """
import sys
from mimesh.__main__ import app
app(["transfer", "hero.obj", "pose.obj", "--no-preview", "--quiet"], standalone_mode=False)
print(*sorted(name for name in sys.modules if name.startswith("mimesh")))
"""


@pytest.mark.slow  # a process of its own, 2 s
def test_a_transfer_loads_what_it_needs(tmp_path):
    save_mesh(person(0), tmp_path / "hero.obj")
    save_mesh(person(1, pose=0), tmp_path / "pose.obj")
    answer = subprocess.run([sys.executable, "-c", CALL], cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded = answer.stdout.split()
    assert (tmp_path / "hero-pose.obj").is_file()
    assert len(loaded) <= MODULES, loaded
    apart = ("io.gltf", "io.ply", "motions", "pipeline.vertex_route", "pipeline.node_route", "methods.npt", "render")
    assert [name for name in loaded if name.removeprefix("mimesh.").startswith(apart)] == []


DISTRIBUTIONS = """
import sys
from importlib.metadata import packages_distributions
import mimesh
hero, pose = (mimesh.load_mesh(name) for name in ("hero.obj", "pose.obj"))
mimesh.transfer(hero, pose)
mimesh.rig(hero)
owners = packages_distributions()
print(*{owner for name in sys.modules for owner in owners.get(name, ())})
"""


@pytest.mark.slow  # a process of its own
def test_the_blender_extension_has_all_packages_that_are_loaded(tmp_path):
    save_mesh(person(0), tmp_path / "hero.obj")
    save_mesh(person(1, pose=0), tmp_path / "pose.obj")
    packages = runpy.run_path(str(CHECKOUT / "scripts" / "build_blender.py"))["PACKAGES"]
    environment = {name: value for name, value in os.environ.items() if name not in LINEAR_ALGEBRA}
    command = [sys.executable, "-c", DISTRIBUTIONS]
    answer = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    needed = set(Requirement(line).name for line in metadata.requires("mimesh") or () if "extra ==" not in line)
    assert set(answer.stdout.split()) & needed == {*packages, "numpy"} - {"wadler-lindig"}  # that is jaxtyping's


def test_the_oldest_numpy_will_do():
    """Arrays have no `mT` before NumPy 2, and Blender 4.5 has NumPy 1.26; tensors have it."""
    found = [path for path in FILES if re.search(r"[\w)\]]\.mT\b", path.read_text())]
    assert [path for path in found if "learn" not in path.relative_to(ROOT).parts] == []
