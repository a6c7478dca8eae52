"""Cases of a parametrization of which `make test` runs a sample and `make test-all` all.

    @matrix("suffix", SUFFIXES, quick=[".obj", ".glb"])
    @matrix(("first", "second"), product(A, B), quick=spanning(A, B))
    @pytest.fixture(params=sampled(FILES, quick=lambda file: file.end == "LF"))

A sample is to span: every value of every argument is in one case at least, so that each piece of code is run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import zip_longest
from typing import Any

import pytest

Quick = Iterable[Any] | Callable[[Any], bool]
"""Some of the cases, or whether a case is one of them."""


def matrix(
    names: str | tuple[str, ...], cases: Iterable[Any], quick: Quick = (), ids: Callable[[Any], str] | None = None
) -> pytest.MarkDecorator:
    """Parametrize a test with all cases; those outside `quick` are slow."""
    return pytest.mark.parametrize(names, sampled(cases, quick, several=not isinstance(names, str)), ids=ids)


def sampled(cases: Iterable[Any], quick: Quick = (), several: bool = False) -> list[Any]:
    """Return parameters, of which those outside `quick` are slow; of `several` names, or of one.

    Raises:
        ValueError: a quick case is none of the cases.
    """
    cases = list(cases)
    if not callable(quick):
        chosen = list(quick)
        if missing := [case for case in chosen if case not in cases]:
            raise ValueError(f"quick: expected some of the cases, found {missing}")
        quick = chosen.__contains__
    marks = [() if quick(case) else pytest.mark.slow for case in cases]
    return [pytest.param(*(case if several else [case]), marks=mark) for case, mark in zip(cases, marks, strict=True)]


def spanning(*values: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Pair up the values of several arguments, so that each comes once; of a shorter list the last one repeats."""
    return [
        tuple(values[k][-1] if value is None else value for k, value in enumerate(row)) for row in zip_longest(*values)
    ]
