"""Public functions as programs call them: arguments are checked, and messages name arguments.

Messages are written with the options of the command line (`give --driving-front`). `public` replaces them by the
arguments of Python (`give driving_front=...`) unless the command line is the caller (`errors.command_line_words`).
"""

from __future__ import annotations

import functools
import inspect
import numbers
import os
import re
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np

from .errors import InputError, did_you_mean, names_options

CLOSE = 0.75
"""Similarity (`difflib`) of the names of arguments from which on one is proposed; "smooth" and "root" have 0.6."""
F = TypeVar("F", bound=Callable[..., Any])

PHRASES = {
    "add --no-limits (Python: with mimesh.no_limits())": "call this inside `with mimesh.no_limits():`",
    ", or ignore the files with --no-joints": "",
    "or ignore the file with --no-joints": "or leave joints out",
    "-m deformation-transfer": 'model="deformation-transfer"',
    "-m mime": 'model="mime"',
    "mimesh convert IN OUT --body-model SMPL.pkl": 'load_recorded_clip(path, body_model="SMPL.pkl")',
    "choose it with -m": "choose another model",
    "; name another with -o": "; name another",
    "--body human or quadruped": 'body="human" or "quadruped"',
    "with --markers FILE": "with markers=...",
    "give one: -o '": "give one: output='",
    "--output-fps": "--fps",
}
"""What is said in another way in Python."""
OPTIONS = (
    *("up", "front", "driving-up", "driving-front", "ensemble", "seed", "pairing", "refine", "reference"),
    *("markers", "model"),
    *("fps", "animation", "start", "stop", "step", "root", "ground", "smooth", "skinned", "rig", "body", "joints"),
    *("driving-joints", "names", "root-bone", "rest", "blendshapes", "body-model", "output", "workers", "summary"),
    *("cluster", "threads"),
)
"""Options of the command line that are arguments in Python, with underscores."""
VALUES = (
    "[+-][xyz]|own|mimesh|human|quadruped|other|auto|file|random|order|body|[TA]|mixamo|unreal|vrm|godot|rigify|\\d+"
)
"""Values that follow an option in messages."""
OPTION = re.compile(rf"(give |with )?(?<![\w-])--({'|'.join(OPTIONS)})(?![\w-])(?: ({VALUES})(?![\w-]))?")


class ArgumentError(InputError, TypeError):
    """A call without an argument that is needed, or with one that the function does not have.

    It is a `TypeError`, too, as Python's own error for such calls.
    """


def for_caller(message: str) -> str:
    """Name arguments of Python in a message that names options, unless the command line is the caller."""
    if names_options():
        return message
    for phrase, other in PHRASES.items():
        message = message.replace(phrase, other)
    return OPTION.sub(_argument, message)


def _argument(found: re.Match[str]) -> str:
    """Return the argument that an option is in Python, with its value if there is one."""
    before, option, value = found.groups(default="")
    name = option.replace("-", "_")
    if value:
        return f"{before}{name}={value}" if value.isdigit() else f'{before}{name}="{value}"'
    return f"{before}{name}=..." if before else name


def public(checked: bool = True) -> Callable[[F], F]:
    """Make a function one that programs call.

    Arguments are checked before the function runs, and wrong ones raise InputError; messages name arguments of Python.

    Args:
        checked: check the kinds of arguments by the annotations; False where a call must take microseconds.
    """

    def decorate(function: F) -> F:
        signature = inspect.signature(function)
        names = [name for name in signature.parameters if name not in ("self", "cls")]

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            try:
                if checked:
                    _check_call(function.__name__, signature, names, args, kwargs)
                return function(*args, **kwargs)
            except InputError as error:
                message = for_caller(str(error))
                if message == str(error):
                    raise
                raise type(error)(message).with_traceback(error.__traceback__) from error.__cause__

        return cast(F, call)

    return decorate


def _check_call(
    function: str, signature: inspect.Signature, names: list[str], args: tuple[Any, ...], given: dict[str, Any]
) -> None:
    """Raise InputError for arguments that are missing, unknown or of another kind than the annotation says."""
    for name in given:
        if name not in signature.parameters:
            hint = did_you_mean(name, names, CLOSE) or f"; it has {', '.join(names)}"
            raise ArgumentError(f"{function}: expected arguments that it has, found {name}{hint}")
    try:
        bound = signature.bind(*args, **given)
    except TypeError as error:
        parameters = signature.parameters
        needed = ", ".join(name for name in names if parameters[name].default is inspect.Parameter.empty)
        raise ArgumentError(f"{function}: expected the arguments {needed}, found: {error}") from None
    for name, value in bound.arguments.items():
        if name in names:
            check_kind(name, value, str(signature.parameters[name].annotation))


def check_kind(name: str, value: object, annotation: str) -> None:
    """Raise InputError for a value of another kind than its annotation, which may be "Mesh | str | Path".

    Kinds that are not in KINDS are left to the function.
    """
    allowed = [kind.strip() for kind in annotation.split("|")]
    if not all(kind in KINDS for kind in allowed) or any(KINDS[kind](value) for kind in allowed):
        return
    words = [WORDS[kind] for kind in allowed if kind != "str" or "Path" not in allowed]
    *others, last = words
    expected = f"{', '.join(others)} or {last}" if others else last
    raise InputError(f"{name}: expected {expected}, found {described(value)}; {_advice(value, allowed)}")


def described(value: object) -> str:
    """Say in a few words what a value is, for messages."""
    if value is None or isinstance(value, (bool, numbers.Number, str, bytes)):
        return repr(value)[:60]
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if _is("Clip")(value):
        return f"a Clip of {len(cast(Any, value))} frames"
    name = type(value).__name__
    return f"{'an' if name[0] in 'aeiouAEIO' else 'a'} {name}"


def _advice(value: object, allowed: list[str]) -> str:
    """Say what to do with a value of a wrong kind."""
    if hasattr(value, "moved"):  # results
        return "give its mesh (Result) or clip (ClipResult)"
    if "Clip" in allowed and _is("Mesh")(value):
        return "mimesh.Clip.still(mesh) is a clip of one frame, transfer takes a pose, save_mesh writes a mesh"
    if "Mesh" in allowed and _is("Clip")(value):
        return (
            "clip.mesh.with_vertices(clip.vertices[0]) is one frame; animate takes whole clips, save_clip writes them"
        )
    if {"Mesh", "Clip"} & set(allowed) and isinstance(value, (np.ndarray, list, tuple)):
        return "make one of arrays: " + (
            "mimesh.Mesh(vertices, faces)" if "Mesh" in allowed else "mimesh.Clip(mesh, vertices)"
        )
    if allowed in (["Mesh"], ["Clip"]) and isinstance(value, (str, os.PathLike)):
        return "load_mesh and load_clip read files; where something is saved, it comes first, then its path"
    return f"give {WORDS['Path' if 'Path' in allowed else allowed[0]]}"


def _is(kind: str) -> Callable[[object], bool]:
    """Return the test of a class of `core.mesh`, by its name: that module imports this one."""
    return lambda value: any(
        (base.__module__, base.__name__) == ("mimesh.core.mesh", kind) for base in type(value).__mro__
    )


def _is_number(kind: type) -> Callable[[object], bool]:
    """Return the test of numbers of a kind; arrays without dimensions, as archives hold them, are numbers."""

    def test(value: object) -> bool:
        scalar = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
        return isinstance(scalar, kind) and not isinstance(scalar, (bool, np.bool_))

    return test


KINDS: dict[str, Callable[[object], bool]] = {
    "None": lambda value: value is None,
    "str": lambda value: isinstance(value, str),
    "Path": lambda value: isinstance(value, os.PathLike),
    "int": _is_number(numbers.Integral),
    "float": _is_number(numbers.Real),
    "bool": lambda value: isinstance(value, (bool, np.bool_)),
    "slice": lambda value: isinstance(value, slice),
    "Progress": callable,
    "Mesh": _is("Mesh"),
    "Clip": _is("Clip"),
}
"""Kind in annotations -> whether a value is of it."""
WORDS = {
    "None": "None",
    "str": "text",
    "Path": "a path",
    "int": "a whole number",
    "float": "a number",
    "bool": "True or False",
    "slice": "a slice",
    "Progress": "a function of (done, total)",
    "Mesh": "a Mesh",
    "Clip": "a Clip",
}
