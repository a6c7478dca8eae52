"""Cases of a parametrization of which `make test` runs a sample and `make test-all` all.

    @matrix("suffix", SUFFIXES, quick=[".obj", ".glb"])
    @matrix(("first", "second"), product(A, B), quick=spanning(A, B))

A sample is to span: every value of every argument is in one case at least, so that each piece of code is run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import zip_longest
from typing import Any

import pytest


def matrix(
    names: str | tuple[str, ...],
    cases: Iterable[Any],
    quick: Iterable[Any] | Callable[[Any], bool] = (),
    ids: Callable[[Any], str] | None = None,
) -> pytest.MarkDecorator:
    """Parametrize a test with all cases; those outside `quick`, a choice of cases or a function of one, are slow.

    Raises:
        ValueError: a quick case is none of the cases.
    """
    cases = list(cases)
    if not callable(quick):
        chosen = list(quick)
        if missing := [case for case in chosen if case not in cases]:
            raise ValueError(f"quick: expected some of the cases, found {missing}")
        quick = chosen.__contains__
    several = not isinstance(names, str)
    marked = [
        pytest.param(*(case if several else [case]), marks=() if quick(case) else pytest.mark.slow) for case in cases
    ]
    return pytest.mark.parametrize(names, marked, ids=ids)


def spanning(*values: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Pair up the values of several arguments, so that each comes once; of a shorter list the last one repeats."""
    return [
        tuple(values[k][-1] if value is None else value for k, value in enumerate(row)) for row in zip_longest(*values)
    ]
