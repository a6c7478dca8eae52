"""Signatures in the reference as they stand in the source, so that shapes read well: `Float[ndarray, 'V 3']`."""

from __future__ import annotations

import dataclasses
import inspect
from functools import partial

from docutils import nodes

EMPTY = inspect.Parameter.empty


def setup(app):
    """Ask autodoc for a say in signatures and docstrings."""
    said: dict[str, list[str]] = {}
    app.connect("autodoc-process-signature", _signature)
    # Napoleon has 500; it takes what stands before a colon for the type of an attribute, which here it never is.
    app.connect("autodoc-process-docstring", partial(_keep, said), priority=400)
    app.connect("autodoc-process-docstring", partial(_put_back, said), priority=600)
    app.connect("doctree-resolved", _with_dashes)
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
    returned = "" if found.return_annotation is EMPTY else str(found.return_annotation)
    # As autodoc has it in fields.
    return text.replace("np.ndarray", "ndarray"), returned.replace("np.ndarray", "ndarray") or None


def _keep(said, app, what, name, obj, options, lines):
    if what in ("attribute", "property"):
        said[name] = lines[:]


def _put_back(said, app, what, name, obj, options, lines):
    if name in said:
        lines[:] = said.pop(name)


def _with_dashes(app, tree, page):
    """Between a parameter and its words."""
    for text in list(tree.findall(nodes.Text)):
        if text.astext() == " -- ":
            text.parent.replace(text, nodes.Text(" \N{EN DASH} "))
