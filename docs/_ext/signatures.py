"""Signatures in the reference as they stand in the source: `Float[np.ndarray, "V 3"]`, not what Python makes of it."""

from __future__ import annotations

import dataclasses
import inspect

EMPTY = inspect.Parameter.empty


def setup(app):
    """Ask autodoc for a say in signatures and docstrings."""
    app.connect("autodoc-process-signature", _signature)
    # Before napoleon, which has 500.
    app.connect("autodoc-process-docstring", _whole_sentence, priority=400)
    return {"parallel_read_safe": True}


def _signature(app, what, name, obj, options, signature, returns):
    """Annotations are strings in all our files, so they are what was typed."""
    if what == "class" and dataclasses.is_dataclass(obj):
        return "", None  # the fields of a dataclass are listed below it
    if what not in ("function", "method") or signature is None:
        return None
    found = inspect.signature(obj)
    parameters = [p for p in found.parameters.values() if p.name not in ("self", "cls")]
    text = str(found.replace(parameters=parameters, return_annotation=EMPTY))
    for parameter in parameters:
        text = text.replace(repr(parameter.annotation), str(parameter.annotation), 1)
    return text, None if found.return_annotation is EMPTY else str(found.return_annotation)


def _whole_sentence(app, what, name, obj, options, lines):
    """Napoleon takes what stands before a colon in the first line of an attribute for its type; here it never is."""
    if what == "attribute" and lines:
        lines.insert(0, "")
