"""Shows signatures in the reference as they are written in the source, with shapes: `Float[ndarray, 'V 3']`."""

from __future__ import annotations

import dataclasses
import inspect
from functools import partial

from docutils import nodes

EMPTY = inspect.Parameter.empty


def setup(app):
    """Register the changes to signatures and docstrings with Sphinx's autodoc."""
    docstrings: dict[str, list[str]] = {}
    app.connect("autodoc-process-signature", _signature)
    # Napoleon (priority 500) reads text before a colon in an attribute's docstring as its type, which is never meant
    # here. So these docstrings are saved before Napoleon runs and restored after it.
    app.connect("autodoc-process-docstring", partial(_save, docstrings), priority=400)
    app.connect("autodoc-process-docstring", partial(_restore, docstrings), priority=600)
    app.connect("doctree-resolved", _with_dashes)
    return {"parallel_read_safe": True}


def _signature(app, what, name, obj, options, signature, returns):
    """Return a signature with its annotations as written: they are strings in all our files (`annotations` import)."""
    if what == "class" and dataclasses.is_dataclass(obj):
        return "", None  # the fields of a dataclass are listed below its signature
    if what not in ("function", "method") or signature is None:
        return None
    inspected = inspect.signature(obj)
    parameters = [p for p in inspected.parameters.values() if p.name not in ("self", "cls")]
    text = str(inspected.replace(parameters=parameters, return_annotation=EMPTY))
    for parameter in parameters:
        text = text.replace(repr(parameter.annotation), str(parameter.annotation), 1)
    returned = "" if inspected.return_annotation is EMPTY else str(inspected.return_annotation)
    # autodoc writes `ndarray` for the types of fields.
    return text.replace("np.ndarray", "ndarray"), returned.replace("np.ndarray", "ndarray") or None


def _save(docstrings, app, what, name, obj, options, lines):
    if what in ("attribute", "property"):
        docstrings[name] = lines[:]


def _restore(docstrings, app, what, name, obj, options, lines):
    if name in docstrings:
        lines[:] = docstrings.pop(name)


def _with_dashes(app, tree, page):
    """Replace the double hyphen between a parameter and its description by an en dash."""
    for text in list(tree.findall(nodes.Text)):
        if text.astext() == " -- ":
            text.parent.replace(text, nodes.Text(" \N{EN DASH} "))
