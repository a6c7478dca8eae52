"""All that a program sees has a docstring: arguments, errors, shapes, units, and an example that runs."""

from __future__ import annotations

import ast
import doctest
import inspect
import re
import textwrap
from typing import Any, NamedTuple

import numpy as np
import pytest
from people import person, walk

import mimesh
from mimesh.io import save_clip, save_mesh
from mimesh.pipeline import report

UNITS = r"second|degree|[Ss]hare|height|factor|[Ff]rom 0 to 1|nats|metres|unit|threshold"
"""What a number is measured in, one of which stands beside each."""
FIRST = ("transfer", "animate", "prepare", "rig", "capture")
"""Whose examples make what others use."""
CLASSES = [value for name in mimesh.__all__ if isinstance(value := getattr(mimesh, name), type)]
CLASSES += [report.TransferReport, report.MeshReport, report.MatchReport, report.ReferenceReport]


class Documented(NamedTuple):
    """A function, class, method or property that users see."""

    name: str
    value: Any

    @property
    def text(self) -> str:
        """Its docstring."""
        return inspect.getdoc(self.value) or ""


def members(owner: type) -> list[Documented]:
    """List the public methods and properties of a class, also those of its bases in this package."""
    ours = [base for base in owner.__mro__ if base.__module__.startswith("mimesh")]
    names = dict.fromkeys(name for base in ours for name in vars(base) if not name.startswith("_"))
    found = [(name, inspect.getattr_static(owner, name, None)) for name in names]
    kinds = (property, classmethod, staticmethod)
    return [
        Documented(f"{owner.__name__}.{name}", getattr(value, "__func__", value))
        for name, value in found
        if inspect.isfunction(value) or isinstance(value, kinds)
    ]


FUNCTIONS = [Documented(name, getattr(mimesh, name)) for name in mimesh.__all__ if name[0].islower()]
METHODS = [member for owner in CLASSES for member in members(owner)]
CALLED = [each for each in FUNCTIONS + METHODS if not isinstance(each.value, property)]
ALL = FUNCTIONS + METHODS + [Documented(owner.__name__, owner) for owner in CLASSES]


def fields(owner: type) -> dict[str, tuple[str, str]]:
    """Return the annotation and the docstring of each public attribute that a class declares."""
    body = ast.parse(textwrap.dedent(inspect.getsource(owner))).body[0]
    assert isinstance(body, ast.ClassDef)
    found = {}
    for statement, after in zip(body.body, [*body.body[1:], None], strict=True):
        if isinstance(statement, ast.AnnAssign) and not ast.unparse(statement.target).startswith("_"):
            text = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
            found[ast.unparse(statement.target)] = (ast.unparse(statement.annotation), str(text))
    return found


def test_there_are_docstrings():
    first = re.compile(r"[A-Z\"(].*\.|Joint -> ")
    assert [each.name for each in ALL if not first.match(each.text.split("\n\n")[0].replace("\n", " "))] == []


def test_arguments_errors_and_an_example_are_documented():
    for each in CALLED:
        names = [name for name in inspect.signature(each.value).parameters if name not in ("self", "cls")]
        args = each.text.partition("Args:")[2].partition("Raises:")[0]
        described = {name for line in re.findall(r"^ +([\w, ]+):", args, re.M) for name in line.split(", ")}
        assert set(names) <= described, each.name
        assert ">>> " in each.text, each.name
        assert "Raises:" in each.text or not names, each.name


def test_arrays_have_shapes():
    for each in FUNCTIONS + METHODS:
        function = each.value.fget if isinstance(each.value, property) else each.value
        annotations = inspect.get_annotations(function).values()
        assert [text for text in annotations if re.search(r"(?<!\[)np\.ndarray", str(text))] == [], each.name


def test_fields_have_docstrings_shapes_and_units():
    for owner in CLASSES:
        for name, (annotation, text) in fields(owner).items():
            where = f"{owner.__name__}.{name}: {text}"
            assert text.endswith((".", ")")), where
            assert not re.search(r"(?<!\[)np\.ndarray", annotation), where
            assert re.search(UNITS, text) or not re.search(r"\bfloat\b", annotation), where


@pytest.mark.slow
def test_examples_run(tmp_path, monkeypatch):
    """In one process and in this order: the first ones make `result`, `moving` and `session`."""
    monkeypatch.chdir(tmp_path)
    save_mesh(person(0), "hero.glb")
    save_mesh(person(0), "hero.obj")
    save_mesh(person(1, 2), "pose.obj")
    save_clip(walk(frames=5), "walk.npz")
    ordered = sorted(ALL, key=lambda each: FIRST.index(each.name) if each.name in FIRST else len(FIRST))
    known: dict[str, Any] = {"mimesh": mimesh, "np": np}
    parser, runner = doctest.DocTestParser(), doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    report, ran = [], 0
    for each in ordered:
        test = parser.get_doctest(each.text, known, each.name, None, None)
        test.globs = known  # shared, where the parser copies
        ran += len(test.examples)
        runner.run(test, out=report.append, clear_globs=False)
    assert not runner.summarize(verbose=False).failed, "".join(report)
    assert ran > 40
