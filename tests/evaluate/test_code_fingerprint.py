"""An edit outdates the figures it may change and no others; what runs for a figure is part of its fingerprint."""

import ast
import shutil
import sys
import threading
from pathlib import Path

import pytest

import mimesh
from mimesh.bodies.contacts import touching
from mimesh.bodies.sampling import sample_pose
from mimesh.core.canonical_order import canonical_order
from mimesh.core.joint_tracks import JointTrack
from mimesh.core.skinning import SkinnedMesh
from mimesh.evaluate import remesh
from mimesh.evaluate.clip_protocols import CLIPS_ANIFORMER
from mimesh.evaluate.code_fingerprint import PackageSource
from mimesh.evaluate.cross_body import CrossBody
from mimesh.evaluate.measure import measure, measure_clip
from mimesh.evaluate.metrics import pmd
from mimesh.evaluate.protocols import CONTACT, DRESSED, HUMAN_NPT, NOISE
from mimesh.evaluate.run import code_of, evaluate_command
from mimesh.io.stl import read_stl
from mimesh.methods.find import find_method
from mimesh.methods.heat_weights import heat_weights
from mimesh.methods.npt import NPTMethod
from mimesh.methods.onnx_models import load_network
from mimesh.pipeline.orientation import reorient
from mimesh.pipeline.refine import Refinement
from mimesh.player.page import write_player
from mimesh.studio.jobs import Worker

ROOT = Path(mimesh.__file__).parent
METHODS = {name: type(find_method(name)) for name in ("skeleton", "npt", "mime")}
PROTOCOLS = {
    "noise": (type(NOISE), measure),
    "contact": (type(CONTACT), measure),
    "cross-body": (CrossBody, measure),
    "clips-aniformer": (type(CLIPS_ANIFORMER), measure_clip),
}
JOINTED = {("mime", protocol) for protocol in PROTOCOLS}
"""Figures of methods with a skeleton that is animated."""
ALL = {(method, protocol) for method in METHODS for protocol in PROTOCOLS}


@pytest.fixture(scope="module")
def copied(tmp_path_factory) -> Path:
    """The package's source and data in a folder of its own."""
    ignored = shutil.ignore_patterns("__pycache__", "*.onnx", "*.js", "*.html")
    return Path(shutil.copytree(ROOT, tmp_path_factory.mktemp("copy") / "mimesh", ignore=ignored))


@pytest.fixture(scope="module")
def before(copied) -> dict[tuple[str, str], int]:
    return fingerprints(copied)


def fingerprints(folder: Path) -> dict[tuple[str, str], int]:
    """Those of all figures, by method and protocol."""
    source = PackageSource(folder)
    return {(m, p): source.fingerprint(METHODS[m], *PROTOCOLS[p]) for m, p in ALL}


def place(definition, folder: Path) -> tuple[Path, ast.FunctionDef | ast.ClassDef]:
    """The copy of the file that defines something, and where in it."""
    definition = getattr(definition, "__wrapped__", definition)
    path = folder / Path(sys.modules[definition.__module__].__file__ or "").relative_to(ROOT)
    body = ast.parse(path.read_text()).body
    for name in definition.__qualname__.split("."):
        node = next(n for n in body if isinstance(n, ast.FunctionDef | ast.ClassDef) and n.name == name)
        body = node.body
    return path, node


def with_line(definition, line: str, folder: Path) -> tuple[Path, str]:
    """The file and its text with a line put in after the docstring of a function or class."""
    path, node = place(definition, folder)
    first = node.body[1]  # all of them have a docstring
    lines = path.read_text().splitlines(keepends=True)
    start = min([first.lineno, *(decorator.lineno for decorator in getattr(first, "decorator_list", ()))])
    lines.insert(start - 1, " " * first.col_offset + line + "\n")
    return path, "".join(lines)


def outdated(path: Path, text: str, folder: Path, before: dict) -> set[tuple[str, str]]:
    """The figures whose fingerprint changes with the text of a file."""
    kept = path.read_text()
    path.write_text(text)
    try:
        return {figure for figure, value in fingerprints(folder).items() if value != before[figure]}
    finally:
        path.write_text(kept)


def of(*methods: str) -> set[tuple[str, str]]:
    """All figures of some methods."""
    return {(method, protocol) for method, protocol in ALL if method in methods}


def on(*protocols: str) -> set[tuple[str, str]]:
    """All figures on some protocols."""
    return {(method, protocol) for method, protocol in ALL if protocol in protocols}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("definition", "expected"),
    [
        (SkinnedMesh, ALL),  # the pipeline of all methods refers to rigs
        (reorient, ALL),  # the pipeline of all methods refers to it
        (Refinement, ALL),
        (JointTrack.smoothed, ALL),
        (METHODS["mime"].prepare, JOINTED),
        (METHODS["skeleton"].prepare, of("skeleton")),
        (heat_weights, of("skeleton")),
        (NPTMethod.prepare, of("npt")),
        (canonical_order, ALL),
        (load_network, ALL),
        (sample_pose, ALL),
        (type(NOISE).noisy_pair, on("noise")),
        (type(DRESSED).unshuffled_pair, set()),
        (touching, on("contact")),
        (remesh.holes, on("noise")),
        (CrossBody.unshuffled_pair, on("cross-body")),
        (type(CLIPS_ANIFORMER).motion, on("clips-aniformer")),
        (measure_clip, on("clips-aniformer")),
        (pmd, ALL),
        (write_player, set()),
        (Worker, set()),
    ],
    ids=lambda value: getattr(value, "__qualname__", None),
)
def test_an_edit_outdates_what_it_may_change(definition, expected, copied, before):
    assert outdated(*with_line(definition, "unused = 1", copied), copied, before) == expected


@pytest.mark.parametrize("definition", [read_stl, Worker, canonical_order], ids=lambda value: value.__name__)
def test_docstrings_and_comments_outdate_nothing(definition, copied, before):
    path, node = place(definition, copied)
    text = path.read_text().replace(ast.get_docstring(node, clean=False) or "", "Other words.")
    assert text != path.read_text()
    assert not outdated(path, "# A comment.\n" + text, copied, before)


def test_data_outdates_what_reads_it(copied, before):
    for name, expected in {
        "human.npz": ALL,
        "cmu.npz": ALL - on("noise"),
        "contacts.npz": set(),
        "dress.npz": set(),
    }.items():
        (path,) = copied.rglob(name)
        kept = path.read_bytes()
        path.write_bytes(kept + b"0")
        changed = {figure for figure, value in fingerprints(copied).items() if value != before[figure]}
        path.write_bytes(kept)
        assert changed == expected, name


def test_another_function_of_the_same_name_is_another(copied, before):
    path, _ = place(measure, copied)
    text = path.read_text().replace("import numpy as np\n", "import scipy as np\n")
    assert outdated(path, text, copied, before) == ALL


@pytest.mark.parametrize("method", ["copy", "deformation-transfer-dense", "npt", "mime"])
def test_what_runs_for_a_figure_is_in_its_fingerprint(method):
    ran = set()

    def called(frame, event, argument) -> None:
        if event == "call":
            ran.add(frame.f_code)

    threading.setprofile(called)
    sys.setprofile(called)
    try:
        measure(CONTACT.pair("val", "hands", 0), method)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    name = "deformation-transfer" if method.startswith("deformation") else method
    found = PackageSource().reachable(type(find_method(name)), type(CONTACT), measure)
    reached = {(module, definition) for module, _, definition in (key.partition(":") for key in found)}
    functions = {
        (
            ".".join(["mimesh", *path.relative_to(ROOT).with_suffix("").parts]).removesuffix(".__init__"),
            code.co_qualname,
        )
        for code in ran
        if (path := Path(code.co_filename)).is_relative_to(ROOT)
    }
    assert len(functions) > 20
    named = {(module, name.partition(".<locals>")[0]) for module, name in functions if not name.startswith("<")}
    # Bodies of classes run when their module is imported, whoever needs it.
    classes = {(module, name) for module, name in named if isinstance(getattr(sys.modules[module], name, None), type)}
    assert named - classes <= reached


def test_a_run_goes_on_but_for_the_method_that_was_edited(tmp_path, monkeypatch):
    out, made = tmp_path / "figures.json", []

    def counted(pair, method, **options):
        made.append(method)
        if len(made) == 7:
            raise KeyboardInterrupt
        return measure(pair, "copy")

    monkeypatch.setattr("mimesh.evaluate.run.measure", counted)
    methods = ["copy", "deformation-transfer-dense"]
    with pytest.raises(KeyboardInterrupt):
        evaluate_command("human-npt", methods, out, split="val", pairs=2)
    edited = code_of(HUMAN_NPT, methods)
    assert edited["copy"] != edited[methods[1]]
    edited["copy"] += 1
    monkeypatch.setattr("mimesh.evaluate.run.code_of", lambda protocol, methods: edited)
    evaluate_command("human-npt", methods, out, split="val", pairs=2)
    assert made == ["copy"] * 4 + methods[1:] * 3 + ["copy"] * 4 + methods[1:] * 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figures.json", "figures.json.partial.old"]
